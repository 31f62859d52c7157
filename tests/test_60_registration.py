"""Registration of overlaps: noise, light and thin overlaps are no misregistration, displaced ground is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from geomosaic.radiometry.registration import registered_part, registration

SHAPE = (70, 90)
ALL = np.ones(SHAPE, dtype=bool)


def ground(seed: int, width: float = 1.2) -> np.ndarray:
    """Fields, woods and houses about 100, larger than the views by 20 cells on each side."""
    rng = np.random.default_rng(seed)
    fine, broad = (gaussian_filter(rng.normal(size=(SHAPE[0] + 40, SHAPE[1] + 40)), s) for s in (width, 12))
    return 100 + 20 * fine / fine.std() + 10 * broad / broad.std()


def view(scene: np.ndarray, shift: tuple[int, int] = (0, 0), noise: float = 0.0, seed: int = 9) -> np.ndarray:
    col, row = 20 + shift[0], 20 + shift[1]
    seen = scene[row : row + SHAPE[0], col : col + SHAPE[1]]
    return (seen + np.random.default_rng(seed).normal(0, noise, SHAPE) if noise else seen)[..., None]


@pytest.mark.parametrize("noise", [0.0, 5.0, 20.0])
def test_registered_views_correlate_whatever_the_noise(noise: float) -> None:
    """20 grey values of noise in each view leave a correlation of 0.5 to be seen; corrected, it is about 1."""
    scene = ground(1)
    found = registration(view(scene, noise=noise), 1.4 * view(scene, noise=noise, seed=8) - 20, ALL)
    assert found.decided
    assert found.correlation == pytest.approx(1, abs=0.1 + noise / 100)
    assert not found.failed


@pytest.mark.parametrize("shift", [(6, 0), (0, -5), (9, 7), (-14, 3)])
def test_displaced_views_fail_and_tell_where_they_are_alike(shift: tuple[int, int]) -> None:
    scene = ground(2)
    found = registration(view(scene, noise=3), view(scene, shift, noise=3, seed=8), ALL)
    assert found.failed
    assert abs(found.correlation) < 0.3
    # The first view's ground lies that far back in the second, whose window was moved on.
    assert found.shift == (-shift[0], -shift[1])


def test_views_of_different_ground_fail_without_a_shift() -> None:
    found = registration(view(ground(3)), view(ground(4)), ALL)
    assert found.failed
    assert found.shift == (0, 0)


def test_a_displacement_of_one_cell_is_none() -> None:
    scene = ground(5)
    assert not registration(view(scene), view(scene, (1, 0)), ALL).failed


@pytest.mark.parametrize("resampled", [0.0, 0.6])
def test_without_texture_nothing_is_decided(resampled: float) -> None:
    """Water and snow: noise only, also noise that resampling has smeared over neighbouring cells."""
    rng = np.random.default_rng(6)
    for _ in range(20):
        a, b = (rng.normal(60, 3, SHAPE) for _ in range(2))
        if resampled:
            a, b = ((1 - resampled) * x + resampled * np.roll(x, 1, axis=(0, 1)) for x in (a, b))
        assert not registration(a[..., None], b[..., None], ALL).decided


def test_light_that_falls_to_opposite_sides_is_no_misregistration() -> None:
    """Snow with little texture, in the bright corner of one photo and the dark one of the next."""
    scene, x = 0.1 * (ground(7) - 100), np.linspace(-1, 1, SHAPE[1])
    a, b = (view(scene, noise=0.5, seed=s)[..., 0] + 200 * (1 + f * x - 0.1 * x**2) for s, f in ((1, 0.2), (2, -0.2)))
    assert not registration(a[..., None], b[..., None], ALL).failed


def test_moved_shadows_and_a_cloud_are_no_misregistration() -> None:
    scene, rng = ground(8), np.random.default_rng(8)
    a, b = view(scene, noise=2).copy(), view(scene, noise=2, seed=8).copy()
    for image in (a, b):
        for row, col in rng.integers(0, 60, (40, 2)):
            image[row : row + 3, col : col + 3] *= 0.6
    b[:, :25] = 230 + 5 * rng.normal(size=(SHAPE[0], 25, 1))
    assert not registration(a, b, ALL).failed


def test_a_thin_overlap_is_judged_as_a_wide_one() -> None:
    scene, seen = ground(9), np.zeros(SHAPE, dtype=bool)
    seen[30:36, 4:86] = True
    assert not registration(view(scene, noise=3), view(scene, noise=3, seed=8), seen).failed
    assert registration(view(scene, noise=3), view(scene, (6, 4), noise=3, seed=8), seen).failed


def test_flat_views_say_nothing() -> None:
    assert not registration(np.full((9, 9, 1), 7.0), np.full((9, 9, 1), 9.0), np.ones((9, 9), dtype=bool)).decided


def test_the_lawn_of_an_overlap_is_registered_where_its_crowns_are_not() -> None:
    """The left 40 % are lawns and roads, seen at one place; the rest are crowns, of which the views show two sides."""
    lawn, crowns = ground(6), [ground(7), ground(8)]
    left = np.arange(SHAPE[1]) < 0.4 * SHAPE[1]
    one, other = (
        np.where(left[None, :, None], gain * view(lawn, noise=3, seed=seed), view(each, noise=3))
        for gain, seed, each in zip((1.0, 0.7), (8, 9), crowns, strict=True)
    )
    assert registration(one, other, ALL).correlation < 0.5
    part = registered_part(one, other, ALL)
    assert part[:, left].mean() > 0.7
    # Windows of 15 cells reach over the edge by half their side.
    assert part[:, ~left].mean() < 0.1
    assert np.median(one[part] / other[part]) == pytest.approx(1 / 0.7, rel=0.02)


@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_no_part_of_displaced_views_is_registered_by_chance(seed: int) -> None:
    scene = ground(seed, 2.0)
    assert not registered_part(view(scene, noise=3), view(scene, (7, 3), noise=3, seed=8), ALL).any()
    assert not registered_part(view(scene), view(ground(seed + 50, 2.0)), ALL).any()
