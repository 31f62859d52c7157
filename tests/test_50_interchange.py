"""Files of other programs, both ways, held against a camera that is written here and against the programs."""

from __future__ import annotations

import bz2
import gzip
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aicon_rig import read_aicon
from ign_lists_rig import read_borea

from geomosaic.errors import InputError, OutputExistsError
from geomosaic.geo.crs import geocentric, geographic, parse_crs
from geomosaic.geo.local_frames import LocalFrame
from geomosaic.interchange.asp import adjusted, adjustment, adjustment_text, match_bytes, read_adjustment, read_match
from geomosaic.interchange.formats import (
    READERS,
    WRITERS,
    files_read,
    format_of,
    read_reconstruction,
    write_reconstruction,
)
from geomosaic.interchange.reconstruction import (
    ImagePoints,
    ImagePose,
    ObjectPoints,
    Reconstruction,
    SurveyedPoints,
)
from geomosaic.options.adjustment import AdjustmentOptions
from geomosaic.options.declaration import declared
from geomosaic.types import FloatArray

RealData = Callable[[str], Path]
SIZE = (640, 480)
RADIAL = {"model": "brown", "k1": -0.05, "k2": 0.01}


def project(camera: Mapping[str, Any], image: ImagePose, xyz: FloatArray) -> FloatArray:
    """Pixels by the formulas of OpenCV's manual, written without the program's own lenses."""
    rotation, centre = image.pose
    across, down, ahead = rotation @ (xyz - centre).T
    x, y = across / ahead, down / ahead
    lens = camera["distortion"]
    k = [lens.get(f"k{i}", 0.0) for i in range(1, 7)]
    p1, p2 = lens.get("p1", 0.0), lens.get("p2", 0.0)
    r = np.hypot(x, y)
    if lens["model"] == "fisheye":
        angle = np.arctan(r)
        scale = angle * (1 + k[0] * angle**2 + k[1] * angle**4 + k[2] * angle**6 + k[3] * angle**8) / r
    else:
        scale = 1 + k[0] * r**2 + k[1] * r**4 + k[2] * r**6
        if lens["model"] == "opencv":
            scale = scale / (1 + k[3] * r**2 + k[4] * r**4 + k[5] * r**6)
    u = x * scale + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2)
    v = y * scale + 2 * p2 * x * y + p1 * (r**2 + 2 * y**2)
    fx, fy = np.broadcast_to(camera["focal_length_px"], 2)
    return np.column_stack([fx * (u + lens.get("shear", 0.0) * v), fy * v]) + camera["principal_point_px"]


def residuals(found: Reconstruction) -> FloatArray:
    """Measured minus computed pixels (N, 2); NaN for points without coordinates."""
    rows = found.observations
    computed = np.empty_like(rows.colrow)
    for index, image in enumerate(found.images):
        own = rows.image == index
        computed[own] = project(found.camera_of(image), image, found.points.xyz[rows.point[own]])
    return rows.colrow - computed


def block(camera: Mapping[str, Any] | None = None, seed: int = 3) -> Reconstruction:
    """Three images that look down on forty points, their measurements exact."""
    random = np.random.default_rng(seed)
    table = camera or {
        "size": list(SIZE),
        "focal_length_px": 700.0,
        "principal_point_px": [320.0, 240.0],
        "distortion": RADIAL,
    }
    xyz = random.uniform((-20.0, -15.0, -3.0), (20.0, 15.0, 3.0), (40, 3))
    images = []
    for index in range(3):
        turn, _ = np.linalg.qr(np.eye(3) + 0.05 * random.normal(size=(3, 3)))
        turn = turn * np.sign(np.diag(turn))[:, None]
        images.append(
            ImagePose(
                f"image {index}.jpg".replace(" ", "_"),
                "1",
                np.diag([1.0, -1.0, -1.0]) @ turn,
                np.array([2.0 * index, 0.0, 60.0]),
            )
        )
    image, point = (grid.ravel() for grid in np.meshgrid(np.arange(3), np.arange(40), indexing="ij"))
    points = ObjectPoints(tuple(map(str, range(40))), xyz, random.integers(0, 255, (40, 3), dtype=np.uint8))
    made = Reconstruction({"1": table}, tuple(images), points, ImagePoints(image, point, np.zeros((120, 2))))
    return replace(made, observations=ImagePoints(image, point, -residuals(made)))


