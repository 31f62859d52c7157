"""One adjustment of scanned films, drone photos, SPOT scenes and rational polynomials over the same hills."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from mixed_rig import CONTROL, NOISE, SENSORS, SIZES, Mixed, mixed_block, write_project

import geomosaic as gm
from geomosaic.block_adjustment.start import start_block
from geomosaic.cli.main import run
from geomosaic.errors import InputError
from geomosaic.orientation.block.initial_values import image_rays
from geomosaic.project.load import load_project

# Without a note of each part that is adjusted alone: the drone shows few control points.
pytestmark = [pytest.mark.ci, pytest.mark.filterwarnings("ignore::geomosaic.errors.GeomosaicWarning")]


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Mixed:
    return mixed_block(tmp_path_factory.mktemp("mixed"))


@pytest.fixture(scope="module")
def clean(mixed: Mixed) -> Any:
    return mixed.adjusted()


def check_rms(found: Any) -> float:
    """RMS in space of the check points, metres."""
    return float(np.hypot(found.facts["checks"]["rms_plan"], found.facts["checks"]["rms_height"]))


def test_one_solution_of_all_sensors_beats_each_alone(mixed: Mixed, clean: Any) -> None:
    """RMS at 30 check points, measured when written: 0.6 m; films 1.2, drone 2.0, SPOT 10, RPC 18."""
    assert clean.facts["checks"]["count"] == 30
    assert clean.facts["sigma0_as_expected"]
    assert sum(out.sum() for out in clean.solution.adjustment.rejected) <= 1
    for kind in SENSORS:
        assert check_rms(clean) < check_rms(mixed.adjusted((kind,)))


def with_gross_errors(mixed: Mixed, share: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Image positions of which some are off by 5 to 300 pixels, and which; those of control are right."""
    random = np.random.default_rng(seed)
    wrong = (random.random(len(mixed.colrow)) < share) & (mixed.point >= CONTROL)
    off = random.choice([-1.0, 1.0], mixed.colrow.shape) * random.uniform(5.0, 300.0, mixed.colrow.shape)
    size = np.array([SIZES[image[: image.index("_")]] for image in mixed.image])
    moved = np.where((mixed.colrow + off > 0) & (mixed.colrow + off < size), mixed.colrow + off, mixed.colrow - off)
    return np.where(wrong[:, None], moved, mixed.colrow), wrong


def named(mixed: Mixed, found: Any) -> np.ndarray:
    """Image positions (N,) that the adjustment left out."""
    left_out = {(each.image, each.point) for each in found.blunders if each.kind == "image positions"}
    return np.array([(i, mixed.ids[p]) in left_out for i, p in zip(mixed.image, mixed.point, strict=True)])


def test_gross_ties_and_wrong_control_of_a_mixed_block_are_named(mixed: Mixed) -> None:
    """3 % of all image positions; a control point moved in plan and one in height. No good one goes with them."""
    measured, wrong = with_gross_errors(mixed, 0.03, 4)
    given = mixed.given.copy()
    given[1, :2] += [8.0, -6.0]
    given[7, 2] += 5.0
    found = mixed.adjusted(colrow=measured, given=given)
    out = named(mixed, found)
    assert out[wrong].all()
    assert (out & ~wrong).sum() <= 0.001 * len(wrong)
    control = {each.point: each for each in found.blunders if each.kind == "control"}
    assert set(control) == {"c1", "c7"}
    assert "height is wrong" in control["c7"].cause


@pytest.mark.slow  # 3 % by default
@pytest.mark.parametrize("seeds", [(6,), tuple(range(4, 10))], ids=["one", "six"])
def test_many_gross_errors_of_a_mixed_block_hardly_change_it(mixed: Mixed, clean: Any, seeds: tuple[int, ...]) -> None:
    """10 %; the ratio of the RMS at check points varies by a tenth or so, as other rays of them are lost."""
    ratios = []
    for seed in seeds:
        measured, wrong = with_gross_errors(mixed, 0.1, seed)
        found = mixed.adjusted(colrow=measured)
        out = named(mixed, found)
        assert out[wrong].all()
        assert (out & ~wrong).sum() <= 0.001 * len(wrong)
        ratios.append(check_rms(found) / check_rms(clean))
    assert np.median(ratios) < 1.2


def test_pixels_of_any_sensor_have_the_angle_that_they_cover_on_the_ground(clean: Any) -> None:
    """Also those of rational polynomials, whose lines of sight start nowhere."""
    solution, sizes = clean.solution, {"film": 3.0, "drone": 0.6, "spot": 21.0, "rpc": 21.0}
    frame = solution.adjustment.problem.frame
    for scene in clean.scenes:
        middle = np.array([scene.model.size]) / 2.0
        origins, _, angle = image_rays(scene.model, middle, frame.local)
        covered = float(angle[0] * np.linalg.norm(origins[0]))
        assert covered == pytest.approx(sizes[scene.name[: scene.name.index("_")]], rel=0.35)


def test_films_without_their_marks_are_refused(mixed: Mixed) -> None:
    blocks, ties = mixed.declared(("film",), mixed.colrow, mixed.given)
    without = gm.Block(
        blocks[0].images, "frame", camera=blocks[0].camera, exterior=blocks[0].exterior, crs=blocks[0].crs,
        heights="ellipsoidal", control=blocks[0].control,
    )  # fmt: skip
    with pytest.raises(InputError, match="fiducial"):
        gm.adjust(without, ties=ties, sigma_px=NOISE)


def test_a_project_declares_films_with_the_marks_of_each_scan_beside_other_sensors(mixed: Mixed) -> None:
    start = start_block(load_project(write_project(mixed)).blocks)
    assert [scene.sensor for scene in start.scenes] == ["frame"] * 13 + ["pushbroom"] * 2 + ["rpc"] * 2
    assert len(set(start.camera[:4].tolist())) == 1
    assert len(set(start.camera.tolist())) == 4
    image = mixed.declared(("film",), mixed.colrow, mixed.given)[0]
    for scene, same in zip(start.scenes[:4], start_block(image).scenes, strict=True):
        place = np.array([scene.model.seed])
        assert np.isfinite(scene.model.ground_to_image(place)).all()
        assert np.allclose(scene.model.ground_to_image(place), same.model.ground_to_image(place), atol=1e-9)


@pytest.mark.slow
def test_a_project_of_many_sensors_is_adjusted_and_mosaicked(mixed: Mixed, capsys: pytest.CaptureFixture[str]) -> None:
    """Films with the marks of each scan under [sensor], three tables [[images]], two of them with other sensors."""
    project = write_project(mixed)
    assert run(["adjust", str(project), "--json"]) == 0
    facts = json.loads(Path(json.loads(capsys.readouterr().out)["outputs"]["adjustment"]).read_text())
    assert facts["described"] == "17 images (13 frame, 2 pushbroom, 2 rpc)"
    assert facts["sigma0_as_expected"]
    assert facts["checks"]["rms_plan"] < 0.5
    assert facts["checks"]["rms_height"] < 1.0
    assert run(["run", str(project), "mosaic", "--json"]) == 0
    assert [step["fresh"] for step in json.loads(capsys.readouterr().out)["steps"]] == [True, False]
    with rasterio.open(mixed.folder / "output" / "hills.tif") as mosaic:
        # The films cover some 9 km of the 12 km of the DEM, the scenes all of it.
        assert mosaic.width * mosaic.res[0] == pytest.approx(12e3, abs=100.0)
