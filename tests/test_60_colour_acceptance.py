"""What a colour balance is accepted for, and its radiometric change, with exposures and light that are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mosaic_rig as rig
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from geomosaic.geo.grid import Window
from geomosaic.mosaicking.colour.acceptance import (
    CLEARLY_BETTER,
    added_spread,
    held_out_ratio,
    misregistration_notes,
    registered_overlaps,
)
from geomosaic.mosaicking.colour.exposure import exposure_balance
from geomosaic.radiometry.gain_offset import solve_gain_offset
from geomosaic.radiometry.overlaps import Overlap, Overlaps, Thumbnail
from geomosaic.radiometry.radiometric_change import RadiometricChange, radiometric_change

SIDE, STEP, COUNT = 60, 24, 6


def ground(seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    size = (SIDE + 40, STEP * COUNT + SIDE + 40)
    fine, broad = (gaussian_filter(rng.normal(size=size), s) for s in (1.2, 15))
    return np.asarray(110 + 15 * fine / fine.std() + 15 * broad / broad.std())


def overlaps(
    gain: np.ndarray, off: dict[int, tuple[int, int]] | None = None, scene: np.ndarray | None = None, noise: float = 1.0
) -> list[Overlap]:
    """A strip of photos of known gains, some of which lie (columns, rows) of cells beside their places."""
    scene, rng = ground() if scene is None else scene, np.random.default_rng(2)
    windows = [Window(STEP * i, 0, SIDE, SIDE) for i in range(COUNT)]
    found = Overlaps(windows, (0, 255))
    for i, window in enumerate(windows):
        col, row = (off or {}).get(i, (0, 0))
        seen = scene[20 + row : 20 + row + SIDE, 20 + window.col + col : 20 + window.col + col + SIDE]
        values = (gain[i] * seen + rng.normal(0, noise, seen.shape)).astype(np.float32)
        found.add(i, Thumbnail(window, values[..., None], np.ones(seen.shape, dtype=np.uint8)))
    return found.found


GAINS = np.exp(np.random.default_rng(3).normal(0, 0.12, COUNT))


def gain_error(pairs: list[Overlap]) -> float:
    found = np.log(solve_gain_offset(COUNT, 1, pairs).gain[:, 0] * GAINS)
    return float(np.ptp(found))


def test_registered_overlaps_are_all_used_and_give_the_gains_back() -> None:
    pairs = overlaps(GAINS)
    good, bad = registered_overlaps(pairs)
    assert (len(good), bad) == (len(pairs), [])
    assert gain_error(good) < 0.02
    assert held_out_ratio(COUNT, 1, good) < 0.2


def test_one_photo_beside_its_place_is_left_out_and_harms_no_other() -> None:
    good, bad = registered_overlaps(overlaps(GAINS, {2: (9, -8)}))
    assert {(p.first, p.second) for p in bad} == {(0, 2), (1, 2), (2, 3), (2, 4)}
    solved = solve_gain_offset(COUNT, 1, good)
    assert solved.gain[2, 0] == 1.0
    others = np.log(solved.gain[[0, 1, 3, 4, 5], 0] * GAINS[[0, 1, 3, 4, 5]])
    # 0 and 1 are joined to the others by 1 and 3 alone.
    assert np.ptp(others) < 0.03


def test_all_photos_beside_their_places_give_no_gain() -> None:
    rng = np.random.default_rng(4)
    off = {i: (int(rng.integers(-15, 15)) + 2 * i, int(18 * (-1) ** i)) for i in range(COUNT)}
    pairs = overlaps(np.ones(COUNT), off)
    good, bad = registered_overlaps(pairs)
    assert not good
    assert len(bad) == len(pairs)
    wrong = solve_gain_offset(COUNT, 1, pairs)
    assert np.ptp(np.log(wrong.gain)) > 0.1  # the test can fail


def test_water_and_snow_are_balanced_by_their_means() -> None:
    """Nothing but noise correlates: no overlap is refused, and the levels come together."""
    pairs = overlaps(GAINS, scene=np.full((SIDE + 40, STEP * COUNT + SIDE + 40), 90.0), noise=2.0)
    good, bad = registered_overlaps(pairs)
    assert not bad
    assert np.median([pair.a.std() for pair in good]) < 3
    solved = solve_gain_offset(COUNT, 1, good)
    level = solved.gain[:, 0] * 90 * GAINS + solved.offset[:, 0]
    assert np.ptp(level) < 0.01 * 90
    assert np.ptp(90 * GAINS) > 0.2 * 90
    assert held_out_ratio(COUNT, 1, good) < 0.3


def test_undecided_overlaps_are_not_trusted_where_most_others_are_misregistered() -> None:
    pairs = overlaps(GAINS, {i: (0, 18 * (-1) ** i) for i in range(COUNT)})
    flat = replace(pairs[0], registration=overlaps(GAINS, scene=np.full((100, 244), 90.0))[0].registration)
    assert not flat.registration.decided
    beside = [pair for pair in pairs if pair.registration.failed]
    assert registered_overlaps([*beside, flat])[0] == []
    assert registered_overlaps([*overlaps(GAINS), flat])[1] == []


def test_the_note_of_misregistered_radar_says_that_two_sides_never_correlate() -> None:
    pair = next(
        one for one in overlaps(GAINS, {i: (0, 18 * (-1) ** i) for i in range(COUNT)}) if one.registration.failed
    )
    radar, photo = SimpleNamespace(sensor_positions=len), SimpleNamespace()
    for model, told in ((radar, True), (photo, False)):
        scenes = [SimpleNamespace(name=f"{i}.tif", model=model) for i in range(COUNT)]
        (note,) = misregistration_notes(SimpleNamespace(scenes=scenes), [pair], 5, 2.0)  # type: ignore[arg-type]
        assert note.startswith("misregistered, 1 of 5 overlaps")
        assert ("radar from two sides" in note) == told


def test_photos_that_need_nothing_are_no_better_with_gains() -> None:
    assert held_out_ratio(COUNT, 1, overlaps(np.ones(COUNT), noise=3.0)) > CLEARLY_BETTER
    assert held_out_ratio(COUNT, 1, []) == 1.0


def test_exposures_make_levels_unlike_and_their_gains_alike() -> None:
    level = 100 * GAINS[:, None]
    assert added_spread(level, level / GAINS[:, None]) == 0.0
    assert added_spread(np.full((COUNT, 1), 100.0), level) == pytest.approx(np.log(GAINS).std())
    assert added_spread(np.full((COUNT, 1), np.nan), level) == 0.0


def block(side: int = 40) -> tuple[np.ndarray, np.ndarray]:
    places = np.argwhere(np.ones((side, side)))[:, ::-1]
    return places, np.random.default_rng(5).integers(40, 200, (len(places), 3)).astype(np.uint8)


def test_no_change_is_no_harm() -> None:
    places, values = block()
    assert radiometric_change(places, values, values.astype(float), np.ones((4, 3)), (0, 255)) == RadiometricChange()
    assert (
        radiometric_change(places[:0], values[:0], values[:0].astype(float), np.ones((4, 3)), (0, 255))
        == RadiometricChange()
    )


def test_a_ramp_of_gains_is_a_trend_and_light_across_each_photo_is_none() -> None:
    places, values = block()
    x = places[:, :1] / 39
    ramp = radiometric_change(places, values, values * (0.8 + 0.4 * x), np.ones((4, 3)), None)
    assert ramp.trend_percent == pytest.approx(50, abs=1)
    saw = radiometric_change(places, values, values * (0.8 + 0.4 * (8 * x % 1)), np.ones((4, 3)), None)
    assert saw.trend_percent < 15


def test_clipping_counts_what_was_not_at_an_end_before() -> None:
    places, values = block()
    values[:100], values[100:150, 1] = 255, 0
    change = radiometric_change(places, values, values + 80.0, np.ones((4, 3)), (0, 255))
    lost = ((values < 255) & (values >= 175)).any(axis=1).mean()
    assert change.clipped_percent == pytest.approx(100 * lost, abs=1e-3)
    assert radiometric_change(places, values, values + 80.0, np.ones((4, 3)), None).clipped_percent == 0
    assert radiometric_change(places, values, values + 80.0, np.ones((4, 3)), None).rms_difference == pytest.approx(80)


def test_the_spread_of_gains_is_that_of_the_worst_band() -> None:
    places, values = block()
    gain = np.exp([[0.0, 0.1], [0.0, -0.1]])
    assert radiometric_change(places, values, values.astype(float), gain, None).gain_spread_percent == pytest.approx(10)


LEVELS = (0.5, 1.1, 0.6, 0.55, 1.2, 1.1, 0.6, 0.9)


def strip(folder: Path, *, light: bool) -> tuple[list[Path], np.ndarray]:
    """Photos of ground darker and brighter by turns, each exposed for its own, or of even ground with light from the
    right; and the gains that undo the exposures."""
    ground, wide = rig.scene(100, 64 * 5 + 160), 160
    if not light:
        at = np.linspace(0, ground.shape[1], len(LEVELS))
        ground = ground * np.interp(np.arange(ground.shape[1]), at, LEVELS)[:, None]
    rng, files, exposure = np.random.default_rng(1), [], []
    for i in range(6):
        part = ground[:, 64 * i : 64 * i + wide]
        exposure.append(1.0 if light else 90 / np.median(part))
        part = part * (0.72 + 0.36 * np.arange(wide)[:, None] / wide if light else exposure[-1])
        values = np.clip(part + rng.normal(0, 2, part.shape), 1, 255).astype(np.uint8)
        files.append(rig.write(folder / f"p{i}.tif", values, 64 * i))
    return files, 1 / np.array(exposure)


def test_light_that_falls_across_each_photo_gives_no_gains(tmp_path: Path) -> None:
    files, _ = strip(tmp_path, light=True)
    made = rig.run(files, tmp_path / "out.tif", balance=True, colour="gain").balance
    assert made is not None
    assert (made.gain == 1.0).all()
    assert "light that falls across each of them looks like exposure" in made.notes[-1]


def test_exposures_for_ground_of_its_own_keep_their_gains_though_photos_differ_more_with_them(tmp_path: Path) -> None:
    files, truth = strip(tmp_path, light=False)
    made = rig.run(files, tmp_path / "out.tif", balance=True, colour="gain").balance
    assert made is not None
    ratio = made.gain.mean(axis=1) / truth
    assert ratio / ratio.mean() == pytest.approx(1.0, abs=0.08)
    assert np.log(made.gain).std() > 0.15


def tagged(folder: Path, seconds: np.ndarray) -> list[str]:
    """Small photos that record their exposure time."""
    plain = np.zeros((8, 8, 1), dtype=np.uint8)
    tags = {"EXIF_FNumber": "(2.8)", "EXIF_ISOSpeedRatings": "100"}
    return [
        str(rig.write(folder / f"e{i}.tif", plain, tags={**tags, "EXIF_ExposureTime": f"({time:.6f})"}))
        for i, time in enumerate(seconds.tolist())
    ]


def test_recorded_exposures_give_the_gains_of_a_tone_curve(tmp_path: Path) -> None:
    """Values grow with the power 0.45 of the light; the ratios of single overlaps are off by 4 % besides."""
    seconds = 0.004 * np.array([1.0, 0.7, 0.9, 0.5, 0.6, 0.8])
    shown = seconds**0.45 * np.exp(np.random.default_rng(5).normal(0, 0.02, COUNT)) / 0.004**0.45
    made = exposure_balance(tagged(tmp_path, seconds), 1, overlaps(shown))
    assert made is not None
    assert made.gain[:, 0] == pytest.approx((seconds / np.exp(np.log(seconds).mean())) ** -0.45, rel=0.03)
    assert np.log(made.gain).mean() == pytest.approx(0.0, abs=1e-9)
    assert made.after < 0.5 * made.before


def test_overlaps_that_do_not_follow_the_exposures_give_no_gains(tmp_path: Path) -> None:
    seconds = 0.004 * np.array([1.0, 0.7, 0.9, 0.5, 0.6, 0.8])
    files, even = tagged(tmp_path, seconds), np.ones(COUNT)
    assert exposure_balance(files, 1, overlaps(even)) is None
    assert exposure_balance(files, 1, overlaps((seconds / 0.004) ** -0.45)) is None
    assert exposure_balance([str(rig.write(tmp_path / "n.tif", np.zeros((8, 8, 1), np.uint8)))], 1, []) is None
