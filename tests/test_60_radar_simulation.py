"""Radar scenes found by their simulation: a speckled scene made apart, moved by known pixels, from a finer ground."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import rasterio
from pyproj import CRS
from radar_hills_rig import Facets, Land
from sar_rig import Scene

import geomosaic as gm
from geomosaic.cli.main import run
from geomosaic.errors import InputError
from geomosaic.inputs.build import build_block
from geomosaic.products.simulation import SimulationMatch

MOVED = np.array([20.0, 12.0])


@dataclass(frozen=True)
class Downs(Land):
    """Hills everywhere, without layover or shadow, and a roughness finer than the DEM."""

    noise: ClassVar[float] = 0.0
    step: ClassVar[float] = 4.0

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return self.coarse(x, y) + 0.6 * np.sin(x / 7.0) * np.sin(y / 9.0)

    def coarse(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, v = x - self.middle[0], y - self.middle[1]
        out = np.full(np.shape(x), 200.0)
        random = np.random.default_rng(12)
        for _ in range(9):
            length, angle, phase = random.uniform(350.0, 1100.0), *random.uniform(0.0, 2 * np.pi, 2)
            out = out + 0.018 * length * np.sin(2 * np.pi * (u * np.cos(angle) + v * np.sin(angle)) / length + phase)
        return out

    def sent(self, facets: Facets) -> np.ndarray:
        return facets.size * facets.cosine**2

    def speckled(self, seed: int, looks: int) -> np.ndarray:
        """Amplitudes of the scene from facets; nothing of the program takes part."""
        half = 5.2 * self.scene.size[0], 6.2 * self.scene.size[1]
        mean = np.zeros(self.scene.size[::-1])
        for low in np.arange(-half[1], half[1], 2000.0):
            facets = self.facets(half, self.step, (low, min(low + 2000.0, half[1])))
            moved = replace(facets, places=facets.places + MOVED)
            mean += moved.image(self.sent(facets), self.scene.size)
        mean += self.noise * mean.mean()
        return np.sqrt(mean * np.random.default_rng(seed).gamma(looks, 1.0 / looks, mean.shape))


class Peaks(Downs):
    """Downs with peaks that have layover and shadow, where the scene shows thermal noise; whole, low amplitudes."""

    noise = 0.05
    step = 6.0

    def coarse(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        out = super().coarse(x, y)
        for east, north in ((-500.0, 300.0), (-100.0, -400.0), (500.0, 200.0)):
            out = out + 330.0 * np.exp(
                -((x - self.middle[0] - east) ** 2 + (y - self.middle[1] - north) ** 2) / (2 * 110.0**2)
            )
        return out

    def sent(self, facets: Facets) -> np.ndarray:
        return np.where(self.shaded(facets, 440.0, 20.0) | (facets.cosine < 0.0), 0.0, super().sent(facets))

    def speckled(self, seed: int, looks: int) -> np.ndarray:
        amplitude = super().speckled(seed, looks)
        return np.round(20.0 * amplitude / np.median(amplitude))


def written(folder: Path, scene: Scene, looks: int, kind: type[Downs] = Downs) -> tuple[Downs, Path]:
    """Scene of so many looks, its metadata, and a DEM of nodes every 10 m without the roughness."""
    land = kind.of(scene)
    land.write_dem(folder, 7.0 * max(scene.size) + 400.0)
    amplitude = land.speckled(1, looks).astype(np.float32)
    with rasterio.open(
        folder / "scene.tif",
        "w",
        driver="GTiff",
        width=amplitude.shape[1],
        height=amplitude.shape[0],
        count=1,
        dtype="float32",
    ) as file:
        file.write(amplitude, 1)
    scene.write(folder, "scene")
    return land, folder / "scene.tif"


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[gm.Scene, Downs]:
    """A sixteenth of a megapixel, four looks as ground range products have."""
    folder = tmp_path_factory.mktemp("small")
    land, path = written(folder, Scene(size=(260, 250)), 4)
    return gm.Scene(path, "sar", dem=folder / "dem.tif", dem_heights="ellipsoidal"), land


@pytest.fixture(scope="module")
def alone(small: tuple[gm.Scene, Downs]) -> SimulationMatch:
    return gm.match_simulation(small[0], tile=64)


def test_a_moved_scene_is_found_within_what_its_speckle_allows(
    small: tuple[gm.Scene, Downs], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The shift, the covariance that is told of it, and the refinement of the sensor by the table."""
    given, land = small
    words = [given.images[0], "--sensor", "sar", "--dem", given.dem, "--dem-heights", "ellipsoidal", "--tile", "64"]
    files = {"-o": tmp_path / "control.csv", "--simulation": tmp_path / "simulated.tif"}
    assert run(["simulate", *map(str, [*words, *chain(*files.items())]), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert all(file.exists() for file in files.values())
    told = run(["simulate", *map(str, words), "-o", "one.csv", "--simulation", "one.csv"])
    assert (told, "would be one file" in capsys.readouterr().err) == (1, True)
    shift, sigma = np.array(found["shift_px"]), np.array(found["sigma_px"])
    assert found["points"] >= 4
    assert (sigma < [0.12, 0.25]).all()
    assert (np.abs(shift - MOVED) < 2.5 * sigma).all()
    placed = replace(given, control=tmp_path / "control.csv", crs=f"EPSG:{land.zone}", heights="ellipsoidal")
    refined, bare = (build_block(one).scenes[0].model for one in (placed, given))
    ground = np.array([bare.seed])
    change = refined.ground_to_image(ground) - bare.ground_to_image(ground)
    assert np.abs(change - MOVED).max() < 0.5


def test_layover_shadow_and_single_zeros_hinder_no_match(tmp_path: Path) -> None:
    _, path = written(tmp_path, Scene(size=(200, 190)), 1, Peaks)
    scene = gm.Scene(path, "sar", dem=tmp_path / "dem.tif", dem_heights="ellipsoidal")
    with rasterio.open(path) as file:
        amplitude = file.read(1)
    assert 1 <= (amplitude == 0).sum() < 100
    expected = gm.simulate_scene(scene, tmp_path / "simulated.tif").read()[0]
    assert expected.shape == (190, 200)
    assert expected.count() == expected.size
    assert (expected < 0.05).sum() > 300
    assert expected.max() > 6.0
    moved = expected[:-12, :-20].ravel(), amplitude[12:, 20:].ravel() ** 2
    assert np.corrcoef(*moved)[0, 1] > 0.5
    found = gm.match_simulation(scene, tile=48, reach=24)
    assert found.matched.whole == 6
    assert str(found).startswith("SimulationMatch('scene.tif', ")
    assert (found.sigma < 0.5).all()
    assert (np.abs(found.shift - MOVED) < 2.5 * found.sigma).all()


@pytest.mark.slow
@pytest.mark.parametrize(("size", "looks", "tile"), [((760, 720), 4, 96), ((1500, 1400), 1, 128)])
def test_a_moved_scene_is_found_to_a_tenth_of_a_pixel_without_control(
    tmp_path: Path, size: tuple[int, int], looks: int, tile: int
) -> None:
    """Four looks, as ground range products have, on 0.55 megapixels; a single look on 2.1."""
    _, path = written(tmp_path, Scene(size=size), looks)
    found = gm.match_simulation(gm.Scene(path, "sar", dem=tmp_path / "dem.tif", dem_heights="ellipsoidal"), tile=tile)
    assert (found.sigma < 0.06).all()
    assert np.abs(found.shift - MOVED).max() < 0.1


def test_a_scene_of_other_land_is_not_found(small: tuple[gm.Scene, Downs], tmp_path: Path) -> None:
    given, _ = small
    width, height = 200, 190
    noise = np.random.default_rng(2).rayleigh(1.0, (1, height, width)).astype(np.float32)
    with rasterio.open(
        tmp_path / "scene.tif", "w", driver="GTiff", width=width, height=height, count=1, dtype="float32"
    ) as file:
        file.write(noise)
    Scene(size=(width, height)).write(tmp_path, "scene")
    with pytest.raises(InputError, match="look like their simulation"):
        gm.match_simulation(replace(given, images=(tmp_path / "scene.tif",)), tile=60)


def test_the_declared_band_is_matched_and_no_other(
    small: tuple[gm.Scene, Downs], alone: SimulationMatch, tmp_path: Path
) -> None:
    given, land = small
    with rasterio.open(given.images[0]) as file:
        amplitude = file.read(1)
    noise = np.random.default_rng(2).rayleigh(1.0, amplitude.shape).astype(np.float32)
    with rasterio.open(
        tmp_path / "scene.tif", "w", driver="GTiff", width=amplitude.shape[1], height=amplitude.shape[0], count=2,
        dtype="float32",
    ) as file:  # fmt: skip
        file.write(np.stack([noise, amplitude]))
    land.scene.write(tmp_path, "scene")
    second = gm.match_simulation(replace(given, images=(tmp_path / "scene.tif",), bands=[2]), tile=64)
    assert np.array_equal(second.shift, alone.shift)
    assert f"EPSG:{land.zone}, heights in the vertical datum of the DEM" in alone.summary


def test_a_scene_too_small_for_its_windows_and_a_dem_elsewhere_are_told(
    small: tuple[gm.Scene, Downs], tmp_path: Path
) -> None:
    given, land = small
    with pytest.raises(InputError, match="room for 1 window of 128 pixels that may be shifted by 32") as caught:
        gm.match_simulation(given)
    assert "`tile`" in (caught.value.hint or "")
    (tmp_path / "scene.tif").write_bytes(Path(given.images[0]).read_bytes())
    land.scene.left().write(tmp_path, "scene")
    with pytest.raises(InputError, match="no ground where the orbit puts the scene"):
        gm.match_simulation(replace(given, images=(tmp_path / "scene.tif",)), tile=64)


def test_ground_in_degrees_is_written_as_finely_as_it_was_found(alone: SimulationMatch, tmp_path: Path) -> None:
    found = replace(alone, control=alone.control.to_crs(CRS.from_epsg(4979)))
    x, y = np.loadtxt(found.write(tmp_path / "control.csv"), delimiter=",", skiprows=1, usecols=(1, 2)).T
    assert np.abs(np.column_stack([x, y]) - found.control.ground[:, :2]).max() < 1e-9


def test_windows_beyond_the_edge_of_the_dem_are_left_out(small: tuple[gm.Scene, Downs], tmp_path: Path) -> None:
    given, _ = small
    assert isinstance(given.dem, Path)
    with rasterio.open(given.dem) as file:
        width = int(0.6 * file.width)
        east = file.bounds.left + width * file.res[0]
        with rasterio.open(tmp_path / "dem.tif", "w", **{**file.profile, "width": width}) as part:
            part.write(file.read(1)[:, :width], 1)
    whole = gm.match_simulation(given, tile=48)
    found = gm.match_simulation(replace(given, dem=tmp_path / "dem.tif"), tile=48)
    assert 4 <= len(found.control) < len(whole.control)
    assert np.isfinite(found.control.ground).all()
    assert (found.control.ground[:, 0] < east).all()
    assert (np.abs(found.shift - MOVED) < 3.0 * found.sigma).all()
