"""BlendOptions: no step where images agree, weights that sum to one, no ghosts, the bands of Burt and Adelson."""

from __future__ import annotations

import hashlib
import itertools
from pathlib import Path

import mosaic_rig as rig
import numpy as np
import numpy_kernels as plain
import pytest
from scipy.ndimage import convolve1d

from geomosaic.errors import InputError
from geomosaic.geo.crs import parse_crs
from geomosaic.geo.grid import Grid
from geomosaic.kernels import blend
from geomosaic.mosaicking.blending.choice import width_px
from geomosaic.options.mosaic import BlendOptions, Width
from geomosaic.resample import agreement, pyramid
from geomosaic.resample.warp import value_range

PLACES = [(0, 0), (180, 40), (60, 190)]
SIZE = (330, 420)
KINDS = [
    BlendOptions(),
    BlendOptions(ramp="smooth"),
    BlendOptions(limit=False),
    BlendOptions(ramp="smooth", limit=False),
    BlendOptions("overlap"),
    BlendOptions("cutline", limit=False),
    BlendOptions("overlap", limit=False),
    BlendOptions("overlap", Width(40, "px"), "smooth", limit=False),
    BlendOptions("multiband", limit=False),
    BlendOptions("multiband"),
    BlendOptions("none"),
]


def pieces(
    folder: Path,
    ground: np.ndarray,
    nodata: float | None = None,
    places: list[tuple[int, int]] = PLACES,
    size: tuple[int, int] = SIZE,
) -> list[Path]:
    """Images of one ground, each its own cut of it."""
    return [
        rig.write(folder / f"{i}.tif", ground[row : row + size[0], col : col + size[1]], col, row, nodata=nodata)
        for i, (col, row) in enumerate(places)
    ]


# Every kind in one of the two types.
@pytest.mark.parametrize(
    ("dtype", "blending"),
    [
        pytest.param(dtype, kind, marks=() if k % 2 == odd else pytest.mark.slow, id=f"{dtype}-{kind}")
        for odd, dtype in enumerate(("uint8", "float32"))
        for k, kind in enumerate(KINDS)
    ],
)
def test_equal_images_leave_no_trace(tmp_path: Path, blending: BlendOptions, dtype: str) -> None:
    ground = rig.scene(530, 610).astype(dtype)
    rig.run(pieces(tmp_path, ground), tmp_path / "out.tif", blending=blending)
    made, valid = rig.read(tmp_path / "out.tif")
    off = np.abs(made[valid].astype(float) - ground[: made.shape[0], : made.shape[1]][valid].astype(float))
    # A weighted mean in 32 bits ends in the last of them; differences that are nothing end in nothing.
    assert off.max() <= (0 if dtype == "uint8" or not blending.plain else 1e-4)


@pytest.mark.parametrize("blending", [kind for kind in KINDS if not kind.limits], ids=str)
def test_weights_sum_to_one(tmp_path: Path, blending: BlendOptions) -> None:
    """Mosaics of one image that is 1 and others that are 0 are the weights."""
    total: np.ndarray | float = 0.0
    for own in range(len(PLACES)):
        files = [
            rig.write(tmp_path / f"{i}.tif", np.full((*SIZE, 1), float(i == own), dtype=np.float32), col, row)
            for i, (col, row) in enumerate(PLACES)
        ]
        rig.run(files, tmp_path / "out.tif", blending=blending)
        values, valid = rig.read(tmp_path / "out.tif")
        assert values[valid].max() > 0.99
        total = total + values[..., 0].astype(np.float64)
    assert np.abs(total[valid] - 1).max() < 1e-6


