"""Block adjustment from declared images and tables: what comes out is what was true, and bad input is told."""

from __future__ import annotations

import json
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import block_rig
import numpy as np
import pytest
import rasterio
import rpc_rig
from adjust_project_rig import Block, grid_block, write_project
from pyproj import CRS

import geomosaic as gm
from geomosaic.block_adjustment.measurements import control_of
from geomosaic.block_adjustment.result import AdjustedBlock
from geomosaic.errors import GeomosaicError, GeomosaicWarning, InputError, SolveError
from geomosaic.estimation import elimination
from geomosaic.geo.engineering_crs import local_frame_crs
from geomosaic.inputs.build import build_block
from geomosaic.inputs.orientation_covariance import with_covariances
from geomosaic.inputs.tie_points import TiePoints, read_ties
from geomosaic.orientation.block.poses import pose_of
from geomosaic.raster.vector import read_layer

OPTIONS: dict[str, Any] = {"sigma_px": 0.3, "position_sigma": 20.0, "attitude_sigma": 0.5}


def declared(folder: Path, **more: Any) -> gm.Block:
    given = {
        "camera": folder / "camera.toml", "exterior": folder / "exterior.csv", "crs": "EPSG:32633",
        "heights": "ellipsoidal", "control": folder / "control.csv", "dem": folder / "dem.tif",
        "dem_heights": "ellipsoidal", **more,
    }  # fmt: skip
    return gm.Block(sorted((folder / "photos").glob("*.tif")), "frame", **given)