def written(found: Reconstruction, folder: Path, format: str) -> Reconstruction:
    name = {"bal": "block.txt", "metashape": "block.xml", "pix4d": "block_calibrated_camera_parameters.txt"}.get(format)
    path = folder if name is None else folder / name
    write_reconstruction(found, path, format)
    return read_reconstruction(path)


LENSES: dict[str, dict[str, Any]] = {
    "none": {"model": "none"},
    "radial": RADIAL,
    "brown": {**RADIAL, "p1": 1e-3, "p2": -2e-3},
    "of seven terms": {**RADIAL, "k3": 2e-3, "p1": 1e-3, "p2": -2e-3},
    "rational": {"model": "opencv", **{f"k{i}": 0.01 * i for i in range(1, 7)}, "p1": 1e-3, "p2": 0.0},
    "fisheye": {"model": "fisheye", "k1": 0.02, "k2": -0.01, "k3": 0.003, "k4": 1e-4},
}
# Lenses of which each format has place, besides none.
PLACES = {
    "colmap": tuple(LENSES),
    "colmap-text": tuple(LENSES),
    "opensfm": ("none", "radial", "brown", "of seven terms", "fisheye"),
    "bundler": ("none", "radial"),
    "bal": ("none", "radial"),
    "metashape": ("none", "radial", "brown", "of seven terms", "fisheye"),
    "pix4d": ("none", "radial", "brown", "of seven terms"),
    "ori": ("none", "radial"),
}


def camera_with(lens: str, format: str) -> dict[str, Any]:
    plain = format in ("bundler", "bal")
    return {
        "size": list(SIZE),
        "focal_length_px": 700.0 if plain or format == "ori" else [700.0, 710.0],
        "principal_point_px": [320.0, 240.0] if plain else [325.5, 233.25],
        "distortion": LENSES[lens],
    }


@pytest.mark.parametrize(("format", "lens"), [(name, lens) for name, lenses in PLACES.items() for lens in lenses])
def test_what_is_written_is_read_back_as_the_same_cameras_and_points(tmp_path: Path, format: str, lens: str) -> None:
    made = block(camera_with(lens, format))
    back = written(made, tmp_path, format)
    if format in ("bundler", "bal"):
        back = back.with_sizes({image.name: SIZE for image in back.images})
    assert [image.name for image in back.images] == (
        ["0", "1", "2"] if format == "bal" else [Path(i.name).stem if format == "ori" else i.name for i in made.images]
    )
    for before, after in zip(made.images, back.images, strict=True):
        expected = project(made.camera_of(before), before, made.points.xyz)
        assert np.abs(project(back.camera_of(after), after, made.points.xyz) - expected).max() < 1e-9
    if len(back.points.ids):
        assert np.array_equal(back.points.xyz, made.points.xyz)
        assert np.abs(residuals(back)).max() < 1e-9
        assert len(back.observations.image) == 120


@pytest.mark.parametrize("format", ["colmap", "colmap-text", "opensfm", "bundler", "bal"])
def test_coordinates_of_points_and_measurements_return_to_the_last_bit(tmp_path: Path, format: str) -> None:
    made = block()
    back = written(made, tmp_path, format)
    again = written(back, tmp_path / "again", format) if (tmp_path / "again").mkdir() is None else back
    assert np.array_equal(again.points.xyz, made.points.xyz)
    if format != "opensfm":  # normalised there by the longer side: 1e-13 of a pixel
        assert np.array_equal(again.observations.colrow, back.observations.colrow)
    if back.points.colour is not None and format != "bal":
        assert np.array_equal(back.points.colour, made.points.colour)


