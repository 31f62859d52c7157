"""Files: read whole and within bounds; written whole or not at all, whatever happens."""

from __future__ import annotations

import csv
import hashlib
import io
import math
import os
import platform
import posixpath
import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError, OutputError
from geomosaic.stores.addresses import Address, is_address
from geomosaic.stores.path import StorePath, given_path, to_path
from geomosaic.types import PathLike


def path_of(given: object, parameter: str) -> Path:
    """Path that a caller has given.

    Parameters
    ----------
    given : object
    parameter : str
        Its name, for the message.

    Raises
    ------
    InputError
        It is no path.
    """
    if not isinstance(given, str | Path):
        raise InputError(f"{type(given).__name__} is no path", where=f"`{parameter}`", hint="give the path of a file")
    return given_path(given)


def relative_path(path: Path, folder: Path) -> str:
    """Path as seen from a folder, with forward slashes; an address of a store from within the same store.

    Parameters
    ----------
    path, folder : Path

    Returns
    -------
    str
        Absolute where there is no way from one to the other, as between drives.
    """
    remote = [isinstance(each, StorePath) for each in (path, folder)]
    if any(remote):
        same = all(remote) and path.parts[:3] == folder.parts[:3]
        return posixpath.relpath("/".join(path.parts[2:]), "/".join(folder.parts[2:])) if same else str(path.absolute())
    try:
        return Path(os.path.relpath(path.absolute(), folder)).as_posix()
    except ValueError:
        return path.absolute().as_posix()


# Bytes of metadata of a scene, the largest of which list every column.
LARGEST_FILE = 256 << 20
# Bytes. No table of orientations or points is that long: a raster given by mistake is not read into memory.
LARGEST_TEXT = 64 << 20
# Bytes of a file of settings, which people write by hand.
LARGEST_TABLE = 4 << 20

# Rows of a table, lines of a list, images of a reconstruction, objects of a layer: as many take a minute or two and one
# to four GB to read.
MOST_ROWS = 1_000_000
# Bytes and rows of a table of tie points, whose columns are read at once: a million takes 4 s and 0.7 GB.
LARGEST_TIES, MOST_TIES = 512 << 20, 10_000_000

# Characters; lines of values are some hundred long, and Python's csv takes 131072 in a field.
_LONGEST_LINE = 100_000


def check_rows(count: int, where: str, most: int | None = None) -> None:
    """Check of the number of rows of anything that is read row by row.

    Parameters
    ----------
    count : int
    where : str
        File, for the message.
    most : int, optional
        `MOST_ROWS` unless given.

    Raises
    ------
    InputError
        More than that.
    """
    most = MOST_ROWS if most is None else most
    if count > most:
        raise InputError(f"more than {most:,} rows", where=where, hint="is it the right file? if so, cut it into parts")


def read_bytes(path: PathLike, what: str, largest: int = LARGEST_FILE) -> bytes:
    """Content of a file of limited size.

    Parameters
    ----------
    path : path-like
    what : str
        Kind of file for messages, such as 'camera file'.
    largest : int
        Bytes.

    Raises
    ------
    InputError
        The file is missing, a folder, too large or unreadable.
    """
    file = to_path(path)
    try:
        if file.stat().st_size > largest:
            raise InputError(
                f"the {what} is larger than {largest >> 20} MB", where=str(path), hint="is it the right file?"
            )
        return file.read_bytes()
    except FileNotFoundError:
        raise InputError(f"the {what} does not exist", where=str(path), hint="check the path") from None
    except IsADirectoryError:
        raise InputError(f"the {what} is a folder", where=str(path), hint="give a file") from None
    except OSError as error:
        raise InputError(
            f"the {what} cannot be read: {error.strerror}", where=str(path), hint="check the permission to read it"
        ) from error


def read_text(path: PathLike, what: str, largest: int = LARGEST_TEXT) -> str:
    """Text of a UTF-8 file of limited size; a byte order mark is dropped.

    Parameters
    ----------
    path, what, largest
        As for `read_bytes`.

    Raises
    ------
    InputError
        As `read_bytes`; or it is no UTF-8 text.
    """
    try:
        return io.TextIOWrapper(io.BytesIO(read_bytes(path, what, largest)), encoding="utf-8-sig").read()
    except UnicodeDecodeError as error:
        raise InputError(
            f"the {what} is not UTF-8 text (byte {error.start})", where=str(path), hint="save it as UTF-8 text"
        ) from None


