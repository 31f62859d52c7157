"""Layover masks as files, and mosaics in which scenes of opposite looks fill each other's shadows."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import rasterio
from radar_hills_rig import Land
from sar_rig import Ellipse, Scene
from scipy.optimize import fsolve

import geomosaic as gm
from geomosaic.cli.main import run
from geomosaic.errors import InputError
from geomosaic.resample.layover_shadow import LAYOVER, SHADOW

RIGHT = Scene()
GREY = {"right": 80, "left": 160}


def opposite(scene: Scene) -> Scene:
    """Scene from another orbit that looks left at the same middle."""

    def off(values: np.ndarray) -> np.ndarray:
        moved = Scene(orbit=Ellipse(node=values[0], start=values[1]), side=-1)
        return np.array(moved.middle(200.0)) - scene.middle(200.0)

    node, start = fsolve(off, [scene.orbit.node + 14.0, scene.orbit.start])
    return Scene(orbit=Ellipse(node=node, start=start), side=-1)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Land]:
    """Two scenes of one grey each, from the right and from the left, and the DEM of the hills."""
    folder = tmp_path_factory.mktemp("looks")
    land = Land.of(RIGHT)
    land.write_dem(folder)
    for name, scene in (("right", RIGHT), ("left", opposite(RIGHT))):
        width, height = scene.size
        with rasterio.open(
            folder / f"{name}.tif", "w", driver="GTiff", width=width, height=height, count=1, dtype="uint8"
        ) as file:
            file.write(np.full((1, height, width), GREY[name], dtype=np.uint8))
        scene.write(folder, name)
    return folder, land


def area(land: Land) -> dict[str, object]:
    """Output about the hills of layover and shadow."""
    x, y = land.middle
    return {
        "dst_crs": f"EPSG:{land.zone}",
        "resolution": 20.0,
        "bounds": (x - 2400.0, y - 2000.0, x + 2400.0, y + 2000.0),
    }


def mask(folder: Path, land: Land, name: str) -> np.ndarray:
    made = gm.layover_mask(
        gm.Scene(folder / f"{name}.tif", "sar", dem=folder / "dem.tif", dem_heights="ellipsoidal"),
        folder / f"{name}-mask.tif", **area(land), overwrite=True,
    )  # fmt: skip
    assert made.incidence is not None
    with rasterio.open(made.incidence) as file:
        assert 20.0 < np.median(file.read(1)) < 60.0
    classes = made.read().filled(255)[0]
    assert made.shares["shadow"] == pytest.approx(((classes & SHADOW) > 0).mean(), abs=1e-9)
    assert not (classes == 255).any()
    return np.asarray(classes & (LAYOVER | SHADOW) > 0)


def test_scenes_of_opposite_looks_fill_each_others_shadows(place: tuple[Path, Land]) -> None:
    folder, land = place
    hidden = {name: mask(folder, land, name) for name in GREY}
    scenes = gm.Block(
        [folder / "right.tif", folder / "left.tif"], "sar", dem=folder / "dem.tif", dem_heights="ellipsoidal"
    )
    made = gm.mosaic(scenes, folder / "mosaic.tif", **area(land), true_ortho=True, balance=False, feather="0")
    values = made.read().filled(0)[0]
    only_left, only_right = hidden["right"] & ~hidden["left"], hidden["left"] & ~hidden["right"]
    assert min(only_left.mean(), only_right.mean()) > 0.05
    # Blocks of the mosaic are gone over along profiles of their own: a place at the edge of a mask may differ.
    assert (values[only_left] == GREY["left"]).mean() > 0.99
    assert (values[only_right] == GREY["right"]).mean() > 0.99
    both = hidden["right"] & hidden["left"]
    assert both.any()
    assert (values[both] == 0).mean() > 0.95
    assert (values[~both] > 0).mean() > 0.999


def test_the_command_says_what_share_is_hidden(place: tuple[Path, Land], capsys: pytest.CaptureFixture[str]) -> None:
    folder, land = place
    left, bottom, right, top = area(land)["bounds"]  # type: ignore[misc]
    words = [
        "layover", folder / "right.tif", "--sensor", "sar", "--dem", folder / "dem.tif", "--dem-heights", "ellipsoidal",
        "--dst-crs", f"EPSG:{land.zone}", "--res", "40", "--bounds", left, bottom, right, top, "--no-incidence",
        "-o", folder / "told.tif",
    ]  # fmt: skip
    assert run([str(word) for word in words]) == 0
    assert "% layover" in capsys.readouterr().out
    assert not (folder / "told-incidence.tif").exists()
    assert run([str(word) for word in [*words, "--overwrite", "--json"]]) == 0
    assert 0.0 < json.loads(capsys.readouterr().out)["shares"]["shadow"] < 0.2


def test_both_rasters_are_made_by_one_pool_of_workers(place: tuple[Path, Land], tmp_path: Path) -> None:
    folder, land = place
    scene = gm.Scene(folder / "right.tif", "sar", dem=folder / "dem.tif", dem_heights="ellipsoidal")
    here = gm.layover_mask(scene, tmp_path / "here.tif", **{**area(land), "resolution": 80.0})
    with ThreadPoolExecutor(1) as workers:
        there = gm.layover_mask(scene, tmp_path / "there.tif", **{**area(land), "resolution": 80.0}, workers=workers)
    for one, other in ((here.path, there.path), (here.incidence, there.incidence)):
        assert one is not None
        assert other is not None
        assert one.read_bytes() == other.read_bytes()
    assert here.run is None
    assert there.run is not None
    (worker,) = there.run.workers.values()
    assert worker.units == {"classes": 1, "incidence": 1}


def test_what_has_no_layover_is_refused(place: tuple[Path, Land], sample: Path) -> None:
    folder, _ = place
    with pytest.raises(InputError, match="level ground"):
        gm.layover_mask(
            gm.Scene(folder / "right.tif", "sar", height=300.0, dem_heights="ellipsoidal"), folder / "x.tif"
        )
    photo = gm.Scene(
        sample / "photos" / "strip1_01.jpg", "frame", camera=sample / "camera.toml", exterior=sample / "exterior.csv",
        crs="EPSG:32633", heights="egm96", dem=sample / "dem.tif",
    )  # fmt: skip
    with pytest.raises(InputError, match="side-looking radar"):
        gm.layover_mask(photo, folder / "x.tif")
    with pytest.raises(InputError, match="`resampling` would do nothing"):
        gm.layover_mask(photo, folder / "x.tif", resampling="cubic")
    with pytest.raises(InputError, match="does not tell its sensor"):
        gm.layover_mask(folder / "right.tif", folder / "x.tif")  # type: ignore[arg-type]
    assert not (folder / "x.tif").exists()
