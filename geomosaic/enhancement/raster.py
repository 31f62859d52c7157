"""Rasters enhanced for print, and rasters pan-sharpened: coarser bands with the detail of a panchromatic one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.enhancement.contrast import hillshade as shade_of_slope
from geomosaic.enhancement.contrast import luminance, shaded, sharpened, with_luminance
from geomosaic.enhancement.picture import (
    HILLSHADE,
    EnhancePart,
    band_curves,
    enhance_keys,
    heights_at,
    local_equalisation,
    shown_bands,
)
from geomosaic.errors import InputError, counted
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.units import linear_unit
from geomosaic.options.declaration import compose
from geomosaic.options.sheet import PAN_METHODS, EnhanceOptions
from geomosaic.raster.cog.codec import Samples
from geomosaic.raster.files import check_output, check_output_size
from geomosaic.raster.pictures import raster_grid, read_bands
from geomosaic.raster.sink import RasterProduct, RasterSink
from geomosaic.raster.source import Source
from geomosaic.resample.warp import value_range
from geomosaic.stores.path import given_path
from geomosaic.types import AnyArray, FloatArray, PathLike


@dataclass(frozen=True, eq=False)
class PanModel:
    """Linear model of the pan band from the others: pan = Σ weights · bands + offset; and gains of its detail.

    Attributes
    ----------
    method : str
    weights, gains : array (bands,)
    offset : float
    r2 : float, share of the variance of the (reduced) pan band that the bands explain
    """

    method: str
    weights: FloatArray
    offset: float
    gains: FloatArray
    r2: float


def pan_model(method: str, bands: AnyArray, pan: AnyArray) -> PanModel:
    """Pan model from samples at the resolution of the bands.

    'regression': weights by least squares, gains cov(band, synthetic) / var(synthetic) (Gram-Schmidt adaptive: Aiazzi,
    Baronti and Selva, IEEE TGRS 45(10), 2007). 'weighted': the same weights, the detail added to all bands alike.
    'brovey': bands · pan / synthetic, with the same weights (Gillespie and others, 1987, has equal ones).

    Parameters
    ----------
    method : str
    bands : array (N, bands)
    pan : array (N,)
        Means of the pan band over the same pixels.

    Raises
    ------
    InputError
        Unknown method, or too few or constant samples.
    """
    if method not in PAN_METHODS:
        raise InputError(f"there is no method '{method}'", where="`method`", hint=f"one of {', '.join(PAN_METHODS)}")
    x, y = bands.astype(np.float64), pan.astype(np.float64)
    if len(x) < 10 * (x.shape[1] + 1) or np.ptp(y) == 0:
        raise InputError("the bands and the pan band share too little ground", hint="do both show the same area?")
    mean = x.mean(axis=0)
    weights = np.linalg.lstsq(x - mean, y - y.mean(), rcond=None)[0]
    offset = float(y.mean() - mean @ weights)
    synthetic = x @ weights + offset
    spread = synthetic.var()
    gains = np.array([np.mean((x[:, k] - mean[k]) * (synthetic - synthetic.mean())) for k in range(x.shape[1])])
    # The gains of Gram-Schmidt adaptive; 1 for the others, which add or multiply the detail alike in all bands.
    gains = gains / spread if method == "regression" else np.ones(x.shape[1])
    r2 = 1.0 - float(np.var(y - synthetic) / np.var(y))
    return PanModel(method, weights, offset, gains, r2)


def pan_sharpened(model: PanModel, bands: AnyArray, pan: AnyArray) -> FloatArray:
    """Pan-sharpened bands (rows, cols, bands) from bands and pan (rows, cols), both on the pixels of the pan band.

    Parameters
    ----------
    model : PanModel
    bands : array (rows, cols, bands)
    pan : array (rows, cols)
    """
    x, y = bands.astype(np.float64), pan.astype(np.float64)
    synthetic = x @ model.weights + model.offset
    if model.method == "brovey":
        ratio = y / np.where(np.abs(synthetic) > 1e-9, synthetic, 1.0)
        return x * np.where(np.abs(synthetic) > 1e-9, ratio, 1.0)[..., None]
    return x + model.gains * (y - synthetic)[..., None]


def magnified(values: AnyArray, rows: FloatArray, cols: FloatArray) -> FloatArray:
    """Cubic convolution (a = -0.5) of bands (R, C, bands) at rows and columns of a grid along their axes.

    Parameters
    ----------
    values : array (R, C, bands)
    rows, cols : array (P,), array (Q,)
        Image coordinates: 0.5 is the centre of the first pixel. Beyond the edge the last pixel goes on.

    Returns
    -------
    array (P, Q, bands)
    """
    picked = _along(values.astype(np.float64), rows, 0)
    return _along(picked, cols, 1)


def _along(values: FloatArray, places: FloatArray, axis: int) -> FloatArray:
    first = np.floor(places - 0.5).astype(int)
    t = places - 0.5 - first
    # Keys, 1981, with a = -0.5.
    weights = (
        -0.5 * t**3 + t**2 - 0.5 * t, 1.5 * t**3 - 2.5 * t**2 + 1.0,
        -1.5 * t**3 + 2.0 * t**2 + 0.5 * t, 0.5 * t**3 - 0.5 * t**2,
    )  # fmt: skip
    shape = [1] * values.ndim
    shape[axis] = len(places)
    total = np.zeros(())
    for k, weight in enumerate(weights):
        index = np.clip(first + k - 1, 0, values.shape[axis] - 1)
        total = total + np.take(values, index, axis=axis) * weight.reshape(shape)
    return total


TILE = (2048, 512)


@dataclass(frozen=True, repr=False)
class EnhancedRaster(RasterProduct):
    """Enhanced 8-bit raster for print."""

    path: Path
    grid: Grid


@dataclass(frozen=True, repr=False)
class PanSharpened(RasterProduct):
    """Pan-sharpened raster, with the model of the panchromatic band."""

    path: Path
    grid: Grid
    model: PanModel


def enhance(
    raster: PathLike,
    output: PathLike,
    *,
    driver: str = "COG",
    overwrite: bool = False,
    max_output: int | None = None,
    **options: Any,
) -> EnhancedRaster:
    """8-bit picture of a raster for print: stretched, its local contrast evened, shaded and sharpened, in this order.

    Parameters
    ----------
    raster, output : path
    driver : str
        'COG' or 'GTiff'.
    overwrite : bool
        Replace an existing file.
    max_output : int, optional
        Bytes; see `geomosaic.raster.files.check_output_size`.
    **options
        Fields of `EnhanceOptions`: `bands` (the first three or the first one unless given), `stretch`, `limits` or
        `percentiles`, `gamma`, `clahe`, `sharpen` with its `radius` in pixels (1 unless given), and `hillshade`, a DEM.

    Raises
    ------
    InputError, OutputExistsError, OutputError
    """
    raster, output = given_path(raster), given_path(output)
    chosen = compose(EnhanceOptions, options)
    hillshade, sharpen = chosen.hillshade, chosen.sharpen
    radius = chosen.radius or 1.0
    check_output(output, overwrite=overwrite, inputs=(raster, *filter(None, [hillshade])), geotiff=True)
    with Source(raster) as source:
        grid = raster_grid(source, str(raster))
        given = {key: value for key, value in enhance_keys(chosen).items() if value is not None}
        look = EnhancePart(**{"stretch": "none" if source.dtype == np.uint8 else "percentile", **given})
        shown = shown_bands(look, source.info.bands, str(raster))
        check_output_size(output, grid, len(shown), max_output)
        curves = band_curves(look, source, grid, shown)
        local = local_equalisation(look, source, grid, shown, curves)
        light_of = None if hillshade is None else _shade_of(hillshade, grid, look)
        # The blur is cut at three standard deviations, slopes need one neighbour: windows overlap by so much, and join
        # without a trace.
        reach = max(int(np.ceil(3 * radius)) + 1 if sharpen else 0, 0 if hillshade is None else 1)
        with RasterSink(output, grid, Samples(len(shown), "uint8"), driver=driver, overwrite=overwrite) as sink:
            for window in grid.window.split(*TILE):
                wide = Window(
                    window.col - reach, window.row - reach, window.width + 2 * reach, window.height + 2 * reach
                )
                values, valid = read_bands(source, grid, wide, 1, shown)
                seen = (valid > 0).astype(np.uint8)
                levels = [curves[k](values[..., k]) if curves else values[..., k] for k in range(len(shown))]
                picture = np.clip(np.floor(np.dstack(levels) + 0.5), 0, 255).astype(np.uint8)
                rgb = picture if len(shown) == 3 else np.repeat(picture, 3, axis=2)
                if local is not None:
                    y = (wide.row + np.arange(wide.height) + 0.5) / grid.height
                    x = (wide.col + np.arange(wide.width) + 0.5) / grid.width
                    light = luminance(rgb)
                    rgb = with_luminance(rgb, light, local(light, y, x))
                if light_of is not None:
                    rgb = shaded(rgb, light_of(wide), float(np.sin(np.radians(look.altitude))), HILLSHADE)
                if sharpen:
                    rgb = sharpened(rgb, seen, radius, sharpen)
                inside = slice(reach, reach + window.height), slice(reach, reach + window.width)
                made = np.ascontiguousarray(rgb[inside][..., : len(shown)])
                sink.write(window, made, np.ascontiguousarray(seen[inside]))
            sink.finish()
    return EnhancedRaster(output, grid)


def _shade_of(dem: Path, grid: Grid, look: EnhancePart) -> Callable[[Window], FloatArray]:
    """Hillshade of windows of a raster."""
    if not grid.crs.is_projected:
        raise InputError("a hillshade needs a map in metres", where="`hillshade`", hint="reproject the raster first")
    metres = linear_unit(grid.crs)

    def of(window: Window) -> FloatArray:
        cols, rows = window.col + np.arange(window.width) + 0.5, window.row + np.arange(window.height) + 0.5
        x = grid.xy(np.column_stack([cols, np.zeros_like(cols)]))[:, 0]
        y = grid.xy(np.column_stack([np.zeros_like(rows), rows]))[:, 1]
        step = grid.resolution[0] * metres, grid.resolution[1] * metres
        return shade_of_slope(heights_at(dem, None, grid.crs, x, y), step, look.azimuth, look.altitude)

    return of


def pan_sharpen(
    raster: PathLike,
    pan: PathLike,
    output: PathLike,
    *,
    method: str = PAN_METHODS[0],
    bands: Sequence[int] | None = None,
    driver: str = "COG",
    overwrite: bool = False,
    max_output: int | None = None,
) -> PanSharpened:
    """Bands of a raster on the pixels of a panchromatic one, with its detail.

    Parameters
    ----------
    raster, pan : path
        In the same CRS, north up; the pan band is the first one of its file.
    output : path
        Of the sample type of the bands.
    method : str
        'regression', 'brovey' or 'weighted'.
    bands : sequence of int, optional
        Counted from 1; all unless given.
    driver : str
        'COG' or 'GTiff'.
    overwrite : bool
        Replace an existing file.
    max_output : int, optional
        Bytes; see `geomosaic.raster.files.check_output_size`.

    Raises
    ------
    InputError, OutputExistsError, OutputError
    """
    raster, pan, output = given_path(raster), given_path(pan), given_path(output)
    check_output(output, overwrite=overwrite, inputs=(raster, pan), geotiff=True)
    with Source(raster) as coarse, Source(pan) as fine:
        low, high = raster_grid(coarse, str(raster)), raster_grid(fine, str(pan))
        if low.crs != high.crs:
            raise InputError(
                f"the rasters have different CRS: {low.crs.name} and {high.crs.name}",
                where=str(pan),
                hint="bring one to the CRS of the other first: geomosaic reproject",
            )
        chosen = tuple(bands or range(1, coarse.info.bands + 1))
        if any(not 1 <= band <= coarse.info.bands for band in chosen):
            count = counted(coarse.info.bands, "band")
            raise InputError(f"the raster has {count}", where="`bands`", hint="give some of these")
        check_output_size(output, high, len(chosen) * coarse.dtype.itemsize, max_output)
        # Where both are known, at the resolution of the bands, from means of the pan band there.
        model = _model(method, coarse, fine, low, high, chosen)
        kind = str(coarse.dtype)
        least, most, whole = value_range(kind)
        with RasterSink(output, high, Samples(len(chosen), kind), driver=driver, overwrite=overwrite) as sink:
            for window in high.window.split(*TILE):
                detail, known = read_bands(fine, high, window, 1, (1,))
                near, seen = _near(coarse, low, high, window, chosen)
                sharp = pan_sharpened(model, near, detail[..., 0])
                if whole:
                    sharp = np.clip(np.floor(sharp + 0.5), least, most)
                valid = ((known > 0) & (seen > 0.5)).astype(np.uint8)
                sink.write(window, np.ascontiguousarray(sharp.astype(coarse.dtype)), valid)
            sink.finish()
    return PanSharpened(output, high, model)


def _near(coarse: Source, low: Grid, high: Grid, window: Window, bands: Sequence[int]) -> tuple[AnyArray, AnyArray]:
    """Bands and validity at the pixels of a window of the fine grid."""
    cols, rows = window.col + np.arange(window.width) + 0.5, window.row + np.arange(window.height) + 0.5
    x = low.colrow(high.xy(np.column_stack([cols, np.full_like(cols, rows[0])])))[:, 0]
    y = low.colrow(high.xy(np.column_stack([np.full_like(rows, cols[0]), rows])))[:, 1]
    # Cubic convolution takes two pixels on each side.
    left, top = int(np.floor(x[0])) - 3, int(np.floor(y[0])) - 3
    part = Window(left, top, int(np.ceil(x[-1])) + 4 - left, int(np.ceil(y[-1])) + 4 - top)
    values, valid = read_bands(coarse, low, part, 1, bands)
    values, filled = _filled(values, valid)
    near = magnified(values, y - top, x - left)
    index = np.floor(y - top).astype(int)[:, None], np.floor(x - left).astype(int)[None, :]
    return near, filled[index]


def _filled(values: AnyArray, valid: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Bands with invalid pixels replaced by the nearest valid ones, so that none enters an interpolation."""
    if valid.all() or not valid.any():
        return values, valid
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(valid == 0, return_distances=False, return_indices=True)
    return values[nearest[0], nearest[1]], valid