def read_toml(path: PathLike, what: str, largest: int = LARGEST_TABLE) -> dict[str, Any]:
    """Table of a TOML file of limited size.

    Parameters
    ----------
    path : path-like
    what : str
        Kind of file for messages, such as 'camera file'.
    largest : int
        Bytes: a file picked by mistake is refused before it fills the memory.

    Raises
    ------
    InputError
        The file cannot be read or is no TOML; names file and line.
    """
    import tomllib

    try:
        values = tomllib.loads(read_text(path, what, largest))
        repr(values)  # fails where no message could show a value: hexadecimal numbers of thousands of digits
        return values
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"the {what} is not valid TOML: {error}", where=str(path), hint="correct that line") from None
    except (RecursionError, ValueError) as error:
        # Beyond the grammar of TOML: a whole number of thousands of digits, or brackets within brackets.
        cause = "nested too deeply" if isinstance(error, RecursionError) else f"not valid TOML: {error}"
        raise InputError(f"the {what} is {cause}", where=str(path), hint="is it the right file?") from None


def read_lines(
    path: PathLike, what: str, largest: int = LARGEST_TEXT, most: int | None = None
) -> list[tuple[int, str]]:
    """Lines of a UTF-8 text that are not blank, with their numbers from 1.

    Parameters
    ----------
    path : path-like
    what : str
        Kind of file for messages, such as 'orientation table'.
    largest, most : int
        Bytes and lines at most; `MOST_ROWS` lines unless given.

    Raises
    ------
    InputError
        As `read_text`; more lines, or one of more than 100,000 characters.
    """
    text = read_text(path, what, largest)
    check_rows(text.count("\n"), str(path), most)
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    long = next((number for number, line in lines if len(line) > _LONGEST_LINE), None)
    if long is not None:
        raise InputError(
            f"the {what} has a line of more than {_LONGEST_LINE:,} characters",
            where=f"{path}, line {long}",
            hint="is it the right file?",
        )
    return lines


def delimiter_of(header: str) -> str:
    """Delimiter of a table: the most frequent of tab, semicolon and comma in its header, else a blank.

    Parameters
    ----------
    header : str
    """
    # Delimiters within quotes belong to a name.
    bare = "".join(part for i, part in enumerate(header.replace("'", '"').split('"')) if i % 2 == 0)
    counts = [(bare.count(mark), mark) for mark in ("\t", ";", ",")]
    most = max(counts, key=lambda pair: pair[0])
    return most[1] if most[0] else " "


def read_records(path: PathLike, what: str) -> list[list[str]]:
    """Rows of comma-separated values, the header first; blank lines and comments (#) are left out.

    Parameters
    ----------
    path : path-like
    what : str
        Kind of file for messages, such as 'track'.

    Raises
    ------
    InputError
        As `read_lines`.
    """
    lines = [line for _, line in read_lines(path, what) if not line.lstrip().startswith("#")]
    return list(csv.reader(lines))


