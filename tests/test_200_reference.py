"""Real photos and scenes found in orthos and scenes of other years, against orientations and places that are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from scipy.ndimage import map_coordinates
from test_200_ngi import inputs

import geomosaic as gm
from geomosaic.errors import GeomosaicWarning, SolveError
from geomosaic.geo.transform import Transform
from geomosaic.inputs.build import build_block
from geomosaic.reference_matching.drawing import georeferenced
from geomosaic.reference_matching.match import Reference, match_oriented
from geomosaic.sensor.solve import image_to_ground

RealData = Callable[[str], Path]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reference", "limit"), [("source/ngi_rgb_byte_{}.tif", 1.0), ("reference/sentinel2_b432_byte.tif", 1.2)]
)
def test_photos_of_wrong_positions_and_angles_come_back(real_data: RealData, reference: str, limit: float) -> None:
    block, orthos = build_block(inputs(real_data("orthority-ngi"))), real_data("homonim-ngi-mosaic")
    random = np.random.default_rng(1)
    for number, scene in enumerate(block.scenes):
        truth = scene.model
        off = [v / np.linalg.norm(v) * size for v, size in zip(random.normal(size=(2, 3)), (300.0, 3.0), strict=True)]
        moved = replace(scene, model=truth.with_values(truth.parameters.values + np.concatenate(off)))
        with (opened := Reference.open(*georeferenced(orthos / reference.format(number + 1), "the reference"))).drawer:
            found = match_oriented(moved, block.surface, opened, 300.0)
        width, height = truth.size
        c, r = np.meshgrid(np.linspace(20, width - 20, 9), np.linspace(20, height - 20, 15))
        ground = image_to_ground(truth, np.column_stack([c.ravel(), r.ravel()]), block.surface)
        xyz = Transform(block.surface.crs, truth.crs)(ground)
        apart = found.scene.model.ground_to_image(xyz) - truth.ground_to_image(xyz)
        seen = np.isfinite(apart).all(axis=1)
        assert np.sqrt((apart[seen] ** 2).sum(axis=1).mean()) < limit, f"{scene.name} in {reference}"
        assert found.moved > 50.0
        assert len(found) > 200


@pytest.mark.slow
def test_a_photo_is_not_found_in_land_that_looks_alike(real_data: RealData, tmp_path: Path) -> None:
    block = build_block(inputs(real_data("orthority-ngi")))
    ortho = real_data("homonim-ngi-mosaic") / "source" / "ngi_rgb_byte_4.tif"
    with rasterio.open(ortho) as file:
        values, profile = file.read()[:, ::-1], file.profile
    turned = tmp_path / "turned.tif"
    with rasterio.open(turned, "w", **{**profile, "driver": "GTiff"}) as file:
        file.write(values)
    opened = Reference.open(*georeferenced(turned, "the reference"))
    with opened.drawer, pytest.raises(SolveError, match="not found in the reference"):
        match_oriented(block.scenes[3], block.surface, opened, 300.0)


@pytest.mark.slow
def test_a_landsat_scene_comes_back_from_where_it_was_moved(real_data: RealData, tmp_path: Path) -> None:
    folder = real_data("geoutils-landsat-aster") / "Everest_Landsat"
    whole, part = (folder / f"LE71400412000304SGS00_B4{end}.tif" for end in ("", "_cropped"))
    with pytest.warns(GeomosaicWarning, match="lies on its reference already"):
        same = gm.coregister(part, whole, tmp_path / "same.tif")
    assert same.displacement.rms < 0.002
    with rasterio.open(whole) as file:
        values, profile = file.read(1).astype(float), file.profile
    rows, cols = np.mgrid[0 : values.shape[0], 0 : values.shape[1]].astype(float)

    def moved(d_col: np.ndarray | float, d_row: np.ndarray | float) -> Path:
        bent = map_coordinates(values, [rows - d_row, cols - d_col], order=3, mode="nearest")
        bent = 0.8 * bent + np.random.default_rng(0).normal(0.0, 1.0, bent.shape)
        with rasterio.open(tmp_path / "moved.tif", "w", **{**profile, "driver": "GTiff"}) as file:
            file.write(np.clip(np.rint(bent), 0, 255).astype(np.uint8), 1)
        return tmp_path / "moved.tif"

    shift = gm.coregister(moved(3.37, -7.81), whole, tmp_path / "shift.tif")
    assert shift.displacement.kind == "shift"
    assert shift.displacement.matrix[:, 2] == pytest.approx((3.37, -7.81), abs=0.01)
    waves = moved(2.5 * np.sin(cols / 90.0) + 1.0, 2.0 * np.cos(rows / 80.0) + 0.5 * np.sin(cols / 70.0))
    local = gm.coregister(waves, whole, tmp_path / "local.tif", model="local")
    assert local.displacement.kind == "local"
    assert local.displacement.held_out["local"] < 0.05 < local.displacement.held_out["affine"]
