"""Accuracy of a product: registration and colour against a reference image; a map against the target of a plan."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.accuracy.check_points import LIMIT, MapCheck, Verdict, check_map
from geomosaic.errors import InputError, did_you_mean
from geomosaic.execution.units import map_units
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import linear_unit
from geomosaic.kernels.warp import OutputScaling, Pixels, sample
from geomosaic.matching.shifts import Shifts, shifts
from geomosaic.options.control import CheckOptions
from geomosaic.options.declaration import compose
from geomosaic.options.render import RunningOptions
from geomosaic.planning.guidelines import position_error
from geomosaic.planning.product_quality import Requirement
from geomosaic.planning.relations import QUANTITIES
from geomosaic.raster.source import Source
from geomosaic.types import AnyArray, BoolArray, FloatArray, PathLike, Progress
from geomosaic.whole_files import path_of

# Bytes of values of one picture that are looked at together, and those that a format without windows may keep.
_STRIP, _HELD = 8 << 20, 64 << 20
_SHIFTS = ("places", "shifts", "correlation")


def against_reference(
    product: Path,
    truth: Path,
    tile: int = 64,
    reach: int = 8,
    running: RunningOptions | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Registration and colour of a product against a reference image of the same ground.

    Parameters
    ----------
    product, truth : Path
        Georeferenced rasters; the product is sampled (bilinear) at the pixel centres of the reference.
    tile, reach : int
        Of the matching, in pixels of the reference.
    running : RunningOptions, optional
        Threads or workers; one thread unless given.
    progress : callable, optional
        Called with (done, total, 'check'); may raise to stop.

    Returns
    -------
    dict
        `registration_rms_px`, `registration_robust_rms_px`, `shift_px` (median col, row), `shift_m`, `tiles`,
        `matched`, `colour_rms` per band, `colour_bias` per band, `pixels` compared.
    """
    found = []
    with Source(truth, memory_limit=_HELD) as ours, Source(product, memory_limit=_HELD) as theirs:
        strips = _Strips(ours, theirs, tile, reach)
        resolution, total = strips.grid.resolution, _Totals(np.zeros(strips.bands), np.zeros(strips.bands))
        for done, (_, (moved, its)) in enumerate(
            map_units(strips, range(strips.count), running or RunningOptions(threads=1)), start=1
        ):
            found.append(moved)
            total.add(its)
            if progress is not None:
                progress(done, strips.count, "check")
    if not total.pixels:
        raise InputError(
            "the product and the reference share no pixel",
            where=str(truth),
            hint="give a reference of the same place, and check the CRS of both",
        )
    moved = Shifts(*(np.concatenate([getattr(one, name) for one in found]) for name in _SHIFTS))
    middle = np.nanmedian(moved.shifts, axis=0) if moved.matched.any() else np.full(2, np.nan)
    return {
        "registration_rms_px": moved.rms,
        "registration_robust_rms_px": moved.robust_rms,
        # Matching gives the reference minus the product; what is told is how far the product lies off.
        "shift_px": [float(v) for v in -middle],
        "shift_m": [float(v) * r for v, r in zip(-middle, resolution, strict=True)],
        "tiles": len(moved.places),
        "matched": int(moved.matched.sum()),
        "colour_rms": [float(v) for v in np.sqrt(total.squares / total.pixels)],
        "colour_bias": [float(v) for v in total.sums / total.pixels],
        "pixels": total.pixels,
    }


@dataclass
class _Totals:
    """Sums and sums of squares over pixels, per band (bands,)."""

    sums: FloatArray
    squares: FloatArray
    pixels: int = 0

    def add(self, other: _Totals) -> None:
        self.sums, self.squares = self.sums + other.sums, self.squares + other.squares
        self.pixels += other.pixels


