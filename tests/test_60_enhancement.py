"""Enhancement: curves, local contrast, sharpening, pan-sharpening and hillshade against what they must be."""

from __future__ import annotations

import numpy as np
import pytest

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
from geomosaic.enhancement.raster import magnified, pan_model, pan_sharpened
from geomosaic.errors import InputError

RANDOM = np.random.default_rng(5)


def test_linear_and_gamma() -> None:
    curve = linear(100.0, 300.0)
    assert curve(np.array([50, 100, 200, 300, 900])).tolist() == [0, 0, 127.5, 255, 255]
    values = np.linspace(0, 1000, 5001)
    for gamma in (0.4, 1.0, 1.8, 2.2, 5.0):
        exact = 255 * (values / 1000) ** (1 / gamma)
        assert np.abs(linear(0, 1000, gamma)(values) - exact).max() < 0.5
    assert linear(7.0, 7.0)(np.array([6, 9])).tolist() == [0, 255]
    with pytest.raises(InputError):
        linear(0, 1, 0)


def test_percentiles_limit_the_stretch() -> None:
    values = np.arange(1001)
    assert percentile_limits(values, 2, 98) == (20, 980)
    with pytest.raises(InputError):
        percentile_limits(values, 98, 2)


def test_equalisation_makes_counts_even() -> None:
    values = RANDOM.normal(500, 40, 50_000).round()
    levels = equalised(values)(values)
    counts = np.histogram(levels, 8, (0, 255))[0]
    assert counts.min() > 0.9 * counts.mean()
    even = np.repeat(np.arange(256), 10)
    assert np.abs(equalised(even)(even) - even).max() < 1e-9  # what is even stays
    assert np.all(np.diff(equalised(values)(np.unique(values))) > 0)  # order is kept
    assert equalised(np.full(5, 3.0))(np.array([3.0])).tolist() == [127.5]


def test_clahe_of_limit_one_changes_nothing() -> None:
    """Limit 1 changes nothing; above, a dim corner gains contrast; windows are treated as in the whole."""
    rows, cols = 160, 200
    dim = 100 + 4 * np.sin(np.arange(cols) / 3)[None] * np.ones((rows, 1)) + 60 * (np.arange(rows) / rows)[:, None]
    seen = np.ones((rows, cols), np.uint8)
    y, x = (np.arange(rows) + 0.5) / rows, (np.arange(cols) + 0.5) / cols
    assert np.abs(Clahe.of(dim, seen, 1.0)(dim, y, x) - dim).max() < 1.0
    clahe = Clahe.of(dim, seen, 4.0)
    strong = clahe(dim, y, x)
    assert strong[40].std() > 1.5 * dim[40].std()
    assert strong.min() >= 0
    assert strong.max() <= 255
    assert np.array_equal(clahe(dim[30:90, 50:150], y[30:90], x[50:150]), strong[30:90, 50:150])
    # Where one part ends the next begins: there are no steps.
    flat = np.full((rows, cols), 120.0)
    mixed = clahe(flat, y, x)
    assert np.abs(np.diff(mixed, axis=0)).max() < 12
    # Parts without pixels leave what they get.
    empty = Clahe.of(dim, np.zeros_like(seen), 4.0)
    assert np.abs(empty(dim, y, x) - dim).max() < 1e-9


def test_sharpening_gains_by_its_formula() -> None:
    """A sine wave gains by 1 + amount (1 - blur), colours keep their differences, flat ground and blanks stay."""
    cols = np.arange(400)
    wave = 120 + 40 * np.sin(2 * np.pi * cols / 20)
    rgb = np.repeat(np.repeat(wave[None, :, None], 40, 0), 3, 2)
    rgb = np.clip(rgb + np.array([10, 0, -10]), 0, 255).round().astype(np.uint8)
    made = sharpened(rgb, np.ones((40, 400), np.uint8), 2.0, 1.0)
    gain = 1 + 1.0 * (1 - np.exp(-0.5 * (2 * np.pi / 20 * 2.0) ** 2))
    amplitude = (luminance(made)[20, 100:300].max() - luminance(made)[20, 100:300].min()) / 2
    assert amplitude == pytest.approx(40 * gain, abs=1.2)
    assert np.abs((made[..., 0].astype(int) - made[..., 1]) - 10).max() <= 1
    flat = np.full((30, 30, 3), 99, np.uint8)
    holes = np.ones((30, 30), np.uint8)
    holes[10:20, 10:20] = 0
    dark = np.where(holes[..., None] > 0, flat, 0).astype(np.uint8)
    assert np.array_equal(sharpened(dark, holes, 2.0, 2.0), dark)
    assert np.array_equal(with_luminance(flat, luminance(flat), luminance(flat) + 5), flat + 5)


