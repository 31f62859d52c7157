"""Digests (SHA-256, in hexadecimal) of files, values and source: whether a result still is that of its inputs."""

from __future__ import annotations

import hashlib
import json
import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.stores.path import StorePath, to_path
from geomosaic.types import PathLike


def sha256(path: PathLike) -> str:
    """Digest of a file's bytes, in constant memory.

    Parameters
    ----------
    path : path

    Raises
    ------
    InputError
        The file cannot be read.
    """
    file_path = to_path(path)
    if isinstance(file_path, StorePath) and (written := file_path.sha256()) is not None:
        return written
    try:
        with file_path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", where=str(path), hint="check the path and the permission to read it"
        ) from error


def digest_of(*parts: Any) -> str:
    """Digest of texts, bytes, arrays, and of what JSON can hold; what it cannot counts by its text.

    Parameters
    ----------
    *parts
        Text, bytes, array or JSON value.

    Returns
    -------
    str
        SHA-256 in hexadecimal digits.
    """
    # Each part counts with its length: ("ab", "c") is not ("a", "bc").
    digest = hashlib.sha256()
    for part in parts:
        data = _bytes(part)
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()


def _bytes(part: Any) -> bytes:
    if isinstance(part, bytes):
        return part
    if isinstance(part, np.ndarray | np.generic):
        return np.asarray(part).tobytes()
    if isinstance(part, str):
        return part.encode()
    return json.dumps(part, sort_keys=True, separators=(",", ":"), default=str).encode()


@cache
def source_digest(*modules: str) -> str:
    """Digest of the source of modules, and of all modules of the program that they import, at any depth.

    Parameters
    ----------
    *modules : str
        Dotted names, such as 'geomosaic.mosaicking.mosaic'.
    """
    # A result whose key has it is computed anew when any code that could change it has changed: no one has to remember
    # to raise a number. Comments count too, as it is cheaper to compute once more than to tell them from what decides.
    found: dict[str, str] = {}
    queue = list(modules)
    while queue:
        name = queue.pop()
        if name not in found:
            found[name], imported = _source(name)
            queue += imported
    return digest_of(*(part for name in sorted(found) if found[name] for part in (name, found[name])))


@cache
def _source(name: str) -> tuple[str, tuple[str, ...]]:
    """Digest of a module's source, and what it imports of the program and its own package; empty where it has none."""
    path = _origin(name)
    if path is None:
        return "", ()
    try:
        text = path.read_bytes()
    except OSError:  # no module, but something in one
        return "", ()
    names: list[str] = []
    for found in _imports(name.partition(".")[0]).finditer(b"\n" + text):
        module, what, alone = (part.decode() for part in found.groups(b""))
        names.append(module or alone)
        origin = _origin(module) if module else None
        if origin is not None and origin.name == "__init__.py":
            names += [f"{module}.{part}" for part in re.findall(r"\w+", what)]
    # Who loads a library counts with the C++ that it is built from.
    built = sorted(path.parent.glob("*.[ch]pp")) if b"import ctypes" in text else ()
    return digest_of(text, *(file.read_bytes() for file in built)), tuple(names)


@cache
def _imports(package: str) -> re.Pattern[bytes]:
    """What a module imports from the program or a package, inside functions too: a module and names, or one alone."""
    own = rb"((?:geomosaic|" + re.escape(package).encode() + rb")\b[\w.]*)"
    # From the end of the line before, which is found at once: `^` is tried at every letter of two megabytes.
    return re.compile(rb"\n *(?:from " + own + rb" import (\([^)]*\)|[^\n]*)|import " + own + rb")")


@cache
def _origin(name: str) -> Path | None:
    """File that a module or package would start with; None of a script, or where there is no source."""
    top, _, rest = name.partition(".")
    if rest:
        start = _origin(top)
        path = None if start is None else start.parent.joinpath(*rest.split("."))
        return path and (path / "__init__.py" if path.is_dir() else path.with_suffix(".py"))
    try:
        found = find_spec(name)
    except ValueError:
        return None
    return None if found is None or found.origin is None else Path(found.origin)
