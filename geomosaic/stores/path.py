"""Path of an object in a store: what the program does with paths of files it does with these."""

from __future__ import annotations

import fnmatch
import io
import os
import re
import stat as modes
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError, OutputError
from geomosaic.stores.addresses import Address, Name, accept, complete, is_address
from geomosaic.stores.failures import StoreError

_Base: Any = type(Path())


def _objects() -> Any:
    """What talks to stores: imported with the first address, as most runs have none."""
    from geomosaic.stores import objects

    return objects


class StorePath(_Base):  # type: ignore[misc]
    """Path of an object or a folder of a store, written as its address.

    It is a `pathlib.Path` whose parts are the scheme, the bucket and the key: names, endings, parents and neighbours
    are those of any path; what is asked of the disk elsewhere is asked of the store here.
    """

    __slots__ = ()

    def __str__(self) -> str:
        scheme, *rest = self.parts[1:]
        return Address(f"{scheme}//{'/'.join(rest)}")

    def __repr__(self) -> str:
        return f"StorePath('{self}')"

    def __fspath__(self) -> str:
        return str(self)

    def __reduce__(self) -> tuple[Any, ...]:
        return given_path, (complete(str(self)),)

    def as_posix(self) -> str:
        """Address."""
        return str(self)

    @property
    def name_in_store(self) -> Name:
        """Scheme, bucket and key."""
        parts = self.parts
        return Name(parts[1].rstrip(":"), parts[2] if len(parts) > 2 else "", "/".join(parts[3:]))

    def absolute(self) -> StorePath:
        """Itself."""
        return self

    def resolve(self, strict: bool = False) -> StorePath:
        """Itself."""
        return self

    def expanduser(self) -> StorePath:
        """Itself."""
        return self

    def samefile(self, other_path: Any) -> bool:
        """Whether two paths are one object."""
        return isinstance(other_path, StorePath) and str(other_path) == str(self)

    def stat(self, *, follow_symlinks: bool = True) -> os.stat_result:
        """Size and time of the object."""
        size, exact = _objects().size_and_time(self.name_in_store)
        seconds = exact // 10**9
        return os.stat_result(
            (modes.S_IFREG | 0o644, 0, 0, 1, 0, 0, size, seconds, seconds, seconds),
            {"st_atime_ns": exact, "st_mtime_ns": exact, "st_ctime_ns": exact},
        )

    lstat = stat

    def exists(self, *, follow_symlinks: bool = True) -> bool:
        """Whether there is such an object, or a folder of _objects()."""
        return self.is_file() or self.is_dir()

    def is_file(self, *, follow_symlinks: bool = True) -> bool:
        """Whether there is such an object."""
        try:
            _objects().size_and_time(self.name_in_store)
        except FileNotFoundError:
            return False
        return True

    def is_dir(self, *, follow_symlinks: bool = True) -> bool:
        """Whether objects lie below; never of an object."""
        name = self.name_in_store
        if name.scheme.startswith("http"):  # the web lists nothing
            return False
        try:
            return any(map(bool, _objects().children(name))) and not self.is_file()
        except FileNotFoundError:
            return False

    def is_symlink(self) -> bool:
        """False."""
        return False

    def neighbours(self) -> tuple[StorePath, ...]:
        """Objects of its folder whose names begin with its stem; none on the web or where listing is refused."""
        name = self.with_name(self.stem).name_in_store
        if name.scheme.startswith("http"):
            return ()
        try:
            return tuple(map(_path, _objects().names_with(name)))
        except (FileNotFoundError, StoreError):
            return ()

    def iterdir(self) -> Iterator[StorePath]:
        """Objects and folders below."""
        for found in _objects().children(self.name_in_store):
            yield from map(_path, found)

    def glob(self, pattern: str, **_: Any) -> Iterator[StorePath]:
        """Objects of this folder whose names are as a pattern; `**` is no part of it."""
        head, _slash, rest = pattern.partition("/")
        if "**" in pattern:
            raise InputError("'**' is not looked for in stores", where=f"{self}/{pattern}", hint="name the folders")
        if not re.search(r"[*?\[]", head):
            found = [self / head]
        else:
            found = [each for each in self.iterdir() if fnmatch.fnmatchcase(each.name, head)]
        for each in found:
            if rest:
                yield from each.glob(rest)
            elif each.exists():
                yield each

    def open(
        self, mode: str = "r", buffering: int = -1, encoding: Any = None, errors: Any = None, newline: Any = None
    ) -> Any:
        """The object, read by ranges."""
        if set(mode) - set("rbt"):
            raise OutputError("objects are written whole", where=str(self), hint="write to a file")
        from geomosaic.stores.reading import RangeReader

        binary = io.BufferedReader(RangeReader(self.name_in_store), buffer_size=_objects().HEAD)
        return binary if "b" in mode else io.TextIOWrapper(binary, encoding or "utf-8", errors, newline)

    def read_bytes(self) -> bytes:
        """All bytes of the object."""
        name = self.name_in_store
        return bytes(_objects().read(name, [(0, _objects().facts(name).size)])[0])

    def read_text(self, encoding: Any = None, errors: Any = None, newline: Any = None) -> str:
        """Text of the object."""
        return io.TextIOWrapper(io.BytesIO(self.read_bytes()), encoding or "utf-8", errors, newline).read()

    def unlink(self, missing_ok: bool = False) -> None:
        """Delete the object."""
        _objects().delete(self.name_in_store)

    def mkdir(self, mode: int = 0o777, parents: bool = False, exist_ok: bool = False) -> None:
        """Nothing: folders of a store are names."""

    def check_writable(self) -> None:
        """Check that objects may be written beside it, and that it is no folder's name."""
        name = self.name_in_store
        try:
            _objects().check_rights(name.scheme, name.store, name.key.rpartition("/")[0])
        except InputError as error:
            error.where = str(self)
            raise

    def sha256(self) -> str | None:
        """Checksum of what this process has written to the object; None where it has not."""
        known: str | None = _objects().checksum(self.name_in_store)
        return known

    def upload(self, file: Path) -> None:
        """Object made of a file, whole or not at all."""
        _objects().write(self.name_in_store, file)


