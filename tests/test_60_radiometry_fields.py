"""Known gain, offset, gamma, falloff and hotspot of every photo come back, but for what overlaps cannot tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geomosaic.radiometry.colour_model import ColourModel, select_terms, solve_colour_model
from geomosaic.radiometry.gain_offset import solve_gain_offset
from geomosaic.radiometry.normal_equations import ColourSetting
from geomosaic.radiometry.overlaps import Overlap, PairedSamples, paired_samples

ROWS, COLS = 3, 5
HALF = np.array([0.8, 0.6])  # of a footprint, in half diagonals
STEP = np.array([0.64, 0.84])  # 60 % forward, 30 % side overlap
R = 255.0


def ground(xy: np.ndarray) -> np.ndarray:
    """Radiance 15 .. 170 over the map, with detail everywhere."""
    x, y = xy.T
    wave = np.sin(7 * x + 2 * np.sin(3 * y)) + np.sin(5 * y - 4 * x) + np.sin(23 * x + 1) * np.sin(19 * y)
    return np.asarray(85 + 23 * wave)[:, None] * np.array([1.1, 1.0, 0.9])


class Cameras:
    """What the photos of a block do to the light."""

    def __init__(self, seed: int = 1, falloff: float = 0.0, hotspot: float = 0.0, bent: bool = False) -> None:
        rng = np.random.default_rng(seed)
        self.count = ROWS * COLS
        self.centre = np.array([(c, r) for r in range(ROWS) for c in range(COLS)]) * STEP
        self.gain = np.exp(rng.normal(0, 0.12, (self.count, 3)))
        self.dark = rng.uniform(-4, 4, (self.count, 3))
        self.gamma = np.exp(rng.normal(0, 0.25, (self.count, 3))) if bent else np.ones((self.count, 3))
        self.falloff, self.hotspot = falloff, hotspot

    def field(self, offset: np.ndarray) -> np.ndarray:
        rho2 = (offset**2).sum(axis=1)
        bump = np.exp(-((offset - (0.25, 0.3)) ** 2).sum(axis=1) / (2 * 0.25**2))
        return np.asarray((1 - self.falloff * rho2 * (0.7 + 0.3 * rho2)) * (1 + self.hotspot * bump))[:, None]

    def shown(self, index: int, xy: np.ndarray) -> np.ndarray:
        """Value of the ground at map places."""
        light = self.gain[index] * self.field(xy - self.centre[index]) * ground(xy)
        return np.asarray(R * (light / R) ** (1 / self.gamma[index]) - self.dark[index])

    def overlaps(self, samples: int = 500, noise: float = 0.0) -> list[Overlap]:
        rng, pairs = np.random.default_rng(3), []
        for i in range(self.count):
            for j in range(i + 1, self.count):
                low = np.maximum(self.centre[i], self.centre[j]) - HALF
                high = np.minimum(self.centre[i], self.centre[j]) + HALF
                if (high - low > 0.05).all():
                    xy = rng.uniform(low, high, (samples, 2))
                    xy = xy[np.lexsort(xy.T)]
                    a, b = (self.shown(k, xy) + noise * rng.normal(size=(samples, 3)) for k in (i, j))
                    pairs.append(Overlap(i, j, a, b, xy))
        return pairs

    def places(self, index: int, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return cells - self.centre[index], cells - self.centre[index]

    def error(self, solved: ColourModel) -> np.ndarray:
        """RMS of corrected values about true radiance, in parts of its mean, per band.

        Without what overlaps cannot tell: a scale and an offset of all images, a gamma, and, where light changes across
        footprints, a ramp over the block, which gains and a trend make alike.
        """
        rng, shown, true, where = np.random.default_rng(8), [], [], []
        for i in range(self.count):
            xy = self.centre[i] + rng.uniform(-HALF, HALF, (400, 2))
            image, view = self.places(i, xy)
            shown.append(solved.correct(i, self.shown(i, xy), image, view))
            true.append(ground(xy))
            where.append(xy)
        out = []
        for m in range(3):
            x, y = np.concatenate(shown)[:, m], np.concatenate(true)[:, m]
            same = [np.ones_like(x), x]
            same += [x**2, x**3] if (self.gamma != 1).any() else []
            same += [x * column for column in np.concatenate(where).T] if self.hotspot else []
            fit = np.stack(same, axis=1)
            out.append(np.sqrt(np.mean((fit @ np.linalg.lstsq(fit, y, rcond=None)[0] - y) ** 2)) / y.mean())
        return np.array(out)


def solved(cameras: Cameras, terms: set[str], noise: float = 0.0) -> tuple[ColourModel, PairedSamples]:
    pairs = cameras.overlaps(noise=noise)
    start = solve_gain_offset(cameras.count, 3, pairs)
    views = paired_samples(pairs, cameras.places, 15_000)
    assert views is not None
    setting = ColourSetting(cameras.count, 1, np.zeros(cameras.count, dtype=np.int64), frozenset(terms), R)
    return solve_colour_model(views, setting, start.gain, start.offset), views


CASES = {
    "gain and offset": ({}, set()),
    "falloff": ({"falloff": 0.4}, {"vignetting"}),
    "gamma": ({"bent": True}, {"gamma"}),
    "hotspot": ({"hotspot": 0.25}, {"trend", "hotspot"}),
    "all": ({"falloff": 0.4, "hotspot": 0.2, "bent": True}, {"vignetting", "trend", "hotspot", "gamma"}),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("noise", [pytest.param(0.0, marks=pytest.mark.slow), 1.0])
def test_known_cameras_come_back(name: str, noise: float) -> None:
    given, terms = CASES[name]
    cameras = Cameras(**given)
    found, _ = solved(cameras, terms, noise)
    plain, _ = solved(cameras, set(), noise)
    error, before = cameras.error(found), cameras.error(plain)
    assert (error < 0.01).all(), (
        f"{np.round(100 * error, 3)} %, with gain and offset alone {np.round(100 * before, 2)} %"
    )
    if terms:
        assert (before > 0.01).all(), f"{np.round(100 * before, 2)} %: the case shows nothing"


@pytest.mark.parametrize(
    ("given", "wanted", "unwanted"),
    [
        ({}, set(), {"vignetting", "trend", "hotspot", "haze", "gamma", "dodging"}),
        ({"falloff": 0.3}, {"vignetting"}, {"hotspot", "haze", "gamma", "dodging"}),
        pytest.param({"hotspot": 0.25}, {"trend", "hotspot"}, {"haze", "gamma", "dodging"}, marks=pytest.mark.slow),
    ],
)
def test_what_is_not_there_is_not_chosen(given: dict[str, float], wanted: set[str], unwanted: set[str]) -> None:
    cameras = Cameras(**given)
    pairs = cameras.overlaps(noise=2.0)
    start = solve_gain_offset(cameras.count, 3, pairs)
    views = paired_samples(pairs, cameras.places, 8000)
    assert views is not None
    setting = ColourSetting(cameras.count, 1, np.zeros(cameras.count, dtype=np.int64), frozenset(), R)
    terms, trials = select_terms(views, setting, start.gain, start.offset)
    said = [(trial.terms, round(trial.held_back_rms, 4)) for trial in trials]
    assert wanted <= terms, said
    assert not unwanted & terms, said


def test_dodging_takes_out_what_each_photo_has_of_its_own() -> None:
    class Blotched(Cameras):
        def shown(self, index: int, xy: np.ndarray) -> np.ndarray:
            turn = 2 * np.pi * np.random.default_rng(index).random(2)
            blot = np.sin(3 * (xy - self.centre[index]) + turn).prod(axis=1)
            return np.asarray(super().shown(index, xy) * (1 + 0.1 * blot)[:, None])

    cameras = Blotched()
    pairs = cameras.overlaps(noise=1.0)
    start = solve_gain_offset(cameras.count, 3, pairs)
    views = paired_samples(pairs, cameras.places)
    assert views is not None
    setting = ColourSetting(cameras.count, 1, np.zeros(cameras.count, dtype=np.int64), frozenset({"dodging"}), R)
    plain = solve_colour_model(views, replace(setting, terms=frozenset()), start.gain, start.offset)
    found = solve_colour_model(views, setting, start.gain, start.offset)
    before, after = cameras.error(plain), cameras.error(found)
    assert (before > 0.035).all()
    assert (after < 0.6 * before).all(), f"{before} before, {after} after"


def cloud(values: np.ndarray, index: int, xy: np.ndarray, offset: np.ndarray) -> None:
    """A quarter of what one photo shows is a white cloud."""
    if index == 7:
        values[np.hypot(*(offset - (0.2, 0.1)).T) < 0.4] = 240.0


def cloud_shadow(values: np.ndarray, index: int, xy: np.ndarray, offset: np.ndarray) -> None:
    """The same of three photos lies in the shadow of one."""
    if index in (3, 7, 11):
        values[np.hypot(*(offset - (0.2, 0.1)).T) < 0.4] *= 0.45


def house_shadows(values: np.ndarray, index: int, xy: np.ndarray, offset: np.ndarray) -> None:
    """A seventh of the ground lies in shadows, which move from strip to strip, as the sun does."""
    strip, (x, y) = index // COLS, xy.T
    values[np.sin(40 * (x + 0.03 * strip)) * np.sin(40 * (y + 0.05 * strip)) > 0.6] *= 0.4


def water(values: np.ndarray, index: int, xy: np.ndarray, offset: np.ndarray) -> None:
    """A lake under several photos is dark, but for the sun in it, which each photo has at the same place in itself."""
    lake = np.hypot(xy[:, 0] - 1.3, 1.2 * (xy[:, 1] - 0.8)) < 0.55
    glint = 100 * np.exp(-((offset - (0.3, 0.3)) ** 2).sum(axis=1) / (2 * 0.3**2))
    values[lake] = (20 + glint)[lake, None]


@pytest.mark.parametrize("disturb", [cloud, cloud_shadow, house_shadows, water])
def test_clouds_shadows_and_water_count_for_nothing_by_themselves(disturb) -> None:
    """No mask is given. Clean samples are within 0.1 %."""
    cameras, pairs, touched, seen = Cameras(falloff=0.3), [], 0, 0
    for pair in cameras.overlaps(noise=1.0):
        a, b = pair.a.copy(), pair.b.copy()
        for values, index in ((a, pair.first), (b, pair.second)):
            disturb(values, index, pair.cells, pair.cells - cameras.centre[index])
        touched += int(((a != pair.a) | (b != pair.b)).any(axis=1).sum())
        seen += len(a)
        pairs.append(Overlap(pair.first, pair.second, a, b, pair.cells))
    assert touched > 0.02 * seen, "the case shows nothing"
    start = solve_gain_offset(cameras.count, 3, pairs)
    views = paired_samples(pairs, cameras.places)
    assert views is not None
    setting = ColourSetting(cameras.count, 1, np.zeros(cameras.count, dtype=np.int64), frozenset({"vignetting"}), R)
    error = cameras.error(solve_colour_model(views, setting, start.gain, start.offset))
    assert (error < 0.01).all(), f"{np.round(100 * error, 2)} %, {touched / seen:.1%} of the samples disturbed"


@pytest.mark.parametrize("haze", [pytest.param(8.0, marks=pytest.mark.slow), 16.0])
def test_haze_that_grows_with_the_view_angle(haze: float) -> None:
    """Path radiance is added, and more of it in blue. Fields multiply: they take most of it, not all."""

    class Hazy(Cameras):
        def shown(self, index: int, xy: np.ndarray) -> np.ndarray:
            path = haze * np.random.default_rng(index).uniform(0.7, 1.3) * np.array([0.6, 0.8, 1.2])
            return np.asarray(super().shown(index, xy) + path * ((xy - self.centre[index]) ** 2).sum(1)[:, None])

    cameras = Hazy()
    found, _ = solved(cameras, {"vignetting", "haze"}, noise=1.0)
    field, _ = solved(cameras, {"vignetting"}, noise=1.0)
    plain, _ = solved(cameras, set(), noise=1.0)
    error, middle, before = cameras.error(found), cameras.error(field), cameras.error(plain)
    said = f"{100 * before} % with gain and offset, {100 * middle} % with a field, {100 * error} % with haze"
    assert (error < 0.005).all(), said
    assert (error < 0.5 * middle).all(), said
    pairs = cameras.overlaps(noise=1.0)
    start = solve_gain_offset(cameras.count, 3, pairs)
    views = paired_samples(pairs, cameras.places, 6000)
    assert views is not None
    setting = ColourSetting(cameras.count, 1, np.zeros(cameras.count, dtype=np.int64), frozenset(), R)
    terms, trials = select_terms(views, setting, start.gain, start.offset)
    assert "haze" in terms, [(trial.terms, round(trial.held_back_rms, 4)) for trial in trials]
