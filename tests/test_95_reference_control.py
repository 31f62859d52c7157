"""Control points found in a reference: near the truth, honest about it, and refused where the land is another."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import reference_rig as rig
from affine import Affine
from pyproj import Transformer
from scipy.ndimage import gaussian_filter

import geomosaic as gm
from geomosaic.block_adjustment.measurements import measurements
from geomosaic.errors import InputError, SolveError
from geomosaic.inputs.build import build_block
from geomosaic.options.adjustment import AdjustmentOptions
from geomosaic.tie_points.control import ReferenceControl

MOVED = (90.0, -60.0, 30.0, 2.0, -1.5, 3.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("reference")


@pytest.fixture(scope="module")
def flight(folder):
    path, camera = rig.photo(folder)
    return path, camera, rig.dem(folder)


@pytest.fixture(scope="module")
def reference(folder) -> Path:
    return rig.reference(folder)


@pytest.fixture(scope="module")
def found(flight, reference) -> ReferenceControl:
    path, _, dem = flight
    return gm.match(rig.block(path, dem, MOVED), reference=reference, search=120.0)


def true_places(camera, xy: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of places (N, 2) on the true ground."""
    xyz = np.column_stack([xy, rig.GROUND.height(xy)])
    to_earth = Transformer.from_crs(rig.GROUND.crs, 4978, always_xy=True)
    return camera.ground_to_image(np.column_stack(to_earth.transform(*xyz.T)))


def test_control_of_another_season_lies_where_the_true_camera_sees_it(flight, found):
    (points,) = found.control.values()
    off = points.colrow - true_places(flight[1], points.xy)
    assert len(points) > 50
    assert np.sqrt((off**2).mean()) < 0.2
    assert np.linalg.norm(off, axis=1).max() < 1.0
    # What the points say of themselves, in the image and on the ground, describes their errors.
    whole = np.sqrt(points.sigma**2 + (found.sigma_xy / rig.PIXEL) ** 2)
    assert 0.5 < np.sqrt((off**2).mean() / (whole**2).mean()) < 1.3
    assert np.ptp(points.colrow, axis=0).min() > 150


def test_the_page_draws_control_residuals_and_what_was_left_out(found):
    (match,) = found.matches.values()
    assert len(match.left_out) == match.tried - len(match)
    page = found.page("<land>", ["a note"])
    assert page.count("<circle") == len(match)
    assert page.count('stroke="#d3261b"') == len(match.left_out)
    assert "&lt;land&gt;" in page
    assert "a note" in page
    assert "data:image/jpeg" in page


@pytest.mark.slow
def test_control_from_a_reference_orients_the_photo(flight, found):
    path, _, dem = flight
    adjusted = gm.adjust(replace(rig.block(path, dem, MOVED), control=found.control))
    c, r = np.meshgrid(np.linspace(20.0, 300.0, 5), np.linspace(20.0, 220.0, 4))
    (truth,) = build_block(rig.block(path, dem)).scenes
    start = truth.model.rays(np.column_stack([c.ravel(), r.ravel()]))
    ground = start[0] + start[1] / np.linalg.norm(start[1], axis=1)[:, None] * 1150.0
    (scene,) = adjusted.scenes
    off = scene.model.ground_to_image(ground) - np.column_stack([c.ravel(), r.ravel()])
    assert np.sqrt((off**2).mean()) < 0.3
    assert found.matches[path.name].moved > 50.0


def test_the_command_writes_a_table_that_is_read_again(flight, reference, found, folder, tell):
    path, _, dem = flight
    camera, exterior, table = folder / "camera.toml", folder / "exterior.csv", folder / "control.csv"
    camera.write_text("\n".join(f"{key} = {value}" for key, value in rig.CAMERA.items()))
    values = ",".join(str(a + b) for a, b in zip((*rig.POSITION, *rig.ANGLES), MOVED, strict=True))
    exterior.write_text(f"image,x,y,z,omega,phi,kappa\n{path.name},{values}\n")
    known = (
        path, "--sensor", "frame", "--camera", camera, "--exterior", exterior, "--exterior-crs", "EPSG:32633",
        "--heights", "ellipsoidal", "--dem", dem, "--dem-heights", "ellipsoidal",
    )  # fmt: skip
    code, out, err = tell("match", *known, "--reference", reference, "--search", 120, "--json", "-o", table)
    assert code == 0, err
    facts = json.loads(out)
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert facts["positions"] == len(rows) > 50
    assert float(rows[0]["sigma_xy"]) == pytest.approx(facts["sigma_xy"], abs=1e-3)
    again = build_block(replace(rig.block(path, dem), control=table))
    assert len(again.control) == len(rows)
    assert again.control[0].sigma_xy > 0.0
    # The covariance of each place counts in the block, as that of a tie point does: off the table as off the values.
    (points,) = found.control.values()
    told = np.array([each.covariance for each in again.control])
    assert np.allclose(told, points.covariance, rtol=0.05, atol=1e-4)
    assert np.abs(told[:, 0, 1]).max() > 1e-4
    size = again.scenes[0].model.size
    counted, _ = measurements({path.name: size}, None, again.control, AdjustmentOptions())
    assert np.allclose(np.sort(counted.covariance[:, 0, 1]), np.sort(told[:, 0, 1]))
    of_values = build_block(replace(rig.block(path, dem), control={path.name: points})).control[0].covariance
    assert np.allclose(of_values, points.covariance[0])
    code, _, err = tell("match", *known, "--search", 120, "-o", folder / "other.csv")
    assert code == 1
    assert "--search would do nothing without --reference" in err


