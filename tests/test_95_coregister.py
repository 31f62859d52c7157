"""Co-registration of rasters whose displacement is known: what is told of it, and the pixels that come out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
import reference_rig as rig
from affine import Affine
from pyproj import CRS

import geomosaic as gm
from geomosaic.errors import GeomosaicWarning, InputError, SolveError

HALF = 300.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("coregister")


@pytest.fixture(scope="module")
def reference(folder) -> Path:
    return rig.reference(folder, half=int(HALF), pixel=2.0)


def image(folder: Path, name: str, shift: tuple[float, float], pixel: float = 1.5, crs: CRS = rig.UTM) -> Path:
    """Raster of the land that says it lies `shift` metres beside where it does."""
    box = gm.Grid.from_bounds(rig.UTM, (*np.subtract(rig.ORIGIN, HALF - 60.0), *np.add(rig.ORIGIN, HALF - 60.0)), pixel)
    return rig.write_raster(folder / name, rig.picture(box), Affine.translation(*shift) @ box.transform, crs)


def test_a_shifted_raster_comes_back_to_where_it_belongs(folder, reference, tell):
    path, out = image(folder, "shifted.tif", (7.3, -4.6)), folder / "moved.tif"
    code, said, err = tell("coregister", path, reference, "--resampling", "cubic", "-o", out, "--json")
    assert code == 0, err
    facts = json.loads(said)
    assert facts["model"] == "shift"
    # It says to lie farther east and south: its content lies to the left of and above where that puts it.
    assert facts["shift_px"] == pytest.approx((7.3 / 1.5, 4.6 / 1.5), abs=0.03)
    with rasterio.open(out) as made, rasterio.open(path) as given:
        assert made.transform == given.transform
        grid = gm.Grid.from_profile(made.profile)
        values, seen = made.read(1).astype(float), made.read_masks(1) > 0
    off = (values - rig.picture(grid).astype(float))[seen]
    before = (rasterio.open(path).read(1).astype(float) - rig.picture(grid))[seen]
    assert np.sqrt((off**2).mean()) < 0.15 * np.sqrt((before**2).mean())
    assert json.loads((folder / "moved-coregistration.json").read_text())["places"]


def test_a_raster_in_another_crs_and_resolution_takes_the_grid_of_its_reference(folder, reference):
    path = image(folder, "degrees.tif", (9.0, 6.0))
    turned = gm.reproject(path, folder / "degrees-own.tif", dst_crs="EPSG:4326", resampling="cubic").path
    moved = gm.coregister(turned, reference, folder / "on-reference.tif", like=reference, search=40.0)
    assert moved.displacement.kind in ("shift", "affine")
    with rasterio.open(reference) as own:
        assert moved.grid == gm.Grid.from_profile(own.profile)
    values = moved.read()[0]
    seen = ~np.ma.getmaskarray(values)
    off = (values.data.astype(float) - rig.picture(moved.grid))[seen]
    assert np.sqrt((off**2).mean()) < 6.0
    assert "places left out" in moved.summary


def test_a_raster_that_lies_right_stays_and_says_so(folder):
    path = image(folder, "right.tif", (0.0, 0.0))
    part = folder / "part.tif"
    with rasterio.open(path) as whole:
        values, own = whole.read(1)[40:260, 30:270], whole.transform
    rig.write_raster(part, values, own @ Affine.translation(30, 40))
    with pytest.warns(GeomosaicWarning, match="lies on its reference already"):
        moved = gm.coregister(part, path, folder / "same.tif", model="affine")
    assert moved.displacement.kind == "none"
    assert np.array_equal(moved.read()[0], values)


def test_a_raster_that_lies_farther_off_than_is_searched_is_refused_and_the_way_is_told(folder, reference):
    path = image(folder, "far.tif", (30.0, -40.0))
    with pytest.raises(SolveError, match=r"50 m from its own place, beyond the search distance of 20 m") as told:
        gm.coregister(path, reference, folder / "far-moved.tif", search=20.0)
    assert "`search` 75" in (told.value.hint or "")
    assert gm.coregister(path, reference, folder / "far-moved.tif", search=60.0).displacement.kind == "shift"


def test_other_land_and_what_is_no_map_are_refused(folder, reference):
    path = image(folder, "far.tif", (40_000.0, 0.0))
    with pytest.raises(InputError, match="shows nothing of the land"):
        gm.coregister(path, reference, folder / "no.tif")
    other = rig.write_raster(
        folder / "noise.tif", np.random.default_rng(1).integers(0, 255, (200, 200)).astype(np.uint8),
        Affine(3.0, 0.0, rig.ORIGIN[0] - 300.0, 0.0, -3.0, rig.ORIGIN[1] + 300.0),
    )  # fmt: skip
    with pytest.raises(SolveError, match="not found in the reference"):
        gm.coregister(other, reference, folder / "no.tif")
    with pytest.raises(InputError, match="no option is named"):
        gm.coregister(other, reference, folder / "no.tif", modle="shift")
    assert not (folder / "no.tif").exists()
