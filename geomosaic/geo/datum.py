"""Datum operations between two CRS: what PROJ does, how accurate it is, and what would be better."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from functools import lru_cache

from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError
from pyproj.transformer import TransformerGroup

_NONE = "no operation"


@dataclass(frozen=True)
class Operation:
    """Datum operation used between two CRS, with its accuracy and what a better one needs.

    Attributes
    ----------
    name : str
        PROJ's description.
    accuracy : float
        Metres, as the registry has it; NaN where it says nothing.
    missing : tuple of str
        Grids of a better operation that are not installed.
    better : float
        Its accuracy in metres; NaN where it is not known or there is none.
    """

    name: str
    accuracy: float
    missing: tuple[str, ...] = ()
    better: float = math.nan

    @property
    def possible(self) -> bool:
        """Whether there is an operation at all."""
        return self.name != _NONE

    def words(self) -> str:
        """Description in one line: name, accuracy, and what a better operation needs."""
        known = f", good to {self.accuracy:g} m" if math.isfinite(self.accuracy) else ", accuracy not known"
        text = f"{self.name}{known}"
        if self.missing:
            how = f" (good to {self.better:g} m)" if math.isfinite(self.better) else ""
            text += (
                f"; a better one{how} needs the grid {', '.join(self.missing)}, which is not installed: put it in a "
                "folder that the environment variable PROJ_DATA names"
            )
        return text


@lru_cache(maxsize=32)
def operation_between(source: CRS, target: CRS) -> Operation:
    """Operation that `Transform` takes between two CRS, x and y only.

    Where PROJ has several by area, that is the one it holds best for most of their common area.

    Parameters
    ----------
    source, target : CRS
        Two-dimensional.

    Returns
    -------
    Operation
        Not `possible` where PROJ knows none.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of missing grids, which the result names
        group = TransformerGroup(source, target, always_xy=True, allow_ballpark=False)
    used = group.transformers[0] if group.transformers else _by_another_datum(source, target)
    if used is None:
        return Operation(_NONE, math.nan)
    accuracy = _accuracy(used.accuracy)
    if group.best_available or not group.unavailable_operations:
        return Operation(_short(used.description), accuracy)
    best = group.unavailable_operations[0]
    grids = tuple(sorted({grid.short_name for grid in best.grids if not grid.available}))
    better = _accuracy(best.accuracy)
    if math.isfinite(better) and math.isfinite(accuracy) and better >= accuracy:
        return Operation(_short(used.description), accuracy)
    return Operation(_short(used.description), accuracy, grids, better)


def _by_another_datum(source: CRS, target: CRS) -> Transformer | None:
    """Operation that `Transform` takes where direct operations lack their grids: PROJ goes through a third datum."""
    try:
        return Transformer.from_crs(source, target, always_xy=True, allow_ballpark=False)
    except ProjError:
        return None


def doubt(crs: CRS) -> str | None:
    """Reason to doubt a CRS read from a file: a name that contradicts its keys, or an unknown datum.

    Parameters
    ----------
    crs : CRS
        As the file has it.

    Returns
    -------
    str or None
        One sentence with a hint; None where nothing is suspicious.
    """
    said = re.search(r"EPSG:+(\d{4,6})", crs.name, re.IGNORECASE)
    unknown = any(word in _datum(crs).lower() for word in ("unknown", "unnamed"))
    if said and (unknown or crs.to_epsg() != int(said.group(1))):
        return (
            f"the file calls its CRS '{crs.name}', but its keys do not define EPSG:{said.group(1)} "
            f"(datum: {_datum(crs)}); if that is what is meant, give `src_crs=EPSG:{said.group(1)}`"
        )
    if unknown:
        return f"the datum of '{crs.name}' is not known, which may hide shifts of hundreds of metres; give `src_crs`"
    return None


def _datum(crs: CRS) -> str:
    return str(crs.datum.name) if crs.datum is not None else "unknown"


def _accuracy(value: float | None) -> float:
    return math.nan if value is None or value < 0 else float(value)


def _short(description: str) -> str:
    return description.replace("axis order change (2D) + ", "").replace(" + axis order change (2D)", "")
