"""Reading inputs, with errors that name the image, the input and the mend."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from geomosaic.errors import InputError, did_you_mean


def word(options: Mapping[str, Any], name: str, words: Sequence[str], where: str, default: str | None = None) -> str:
    """One of some words."""
    given = options.get(name, default)
    if given not in words:
        said = f"input '{name}' is '{given}'" if name in options else f"input '{name}' is missing"
        raise InputError(said, where=where, mend=f"{did_you_mean(str(given), words)} give {' or '.join(words)}".strip())
    return str(given)


def number(options: Mapping[str, Any], name: str, where: str, default: float | None = None) -> float:
    """A finite number."""
    if name not in options and default is not None:
        return default
    return numbers({name: [options[name]]} if name in options else {}, name, 1, where)[0]


def numbers(
    options: Mapping[str, Any], name: str, count: int, where: str, default: Sequence[float] | None = None
) -> list[float]:
    """So many finite numbers."""
    given = options.get(name, default)
    if given is None:
        raise InputError(f"input '{name}' is missing", where=where, mend="see `geomosaic sensors panoramic`")
    good = isinstance(given, Sequence) and not isinstance(given, str) and len(given) == count
    try:
        found = [float(value) for value in given] if good else []
    except (TypeError, ValueError):
        found = []
    if len(found) != count or not all(map(math.isfinite, found)):
        noun = "a number" if count == 1 else f"{count} numbers"
        raise InputError(f"input '{name}' is not {noun}: {given!r}", where=where)
    return found