def test_the_step_at_a_seam(tmp_path: Path) -> None:
    """Two flat images that differ by 20."""
    files = [
        rig.write(tmp_path / "a.tif", np.full((200, 500, 1), 100, np.uint8)),
        rig.write(tmp_path / "b.tif", np.full((200, 500, 1), 120, np.uint8), 300),
    ]
    steps = {}
    for name, blending in {
        "none": BlendOptions("none"),
        "feather": BlendOptions("feather", Width(40, "px"), limit=False),
        "limited": BlendOptions("feather", Width(40, "px")),
        "smooth": BlendOptions("feather", Width(40, "px"), "smooth"),
        "overlap": BlendOptions("overlap"),
        "multiband": BlendOptions("multiband", Width(32, "px")),
    }.items():
        rig.run(files, tmp_path / "out.tif", blending=blending)
        values, _ = rig.read(tmp_path / "out.tif")
        along = values[100, :, 0].astype(int)
        assert along[0] == 100
        assert along[-1] == 120
        steps[name] = np.abs(np.diff(along)).max()
    assert steps == {"none": 20, "feather": 1, "limited": 1, "smooth": 1, "overlap": 1, "multiband": 1}


def laplacian_blend(images: list[np.ndarray], masks: list[np.ndarray], levels: int) -> np.ndarray:
    """Burt and Adelson (1983), of whole images, written down plainly."""
    taps = np.array([1, 4, 6, 4, 1]) / 16

    def smooth(values: np.ndarray, kernel: np.ndarray) -> np.ndarray:
        return convolve1d(convolve1d(values, kernel, axis=0, mode="nearest"), kernel, axis=1, mode="nearest")

    def down(values: np.ndarray) -> np.ndarray:
        return smooth(values, taps)[::2, ::2]

    def up(values: np.ndarray) -> np.ndarray:
        wide = np.zeros((2 * values.shape[0], 2 * values.shape[1], values.shape[2]))
        wide[::2, ::2] = values
        return smooth(wide, 2 * taps)

    bands: list[np.ndarray | float] = [0.0] * (levels + 1)
    for image, mask in zip(images, masks, strict=True):
        value, weight = image.astype(np.float64), mask[..., None].astype(np.float64)
        for level in range(levels + 1):
            smaller = down(value)
            bands[level] = bands[level] + weight * (value if level == levels else value - up(smaller))
            value, weight = smaller, down(weight)
    out = bands[-1]
    for band in bands[-2::-1]:
        out = up(out) + band
    return np.asarray(out)