@pytest.mark.parametrize("format", [name for name in WRITERS if name not in ("match", "adjust")])  # they hold none
def test_a_lens_without_a_place_in_the_format_is_refused_and_nothing_written(tmp_path: Path, format: str) -> None:
    sheared = {"model": "opencv", "k4": 0.1, "shear": 0.01, "s1": 0.1}
    camera = {"size": list(SIZE), "focal_length_px": 700.0, "principal_point_px": [320.0, 240.0], "distortion": sheared}
    made = replace(block(), cameras={"1": camera})
    with pytest.raises(InputError, match="no place for a lens") as caught:
        written(made, tmp_path, format)
    assert caught.value.hint
    assert not list(tmp_path.iterdir())


def test_existing_files_are_kept_unless_overwriting_is_asked_for(tmp_path: Path) -> None:
    write_reconstruction(block(), tmp_path, "colmap-text")
    with pytest.raises(OutputExistsError):
        write_reconstruction(block(), tmp_path, "colmap-text")
    write_reconstruction(block(), tmp_path, "colmap-text", overwrite=True)


def test_problems_of_bal_may_be_packed(tmp_path: Path) -> None:
    write_reconstruction(block(), tmp_path / "a.txt", "bal")
    plain = (tmp_path / "a.txt").read_bytes()
    for name, pack in (("a.txt.bz2", bz2.compress), ("a.txt.gz", gzip.compress)):
        (tmp_path / name).write_bytes(pack(plain))
        back = read_reconstruction(tmp_path / name)
        assert np.array_equal(back.points.xyz, block().points.xyz)
        (tmp_path / name).write_bytes(pack(plain)[:-20])
        with pytest.raises(InputError, match="packed"):
            read_reconstruction(tmp_path / name)


def test_sizes_move_pixels_from_the_middle_to_the_corner(tmp_path: Path) -> None:
    back = written(block(), tmp_path, "bundler")
    assert "size" not in back.cameras["0"]
    placed = back.with_sizes({image.name: SIZE for image in back.images})
    assert placed.cameras["0"]["principal_point_px"] == [320.0, 240.0]
    assert np.allclose(placed.observations.colrow - back.observations.colrow, [320.0, 240.0])
    with pytest.raises(InputError, match="size of the image is missing"):
        back.with_sizes({})


def test_the_datum_of_a_reference_reaches_metashape(tmp_path: Path) -> None:
    datum = geographic(parse_crs("EPSG:31468"))  # 100 m beside WGS 84
    found = written(replace(block(), crs=datum.to_wkt(), reference=(11.5, 48.1, 500.0)), tmp_path, "metashape")
    axes = LocalFrame.at(datum, np.array([11.5, 48.1, 500.0]))
    assert geocentric(parse_crs(str(found.crs))).equals(axes.crs)
    for before, after in zip(block().images, found.images, strict=True):
        assert np.abs(axes.to_enu(after.pose[1][None])[0] - before.pose[1]).max() < 1e-6


def test_images_without_a_pose_in_bundler_have_none(tmp_path: Path) -> None:
    write_reconstruction(block(), tmp_path, "bundler")
    file = tmp_path / "bundle.out"
    lines = file.read_text().splitlines()
    lines[2:7] = ["0 0 0"] * 5
    file.write_text("\n".join(lines))
    back = read_reconstruction(file)
    assert [image.oriented for image in back.images] == [False, True, True]
    assert set(back.observations.image) == {1, 2}


