"""The sample block that comes with the program."""

from __future__ import annotations

import shutil
from importlib.resources import files
from pathlib import Path

from geomosaic.errors import InputError, OutputError

PROJECT = "project.toml"


def sample_folder() -> Path:
    """Folder of the sample: in the installed package, or in a checkout of the repository.

    Raises
    ------
    InputError
        The installation has none.
    """
    package = Path(str(files("geomosaic")))
    for folder in (package / "sample", package.parent / "data" / "sample"):
        if (folder / PROJECT).is_file():
            return folder
    raise InputError("this installation has no sample block", mend="reinstall geomosaic, or run from its repository")


def copy_sample(target: Path) -> Path:
    """Copy the sample to a folder and return its project file.

    A folder that holds the sample already is used as it is; any other that is not empty is left alone.

    Raises
    ------
    InputError, OutputError
        The folder holds something else, or cannot be written.
    """
    source = sample_folder()
    project = target / PROJECT
    if project.is_file() and project.read_bytes() == (source / PROJECT).read_bytes():
        return project
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError("the folder exists and is not empty", where=str(target), mend="name another folder")
    try:
        shutil.copytree(source, target, dirs_exist_ok=True, ignore=shutil.ignore_patterns("output", ".*"))
    except (OSError, shutil.Error) as error:
        raise OutputError(f"the sample cannot be copied: {error}", where=str(target)) from error
    return project