class _Strips:
    """Comparison of strips of a reference with a product: shifts of their tiles, and totals of colour differences.

    A strip is rows of whole tiles with the margin that matching looks into: the tiles are those of the whole.
    """

    def __init__(self, ours: Source, theirs: Source, tile: int, reach: int) -> None:
        self._ours, self._theirs, self._tile, self._reach = ours, theirs, tile, reach
        self.grid, self._own = _grid(ours), _grid(theirs)
        self.bands = min(ours.info.bands, theirs.info.bands)
        self._margin = reach + 2
        tiles = max(1, (self.grid.height - 2 * self._margin) // tile)
        many = max(1, _STRIP // (self.grid.width * max(ours.info.bands, theirs.info.bands) * 8 * tile))
        self._height, self.count = many * tile, -(-tiles // many)

    def __call__(self, strip: int) -> tuple[Shifts, _Totals]:
        """Shifts and colour differences of one strip, counted from the top."""
        top, last, grid = strip * self._height, strip == self.count - 1, self.grid
        bottom = grid.height if last else top + self._height + 2 * self._margin
        window = Window(0, top, grid.width, bottom - top)
        values, there = _read(self._ours, window)
        sampled, seen = _sampled(self._theirs, self._own, grid.crop(window), Transform(grid.crs, self._own.crs))
        both = there & seen
        moved = _match(sampled[..., : self.bands], values[..., : self.bands], both, self._tile, self._reach)
        # Strips overlap by the margins of matching; each row counts once for the colours.
        new = slice(None) if last else slice(None, self._height)
        off = sampled[new][both[new]][:, : self.bands] - values[new][both[new]][:, : self.bands]
        return replace(moved, places=moved.places + np.array([0.0, top])), _Totals(
            off.sum(axis=0), (off**2).sum(axis=0), len(off)
        )


def _match(first: AnyArray, second: AnyArray, both: BoolArray, tile: int = 64, reach: int = 8) -> Shifts:
    """Shifts of `second` against `first` (rows, cols, bands) in their mean grey, of tiles of pixels that both have."""
    return shifts(first.mean(axis=2), second.mean(axis=2), both, tile, reach)


def _grid(source: Source) -> Grid:
    info = source.info
    if info.crs is None or info.transform is None:
        raise InputError(
            "the raster is not georeferenced",
            where=info.path,
            hint="give it a world file and a CRS, or check an ortho",
        )
    return Grid(horizontal(info.crs), info.transform, info.width, info.height)


def _read(source: Source, window: Window) -> tuple[FloatArray, BoolArray]:
    values, valid = source.read(window)
    seen = np.ones(values.shape[:2], dtype=bool) if valid is None else valid > 0
    return values.astype(np.float64), seen


def _sampled(source: Source, own: Grid, grid: Grid, to_own: Transform) -> tuple[FloatArray, BoolArray]:
    """Bilinear values of a raster, which lies on `own`, at the pixel centres of a grid."""
    info = source.info
    window = own.window_of(_bounds_in(grid, own, to_own)).intersection(own.window)
    if window.empty:
        return np.zeros((*grid.shape, info.bands)), np.zeros(grid.shape, dtype=bool)
    values, valid = source.read(window)
    c, r = np.meshgrid(np.arange(grid.width) + 0.5, np.arange(grid.height) + 0.5)
    xy = to_own(grid.xy(np.column_stack([c.ravel(), r.ravel()])))
    place = own.colrow(xy) - (window.col, window.row)
    out = np.zeros((*grid.shape, info.bands))
    seen = np.zeros(grid.shape, dtype=np.uint8)
    cols, rows = place[:, 0].reshape(grid.shape), place[:, 1].reshape(grid.shape)
    pixels = Pixels(values, valid, 0, 0, 1, (window.width, window.height))
    unchanged = OutputScaling(np.ones(info.bands), np.zeros(info.bands), -np.inf, np.inf, False)
    sample(cols, rows, pixels, "bilinear", unchanged, out, seen)
    return out, seen > 0


def _bounds_in(grid: Grid, own: Grid, to_own: Transform) -> tuple[float, float, float, float]:
    # Corners alone would miss the bulge of edges that are curved in the other CRS.
    edge = np.linspace(0, 1, 9)
    c, r = np.meshgrid(edge * grid.width, edge * grid.height)
    xy = to_own(grid.xy(np.column_stack([c.ravel(), r.ravel()])))
    pad = 2 * max(own.resolution)
    (left, bottom), (right, top) = np.nanmin(xy, axis=0) - pad, np.nanmax(xy, axis=0) + pad
    return float(left), float(bottom), float(right), float(top)


# What a finished map and its check points show; the rest of a plan concerns photos, scans and heights.
SEEN = ("position_error", "ortho_pixel", "control_error")
# Relative excess that rounding may cause: a pixel of 0.5 m holds a target of 0.5 m.
EVEN = 1e-9


def read_target(path: Path) -> tuple[Requirement, ...]:
    """Requirements from the JSON of `geomosaic plan product --json`, or a TOML file of largest values by name.

    Parameters
    ----------
    path : Path
        Suffix .json for a plan; any other is read as TOML, values in metres.

    Returns
    -------
    tuple of Requirement
        All that the file holds, also those that a finished map does not show.

    Raises
    ------
    InputError
        The file is no plan, or holds nothing that a finished map shows.
    """
    try:
        text = path.read_text(encoding="utf-8")
        found = _plan(json.loads(text)) if path.suffix.lower() == ".json" else _table(tomllib.loads(text))
    except FileNotFoundError:
        raise InputError("the target does not exist", where=str(path), hint=_MEND) from None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"the target cannot be read ({error})", where=str(path), hint=_MEND) from error
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InputError(
            "this is no plan of a product, or a limit is no number", where=str(path), hint=_MEND
        ) from error
    if not any(requirement.name in SEEN for requirement in found):
        raise InputError(
            "the target has no quantity that can be checked on a finished map",
            where=str(path),
            hint=f"give {', '.join(SEEN)}",
        )
    return found


_MEND = (
    "write it by `geomosaic plan product ... --json > plan.json`, or as TOML with position_error, ortho_pixel and "
    "control_error in metres"
)


def _plan(data: Any) -> tuple[Requirement, ...]:
    made = (
        Requirement(
            str(r["name"]),
            _text(str(r["name"])),
            _limit(r["least"]),
            _limit(r["most"]),
            str(r["unit"]),
            str(r["source"]),
        )
        for r in data["requirements"]
    )
    return tuple(made)


def _limit(value: Any) -> float | None:
    """A limit of a requirement; None where it is open."""
    if value is None:
        return None
    if isinstance(value, bool) or not 0 <= float(value) < math.inf:
        raise ValueError(value)
    return float(value)


def _table(data: Mapping[str, Any]) -> tuple[Requirement, ...]:
    for name in data:
        if name not in SEEN:
            raise InputError(f"a target has no '{name}'", hint=did_you_mean(name, SEEN) or f"it has {', '.join(SEEN)}")
    return tuple(Requirement(name, _text(name), None, _limit(value), "m", "target") for name, value in data.items())


def _text(name: str) -> str:
    own = {"position_error": "error of position at check points", "control_error": "error of the check points' survey"}
    return own.get(name) or (QUANTITIES[name].text if name in QUANTITIES else name.replace("_", " "))


def _judge(found: MapCheck, target: tuple[Requirement, ...]) -> tuple[Verdict, ...]:
    """Verdicts on all requirements of a target that a finished map shows; `survey_rms` is judged where it was given."""
    crs = found.grid.crs
    if not crs.is_projected:
        raise InputError("a map in degrees has no pixel in metres", where="`target`", hint="reproject the raster first")
    # Targets are in metres; errors and pixels of the map may be in feet.
    metres = linear_unit(crs)
    values = {
        "position_error": found.statistics.rms_total * metres,
        "ortho_pixel": max(found.grid.resolution) * metres,
        "control_error": found.statistics.survey_rms * metres,
    }
    out = []
    for requirement in target:
        # A survey error of 0 stands for one that was not given: it is not judged.
        known = requirement.name in SEEN and (requirement.name != "control_error" or found.statistics.survey_rms > 0)
        if known:
            value = values[requirement.name]
            enough = requirement.least is None or value >= requirement.least * (1 - EVEN)
            passed = enough and (requirement.most is None or value <= requirement.most * (1 + EVEN))
            out.append(Verdict(requirement, value, passed))
    return tuple(out)


def check(raster: PathLike, points: PathLike, *, insist: bool = False, **options: Any) -> MapCheck:
    """Accuracy of a georeferenced raster at points whose places are known, and whether it keeps the limits given.

    Parameters
    ----------
    raster : path
    points : path
        True x and y, and where the raster has them: col and row, or measured_x and measured_y in its CRS. Any file of
        control will do; where some points have the role 'check', only those count.
    insist : bool
        Go on where coordinates look wrong.
    **options
        Of `CheckOptions`: `crs` of the true places, `pixels`, `rows`, `without`, `raster_crs`, `survey_rms`; the limits
        `max_rms` (pixels), `max_rms_map`, `map_scale` and `target`.

    Returns
    -------
    MapCheck
        `passed` says whether all limits are kept, `verdicts` each of them.

    Raises
    ------
    InputError
        The raster is not georeferenced, a file is wrong, or coordinates do not fit their CRS.
    """
    wanted = compose(CheckOptions, options)
    found = check_map(path_of(raster, "raster"), path_of(points, "points"), wanted, insist=insist)
    crs, rms, unit = found.grid.crs, found.statistics.rms_total, found.statistics.unit
    limits = [("px", found.pixel_rms_total, wanted.max_rms), (unit, rms, wanted.max_rms_map)]
    if wanted.map_scale is not None:
        if not crs.is_projected:
            hint = "reproject the raster first, or use `max_rms`"
            raise InputError("a map in degrees has no scale", where="`map_scale`", hint=hint)
        limits.append(("m", rms * linear_unit(crs), position_error(wanted.map_scale)))
    verdicts = [
        Verdict(Requirement("rms_total", "total RMS", None, limit, unit, LIMIT), value, value <= limit)
        for unit, value, limit in limits
        if limit is not None
    ]
    target = _judge(found, read_target(wanted.target)) if wanted.target is not None else ()
    return replace(found, verdicts=(*verdicts, *target))
