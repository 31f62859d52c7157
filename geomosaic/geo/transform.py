"""Datum operations between two CRS, and point transforms that fail loudly instead of shifting heights in silence."""

from __future__ import annotations

import math
import re
import threading
import warnings
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from pyproj import CRS, Transformer
from pyproj.enums import TransformDirection
from pyproj.exceptions import ProjError
from pyproj.transformer import TransformerGroup

from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import has_heights, height_name, horizontal, is_local, same_local
from geomosaic.types import FloatArray

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

    def text(self) -> str:
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


def crs_defect(crs: CRS) -> str | None:
    """Defect of a CRS read from a file: a name that contradicts its keys, or an unknown datum.

    Parameters
    ----------
    crs : CRS
        As the file has it.

    Returns
    -------
    str or None
        One sentence with a hint; None where nothing is suspicious.
    """
    named = re.search(r"EPSG:+(\d{4,6})", crs.name, re.IGNORECASE)
    unknown = any(word in _datum(crs).lower() for word in ("unknown", "unnamed"))
    if named and (unknown or crs.to_epsg() != int(named.group(1))):
        return (
            f"the file calls its CRS '{crs.name}', but its keys do not define EPSG:{named.group(1)} "
            f"(datum: {_datum(crs)}); if that is what is meant, give `src_crs=EPSG:{named.group(1)}`"
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


@dataclass(frozen=True)
class Transform:
    """Points of one CRS to another, x east before y north, ballpark operations refused.

    Where either end has no heights, only x and y are transformed and z passes through.

    Parameters
    ----------
    source, target : CRS
        2-D or 3-D.

    Attributes
    ----------
    spatial : bool
        Whether heights take part.
    """

    source: CRS
    target: CRS
    spatial: bool = field(init=False, repr=False, compare=False)
    _operation: _Operation | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "spatial", has_heights(self.source) and has_heights(self.target))
        # Made here so that it fails when made, not at the first point.
        object.__setattr__(self, "_operation", self._find())

    def _find(self) -> _Operation | None:
        if self.spatial:
            return _operation(_key(self.source), _key(self.target))
        if self.source.is_geocentric or self.target.is_geocentric:
            flat = self.target if self.source.is_geocentric else self.source
            raise HeightDatumError(
                f"the heights of '{flat.name}' have no vertical datum, so they cannot meet an Earth-centred model",
                hint="declare the heights: 'ellipsoidal', 'egm96', a vertical EPSG code or a geoid grid",
            )
        return _operation(_key(horizontal(self.source)), _key(horizontal(self.target)))

    @property
    def identical(self) -> bool:
        """Whether points stay as they are."""
        return self._operation is None

    def __call__(self, xyz: FloatArray) -> FloatArray:
        """Transform points.

        Parameters
        ----------
        xyz : array (N, 3) or (N, 2)
            In `source`; metres or degrees as the CRS has it.

        Returns
        -------
        array of the same shape
            In `target`; NaN where a point cannot be transformed.
        """
        points = np.asarray(xyz, dtype=np.float64)
        operation = self._operation
        if operation is None or not len(points):
            return points.copy()
        out = np.array(points, dtype=np.float64)
        if self.spatial and points.shape[1] == 3:
            out[:, 0], out[:, 1], out[:, 2] = operation(points[:, 0], points[:, 1], points[:, 2])
        else:
            out[:, 0], out[:, 1] = operation(points[:, 0], points[:, 1])
        out[~np.isfinite(out).all(axis=1)] = np.nan
        return out

    def inverse(self) -> Transform:
        """Transform from target to source."""
        return Transform(self.target, self.source)


@dataclass(frozen=True, eq=False)
class _Operation:
    """A PROJ operation, forwards or backwards."""

    transformer: Transformer
    backwards: bool

    def __call__(self, *columns: FloatArray) -> Any:
        direction = TransformDirection.INVERSE if self.backwards else TransformDirection.FORWARD
        apply: Any = self.transformer.transform
        return apply(*columns, direction=direction)


