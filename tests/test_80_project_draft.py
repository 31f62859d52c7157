"""`geomosaic new` from what images carry: EXIF and XMP, RPC, DIMAP, a georeference, files of other programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rpc_rig
from affine import Affine
from photo_rig import PLACES, SIZE, photo
from PIL import Image

from geomosaic.cli.main import run
from geomosaic.errors import GeomosaicWarning
from geomosaic.inputs.build import build_block
from geomosaic.inputs.summary import list_missing_inputs
from geomosaic.project.drafts import new_project
from geomosaic.project.load import load_project
from geomosaic.project.photo_tags import photo_facts
from geomosaic.raster.image_metadata import read_photo_tags
from geomosaic_rpc.write import text_of


def new(capsys: pytest.CaptureFixture[str], project: Path, *arguments: object) -> dict[str, Any]:
    code = run(["new", str(project), *map(str, arguments), "--json"])
    out = capsys.readouterr().out
    assert code == 0, out
    result: dict[str, Any] = json.loads(out)
    return result


@pytest.mark.parametrize("element", [False, True])
def test_facts_of_a_photo(tmp_path: Path, element: bool) -> None:
    path = photo(tmp_path / "a.jpg", PLACES[0], element=element)
    facts = photo_facts(read_photo_tags(path), SIZE)
    assert facts.position == pytest.approx((*PLACES[0], 150.5), abs=1e-7)
    assert facts.gimbal == (30.5, -89.0, 0.0)
    assert facts.above_start == 101.2
    assert facts.camera == "Maker Model 1"
    assert facts.focal == pytest.approx(24 * 500 / np.hypot(36, 24))  # the diagonal of 400 x 300 is 500
    south = photo_facts(read_photo_tags(photo(tmp_path / "b.jpg", PLACES[0], south=True)), SIZE).position
    assert south == pytest.approx((-PLACES[0][0], -PLACES[0][1], 150.5), abs=1e-7)


def test_drone_photos_with_what_is_needed_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = [photo(tmp_path / f"{i}.jpg", place) for i, place in enumerate(PLACES)]
    made = new(capsys, tmp_path / "p.toml", *images, "--heights", "ellipsoidal", "--height", 50)
    assert made["needed"] == []
    assert made["misfit"] is None
    inputs = load_project(tmp_path / "p.toml").inputs
    assert list_missing_inputs(inputs) == []
    block = build_block(inputs)
    sight = block.scenes[0].model
    # Straight under the drone, one degree off the nadir: 100.5 m above ground, 1.75 m away.
    from geomosaic.geo.transform import Transform
    from geomosaic.sensor.solve.inverse import image_to_ground

    centre = image_to_ground(sight, np.array([[200.0, 150.0]]), block.surface)
    lon, lat, _ = Transform(block.surface.crs, inputs_crs())(centre)[0]
    north, east = (lat - PLACES[0][1]) * 111_240, (lon - PLACES[0][0]) * 67_900
    assert np.hypot(north, east) == pytest.approx(100.5 * np.tan(np.radians(1.0)), abs=0.02)
    assert np.degrees(np.arctan2(east, north)) == pytest.approx(30.5, abs=0.5)


def inputs_crs() -> Any:
    from pyproj import CRS

    return CRS.from_epsg(4979)


def test_a_raster_with_control_points_in_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from rasterio.control import GroundControlPoint

    points = [GroundControlPoint(row, col, 5e5 + col, 5.5e6 - row) for col in (0, 30) for row in (0, 20)]
    with rasterio.open(
        tmp_path / "one.tif", "w", driver="GTiff", width=40, height=30, count=1, dtype="uint8", gcps=points,
        crs="EPSG:32633",
    ) as file:  # fmt: skip
        file.write(np.full((1, 30, 40), 7, dtype=np.uint8))
    made = new(capsys, tmp_path / "p.toml", tmp_path / "one.tif")
    assert "one.tif carries 4 control points" in made["recognised"]
    assert any("geomosaic georeference" in text for text in made["needed"])


@pytest.mark.parametrize(("reference", "height"), [("0", 150.5), ("1", -150.5), ("0x02", 150.5), ("3", -150.5)])
def test_a_depth_below_the_sea_is_a_negative_height(reference: str, height: float) -> None:
    """Below the sea, in the words of EXIF 2 and of EXIF 3."""
    from geomosaic.raster.image_metadata import PhotoTags

    place = {"GPSLatitude": "(50) (0) (0)", "GPSLatitudeRef": "N", "GPSLongitude": "(10)", "GPSLongitudeRef": "E"}
    facts = photo_facts(PhotoTags({**place, "GPSAltitude": "(150.5)", "GPSAltitudeRef": reference}, ""), SIZE)
    assert facts.position == (10.0, 50.0, height)


@pytest.mark.parametrize(("height", "doubted"), [(50, False), (20, False), (135, True), (-30, True)])
def test_a_ground_that_does_not_fit_the_height_above_take_off_is_doubted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], height: float, doubted: bool
) -> None:
    """Altitude 150.5 m, 101.2 m above take-off: the ground is near 49.3 m."""
    images = [str(photo(tmp_path / f"{i}.jpg", place)) for i, place in enumerate(PLACES)]
    words = ("--heights", "egm96", "--dem-heights", "egm96", "--height", str(height))
    assert run(["new", str(tmp_path / "p.toml"), *images, *words]) == 0
    assert ("--height of 49.3 would agree" in capsys.readouterr().err) == doubted


def test_a_doubtful_ground_is_told_whoever_asks_and_a_trusted_one_is_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = [str(photo(tmp_path / f"{i}.jpg", place)) for i, place in enumerate(PLACES)]
    project, ground = tmp_path / "p.toml", ("--heights", "egm96", "--height", "135")

    def told(*words: object) -> str:
        capsys.readouterr()
        assert run([str(word) for word in words]) == 0
        return capsys.readouterr().err

    told("new", project, *images, *ground)
    text = project.read_text()
    project.write_text(text[: text.index("[match]")] + text[text.index("[output]") :])
    assert "[dem] height of 49.3 would agree" in told("run", project, "orient")
    place = ("--camera", tmp_path / "p-camera.toml", "--exterior", tmp_path / "p-exterior.csv", "--crs", "EPSG:4326")
    words = ("--sensor", "frame", *place, "--angles", "dji", *ground, "-o", tmp_path / "o.tif", "--res", "2")
    assert "--height of 49.3 would agree" in told("ortho", images[0], *words, "--dst-crs", "EPSG:32633")
    project.write_text(project.read_text().replace("[exterior]\n", "[exterior]\ntrusted = true\n"))
    assert "would agree" not in told("run", project, "orient")


@pytest.mark.parametrize("sensor", [[], ["--sensor", "frame"]])
def test_a_block_with_positions_of_most_photos_keeps_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], sensor: list[str]
) -> None:
    """In the CRS that was asked for, with or without a sensor named; photos without a position have empty cells."""
    places = [(13.4 + 0.0003 * i, 52.52) for i in range(75)]
    images = [photo(tmp_path / f"{i}.jpg", place if i else None, gimbal=i == 3) for i, place in enumerate(places)]
    made = new(capsys, tmp_path / "p.toml", *images, *sensor, "--crs", "EPSG:32633")
    told = "\n".join(made["recognised"])
    assert "EXIF and XMP: 74 of 75 photos have a position, 1 a gimbal attitude" in told
    assert "written to p-positions.csv: x, y in EPSG:32633" in told
    rows = [line.split(",") for line in (tmp_path / "p-positions.csv").read_text().splitlines()]
    assert rows[1] == ["0.jpg", "", "", "", "", "", ""]
    assert [float(cell) for cell in rows[4][4:]] == [30.5, -89.0, 0.0]
    from pyproj import Transformer

    wanted = Transformer.from_crs(4326, 32633, always_xy=True).transform(*np.array(places[1:]).T)
    assert np.allclose(np.array([row[1:3] for row in rows[2:]], dtype=float).T, wanted, atol=0.02)


@pytest.mark.parametrize("crs", [[], ["--crs", "EPSG:32633"]])
def test_a_frame_sensor_takes_positions_and_attitude(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], crs: list[str]
) -> None:
    images = [photo(tmp_path / f"{i}.jpg", place) for i, place in enumerate(PLACES)]
    words = ("--sensor", "frame", "--heights", "ellipsoidal", "--height", 50, *crs)
    made = new(capsys, tmp_path / "p.toml", *images, *words)
    assert (made["needed"], made["misfit"]) == ([], None)
    assert load_project(tmp_path / "p.toml").inputs.exterior == tmp_path / "p-exterior.csv"


def odm_list(path: Path, heights: tuple[float, float]) -> Path:
    marks = ["500001 5820001 {0} 10 20 0.jpg a", "500041 5820001 {1} 30 40 1.jpg b"]
    path.write_text("\n".join(["EPSG:32633", *marks]).format(*heights) + "\n")
    return path


def test_positions_beside_a_list_of_control_points_are_observed_in_its_crs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = [photo(tmp_path / f"{i}.jpg", place) for i, place in enumerate(PLACES)]
    control = odm_list(tmp_path / "gcp_list.txt", (51.0, 52.0))
    told = "\n".join(new(capsys, tmp_path / "p.toml", *images, "--gcps", control)["recognised"])
    text = (tmp_path / "p.toml").read_text()
    assert "x, y in EPSG:32633" in told
    assert "p-exterior.csv" in text
    assert "position_sigma = 3" in text
    assert 'heights = "egm96"    # ASSUMED' in text  # one datum for both
    assert "max_corner_sigma_px = 5 " in text  # control tells the place
    flat = odm_list(tmp_path / "flat.txt", (0.0, 0.0))
    told = "\n".join(new(capsys, tmp_path / "flat.toml", *images, "--gcps", flat)["recognised"])
    assert "the positions are not used: flat.txt has one height for all its points" in told
    assert "position_sigma" not in (tmp_path / "flat.toml").read_text()


def test_a_ground_from_tie_points_has_its_accuracy_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = [photo(tmp_path / f"{i}.jpg", place) for i, place in enumerate(PLACES)]
    for name, more in (("own", ()), ("flat", ("--height", 50))):
        new(capsys, tmp_path / f"{name}.toml", *images, *more, "--overwrite")
    own, flat = (load_project(tmp_path / f"{name}.toml").options.uncertainty.accuracy for name in ("own", "flat"))
    assert (own, flat) == (True, False)


def test_photos_that_say_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = new(capsys, tmp_path / "p.toml", photo(tmp_path / "a.jpg", None, gimbal=False))
    assert any("no image says where it was taken" in line for line in made["recognised"])
    assert made["needed"]


def test_scenes_with_rpc(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with rasterio.open(tmp_path / "one.tif", "w", driver="GTiff", width=4000, height=3000, count=1, dtype="uint8"):
        pass
    (tmp_path / "one_RPC.TXT").write_text(text_of(rpc_rig.rpc()))
    made = new(capsys, tmp_path / "p.toml", tmp_path / "one.tif", "--height", 400, "--dem-heights", "ellipsoidal")
    assert "sensor: rpc" in made["recognised"]
    assert made["needed"] == []
    assert made["misfit"] is None
    assert "NEEDED" not in (tmp_path / "p.toml").read_text()
    words = ["--pixel", "5", "5", "--height", "400", "--dem-heights", "ellipsoidal"]
    assert run(["locate", str(tmp_path / "one.tif"), *words]) == 1
    assert "--sensor rpc" in capsys.readouterr().err


def test_one_height_under_a_scene_must_say_what_it_counts_from(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with rasterio.open(tmp_path / "one.tif", "w", driver="GTiff", width=4000, height=3000, count=1, dtype="uint8"):
        pass
    (tmp_path / "one_RPC.TXT").write_text(text_of(rpc_rig.rpc()))
    made = new(capsys, tmp_path / "p.toml", tmp_path / "one.tif", "--height", 400)
    assert [text.split(":")[0] for text in made["needed"]] == ["the vertical datum of the ground's height"]


def test_georeferenced_images_and_world_files_stay_as_they_lie(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with rasterio.open(
        tmp_path / "one.tif", "w", driver="GTiff", width=40, height=30, count=1, dtype="uint8", crs="EPSG:32633",
        transform=Affine(1, 0, 5e5, 0, -1, 5.5e6),
    ) as file:  # fmt: skip
        file.write(np.full((1, 30, 40), 7, dtype=np.uint8))
    made = new(capsys, tmp_path / "p.toml", tmp_path / "one.tif")
    assert "sensor: planar" in made["recognised"]
    assert made["needed"] == []
    Image.fromarray(np.full((30, 40), 7, dtype=np.uint8)).save(tmp_path / "two.png")
    (tmp_path / "two.pgw").write_text("1\n0\n0\n-1\n500000.5\n5499999.5\n")
    made = new(capsys, tmp_path / "q.toml", tmp_path / "two.png", "--crs", "EPSG:32633")
    assert "sensor: planar" in made["recognised"]
    assert made["needed"] == []


@pytest.mark.parametrize("z", ["x,y,z", "x,y"])
def test_control_of_a_scan_needs_no_heights(tmp_path: Path, capsys: pytest.CaptureFixture[str], z: str) -> None:
    Image.fromarray(np.full((30, 40), 7, dtype=np.uint8)).save(tmp_path / "scan.png")
    empty = "," if z.endswith("z") else ""
    places = [(1.0, 1.0), (39.0, 2.0), (38.0, 29.0), (2.0, 28.0)]
    rows = [f"{n},{5e5 + col},{5.5e6 - row}{empty},scan.png,{col},{row}" for n, (col, row) in enumerate(places)]
    (tmp_path / "gcps.csv").write_text("\n".join([f"id,{z},image,col,row", *rows]) + "\n")
    files, frame = ("--gcps", tmp_path / "gcps.csv"), ("--crs", "EPSG:32633")
    made = new(capsys, tmp_path / "p.toml", tmp_path / "scan.png", "--sensor", "planar", *files, *frame)
    assert "control: 4 control and 0 check points, 4 measurements" in made["recognised"]
    assert made["needed"] == []


def test_photos_of_flat_ground(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    images = [photo(tmp_path / f"{i}.jpg", None) for i in range(2)]
    (tmp_path / "ties.csv").write_text(
        "id,image,col,row\n" + "".join(f"{i},{j}.jpg,{i},{j}\n" for i in range(3) for j in (0, 1))
    )
    new(capsys, tmp_path / "p.toml", *images, "--kind", "controlled")
    text = (tmp_path / "p.toml").read_text()
    assert '[planar]\nkind = "controlled"' in text
    new(capsys, tmp_path / "q.toml", *images, "--ties", tmp_path / "ties.csv")
    planar = load_project(tmp_path / "q.toml").inputs.planar
    assert planar is not None
    assert (planar.kind, planar.ties) == ("uncontrolled", tmp_path / "ties.csv")


def test_a_folder_stands_for_its_image(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "SCENE"
    folder.mkdir()
    photo(folder / "IMG_1.jpg", PLACES[0])
    photo(folder / "preview.jpg", PLACES[0])
    (folder / "METADATA.DIM").write_text("<x/>")
    made = new(capsys, tmp_path / "p.toml", folder)
    assert "images: 1, 400 x 300 pixels, 3 x uint8, none georeferenced" in made["recognised"]
    empty = tmp_path / "empty"
    empty.mkdir()
    (empty / "METADATA.DIM").write_text("<x/>")
    assert run(["new", str(tmp_path / "q.toml"), str(empty / "METADATA.DIM")]) == 1
    assert "there is metadata, but no image" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["(a) (b) (c)", "()", "(1) (2) (3) (4)", "", "nan", "(1e999)"])
def test_damaged_tags_count_as_missing(text: str) -> None:
    from geomosaic.raster.image_metadata import PhotoTags

    exif = {
        "GPSLatitude": text,
        "GPSLatitudeRef": "N",
        "GPSLongitude": text,
        "GPSLongitudeRef": "E",
        "FocalLength": text,
    }
    facts = photo_facts(PhotoTags(exif, f'drone-dji:GimbalYawDegree="{text}"'), SIZE)
    assert (facts.position, facts.gimbal, facts.focal) == (None, None, None)


def raster(path: Path, value: int = 7, *, left: float = 5e5) -> Path:
    with rasterio.open(
        path, "w", driver="GTiff", width=40, height=30, count=1, dtype="uint8", crs="EPSG:32633",
        transform=Affine(1, 0, left, 0, -1, 5.5e6),
    ) as file:  # fmt: skip
        file.write(np.full((1, 30, 40), value, dtype=np.uint8))
    return path


def test_images_that_were_listed_stay_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A file that comes later does not join them, and brackets in a name are no pattern."""
    images = [raster(tmp_path / name) for name in ("one.tif", "two[1].tif", "name.tif")]
    new(capsys, tmp_path / "p.toml", *images)
    raster(tmp_path / "later.tif")
    raster(tmp_path / "two1.tif")
    assert load_project(tmp_path / "p.toml").images == tuple(images)
    text = (tmp_path / "p.toml").read_text()
    (tmp_path / "p.toml").write_text(text.replace("[mosaic]", "[mosaic]\ncolour = 3"))
    assert run(["status", str(tmp_path / "p.toml")]) == 1
    assert "line " in capsys.readouterr().err