def test_a_reference_of_other_land_is_told(flight, folder):
    path, _, dem = flight
    grid = gm.Grid.from_bounds(rig.UTM, (*np.subtract(rig.ORIGIN, 400.0), *np.add(rig.ORIGIN, 400.0)), 2.0)
    noise = gaussian_filter(np.random.default_rng(9).normal(size=grid.shape), 2.0)
    grey = np.clip(128 + 40 * noise / noise.std(), 1, 255).astype(np.uint8)
    other = rig.write_raster(folder / "other.tif", grey, grid.transform)
    with pytest.raises(SolveError, match="not found in the reference") as failure:
        gm.match(rig.block(path, dem), reference=other, search=50.0)
    assert "`search`" in failure.value.hint
    beyond = rig.write_raster(folder / "beyond.tif", grey, Affine.translation(5_000.0, 0.0) @ grid.transform)
    with pytest.raises(InputError, match="shows nothing of the land"):
        gm.match(rig.block(path, dem), reference=beyond, search=50.0)


def test_a_position_in_another_country_is_told_before_the_search_which_an_empty_one_leads_to(
    flight, reference, folder, monkeypatch
):
    """Brasília is 84.85 degrees of a great circle from there, 9,435 km on a sphere."""
    path, _, dem = flight
    table = folder / "abroad.csv"
    block = gm.Block(
        path, "frame", camera=gm.Camera(**rig.CAMERA), crs="EPSG:32723", heights="ellipsoidal", dem=dem,
        dem_heights="ellipsoidal", exterior=table, angles="none",
    )  # fmt: skip

    def search(*_: object) -> None:
        raise SolveError("searched")

    monkeypatch.setattr("geomosaic.tie_points.control.match_anywhere", search)
    table.write_text(f"image,x,y,z\n{path.name},190000,8250000,1500\n")
    with pytest.raises(InputError, match=r"its position lies 94\d\d km from the land that the reference") as failure:
        gm.match(block, reference=reference)
    assert "leave them empty" in failure.value.hint
    table.write_text(f"image,x,y,z\n{path.name},,,\n")
    with pytest.raises(SolveError, match="searched"):
        gm.match(block, reference=reference)


def test_what_is_missing_is_named(flight, reference, folder):
    path, _, dem = flight
    with pytest.raises(InputError, match="heights of the ground"):
        gm.match(replace(rig.block(path, dem), dem=None, dem_heights=None), reference=reference)
    with pytest.raises(InputError, match="is not georeferenced"):
        gm.match(rig.block(path, dem), reference=path)
    with pytest.raises(InputError, match="no ground"):
        gm.match(rig.block(path, dem), dem=dem)


@pytest.mark.slow
def test_a_project_finds_its_own_control(flight, reference, folder, tell):
    path, _, dem = flight
    (folder / "exterior.csv").write_text(
        "image,x,y,z,omega,phi,kappa\n"
        + ",".join([path.name, *(str(a + b) for a, b in zip((*rig.POSITION, *rig.ANGLES), MOVED, strict=True))])
    )
    lines = "\n".join(f"{key} = {value}" for key, value in rig.CAMERA.items())
    (folder / "camera.toml").write_text(lines)
    (folder / "block.toml").write_text(f"""format = 1
[project]
images = ["{path.name}"]
[sensor]
name = "frame"
camera = "camera.toml"
[exterior]
file = "exterior.csv"
crs = "EPSG:32633"
heights = "ellipsoidal"
[dem]
file = "{dem.name}"
heights = "ellipsoidal"
[match]
reference = "{reference.name}"
search = 120.0
[adjust]
[output]
folder = "out"
""")
    code, _, err = tell("adjust", folder / "block.toml")
    assert code == 0, err
    table = folder / "out" / "reference_control.csv"
    assert len(table.read_text().splitlines()) > 50
    page = (folder / "out" / "reference_matches.html").read_text()
    assert f"{path.name}: residuals enlarged" in page
    (row,) = csv.DictReader((folder / "out" / "mosaic-exterior.csv").read_text().splitlines())
    # A narrow view over little relief: position and tilt make up for each other, but by less than was moved.
    off = np.array([float(row[name]) for name in ("x", "y", "z")]) - rig.POSITION
    assert np.abs(off).max() < 10.0
    assert float(row["kappa"]) == pytest.approx(rig.ANGLES[2], abs=0.1)


def test_a_photo_without_an_orientation_is_found_over_its_ground(flight, reference):
    path, camera, dem = flight
    bare = gm.Block(path, "frame", camera=gm.Camera(**rig.CAMERA), crs="EPSG:32633", heights="ellipsoidal")
    with pytest.raises(InputError, match="control points need the heights of the ground"):
        gm.match(bare, reference=reference)
    found = gm.match(bare, reference=reference, dem=dem, dem_heights="ellipsoidal")
    (points,) = found.control.values()
    off = points.colrow - true_places(camera, points.xy)
    assert len(points) > 50
    assert np.sqrt((off**2).mean()) < 0.2
    assert found.facts["images"][0]["moved_m"] is None
    assert "found without an orientation" in found.summary
    assert ">nan<" not in found.page("land")
