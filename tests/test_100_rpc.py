"""The command `rpc`: fits told truly, refinements that find the truth, files that GDAL takes, and how it fails."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rpc_rig as rig
from affine import Affine
from rpc_rig import blank, gdal
from spot_rig import SIZE, Satellite

import geomosaic as gm
from geomosaic.cli.main import run
from geomosaic.errors import InputError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.sensor.solve import image_to_height
from geomosaic_rpc import RpcModel, write_tags
from geomosaic_rpc.model import WGS84

TRUE = Satellite(attitude=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0))
OFF = np.array([4.5, -3.25])


def asked(capsys: pytest.CaptureFixture[str], *words: str) -> list[dict[str, Any]]:
    assert run([*words, "--json"]) == 0, capsys.readouterr()
    images: list[dict[str, Any]] = json.loads(capsys.readouterr().out)["images"]
    return images


def off(model: SensorModel, path: Path, low: float, high: float) -> float:
    """Largest distance in pixels between a model and GDAL's view of a file, at places no fit has seen."""
    rng = np.random.default_rng(8)
    places = rng.uniform([0, 0], model.size, (400, 2))
    ground = image_to_height(model, places, rng.uniform(low, high, 400), WGS84)
    return float(np.hypot(*(gdal(path, ground) - places).T).max())


@pytest.mark.parametrize("how", ["--text", pytest.param("--tags", marks=pytest.mark.slow)])
def test_an_rpc_is_fitted_to_a_spot_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str], how: str) -> None:
    """By GDAL, from the file alone: within 0.01 px of the rigorous model, and of what the command says."""
    image = blank(tmp_path / "IMAGERY.TIF", SIZE)
    (tmp_path / "METADATA.DIM").write_text(TRUE.dimap())
    words = ["rpc", str(image), "--sensor", "pushbroom", "--height-range", "0", "900"]
    (told,) = asked(capsys, *words, how)
    assert told["how"] == "fitted"
    assert told["fit_worst_px"] < 0.01
    assert told["heights_m"] == [0.0, 900.0]
    request = SensorRequest("scene", SIZE, {"metadata": "METADATA.DIM"}, None, str(tmp_path))
    apart = off(registry.build("pushbroom", request), image, 0.0, 900.0)
    assert apart < 0.01
    assert apart < 2.0 * told["fit_worst_px"] + 1e-4
    ours = registry.build("rpc", SensorRequest("s", SIZE, {}, None, ".", str(image)))
    assert isinstance(ours, RpcModel)
    lonlath = np.array(ours.seed) + np.random.default_rng(3).uniform(-1, 1, (300, 3)) * [0.2, 0.2, 400.0]
    assert np.abs(ours.ground_to_image(lonlath) - gdal(image, lonlath)).max() < 1e-6
    assert run([*words, how]) == 1  # never over an RPC that is there
    assert "--overwrite" in capsys.readouterr().err


FRAME = {
    "position": [500000.0, 5400000.0, 1500.0],
    "orientation": {"system": "opk", "omega": 4.0, "phi": -3.0, "kappa": 25.0},
    "ground_height": 450.0,
}
LENSES = {
    "mapping camera": ({"model": "brown", "k1": -0.008, "k2": 0.001, "p1": 1e-4, "p2": -1e-4}, 0.0, 0.01),
    "action camera": ({"model": "opencv", "k1": -0.3, "k2": 0.1}, 0.2, 5.0),
}


@pytest.mark.parametrize("lens", LENSES)
def test_an_rpc_is_fitted_to_a_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str], lens: str) -> None:
    """Heights from the DEM; a lens that is too much for cubics is not flattered."""
    distortion, least, most = LENSES[lens]
    size = (4000, 3000)
    image = blank(tmp_path / "photo.tif", size)
    x, y = np.meshgrid(498005.0 + 10.0 * np.arange(400), 5401995.0 - 10.0 * np.arange(400))
    grid = {"width": 400, "height": 400, "crs": 32633, "transform": Affine(10, 0, 498000, 0, -10, 5402000)}
    with rasterio.open(tmp_path / "dem.tif", "w", driver="GTiff", count=1, dtype="float64", **grid) as file:
        file.write(450.0 + 150.0 * np.sin(x / 300.0) * np.sin(y / 250.0), 1)
    options = {**FRAME, "camera": {"focal_length": 20.0, "sensor_size": [24.0, 18.0], "distortion": distortion}}
    more = [word for key, value in options.items() for word in ("--option", f"{key}={json.dumps(value)}")]
    place = ["--sensor", "frame", "--crs", "EPSG:32633", "--heights", "ellipsoidal"]
    ground = ["--dem", str(tmp_path / "dem.tif"), "--dem-heights", "ellipsoidal"]
    (told,) = asked(capsys, "rpc", str(image), *place, *ground, *more, "--tags")
    low, high = told["heights_m"]
    assert 200.0 < low < 310.0
    assert 590.0 < high < 700.0
    utm = with_heights(parse_crs("EPSG:32633"), "ellipsoidal")
    apart = off(registry.build("frame", SensorRequest("photo", size, options, utm)), image, low, high)
    assert least <= apart <= most
    assert told["fit_worst_px"] > 0.6 * apart
    assert told["fit_rms_px"] < told["fit_worst_px"]


