"""Scans without a point measured by hand, found anywhere in a reference."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
import reference_rig as rig
from scipy.ndimage import binary_erosion, gaussian_filter

import geomosaic as gm
from geomosaic.errors import InputError, SolveError

SIZE = (300, 220)
TURN, PIXEL, MIDDLE = np.radians(67.0), 1.7, np.array([60.0, -45.0])


def on_the_map(colrow: np.ndarray) -> np.ndarray:
    """Map (N, 2) of pixels (N, 2) of the scan, whose paper is a little warped."""
    off = (colrow - np.array(SIZE) / 2.0) * PIXEL
    turned = off @ np.array([[np.cos(TURN), -np.sin(TURN)], [-np.sin(TURN), -np.cos(TURN)]])
    return rig.ORIGIN + MIDDLE + turned + 1.5 * np.sin(colrow[:, ::-1] / 90.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("scan")


@pytest.fixture(scope="module")
def scan(folder) -> Path:
    c, r = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    grey = rig.land(on_the_map(np.column_stack([c.ravel(), r.ravel()]))).reshape(c.shape)
    grey = 60.0 + 140.0 * grey + np.random.default_rng(0).normal(0.0, 3.0, grey.shape)
    grey[:12] = grey[-12:] = grey[:, :12] = grey[:, -12:] = 250.0  # the margin of the sheet
    path = folder / "scan.tif"
    with rasterio.open(path, "w", driver="GTiff", width=SIZE[0], height=SIZE[1], count=1, dtype="uint8") as file:
        file.write(np.clip(grey, 0, 255).astype(np.uint8), 1)
    return path


def test_a_turned_scan_is_placed_without_a_point_measured_by_hand(scan, folder, tell):
    out = folder / "placed.tif"
    known = scan, "--reference", rig.reference(folder, half=330), "--model", "poly3"
    code, said, err = tell("georeference", *known, "-o", out, "--json")
    assert code == 0, err
    facts = json.loads(said)
    points = facts["points"]
    off = on_the_map(np.array([[p["col"], p["row"]] for p in points])) - [[p["x"], p["y"]] for p in points]
    assert len(points) > 30
    assert np.median(np.hypot(*off.T)) < 0.3 * PIXEL
    with rasterio.open(out) as made:
        grid, values, seen = gm.Grid.from_profile(made.profile), made.read(1), made.read_masks(1) > 0
    kept = binary_erosion(seen & (values < 245), iterations=4)
    agreement = np.corrcoef(values[kept].astype(float), rig.picture(grid)[kept].astype(float))[0, 1]
    assert agreement > 0.97, agreement


def test_a_scan_of_other_land_is_refused(scan, folder):
    noise = gaussian_filter(np.random.default_rng(3).normal(size=(300, 300)), 2.0)
    grey = np.clip(128 + 40 * noise / noise.std(), 1, 255).astype(np.uint8)
    grid = gm.Grid.from_bounds(rig.UTM, (*np.subtract(rig.ORIGIN, 300.0), *np.add(rig.ORIGIN, 300.0)), 2.0)
    other = rig.write_raster(folder / "other.tif", grey, grid.transform)
    with pytest.raises(SolveError, match="not found in the reference") as failure:
        gm.georeference(scan, folder / "no.tif", reference=other)
    assert "`control`" in failure.value.hint
    with pytest.raises(InputError, match="not georeferenced"):
        gm.georeference(scan, folder / "no.tif", reference=scan)
    with pytest.raises(InputError, match="`reference` would do nothing"):
        gm.georeference(scan, folder / "no.tif", control=folder / "points.csv", reference=other)


@pytest.mark.parametrize("named", [{"crs": "EPSG:32633"}, {"rows": "up"}, {"pixels": "centre"}])
def test_what_describes_a_file_of_points_is_refused_beside_a_reference(scan, folder, named):
    with pytest.raises(InputError, match=f"`{next(iter(named))}` would do nothing with `reference`"):
        gm.georeference(scan, folder / "no.tif", reference=scan, **named)