def _path(name: Name) -> StorePath:
    path: StorePath = StorePath("/", f"{name.scheme}:", name.store, *name.key.split("/"))
    return path


def to_path(name: str | Path) -> Path:
    """Path of a name inside of the program: a file's, or an object's, whose store is opened if a user gave it.

    Parameters
    ----------
    name : str or Path
    """
    if isinstance(name, StorePath):
        return name
    text = str(name)
    if not is_address(text):
        return Path(name)
    scheme, _, rest = text.lstrip("/").partition(":")
    path: StorePath = StorePath("/", f"{scheme.lower()}:", *rest.lstrip("/").split("/"))
    return path


def joined(folder: Path, name: str | Path) -> Path:
    """Path of a name that counts from a folder, unless it is absolute or an address.

    Parameters
    ----------
    folder : Path
    name : str or Path
    """
    return to_path(name) if isinstance(name, StorePath) or is_address(str(name)) else folder / name


def split_pattern(path: Path) -> tuple[Path, str]:
    """Folder of a path before its first part with a wildcard, and the rest of it; empty where there is none.

    Parameters
    ----------
    path : Path
    """
    parts = path.parts
    fixed = next((k for k, part in enumerate(parts) if re.search(r"[*?\[]", part)), len(parts))
    return type(path)(*parts[:fixed]), "/".join(parts[fixed:])


def expanded(path: Path) -> tuple[Path, ...]:
    """Objects that the address of a pattern stands for, in order, as a shell does it for files; else the path itself.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        The pattern matches nothing.
    """
    folder, pattern = split_pattern(path) if isinstance(path, StorePath) else (path, "")
    if not pattern:
        return (path,)
    found = tuple(sorted(each for each in folder.glob(pattern) if each.is_file()))
    if not found:
        raise InputError("the pattern matches no object", where=str(path), hint="check it")
    return found


def given_path(name: str | Path) -> Path:
    """Path of a name that a user has given; its store may be opened from now on.

    Parameters
    ----------
    name : str or Path

    Raises
    ------
    InputError
        An address of an unknown scheme, or of no object.
    """
    if isinstance(name, StorePath):
        return name
    accepted = accept(str(name))
    return to_path(accepted) if is_address(accepted) else Path(name)
