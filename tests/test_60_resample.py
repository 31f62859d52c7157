"""The kernels against NumPy, against analytic images, and against white noise."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy_warp
import pytest
from helpers import GROUND, MAP, ArrayReader, Hills, PinholeOverMap

from geomosaic import kernels
from geomosaic.geo.grid import Grid, Window
from geomosaic.kernels.warp import Geometry, OutputScaling, Pixels, coordinates
from geomosaic.resample.warp import RESAMPLING, Colour, Sampling, Target, supersampling, value_range, warp
from geomosaic.sensor.lattice import Lattice, build
from geomosaic.sensor.map_to_image import BlockGround, Ground, MapToImage
from geomosaic.surface.model import Surface

MODEL = PinholeOverMap()
SMALL = PinholeOverMap(size=(250, 200), focal=250.0)
HILLS = Hills()


def grid_of(resolution: float) -> Grid:
    return Grid.from_bounds(MAP, (499600.0, 5499650.0, 500400.0, 5500350.0), resolution)


@cache
def placed(resolution: float, window: Window, surface: Surface, model: PinholeOverMap) -> tuple[BlockGround, Lattice]:
    """Ground and lattice of a block, which many tests share."""
    grid = grid_of(resolution)
    ground = Ground.under(grid, surface).block(window)
    (lattice,) = build(MapToImage.between(MAP, GROUND, model), grid, ground, 0.02)
    return ground, lattice


def warped(values, resampling, resolution=1.0, valid=None, dtype=None, window=None, surface=None, **more):
    model = more.pop("model", MODEL)
    grid = grid_of(resolution)
    window = window or grid.window
    ground, lattice = placed(resolution, window, surface or HILLS, model)
    out = np.zeros((window.height, window.width, values.shape[2]), dtype=dtype or values.dtype)
    out_valid = np.zeros(out.shape[:2], dtype=np.uint8)
    reader = ArrayReader(values, valid)
    colour = Colour.identity(values.shape[2])
    target = Target(out, out_valid, **more)
    warp(reader, model.size, lattice, ground.patch, Sampling(resampling), colour, target)
    return grid, lattice, out, out_valid


@pytest.fixture(params=["compiled", "NumPy"])
def either(request, monkeypatch) -> None:
    """The compiled kernels, or NumPy in their place."""
    if request.param == "NumPy":
        by_numpy(monkeypatch)


def by_numpy(monkeypatch) -> None:
    for name in ("warp", "sample", "coordinates"):
        monkeypatch.setattr(kernels.warp, name, getattr(numpy_warp, name))


def image(dtype: str, bands: int) -> np.ndarray:
    rng = np.random.default_rng(4)
    values = rng.integers(0, 250, (SMALL.size[1], SMALL.size[0], bands)).astype(dtype)
    return values - 100 if dtype == "int16" else values


TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64")
FORMS = [(dtype, bands) for dtype in ("uint8", "uint16", "int16", "float32") for bands in (1, 3, 4, 7)]


@pytest.mark.parametrize("resampling", RESAMPLING)
@pytest.mark.parametrize(("dtype", "bands"), [*FORMS, *((dtype, 2) for dtype in TYPES if (dtype, 2) not in FORMS)])
def test_kernels_give_the_bytes_of_numpy(monkeypatch, resampling: str, dtype: str, bands: int) -> None:
    values = image(dtype, bands)
    known = (np.random.default_rng(5).random(values.shape[:2]) > 0.02).astype(np.uint8)
    planes = np.moveaxis(np.ascontiguousarray(np.moveaxis(values, -1, 0)), 0, -1)
    cases = [(resolution, valid) for resolution in (4.0, 10.0) for valid in (None, known)]
    compiled = [warped(values, resampling, size, valid, model=SMALL)[2:] for size, valid in cases]
    planar = [warped(planes, resampling, size, valid, model=SMALL)[2:] for size, valid in cases]
    by_numpy(monkeypatch)
    for (size, valid), (out, seen), (by_band, seen_by_band) in zip(cases, compiled, planar, strict=True):
        expected, expected_seen = warped(values, resampling, size, valid, model=SMALL)[2:]
        assert 0.5 < seen.mean() < 1
        assert np.array_equal(seen, expected_seen)
        assert np.array_equal(seen_by_band, expected_seen)
        assert np.array_equal(by_band, out)
        if resampling == "lanczos":  # the sine of two libraries may differ in the last bit
            close = np.abs(out.astype(float) - expected) <= (1e-4 if dtype == "float32" else 1)
            assert close.all()
        elif dtype == "float64":  # beyond the centres of the outer pixels the last bit may differ
            assert np.allclose(out, expected, rtol=1e-12, atol=1e-12)
        else:
            assert np.array_equal(out, expected)


@pytest.mark.parametrize("resampling", RESAMPLING)
@pytest.mark.parametrize(("dtype", "bands"), [("uint8", 3), ("uint8", 1), ("float32", 2)])
@pytest.mark.parametrize("flat", [False, True])
def test_single_pixels_have_the_bytes_of_the_whole(resampling: str, dtype: str, bands: int, flat: bool) -> None:
    """Placed one by one; the others stay as they were."""
    values, surface = image(dtype, bands), Hills(amplitude=0.0) if flat else Hills()
    valid = None if bands == 3 else (np.random.default_rng(5).random(values.shape[:2]) > 0.02).astype(np.uint8)
    size = grid_of(4.0)
    only = np.random.default_rng(6).random(size.shape) < 0.1
    whole, few = (
        warped(values, resampling, 4.0, valid, model=SMALL, surface=surface, only=mask)[2:] for mask in (None, only)
    )
    assert np.array_equal(few[1], whole[1] * only)
    assert np.array_equal(few[0], whole[0] * only[..., None])
    assert 0.05 < few[1].mean() < 0.1


@pytest.mark.parametrize("resampling", ["bilinear", "cubic", "lanczos"])
def test_a_ramp_comes_back_as_its_own_coordinates(resampling: str) -> None:
    """The image's value is its own (col, row): what comes out must be the exact projection of the pixel's centre."""
    c, r = np.meshgrid(np.arange(MODEL.size[0]) + 0.5, np.arange(MODEL.size[1]) + 0.5)
    ramp = np.stack([c, r], axis=-1).astype(np.float32)
    hills = Hills(spacing=1.0)
    grid, lattice, out, valid = warped(ramp, resampling, surface=hills)
    rows, cols = np.nonzero(valid)
    xy = grid.xy(np.column_stack([cols + 0.5, rows + 0.5]))
    exact = MODEL.ground_to_image(np.column_stack([xy, hills.height(xy)]))
    inside = (exact > 4).all(axis=1) & (exact[:, 0] < MODEL.size[0] - 4) & (exact[:, 1] < MODEL.size[1] - 4)
    miss = np.hypot(*(out[rows, cols] - exact)[inside].T)
    assert np.sqrt((miss**2).mean()) < 0.005
    assert miss.max() < 0.02
    assert (np.abs((out[rows, cols] - exact)[inside].mean(axis=0)) < 0.0005).all()
    assert lattice.error <= 0.01


def at_one_phase(resampling: str, values: np.ndarray, phase: float) -> np.ndarray:
    """Values of an image at places that lie `phase` pixels right of its pixel centres, inner ones."""
    height, width = values.shape[:2]
    cols, rows = np.meshgrid(np.arange(8, width - 8) + 0.5 + phase, np.arange(8, height - 8) + 0.5)
    out, seen = np.zeros((*cols.shape, 1), np.float32), np.zeros(cols.shape, np.uint8)
    ending = OutputScaling(np.ones(1), np.zeros(1), -np.inf, np.inf, False)
    kernels.warp.sample(cols, rows, Pixels(values, None, 0, 0, 1, (width, height)), resampling, ending, out, seen)
    assert seen.all()
    return out[..., 0]


@pytest.mark.parametrize("resampling", ["bilinear", "cubic", "lanczos"])
@pytest.mark.parametrize("dtype", ["uint8", "float32"])
@pytest.mark.usefixtures("either")
def test_a_slope_stays_where_it_is_at_every_place_between_pixels(resampling: str, dtype: str) -> None:
    """Where the output has the image's pixel size, all pixels have the same place, and nothing averages out."""
    slope = np.broadcast_to(np.arange(0, 200, 2, dtype=dtype)[None, :, None], (20, 100, 1)).copy()
    for phase in (0.03, 0.1, 0.2499, 0.31, 0.63, 0.87):
        moved = at_one_phase(resampling, slope, phase) / 2 - np.arange(8, 92)
        assert np.abs(moved - phase).max() < 0.0005