def scene(folder: Path, name: str = "scene.tif") -> tuple[Path, RpcModel]:
    """A scene with an RPC that is off by `OFF`, and its true model."""
    image = blank(folder / name, rig.SIZE)
    true = rig.model("affine").with_values(np.array([*OFF, 1.5, -0.5, 0.8, 0.6]))
    write_tags(rig.model(), image)
    return image, true


def control(folder: Path, true: RpcModel, image: Path, count: int = 14) -> tuple[Path, list[str]]:
    """Control in a map CRS with geoid heights, three points of it wrong; four more points check."""
    rng = np.random.default_rng(11)
    places = rng.uniform([0, 0], true.size, (count + 4, 2))
    ground = image_to_height(true, places, rng.uniform(0.0, 800.0, count + 4), WGS84)
    utm = with_heights(parse_crs("EPSG:32633"), "egm96")
    xyz = Transform(WGS84, utm)(ground)
    places += rng.normal(0, 0.1, places.shape)
    places[:3] += [[30.0, -12.0], [-25.0, 40.0], [9.0, 9.0]]
    rows = np.column_stack([xyz, places]).tolist()
    lines = [
        f"p{i},{x!r},{y!r},{z!r},{image.name},{c!r},{r!r},0.1,{'control' if i < count else 'check'}"
        for i, (x, y, z, c, r) in enumerate(rows)
    ]
    table = folder / "gcps.csv"
    table.write_text("id,x,y,z,image,col,row,sigma_px,role\n" + "\n".join(lines) + "\n")
    return table, ["--gcps", str(table), "--crs", "EPSG:32633", "--heights", "egm96"]


