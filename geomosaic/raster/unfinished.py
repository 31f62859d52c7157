"""Files made under another name: whole, they get their own; else nothing is left of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from geomosaic.errors import OutputError
from geomosaic.raster.output import check_output, partial, remove, sync


@contextmanager
def under_construction(path: Path, suffix: str = "", failures: tuple[type[Exception], ...] = ()) -> Iterator[Path]:
    """Give the name under which a file is made; with the end of the block it gets its own.

    Parameters
    ----------
    path : Path
        The final name; `check_output` has found it free.
    suffix : str
        Ending of the other name, for writers that go by it.
    failures : tuple of type
        What besides OSError means that writing failed.

    Raises
    ------
    OutputError
        Writing failed.
    """
    unfinished: Path | None = None
    failing: tuple[type[Exception], ...] = (OSError, *failures)
    try:
        unfinished = partial(path, suffix)
        yield unfinished
        sync(unfinished)
        unfinished.replace(path)
        sync(path.parent)
    except failing as error:
        raise OutputError(
            f"writing failed ({getattr(error, 'strerror', None) or error})",
            where=str(path),
            mend="check the space on the disk and the rights of the folder",
        ) from error
    finally:
        if unfinished is not None:
            remove(unfinished)


def write_text(path: Path, text: str, *, overwrite: bool, encoding: str = "utf-8") -> None:
    """Write a text file, whole under its name or not at all.

    Raises
    ------
    OutputExistsError, OutputError
        The name is taken; writing failed.
    """
    check_output(path, overwrite=overwrite)
    with under_construction(path) as unfinished:
        unfinished.write_text(text, encoding=encoding, newline="\n")
