"""Rolling shutters: the motion of each photo comes back from a block, and errors of points without it go."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import block_rig
import numpy as np
import pytest
from adjust_project_rig import CAMERA_TOML, tables, write_photo, write_project
from block_rig import CAMERA, adjust_block, grid_block, problem
from PIL import Image

import geomosaic as gm
from geomosaic.errors import InputError
from geomosaic.inputs.build import build_block
from geomosaic.inputs.velocities import velocities
from geomosaic.interchange.reconstruction import pixel_camera
from geomosaic.sensor.solve import image_to_height
from geomosaic_frame.camera import Camera

# A pixel is 0.2 m on the ground: 20 m/s in 0.1 s are the ten pixels of a drone that is ten times as low.
SHUTTER = {"readout_time": 0.1, "direction": "down"}


@pytest.fixture(scope="module")
def block() -> Any:
    """Block whose photos move by some ten pixels while they are read out."""
    random, still = np.random.default_rng(8), block_rig.photo

    def moving(name: str, *given: Any) -> Any:
        model = still(name, *given)
        north = 2.0 * (-1.0) ** int(name[1])  # strips fly to and fro
        motion = np.array([0.0, north, 0.0]) + random.normal(size=3) * [0.3, 0.3, 0.2]
        return model.with_values(np.concatenate([model.parameters.values[:6], motion, np.zeros(3)]))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(block_rig, "photo", moving)
        return grid_block(2, 3, 80, seed=6, camera={**CAMERA, "rolling_shutter": SHUTTER})


def adjusted(block: Any, start: list[Any]) -> tuple[Any, float]:
    found = adjust_block(*problem(replace(block, start=start)), robust=False, alpha=None)
    return found, float(np.sqrt(((found.state.points - block.points)[found.state.moving] ** 2).mean()))


def test_the_motion_of_each_photo_comes_back_and_points_are_where_they_are(block: Any) -> None:
    start = [model.with_values(np.concatenate([model.parameters.values[:6], np.zeros(6)])) for model in block.start]
    found, off = adjusted(block, start)
    assert 0.9 < found.sigma0 < 1.1
    unknowns, scores = found.problem.unknowns, []
    for image, (model, true) in enumerate(zip(found.state.models, block.models, strict=True)):
        columns = unknowns.of_image(image)[6:9]
        sigmas = np.sqrt(np.diag(found.network.cofactors_between(columns, columns)))
        scores.append((model.parameters.values - true.parameters.values)[6:9] / sigmas)
    assert np.abs(scores).max() < 4.0
    still = [
        replace(
            model, camera=replace(model.camera, shutter=None),
            parameters=replace(
                model.parameters, names=model.parameters.names[:6], units=model.parameters.units[:6],
                values=model.parameters.values[:6], sigmas=model.parameters.sigmas[:6],
                steps=model.parameters.steps[:6],
            ),
        )
        for model in block.start
    ]  # fmt: skip
    without, off_without = adjusted(block, still)
    assert without.sigma0 > 1.3
    assert off < 0.5 * off_without


def test_without_motion_a_rolling_shutter_shows_what_any_other_does(block: Any) -> None:
    model = block.models[0].with_values(np.concatenate([block.models[0].parameters.values[:6], np.zeros(6)]))
    other = block_rig.photo("still", np.array([500_000.0, 5_500_000.0, 1300.0]), np.zeros(3))
    other = replace(other, frame=model.frame).with_values(model.parameters.values[:6])
    ground = block.frame.to_crs(model.crs, block.points)[0]
    assert np.nanmax(np.abs(model.ground_to_image(ground) - other.ground_to_image(ground))) < 1e-8


def test_velocities_are_those_of_the_strip_and_not_of_the_turn() -> None:
    photos: dict[str, Any] = {f"a{i}": (2.0 * i, (0.0, 20.0 * i, 100.0)) for i in range(4)}
    photos |= {f"b{i}": (30.0 + 2.0 * i, (50.0, 60.0 - 20.0 * i, 100.0)) for i in range(4)}
    photos["lost"] = (None, (0.0, 0.0, 0.0))
    photos["alone"] = (1e6, (0.0, 0.0, 0.0))
    found = velocities(photos)
    assert {tuple(np.round(v, 9)) for name, v in found.items() if name[0] == "a"} == {(0.0, 10.0, 0.0)}
    assert {tuple(np.round(v, 9)) for name, v in found.items() if name[0] == "b"} == {(0.0, -10.0, 0.0)}
    assert len(found) == 8


def test_times_of_the_orientation_table_give_each_photo_its_motion(tmp_path: Path) -> None:
    rig = grid_block(1, 3, 10, seed=1, shift=0.0, turn=0.0)
    for name in rig.names:
        write_photo(tmp_path / "photos" / f"{name}.tif")
    header, *lines = tables(rig)["exterior.csv"]
    timed = [f"{header},time"] + [f"{line},{4.0 * index}" for index, line in enumerate(lines)]
    (tmp_path / "timed.csv").write_text("\n".join(timed) + "\n")
    (tmp_path / "camera.toml").write_text(CAMERA_TOML)
    (tmp_path / "rolling.toml").write_text(CAMERA_TOML + "rolling_shutter = { readout_time = 0.03 }\n")
    photos = sorted((tmp_path / "photos").glob("*.tif"))
    given: dict[str, Any] = {"crs": "EPSG:32633", "heights": "ellipsoidal", "height": 300.0, "trusted": True}
    made = {
        name: build_block(gm.Block(photos, "frame", camera=tmp_path / name, exterior=tmp_path / "timed.csv", **given))
        for name in ("rolling.toml", "camera.toml")
    }
    centres = np.array([scene.model.pose[0] for scene in made["camera.toml"].scenes])
    for index, scene in enumerate(made["rolling.toml"].scenes):
        first, last = max(index - 1, 0), min(index + 1, 2)
        way = 0.03 * (centres[last] - centres[first]) / (4.0 * (last - first))
        motion = scene.model.parameters.values[6:9] @ scene.model.frame.axes
        assert motion == pytest.approx(way, rel=1e-3, abs=1e-5)
        assert scene.model.parameters.sigmas[6:9] == pytest.approx(0.03)


@pytest.mark.ci
def test_the_motion_that_an_adjustment_finds_stands_in_its_table_and_comes_back_from_it(tmp_path: Path) -> None:
    rig = grid_block(2, 3, 40, seed=6)
    write_project(tmp_path, rig)
    (tmp_path / "camera.toml").write_text(CAMERA_TOML + "rolling_shutter = { readout_time = 0.1 }\n")
    photos = sorted((tmp_path / "photos").glob("*.tif"))
    given: dict[str, Any] = {
        "camera": tmp_path / "camera.toml", "crs": "EPSG:32633", "heights": "ellipsoidal",
        "dem": tmp_path / "dem.tif", "dem_heights": "ellipsoidal",
    }  # fmt: skip
    block = gm.Block(
        photos, "frame", exterior=tmp_path / "exterior.csv", control=tmp_path / "control.csv",
        options={"sigmas": {"turn": 0.02}}, **given,
    )  # fmt: skip
    found = gm.adjust(
        block, ties=tmp_path / "ties.csv", sigma_px=0.3, position_sigma=20.0, attitude_sigma=0.5, robust=False
    )
    assert found.write_exterior(tmp_path / "out.csv")
    again = build_block(gm.Block(photos, "frame", exterior=tmp_path / "out.csv", **given))
    table = (tmp_path / "out.csv").read_text()
    without = [",".join(line.split(",")[:7]) for line in table.splitlines()]
    (tmp_path / "pose.csv").write_text("\n".join(without) + "\n")
    still = build_block(gm.Block(photos, "frame", exterior=tmp_path / "pose.csv", **given))
    ground = rig.frame.to_crs(found.scenes[0].model.crs, rig.points)[0]
    off = []
    for scene, other, at_rest in zip(found.scenes, again.scenes, still.scenes, strict=True):
        assert np.all(scene.model.parameters.values[6:] != 0.0)
        seen = scene.model.ground_to_image(ground)
        inside = ((seen > 0.0) & (seen < scene.model.size)).all(axis=1)
        off.append([np.abs(each.model.ground_to_image(ground) - seen)[inside].max() for each in (other, at_rest)])
    assert np.max(off, axis=0)[0] < 1e-5 < 0.1 < np.max(off, axis=0)[1]


def test_rates_of_a_table_turn_the_camera_about_its_own_axes() -> None:
    camera = {"size": [300, 200], "focal_length_px": 250.0, "rolling_shutter": {"readout_time": 0.1}}
    given: dict[str, Any] = {
        "camera": camera, "position": [500_000.0, 5_500_000.0, 400.0], "sigmas": {"turn": 1.0},
        "orientation": {"system": "opk", "omega": 12.0, "phi": -9.0, "kappa": 70.0, "rates": [3.0, -2.0, 4.0],
                        "velocity": [0.0, 0.0, 0.0]},
    }  # fmt: skip
    model: Any = block_rig.registry.build("frame", block_rig.SensorRequest("p", (300, 200), given, block_rig.GROUND))
    # The camera turns by the right hand: what stands still goes the other way.
    still = model.with_values(np.concatenate([model.parameters.values[:6], np.zeros(6)]))
    direction = np.array([0.1, 0.05, 1.0])
    turned = [model._scan.rotations(np.array([time]))[0] for time in (-1e-4, 1e-4)]
    change = (turned[1] - turned[0]) @ turned[0].T @ (direction * [1.0, -1.0, -1.0]) * [1.0, -1.0, -1.0] / 2e-4
    expected = -np.cross(np.radians([3.0, -2.0, 4.0]) * 0.1, direction)
    assert change == pytest.approx(expected, abs=1e-7)
    assert model.motion(block_rig.GROUND)[3:] == pytest.approx([3.0, -2.0, 4.0], abs=1e-12)
    assert still.motion(block_rig.GROUND) == pytest.approx(np.zeros(6))


def pattern(xy: Any) -> Any:
    x, y = (np.asarray(xy) - [500_000.0, 5_500_000.0]).T
    return 128.0 + 100.0 * np.sin(x / 6.0) * np.cos(y / 9.0)


def test_an_ortho_shows_the_ground_where_it_was_when_its_row_was_read(tmp_path: Path) -> None:
    camera = {"size": [300, 200], "focal_length_px": 250.0}
    given: dict[str, Any] = {
        "camera": {**camera, "rolling_shutter": {"readout_time": 0.05}}, "velocity": [20.0, 40.0, 5.0],
        "position": [500_000.0, 5_500_000.0, 400.0],
        "orientation": {"system": "opk", "omega": 2.0, "phi": -3.0, "kappa": 20.0},
    }  # fmt: skip
    model = block_rig.registry.build("frame", block_rig.SensorRequest("p", (300, 200), given, block_rig.GROUND))
    pixels = np.stack(np.meshgrid(np.arange(300) + 0.5, np.arange(200) + 0.5), axis=-1).reshape(-1, 2)
    ground = image_to_height(model, pixels, np.full(len(pixels), 300.0), block_rig.GROUND)
    Image.fromarray(pattern(ground[:, :2]).reshape(200, 300).round().astype(np.uint8)).save(tmp_path / "p.png")
    worst = {}
    for name, options in (
        ("rolling", given),
        ("still", {key: value for key, value in given.items() if key != "velocity"}),
    ):
        scene = gm.Scene(
            tmp_path / "p.png", "frame", crs="EPSG:32633", heights="ellipsoidal", options=options, trusted=True
        )
        made = gm.ortho(scene, tmp_path / f"{name}.tif", dem=300.0, dem_heights="ellipsoidal", resolution=0.5)
        values, grid = made.read(), made.grid
        grey = np.ma.getdata(values).reshape(grid.height, grid.width).astype(float)
        x = grid.transform.c + (np.arange(grid.width) + 0.5) * grid.transform.a
        y = grid.transform.f + (np.arange(grid.height) + 0.5) * grid.transform.e
        true = pattern(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)).reshape(grey.shape)
        inside = grey > 0.0
        worst[name] = float(np.sqrt(((grey - true)[inside] ** 2).mean()))
    assert worst["rolling"] < 0.2 * worst["still"], worst


@pytest.mark.parametrize(
    ("shutter", "words"),
    [
        ({"readout_time": 30.0}, "milliseconds"),
        ({"direction": "down"}, "readout_time"),
        ({"readout_time": 0.03, "direction": "south"}, "choose from: down, up, right, left"),
    ],
)
def test_slips_in_the_table_are_told(shutter: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as error:
        Camera.from_table({**CAMERA, "rolling_shutter": shutter}, (6000, 4000), "camera")
    assert words in f"{error.value} {error.value.hint}"


def test_a_velocity_without_a_rolling_shutter_and_other_programs_are_refused() -> None:
    with pytest.raises(InputError, match="no rolling shutter"):
        pixel_camera(Camera.from_table({**CAMERA, "rolling_shutter": SHUTTER}, (6000, 4000), "c").to_dict(), "c")
    options = {
        "camera": CAMERA, "position": [500000.0, 5500000.0, 1300.0], "velocity": [1.0, 0.0, 0.0],
        "orientation": {"system": "opk", "omega": 0.0, "phi": 0.0, "kappa": 0.0},
    }  # fmt: skip
    with pytest.raises(InputError, match="no rolling shutter"):
        block_rig.registry.build("frame", block_rig.SensorRequest("p", (6000, 4000), options, block_rig.GROUND))