def write_atomic(path: Path, text: str, encoding: str = "utf-8", check: Callable[[], None] = lambda: None) -> None:
    """Write a text file in place of one that may be there, and make its folder.

    Parameters
    ----------
    path : Path
    text : str
    encoding : str
    check : callable
        Called when all is written but the name; an error of it leaves the file as it was.

    Raises
    ------
    OutputError
        The folder cannot be made or written, or the disk is full.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"cannot be written: {error.strerror}", where=str(path), hint="check free space and permissions"
        ) from error
    with under_construction(path) as unfinished:
        unfinished.write_text(text, encoding=encoding, newline="\n")
        check()


def partial(path: Path, suffix: str = "") -> Path:
    """Name of a file under construction: `.NAME.partial-HOST-PID`, an ending last, in the folder where it is made.

    Those that dead processes of this machine left of the same final name are removed.

    Parameters
    ----------
    path : Path
    suffix : str
        Ending of the name.
    """
    path = _workplace_name(path)
    # Some drivers take the first such ending in a name for that of the file, so it stands but once.
    stem = path.stem if suffix and path.suffix.lower() == suffix else path.name
    ours = re.escape(f".partial-{_host()}-")
    pattern = re.compile(rf"\.{re.escape(path.stem)}({re.escape(path.suffix)})?{ours}(\d+)(\..*|-.*)?")
    for entry in os.scandir(path.parent):
        found = pattern.fullmatch(entry.name)
        if found and not _alive(int(found.group(2))):
            Path(entry.path).unlink(missing_ok=True)
    return path.with_name(f".{stem}.partial-{_host()}-{os.getpid()}{suffix}")


def workplace(path: Path) -> Path:
    """Folder in which a file is made: its own, or the scratch folder for an object of a store.

    Parameters
    ----------
    path : Path
    """
    return Path(tempfile.gettempdir()) if isinstance(path, StorePath) else path.parent


def _workplace_name(path: Path) -> Path:
    """Final name as it would be in the folder where the file is made; objects of one name do not meet there."""
    if not isinstance(path, StorePath):
        return path
    digest = hashlib.sha256(str(path).encode()).hexdigest()[:12]
    return workplace(path) / f"geomosaic-{digest}-{path.name}"


def put_in_place(unfinished: Path, path: Path) -> None:
    """Give a whole file its final name: on the disk at once, in a store by an upload that is seen at its end.

    Parameters
    ----------
    unfinished, path : Path

    Raises
    ------
    OSError, InputError
        The file cannot be moved, or the store refuses it.
    """
    if isinstance(path, StorePath):
        path.upload(unfinished)
        return
    # The bytes must be on the disk before the name is, or a power cut leaves a final name on a file in pieces.
    sync(unfinished)
    unfinished.replace(path)
    sync(path.parent)


def remove(unfinished: Path) -> None:
    """Remove a file under construction and what lies beside it under longer names (levels, journals).

    Parameters
    ----------
    unfinished : Path
    """
    for entry in os.scandir(unfinished.parent):
        if entry.name == unfinished.name or entry.name.startswith((f"{unfinished.name}.", f"{unfinished.name}-")):
            Path(entry.path).unlink(missing_ok=True)


def _host() -> str:
    return re.sub(r"[^A-Za-z0-9]", "", platform.node()) or "here"


def _alive(process: int) -> bool:
    if os.name == "nt":  # there is no harmless signal
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def sync(path: Path) -> None:
    """Bring a file, or a folder's entries, to the disk.

    Parameters
    ----------
    path : Path
    """
    if os.name == "nt" and path.is_dir():
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def under_construction(path: Path, suffix: str = "", failures: tuple[type[Exception], ...] = ()) -> Iterator[Path]:
    """Name under which a file is made; with the end of the block it gets its own.

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
        put_in_place(unfinished, path)
    except failing as error:
        raise OutputError(
            f"writing failed ({getattr(error, 'strerror', None) or error})",
            where=str(path),
            hint="check the space on the disk and the rights of the folder",
        ) from error
    finally:
        if unfinished is not None:
            remove(unfinished)


def finite(value: float) -> float | None:
    """Number for JSON, which knows no NaN.

    Parameters
    ----------
    value : float

    Returns
    -------
    float or None
        None for NaN and infinity.
    """
    number = float(value)
    return number if math.isfinite(number) else None


def plain(value: Any) -> Any:
    """Values of the types that JSON has.

    Parameters
    ----------
    value : object
        Mappings and sequences are gone through; NumPy arrays and scalars become lists and numbers, others their text.

    Returns
    -------
    dict, list, str, int, float, bool or None
        Floats are finite: NaN and infinity become None.
    """
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, bool) or value is None or isinstance(value, int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    # NumPy arrays and scalars, without importing NumPy here.
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    return str(value)


def absolute(name: str) -> str:
    """Name of a file as a process in another folder finds it; what is no file, such as a part of one, stays.

    Parameters
    ----------
    name : str
    """
    if is_address(name):
        return Address(name)
    path = Path(name)
    return str(path.absolute()) if path.exists() else name