def test_files_with_another_role_are_no_images(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A DEM, a reference or an output that a pattern matches is left out; one that is listed is named, too."""
    images = [raster(tmp_path / f"{i}.tif", left=5e5 + 20 * i) for i in range(2)]
    names = ("dem.tif", "ortho.tif", "output/old.tif")
    (tmp_path / "output").mkdir()
    dem, reference, _ = [raster(tmp_path / name) for name in names]
    new(capsys, tmp_path / "p.toml", *images, dem, "--dem", dem)
    text = (tmp_path / "p.toml").read_text()
    assert "dem.tif" not in text.split("[sensor]")[0]
    start, rest = text.split("images = [")
    project = f'{start}images = ["*.tif", "*/*.tif"]{rest.split("]", 1)[1]}'.replace("# [dem]", "[dem]")
    project += '\nreference = "ortho.tif"\nmax_registration_px = 1.0\n'
    (tmp_path / "p.toml").write_text(project)
    (tmp_path / "sub").mkdir()
    images.append(raster(tmp_path / "sub" / "2.tif"))
    with pytest.warns(GeomosaicWarning, match=r"'\*\.tif' matches dem\.tif, ortho\.tif, which .* left out") as said:
        assert load_project(tmp_path / "p.toml").images == tuple(images)
    assert len(said) == 1  # outputs come and go
    listed = project.replace('"*.tif", ', '"0.tif", "1.tif", "dem.tif", ')
    (tmp_path / "listed.toml").write_text(listed)
    assert run(["status", str(tmp_path / "listed.toml")]) == 0
    assert "note: dem.tif is the file of [dem] file: it is left out of the images" in capsys.readouterr().err
    words = ["--reference", str(reference), "--histogram", "overlap", "-o", str(tmp_path / "m.tif")]
    assert run(["mosaic", *map(str, images[:2]), str(reference), *words]) == 0
    assert "ortho.tif is the file of `reference`" in capsys.readouterr().err.replace("--reference", "`reference`")


def test_a_pattern_takes_rasters_without_their_side_cars(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is neither is named: it may be a photo that cannot be read."""
    (tmp_path / "photos").mkdir()
    images = [raster(tmp_path / "photos" / f"{i}.tif") for i in range(2)]
    raster(tmp_path / "photos" / "0.tif.ovr")
    names = ("0.stac.json", "0.tif.aux.xml", "1.wld", "1.prj", "1.xmp", "list.txt", "seams.gpkg")
    beside = [tmp_path / "photos" / name for name in (*names, "1.arw")]
    for file in beside:
        file.write_text("")
    new(capsys, tmp_path / "p.toml", *images, *beside[:5])
    text = (tmp_path / "p.toml").read_text()
    assert "stac" not in text
    start, rest = text.split("images = [")
    (tmp_path / "p.toml").write_text(f'{start}images = ["photos/*"]{rest.split("]", 1)[1]}')
    with pytest.warns(GeomosaicWarning, match=r"matches 1\.arw, which cannot be read as a raster") as said:
        assert load_project(tmp_path / "p.toml").images == tuple(images)
    assert len(said) == 1


def test_metadata_under_a_name_of_its_own_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with rasterio.open(tmp_path / "one.tif", "w", driver="GTiff", width=40, height=30, count=1, dtype="uint8"):
        pass
    (tmp_path / "SPOT6.XML").write_text("<?xml version='1.0'?><Dimap_Document></Dimap_Document>")
    words = ["--sensor", "pushbroom", "--pixel", "5", "5", "--height", "400", "--dem-heights", "ellipsoidal"]
    assert run(["locate", str(tmp_path / "one.tif"), *words]) == 1
    assert "SPOT6.XML beside it has no orbit and attitude" in capsys.readouterr().err


@pytest.mark.parametrize("rows_down", [True, False])
def test_crops_of_a_scene_get_the_offsets_that_their_geotransforms_tell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rows_down: bool
) -> None:
    """Each lies at its own place then; without its offset none is taken for the upper-left part in silence."""
    corners = {"a.tif": (400, 0), "b.tif": (2100, 1500)}
    for name, (col, row) in corners.items():
        sign = 1 if rows_down else -1
        with rasterio.open(
            tmp_path / name, "w", driver="GTiff", width=500, height=400, count=1, dtype="uint8",
            transform=Affine(1, 0, col, 0, sign, sign * row),
        ) as file:  # fmt: skip
            file.write(np.full((1, 400, 500), 7, dtype=np.uint8))
        (tmp_path / f"{Path(name).stem}_RPC.TXT").write_text(text_of(rpc_rig.rpc()))
    ground = ["--height", "400", "--dem-heights", "ellipsoidal"]
    made = new(capsys, tmp_path / "p.toml", tmp_path / "a.tif", tmp_path / "b.tif", *ground)
    assert made["misfit"] is None
    assert sum("is proposed" in line for line in made["recognised"]) == 2
    blocks = load_project(tmp_path / "p.toml").blocks
    models = {scene.name: scene.model for scene in build_block(blocks[0]).scenes}
    places = rpc_rig.ground(5)
    for name, corner in corners.items():
        found = models[name].ground_to_image(places) + corner
        np.testing.assert_allclose(found, rpc_rig.model().ground_to_image(places), atol=1e-9)
    words = ["--sensor", "rpc", "-o", tmp_path / "o.tif", *ground]
    assert run([str(word) for word in ("ortho", tmp_path / "b.tif", *words)]) == 1
    assert "give offset = [2100, 1500]" in capsys.readouterr().err
    assert run([str(word) for word in ("locate", tmp_path / "p.toml", "--image", "b.tif", "--pixel", 9, 9)]) == 0


def test_an_image_that_was_cut_with_its_rpc_needs_no_offset(tmp_path: Path) -> None:
    with rasterio.open(
        tmp_path / "a.tif", "w", driver="GTiff", width=500, height=400, count=1, dtype="uint8",
        transform=Affine(1, 0, 2100, 0, 1, 1500),
    ):  # fmt: skip
        pass
    (tmp_path / "a_RPC.TXT").write_text(text_of(rpc_rig.rpc().moved(-2100, -1500)))
    made = new_project(tmp_path / "p.toml", tmp_path / "a.tif")
    assert not any("proposed" in line for line in made.recognised)
