"""Ground of adjusted tie points: its heights against the truth, and the mosaics, orthos and projects that use it."""

from __future__ import annotations

import re
import shutil
import warnings
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from adjust_project_rig import PROJECT, Block, grid_block, write_project
from block_rig import heights

import geomosaic as gm
from geomosaic.block_adjustment.result import AdjustedBlock
from geomosaic.cli.results import outcome_text
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.jobs.steps.orient import restore_block
from geomosaic.project.load import load_project

FROM_TIES = PROJECT.replace('file = "dem.tif"\nheights = "ellipsoidal"', "from_tie_points = true").replace(
    "resolution = 4.0", "resolution = 20.0"
)
NOWHERE = (
    FROM_TIES.replace('file = "exterior.csv"\ncrs = "EPSG:32633"\nheights = "ellipsoidal"', 'crs = "local"')
    .replace('[control]\nfile = "control.csv"\n', "")
    .replace("position_sigma = 20.0\nattitude_sigma = 0.5\n", "")
    .replace("resolution = 20.0", "resolution = 2.0")
)


def truth() -> Block:
    return grid_block(2, 4, 150, seed=3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("block")
    write_project(base, truth(), FROM_TIES)
    return base


@pytest.fixture(scope="module")
def adjusted(folder: Path) -> AdjustedBlock:
    project = load_project(folder / "block.toml")
    assert project.adjustment is not None
    return gm.adjust(project.inputs, ties=folder / "ties.csv", sigma_px=0.3, position_sigma=20.0, attitude_sigma=0.5)


@pytest.mark.ci
def test_workers_make_the_ground_of_a_project(folder: Path, adjusted: AdjustedBlock, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "own")
    done = gm.run_project(tmp_path / "own" / "block.toml", steps=("orient",), workers=2)
    assert done.run is not None
    computed = sum((worker.units for worker in done.run.workers.values()), Counter())
    assert {"Judged", "LeftOut", "Nodes"} <= set(computed)
    with rasterio.open(tmp_path / "own" / "output" / "surface.tif") as file:
        assert np.array_equal(file.read(1), adjusted.tie_point_surface.surface.heights)


def test_heights_are_wrong_by_what_their_sigmas_say(adjusted: AdjustedBlock) -> None:
    found = adjusted.tie_point_surface.surface
    rows, cols = np.indices(found.grid.shape) + 0.5
    true = heights(found.grid.xy(np.column_stack([cols.ravel(), rows.ravel()]))).reshape(found.grid.shape)
    ratio = np.abs(found.heights - true) / found.sigma
    assert not found.plane
    assert (ratio[~found.beyond] < 1.0).mean() == pytest.approx(0.683, abs=0.05)
    assert (ratio[found.beyond] < 2.0).mean() > 0.9
    assert "surface: triangles between heights of" in adjusted.summary


def test_an_adjusted_block_becomes_an_ortho_and_a_mosaic_in_one_call(adjusted: AdjustedBlock, tmp_path: Path) -> None:
    dem = adjusted.surface()
    assert dem.crs == adjusted.start.ground
    made = gm.mosaic(adjusted.block(), tmp_path / "mosaic.tif", resolution=20.0, balance=False, accuracy=True)
    assert made.accuracy is not None
    assert "heights" in made.accuracy.parts
    name = adjusted.scenes[0].name
    ortho = gm.ortho(adjusted.block(name), tmp_path / "ortho.tif", resolution=20.0)
    assert ortho.read().count() > 1000
    with pytest.raises(InputError, match="would do nothing"):
        gm.ortho(adjusted.block(name), tmp_path / "again.tif", dem=100.0)
    with pytest.raises(InputError, match="one image"):
        gm.ortho(adjusted.block(), tmp_path / "again.tif")


def test_files_of_the_surface_hold_what_the_block_knows(adjusted: AdjustedBlock, tmp_path: Path) -> None:
    files = adjusted.write(tmp_path)
    middle = np.array(list(adjusted.points.values()))[:5, :2]
    for name, surface in (("surface", adjusted.surface()), ("surface_sigma", adjusted.surface().sigma)):
        assert surface is not None
        written = gm.Dem.open(files[name], heights="ellipsoidal")
        assert written.height(middle) == pytest.approx(surface.height(middle), rel=1e-6)


@pytest.mark.slow
def test_a_project_without_a_dem_makes_one_and_knows_when_it_is_stale(folder: Path) -> None:
    done = gm.run_project(folder / "block.toml")
    assert done.facts["orient"]["surface_from_tie_points"]["plane"] is False
    assert any("triangles between" in note for note in done.facts["orient"]["surface_notes"])
    assert all(state.fresh for state in gm.run_project(folder / "block.toml", dry_run=True).states)
    output = folder / "output"
    (output / "surface.tif").unlink()
    stale = {state.name for state in gm.run_project(folder / "block.toml", dry_run=True).states if not state.fresh}
    assert stale >= {"orient", "mosaic"}
    assert "surface.tif" in (output / "report.json").read_text()


@pytest.mark.ci
def test_a_project_without_any_position_ends_in_a_level_frame_that_lies_nowhere(tmp_path: Path) -> None:
    file = write_project(tmp_path, grid_block(2, 3, 60, seed=3), NOWHERE)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        gm.run_project(file)
    texts = [str(one.message) for one in told if issubclass(one.category, GeomosaicWarning)]
    assert any("has no place on the Earth" in text for text in texts)
    with rasterio.open(tmp_path / "output" / "block.tif") as mosaic:
        assert mosaic.crs.to_wkt().startswith('LOCAL_CS["local frame"')
    assert not list((tmp_path / "output").glob("*.stac.json"))
    with rasterio.open(tmp_path / "output" / "surface.tif") as surface:
        z = surface.read(1)
    assert all(state.fresh for state in gm.run_project(file, dry_run=True).states)
    # The ground of the truth lies level below a level flight; the cameras are a hundred units above it.
    assert abs(np.median(z)) < 5.0
    page = (tmp_path / "output" / "adjustment.html").read_text()
    assert "has no place on the Earth" in page
    # Its lengths are in units of its own, and no metres.
    assert re.findall(r"[^>]*\d (?:m|cm|mm|km)\b[^<]*", page) == []
    assert re.search(r"standard deviation of its heights: median [\d.]+ units", page)


def test_the_models_of_a_project_say_which_photos_are_set_aside(tmp_path: Path) -> None:
    file = write_project(tmp_path, grid_block(2, 3, 60, seed=3), NOWHERE)
    ties = tmp_path / "ties.csv"
    ties.write_text("".join(line for line in ties.read_text().splitlines(True) if ",s2p3.tif," not in line))
    with pytest.warns(GeomosaicWarning) as told:
        done = gm.run_project(file, steps=["orient"])
    assert any("1 image set aside, the rest is adjusted: s2p3.tif" in str(each.message) for each in told)
    assert list(done.facts["orient"]["set_aside"]) == ["s2p3.tif"]
    assert "1 image set aside" in outcome_text(done)
    assert gm.run_project(file, dry_run=True).states[0].fresh
    block = restore_block(load_project(file), 1 << 28)
    assert [scene.name for scene in block.scenes] == ["s1p1.tif", "s1p2.tif", "s1p3.tif", "s2p1.tif", "s2p2.tif"]


@pytest.mark.slow
def test_a_project_goes_on_without_a_photo_that_nothing_ties_and_takes_it_back(tmp_path: Path) -> None:
    text = NOWHERE.replace("resolution = 2.0", "resolution = 10.0\northos = true")
    file = write_project(tmp_path, grid_block(2, 3, 60, seed=3), text)
    ties, output = tmp_path / "ties.csv", tmp_path / "output"
    whole = ties.read_text().splitlines(keepends=True)
    ties.write_text("".join(line for line in whole if ",s2p3.tif," not in line))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        done = gm.run_project(file)
    assert any("1 image set aside, the rest is adjusted: s2p3.tif (no" in str(one.message) for one in told)
    assert list(done.facts["orient"]["set_aside"]) == ["s2p3.tif"]
    assert [image["name"] for image in done.facts["mosaic"]["images"]] == [
        f"s{k}p{n}.tif" for k in (1, 2) for n in (1, 2, 3)
    ][:5]
    assert len(list((output / "orthos").glob("*.tif"))) == 5
    assert "1 image set aside" in (output / "report.html").read_text()
    assert "1 image set aside" in (output / "adjustment.html").read_text()
    assert all(state.fresh for state in gm.run_project(file, dry_run=True).states)

    ties.write_text("".join(whole))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        done = gm.run_project(file)
    assert not done.facts["orient"]["set_aside"]
    assert (output / "orthos" / "s2p3.tif").is_file()
    ties.write_text("".join(line for line in whole if ",s2p3.tif," not in line))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gm.run_project(file)
    assert not (output / "orthos" / "s2p3.tif").exists()


def test_a_ground_of_tie_points_needs_an_adjustment(folder: Path, tmp_path: Path) -> None:
    text = FROM_TIES.split("[adjust]")[0] + "[output]" + FROM_TIES.split("[output]")[1]
    with pytest.raises(InputError, match="nothing is adjusted"):
        load_project(write_project(tmp_path, truth(), text))
    block = load_project(folder / "block.toml").inputs
    with pytest.raises(InputError, match="not adjusted"):
        gm.mosaic(replace(block, control=None), tmp_path / "mosaic.tif")