def test_refined_with_control(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The affine correction comes back through a map CRS and geoid heights; three wrong points change nothing."""
    image, true = scene(tmp_path)
    _, given = control(tmp_path, true, image)
    folder = ["--text", "--folder", str(tmp_path / "refined")]
    (told,) = asked(capsys, "rpc", str(image), "--refine", "affine", *given, *folder)
    assert told["how"] == "control points"
    assert told["left_out"] == ["p0", "p1", "p2"]
    assert told["rms_after_px"] < 0.2 < 3.0 < told["rms_before_px"]
    assert told["checks"] == 4
    assert told["check_rms_after_px"] < 0.3 < 3.0 < told["check_rms_before_px"]
    found = list(told["corrections_px"].values())
    assert np.allclose(found, true.parameters.values, atol=0.25)
    assert (np.abs(found - true.parameters.values) < 4.5 * np.array(list(told["sigmas_px"].values()))).all()
    assert told["rewritten_worst_px"] < 1e-3
    accuracy = told["accuracy"]
    assert 0.0 < accuracy["middle_sigma_px"] < accuracy["largest_sigma_px"] < 1.0
    places = np.array([[0, 0], [rig.SIZE[0], 0], rig.SIZE, [0, rig.SIZE[1]]], dtype=float)
    found_at, true_at = (np.array([each.ground_to_image(image_to_height(true, places, 300.0, WGS84))]) for each in
                         (true.with_values(np.array(found)), true))  # fmt: skip
    assert np.hypot(*(found_at - true_at)[0].T).max() < 3.0 * accuracy["largest_sigma_px"]
    copy = blank(tmp_path / "refined" / "scene.tif", rig.SIZE)
    apart = np.hypot(*(gdal(copy, rig.ground()) - true.ground_to_image(rig.ground())).T)
    assert apart.max() < 0.4
    assert run(["rpc", str(image), "--refine", "shift", *given, "--tags", "--overwrite"]) == 0
    said = capsys.readouterr().out
    assert "left out: p0, p1" in said
    assert "px at the corners of the image" in said
    assert "check points" in said


def pair(folder: Path) -> tuple[list[Path], list[RpcModel]]:
    """Two scenes looked at from two sides, the second of which is off."""
    images = [blank(folder / f"{name}.tif", rig.SIZE) for name in ("left", "right")]
    models = [rig.model("shift"), rig.model("shift")]
    turned = models[1].rpc.coefficients.copy()
    turned[0, 3] = -turned[0, 3] + 0.004  # another height term: another direction of sight
    from dataclasses import replace

    models[1] = RpcModel.of(replace(models[1].rpc, coefficients=turned), rig.SIZE, "shift")
    for image, model in zip(images, models, strict=True):
        write_tags(model, image)
    return images, [models[0], models[1].with_values(np.array([0.0, 2.5, 0, 0, 0, 0]))]


def test_control_without_a_vertical_datum_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Ellipsoidal or geoid, that is 44 m and nine pixels here: nothing is guessed."""
    image = blank(tmp_path / "scene.tif", rig.SIZE)
    write_tags(rig.model(), image)
    ground = rig.ground(4)
    rows = zip(ground.tolist(), rig.model().ground_to_image(ground).tolist(), strict=True)
    lines = [f"p{k},{x!r},{y!r},{z!r},scene.tif,{c!r},{r!r}" for k, ((x, y, z), (c, r)) in enumerate(rows)]
    (tmp_path / "gcps.csv").write_text("id,x,y,z,image,col,row\n" + "\n".join(lines) + "\n")
    words = ["rpc", str(image), "--refine", "shift", "--gcps", str(tmp_path / "gcps.csv"), "--crs", "EPSG:4326"]
    assert run(words) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "the heights of the control points have no vertical datum" in said
    assert "px in the image" in said
    assert run([*words, "--heights", "ellipsoidal"]) == 0


def test_a_refinement_without_points_and_ties_of_a_fit_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = blank(tmp_path / "scene.tif", rig.SIZE)
    write_tags(rig.model(), image)
    for words, said in (
        (["--refine", "shift"], "give control or --ties"),
        (["--refine", "shift", "--sigma-px", "2"], "--sigma-px would do nothing without --ties"),
        (["--refine", "shift", "--fixed", "scene.tif"], "--fixed would do nothing without --ties"),
        (["--sigma-px", "0.2"], "--sigma-px refines RPCs"),
    ):
        assert run(["rpc", str(image), *words]) == 1
        assert said in " ".join(capsys.readouterr().err.split())
    with pytest.raises(InputError, match="out of range"):
        gm.refine_rpc(image, "shift", ties=tmp_path / "ties.csv", sigma_px=-4.0)


def test_refined_against_another_image(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Tie points bring the lines of sight together; the scene that is held keeps its RPC."""
    images, true = pair(tmp_path)
    rng = np.random.default_rng(5)
    ground = rig.ground()[:60]
    lines = [
        f"t{k},{image.name},{c!r},{r!r}"
        for image, model in zip(images, true, strict=True)
        for k, (c, r) in enumerate((model.ground_to_image(ground) + rng.normal(0, 0.1, (len(ground), 2))).tolist())
    ]
    table = tmp_path / "ties.csv"
    table.write_text("id,image,col,row\n" + "\n".join(lines) + "\n")
    words = ["rpc", *map(str, images), "--refine", "shift", "--ties", str(table), "--sigma-px", "0.1"]
    left, right = asked(capsys, *words, "--fixed", "left.tif", "--tags", "--overwrite")
    assert left["how"] == "as it came"
    assert right["how"] == "tie points"
    assert right["rms_before_px"] > 5 * right["rms_after_px"]
    assert right["rms_after_px"] < 0.2
    before = RpcModel.of(true[0].rpc, rig.SIZE)
    assert np.abs(gdal(images[0], ground) - before.ground_to_image(ground)).max() < 1e-6
    # The part across the plane of the two sights is found: rows here, as heights move columns.
    assert right["corrections_px"]["row_shift"] == pytest.approx(2.5, abs=0.2)


WRONG = {
    "no heights": (["--sensor", "pushbroom"], 1, "--height-range"),
    "no box": (["--sensor", "pushbroom", "--height-range", "100", "100"], 1, "no box"),
    "refining a rigorous sensor": (["--sensor", "pushbroom", "--refine", "shift"], 1, "corrects an RPC"),
    "unknown kind": (["--refine", "shfit"], 1, "did you mean 'shift'"),
    "points without kind": (["--gcps", "gcps.csv"], 1, "--refine"),
    "folder without text": (["--folder", "x"], 1, "--text"),
    "ties without kind": (["--ties", "ties.csv"], 1, "add --refine"),
    "grid of a refined RPC": (["--refine", "shift", "--gcps", "gcps.csv", "--grid", "--text"], 1, "leave it out"),
    "grid without a file": (["--sensor", "pushbroom", "--grid"], 1, "without --text or --tags"),
    "grid of an image's own RPC": (["--grid", "--tags"], 1, "come with an RPC of their own"),
    "no RPC": ([], 1, "carries no RPC"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_calls_are_refused_with_a_hint(tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str) -> None:
    given, code, said = WRONG[case]
    image = blank(tmp_path / "IMAGERY.TIF", SIZE)
    (tmp_path / "METADATA.DIM").write_text(TRUE.dimap())
    assert run(["rpc", str(image), *given]) == code
    assert said in capsys.readouterr().err
    assert not list(tmp_path.glob("*_RPC*"))


def test_ties_that_tie_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images, _ = pair(tmp_path)
    table = tmp_path / "ties.csv"
    words = ["rpc", *map(str, images), "--refine", "shift", "--ties", str(table)]
    for text, said in (
        ("id,image,col,row\na,other.tif,1,2\n", "no tie point is measured in these images"),
        ("id,image,col,row\na,left.tif,1,2\na,left.tif,3,4\n", "on line 2"),
        ("id,image,col,row\na,left.tif,1,2\nb,right.tif,3,4\n", "seen in two scenes"),
    ):
        table.write_text(text)
        assert run(words) == 1
        assert said in capsys.readouterr().err
    assert run([*words, "--fixed", "middle.tif"]) == 1
    assert "no image is named 'middle.tif'" in capsys.readouterr().err
