"""Terrain flattening of radar: illuminated areas summed apart from small facets, shadow cast by straight lines."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from radar_hills_rig import Land
from sar_rig import Scene
from scipy.ndimage import minimum_filter, uniform_filter

import geomosaic as gm
from geomosaic.errors import InputError
from geomosaic.geo.grid import Window
from geomosaic.inputs.build import build_block
from geomosaic.render.illuminated_area import IlluminatedArea

SIZE = (96, 80)
# Power of an amplitude of 1: a twentieth of a typical GRD's.
FACTOR = 2e-5


@dataclass(frozen=True)
class Hill(Land):
    """A hill of 110 m without layover or shadow, or one of 420 m with both."""

    top: float = 110.0

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, v = x - self.middle[0], y - self.middle[1]
        return 200.0 + self.top * np.exp(-(((u + 60.0) / 240.0) ** 2) - ((v - 20.0) / 240.0) ** 2)

    def brightness(self) -> np.ndarray:
        """β⁰ of ground whose γ⁰ is 1: area across the line of sight over that of the slant range plane."""
        steep = self.top > 200.0
        facets = self.facets((860.0, 560.0) if steep else (500.0, 450.0), 2.0 if steep else 1.0)
        sent = facets.size * np.maximum(facets.cosine, 0.0)
        if steep:
            sent[self.shaded(facets, 700.0, 20.0)] = 0.0
        row, _ = self._row_length()
        return facets.image(sent, self.scene.size) / (row * self.scene.spacing)

    def _row_length(self) -> tuple[float, float]:
        """Metres on the ground from row to row, and from column to column."""
        x, y = (
            self.middle[axis] + np.array([0.0, 100.0, 0.0])[[0, 1, 2] if axis == 0 else [0, 2, 1]] for axis in (0, 1)
        )
        place = self.scene.image(self.earth(x, y, np.full(3, 200.0)))
        steps = np.linalg.inv((place[1:] - place[0]) / 100.0)
        return float(np.linalg.norm(steps[1])), float(np.linalg.norm(steps[0]))


def written(folder: Path, top: float) -> tuple[Hill, gm.Scene, np.ndarray]:
    """Amplitudes of ground of one γ⁰ = 0.3 everywhere, DEM with nodes every 10 m, metadata with calibration."""
    scene = Scene(size=SIZE)
    land = Hill(*(getattr(Land.of(scene), name) for name in ("scene", "middle", "zone")), top=top)
    land.write_dem(folder, 2500.0)
    bright = land.brightness()
    with rasterio.open(
        folder / "scene.tif", "w", driver="GTiff", width=SIZE[0], height=SIZE[1], count=1, dtype="float32"
    ) as file:
        file.write(np.sqrt(0.3 * bright / FACTOR).astype(np.float32), 1)
    table = scene.table() | {"calibration": {"quantity": "beta0", "factor": FACTOR}, "ground_height": 200.0}
    (folder / "scene.radar.json").write_text(json.dumps(table))
    return land, gm.Scene(folder / "scene.tif", "sar", dem=folder / "dem.tif", dem_heights="ellipsoidal"), bright


def area_of(scene: gm.Scene) -> np.ndarray:
    block = build_block(scene)
    return IlluminatedArea(block.scenes[0].model, block.surface).at(Window(0, 0, *SIZE))


@pytest.fixture(scope="module")
def gentle(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Hill, gm.Scene, np.ndarray]:
    folder = tmp_path_factory.mktemp("gentle")
    return folder, *written(folder, 110.0)


def test_areas_are_those_of_facets_placed_by_the_exact_orbit(gentle) -> None:
    """To 1 %, over means of 5 x 5 pixels: the truth counts facets by their middles."""
    _, _, scene, bright = gentle
    found = area_of(scene)
    assert found.min() < 0.9 < 2.2 < found.max()
    ratio = (uniform_filter(found, 5) / uniform_filter(bright, 5))[4:-4, 4:-4]
    assert ratio.mean() == pytest.approx(1.0, abs=1e-3)
    assert np.abs(ratio - 1.0).max() < 0.02
    assert ratio.std() < 0.004


def test_ground_of_one_gamma_is_flattened_and_the_incidence_angle_alone_does_not_do_it(gentle) -> None:
    folder, land, scene, _ = gentle
    x, y = land.middle
    area = {"dst_crs": f"EPSG:{land.zone}", "resolution": 20.0, "bounds": (x - 320, y - 360, x + 300, y + 360)}
    made = {}
    for kind in ("beta0", "gamma0", "gamma0-flattened"):
        given = replace(scene, options={"calibration": kind})
        result = gm.ortho(given, folder / f"{kind}.tif", resampling="average", **area)
        made[kind] = result.read()[0].astype(float)
        with rasterio.open(result.path) as file:
            assert file.dtypes == ("float32",)
            assert file.units == ("m2/m2",)
    with rasterio.open(folder / "gamma0-flattened.tif") as file:
        assert file.descriptions == ("terrain-flattened gamma nought (m2/m2)",)
    mask = gm.layover_mask(scene, folder / "mask.tif", **area)
    with rasterio.open(mask.incidence) as file:
        angle = np.radians(file.read(1).astype(float))
    flat = made["gamma0-flattened"]
    assert flat.mean() == pytest.approx(0.3, rel=2e-3)
    assert np.abs(flat / 0.3 - 1.0).max() < 0.03
    assert flat.std() < 0.0025
    spread = {
        "flattened": np.ptp(10 * np.log10(flat)),
        # Sine of the local angle in place of the ellipsoid's (Kellndorfer and others, 1998), and its tangent.
        "sine": np.ptp(10 * np.log10(made["beta0"] * np.sin(angle))),
        "tangent": np.ptp(10 * np.log10(made["beta0"] * np.tan(angle))),
    }
    assert spread["flattened"] < 0.25
    assert spread["sine"] > 10 * spread["flattened"]
    assert spread["tangent"] > 4 * spread["flattened"]
    assert np.ptp(10 * np.log10(made["gamma0"])) > 3.0


def test_layover_adds_areas_up_and_shadow_has_no_value(tmp_path: Path) -> None:
    _, scene, bright = written(tmp_path, 420.0)
    found = area_of(scene)
    lit = np.isfinite(found)
    truth, known = uniform_filter(bright, 5)[4:-4, 4:-4], (minimum_filter(lit, 7) > 0)[4:-4, 4:-4]
    ratio = uniform_filter(np.where(lit, found, 0.0), 5)[4:-4, 4:-4][known] / truth[known]
    assert found[lit].max() > 6.0
    assert (np.abs(ratio - 1.0) < 0.05).mean() > 0.99
    assert 0.02 < (~lit).mean() < 0.3
    assert ((bright < 0.05) == ~lit).mean() > 0.99


def test_a_project_and_other_processes_flatten_alike(gentle) -> None:
    """Models come back from the project's files and from other processes with their calibration."""
    folder, land, scene, _ = gentle
    x, y = land.middle
    bounds = [x - 320, y - 360, x + 300, y + 360]
    (folder / "project.toml").write_text(
        f"""format = 1
project = {{ name = "radar", images = ["scene.tif"] }}
sensor = {{ name = "sar", calibration = "gamma0-flattened" }}
dem = {{ file = "dem.tif", heights = "ellipsoidal" }}
output = {{ folder = "output", crs = "EPSG:{land.zone}", resampling = "average", resolution = 20.0, bounds = {bounds} }}
"""
    )
    gm.run_project(folder / "project.toml", steps=("orient", "mosaic"))
    with rasterio.open(folder / "output" / "radar.tif") as file:
        project, named = file.read(1), file.descriptions[0]
    assert named == "terrain-flattened gamma nought (m2/m2)"
    area = {"dst_crs": f"EPSG:{land.zone}", "resolution": 20.0, "bounds": bounds, "resampling": "average"}
    given = replace(scene, options={"calibration": "gamma0-flattened"})
    elsewhere = gm.mosaic(given, folder / "elsewhere.tif", workers=2, **area).read().filled(0.0)
    assert np.array_equal(elsewhere[0], project)
    assert project.mean() == pytest.approx(0.3, rel=2e-3)