@pytest.mark.usefixtures("either")
def test_lanczos_moves_no_smooth_picture() -> None:
    across = np.arange(300) + 0.5
    for wavelength in (40.0, 16.0, 8.0):
        turn = 2 * np.pi / wavelength
        wave = np.broadcast_to(np.sin(turn * across)[None, :, None], (20, 300, 1)).astype(np.float32)
        for phase in (0.1, 0.25, 0.4, 0.8):
            got = at_one_phase("lanczos", wave, phase)[0]
            place = across[8:-8] + phase
            here = slice(0, int((len(place) // wavelength) * wavelength))  # whole waves
            shift = np.angle((got[here] * np.exp(-1j * turn * place[here])).sum() * 1j) / turn
            assert abs(shift) < 0.0005, (wavelength, phase)


@pytest.mark.parametrize(("tolerance", "amplitude"), [(0.1, 200.0), (0.02, 200.0), (0.02, 60.0), (0.002, 60.0)])
def test_lattice_keeps_its_tolerance_against_every_pixel(tolerance: float, amplitude: float) -> None:
    from scipy.interpolate import RegularGridInterpolator

    grid = grid_of(0.5)
    ground = Ground.under(grid, Hills(amplitude=amplitude)).block(Window(0, 512, 1024, 512))
    lattices = build(MapToImage.between(MAP, GROUND, MODEL), grid, ground, tolerance)
    patch = ground.patch
    t, (h, w) = patch.transform, patch.heights.shape
    # Heights as the patch has them: what is judged here is the lattice, not the spacing of the DEM.
    heights = RegularGridInterpolator((np.arange(h), np.arange(w)), patch.heights.astype(float))
    pixels, largest, reported = 0, 0.0, 0.0
    for lattice in lattices:
        window = lattice.window
        cols, rows = np.empty((2, window.height, window.width))
        x, y = lattice.surface[..., 0], lattice.surface[..., 1]
        places = np.stack([t.a * x + t.b * y + t.c - 0.5, t.d * x + t.e * y + t.f - 0.5], axis=-1)
        coordinates(
            Geometry(lattice.nodes, places, patch.heights, lattice.z_middle, 1 / lattice.z_half, False, lattice.step),
            0, 1, MODEL.size, np.ones((8, 16), dtype=np.uint8), cols, rows,
        )  # fmt: skip
        cc, rr = np.meshgrid(window.col + np.arange(window.width) + 0.5, window.row + np.arange(window.height) + 0.5)
        xy = grid.xy(np.column_stack([cc.ravel(), rr.ravel()]))
        z = heights((np.column_stack([t.a * xy[:, 0] + t.c, t.e * xy[:, 1] + t.f]) - 0.5)[:, ::-1])
        exact = MODEL.ground_to_image(np.column_stack([xy, z]))
        seen = (exact > 0).all(axis=1) & (exact < np.array(MODEL.size)).all(axis=1)
        miss = np.hypot(cols.ravel() - exact[:, 0], rows.ravel() - exact[:, 1])[seen]
        largest, reported = max(largest, miss.max()), max(reported, lattice.error)
        pixels += window.width * window.height
    assert pixels == 1024 * 512
    assert largest <= tolerance
    assert reported <= tolerance
    assert largest <= 2.0 * reported + 1e-9  # the measured error is an honest one


def test_white_noise_keeps_the_deviation_of_the_block_mean() -> None:
    """Ten times coarser: the deviation must be that of the mean of 100 pixels, not five to seven times it."""
    rng = np.random.default_rng(1)
    values = rng.normal(128, 72, (MODEL.size[1], MODEL.size[0], 1)).astype(np.float32)
    for resampling in ("bilinear", "cubic", "lanczos", "average"):
        _, lattice, out, valid = warped(values, resampling, resolution=10.0 * 0.95, surface=Hills(amplitude=0.01))
        assert 9.0 < lattice.scale < 11.0
        deviation = out[valid > 0].std()
        assert deviation == pytest.approx(72 / lattice.scale, rel=0.12)
    _, _, out, valid = warped(values, "nearest", resolution=10.0)
    assert out[valid > 0].std() > 60  # classes are never averaged


def test_shrinking_on_reading_agrees_with_sampling() -> None:
    rng = np.random.default_rng(2)
    smooth = np.add.outer(np.sin(np.arange(MODEL.size[1]) / 60), np.cos(np.arange(MODEL.size[0]) / 80))
    values = (100 + 40 * smooth + rng.normal(0, 5, smooth.shape))[..., None].astype(np.float32)
    grid = grid_of(10.0)
    window = grid.window
    ground = Ground.under(grid, Hills()).block(window)
    lattice = build(MapToImage.between(MAP, GROUND, MODEL), grid, ground, 0.02)[0]
    results = []
    for most in (16, 3):
        out, valid = np.zeros((*grid.shape, 1), dtype=np.float32), np.zeros(grid.shape, dtype=np.uint8)
        warp(
            ArrayReader(values), MODEL.size, lattice, ground.patch, Sampling("average", most),
            Colour.identity(1), Target(out, valid),
        )  # fmt: skip
        results.append((out, valid))
    both = (results[0][1] > 0) & (results[1][1] > 0)
    assert both.mean() > 0.3
    assert np.abs(results[0][0] - results[1][0])[both].std() < 1.5


def test_root_mean_square_is_the_average_of_the_squares_reduced_on_reading_or_not() -> None:
    values = np.random.default_rng(4).rayleigh(100, (MODEL.size[1], MODEL.size[0], 1)).astype(np.float32)
    for resolution, least in ((10.0, 5), (80.0, 64)):
        _, lattice, out, valid = warped(values, "rms", resolution=resolution, surface=Hills(amplitude=0.01))
        _, _, squares, same = warped(values**2, "average", resolution=resolution, surface=Hills(amplitude=0.01))
        assert lattice.scale > least
        assert np.array_equal(valid, same)
        assert valid.any()
        inside = np.abs(out - np.sqrt(squares))[valid > 0]
        assert inside.max() < (1e-3 if least < 64 else 1.5)  # beyond 16 image pixels means are taken of means


def test_black_stays_and_nodata_never_bleeds() -> None:
    values = np.full((MODEL.size[1], MODEL.size[0], 1), 200, dtype=np.uint8)
    values[300:500, 300:700] = 0  # true black
    valid = np.ones(values.shape[:2], dtype=np.uint8)
    valid[:, 500:520] = 0
    values[:, 500:520] = 255  # garbage under the mask
    for resampling in RESAMPLING:
        _, _, out, seen = warped(values, resampling, 1.0, valid)
        assert (out[seen > 0] == 0).sum() > 10000
        assert out[seen > 0].max() <= (200 if resampling not in ("cubic", "lanczos") else 230)
        assert (out[seen == 0] == 0).all()


def test_windows_that_are_reduced_are_cut_by_the_bytes_of_their_means(monkeypatch) -> None:
    read: list[int] = []

    class Measured(ArrayReader):
        def read(self, window: Window, shrink: int = 1) -> tuple[Any, Any]:
            values, valid = super().read(window, shrink)
            read.append(values.nbytes)
            return values, valid

    values, most = np.full((*MODEL.size[::-1], 3), 100, dtype=np.uint8), 180_000
    monkeypatch.setattr("geomosaic.resample.warp.MOST_PIXELS", most)
    grid = grid_of(10.0)
    ground = Ground.under(grid, Hills()).block(grid.window)
    (lattice,) = build(MapToImage.between(MAP, GROUND, MODEL), grid, ground, 0.02)
    target = Target(np.zeros((*grid.shape, 3), dtype=np.uint8), np.zeros(grid.shape, dtype=np.uint8))
    few, colour = Sampling("bilinear", 3), Colour.identity(3)
    warp(Measured(values), MODEL.size, lattice, ground.patch, few, colour, target)
    assert sum(read) > 3 * most  # one window would hold too much
    assert max(read) <= 3 * most


def test_colour_is_applied_before_rounding() -> None:
    values = np.full((MODEL.size[1], MODEL.size[0], 1), 101, dtype=np.uint8)
    grid = grid_of(2.0)
    ground = Ground.under(grid, Hills()).block(grid.window)
    lattice = build(MapToImage.between(MAP, GROUND, MODEL), grid, ground, 0.02)[0]
    for gain, offset, expected in ((1.5, 0.0, 152), (1.0, -200.0, 0), (3.0, 0.0, 255)):
        out, valid = np.zeros((*grid.shape, 1), dtype=np.uint8), np.zeros(grid.shape, dtype=np.uint8)
        colour = Colour(np.array([gain]), np.array([offset]))
        target = Target(out, valid)
        warp(ArrayReader(values), MODEL.size, lattice, ground.patch, Sampling("bilinear"), colour, target)
        assert (out[valid > 0] == expected).all()


def test_unknown_heights_leave_unknown_pixels_only() -> None:
    class Holed(Hills):
        def patch(self, bounds, spacing=0.0):
            patch = super().patch(bounds, spacing)
            heights = patch.heights.copy()
            heights[60:80, 60:80] = np.nan
            return type(patch)(heights, patch.transform)

    values = np.full((MODEL.size[1], MODEL.size[0], 1), 9, dtype=np.uint8)
    counts = []
    for surface in (Hills(), Holed()):
        _, _, out, valid = warped(values, "bilinear", surface=surface)
        assert (out[valid > 0] == 9).all()
        counts.append(int(valid.sum()))
    assert 19 * 19 * 25 <= counts[0] - counts[1] <= 21 * 21 * 25 + 100


def test_samples_per_pixel_follow_the_scale() -> None:
    assert supersampling("bilinear", 1.0) == (1, 1)
    assert supersampling("bilinear", 10.0) == (10, 1)
    assert supersampling("nearest", 10.0) == (1, 1)
    n, shrink = supersampling("cubic", 100.0)
    assert shrink == 8
    assert n == 13


@pytest.mark.parametrize("resampling", ["bilinear", "cubic"])
@pytest.mark.parametrize("dtype", TYPES)
@pytest.mark.parametrize("held", ["uint8", "int8", "uint16", "float32"])
def test_an_image_keeps_its_values_in_every_type_that_holds_them(resampling: str, dtype: str, held: str) -> None:
    values, sizes = np.full((20, 30, 1), 77, dtype=held), (30, 20)
    out, seen = np.zeros((8, 9, 1), dtype=dtype), np.zeros((8, 9), dtype=np.uint8)
    cols, rows = np.meshgrid(np.linspace(3.2, 25.1, 9), np.linspace(4.4, 15.3, 8))
    ending = OutputScaling(np.ones(1), np.zeros(1), *value_range(dtype))
    kernels.warp.sample(cols, rows, Pixels(values, None, 0, 0, 1, sizes), resampling, ending, out, seen)
    assert seen.all()
    assert (np.abs(out - 77.0) < 1e-9).all()


@pytest.mark.parametrize("resampling", ["bilinear", "cubic"])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("held", ["uint8", "uint16"])
def test_kernels_give_the_corrected_and_unrounded_values_of_numpy(
    monkeypatch, resampling: str, dtype: str, held: str
) -> None:
    values = image(held, 3)
    grid = grid_of(4.0)
    ground = Ground.under(grid, Hills()).block(grid.window)
    (lattice,) = build(MapToImage.between(MAP, GROUND, SMALL), grid, ground, 0.02)
    colour = Colour(np.array([1.1, 0.9, 1.0]), np.array([-3.3, 4.7, 0.0]))
    results = []
    for replaced in (False, True):
        if replaced:
            by_numpy(monkeypatch)
        out, valid = np.zeros((*grid.shape, 3), dtype=dtype), np.zeros(grid.shape, dtype=np.uint8)
        sampling, target = Sampling(resampling), Target(out, valid)
        warp(ArrayReader(values), SMALL.size, lattice, ground.patch, sampling, colour, target)
        results.append((out, valid))
    assert np.array_equal(results[0][1], results[1][1])
    assert np.array_equal(results[0][0], results[1][0])


def test_a_mask_with_gaps_is_refused_and_gains_with_gaps_are_followed() -> None:
    cols, rows = np.meshgrid(np.linspace(2.0, 15.0, 9), np.linspace(2.0, 11.0, 8))
    gain, gaps = np.array([2.0, 9.0, 3.0, 9.0]), np.ones((14, 36), np.uint8)
    values, out, seen = np.full((14, 18, 2), 7, np.uint16), np.zeros((8, 9, 2), np.uint16), np.zeros((8, 9), np.uint8)
    ending = OutputScaling(gain[::2], np.zeros(2), 0.0, 65535.0, True)
    kernels.warp.sample(cols, rows, Pixels(values, None, 0, 0, 1, (18, 14)), "bilinear", ending, out, seen)
    assert (out == (14, 21)).all()
    with pytest.raises(TypeError, match="gaps"):
        kernels.warp.sample(cols, rows, Pixels(values, gaps[:, ::2], 0, 0, 1, (18, 14)), "cubic", ending, out, seen)


@pytest.mark.usefixtures("either")
@pytest.mark.parametrize("resampling", sorted({*RESAMPLING} - {"rms"}))
@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (3, 3), (5, 2)])
def test_images_smaller_than_a_kernel_repeat_their_edges(resampling: str, size: tuple[int, int]) -> None:
    values = np.full((size[1], size[0], 2), (70, 90), dtype=np.uint16)
    cols, rows = np.meshgrid(np.linspace(-1, size[0] + 1, 53), np.linspace(-1, size[1] + 1, 47))
    out, seen = np.zeros((47, 53, 2), np.uint16), np.zeros((47, 53), np.uint8)
    ending = OutputScaling(np.ones(2), np.zeros(2), 0.0, 65535.0, True)
    method = "bilinear" if resampling == "average" else resampling
    kernels.warp.sample(cols, rows, Pixels(values, None, 0, 0, 1, size), method, ending, out, seen)
    inside = (cols >= 0) & (rows >= 0) & (cols < size[0]) & (rows < size[1])
    assert np.array_equal(seen > 0, inside)
    assert (out[inside] == (70, 90)).all()