def centre_errors(found: AdjustedBlock, truth: Block) -> np.ndarray:
    return np.array(
        [
            pose_of(found.models[f"{name}.tif"], truth.frame).centre - pose_of(model, truth.frame).centre
            for name, model in zip(truth.names, truth.models, strict=True)
        ]
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("block")
    write_project(base, truth())
    return base


def truth() -> Block:
    return grid_block(2, 4, 30, seed=3)


@pytest.fixture(scope="module")
def adjusted(folder: Path) -> AdjustedBlock:
    return gm.adjust(declared(folder), ties=folder / "ties.csv", **OPTIONS)


def test_a_block_comes_back_from_disturbed_orientations(adjusted: AdjustedBlock) -> None:
    errors = centre_errors(adjusted, truth())
    sigmas = np.array([list(image["sigmas"].values())[:3] for image in adjusted.facts["images"]])
    assert np.abs(errors).max() < 3.0
    assert 0.5 < np.sqrt(((errors / sigmas) ** 2).mean()) < 1.6
    assert adjusted.facts["sigma0_as_expected"]
    assert adjusted.facts["checks"]["rms_plan"] < 0.3


def test_a_block_too_large_for_a_factor_ends_well_and_says_what_it_goes_without(
    folder: Path, adjusted: AdjustedBlock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong, ties = "s1p2.tif", read_ties(folder / "ties.csv")
    colrow = ties.colrow.copy()
    rays = Counter(ties.points)
    row = next(k for k, image in enumerate(ties.images) if image == wrong and rays[ties.points[k]] >= 4)
    colrow[row] += [0.0, 40.0]
    monkeypatch.setattr(elimination, "LARGEST", 2)
    found = gm.adjust(declared(folder), ties=replace(ties, colrow=colrow), **OPTIONS)
    assert "conjugate gradients: covariances" in found.summary
    assert [(each.image, each.point) for each in found.blunders] == [(wrong, ties.points[row])]
    assert found.sigma0 == pytest.approx(adjusted.sigma0, rel=0.02)
    for name, scene in adjusted.models.items():
        off = scene.parameters.values - found.models[name].parameters.values
        assert np.abs(off / scene.parameters.steps).max() < 1.0
    files = found.write(tmp_path)
    assert json.loads((files["models"] / wrong).with_suffix(".tif.json").read_text())["covariance"] is None
    assert "sigma_x" not in files["exterior"].read_text().splitlines()[0]
    assert np.isnan(read_layer(files["points"])["sigma_z"]).all()
    assert "are not computed" in files["report"].read_text()


def test_covariances_of_tie_points_count_in_place_of_one_sigma(folder: Path, adjusted: AdjustedBlock) -> None:
    ties, random = read_ties(folder / "ties.csv"), np.random.default_rng(5)
    # Walls and kerbs hold a patch badly along themselves, wherever they run.
    angle = random.uniform(0.0, np.pi, len(ties))
    turn = np.stack([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]).transpose(2, 0, 1)
    noise = np.einsum("nij,nj->ni", turn, random.normal(0.0, 1.0, (len(ties), 2)) * [4.0, 0.1])
    covariance = turn @ np.diag([4.0**2, 0.3**2]) @ turn.transpose(0, 2, 1)
    noisy = replace(ties, colrow=ties.colrow + noise, covariance=covariance)
    plain = replace(noisy, covariance=None)
    assert plain.sigma[0] == pytest.approx(np.sqrt(16.09 / 2.0))
    whole, mean = (gm.adjust(declared(folder), ties=each, **OPTIONS) for each in (noisy, plain))
    off = [np.sqrt((centre_errors(each, truth()) ** 2).mean()) for each in (whole, mean)]
    assert off[0] < 0.8 * off[1]
    assert not whole.facts["observations"][0]["rejected"]


def test_scenes_with_rpcs_meet_without_control_and_stay_where_they_were(tmp_path: Path) -> None:
    shifts = {"a": [6.0, -3.0], "b": [-4.0, 5.0]}
    profile = {"driver": "GTiff", "width": rpc_rig.SIZE[0], "height": rpc_rig.SIZE[1], "count": 1, "dtype": "uint8"}
    for name, slant in (("a", 0.031), ("b", 0.25)):
        (tmp_path / f"{name}_RPC.TXT").write_text(
            re.sub(r"(SAMP_NUM_COEFF_4: ).*", rf"\g<1>{slant}", rpc_rig.rpc_txt())
        )
        with rasterio.open(tmp_path / f"{name}.tif", "w", sparse_ok=True, **profile):
            pass
    block = gm.Block(sorted(tmp_path.glob("*.tif")), "rpc")
    ground, models = rpc_rig.ground(40), {scene.name: scene.model for scene in build_block(block, ground=False).scenes}
    images = [name for name in models for _ in ground]
    colrow = np.vstack([model.ground_to_image(ground) + shifts[name[0]] for name, model in models.items()])
    colrow += np.random.default_rng(2).normal(0.0, 0.1, colrow.shape)
    found = gm.adjust(block, ties=TiePoints([str(k % 40) for k in range(80)], images, colrow, np.full(80, 0.1)))
    assert found.facts["observations"][0]["rms"] < 0.1
    values = np.array([model.parameters.values[:2] for model in found.models.values()])
    # Across the epipolar lines both come together; what moves both alike, or all heights, is shared out.
    assert np.abs(values - list(shifts.values())).max() > 1.0
    assert np.abs(values).max() < 20.0
    assert found.sigma0 == pytest.approx(1.0, abs=0.4)


def test_the_story_names_what_went_in_and_what_came_out(adjusted: AdjustedBlock) -> None:
    told = adjusted.summary
    assert len(told.splitlines()) <= 24
    for words in ("8 images (8 frame)", "sigma0 ", "camera positions: 8", "control points: 4, RMS", "check points: 2"):
        assert words in told
    assert json.loads(json.dumps(adjusted.facts["observations"]))[0]["unit"] == "px"


def test_files_of_a_result_hold_models_points_and_orientations(adjusted: AdjustedBlock, tmp_path: Path) -> None:
    files = adjusted.write(tmp_path / "out")
    state = json.loads((files["models"] / "s1p1.tif.json").read_text())
    assert np.shape(state["covariance"]) == (6, 6)
    points = read_layer(files["points"])
    assert len(points) == len(adjusted.points)
    assert points.geometry.iloc[0].has_z
    assert {"id", "rays", "sigma_z", "cor_x_y"} <= set(points.columns)
    two = points["rays"] == 2
    assert points["detectable_px"][two & (points["role"] == "tie")].isna().all()
    assert (points["detectable_px"][points["rays"] > 3] > 4 * 0.3).all()
    again = gm.Block(
        sorted((tmp_path / "none").glob("*")) or adjusted.start.scenes[0].path, "frame",
        camera=Path(adjusted.start.scenes[0].path).parents[1] / "camera.toml", exterior=files["exterior"],
        crs="EPSG:32633", heights="ellipsoidal",
    )  # fmt: skip
    model = build_block(again, ground=False).scenes[0].model
    xyz = np.array([model.seed])
    assert np.allclose(model.ground_to_image(xyz), adjusted.scenes[0].model.ground_to_image(xyz), atol=1e-4)
    assert json.loads(files["facts"].read_text())["redundancy"] == adjusted.facts["redundancy"]
    assert f"{adjusted.sigma0:.3f}" in files["report"].read_text()


def test_photos_without_any_orientation_are_oriented_by_ties_and_control(folder: Path) -> None:
    found = gm.adjust(declared(folder, exterior=None), ties=folder / "ties.csv", sigma_px=0.3)
    assert np.abs(centre_errors(found, truth())).max() < 3.0
    assert "8 without an orientation" in found.summary


def test_positions_alone_and_gaps_of_a_table_are_enough_beside_tie_points(folder: Path, tmp_path: Path) -> None:
    """All angles missing; or those of one photo and the position of another: nothing is asked for."""
    cells = [line.split(",") for line in (folder / "exterior.csv").read_text().splitlines()]
    columns = [cells[0].index(name) for name in ("image", "x", "y", "z", "omega", "phi", "kappa")]
    rows = [[line[column] for column in columns] for line in cells]
    table = tmp_path / "positions.csv"
    table.write_text("".join(",".join(row[:4]) + "\n" for row in rows))
    options = {name: value for name, value in OPTIONS.items() if name != "attitude_sigma"}
    given = declared(folder, exterior=table, angles="none", control=None)
    found = gm.adjust(given, ties=folder / "ties.csv", **options)
    assert np.abs(centre_errors(found, truth())).max() < 60.0  # positions of 20 m
    assert "8 without an orientation, 8 of these with a position" in found.summary
    assert found.facts["sigma0_as_expected"]
    rows[2][4:], rows[5][1:4] = [""] * 3, [""] * 3
    table.write_text("".join(",".join(row) + "\n" for row in rows))
    found = gm.adjust(declared(folder, exterior=table), ties=folder / "ties.csv", **OPTIONS)
    assert np.abs(centre_errors(found, truth())).max() < 3.0
    assert "camera positions: 7" in found.summary
    assert "attitudes: 6" in found.summary


def test_an_image_that_its_table_does_not_orient_is_told_to_whoever_needs_it(folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "positions.csv"
    lines = (folder / "exterior.csv").read_text().splitlines()
    table.write_text("image,x,y,z\n" + "\n".join(",".join(line.split(",")[:4]) for line in lines[1:]) + "\n")
    with pytest.raises(InputError, match=r"the table has no angles of this image") as caught:
        build_block(declared(folder, exterior=table, angles="none", control=None))
    assert "line 2" in str(caught.value)
    assert "[match] or [adjust]" in str(caught.value.hint)


def test_camera_positions_hold_a_block_without_control(folder: Path) -> None:
    found = gm.adjust(declared(folder, control=None), ties=folder / "ties.csv", **OPTIONS)
    sigmas = np.array([list(image["sigmas"].values())[:3] for image in found.facts["images"]])
    assert (np.abs(centre_errors(found, truth())) < 4.0 * sigmas).all()
    assert (sigmas > 2.0).all()  # eight positions of 20 m


def test_a_dem_observes_the_heights_of_tie_points(folder: Path, adjusted: AdjustedBlock) -> None:
    found = gm.adjust(declared(folder), ties=folder / "ties.csv", dem_sigma=0.3, **OPTIONS)
    named = {each["name"]: each for each in found.facts["observations"]}
    assert named["heights of the DEM"]["used"] > 50
    assert 0.5 < named["heights of the DEM"]["variance_factor"] < 1.5 or named["heights of the DEM"]["rms"] < 0.3
    before, after = adjusted.facts["points"]["median_sigmas"][2], found.facts["points"]["median_sigmas"][2]
    assert after < before


def test_a_dem_on_another_height_datum_is_told_and_bends_nothing(
    folder: Path, adjusted: AdjustedBlock, tmp_path: Path
) -> None:
    dem = tmp_path / "dem.tif"
    with rasterio.open(folder / "dem.tif") as source, rasterio.open(dem, "w", **source.profile) as sink:
        sink.write(source.read() + np.float32(8.0))
    found = gm.adjust(declared(folder, dem=dem), ties=folder / "ties.csv", dem_sigma=0.3, **OPTIONS)
    (wrong,) = found.facts["wrong_groups"]
    assert (wrong["kind"], wrong["left_out"], wrong["others"]) == ("heights of the DEM", True, ["control"])
    assert not found.blunders
    assert "heights of the DEM are left out: in the median they are 8." in found.summary
    assert "another height datum?" in found.page("block")
    assert found.facts["checks"]["rms_height"] == pytest.approx(adjusted.facts["checks"]["rms_height"], abs=0.1)


def test_a_focal_length_that_is_set_free_is_found(folder: Path, tmp_path: Path) -> None:
    camera = tmp_path / "camera.toml"
    camera.write_text((folder / "camera.toml").read_text().replace("5000.0", "5010.0"))
    block = declared(folder, camera=camera)
    found = gm.adjust(block, ties=folder / "ties.csv", interior=["focal_length"], **OPTIONS)
    (parameter,) = found.facts["cameras"][0]["parameters"]
    assert abs(parameter["after"] - 5000.0) < 3.5 * parameter["sigma"]
    assert parameter["before"] == 5010.0
    assert np.shape(found.covariances[0])[0] > 6


@pytest.mark.ci
def test_self_calibration_sets_free_what_the_block_determines(folder: Path, tmp_path: Path) -> None:
    """Of a lens without distortion, declared with some: k1 comes back to 0, and nothing is free that need not be."""
    camera = tmp_path / "camera.toml"
    camera.write_text((folder / "camera.toml").read_text() + '[distortion]\nmodel = "brown"\nk1 = -0.02\n')
    options: dict[str, Any] = {"interior": ["focal_length=50"], "self_calibration": True, **OPTIONS}
    with quietly():
        found = gm.adjust(declared(folder, camera=camera), ties=folder / "ties.csv", **options)
    parameters = {each["name"]: each for each in found.facts["cameras"][0]["parameters"]}
    assert set(parameters) == {"focal_length", "k1"}
    assert abs(parameters["k1"]["after"]) < 3.5 * parameters["k1"]["sigma"] < 0.005
    assert abs(parameters["focal_length"]["after"] - 5000.0) < 3.5 * parameters["focal_length"]["sigma"]
    assert found.facts["offered"] == []
    assert "self-calibration: k1 set free" in found.summary
    assert 0.6 < ground_errors(found) < 1.4
    assert gm.adjust(declared(folder), ties=folder / "ties.csv", **options).set_free == ()


def ground_errors(found: AdjustedBlock) -> float:
    """RMS of the errors of tie points over their standard deviations."""
    block = truth()
    true, squares = block.frame.to_ground(block.points), []
    for name, place, covariance in zip(
        found.solution.ids, found.solution.ground, found.solution.point_covariance, strict=True
    ):
        if name.startswith("t") and np.isfinite(covariance).all():
            off = place - true[int(name[1:])]
            squares.append(off @ np.linalg.solve(covariance, off) / 3.0)
    assert len(squares) > 60
    return float(np.sqrt(np.mean(squares)))


@pytest.mark.ci
def test_the_ground_is_right_whichever_radial_terms_make_up_for_a_wrong_lens(folder: Path, tmp_path: Path) -> None:
    """A wrong term in r⁹ is mended by k1 and k2 to 0.31 px, of 0.28 by itself: the ground has the errors it tells."""
    camera = tmp_path / "camera.toml"
    camera.write_text((folder / "camera.toml").read_text() + '[distortion]\nmodel = "brown"\nk4 = 0.2\n')
    options: dict[str, Any] = {"interior": ["focal_length=50"], "self_calibration": True, **OPTIONS}
    with quietly():
        found = gm.adjust(declared(folder, camera=camera), ties=folder / "ties.csv", **options)
    assert {each["name"] for each in found.facts["cameras"][0]["parameters"]} == {"focal_length", "k1", "k2"}
    assert 0.6 < ground_errors(found) < 1.4


def test_the_lens_of_a_single_image_is_held_and_its_focal_length_found_from_what_is_known_of_it(
    folder: Path, tmp_path: Path
) -> None:
    """A movie frame among photos: nothing orients it, and its focal length, 30 % too long, is a guess."""
    guess = tmp_path / "guess.toml"
    guess.write_text((folder / "camera.toml").read_text().replace("5000.0", "6500.0"))
    exterior = changed(
        folder, "exterior.csv", tmp_path, lambda line: "s2p4.tif,,,,,," if line.startswith("s2p4") else line
    )
    block = replace(
        declared(folder, control=None, exterior=exterior), image_options={"s2p4.tif": {"camera": str(guess)}}
    )
    interior = ["focal_length=200", "focal_length:s2p4.tif=1950", "principal_point=40", "k1", "k2"]
    with pytest.warns(GeomosaicWarning, match="single image and no control point .* held as given: s2p4.tif"):
        found = gm.adjust(block, ties=folder / "ties.csv", interior=interior, self_calibration=True, **OPTIONS)
    several, single = ({each["name"]: each for each in camera["parameters"]} for camera in found.facts["cameras"])
    assert {"focal_length", "principal_col", "k1", "k2"} < set(several)
    assert set(single) == {"focal_length"}
    for focal in (several["focal_length"], single["focal_length"]):
        assert abs(focal["after"] - 5000.0) < 3.5 * focal["sigma"] < 500.0


def test_a_parameter_of_the_camera_of_an_unknown_image_is_told(folder: Path) -> None:
    with pytest.warns(GeomosaicWarning, match="images that are not in the block, not used: focal_length:other.tif"):
        gm.adjust(declared(folder), ties=folder / "ties.csv", interior={"focal_length:other.tif": 5.0}, **OPTIONS)


@contextmanager
def quietly() -> Iterator[None]:
    """Without the notes that another test is about."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomosaicWarning)
        yield


def changed(folder: Path, name: str, tmp_path: Path, change: Any) -> Path:
    lines = (folder / name).read_text().splitlines()
    path = tmp_path / name
    path.write_text("\n".join([lines[0], *(each for line in lines[1:] if (each := change(line)) is not None)]) + "\n")
    return path


def test_points_of_the_control_table_may_be_known_in_plan_or_in_height_alone(folder: Path, tmp_path: Path) -> None:
    def part(line: str) -> str:
        fields = line.split(",")
        if fields[0] == "c0":
            fields[3] = ""
        if fields[0] == "c1":
            fields[1] = fields[2] = ""
        return ",".join(fields)

    control = changed(folder, "control.csv", tmp_path, part)
    found = gm.adjust(declared(folder, control=control), ties=folder / "ties.csv", **OPTIONS)
    errors = {each["id"]: each["errors"] for each in found.facts["control"]["points"]}
    assert np.isnan(errors["c0"][2])
    assert abs(errors["c0"][0]) < 0.2
    assert np.isnan(errors["c1"][0])
    assert abs(errors["c1"][2]) < 0.2
    assert np.abs(centre_errors(found, truth())).max() < 6.0


def test_control_values_without_heights_hold_the_plan_alone(folder: Path) -> None:
    """They do not lie at height 0."""
    lines = [line.split(",") for line in (folder / "control.csv").read_text().splitlines()[1:]]
    rows = [fields for fields in lines if fields[-1] == "control"]
    control = {}
    for image in {fields[4] for fields in rows}:
        own = [fields for fields in rows if fields[4] == image]
        numbers = np.array([fields[1:3] + fields[5:7] for fields in own], dtype=float)
        control[image] = gm.ControlPoints.from_arrays(
            numbers[:, 2:], numbers[:, :2], "EPSG:32633", names=[fields[0] for fields in own]
        )
    found = gm.adjust(declared(folder, control=control), ties=folder / "ties.csv", **OPTIONS)
    assert not found.blunders
    errors = np.array([each["errors"] for each in found.facts["control"]["points"]])
    assert np.isnan(errors[:, 2]).all()
    assert np.abs(errors[:, :2]).max() < 0.2


def test_blunders_are_named_with_their_likely_cause(folder: Path, tmp_path: Path) -> None:
    def wrong(line: str) -> str:
        fields = line.split(",")
        if fields[0] == "c2":
            fields[3] = f"{float(fields[3]) + 5.0:.3f}"
        return ",".join(fields)

    control = changed(folder, "control.csv", tmp_path, wrong)
    lines = (folder / "ties.csv").read_text().splitlines()
    row = next(i for i, line in enumerate(lines) if line.startswith("t") and ",s1p2.tif" in line)
    fields = lines[row].split(",")
    lines[row] = ",".join([*fields[:2], f"{float(fields[2]) + 60.0:.2f}", fields[3]])
    ties = tmp_path / "ties.csv"
    ties.write_text("\n".join(lines) + "\n")
    found = gm.adjust(declared(folder, control=control), ties=ties, **OPTIONS)
    said = [str(each) for each in found.blunders]
    assert any("'c2'" in text for text in said)
    assert any(fields[0] in text for text in said)
    assert "left out:" in found.summary


# Bad input: a clear message, and nothing written.


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"drift": "offset"}, "`drift` would do nothing"),
        ({"strips": "strips.csv"}, "`strips` would do nothing"),
        ({"boresight": True}, "`boresight` would do nothing"),
        ({"interior": ["focus"]}, "no camera has the parameter 'focus'"),
        ({"interior": ["focal_length=-1"]}, "standard deviation above 0"),
        ({"fixed": ["s9p9"]}, "no image is named 's9p9'"),
        ({"sigma_px": 0.0}, "0 is out of range"),
        ({"position_sigma": float("nan")}, "nan"),
    ],
)
def test_options_that_cannot_be_are_refused(folder: Path, options: dict[str, Any], said: str) -> None:
    with pytest.raises(GeomosaicError) as caught:
        gm.adjust(declared(folder), ties=folder / "ties.csv", **options)
    assert said in str(caught.value)


def test_a_dem_that_is_to_be_observed_must_be_there(folder: Path) -> None:
    block = declared(folder, dem=None, dem_heights=None)
    with pytest.raises(InputError, match="there is no DEM"):
        gm.adjust(block, ties=folder / "ties.csv", dem_sigma=1.0)


def test_no_datum_is_told(folder: Path) -> None:
    with pytest.raises(SolveError, match="the block has no datum: 8 images"):
        gm.adjust(declared(folder, control=None), ties=folder / "ties.csv")


def test_too_little_control_tells_what_is_free(folder: Path, tmp_path: Path) -> None:
    control = changed(folder, "control.csv", tmp_path, lambda line: line if line[:2] in ("c0", "c1") else None)
    with pytest.raises(SolveError, match=r"too little holds the block: 8 images .*free in .*tilt"):
        gm.adjust(declared(folder, control=control), ties=folder / "ties.csv")


def test_parts_without_a_datum_are_named(folder: Path, tmp_path: Path) -> None:
    """Points of strip 2 get names of their own: nothing joins the strips, and control is in strip 1 alone."""

    def apart(line: str) -> str | None:
        fields = line.split(",")
        if fields[1].startswith("s2"):
            fields[0] += "b"
        return ",".join(fields)

    ties = changed(folder, "ties.csv", tmp_path, apart)
    control = changed(folder, "control.csv", tmp_path, lambda line: None if ",s2p" in line else line)
    with quietly(), pytest.raises(SolveError, match=r"1 part of the block without a datum: 4 images \(s2p1.tif"):
        gm.adjust(declared(folder, control=control), ties=ties)


def test_parts_that_stand_by_themselves_are_adjusted_and_named(folder: Path, tmp_path: Path) -> None:
    def apart(line: str) -> str | None:
        fields = line.split(",")
        if fields[1].startswith("s2"):
            fields[0] += "b"
        return ",".join(fields)

    ties = changed(folder, "ties.csv", tmp_path, apart)
    with pytest.warns(GeomosaicWarning) as told:
        gm.adjust(declared(folder, control=None), ties=ties, **OPTIONS)
    assert any(re.search(r"2 parts that no points join.*s1p1.tif.*s2p1.tif", str(each.message)) for each in told)


def test_points_seen_once_are_left_out_aloud(folder: Path, tmp_path: Path) -> None:
    ties = tmp_path / "ties.csv"
    ties.write_text((folder / "ties.csv").read_text() + "alone,s1p1.tif,100,100\n")
    with pytest.warns(GeomosaicWarning, match="1 point seen once, left out: alone"):
        gm.adjust(declared(folder), ties=ties, **OPTIONS)


def test_a_point_in_two_places_of_one_image_names_both_lines(folder: Path, tmp_path: Path) -> None:
    ties = tmp_path / "ties.csv"
    lines = (folder / "ties.csv").read_text().splitlines()
    fields = lines[1].split(",")
    ties.write_text("\n".join([*lines, ",".join([*fields[:2], "17", "18"])]) + "\n")
    with pytest.raises(InputError, match=r"measured in s1p1.tif already .*ties.csv, line 2\)") as caught:
        gm.adjust(declared(folder), ties=ties, **OPTIONS)
    assert caught.value.where == f"{ties}, line {len(lines) + 1}"


def test_measurements_in_millimetres_are_told(folder: Path, tmp_path: Path) -> None:
    def metric(line: str) -> str:
        identity, image, col, row = line.split(",")
        return f"{identity},{image},{(float(col) - 3000) * 5},{(2000 - float(row)) * 5}"

    ties = changed(folder, "ties.csv", tmp_path, metric)
    with pytest.raises(InputError, match=r"lies outside .*6000 x 4000 pixels"):
        gm.adjust(declared(folder), ties=ties, **OPTIONS)


def test_measurements_in_millimetres_of_a_small_sensor_are_told(folder: Path, tmp_path: Path) -> None:
    def metric(line: str) -> str:
        identity, image, col, row = line.split(",")
        return f"{identity},{image},{(float(col) - 3000) * 0.004},{(2000 - float(row)) * 0.004}"

    ties = changed(folder, "ties.csv", tmp_path, metric)
    with pytest.raises(InputError, match=r"all \d+ measurements of tie points lie within .* millimetres\?"):
        gm.adjust(declared(folder), ties=ties, **OPTIONS)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f: [f[0], f[2], f[1], *f[3:]], "exchange"),
        (lambda f: [*f[:3], str(float(f[3]) / 0.3048), *f[4:]], "feet"),
        (lambda f: [f[0], str(float(f[1]) + 3e5), *f[2:]], "px from where the orientations put them"),
    ],
)
def test_control_in_another_crs_or_unit_is_told(folder: Path, tmp_path: Path, change: Any, said: str) -> None:
    control = changed(folder, "control.csv", tmp_path, lambda line: ",".join(change(line.split(","))))
    with pytest.raises(InputError) as caught:
        gm.adjust(declared(folder, control=control), ties=folder / "ties.csv", **OPTIONS)
    assert said in str(caught.value) + str(caught.value.hint)


def test_two_images_of_one_name_are_refused(folder: Path, tmp_path: Path) -> None:
    from adjust_project_rig import write_photo

    write_photo(tmp_path / "s1p1.tif")
    block = declared(folder)
    block = replace(block, images=(*block.images, tmp_path / "s1p1.tif"))
    with pytest.raises(InputError, match=r"two images share the name 's1p1\.tif'"):
        gm.adjust(block, ties=folder / "ties.csv", **OPTIONS)


def test_images_of_two_sizes_are_not_one_camera(folder: Path, tmp_path: Path) -> None:
    from adjust_project_rig import write_photo

    block = declared(folder)
    write_photo(tmp_path / "s1p1.tif", (3000, 2000))
    block = replace(block, images=(tmp_path / "s1p1.tif", *block.images[1:]))

    def halved(line: str) -> str:
        fields = line.split(",")
        at = fields.index("s1p1.tif") if "s1p1.tif" in fields else None
        if at is not None:
            fields[at + 1], fields[at + 2] = (str(float(fields[at + k]) / 2) for k in (1, 2))
        return ",".join(fields)

    control = changed(folder, "control.csv", tmp_path, halved)
    ties = changed(folder, "ties.csv", tmp_path, halved)
    with pytest.raises(InputError, match="declared with one camera, and differ in size"):
        gm.adjust(replace(block, control=control), ties=ties, interior=["focal_length"], **OPTIONS)


def test_covariances_that_are_no_numbers_are_refused(folder: Path) -> None:
    with pytest.raises(InputError, match="measurement 2: point 'a'"):
        gm.TiePoints(["a", "a"], ["s1p1.tif", "s1p2.tif"], np.ones((2, 2)), np.array([1.0, -1.0]))
    with pytest.raises(InputError, match="point 'b'"):
        gm.TiePoints(["a", "b"], ["s1p1.tif"] * 2, np.array([[1.0, 2.0], [np.nan, 4.0]]))


def test_ties_on_one_line_do_not_orient_an_image(folder: Path, tmp_path: Path) -> None:
    """Of one photo only points along a line stay: it could turn about that line."""
    block = truth()
    image = block.names.index("s2p4")
    mine = np.flatnonzero(block.image == image)
    row = block.colrow[mine, 1]
    line = set(block.point[mine[np.argsort(np.abs(row - np.median(row)))[:3]]].tolist())

    def thin(text: str) -> str | None:
        identity, name, *_ = text.split(",")
        return text if name != "s2p4.tif" or int(identity[1:]) in line else None

    ties = changed(folder, "ties.csv", tmp_path, thin)
    lines = ties.read_text().splitlines()
    kept = [i for i, text in enumerate(lines) if ",s2p4.tif," in text]
    assert len(kept) <= 3
    control = changed(folder, "control.csv", tmp_path, lambda text: None if ",s2p4.tif," in text else text)
    del lines[kept[-1]]
    ties.write_text("\n".join(lines) + "\n")
    with quietly(), pytest.raises(SolveError, match=r"the points of s2p4.tif lie on one line, or are too few"):
        gm.adjust(declared(folder, control=control), ties=ties, sigma_px=0.3)


@pytest.mark.slow
def test_ties_that_contradict_everything_end_in_words(folder: Path, tmp_path: Path) -> None:
    """All of them moved into one row: solutions run away, of the trials that ask which kind is wrong as well."""
    ties = changed(folder, "ties.csv", tmp_path, lambda line: ",".join([*line.split(",")[:3], "2000"]))
    with quietly(), pytest.raises(SolveError, match="does not converge"):
        gm.adjust(declared(folder), ties=ties, **OPTIONS)


def test_an_image_that_nothing_joins_is_set_aside_and_named(folder: Path, tmp_path: Path) -> None:
    ties = changed(folder, "ties.csv", tmp_path, lambda text: None if ",s2p4.tif," in text else text)
    control = changed(folder, "control.csv", tmp_path, lambda text: None if ",s2p4.tif," in text else text)
    with pytest.warns(GeomosaicWarning) as told:
        rest = gm.adjust(declared(folder, control=control), ties=ties, sigma_px=0.3, position_sigma=20.0)
    assert any("1 image set aside, the rest is adjusted: s2p4.tif (no tie point" in str(each.message) for each in told)
    assert list(rest.set_aside) == ["s2p4.tif"]
    assert len(rest.scenes) == 7
    assert "s2p4.tif" in rest.summary
    with quietly():
        found = gm.adjust(declared(folder, control=control), ties=ties, **OPTIONS)
    assert found.facts["images"][-1]["points"] == 0


def positions(folder: Path, tmp_path: Path, moved: Callable[[int, float, float, float], tuple[float, ...]]) -> Path:
    """Table of positions, moved by the number of the photo and its x, y, z."""
    rows = [line.split(",") for line in (folder / "exterior.csv").read_text().splitlines()[1:]]
    places = [moved(k, *map(float, row[1:4])) for k, row in enumerate(rows)]
    lines = [f"{row[0]},{x},{y},{z}" for row, (x, y, z) in zip(rows, places, strict=True)]
    (tmp_path / "positions.csv").write_text("\n".join(["image,x,y,z", *lines]) + "\n")
    return tmp_path / "positions.csv"


def test_positions_that_are_all_the_same_are_told_with_what_to_do(folder: Path, tmp_path: Path) -> None:
    table = positions(folder, tmp_path, lambda k, x, y, z: (5e5, 5.5e6, 1e3))
    block = declared(folder, exterior=table, angles="none", control=None)
    with pytest.raises(InputError, match="positions of all 8 photos are the same") as told:
        gm.adjust(block, ties=folder / "ties.csv", position_sigma=3.0)
    assert "without reception" in (told.value.hint or "")


def test_a_position_far_from_all_others_is_named_and_tie_points_place_its_photo(folder: Path, tmp_path: Path) -> None:
    table = positions(folder, tmp_path, lambda k, x, y, z: (x + 3e5 * (k == 2), y, z))
    block = declared(folder, exterior=table, angles="none", control=None)
    with pytest.warns(GeomosaicWarning) as told:
        found = gm.adjust(block, ties=folder / "ties.csv", position_sigma=3.0)
    assert any(re.search(r"far from all others.*: s1p3.tif \(299 km\)", str(each.message)) for each in told)
    # The positions of the table are some 10 m off.
    assert np.linalg.norm(centre_errors(found, truth()), axis=1).max() < 25.0


def test_a_photo_of_another_country_is_set_aside_and_named(folder: Path, tmp_path: Path) -> None:
    table = positions(folder, tmp_path, lambda k, x, y, z: (x + 3e5 * (k == 2), y, z))
    ties = changed(folder, "ties.csv", tmp_path, lambda text: None if ",s1p3.tif," in text else text)
    block = declared(folder, exterior=table, angles="none", control=None)
    with quietly():
        found = gm.adjust(block, ties=ties, position_sigma=3.0)
    assert list(found.set_aside) == ["s1p3.tif"]


def test_heights_of_positions_that_are_off_by_300_m_are_told_by_the_dem(folder: Path, tmp_path: Path) -> None:
    table = positions(folder, tmp_path, lambda k, x, y, z: (x, y, z + 300.0))
    block = declared(folder, exterior=table, angles="none", control=None)
    with pytest.warns(GeomosaicWarning, match=r"points lie (29|30)\d m above the declared ground.*check what"):
        found = gm.adjust(block, ties=folder / "ties.csv", position_sigma=3.0)
    assert found.facts["height_offset"]["offset_m"] == pytest.approx(300.0, abs=15.0)
    assert "above the declared ground" in found.summary


def test_right_heights_give_no_offset_from_the_dem(adjusted: AdjustedBlock) -> None:
    assert adjusted.height_offset is not None
    assert not adjusted.height_offset.significant
    assert abs(adjusted.height_offset.offset) < 2.0


def test_a_missing_dem_is_told_where_nothing_is_oriented_yet(folder: Path) -> None:
    block = declared(folder, exterior=None, dem=folder / "missing.tif")
    with pytest.raises(InputError, match=r"missing\.tif"):
        gm.adjust(block, ties=folder / "ties.csv")
    nowhere = declared(folder, exterior=None, control=None, crs="local", heights=None)
    with pytest.raises(InputError, match="a DEM cannot serve a block in a local frame"):
        gm.match(nowhere)


def parted(folder: Path, tmp_path: Path, others: str) -> dict[str, Path | None]:
    """Names of points changed in some of the photos: nothing joins them to the others; nothing says where any lies."""

    def apart(line: str) -> str:
        fields = line.split(",")
        return ",".join([fields[0] + "b" * bool(re.match(others, fields[1])), *fields[1:]])

    return {"ties": changed(folder, "ties.csv", tmp_path, apart)}


def test_the_larger_of_two_groups_goes_on(folder: Path, tmp_path: Path) -> None:
    nowhere = gm.Block(sorted((folder / "photos").glob("*.tif")), "frame", camera=folder / "camera.toml", crs="local")
    with quietly():
        found = gm.adjust(nowhere, **parted(folder, tmp_path, "s2p[234]"), sigma_px=0.3)
    assert set(found.set_aside) == {"s2p2.tif", "s2p3.tif", "s2p4.tif"}
    assert "s2p4.tif (3 images tied to each other alone)" in found.summary
    assert found.sigma0 == pytest.approx(1.0, abs=0.2)  # few points are left of a small block
    assert len(found.block().scenes) == 5


def test_two_equal_groups_are_an_error_that_names_both(folder: Path, tmp_path: Path) -> None:
    nowhere = gm.Block(sorted((folder / "photos").glob("*.tif")), "frame", camera=folder / "camera.toml", crs="local")
    with quietly(), pytest.raises(SolveError, match=r"2 groups.*: 4 images \(s.p1.tif.*; 4 images \(s.p1.tif") as told:
        gm.adjust(nowhere, **parted(folder, tmp_path, "s2"), sigma_px=0.3)
    assert "make a block of each group" in (told.value.hint or "")


def test_more_than_half_without_a_point_in_common_is_an_error(folder: Path, tmp_path: Path) -> None:
    few = changed(folder, "ties.csv", tmp_path, lambda line: line if line.split(",")[1][:4] in "s1p1 s1p2" else None)
    block = declared(folder, control=None)
    with quietly(), pytest.raises(InputError, match=re.escape("6 images without a point that another image shows")):
        gm.adjust(block, ties=few, sigma_px=0.3, position_sigma=20.0)


def test_standard_deviations_of_a_table_hold_an_image_without_points(
    folder: Path, adjusted: AdjustedBlock, tmp_path: Path
) -> None:
    exterior = adjusted.write(tmp_path / "out")["exterior"]
    ties, control = (
        changed(folder, name, tmp_path, lambda text: None if ",s2p4.tif," in text else text)
        for name in ("ties.csv", "control.csv")
    )
    with quietly():
        found = gm.adjust(declared(folder, exterior=exterior, control=control), ties=ties, sigma_px=0.3)
    assert found.facts["images"][-1]["points"] == 0


def test_a_point_of_two_rays_that_do_not_meet_accuses_neither(folder: Path, tmp_path: Path) -> None:
    rows = [line.split(",") for line in (folder / "ties.csv").read_text().splitlines()[1:]]
    two = next(name for name, *_ in rows if sum(row[0] == name for row in rows) == 2)
    of_it = [row for row in rows if row[0] == two]

    def wrong(line: str) -> str:
        fields = line.split(",")
        if fields[:2] == of_it[0][:2]:
            fields[2:] = [str(float(value) + 40.0) for value in fields[2:]]
        return ",".join(fields)

    found = gm.adjust(declared(folder), ties=changed(folder, "ties.csv", tmp_path, wrong), **OPTIONS)
    assert {each.cause for each in found.blunders} == {"its two rays do not meet: either is wrong"}
    assert {each.point for each in found.blunders} == {two}


# What else was observed.


def test_positions_of_a_strip_share_an_offset_that_is_found(folder: Path, tmp_path: Path) -> None:
    """Positions are true but for 5 m that all of strip 1 are off in x: control tells it."""
    block = truth()
    lines = ["image,x,y,z,omega,phi,kappa"]
    strips = ["image,strip"]
    for name, model in zip(block.names, block.models, strict=True):
        values = model.exterior(block.frame.ground) + np.array([5.0 if name.startswith("s1") else 0.0, *[0.0] * 5])
        lines.append(",".join([name, *(f"{value:.9f}" for value in values)]))
        strips.append(f"{name},{name[:2]}")
    (tmp_path / "exterior.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "strips.csv").write_text("\n".join(strips) + "\n")
    found = gm.adjust(
        declared(folder, exterior=tmp_path / "exterior.csv"), ties=folder / "ties.csv", sigma_px=0.3,
        position_sigma=0.05, drift="offset", strips=tmp_path / "strips.csv",
    )  # fmt: skip
    first, second = found.solution.adjustment.state.further
    assert abs(first[0] - 5.0) < 0.5
    assert abs(second[0]) < 0.5
    assert np.abs(centre_errors(found, block)).max() < 0.5


def test_a_strip_of_one_image_has_an_offset_and_no_drift(folder: Path, tmp_path: Path) -> None:
    names = truth().names
    (tmp_path / "strips.csv").write_text(
        "image,strip\n" + "".join(f"{name},{'alone' if name == names[-1] else 'long'}\n" for name in names)
    )
    found = gm.adjust(
        declared(folder), ties=folder / "ties.csv", sigma_px=0.3, position_sigma=20.0, drift="linear",
        strips=tmp_path / "strips.csv",
    )  # fmt: skip
    long, alone = found.solution.adjustment.state.further
    assert long.all()
    assert alone[:3].all()
    assert not alone[3:].any()


def test_standard_deviations_of_a_table_hold_its_images(folder: Path, adjusted: AdjustedBlock, tmp_path: Path) -> None:
    """What an adjustment has written is taken as observed: twice the same, with smaller standard deviations."""
    files = adjusted.write(tmp_path)
    block = declared(folder, exterior=files["exterior"], control=None)
    found = gm.adjust(block, ties=folder / "ties.csv", sigma_px=0.3)
    assert {each["name"] for each in found.facts["observations"]} == {
        "image positions",
        "camera positions",
        "attitudes",
    }
    before, after = (
        np.array([list(image["sigmas"].values())[:3] for image in each.facts["images"]]) for each in (adjusted, found)
    )
    assert (np.median(after, axis=0) < np.median(before, axis=0)).all()


def test_positions_in_degrees_are_adjusted_in_metres(folder: Path, tmp_path: Path) -> None:
    from geomosaic.geo.crs import parse_crs, with_heights
    from geomosaic.geo.transform import Transform

    block = truth()
    lonlat = with_heights(parse_crs("EPSG:4326"), "ellipsoidal")
    lines = ["image,x,y,z,omega,phi,kappa"]
    for name, model in zip(block.names, block.start, strict=True):
        values = model.exterior(block.frame.ground)
        place = Transform(block.frame.ground, lonlat)(values[None, :3])[0]
        lines.append(",".join([name, *(f"{value:.10f}" for value in (*place, *values[3:]))]))
    (tmp_path / "exterior.csv").write_text("\n".join(lines) + "\n")
    given = declared(folder, exterior=tmp_path / "exterior.csv", crs="EPSG:4326", control=None)
    found = gm.adjust(given, ties=folder / "ties.csv", **OPTIONS)
    assert found.start.ground.utm_zone == "33N"
    assert np.abs(centre_errors(found, block)).max() < 80.0
    assert found.facts["sigma0_as_expected"]


def test_images_of_two_cameras_find_a_focal_length_each(folder: Path, tmp_path: Path) -> None:
    camera = tmp_path / "camera.toml"
    camera.write_text((folder / "camera.toml").read_text().replace("5000.0", "5010.0"))
    whole = declared(folder)
    one = replace(whole, images=whole.images[:4])
    other = replace(whole, images=whole.images[4:], camera=camera, control=None)
    found = gm.adjust([one, other], ties=folder / "ties.csv", interior=["focal_length"], **OPTIONS)
    first, second = (camera["parameters"][0] for camera in found.facts["cameras"])
    assert (first["before"], second["before"]) == (5000.0, 5010.0)
    for each in (first, second):
        assert abs(each["after"] - 5000.0) < 4.0 * each["sigma"]
    assert len(found.facts["control"]["points"]) == 4


def test_a_distance_gives_the_scale(folder: Path, tmp_path: Path) -> None:
    block = truth()
    pair = [int(point) for point in np.flatnonzero(np.bincount(block.point) >= 4)[-2:]]
    length = float(np.linalg.norm(block.points[pair[0]] - block.points[pair[1]]))
    table = tmp_path / "distances.csv"
    table.write_text(f"from,to,length,sigma\nt{pair[0]},t{pair[1]},{length:.4f},0.01\n")
    block_of = declared(folder, control=None)
    found = gm.adjust(block_of, ties=folder / "ties.csv", distances=table, **OPTIONS)
    ends = [np.array(found.points[f"t{point}"]) for point in pair]
    assert abs(float(np.linalg.norm(ends[0] - ends[1])) - length) < 0.3
    assert not any(each["name"].startswith("point") for each in found.facts["weakest"])
    table.write_text("from,to,length,sigma\nt999999,t1,10,0.01\n")
    with pytest.raises(InputError, match="point 't999999' is not measured"):
        gm.adjust(block_of, ties=folder / "ties.csv", distances=table, **OPTIONS)
    table.write_text(f"from,to,length,sigma\nt{pair[0]},t{pair[0]},10,0.01\n")
    with pytest.raises(InputError, match=f"from point 't{pair[0]}' to itself"):
        gm.adjust(block_of, ties=folder / "ties.csv", distances=table, **OPTIONS)


def test_a_wrong_distance_between_control_points_is_named_and_nothing_else(folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "distances.csv"
    table.write_text("from,to,length,sigma\nc1,c2,4.0,0.01\n")
    found = gm.adjust(declared(folder), ties=folder / "ties.csv", distances=table, **OPTIONS)
    assert [each.kind for each in found.blunders] == ["distances"]
    assert found.write(tmp_path / "out")["points"].is_file()


def test_positions_and_angles_of_images_that_stay_are_no_observations(folder: Path) -> None:
    # Their orientations are wrong, and all rays would be blamed for that, one by one.
    options = {"ties": folder / "ties.csv", "robust": False, **OPTIONS}
    used = {}
    for fixed in (["*"], ["s1*"]):
        facts = gm.adjust(declared(folder), fixed=fixed, **options).facts
        used[fixed[0]] = {each["name"]: each["used"] for each in facts["observations"] if each["used"]}
    assert set(used["*"]) == {"image positions", "control"}
    free = sum(not each["name"].startswith("s1") for each in facts["images"])
    assert used["s1*"]["camera positions"] == used["s1*"]["attitudes"] == free


def test_many_wrong_measurements_are_told_to_have_one_cause(folder: Path, tmp_path: Path) -> None:
    random, number = np.random.default_rng(0), iter(range(10**6))

    def wrong(line: str) -> str:
        fields = line.split(",")
        if fields[0].startswith("t") and next(number) % 4 == 0:
            fields[2:4] = [f"{value:.2f}" for value in random.uniform(10.0, 500.0, 2)]
        return ",".join(fields)

    with pytest.warns(GeomosaicWarning, match=r"image positions were left out, .* look for one cause"):
        gm.adjust(declared(folder), ties=changed(folder, "ties.csv", tmp_path, wrong), **OPTIONS)


def test_fixed_images_stay(folder: Path, adjusted: AdjustedBlock) -> None:
    block = declared(folder, control=None)
    found = gm.adjust(block, ties=folder / "ties.csv", sigma_px=0.3, fixed=("s1p1", "s2p4.tif"), robust=False)
    for index in (0, 7):
        before = adjusted.start.models[index].parameters.values
        assert np.array_equal(found.scenes[index].model.parameters.values, before)
        assert not found.covariances[index].any()


def test_nothing_is_said_of_the_accuracy_of_an_image_that_is_left_as_given(folder: Path, tmp_path: Path) -> None:
    """Zero would be the best of all. What was measured in it is of other places."""
    random = np.random.default_rng(4)

    def elsewhere(line: str) -> str:
        name, image, *_ = line.split(",")
        col, row = random.uniform(100.0, 3900.0, 2)
        return f"{name},{image},{col:.2f},{row:.2f}" if image == "s2p4.tif" else line

    control = changed(folder, "control.csv", tmp_path, lambda line: None if "s2p4" in line else line)
    block = declared(folder, control=control)
    with quietly():
        found = gm.adjust(block, ties=changed(folder, "ties.csv", tmp_path, elsewhere), sigma_px=0.3)
    lost = [scene.covariance is None for scene in found.scenes]
    names = [scene.name for scene in found.scenes]
    at = names.index("s2p4.tif")
    assert lost[at]
    assert sum(lost) < 4
    assert "takes no part" in found.scenes[at].known_by
    assert "sigma0" in found.scenes[lost.index(False)].known_by
    assert np.isnan(list(found.facts["images"][at]["sigmas"].values())).all()
    assert not lost[names.index(found.accuracy["largest_in"])]
    files = found.write(tmp_path / "out")
    assert json.loads((files["models"] / "s2p4.tif.json").read_text())["covariance"] is None
    again = replace(block, exterior=files["exterior"], control=None)
    known = with_covariances(again, build_block(again, ground=False), {}).scenes
    assert [scene.covariance is None for scene in known] == lost


def turned(line: str) -> str:
    """Line of an orientation table, in strip 1 with the yaw of a photo that looks down from the other side."""
    fields = line.split(",")
    if fields[0].startswith("s1"):
        fields[6] = f"{float(fields[6]) + 180.0:.6f}"
    return ",".join(fields)


def test_angles_that_are_wrong_all_along_a_strip_leave_the_start_to_the_tie_points(
    folder: Path, tmp_path: Path
) -> None:
    """Gimbals of drones tell the yaw of photos that look straight down from either side."""
    block = declared(folder, exterior=changed(folder, "exterior.csv", tmp_path, turned))
    with quietly():
        judged = gm.adjust(block, ties=folder / "ties.csv", **OPTIONS)
    assert {each.image for each in judged.blunders if each.kind == "attitudes"} == {f"s1p{n}.tif" for n in range(1, 5)}
    options = {**OPTIONS, "attitude_sigma": None}
    found = gm.adjust(block, ties=folder / "ties.csv", **options)
    assert 0.9 < found.sigma0 < 1.1


@pytest.mark.parametrize(
    ("sigma", "turn", "column", "off"),
    # 40 m above trees 3 m are as 75 m here, and 300 m as 7500 m; a position of another place in the usual flight.
    [(75.0, 5.0, 3, 7500.0), (3.0, 0.5, 1, 200.0)],
)
def test_one_wrong_position_of_a_strip_without_control_is_named(
    tmp_path: Path, sigma: float, turn: float, column: int, off: float
) -> None:
    """The start has it wrong, too: tie points tell how the photos lie to each other."""
    strip = grid_block(1, 6, 30, seed=3, control=0, shift=sigma, turn=turn)
    write_project(tmp_path, strip)
    lines = [line.split(",") for line in (tmp_path / "exterior.csv").read_text().splitlines()]
    lines[1][column] = str(float(lines[1][column]) + off)
    (tmp_path / "exterior.csv").write_text("\n".join(map(",".join, lines)) + "\n")
    block = declared(tmp_path, control=None, dem=None, dem_heights=None)
    options = {"sigma_px": 0.3, "position_sigma": sigma, "attitude_sigma": turn, "interior": ("focal_length=200",)}
    with quietly():
        found = gm.adjust(block, ties=tmp_path / "ties.csv", **options)
    assert [(each.kind, each.image) for each in found.blunders] == [("camera positions", "s1p1.tif")]
    assert 0.8 < found.sigma0 < 1.2
    assert np.linalg.norm(centre_errors(found, strip), axis=-1).max() < 3.0 * sigma


def test_fixed_images_stay_where_angles_of_others_are_wrong(
    folder: Path, tmp_path: Path, adjusted: AdjustedBlock
) -> None:
    block = declared(folder, exterior=changed(folder, "exterior.csv", tmp_path, turned), control=None)
    options = {**OPTIONS, "attitude_sigma": None}
    with quietly():
        found = gm.adjust(block, ties=folder / "ties.csv", fixed=("s2p1",), **options)
    at = [scene.name for scene in found.scenes].index("s2p1.tif")
    before = adjusted.start.models[at].parameters.values
    assert np.array_equal(found.scenes[at].model.parameters.values, before)


def test_distances_give_a_block_without_any_position_its_scale(folder: Path, tmp_path: Path) -> None:
    block = declared(
        folder, crs=local_frame_crs().to_wkt(), exterior=None, heights=None, control=None, dem=None, dem_heights=None
    )
    plain = gm.adjust(block, ties=folder / "ties.csv", sigma_px=0.3)
    xyz, ids = plain.solution.adjustment.state.points, list(plain.solution.ids)
    ends = [(ids[one], ids[-1 - one]) for one in range(2)]
    free = [float(np.linalg.norm(xyz[one] - xyz[-1 - one])) for one in range(2)]
    factor = 500.0
    lines = [f"{a},{b},{factor * length},{1e-4 * factor * length}" for (a, b), length in zip(ends, free, strict=True)]
    table = tmp_path / "distances.csv"
    table.write_text("\n".join(["from,to,length,sigma", *lines]))
    found = gm.adjust(block, ties=folder / "ties.csv", sigma_px=0.3, distances=table)
    assert [each["rejected"] for each in found.facts["observations"]] == [0, 0]
    there = found.solution.adjustment.state.points
    assert np.linalg.norm(there[0] - there[-1]) == pytest.approx(factor * free[0], rel=1e-4)


def test_copies_of_a_repeated_texture_do_not_throw_a_block_without_positions_away(folder: Path, tmp_path: Path) -> None:
    """Orchards and fields repeat: matches with the copies agree with each other, and with nothing else."""
    lines = (folder / "ties.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    there = {row[0] for row in rows if row[1] == "s2p4.tif"}
    mine = [row for row in rows if row[1] == "s1p1.tif" and row[0] not in there]
    # Of a texture that repeats, all copies are shifted alike.
    false = [(row[0], float(row[2]), float(row[3])) for row in mine[::4]]
    lines += [f"{name},s2p4.tif,{col - 300.0},{line + 200.0}" for name, col, line in false]
    ties = tmp_path / "ties.csv"
    ties.write_text("\n".join(lines) + "\n")
    nowhere = declared(
        folder, crs=local_frame_crs().to_wkt(), exterior=None, heights=None, control=None, dem=None, dem_heights=None
    )
    with quietly():
        found = gm.adjust(nowhere, ties=ties, sigma_px=0.3)
    assert 0.9 < found.sigma0 < 1.1
    copies = {name for name, *_ in false}
    assert len(copies) > 5
    left_out = {(each.point, each.image) for each in found.blunders}
    assert len(left_out & {(name, "s2p4.tif") for name in copies}) > 0.9 * len(copies)


def test_measurements_that_are_all_worse_than_declared_stay_and_tell(folder: Path) -> None:
    with quietly():
        found = gm.adjust(declared(folder), ties=folder / "ties.csv", **{**OPTIONS, "sigma_px": 0.1})
    images = found.facts["observations"][0]
    assert images["rejected"] < 0.02 * images["used"]
    assert 2.5**2 < images["variance_factor"] < 3.5**2
    assert found.facts["sigma0_as_expected"]
    assert "Image positions scatter " in found.summary


def test_a_camera_that_strays_from_what_was_known_of_it_is_told(folder: Path, tmp_path: Path) -> None:
    camera = tmp_path / "camera.toml"
    camera.write_text((folder / "camera.toml").read_text().replace("5000.0", "5200.0"))
    block = declared(folder, camera=camera)
    with pytest.warns(GeomosaicWarning, match="focal_length came to .* of its a-priori standard deviations, and held"):
        found = gm.adjust(block, ties=folder / "ties.csv", interior=["focal_length=20"], **OPTIONS)
    assert not found.held
    assert [p["name"] for p in found.facts["cameras"][0]["parameters"]] == ["focal_length"]


def test_a_strip_whose_angles_are_in_gon_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Flown to the south: kappa is 180 degrees, or 200 gon, and the other strip says that the table is in degrees."""
    straight = block_rig.photo

    def photo(name: str, centre: np.ndarray, angles: np.ndarray, camera: Any = None) -> Any:
        return straight(name, centre, angles + np.array([0.0, 0.0, 180.0]), camera)

    monkeypatch.setattr(block_rig, "photo", photo)
    write_project(tmp_path, truth())
    lines = (tmp_path / "exterior.csv").read_text().splitlines()
    for number, line in enumerate(lines):
        name, *values = line.split(",")
        if name.startswith("s2"):
            angles = [float(value) / 0.9 for value in values[3:6]]
            lines[number] = ",".join([name, *values[:3], *(f"{angle:.6f}" for angle in angles)])
    (tmp_path / "exterior.csv").write_text("\n".join(lines) + "\n")
    with pytest.warns(GeomosaicWarning) as told:
        found = gm.adjust(declared(tmp_path, dem=None, dem_heights=None), ties=tmp_path / "ties.csv", **OPTIONS)
    notes = [str(each.message) for each in told]
    units = [note for note in notes if "agree with the block as" in note]
    assert len(units) == 1
    assert "s2p1.tif, s2p2.tif, s2p3.tif, s2p4.tif agree with the block as gon (read as degrees)" in units[0]
    assert np.linalg.norm(centre_errors(found, truth()), axis=1).max() < 2.0


def notes_on_angles(
    folder: Path, monkeypatch: pytest.MonkeyPatch, kappas: tuple[float, float], change: Any
) -> list[str]:
    """Notes on the unit of the angles, of a block whose strips have these kappas and whose table is changed."""
    straight, strips = block_rig.photo, dict(zip(("s1", "s2"), kappas, strict=True))

    def photo(name: str, centre: np.ndarray, angles: np.ndarray, camera: Any = None) -> Any:
        return straight(name, centre, angles + np.array([0.0, 0.0, strips.get(name[:2], 0.0)]), camera)

    monkeypatch.setattr(block_rig, "photo", photo)
    write_project(folder, truth())
    lines = (folder / "exterior.csv").read_text().splitlines()
    for number, line in enumerate(lines[1:], 1):
        name, *values = line.split(",")
        angles = change(np.array(values[3:6], dtype=float))
        lines[number] = ",".join([name, *values[:3], *(f"{angle:.6f}" for angle in angles)])
    (folder / "exterior.csv").write_text("\n".join(lines) + "\n")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        gm.adjust(declared(folder, dem=None, dem_heights=None), ties=folder / "ties.csv", **OPTIONS)
    return [str(each.message) for each in told if "agree with" in str(each.message)]


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1.0 / 0.9, r'as gon \(read as degrees\): .*; set angle_unit = "gon"'),
        (0.9, r'as degrees \(read as gon\): .*"deg"'),
    ],
)
def test_a_table_whose_angles_are_all_in_another_unit_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, factor: float, words: str
) -> None:
    (note,) = notes_on_angles(tmp_path, monkeypatch, (174.0, -6.0), lambda angles: factor * angles)
    assert re.search(f"8 images agree with their table {words}", note)