def scene(size: int = 240, factor: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sharp bands of four, the same as means of blocks, and a pan band that sums the sharp ones up."""
    y, x = np.mgrid[0:size, 0:size] / size
    detail = RANDOM.normal(0, 1, (size, size))
    detail = sum(np.roll(detail, k, 0) + np.roll(detail, k, 1) for k in range(3))
    base = np.stack([300 + 200 * np.sin(5 * x + k) * np.cos(4 * y + k) for k in range(4)], axis=2)
    sharp = base + detail[..., None] * np.array([12.0, 10.0, 14.0, 6.0])
    coarse = sharp.reshape(size // factor, factor, size // factor, factor, 4).mean(axis=(1, 3))
    return sharp, coarse, sharp @ np.array([0.2, 0.3, 0.4, 0.1]) + 25.0


@pytest.mark.parametrize("method", ["regression", "brovey", "weighted"])
def test_pan_sharpening_finds_the_truth(method: str) -> None:
    """The weights of the pan band come back, and the sharp bands are nearer to the truth than the magnified ones."""
    sharp, coarse, pan = scene()
    small = pan.reshape(60, 4, 60, 4).mean(axis=(1, 3))
    model = pan_model(method, coarse.reshape(-1, 4), small.ravel())
    assert model.weights == pytest.approx([0.2, 0.3, 0.4, 0.1], abs=1e-9)
    assert model.offset == pytest.approx(25.0, abs=1e-6)
    assert model.r2 == pytest.approx(1.0)
    places = (np.arange(240) + 0.5) / 4
    near = magnified(coarse, places, places)
    made = pan_sharpened(model, near, pan)
    inner = slice(8, -8), slice(8, -8)
    before = np.sqrt(((near - sharp)[inner] ** 2).mean(axis=(0, 1)))
    after = np.sqrt(((made - sharp)[inner] ** 2).mean(axis=(0, 1)))
    assert (after[:3] < 0.55 * before[:3]).all()
    # What is seen at the resolution of the bands stays: Wald's first property.
    again = made.reshape(60, 4, 60, 4, 4).mean(axis=(1, 3))
    assert np.sqrt(((again - coarse)[3:-3, 3:-3] ** 2).mean()) < 6.0
    if method == "regression":  # the gains leave the synthetic band of the result at the pan band: Σ w g = 1
        assert (made @ model.weights + model.offset)[inner] == pytest.approx(pan[inner], abs=1e-6)


def test_regression_takes_out_what_the_pan_band_adds() -> None:
    """Gains of the detail: bands that follow the synthetic one twice as much get twice the detail."""
    base = RANDOM.normal(100, 20, 4000)
    bands = np.column_stack([base, 2 * base])
    model = pan_model("regression", bands + RANDOM.normal(0, 1e-3, bands.shape), base)
    assert model.gains == pytest.approx([1, 2], rel=0.02)
    with pytest.raises(InputError, match="too little"):
        pan_model("regression", bands[:5], base[:5])
    with pytest.raises(InputError, match="no method"):
        pan_model("ihs", bands, base)


def test_magnification_is_cubic_convolution() -> None:
    """Exact on what is quadratic, and on the pixels themselves."""
    y, x = np.mgrid[0:30, 0:40] + 0.5
    values = (3 + 2 * x + 0.5 * y + 0.02 * x * x)[..., None]
    rows, cols = np.linspace(5, 25, 41), np.linspace(5, 35, 61)
    made = magnified(values, rows, cols)[..., 0]
    exact = 3 + 2 * cols[None] + 0.5 * rows[:, None] + 0.02 * cols[None] ** 2
    assert np.abs(made - exact).max() < 1e-9
    assert np.array_equal(magnified(values, y[:, 0], x[0]), values)


@pytest.mark.parametrize("azimuth", [0.0, 45.0, 225.0, 315.0])
def test_hillshade_of_a_plane(azimuth: float) -> None:
    """The cosine between the sun and the normal, by vectors; a slope turned away is dark."""
    row, col = np.mgrid[0:12, 0:15]
    east, north = 0.3, -0.2
    z = east * 5.0 * col - north * 4.0 * row
    normal = np.array([-east, -north, 1]) / np.sqrt(1 + east**2 + north**2)
    a, h = np.radians(azimuth), np.radians(40.0)
    sun = np.array([np.sin(a) * np.cos(h), np.cos(a) * np.cos(h), np.sin(h)])
    assert hillshade(z, (5.0, 4.0), azimuth, 40.0) == pytest.approx(np.full(z.shape, max(0.0, normal @ sun)))
    assert hillshade(np.zeros((5, 5)), (1, 1), azimuth, 40.0) == pytest.approx(np.full((5, 5), np.sin(h)))
    steep = -100.0 * (np.sin(a) * col - np.cos(a) * row)
    assert hillshade(-steep, (1, 1), azimuth, 40.0).max() == 0


def test_blend_with_a_hillshade() -> None:
    rgb = np.full((2, 3, 3), 100, np.uint8)
    shade = np.array([[0.7, 0.35, np.nan], [1.0, 0.0, 0.7]])
    made = shaded(rgb, shade, 0.7, 1.0)[..., 0]
    assert made.tolist() == [[100, 50, 100], [143, 0, 100]]
    assert np.array_equal(shaded(rgb, shade, 0.7, 0.0), rgb)
    assert shaded(rgb, shade, 0.7, 0.5)[0, 1, 0] == 75
    hole = np.zeros((5, 5))
    hole[2, 2] = np.nan
    assert np.isnan(hillshade(hole, (1, 1))[1:4, 1:4]).all()
