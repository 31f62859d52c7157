"""The command `locate`: pixels and digitized vectors to the map, map vectors into the photo, and how it fails."""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine
from helpers import GROUND, Hills

from geomosaic.cli.main import run
from geomosaic.estimation.statistics import correlations, variance_factor
from geomosaic.geo.transform import Transform
from geomosaic.inputs.adjusted import adjusted_images, exterior_of
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import HasExterior, SensorRequest
from geomosaic.sensor.solve import resect
from geomosaic.surface.dem import Dem

SIZE = (1000, 800)
FILES = {"camera": "camera.toml", "exterior": "exterior.csv", "dem": "dem.tif"}
OPTIONS: dict[str, Any] = {
    "camera": {"focal_length_px": 1000.0},
    "position": [500000.0, 5500000.0, 1000.0],
    "orientation": {"system": "opk", "omega": 3.0, "phi": -2.0, "kappa": 30.0},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A photo without georeference, and a DEM of hills."""
    base = tmp_path_factory.mktemp("locate")
    profile = {"driver": "GTiff", "count": 1}
    with rasterio.open(base / "photo.tif", "w", width=SIZE[0], height=SIZE[1], dtype="uint8", **profile) as file:
        file.write(np.zeros(SIZE[::-1], np.uint8), 1)
    x, y = np.meshgrid(498502.5 + 5.0 * np.arange(600), 5501497.5 - 5.0 * np.arange(600))
    z = Hills().height(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
    grid = {"width": 600, "height": 600, "transform": Affine(5, 0, 498500, 0, -5, 5501500), "crs": 32633}
    with rasterio.open(base / "dem.tif", "w", dtype="float64", **grid, **profile) as file:
        file.write(z, 1)
    return base


def words(folder: Path, *more: str, sensor: bool = True) -> list[str]:
    options = [word for name, value in OPTIONS.items() for word in ("--option", f"{name}={json.dumps(value)}")]
    place = ["--sensor", "frame", "--crs", "EPSG:32633", "--heights", "ellipsoidal", *options] if sensor else []
    ground = ["--dem", str(folder / "dem.tif"), "--dem-heights", "ellipsoidal"]
    return ["locate", str(folder / "photo.tif"), *more, *place, *ground]


def truth(folder: Path, xy: np.ndarray) -> np.ndarray:
    """Where the photo shows places of the map."""
    model = registry.build("frame", SensorRequest("photo", SIZE, OPTIONS, GROUND))
    dem = Dem.open(folder / "dem.tif", heights="ellipsoidal")
    ground = np.column_stack([xy, dem.height(xy)])
    dem.close()
    return model.ground_to_image(Transform(GROUND, model.crs)(ground))


def asked(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert run([*arguments, "--json"]) == 0, capsys.readouterr().err
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    return answer


def resected(folder: Path, seed: int = 0, noise: float = 0.5) -> Path:
    """Table of control points measured in the photo with noise, with their standard deviation."""
    random = np.random.default_rng(seed)
    xy = np.random.default_rng(1).uniform([499600, 5499700], [500400, 5500300], (12, 2))
    dem = Dem.open(folder / "dem.tif", heights="ellipsoidal")
    heights = dem.height(xy)
    dem.close()
    measured = truth(folder, xy) + noise * random.normal(size=(12, 2))
    rows = [f"p{i},{x},{y},{z},photo.tif,{c},{r},{noise}" for i, ((x, y), z, (c, r)) in
            enumerate(zip(xy.tolist(), heights.tolist(), measured.tolist(), strict=True))]  # fmt: skip
    path = folder / f"gcps-{seed}.csv"
    path.write_text("\n".join(["id,x,y,z,image,col,row,sigma_px", *rows]) + "\n")
    return path


def frame(folder: Path) -> list[str]:
    (folder / "camera.toml").write_text("size = [1000, 800]\nfocal_length_px = 1000.0\n")
    ground = ["--dem", str(folder / "dem.tif"), "--dem-heights", "ellipsoidal"]
    place = ["--crs", "EPSG:32633", "--heights", "ellipsoidal"]
    return ["--sensor", "frame", "--camera", str(folder / "camera.toml"), *place, *ground]


def test_sigmas_that_are_said_are_those_of_the_table_and_the_limit_of_corners_is_a_flag(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gcps, output = resected(folder), tmp_path / "a.tif"
    # Residuals five times what these sigmas promise: both have a say.
    sure = tmp_path / "sure.csv"
    sure.write_text(gcps.read_text().replace(",0.5\n", ",0.1\n"))
    given = [str(folder / "photo.tif"), *frame(folder), "--gcps", str(sure), "--res", "9", "-o", str(output)]
    assert run(["ortho", *given, "--max-corner-sigma", "0.01"]) == 3
    told = " ".join("".join(capsys.readouterr()).split())
    assert "what you accept is --max-corner-sigma" in told
    with (tmp_path / "a-exterior.csv").open() as lines:
        row = next(csv.DictReader(lines))
    # Said along other axes than the table's, so that the length alone is the same.
    metres = re.search(r"sigmas of [^:]+: ([\d., ]+) m;", told)
    assert metres
    said = [float(number) for number in metres[1].split(",")]
    assert math.hypot(*said) == pytest.approx(math.hypot(*(float(row[f"sigma_{axis}"]) for axis in "xyz")), rel=0.04)
    assert run(["ortho", *given, "--max-corner-sigma", "9", "--overwrite"]) == 0


def test_a_resected_orientation_is_exported_and_read_again(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The ortho by control points, and that by the table they gave, are one; so are the places and their errors."""
    photo, gcps, first, again = folder / "photo.tif", resected(folder), tmp_path / "a.tif", tmp_path / "b.tif"
    with rasterio.open(photo, "r+") as file:
        file.write(np.random.default_rng(2).integers(1, 255, SIZE[::-1], np.uint8), 1)
    points = ["--gcps", str(gcps)]
    made = asked(capsys, "ortho", str(photo), *frame(folder), *points, "--res", "4", "-o", str(first))
    table = ["--exterior", str(tmp_path / "a-exterior.csv")]
    asked(capsys, "ortho", str(photo), *frame(folder), *table, "--res", "4", "-o", str(again))
    with rasterio.open(first) as one, rasterio.open(again) as other:
        difference = np.abs(one.read().astype(int) - other.read().astype(int))
    assert difference.max() <= 1
    assert (difference > 0).mean() < 1e-4
    placed = made["placement"]
    assert 0.3 < placed["rms_control_px"] < 1.2
    assert placed["accuracy"]["middle_sigma_px"] < placed["accuracy"]["largest_sigma_px"] < 5.0
    pixel = ["--pixel", "100", "100"]
    by_points = asked(capsys, "locate", str(photo), *frame(folder), *points, *pixel)["points"][0]
    by_table = asked(capsys, "locate", str(photo), *frame(folder), *table, *pixel)["points"][0]
    for name, value in by_points.items():
        assert by_table[name] == value or abs(by_table[name] - value) < 1e-3 * abs(value), name
    assert 0.2 < by_table["semi_minor_m"] < by_table["semi_major_m"] < 1.0
    bare = tmp_path / "bare.csv"
    bare.write_text("\n".join(",".join(line.split(",")[:7]) for line in Path(table[1]).read_text().splitlines()) + "\n")
    nothing = asked(capsys, "locate", str(photo), *frame(folder), "--exterior", str(bare), *pixel)
    assert "nothing says how well" in nothing["notes"][0]
    bare.write_text(Path(table[1]).read_text().replace("-0.99", "-1.99"))
    assert run(["locate", str(photo), *frame(folder), "--exterior", str(bare), *pixel]) == 1
    assert "correlations of the orientation cannot be" in capsys.readouterr().err


def test_a_wrong_control_point_is_named_by_command_facts_and_accuracy_alike(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of twelve is 17 px off: the model, what is said of it, and its accuracy are those of the other eleven."""
    lines = resected(folder, 4).read_text().splitlines()
    cells = lines[8].split(",")
    spoilt, without = tmp_path / "spoilt.csv", tmp_path / "without.csv"
    moved = ",".join([*cells[:5], str(float(cells[5]) + 15.0), str(float(cells[6]) - 8.0), cells[7]])
    spoilt.write_text("\n".join([*lines[:8], moved, *lines[9:]]) + "\n")
    without.write_text("\n".join([*lines[:8], *lines[9:]]) + "\n")
    made = {}
    for table in (spoilt, without):
        output = tmp_path / f"{table.stem}.tif"
        words = [str(folder / "photo.tif"), *frame(folder), "--gcps", str(table), "--res", "9", "-o", str(output)]
        assert run(["ortho", *words, "--json"]) == 0
        out, err = capsys.readouterr()
        made[table.stem] = json.loads(out)["placement"]
        assert ("1 of 12 control points contradicts the others and is left out: point 'p7' is off by" in err) == (
            table == spoilt
        )
    found, good = made["spoilt"], made["without"]
    (image,) = found["images"]
    assert [point["point"] for point in image["left_out"]] == ["p7"]
    assert math.hypot(*image["left_out"][0]["size_px"]) == pytest.approx(17.0, abs=2.0)
    assert image["points"] == 11
    assert "11 measurements of control points, 1 left out (point 'p7' is off by" in found["summary"][0]
    assert found["rms_control_px"] == pytest.approx(good["rms_control_px"], abs=1e-6)
    assert found["accuracy"]["largest_sigma_px"] == pytest.approx(good["accuracy"]["largest_sigma_px"], rel=1e-4)
    place = ["locate", str(folder / "photo.tif"), *frame(folder), "--pixel", "500", "400"]
    assert any("11 control points, 1 left out" in n for n in asked(capsys, *place, "--gcps", str(spoilt))["notes"])


def test_exported_sigmas_are_the_errors_of_resections(folder: Path) -> None:
    """Errors of the exported elements in many resections of the same noise, over their standard deviations."""
    block = Block((folder / "photo.tif",), "frame", options={"camera": OPTIONS["camera"]}, control=resected(folder),
                  crs="EPSG:32633", heights="ellipsoidal", height=0.0, dem_heights="ellipsoidal")  # fmt: skip
    built = build_block(block)
    (image,) = adjusted_images(block, built)
    model, random, trials = image.scene.model, np.random.default_rng(3), 60
    assert built.crs is not None
    assert isinstance(model, HasExterior)
    ground = Transform(built.crs, model.crs)(np.array([point.xyz for point in built.control]))
    exact, found = model.ground_to_image(ground), []
    for _ in range(trials):
        noisy = exact + random.normal(0.0, 0.5, exact.shape)
        found.append(resect(model, ground, noisy, 0.5).model.exterior(built.crs))
    exported = exterior_of(image.scene.model, image.covariance, built.crs)
    assert exported is not None
    values, covariance = exported
    ratios = (np.array(found) - values) / np.sqrt(np.diag(covariance) / variance_factor(image.found.sigma0, 18))
    # Sigmas of a sample of so many scatter by 1 / sqrt(2 · trials), and the resections are not quite linear.
    assert np.abs(np.sqrt((ratios**2).mean(axis=0)) - 1.0).max() < 0.35
    rho = np.corrcoef(np.array(found).T)
    assert np.abs(rho - correlations(covariance)).max() < 0.3


def test_an_orientation_far_off_its_control_ends_with_the_code_of_quality(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Orthos, mosaics, and a project that is oriented only: all is written, and told."""
    photo, points, table = folder / "photo.tif", ["--gcps", str(resected(folder))], tmp_path / "off.csv"
    table.write_text("image,x,y,z,omega,phi,kappa\nphoto.tif,500042,5500000,1000,3,-2,30\n")
    given = [*frame(folder), *points, "--exterior", str(table)]
    for command in ("ortho", "mosaic"):
        output = tmp_path / f"{command}.tif"
        assert run([command, str(photo), *given, "--res", "40", "-o", str(output)]) == 3
        assert "control points, median distance: 4" in capsys.readouterr().err
        assert output.is_file()
    project = tmp_path / "block.toml"
    assert run(["new", str(project), str(photo), *given]) == 0
    assert run(["run", str(project), "orient"]) == 3
    assert run(["run", str(project), "orient"]) == 3  # also where nothing is stale
    assert "control points, median distance: 4" in capsys.readouterr().err


def test_pixels_of_the_command_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    xy = np.array([[500010.0, 5500020.0], [500200.0, 5499900.0]])
    pixels = [word for c, r in truth(folder, xy).tolist() for word in ("--pixel", repr(c), repr(r))]
    found = asked(capsys, *words(folder, *pixels))
    assert np.allclose([[p["x"], p["y"]] for p in found["points"]], xy, atol=1e-5)
    assert found["heights"] == "ellipsoidal"
    assert found["error_of"] == []
    assert found["points"][0]["semi_major_m"] is None
    assert "takes no part" in found["notes"][0]
    sigmas = [w for n in registry.plugin("frame").build(SensorRequest("p", SIZE, OPTIONS, GROUND)).parameters.names
              for w in ("--sigma", f"{n}=0.01")]  # fmt: skip
    more = asked(capsys, *words(folder, *pixels, "--sigma-px", "0.5", "--sigma-dem", "1", *sigmas))
    assert more["error_of"] == ["measurement", "orientation", "surface"]
    assert 0.5 < more["points"][0]["semi_minor_m"] < more["points"][0]["semi_major_m"] < 3.0
    degrees = asked(capsys, *words(folder, *pixels, "--dst-crs", "EPSG:4326", "--dst-heights", "egm96"))
    assert degrees["crs"] == "EPSG:4326"
    assert 14.9 < degrees["points"][0]["x"] < 15.1
    assert abs(degrees["points"][0]["z"] - found["points"][0]["z"]) > 30.0
    assert run(words(folder, *pixels)) == 0
    said = capsys.readouterr().out
    assert "500010.000 5500020.000" in said
    assert "heights: ellipsoidal" in said


def test_a_table_and_its_count_of_pixels(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    xy = np.array([[500010.0, 5500020.0], [500200.0, 5499900.0]])
    image = truth(folder, xy)
    counts = {
        ("down", "0.5"): image,
        ("down", "0"): image - 0.5,
        ("negative", "0.5"): image * [1, -1],
        ("up", "0"): np.column_stack([image[:, 0] - 0.5, SIZE[1] - image[:, 1] - 0.5]),
    }
    for (rows, first), places in counts.items():
        table = tmp_path / "pixels.csv"
        lines = "\n".join(f"p{k},{c!r},{r!r}" for k, (c, r) in enumerate(places.tolist()))
        table.write_text(f"id,col,row\n{lines}\n")
        found = asked(capsys, *words(folder, str(table), "--rows", rows, "--first-pixel", first))
        assert np.allclose([[p["x"], p["y"]] for p in found["points"]], xy, atol=1e-5), (rows, first)
    out = tmp_path / "places.csv"
    assert run(words(folder, str(table), "--rows", "up", "--first-pixel", "0", "--sigma-px", "1", "-o", str(out))) == 0
    with out.open() as file:
        rows_ = list(csv.DictReader(file))
    assert [row["id"] for row in rows_] == ["p0", "p1"]
    assert np.allclose([[float(r["x"]), float(r["y"])] for r in rows_], xy, atol=1e-5)
    assert 0.5 < float(rows_[0]["semi_minor_m"]) < 2.0


@pytest.mark.parametrize("suffix", [".gpkg", ".geojson"])
def test_vectors_digitized_on_the_photo(folder: Path, tmp_path: Path, suffix: str) -> None:
    """As QGIS shows a raw photo: y is minus the row. Attributes stay; heights come."""
    xy = np.array([[499900.0, 5500000.0], [500100.0, 5500050.0], [500150.0, 5499900.0]])
    line = shapely.LineString(truth(folder, xy) * [1, -1])
    sky = shapely.LineString([(10.0, -10.0), (20.0, -20.0)])
    frame = geopandas.GeoDataFrame({"name": ["path", "edge"]}, geometry=[line, sky])
    source = tmp_path / f"digitized{suffix}"
    with pytest.warns(UserWarning, match="crs"):
        frame.to_file(source)
    out = tmp_path / f"map{suffix}"
    assert run(words(folder, str(source), "--rows", "negative", "--sigma-px", "0.5", "-o", str(out))) == 0
    found = geopandas.read_file(out)
    assert found["name"].tolist() == ["path", "edge"]
    assert found.crs.to_2d().to_epsg() == 32633
    assert found["heights"].tolist() == ["ellipsoidal"] * 2
    coords = shapely.get_coordinates(found.geometry[0], include_z=True)
    assert np.allclose(coords[:, :2], xy, atol=1e-4)
    dem = Dem.open(folder / "dem.tif", heights="ellipsoidal")
    assert np.allclose(coords[:, 2], dem.height(xy), atol=1e-3)
    dem.close()
    assert 0.3 < found["semi_major_m"][0] < 1.0
    dense = tmp_path / "dense.csv"
    assert run(words(folder, str(source), "--rows", "negative", "--step", "20", "-o", str(dense))) == 0
    assert len(dense.read_text().splitlines()) > 15


def test_map_vectors_into_the_photo_and_back(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A road far longer than the photo, a house, a lamp and a house elsewhere; QGIS's count of rows."""
    road = shapely.LineString([(498600.0, 5499800.0), (501400.0, 5500300.0)])
    house = shapely.box(500010, 5500010, 500040, 5500030)
    shapes = [road, house, shapely.Point(499950.0, 5499950.0), shapely.box(498600, 5501300, 498650, 5501400)]
    vectors = geopandas.GeoDataFrame({"what": ["road", "house", "lamp", "far"]}, geometry=shapes, crs=32633)
    source = tmp_path / "map.gpkg"
    vectors.to_file(source)
    out = tmp_path / "drawn.gpkg"
    more = (str(source), "--inverse", "--rows", "negative", "-o", str(out))
    told = asked(capsys, *words(folder, *more))
    assert (told["features"], told["drawn"], told["hidden"]) == (4, 3, 0)
    drawn = geopandas.read_file(out)
    assert drawn.crs is None or "ndefined" in drawn.crs.name
    assert set(drawn["what"]) == {"road", "house", "lamp"}
    y = shapely.get_coordinates(drawn.geometry)[:, 1]
    assert ((y <= 0) & (y >= -SIZE[1])).all()
    lamp = drawn[drawn["what"] == "lamp"].geometry.iloc[0]
    assert np.allclose([lamp.x, -lamp.y], truth(folder, np.array([[499950.0, 5499950.0]]))[0], atol=1e-6)
    corners = truth(folder, np.array(house.exterior.coords)) * [1, -1]
    outline = drawn[drawn["what"] == "house"].geometry.iloc[0]
    assert outline.geom_type == "Polygon"
    assert max(outline.exterior.distance(shapely.Point(c)) for c in corners) < 0.05
    # And back: what was drawn lies on the road again.
    back = tmp_path / "back.gpkg"
    assert run(words(folder, str(out), "--rows", "negative", "-o", str(back))) == 0
    roads = geopandas.read_file(back)
    roads = roads[roads["what"] == "road"]
    places = shapely.get_coordinates(roads.geometry)
    assert max(road.distance(shapely.Point(p)) for p in places) < 0.05
    table = tmp_path / "drawn.csv"
    assert run(words(folder, str(source), "--inverse", "--mark-hidden", "-o", str(table))) == 0
    assert table.read_text().startswith("feature,piece,col,row,hidden\n")


def test_shapefiles_in_another_crs(folder: Path, tmp_path: Path) -> None:
    road = geopandas.GeoDataFrame(geometry=[shapely.LineString([(499900, 5500000), (500100, 5500050)])], crs=32633)
    road.to_crs(4326).to_file(tmp_path / "road.shp")
    out = tmp_path / "drawn.geojson"
    assert run(words(folder, str(tmp_path / "road.shp"), "--inverse", "--rows", "down", "-o", str(out))) == 0
    drawn = json.loads(out.read_text())["features"][0]["geometry"]["coordinates"]
    assert np.allclose(drawn[0], truth(folder, np.array([[499900.0, 5500000.0]]))[0], atol=1e-4)


def test_control_points_tell_the_error(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The photo is placed by resection; its orientation's covariance goes into the ellipse."""
    rng = np.random.default_rng(2)
    xy = rng.uniform([499750, 5499800], [500250, 5500200], (12, 2))
    image = truth(folder, xy) + rng.normal(0, 0.3, (12, 2))
    dem = Dem.open(folder / "dem.tif", heights="ellipsoidal")
    z = dem.height(xy)
    dem.close()
    points = np.column_stack([xy, z, image]).tolist()
    lines = [f"{i},{x!r},{y!r},{h!r},photo.tif,{c!r},{r!r},0.3" for i, (x, y, h, c, r) in enumerate(points)]
    table = tmp_path / "gcps.csv"
    table.write_text("id,x,y,z,image,col,row,sigma_px\n" + "\n".join(lines) + "\n")
    given = ["--sensor", "frame", "--crs", "EPSG:32633", "--heights", "ellipsoidal", "--gcps", str(table)]
    camera = ["--option", f"camera={json.dumps(OPTIONS['camera'])}"]
    found = asked(capsys, *words(folder, "--pixel", "500", "400", *given, *camera, sensor=False))
    assert found["error_of"] == ["orientation"]
    assert "12 control points" in found["notes"][0]
    assert 0.03 < found["points"][0]["semi_major_m"] < 1.0
    assert run(words(folder, "--pixel", "500", "400", *given, *camera, "--sigma", "omega=1", sensor=False)) == 1
    assert "both given" in capsys.readouterr().err
    # An orientation that is off is put right by the control, in both directions.
    off = {**OPTIONS, "position": [500012.0, 5499991.0, 1004.0]}
    wrong = [word for name, value in off.items() for word in ("--option", f"{name}={json.dumps(value)}")]
    image = truth(folder, np.array([[500010.0, 5500020.0]]))[0].tolist()
    pixel = ["--pixel", *map(repr, image)]
    moved = asked(capsys, *words(folder, *pixel, *given[:-2], *wrong, sensor=False))["points"][0]
    put = asked(capsys, *words(folder, *pixel, *given, *wrong, sensor=False))["points"][0]
    assert np.hypot(moved["x"] - 500010.0, moved["y"] - 5500020.0) > 5.0
    assert np.hypot(put["x"] - 500010.0, put["y"] - 5500020.0) < 0.5
    geopandas.GeoDataFrame(geometry=[shapely.Point(500010.0, 5500020.0)], crs=32633).to_file(tmp_path / "map.gpkg")
    drawn = ["--inverse", "--rows", "down", "-o", str(tmp_path / "drawn.csv")]
    assert run(words(folder, str(tmp_path / "map.gpkg"), *drawn, *given, *wrong, sensor=False)) == 0
    line = (tmp_path / "drawn.csv").read_text().splitlines()[1].split(",")
    assert np.hypot(float(line[2]) - image[0], float(line[3]) - image[1]) < 0.5


WRONG = {
    "nothing": ([], 2, "either --pixel"),
    "both": (["FILE", "--pixel", "1", "2"], 2, "either --pixel"),
    "inverse without file": (["FILE", "--inverse"], 2, "-o"),
    "sigma of nothing": (["--pixel", "1", "2", "--sigma", "omge=1"], 1, "did you mean 'omega'"),
    "negative sigma": (["--pixel", "1", "2", "--sigma", "omega=-1"], 2, "standard deviation"),
    "missing sigma": (["--pixel", "1", "2", "--sigma", "omega=0.1"], 1, "nothing says how well"),
    "pixels far off": (["--pixel", "500000", "5500000"], 1, "no pixels of this image"),
    "no such file": (["nothing.csv"], 1, "does not exist"),
    "unknown suffix": (["--pixel", "1", "2", "-o", "OUT.xyz"], 1, "no format"),
    "vectors without rows": (["FILE", "-o", "OUT.gpkg"], 1, "--rows"),
    "map places as pixels": (["FILE", "--rows", "down", "-o", "OUT.gpkg"], 1, "--inverse"),
    "drawing without rows": (["FILE", "--inverse", "-o", "OUT.gpkg"], 1, "--rows"),
    "option of the other way": (["FILE", "--inverse", "--sigma-px", "1", "-o", "OUT.gpkg"], 2, "means nothing"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_calls_are_refused_with_a_hint(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str
) -> None:
    given, code, said = WRONG[case]
    vectors = geopandas.GeoDataFrame(geometry=[shapely.Point(500000.0, 5500000.0)], crs=32633)
    vectors.to_file(tmp_path / "map.gpkg")
    swapped = [w.replace("FILE", str(tmp_path / "map.gpkg")).replace("OUT", str(tmp_path / "out")) for w in given]
    assert run(words(folder, *swapped)) == code
    assert said in capsys.readouterr().err
    assert not list(tmp_path.glob("out*"))


def test_rows_of_the_wrong_sense_are_recognised(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "p.csv").write_text("id,col,row\na,100,-300\nb,200,-310\n")
    assert run(words(folder, str(tmp_path / "p.csv"))) == 1
    assert "--rows negative would bring them into it" in capsys.readouterr().err


def test_pixels_outside_the_image_have_no_place(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A model goes on beyond the image; nobody has seen what it would say there."""
    (tmp_path / "p.csv").write_text("id,col,row\na,500,400\nb,-3,400\nc,1000.5,400\n")
    found = asked(capsys, *words(folder, str(tmp_path / "p.csv")))
    assert [point["x"] is None for point in found["points"]] == [False, True, False]  # a hand may slip over the edge
    assert (found["lost"], found["outside"]) == (1, [1])
    assert run(words(folder, str(tmp_path / "p.csv"), "-o", str(tmp_path / "p.gpkg"))) == 0
    told = capsys.readouterr().out
    assert "p.gpkg: 2 points" in told
    assert "1 point with no place" in told
    assert "1 outside the image" in told
    lines = [shapely.LineString([(10, 10), (90, 60)]), shapely.LineString([(10, 10), (-90, 60)])]
    geopandas.GeoDataFrame(geometry=lines, crs=32633).to_file(tmp_path / "lines.gpkg")
    assert run(words(folder, str(tmp_path / "lines.gpkg"), "--rows", "down", "-o", str(tmp_path / "o.gpkg"))) == 0
    assert "1 feature with no place and left out" in capsys.readouterr().out
    assert run(words(folder, "--pixel", "5000", "400")) == 1
    assert "would bring them into it" not in capsys.readouterr().err


def test_vectors_of_another_place_are_reported(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    far = geopandas.GeoDataFrame(geometry=[shapely.Point(590000.0, 5500000.0)], crs=32633)
    far.to_file(tmp_path / "far.gpkg")
    drawn = [str(tmp_path / "far.gpkg"), "--inverse", "--rows", "down", "-o", str(tmp_path / "drawn.csv")]
    assert run(words(folder, *drawn)) == 0
    said = capsys.readouterr().err
    assert "nothing of far.gpkg is seen in the photo" in said
    assert "--src-crs" in said


def test_heights_of_a_geoid_stay_in_the_file(folder: Path, tmp_path: Path) -> None:
    """A compound CRS is kept whole by a GeoPackage; GeoJSON has the map's, and a column for the heights."""
    for suffix in (".gpkg", ".geojson"):
        out = tmp_path / f"places{suffix}"
        assert run(words(folder, "--pixel", "500", "400", "--dst-heights", "egm96", "-o", str(out))) == 0
        found = geopandas.read_file(out)
        assert found["heights"].tolist() == ["EGM96 height"]
        assert found.crs.is_compound == (suffix == ".gpkg")
        assert found.geometry[0].z < -20.0


def test_an_image_of_a_project(sample: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The project's inputs hold; they give the same place as the same inputs on the command line."""
    project, photo = sample / "project.toml", sample / "photos" / "strip1_02.jpg"
    pixel = ["--pixel", "600", "450", "--json"]
    assert run(["locate", str(project), "--image", "strip1_02", *pixel]) == 0
    of_project = json.loads(capsys.readouterr().out)
    given = ["--sensor", "frame", "--crs", "EPSG:32633", "--heights", "egm96", "--dem-heights", "egm96"]
    given += [word for name, file in FILES.items() for word in (f"--{name}", str(sample / file))]
    assert run(["locate", str(photo), *given, *pixel]) == 0
    assert json.loads(capsys.readouterr().out)["points"] == of_project["points"]
    for wrong, said in (([], "--image strip1_01.jpg"), (["--image", "strip1_20"], "no image 'strip1_20'")):
        assert run(["locate", str(project), *wrong, *pixel]) == 1
        assert said in capsys.readouterr().out
    assert run(["locate", str(photo), "--image", "strip1_02", *pixel]) == 2
    assert run(["locate", str(project), "--sensor", "frame", *pixel]) == 2