def test_a_compass_that_is_off_is_told_where_another_unit_fits_as_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Off by a ninth of the one direction of flight: as gon the table would be right to the tilt of the camera."""
    notes = notes_on_angles(tmp_path, monkeypatch, (171.0, 171.0), lambda angles: angles + np.array([0.0, 0.0, 19.0]))
    assert all(note.endswith("unless one rotation turns all of them, such as a compass that is off") for note in notes)
    assert len(notes) == 1


def test_control_measured_in_images_that_are_not_of_the_block_is_told(folder: Path, tmp_path: Path) -> None:
    rows = (folder / "control.csv").read_text().splitlines()
    first = rows[0].split(",").index("image")
    other = [row.split(",") for row in rows[1:3]]
    for row in other:
        row[first] = "nope.tif"
    table = tmp_path / "control.csv"
    table.write_text("\n".join([*rows, *map(",".join, other)]) + "\n")
    with pytest.warns(GeomosaicWarning) as told:
        control_of(
            [declared(folder, control=table)],
            [path.name for path in (folder / "photos").glob("*.tif")],
            CRS("EPSG:32633").to_3d(),
        )
    assert any(
        "2 measurements of control points left out, in images that are not of the block: nope.tif (2 rows)" in note
        and "correct the names in the table, or add the images" in note
        for note in (str(each.message) for each in told)
    )