def test_control_points_of_opensfm_return(tmp_path: Path) -> None:
    surveyed = SurveyedPoints(
        ObjectPoints(("a", "b"), np.array([[13.4, 52.5, 40.0], [np.nan] * 3])),
        ImagePoints(np.array([0, 2, 1]), np.array([0, 0, 1]), np.array([[10.0, 20.0], [30.5, 40.5], [600.0, 470.0]])),
        "EPSG:4979",
    )
    made = replace(block(), reference=(13.4, 52.5, 0.0), control=surveyed)
    back = written(made, tmp_path, "opensfm")
    assert back.reference == made.reference
    assert back.control is not None
    assert back.control.points.ids == ("a", "b")
    assert np.array_equal(back.control.points.xyz, surveyed.points.xyz, equal_nan=True)
    assert np.allclose(back.control.observations.colrow, surveyed.observations.colrow, atol=1e-12)
    with pytest.raises(InputError, match="longitude, latitude"):
        write_reconstruction(replace(made, control=replace(surveyed, crs="EPSG:25833")), tmp_path / "x", "opensfm")


def test_a_point_in_two_parts_of_a_reconstruction_is_two_points(tmp_path: Path) -> None:
    write_reconstruction(block(), tmp_path, "opensfm")
    file = tmp_path / "reconstruction.json"
    (part,) = json.loads(file.read_text())
    other = {**part, "shots": {"image_2.jpg": part["shots"].pop("image_2.jpg")}}
    file.write_text(json.dumps([part, other]))
    back = read_reconstruction(file)
    assert len(back.points.ids) == 80
    assert back.points.ids[40] == "0 (2)"
    assert set(back.observations.point[back.observations.image == 2]) == set(range(40, 80))
    assert np.abs(residuals(back)).max() < 1e-9


def test_measurements_of_opensfm_without_a_point_keep_their_track(tmp_path: Path) -> None:
    write_reconstruction(block(), tmp_path, "opensfm")
    file = tmp_path / "reconstruction.json"
    parts = json.loads(file.read_text())
    del parts[0]["points"]["7"]
    file.write_text(json.dumps(parts))
    back = read_reconstruction(file)
    lost = back.points.ids.index("7")
    assert np.isnan(back.points.xyz[lost]).all()
    assert (back.observations.point == lost).sum() == 3


def test_points_of_colmap_that_are_not_in_the_model_are_named(tmp_path: Path) -> None:
    write_reconstruction(block(), tmp_path, "colmap-text")
    file = tmp_path / "points3D.txt"
    file.write_text("\n".join(line for line in file.read_text().splitlines() if not line.startswith("7 ")))
    with pytest.raises(InputError, match=r"point 7 of image image_0\.jpg"):
        read_reconstruction(tmp_path)


def test_matches_of_pairs_become_points_of_many_images(tmp_path: Path) -> None:
    made = block()
    write_reconstruction(made, tmp_path, "match")
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "image_0__image_1.match",
        "image_0__image_2.match",
        "image_1__image_2.match",
    ]
    back = read_reconstruction(tmp_path)
    assert len(back.points.ids) == 40
    assert len(back.observations.image) == 120
    by_point = [np.sort(back.observations.colrow[back.observations.point == k, 0]) for k in range(40)]
    truth = [np.sort(made.observations.colrow[made.observations.point == k, 0]) for k in range(40)]
    # Pixels are float32 in the files.
    assert np.abs(np.array(by_point) - np.array(truth)).max() < 1e-4


def test_match_files_with_descriptors_are_those_of_the_vision_workbench() -> None:
    point = b"".join(
        np.array([value], dtype=kind).tobytes()
        for value, kind in (
            (9.5, "<f4"), (20.25, "<f4"), (9, "<i4"), (20, "<i4"), (0.1, "<f4"), (1.5, "<f4"), (0.9, "<f4"),
            (1, "u1"), (2, "<u4"), (3, "<u4"), (2, "<u8"), (0.5, "<f4"), (0.25, "<f4"),
        )
    )  # fmt: skip
    data = np.array([1, 1], dtype="<u8").tobytes() + 2 * point
    left, right = read_match(data, "a__b.match")
    # The centre of the upper-left pixel is (0, 0) there, (0.5, 0.5) here.
    assert left.tolist() == right.tolist() == [[10.0, 20.75]]
    with pytest.raises(InputError, match="the file ends"):
        read_match(data[:-1], "a__b.match")
    assert np.array_equal(read_match(match_bytes(left, right), "x")[0], left)


