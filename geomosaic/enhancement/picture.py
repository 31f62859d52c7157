"""Enhancement of a raster for print: stretch, local contrast, hillshade and sharpening of its pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.enhancement.contrast import (
    Clahe,
    equalised,
    hillshade,
    linear,
    luminance,
    percentile_limits,
    shaded,
    sharpened,
    with_luminance,
)
from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Bounds, Grid, Window
from geomosaic.geo.transform import Transform
from geomosaic.options.declaration import option
from geomosaic.options.sheet import StretchOptions
from geomosaic.raster.pictures import Curves, read_bands
from geomosaic.raster.source import Source
from geomosaic.surface.dem import Dem
from geomosaic.types import AnyArray, ByteArray, FloatArray


@dataclass(frozen=True)
class EnhancePart:
    """`[enhance]`: enhancement of the raster for print; the defaults change nothing."""

    bands: tuple[int, ...] = ()  # of red, green, blue, or one; from 1
    stretch: str = option(
        "none",
        choices=("none", "percentile", "linear", "equalise"),
    )
    low: float = option(2.0, least=0.0, most=100.0)  # percentiles
    high: float = option(98.0, least=0.0, most=100.0)
    limits: tuple[float, float] | None = None  # of 'linear', values
    gamma: float = option(1.0, above=0.0, most=10.0)
    clahe: float = option(0.0, least=0.0, most=100.0)  # clip limit; 0 for none
    sharpen: float = option(0.0, least=0.0, most=10.0)  # amount; 0 for none
    radius: float = option(0.15, above=0.0, most=5.0, needs=("sharpen",))  # of sharpening, mm on paper
    hillshade: float = option(0.0, least=0.0, most=1.0)  # strength; 0 for none
    dem: str = ""  # of the hillshade; that of the contours where empty
    azimuth: float = option(315.0, least=0.0, most=360.0)
    altitude: float = option(45.0, above=0.0, most=90.0)


# Strength of a hillshade that is asked for without one.
HILLSHADE = 0.6
# Pixels along the longer side of the reduced raster that statistics are taken of: the same for all its sheets.
SAMPLE = 1000

# Function from pixels (rows, cols, 4) and their area to enhanced pixels.
Finish = Callable[[ByteArray, Bounds], ByteArray]


def enhance_keys(look: StretchOptions) -> dict[str, Any]:
    """Keys of `EnhancePart` from options, None where not given; the hillshade is left to the caller.

    Parameters
    ----------
    look : StretchOptions, limits or percentiles alone name the stretch

    Raises
    ------
    InputError
        Limits or percentiles do not belong to the stretch, or are the wrong way round.
    """
    stretch, limits, percentiles = look.stretch, look.limits, look.percentiles
    if limits is not None and percentiles is not None:
        raise InputError("`limits` are values and `percentiles` shares of them", hint="leave one of them out")
    for name, pair, kind in (("limits", limits, "linear"), ("percentiles", percentiles, "percentile")):
        if pair is not None and stretch not in (None, kind):
            raise InputError(
                f"`{name}` belongs to `stretch={kind}`", where=f"`stretch={stretch}`", hint="leave one out"
            )
        if pair is not None and not pair[0] < pair[1]:
            raise InputError(
                f"`{name}` {pair[0]:g} {pair[1]:g} is the wrong way round", hint="give the lower one first"
            )
    low, high = percentiles or (None, None)
    own = None if limits is None and percentiles is None else "linear" if limits else "percentile"
    return {
        "bands": look.bands, "stretch": stretch or own, "limits": limits, "low": low, "high": high,
        "gamma": look.gamma, "clahe": look.clahe, "sharpen": look.sharpen,
    }  # fmt: skip


def shown_bands(part: EnhancePart, count: int, where: str) -> tuple[int, ...]:
    """Numbers of the bands that are shown, from 1.

    Parameters
    ----------
    part : EnhancePart
    count : int, bands of the raster
    where : str, named in errors

    Raises
    ------
    InputError
        They are not one or three of the raster's.
    """
    bands = part.bands or ((1, 2, 3) if count >= 3 else (1,))
    if len(bands) not in (1, 3) or any(not 1 <= band <= count for band in bands):
        raise InputError(
            f"bands {', '.join(map(str, bands))} cannot be shown: the raster has {count}",
            where=where,
            hint="give three of them for red, green and blue, or one for grey",
        )
    return bands


def sample(source: Source, grid: Grid, bands: Sequence[int]) -> tuple[AnyArray, AnyArray]:
    """Reduced raster for statistics: values (rows, cols, bands) and validity (rows, cols).

    Parameters
    ----------
    source : Source
    grid : Grid, of the source
    bands : sequence of int, from 1
    """
    factor = max(1, -(-max(grid.width, grid.height) // SAMPLE))
    size = (-(-grid.width // factor) * factor, -(-grid.height // factor) * factor)
    return read_bands(source, grid, Window(0, 0, *size), factor, bands)


def band_curves(part: EnhancePart, source: Source, grid: Grid, bands: Sequence[int]) -> Curves:
    """Curves of the stretch from the whole raster; none for 8 bits where nothing is asked for.

    Parameters
    ----------
    part : EnhancePart
    source : Source
    grid : Grid, of the source
    bands : sequence of int, from 1
    """
    whole = source.dtype == np.uint8
    if whole and part.stretch == "none" and part.gamma == 1.0:
        return ()
    if part.stretch == "linear" or (part.stretch == "none" and whole):
        low, high = part.limits or (0.0, 255.0)
        if part.stretch == "linear" and part.limits is None and not whole:
            raise InputError(
                "a linear stretch needs its limits",
                where="stretch",
                hint="give `limits`, the lowest and the highest value",
            )
        return [linear(low, high, part.gamma)] * len(bands)
    values, valid = sample(source, grid, bands)
    if part.stretch == "none":
        # The same for all bands: colours stay, and the sheets of a series fit each other.
        return [linear(*percentile_limits(values[valid > 0], 2.0, 98.0), part.gamma)] * len(bands)
    seen = [values[..., k][valid > 0] for k in range(len(bands))]
    if part.stretch == "equalise":
        curves = [equalised(band) for band in seen]
        bent = linear(0.0, 255.0, part.gamma)
        return [_after(curve, bent) for curve in curves]
    return [linear(*percentile_limits(band, part.low, part.high), part.gamma) for band in seen]


def _after(first: Callable[[AnyArray], AnyArray], second: Callable[[AnyArray], AnyArray]) -> Callable[..., AnyArray]:
    return lambda values: second(first(values))


def local_equalisation(
    part: EnhancePart, source: Source, grid: Grid, bands: Sequence[int], curves: Curves
) -> Clahe | None:
    """CLAHE of the whole raster, None where it is not asked for.

    Parameters
    ----------
    part : EnhancePart
    source : Source
    grid : Grid, of the source
    bands : sequence of int, one or three, from 1
    curves : sequence of callable, of the stretch
    """
    if not part.clahe:
        return None
    values, valid = sample(source, grid, bands)
    level = np.dstack([curves[k](values[..., k]) if curves else values[..., k] for k in range(len(bands))])
    grey = luminance(level) if len(bands) == 3 else level[..., 0]
    return Clahe.of(grey, valid.astype(np.uint8), part.clahe)


def finishing(
    part: EnhancePart,
    clahe: Clahe | None,
    grid: Grid,
    *,
    dpi: float,
    metres: float,
    dem: Path | None,
    dem_heights: str | None,
) -> Finish:
    """Function that applies local contrast, hillshade and sharpening, in this order.

    Parameters
    ----------
    part : EnhancePart
    clahe : Clahe, optional
        Of `local_equalisation`.
    grid : Grid
        Of the raster.
    dpi : float
        Pixels per inch on paper.
    metres : float
        In a unit of the map.
    dem : Path, optional
        Of the hillshade.
    dem_heights : str, optional
        Its vertical datum, where the file does not say it.
    """
    if part.hillshade > 0 and dem is None:
        raise InputError("a hillshade needs heights", where="[enhance]", hint='give dem = "..." or `hillshade`')

    def finish(pixels: ByteArray, area: Bounds) -> ByteArray:
        out = pixels.copy()
        valid = (pixels[..., 3] > 0).astype(np.uint8)
        rows, cols = pixels.shape[:2]
        x = area[0] + (np.arange(cols) + 0.5) / cols * (area[2] - area[0])
        y = area[3] - (np.arange(rows) + 0.5) / rows * (area[3] - area[1])
        if clahe is not None:
            left, bottom, right, top = grid.bounds
            light = luminance(out)
            made = with_luminance(out, light, clahe(light, (top - y) / (top - bottom), (x - left) / (right - left)))
            out[..., :3] = np.where(valid[..., None] > 0, made, out[..., :3])
        if part.hillshade > 0 and dem is not None:
            step = ((area[2] - area[0]) / cols * metres, (area[3] - area[1]) / rows * metres)
            shade = hillshade(heights_at(dem, dem_heights, grid.crs, x, y), step, part.azimuth, part.altitude)
            made = shaded(out, shade, float(np.sin(np.radians(part.altitude))), part.hillshade)
            out[..., :3] = np.where(valid[..., None] > 0, made, out[..., :3])
        if part.sharpen > 0:
            out[..., :3] = sharpened(out[..., :3], valid, part.radius / 25.4 * dpi, part.sharpen)
        return out

    return finish


def heights_at(path: Path, heights: str | None, crs: CRS, x: FloatArray, y: FloatArray) -> FloatArray:
    """Heights (rows, cols) of a DEM at pixels in columns x and rows y of a map, row by row; NaN where unknown.

    Parameters
    ----------
    path : Path, DEM
    heights : str or None, its vertical datum, where the file does not say it
    crs : CRS, of the map
    x, y : array (cols,), (rows,), map units
    """
    # Heights that declare no vertical datum are taken as they are: for the slopes of a hillshade none is needed.
    try:
        opened = Dem.open(path, heights=heights)
    except HeightDatumError:
        opened = Dem.open(path, heights="ellipsoidal")
    with closing(opened) as dem:
        move = Transform(crs, horizontal(dem.crs))
        return np.array([dem.height(move(np.column_stack([x, np.full_like(x, row)]))) for row in y])
