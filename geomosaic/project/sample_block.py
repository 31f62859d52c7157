"""Sample block that comes with the program."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
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
    raise InputError("this installation has no sample block", hint="reinstall geomosaic, or run from its repository")


def copy_sample(target: Path) -> Path:
    """Copy of the sample block in a folder of the user's.

    A folder that holds the sample already is used as it is; any other that is not empty is left alone.

    Parameters
    ----------
    target : Path

    Returns
    -------
    Path
        The project file in it.

    Raises
    ------
    InputError
        The folder holds something else, or the installation has no sample.
    OutputError
        The folder cannot be written.
    """
    source = sample_folder()
    project = target / PROJECT
    if project.is_file() and project.read_bytes() == (source / PROJECT).read_bytes():
        return project
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError("the folder exists and is not empty", where=str(target), hint="name another folder")
    partial = target / f".partial-{os.getpid()}"
    made = not target.exists()
    try:
        shutil.copytree(source, partial, ignore=shutil.ignore_patterns("output", ".*"))
        for entry in sorted(partial.iterdir(), key=lambda entry: entry.name == PROJECT):  # last what says it is whole
            entry.rename(target / entry.name)
    except OSError as error:
        # copytree goes on after a failure and lists them all as source, target, reason; they have one cause.
        reason = error.args[0][0][2] if isinstance(error, shutil.Error) else error.strerror
        raise OutputError(
            f"the sample cannot be copied: {reason}", where=str(target), hint="check free space and permissions"
        ) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        if made and not project.exists():
            with suppress(OSError):
                target.rmdir()
    return project