_lock = threading.RLock()
_equals: list[tuple[CRS, str]] = []
_made: dict[tuple[str, str], _Operation | None] = {}


@lru_cache(maxsize=256)
def _key(crs: CRS) -> str:
    """WKT of the first CRS met that means the same; making an operation takes long enough to do it once for all."""
    wkt = str(crs.to_wkt())
    if "BOUNDCRS" in wkt:  # what it is bound by is not compared
        return wkt
    with _lock:
        for other, found in _equals:
            if len(other.axis_info) == len(crs.axis_info) and _same(crs, other):
                return found
        _equals.append((crs, wkt))
    return wkt


def _same(one: CRS, other: CRS) -> bool:
    """Whether two CRS mean the same, in whatever order of axes."""
    # PROJ does not compare names, and from GeoTIFF local frames differ in nothing else.
    if is_local(one) or is_local(other):
        return same_local(one, other)
    return bool(one.equals(other, ignore_axis_order=True))


def _operation(source_wkt: str, target_wkt: str) -> _Operation | None:
    """PROJ operation between a pair of CRS, made once; None is the identity."""
    if source_wkt == target_wkt:
        return None
    with _lock:
        pair = source_wkt, target_wkt
        if pair not in _made:
            # Built the same way round whichever is asked for first: a way back differs from a way forth in its last
            # digits, and results must not depend on what else the process did before.
            first, second = sorted(pair)
            transformer = _transformer(first, second, as_given=pair)
            _made[first, second] = _Operation(transformer, backwards=False)
            # Where PROJ has several operations, by area, it may choose another one for the way back.
            single = transformer.description != "unavailable until proj_trans is called"
            back = transformer if single else _transformer(second, first, as_given=pair)
            _made[second, first] = _Operation(back, backwards=single)
        return _made[pair]


def _transformer(source_wkt: str, target_wkt: str, as_given: tuple[str, str]) -> Transformer:
    """PROJ's operation; errors name the CRS in the order in which they were asked for."""
    source, target = CRS.from_wkt(source_wkt), CRS.from_wkt(target_wkt)
    # On one datum the way is a conversion: nothing is to be looked up in the registry, which takes PROJ 20 ms.
    registry = "none" if _on_one_datum(source, target) else None
    try:
        # A ballpark operation would leave out a shift of datum or geoid without a word.
        return Transformer.from_crs(source, target, always_xy=True, allow_ballpark=False, authority=registry)
    except ProjError as error:
        raise _no_operation(*map(CRS.from_wkt, as_given)) from error


def _on_one_datum(source: CRS, target: CRS) -> bool:
    if any(crs.is_compound or crs.is_bound for crs in (source, target)):
        return False
    return source.datum is not None and bool(source.datum.is_exact_same(target.datum))  # == takes PROJ 40 ms


_GET_GRID = (
    "put the grid (https://cdn.proj.org has it) in a folder, under this or its former name, and name the folder in the "
    "environment variable PROJ_DATA"
)


def _no_operation(source: CRS, target: CRS) -> InputError:
    """Name the grid that is missing, when one is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it would warn of the very grid that the error names
        group = TransformerGroup(source, target, always_xy=True, allow_ballpark=False)
    grids = sorted({grid.short_name for op in group.unavailable_operations for grid in op.grids if not grid.available})
    what = (
        f"no trustworthy transformation from '{source.name}' (heights: {height_name(source)}) "
        f"to '{target.name}' (heights: {height_name(target)})"
    )
    if grids and not (has_heights(source) or has_heights(target)):
        return InputError(
            f"{what}: the grid for the shift of datum, {' or '.join(grids)}, is not installed",
            hint=_GET_GRID,
        )
    if grids:
        return HeightDatumError(
            f"{what}: grid {' or '.join(grids)} is not installed",
            hint="give the path of that geoid grid as the vertical datum, or name another where that is true",
        )
    if is_local(source) or is_local(target):
        hint = "nothing relates a local frame to other CRS: give all inputs in it, with the same vertical datum or none"
        return InputError(what, hint=hint)
    return InputError(what, hint="check both coordinate reference systems, or give a geoid grid file")