def _model(method: str, coarse: Source, fine: Source, low: Grid, high: Grid, bands: Sequence[int]) -> PanModel:
    """Pan model from at most about a million pixels of the bands, in evenly spread blocks."""
    ratio = low.resolution[0] / high.resolution[0]
    if ratio < 1.0:
        raise InputError("the pan raster is coarser than the bands", where="`pan`", hint="are the two exchanged?")
    # A weight for each band and an offset need no more samples, whatever the size of the raster.
    blocks = list(low.window.split(128, 128))
    picked = blocks[:: max(1, len(blocks) // 64)]
    xs, ys = [], []
    for block in picked:
        values, valid = read_bands(coarse, low, block, 1, bands)
        means, known = _means(fine, low, high, block)
        use = (valid > 0) & known
        xs.append(values[use])
        ys.append(means[use])
    return pan_model(method, np.concatenate(xs), np.concatenate(ys))


def _means(fine: Source, low: Grid, high: Grid, block: Window) -> tuple[AnyArray, AnyArray]:
    """Mean of the pan band over each pixel of a block of the coarse grid, from the pixels whose centres it holds."""
    corner = np.array([[block.col, block.row], [block.stop_col, block.stop_row]], dtype=np.float64)
    (left, top), (right, bottom) = high.colrow(low.xy(corner))
    window = Window(int(np.floor(left)), int(np.floor(top)), int(np.ceil(right - np.floor(left))) + 1,
                    int(np.ceil(bottom - np.floor(top))) + 1)  # fmt: skip
    values, valid = read_bands(fine, high, window, 1, (1,))
    centres = np.column_stack([window.col + np.arange(window.width) + 0.5, np.full(window.width, window.row + 0.5)])
    col = np.floor(low.colrow(high.xy(centres))[:, 0] - block.col).astype(int)
    centres = np.column_stack([np.full(window.height, window.col + 0.5), window.row + np.arange(window.height) + 0.5])
    row = np.floor(low.colrow(high.xy(centres))[:, 1] - block.row).astype(int)
    inside = (
        (row >= 0)[:, None] & (row < block.height)[:, None] & (col >= 0)[None] & (col < block.width)[None] & (valid > 0)
    )
    index = (row[:, None] * block.width + col[None, :])[inside]
    size = block.width * block.height
    count = np.bincount(index, minlength=size)
    total = np.bincount(index, values[..., 0][inside].astype(np.float64), minlength=size)
    # Pixels of the coarse grid that the pan band does not fill would compare different ground.
    full = count >= max(1, 0.9 * count.max())
    shape = block.height, block.width
    return (total / np.maximum(count, 1)).reshape(shape), full.reshape(shape)