def test_level_ground_is_not_flattened(gentle) -> None:
    folder, _, scene, _ = gentle
    given = gm.Scene(
        scene.images[0], "sar", options={"calibration": "gamma0-flattened"}, height=200.0, dem_heights="ellipsoidal"
    )
    with pytest.raises(InputError, match="needs the relief"):
        gm.ortho(given, folder / "level.tif")
    assert not (folder / "level.tif").exists()


def test_pixels_into_which_unknown_ground_may_fall_have_no_value(tmp_path: Path) -> None:
    """The DEM ends within the scene, and has a hole: what is left is what the whole DEM gives."""
    scene = Scene(size=SIZE)
    land = Hill(*(getattr(Land.of(scene), name) for name in ("scene", "middle", "zone")))
    scene.write(tmp_path, "scene")
    with rasterio.open(
        tmp_path / "scene.tif", "w", driver="GTiff", width=SIZE[0], height=SIZE[1], count=1, dtype="uint8"
    ) as file:
        file.write(np.ones((1, SIZE[1], SIZE[0]), dtype=np.uint8))
    given = gm.Scene(tmp_path / "scene.tif", "sar", dem=land.write_dem(tmp_path, 2500.0), dem_heights="ellipsoidal")
    whole = area_of(given)
    with rasterio.open(tmp_path / "dem.tif", "r+") as file:
        heights = file.read(1)
        heights[:, 262:] = heights[240:246, 225:235] = -9999
        file.nodata = -9999
        file.write(heights, 1)
    found = area_of(given)
    known = np.isfinite(found)
    assert 0.3 < known.mean() < 0.7
    assert np.abs(found / whole - 1.0)[known].max() < 5e-3