def test_an_adjustment_turns_the_camera_about_its_own_centre() -> None:
    before, after = block().images[:2]
    text = adjustment_text(*adjustment(before, after))
    moved = adjusted(before, *read_adjustment(text, "a.adjust"))
    assert np.abs(moved.pose[0] - after.pose[0]).max() < 1e-14
    assert np.abs(moved.pose[1] - after.pose[1]).max() < 1e-12
    # A quarter turn about z, as the Vision Workbench applies it: the direction of view is turned by the quaternion.
    shift, turn = read_adjustment("1 2 3\n0.70710678118654757 0 0 0.70710678118654757\n", "a.adjust")
    assert shift.tolist() == [1.0, 2.0, 3.0]
    level = ImagePose("a", "1", np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]).T, np.zeros(3))
    view = level.pose[0].T @ [0.0, 0.0, 1.0]
    assert np.allclose(adjusted(level, shift, turn).pose[0].T @ [0.0, 0.0, 1.0], [-view[1], view[0], view[2]])
    with pytest.raises(InputError, match="numbers are not a translation"):
        read_adjustment("1 2 3 1 0 0 0 5 5 1", "a.adjust")


def test_files_that_belong_together_are_known(tmp_path: Path) -> None:
    for format in ("opensfm", "colmap"):
        write_reconstruction(block(), tmp_path / format, format)
    named = {path.name for path in files_read(tmp_path / "opensfm" / "reconstruction.json")}
    assert named == {"reconstruction.json", "tracks.csv"}
    three = {"cameras.bin", "images.bin", "points3D.bin"}
    for path in (tmp_path / "colmap", tmp_path / "colmap" / "images.bin"):
        assert {file.name for file in files_read(path)} == three
    assert files_read(tmp_path / "ties.csv") == (tmp_path / "ties.csv",)


def test_projects_export_every_format_that_is_written() -> None:
    (exports,) = (each for each in declared(AdjustmentOptions) if each.name == "exports")
    assert exports.option.choices == tuple(WRITERS)