def test_bands_are_those_of_whole_images(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    ground = rig.scene(1100, 1700, bands=2)
    places, size = [(0, 0), (200, 100)], (1000, 1500)
    cuts = []
    for i, (col, row) in enumerate(places):
        cut = ground[row : row + size[0], col : col + size[1]]
        cut = cut * (1.0, 1.15)[i] + rng.normal(0, 4, cut.shape) + 12 * i * np.sin(np.arange(size[1]) / 90)[:, None]
        cuts.append(cut.astype(np.float32))
    files = [rig.write(tmp_path / f"{i}.tif", cuts[i], *place) for i, place in enumerate(places)]
    rig.run(files, tmp_path / "out.tif", blending=BlendOptions("multiband", Width(32, "px"), limit=False))
    made, _ = rig.read(tmp_path / "out.tif")
    labels = rig.read(tmp_path / "out-labels.tif")[0][..., 0]
    top, left, bottom, right = 128, 224, 992, 1472  # both images show it, and it starts at whole cells of all levels
    both = [
        cut[top - row : bottom - row, left - col : right - col] for cut, (col, row) in zip(cuts, places, strict=True)
    ]
    label = labels[top:bottom, left:right]
    expected = laplacian_blend(both, [label == 1, label == 2], 5)
    inner = slice(128, -128), slice(128, -128)
    mine = made[top:bottom, left:right]
    assert {1, 2} == set(np.unique(label[inner]))
    assert np.abs(both[0] - both[1])[inner].max() > 30
    assert np.abs(mine - expected)[inner].max() < 2e-3


TYPES = ["uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64"]
# Bands and interleaving of pixels.
FORMS = [(1, "pixels"), (2, "pixels"), (3, "pixels"), (3, "bands"), (4, "pixels"), (4, "bands"), (7, "pixels")]


def in_form(values: np.ndarray, interleaving: str) -> np.ndarray:
    """The same values (rows, cols, bands), as a view of what lies pixel by pixel or band by band."""
    if interleaving == "bands":
        return np.ascontiguousarray(np.moveaxis(values, -1, 0)).transpose(1, 2, 0)
    return np.ascontiguousarray(values)


def samples(rng: np.random.Generator, shape: tuple[int, ...], dtype: str, unknown: np.ndarray) -> np.ndarray:
    """Values over the whole of small types; where nothing is known there may be NaN."""
    if dtype.startswith("f"):
        values = rng.normal(120, 900, shape).astype(dtype)
        values[unknown] = np.nan
        return values
    info = np.iinfo(dtype)
    return rng.integers(max(info.min, -(10**6)), min(info.max, 10**6), shape, dtype=dtype, endpoint=True)


@pytest.mark.parametrize(("bands", "rows", "cols"), [(3, 64, 96), (1, 2, 2), (2, 34, 6)])
def test_steps_of_pyramids_are_those_of_numpy(bands: int, rows: int, cols: int) -> None:
    values = np.random.default_rng(4).normal(100, 40, (bands, rows, cols)).astype(np.float32)
    small = plain.reduce(values)
    assert small.dtype == np.float32
    assert np.array_equal(pyramid.reduce(values), small)
    assert np.array_equal(pyramid.reduce(values[:, ::-1, ::-1]), plain.reduce(values[:, ::-1, ::-1]))
    assert np.array_equal(pyramid.expand(small), plain.expand(small))
    assert np.allclose(plain.expand(plain.reduce(np.ones_like(values))), 1, atol=1e-6)


@pytest.mark.parametrize(("bands", "interleaving"), FORMS)
def test_differences_are_taken_and_joined_as_in_numpy(bands: int, interleaving: str) -> None:
    for dtype in TYPES:
        check_differences(dtype, bands, interleaving)


def check_differences(dtype: str, bands: int, interleaving: str) -> None:
    rng, shape = np.random.default_rng(5), (20, 330)
    exact, both = np.result_type(dtype, np.float32), rng.random(shape) > 0.2
    values = in_form(samples(rng, (*shape, bands), dtype, ~both), interleaving)
    ground = rng.normal(100, 60, values.shape).astype(exact)
    blended, own = rng.normal(0, 9, (2, bands, *shape)).astype(np.float32)
    label = np.where(both, rng.integers(0, 2, shape), -1)
    label[5:9] = np.where(both[5:9], 1, -1)
    label[9, :300] = 1
    apart = plain.minus(values, ground, both)
    assert apart.dtype == np.float32
    assert apart.tobytes() == pyramid.minus(values, ground, both).tobytes()
    raw = np.moveaxis(values.astype(float) - ground, -1, 0)
    assert np.allclose(apart, np.where(both, raw, 0), rtol=1e-6, atol=1e-4)
    least, most, whole = limits = value_range(dtype)
    for differs, blends in itertools.product((False, True), repeat=2):
        made = [in_form(np.full(values.shape, 3, dtype=dtype), interleaving) for _ in range(2)]
        for kernel, out in zip((pyramid.join, plain.join), made, strict=True):
            kernel(values, own if differs else None, blended if blends else None, label, 1, limits, out)
        assert made[0].tobytes() == made[1].tobytes()
        raw = np.moveaxis(values.astype(float), -1, 0) + blends * blended - differs * own
        expected = np.moveaxis(np.clip(np.floor(raw + 0.5), least, most) if whole else raw, 0, -1)
        here = label == 1
        near = np.isclose(made[0][here].astype(float), expected[here], rtol=1e-6, atol=1e-3, equal_nan=True)
        assert near.mean() > 0.95  # at a half, float32 may round to the other neighbour
        assert np.allclose(made[0][here].astype(float), expected[here], rtol=1e-6, atol=1, equal_nan=True)
        assert (made[0][~here] == 3).all()


def test_kernels_refuse_arrays_that_they_would_read_as_something_else() -> None:
    shape, cells = (64, 64), np.ones((1, 1), dtype=np.uint8)
    values, valid = np.ones((*shape, 1), dtype=np.float32), np.ones(shape, dtype=np.uint8)
    sums, total, label = np.zeros(shape, dtype=np.float32), np.zeros_like(values), np.zeros(shape, dtype=np.uint8)
    for wrong in (
        (values, valid, np.ones((20, 20)), 4, 2, 1, cells, total, sums, sums.copy(), label),
        (values, valid, np.ones((20, 20), dtype=np.float32), 4, 2, 1, cells, total, sums.T, sums.copy(), label),
        (values.astype(float), valid, np.ones((20, 20), dtype=np.float32), 4, 2, 1, cells, total, sums, sums, label),
    ):
        with pytest.raises(TypeError, match=r"accumulate has no form|takes arrays of float32, not of float64"):
            blend.accumulate(*wrong)
    assert not total.any()


def test_the_highest_values_of_wide_types_stay_what_they_are() -> None:
    """The highest value of 64 bits is no double: what is rounded to it must not turn into the lowest."""
    for dtype in ("uint32", "int32", "uint64", "int64"):
        info = np.iinfo(dtype)
        values = np.array([info.max, info.max - 1, info.min], dtype=dtype).reshape(1, 3, 1)
        out = np.zeros_like(values)
        label = np.ones((1, 3), dtype=np.int64)
        pyramid.join(values, None, None, label, 1, value_range(dtype), out)
        assert out[0, 0, 0] == info.max
        assert out[0, 2, 0] == info.min


@pytest.mark.parametrize(("bands", "interleaving"), FORMS)
@pytest.mark.parametrize("kind", ["float32", "float64"])
def test_weighted_means_are_those_of_numpy(kind: str, bands: int, interleaving: str) -> None:
    """Every sample type, cells that are not wanted, unknown pixels that hold NaN, and a block that ends in a cell."""
    rng, shape, factor, margin = np.random.default_rng(6), (70, 333), 4, 3
    cells = np.array([[1, 1, 1, 0, 1, 1], [0, 1, 0, 1, 1, 0]], dtype=np.uint8)
    images = []
    for _ in range(3):
        valid = (rng.random(shape) > 0.1).astype(np.uint8)
        values = rng.normal(100, 40, (*shape, bands)).astype(kind)
        values[valid == 0] = np.nan
        weight = rng.random((shape[0] // factor + 8, shape[1] // factor + 8)).astype(np.float32) - np.float32(0.3)
        images.append((in_form(values, interleaving), valid, weight.clip(0)))
    sums = []
    for kernel in (blend.accumulate, plain.accumulate):
        total = in_form(np.zeros((*shape, bands), dtype=kind), interleaving)
        arrays = total, *np.zeros((2, *shape), dtype=np.float32), np.zeros(shape, dtype=np.int32)
        for number, image in enumerate(images):
            kernel(*image, factor, margin, number + 1, cells, *arrays)
        sums.append(arrays)
    assert all(one.tobytes() == other.tobytes() for one, other in zip(*sums, strict=True))
    assert np.isfinite(sums[0][0]).all()
    assert set(np.unique(sums[0][3])) == {0, 1, 2, 3}
    for dtype in TYPES if kind == "float64" else ("uint8", "int8", "uint16", "int16", "float32"):
        made = []
        for kernel in (blend.finish, plain.finish):
            out, seen = np.full((*shape, bands), 9, dtype=dtype), np.zeros(shape, dtype=np.uint8)
            out = in_form(out, interleaving)
            kernel(*sums[0][:2], cells, *value_range(dtype), out, seen)
            made.append((out, seen))
        assert made[0][0].tobytes() == made[1][0].tobytes()
        assert np.array_equal(made[0][1], made[1][1])
        assert 0.4 < made[0][1].mean() < 0.9


@pytest.mark.parametrize(
    "blending",
    [BlendOptions("multiband"), pytest.param(BlendOptions("overlap"), marks=pytest.mark.slow), BlendOptions()],
    ids=str,
)
def test_tiles_and_threads_do_not_matter(tmp_path: Path, blending: BlendOptions) -> None:
    rng = np.random.default_rng(8)
    ground = rig.scene(600, 2300)
    files = []
    for i, (col, row) in enumerate([(0, 0), (700, 60), (1300, 0)]):
        cut = ground[row : row + 540, col : col + 1000] + rng.normal(0, 5, (540, 1000, 3)) + 9 * i
        files.append(rig.write(tmp_path / f"{i}.tif", cut.clip(1, 255).astype(np.uint8), col, row, nodata=0))
    made = set()
    for threads, tile in ((1, 2048), (3, 1024)):
        rig.run(files, tmp_path / "out.tif", blending=blending, threads=threads, tile=tile)
        made.add(hashlib.sha256((tmp_path / "out.tif").read_bytes()).hexdigest())
    assert len(made) == 1


def with_car(folder: Path) -> tuple[list[Path], np.ndarray, list[np.ndarray]]:
    """Two images, one colour step of 10, and a car of 12 x 24 pixels that only the first shows, on the seam."""
    rng = np.random.default_rng(6)
    ground = rig.scene(300, 900)
    cuts = []
    for i, col in enumerate((0, 300)):
        cut = ground[:, col : col + 600] + rng.normal(0, 3, (300, 600, 3)) + 10 * i
        if i == 0:
            cut[140:152, 438:462] = 250
        cuts.append(cut.clip(1, 255).astype(np.uint8))
    files = [rig.write(folder / f"{i}.tif", cut, 300 * i) for i, cut in enumerate(cuts)]
    wide = [np.pad(cut, ((0, 0), ((300 * i), 300 - 300 * i), (0, 0))).astype(float) for i, cut in enumerate(cuts)]
    return files, ground, wide


def test_what_moved_leaves_no_ghost(tmp_path: Path) -> None:
    """Every pixel of the car is the car, or the ground below it - not something between the two."""
    files, _, images = with_car(tmp_path)
    car = slice(142, 150), slice(440, 460)

    def between(blending: BlendOptions) -> float:
        rig.run(files, tmp_path / "out.tif", blending=blending)
        made = rig.read(tmp_path / "out.tif")[0].astype(float)
        # Of a pixel's way from the ground to the car, how far it is from the nearer end; the step of 10 is no ghost.
        apart = images[0][car] - images[1][car]
        share = (made[car] - images[1][car]) / apart
        return float(np.median(np.minimum(np.abs(share), np.abs(1 - share)), axis=2).max())

    assert between(BlendOptions("feather", Width(60, "px"), limit=False)) > 0.3
    assert between(BlendOptions("multiband", Width(32, "px"), limit=False)) > 0.2
    for blending in (
        BlendOptions("feather", Width(60, "px")),
        BlendOptions("feather", Width(60, "px"), "smooth"),
        BlendOptions("multiband", Width(32, "px")),
        BlendOptions("overlap"),
    ):
        assert between(blending) < 0.12, blending


@pytest.mark.parametrize(("kind", "most"), [("feather", 0.0), ("multiband", 0.15)])
def test_limits_do_not_stop_the_blending_of_colour(tmp_path: Path, kind: str, most: float) -> None:
    """Away from the car the step of 10 is blended as if there were no limit: by weights to the bit."""
    files, _, _ = with_car(tmp_path)
    made = []
    for limit in (True, False):
        rig.run(files, tmp_path / "out.tif", blending=BlendOptions(kind, Width(32, "px"), limit=limit))
        made.append(rig.read(tmp_path / "out.tif")[0].astype(float))
    assert np.abs(made[0] - made[1])[:90].mean() <= most
    assert np.abs(made[0] - made[1])[130:160].max() > 10


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_a_difference_of_exposure_is_no_other_ground(tmp_path: Path, dtype: str) -> None:
    """One image a quarter brighter, unbalanced: what is bright differs most, and is blended like the rest."""
    rng, ground, scale = np.random.default_rng(12), rig.scene(300, 900), {"uint8": 0.8, "uint16": 60.0, "float32": 1e-3}
    ground[(np.arange(300) // 11 % 4 == 0)] += 40  # roads
    cuts = [
        scale[dtype] * gain * (ground[:, col : col + 600] + rng.normal(0, 1.5, (300, 600, 3)))
        for gain, col in ((1.0, 0), (1.25, 300))
    ]
    files = [rig.write(tmp_path / f"{i}.tif", cut.astype(dtype), 300 * i) for i, cut in enumerate(cuts)]
    made = []
    for limit in (True, False):
        rig.run(files, tmp_path / "out.tif", blending=BlendOptions("feather", Width(60, "px"), limit=limit))
        made.append(rig.read(tmp_path / "out.tif")[0].astype(float))
    apart = np.abs(made[0] - made[1]) / scale[dtype]
    assert (apart > 1).mean() < 2e-4, f"{apart.max()}, {(apart > 1).mean()}"


@pytest.mark.parametrize(("bands", "interleaving"), FORMS)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_what_moved_is_left_out_as_in_numpy(dtype: str, bands: int, interleaving: str) -> None:
    rng, (rows, cols) = np.random.default_rng(13), (201, 333)
    ground = rig.scene(rows, cols)[..., [0, 1, 2, 0, 1, 2, 0]][..., :bands] + rng.normal(0, 2, (rows, cols, bands))
    values = [in_form((ground + by + rng.normal(0, 2, ground.shape)).astype(dtype), interleaving) for by in (0, 5)]
    values[1][60:90, 140:190] = 250
    seen = [(rng.random((rows, cols)) > 0.01).astype(np.uint8) for _ in values]
    for one, known in zip(values, seen, strict=True):
        one[known == 0] = np.nan
    weight = np.clip((np.arange(cols // 4 + 10) - 35) / 20, 0, 1).astype(np.float32)
    weight = np.broadcast_to(weight, (rows // 4 + 10, len(weight))).copy()
    cells = np.ones((4, 6), dtype=np.uint8)
    cells[:, :2] = 0
    label = np.where(np.arange(cols) < 170, 1, 2) * np.ones((rows, 1), dtype=np.uint8)
    corner, shape = agreement.box_of(cells)
    views = [agreement.View(*each) for each in zip(values, seen, (weight, 1 - weight), (1, 2), strict=True)]
    made = []
    for by in (agreement, plain):
        moments, known = np.zeros((5, bands, *shape), dtype=np.float32), np.zeros(shape, dtype=np.float32)
        level, total = np.full(bands, 100.0), in_form(np.zeros((rows, cols, bands), dtype=dtype), interleaving)
        by.compare(*views, level, cells, corner, moments, known)
        mismatch = agreement.mismatch_of(moments, known, level, 0.5)
        assert mismatch is not None
        by.deghost(*views, (4, 3), cells, corner, mismatch, label, total)
        made.append((moments.tobytes(), known.tobytes(), mismatch.share.tobytes(), total.tobytes()))
    assert made[0] == made[1]
    assert np.abs(total[65:85, 145:185]).max() > 10
    assert not total[:40].any()
    assert np.isfinite(total).all()


@pytest.mark.parametrize("kind", ["multiband", "feather"])
def test_the_edge_of_what_is_known_is_a_seam_too(tmp_path: Path, kind: str) -> None:
    """A slanted border of nodata, as orthos have: no step and no dark halo along it."""
    rows, cols = np.mgrid[0:400, 0:600]
    one = np.full((400, 600, 1), 100, dtype=np.uint8)
    two = np.where(cols + 0.35 * rows > 170, 120, 0).astype(np.uint8)[..., None]
    files = [rig.write(tmp_path / "a.tif", one, nodata=0), rig.write(tmp_path / "b.tif", two, 100, 0, nodata=0)]
    rig.run(files, tmp_path / "out.tif", blending=BlendOptions(kind, Width(32, "px")), order="list")
    values, valid = rig.read(tmp_path / "out.tif")
    assert valid.all()
    inner = values[40:-40, :590, 0].astype(int)
    assert inner.min() >= 99
    assert inner.max() <= 121
    assert np.abs(np.diff(inner, axis=1)).max() <= 2


@pytest.mark.parametrize(("dtype", "bands"), [("uint16", 1), ("int16", 5), ("float64", 2)])
def test_any_sample_type_and_number_of_bands(tmp_path: Path, dtype: str, bands: int) -> None:
    ground = (rig.scene(530, 610, bands=bands) * 37 - (1000 if dtype == "int16" else 0)).astype(dtype)
    for blending in (BlendOptions("multiband"), BlendOptions("overlap", ramp="smooth")):
        rig.run(pieces(tmp_path, ground), tmp_path / "out.tif", blending=blending)
        made, valid = rig.read(tmp_path / "out.tif")
        assert made.dtype == dtype
        assert np.array_equal(made[valid], ground[: made.shape[0], : made.shape[1]][valid])


def test_widths_have_units() -> None:
    def grid(crs: str, size: float) -> Grid:
        return Grid.from_bounds(parse_crs(crs), (10.0, 40.0, 10.0 + 100 * size, 40.0 + 100 * size), size, snap=False)

    assert width_px(Width.parse("20px"), grid("EPSG:32633", 0.25)) == 20
    assert width_px(Width.parse("5m"), grid("EPSG:32633", 0.25)) == 20
    assert width_px(Width.parse("5"), grid("EPSG:2154", 0.5)) == 10
    assert width_px(Width.parse("5 m"), grid("EPSG:2263", 1.0)) == pytest.approx(5 / 0.3048, rel=1e-5)
    metre = width_px(Width.parse("111.2m"), grid("EPSG:4326", 0.001))  # of a pixel of 111.2 m by 85.2 m
    assert metre == pytest.approx(1 / np.sqrt(np.cos(np.radians(40.05))), rel=1e-3)
    with pytest.raises(InputError, match="'wide' is not a width"):
        Width.parse("wide")


def test_seams_keep_to_what_orthos_show(tmp_path: Path) -> None:
    """Two turned orthos with corners of nodata: no step anywhere in the mosaic, though their rectangles say nothing."""
    rows, cols = np.mgrid[0:420, 0:640]
    files = []
    for i, (left, value) in enumerate(((0, 100), (300, 120))):
        u, v = cols - 300, rows - 210
        shown = (np.abs(u * 0.94 + v * 0.34) < 230) & (np.abs(v * 0.94 - u * 0.34) < 120)
        values = np.where(shown, value, 0).astype(np.uint8)[..., None]
        files.append(rig.write(tmp_path / f"{i}.tif", values, left, 25 * i, nodata=0))
    for blending, most in (
        (BlendOptions("multiband", Width(32, "px")), 2),
        (BlendOptions("feather", Width(32, "px")), 3),
    ):
        rig.run(files, tmp_path / "out.tif", blending=blending)
        values, valid = rig.read(tmp_path / "out.tif")
        inside = valid[:, 1:] & valid[:, :-1]
        step = np.abs(np.diff(values[..., 0].astype(int), axis=1))[inside]
        assert set(np.unique(values[valid])) >= {100, 110, 120}
        assert np.quantile(step, 0.9999) <= most, blending


def test_an_edited_seam_does_not_change_what_counts_as_usual():
    """The usual difference is measured halfway between centres, wherever seams run now: else an edit would be felt in
    every blended pixel of the mosaic."""
    from types import SimpleNamespace

    import shapely

    from geomosaic.mosaicking.blending import choice as noise

    outlines, seen = [shapely.box(0, 0, 60, 40), shapely.box(40, 0, 100, 40)], []

    def spread(_blender, i, j, xy):
        seen.append((i, j, tuple(xy[0])))
        return 1.0

    centres = SimpleNamespace(centres=[(30.0, 20.0), (70.0, 20.0)])
    for cut in (45.0, 58.0):
        regions = [shapely.box(0, 0, cut, 40), shapely.box(cut, 0, 100, 40)]
        blender = SimpleNamespace(seams=SimpleNamespace(polygons=regions, outlines=outlines), photos=centres)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(noise, "_difference_noise", spread)
            assert noise.image_noise(blender) == 1.0
    assert len(seen) == 6
    assert seen[:3] == seen[3:]
    assert {x for _, _, (x, _) in seen} == {50.0}
