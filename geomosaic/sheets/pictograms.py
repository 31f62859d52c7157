"""Pictorial symbols: the own set, and SVG files of the user."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType

from geomosaic.errors import InputError, did_you_mean
from geomosaic.sheets.svg import PaintedOutline, read_svg
from geomosaic.whole_files import read_text

# Symbols of the own set by group, each the name of a file in the folder `symbols`.
GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType({
    "survey": (
        "trig-point", "benchmark", "control-point", "check-point", "traverse-point", "gnss-point", "target",
        "boundary-stone",
    ),
    "hydrography": ("spring", "well", "waterfall", "water-tower", "gauge", "lock", "lighthouse", "harbour"),
    "settlement": (
        "house", "church", "mosque", "synagogue", "temple", "school", "hospital", "cemetery", "castle", "ruin",
        "monument", "factory",
    ),
    "landmark": ("windmill", "tower", "mast", "mine", "cave", "tree"),
    "along lines": ("bar", "half-bar", "saltire", "arrowhead", "tooth", "bead"),
})  # fmt: skip
PICTOGRAMS = tuple(name for names in GROUPS.values() for name in names)
# Bytes of the largest file that is taken for a symbol.
_LARGEST = 1 << 20


def is_file(shape: str) -> bool:
    """Whether a symbol is a file of the user.

    Parameters
    ----------
    shape : str
    """
    return shape.lower().endswith(".svg")


def pictogram(shape: str) -> tuple[PaintedOutline, ...]:
    """Outlines of a symbol, the lowest first.

    Parameters
    ----------
    shape : str
        Name of the own set, or path of an SVG file.

    Raises
    ------
    InputError
        No such symbol, or a file that cannot be read.
    """
    if is_file(shape):
        return read_svg(read_text(Path(shape), "symbol", _LARGEST), shape)
    if shape not in PICTOGRAMS:
        hint = did_you_mean(shape, PICTOGRAMS)
        raise InputError(f"there is no symbol '{shape}'", hint=hint or f"one of {', '.join(PICTOGRAMS)}")
    return _own(shape)


@lru_cache(maxsize=len(PICTOGRAMS))
def _own(name: str) -> tuple[PaintedOutline, ...]:
    return read_svg((files("geomosaic.sheets") / "symbols" / f"{name}.svg").read_text("utf-8"), f"{name}.svg")