def test_files_of_no_known_program_and_unknown_formats_are_told(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("hello")
    for path, format, what in (
        (tmp_path / "a.txt", None, "no program that is known"),
        (tmp_path / "b.txt", None, "no such file"),
        (tmp_path / "a.txt", "colmab", "no format is named"),
    ):
        with pytest.raises(InputError, match=what) as caught:
            read_reconstruction(path, format)
        assert caught.value.hint
    with pytest.raises(InputError, match="str is no reconstruction"):
        write_reconstruction("block", tmp_path, "colmap")  # type: ignore[arg-type]
    assert repr(block()) == "Reconstruction(3 images, 1 camera, 40 points, 120 measurements)"
    assert format_of(tmp_path) is None
    assert set(READERS) >= {name.removesuffix("-text") for name in WRITERS}


def test_a_damaged_number_is_named_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("1 1 1\n0 0 1.5 2.5\nx\n")
    with pytest.raises(InputError, match="'x' is not a finite number") as caught:
        read_reconstruction(tmp_path / "a.txt")
    assert str(caught.value.where).endswith("a.txt, line 3")


def test_a_bundler_reconstruction_has_the_residuals_of_a_bundle(real_data: RealData) -> None:
    found = read_reconstruction(real_data("bundler-bal") / "Balbianello.out")
    off = np.hypot(*residuals(found).T)
    assert (len(found.images), len(found.points.ids), len(off)) == (5, 544, 1417)
    assert np.median(off) < 0.13
    assert np.sqrt((off**2).mean()) < 0.43


def test_an_opensfm_reconstruction_has_residuals_of_a_thousandth_of_its_format(real_data: RealData) -> None:
    found = read_reconstruction(real_data("opensfm-berlin") / "reconstruction_example.json")
    off = np.hypot(*residuals(found).T)
    off = off[np.isfinite(off)] / 3264.0
    assert (len(found.images), len(off)) == (3, 3082)
    assert np.median(off) < 2.5e-4
    assert np.sqrt((off**2).mean()) < 8e-4
    assert found.control is not None
    assert found.control.points.ids == ("0", "1", "3")


def test_a_problem_of_bal_is_read_in_its_own_axes(real_data: RealData) -> None:
    found = read_reconstruction(real_data("bundler-bal") / "dubrovnik-3-7-pre.txt")
    off = residuals(found)
    assert (len(found.images), len(found.points.ids), len(off)) == (3, 7, 19)
    # Before adjustment, as the file's name says; any other reading of its axes gives hundreds of pixels.
    assert 0.5 * (off**2).sum() == pytest.approx(2764.22, abs=0.01)


def test_a_network_in_lists_of_aicon_has_the_residuals_that_its_protocol_prints(real_data: RealData) -> None:
    network = read_aicon(real_data("jaicov-bundle"))
    rows = network.block.observations
    off = np.empty_like(network.xy)
    for index in range(len(network.block.images)):
        own = rows.image == index
        off[own] = network.project(index, network.block.points.xyz[rows.point[own]]) - network.xy[own]
    # Equal to the digits of the lists: coordinates of points have 0.1 µm, at scales of 1 : 50 and less.
    assert (len(network.block.images), len(off)) == (115, 9972)
    assert np.abs(off - network.residuals).max() < 1e-5
    # The camera in our own parameters is the same but for products of affinity and distortion.
    pixel = network.format[0] / network.format[2]
    assert np.sqrt((residuals(network.block) ** 2).mean()) * pixel == pytest.approx(0.000394, abs=2e-6)


def test_lists_of_an_aerial_block_fit_when_convergence_geoid_and_scale_are_heeded(real_data: RealData) -> None:
    found = read_borea(real_data("borea-ign-uce-block"))
    off = residuals(found)
    assert (len(found.images), len(found.points.ids), len(off)) == (805, 3005, 14407)
    assert len(np.unique(found.observations.image)) == 68
    assert np.abs(off.mean(axis=0)).max() < 0.015
    assert off.std(axis=0).max() < 0.21


@pytest.mark.parametrize("format", ["colmap", "colmap-text"])
@pytest.mark.parametrize("lens", list(LENSES))
def test_colmap_itself_reads_and_writes_the_same(tmp_path: Path, format: str, lens: str) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    made = block(camera_with(lens, format))
    write_reconstruction(made, tmp_path, format)
    theirs = pycolmap.Reconstruction(str(tmp_path))
    for image in theirs.images.values():
        pose = next(own for own in made.images if own.name == image.name)
        for row in image.get_observation_points2D():
            point = theirs.points3D[row.point3D_id].xyz
            assert np.abs(image.project_point(point) - row.xy).max() < 1e-8
        assert np.abs(image.projection_center() - pose.pose[1]).max() < 1e-12
    (tmp_path / "theirs").mkdir()
    (theirs.write_text if format == "colmap-text" else theirs.write_binary)(str(tmp_path / "theirs"))
    back = read_reconstruction(tmp_path / "theirs")
    # COLMAP gives its points in an order of its own.
    mine = dict(zip(made.points.ids, made.points.xyz.tolist(), strict=True))
    assert {key: mine[key] for key in back.points.ids} == dict(
        zip(back.points.ids, back.points.xyz.tolist(), strict=True)
    )
    assert np.abs(residuals(back)).max() < 1e-8
