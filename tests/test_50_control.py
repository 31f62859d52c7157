"""Control of one image and the files it comes in."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from pyproj import CRS
from rasterio.control import GroundControlPoint

import geomosaic as gm
from geomosaic.block_adjustment.measurements import control_of, measurements
from geomosaic.control.points import ControlPoints, Origin
from geomosaic.control.read import read_control_file, read_world_transform, recognise
from geomosaic.errors import GeomosaicError, InputError
from geomosaic.options.adjustment import AdjustmentOptions

UTM = "EPSG:32633"
Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def to(text: str, name: str = "control.txt") -> Path:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return to


def control(**changes: object) -> ControlPoints:
    values: dict[str, object] = {
        "names": ("a", "b"),
        "colrow": np.array([[1.0, 2.0], [3.0, 4.0]]),
        "ground": np.array([[5e5, 5e6, 100.0], [5e5 + 10, 5e6, np.nan]]),
        "crs": CRS(UTM),
        "sigma": np.ones(2),
        "roles": ("control", "check"),
        "enabled": np.array([True, True]),
        "origins": (Origin("f.csv", 2), Origin("f.csv", 3)),
    }
    return ControlPoints(**{**values, **changes})


def test_value_is_frozen_and_selects() -> None:
    points = control()
    with pytest.raises(ValueError, match="read-only"):
        points.colrow[0, 0] = 9.0
    assert points.of_role("check").names == ("b",)
    assert points.without(["a"]).of_role("control").names == ()
    assert len(points) == 2
    with pytest.raises(InputError, match="no point 'c'"):
        points.without(["c"])


def test_value_goes_to_another_crs_and_back() -> None:
    points = control()
    there = points.to_crs(CRS("EPSG:4326"))
    # On the central meridian of zone 33, by definition of the projection.
    assert there.ground[0, 0] == pytest.approx(15.0, abs=1e-12)
    assert there.ground[0, 2] == 100.0
    assert np.isnan(there.ground[1, 2])
    back = there.to_crs(CRS(UTM))
    np.testing.assert_allclose(back.xy, points.xy, atol=1e-6)
    with pytest.raises(InputError, match=r"f.csv, line 3: point 'b' has no height"):
        control(crs=CRS("EPSG:32633").to_3d()).to_crs(CRS("EPSG:4978"))
    with pytest.raises(InputError, match=r"point 'a' .* has no place"):
        control(ground=np.array([[1e9, 1e9], [5e5, 5e6]])).to_crs(CRS("EPSG:4326"))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"names": ("a", "a")}, r"f.csv, line 3: two points are called 'a': f.csv, line 2"),
        ({"sigma": np.array([1.0, 0.0])}, r"line 3: point 'b' has the sigma 0"),
        ({"roles": ("control", "tie")}, r"line 3: point 'b' has the role 'tie'"),
        ({"colrow": np.array([[np.nan, 2.0], [3.0, 4.0]])}, r"line 2: point 'a' .* not finite"),
        ({"roles": ("control",)}, "parts of other lengths"),
    ],
)
def test_impossible_control_values_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        control(**changes)


TABLES = {
    "commas": "id,x,y,z,image,col,row\nP1,500000.5,5000000.25,10,a.tif,100.5,200.25\n",
    "semicolons, decimal commas": "id;X;Y;Z;Image;Col;Row\nP1;500000,5;5000000,25;10;a.tif;100,5;200,25\n",
    "tabs, other words": "name\teasting\tnorthing\theight\tfile\tcolumn\tline\n"
    "P1\t500000.5\t5000000.25\t10\ta.tif\t100.5\t200.25\n",
    "blanks, comments": "# made by hand\nid x y z image col row\n# first\n"
    "P1 500000.5 5000000.25 10 a.tif 100.5 200.25\n",
    "quotes, order, byte order mark": '\ufeffrow,col,"image",id,y,x,z,\n'
    '200.25,100.5,"a.tif",P1,5000000.25,500000.5,10\n',
}


@pytest.mark.parametrize("text", TABLES.values(), ids=TABLES.keys())
def test_the_published_table(write: Write, text: str) -> None:
    reading = read_control_file(write(text), crs=UTM)
    assert reading.format == "csv"
    points = reading.control
    assert points.names == ("P1",)
    np.testing.assert_array_equal(points.colrow, [[100.5, 200.25]])
    np.testing.assert_array_equal(points.ground, [[500000.5, 5000000.25, 10.0]])
    assert points.origins[0].number == len(text.splitlines())
    assert ("decimal commas" in reading.notes) == (";" in text)


def test_table_with_all_columns(write: Write) -> None:
    text = (
        "#CRS: EPSG:32633\nid,x,y,image,col,row,sigma_px,role,enabled,remark\n"
        "1,5,6,A/one.tif,7,8,0.5,check,0,kerb\n2,15,16,two.tif,17,18,,,,\n3,25,26,one.TIF,27,28,,,1,\n"
    )
    path = write(text)
    reading = read_control_file(path, image="/photos/one.tif")
    points = reading.control
    assert points.names == ("1", "3")
    assert points.crs == CRS(UTM)
    assert points.ground.shape == (2, 2)
    assert points.sigma.tolist() == [0.5, 1.0]
    assert points.roles == ("check", "control")
    assert points.enabled.tolist() == [False, True]
    assert [str(origin) for origin in points.origins] == [f"{path}, line 3", f"{path}, line 5"]
    assert "columns not used: remark" in reading.notes
    assert "1 point of other images left out" in reading.notes
    assert read_control_file(path, image="two").control.names == ("2",)
    centre = read_control_file(path, image="two", count="centre").control
    np.testing.assert_array_equal(centre.colrow, [[17.5, 18.5]])
    with pytest.raises(InputError, match="points of 2 images"):
        read_control_file(path)
    with pytest.raises(InputError, match=r"no point is measured in 'tow.tif'[^$]*did you mean 'two.tif'"):
        read_control_file(path, image="tow.tif")
    with pytest.raises(InputError, match="says its ground coordinates are in 'WGS 84 / UTM zone 33N', and"):
        read_control_file(path, image="two", crs="EPSG:32632")
    assert read_control_file(path, image="two", crs="+proj=utm +zone=33 +datum=WGS84").control.names == ("2",)


HEAD = "id;x;y;col;row\n"
BAD_TABLES = {
    "no CRS": (HEAD + "a;1;2;3;4\n", None, "does not say which CRS"),
    "no column": ("id,x,y,col\na,1,2,3\n", UTM, r"line 1: control needs the column row; the header has id, x, y, col"),
    "two words": ("x,lon,y,col,row\n1,2,3,4,5\n", UTM, "columns 'x' and 'lon' both mean x"),
    "no rows": (HEAD, UTM, "no points in the file"),
    "word": (HEAD + "a;1;2;3;4\nb;one;2;3;4\n", UTM, r"line 3: column 'x' has 'one'"),
    "empty": (HEAD + "a;1;2;;4\n", UTM, r"line 2: column 'col' is empty"),
    "infinite": (HEAD + "a;1;inf;3;4\n", UTM, "column 'y' has 'inf'"),
    "thousands": (HEAD + "a;500 123,5;2;3;4\n", UTM, "column 'x' has '500 123,5'[^$]*thousands"),
    "thousands by point": (HEAD + "a;500.123,5;2;3;4\n", UTM, "column 'x'[^$]*thousands"),
    "mixed marks": (HEAD + "a;500,123;2.5;3;4\n", UTM, "'500,123' has a comma and '2.5' \\(line 2\\) a point"),
    "degrees": (HEAD + "a;15°30'E;2;3;4\n", UTM, "15°30'E[^$]*degrees with decimals"),
    "decimal commas among commas": ("x,y,col,row\n1,5,2,5,3,5,4,5\n", UTM, r"line 2: 8 values for 4 [^$]*semicolons"),
    "too many": (HEAD + "a;1;2;3;4;5\n", UTM, "6 values for 5 columns"),
    "twice": (HEAD + "a;1;2;3;4\na;1;2;3;4\n", UTM, r"line 3: two points are called 'a'"),
    "flag": ("x,y,col,row,enabled\n1,2,3,4,perhaps\n", UTM, "column 'enabled' has 'perhaps'"),
    "sigma": ("x,y,col,row,sigma_px\n1,2,3,4,-1\n", UTM, "point '1' has the sigma -1"),
    "nonsense": ("1,2,3\n4,5,6\n", UTM, "no control that can be read; its first line is '1,2,3'"),
    "nothing": ("", UTM, "no control that can be read"),
    "endless line": (
        "x,y,col,row\n" + "9" * 200_000 + ",1,2,3\n",
        UTM,
        "line 2: the list of control points has a line of more than 100,000 characters",
    ),
    "image missing": ("x,y,image,col,row\n1,2,,3,4\n", UTM, "line 2: column 'image' is empty"),
}


@pytest.mark.parametrize(("text", "crs", "message"), BAD_TABLES.values(), ids=BAD_TABLES.keys())
def test_errors_in_a_table_name_line_and_column(write: Write, text: str, crs: str | None, message: str) -> None:
    path = write(text)
    with pytest.raises(InputError, match=message) as caught:
        read_control_file(path, crs=crs)
    assert caught.value.hint
    assert str(path) in str(caught.value)


QGIS_NEW = (
    "#CRS: EPSG:32633\nmapX,mapY,sourceX,sourceY,enable,dX,dY,residual\n"
    "500000,5000000,10.5,-20.25,1,0,0,0\n500010,5000000,30,0,0,0,0,0\n"
)
QGIS_OLD = "mapX,mapY,pixelX,pixelY,enable\n500000,5000000,10.5,-20.25,1\n500010,5000000,30,0,0\n"


@pytest.mark.parametrize(("text", "crs"), [(QGIS_NEW, None), (QGIS_OLD, UTM), (QGIS_OLD.replace(",", "\t"), UTM)])
def test_points_of_qgis_are_read(write: Write, text: str, crs: str | None) -> None:
    reading = read_control_file(write(text), crs=crs)
    assert reading.format == "qgis"
    points = reading.control
    assert points.crs == CRS(UTM)
    np.testing.assert_array_equal(points.colrow, [[10.5, 20.25], [30.0, 0.0]])
    np.testing.assert_array_equal(points.ground, [[500000, 5000000], [500010, 5000000]])
    assert points.enabled.tolist() == [True, False]
    assert points.names == ("0", "1")
    assert any("upwards" in note for note in reading.notes)


def test_qgis_rows_downwards(write: Write) -> None:
    path = write(QGIS_NEW.replace("-20.25", "20.25"))
    reading = read_control_file(path, size=(100, 50))
    np.testing.assert_array_equal(reading.control.colrow[0], [10.5, 20.25])
    assert any("downwards (positive)" in note for note in reading.notes)
    assert read_control_file(path, sign="down").control.colrow[0, 1] == 20.25
    with pytest.raises(InputError, match="rows are positive, which QGIS does not write"):
        read_control_file(path)
    with pytest.raises(InputError, match="georeferenced already"):
        read_control_file(path, size=(20, 50))
    mixed = write(QGIS_NEW.replace(",30,0,", ",30,7,"))
    with pytest.raises(InputError, match=r"line 4: rows have both signs: point 1 has 7"):
        read_control_file(mixed, size=(100, 50))
    assert read_control_file(mixed, sign="up").control.colrow[:, 1].tolist() == [20.25, -7.0]


ODM = "{crs}\n500000.5 5000000 NaN 10 20 a.jpg p1 extra\n500010 5000000 7 30 40 b.jpg\n500010 5000000 8 50 60 a.jpg\n"


@pytest.mark.parametrize("crs", ["EPSG:32633", "WGS84 UTM 33N", "+proj=utm +zone=33 +datum=WGS84 +units=m +no_defs"])
def test_points_of_odm_are_read(write: Write, crs: str) -> None:
    path = write(ODM.format(crs=crs))
    reading = read_control_file(path, image="a.jpg")
    assert reading.format == "odm"
    points = reading.control
    assert points.crs.to_epsg() == 32633
    assert points.names == ("p1", "line 4")
    np.testing.assert_array_equal(points.colrow, [[10.5, 20.5], [50.5, 60.5]])
    np.testing.assert_array_equal(points.ground, [[500000.5, 5000000, np.nan], [500010, 5000000, 8]])
    assert reading.notes[0].startswith("0.5 added")
    np.testing.assert_array_equal(read_control_file(path, image="b", count="corner").control.colrow, [[30.0, 40.0]])
    with pytest.raises(InputError, match=r"points of 2 images: a\.jpg, b.jpg"):
        read_control_file(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ODM.format(crs="WGS84 UTM 33"), "line 1: 'WGS84 UTM 33': UTM zone 33 has no hemisphere"),
        (ODM.format(crs="WGS84 UTM 73N"), "no UTM zone 73"),
        (ODM.format(crs="EPSG:1"), "not a coordinate reference system"),
        ("EPSG:32633\n1 2 3\n", r"line 2: 3 values where at least 6"),
        ("EPSG:32633\n1 2 3 four 5 a.jpg\n", r"line 2: column 'im_x' has 'four'"),
        ("EPSG:32633\n", "no points"),
    ],
)
def test_errors_in_a_list_of_opendronemap_name_the_line(write: Write, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_control_file(write(text), image="a.jpg")


def test_points_of_a_raster_are_read(tmp_path: Path) -> None:
    path = tmp_path / "tagged.tif"
    gcps = [GroundControlPoint(row=2.5, col=1.5, x=15.0, y=45.0, z=9.0, id="k1"), GroundControlPoint(0, 0, 14, 46, 3)]
    with rasterio.open(path, "w", driver="GTiff", width=4, height=3, count=1, dtype="uint8") as file:
        file.gcps = (gcps, rasterio.CRS.from_epsg(4326))
    reading = read_control_file(path)
    assert reading.format == "raster"
    np.testing.assert_array_equal(reading.control.colrow, [[1.5, 2.5], [0, 0]])
    np.testing.assert_array_equal(reading.control.ground, [[15.0, 45.0, 9.0], [14.0, 46.0, 3.0]])
    assert reading.control.crs.to_epsg() == 4326
    assert str(reading.control.origins[1]) == f"{path}, GCP 2"
    bare = tmp_path / "bare.tif"
    with rasterio.open(bare, "w", driver="GTiff", width=4, height=3, count=1, dtype="uint8"):
        pass
    with pytest.raises(InputError, match="no control points in it"):
        read_control_file(bare)


def test_a_world_file_is_four_corners(write: Write) -> None:
    path = write("2.0\n0.0\n0.0\n-2.0\n500001.0\n4999999.0\n", "image.tfw")
    assert read_world_transform(path) == (2.0, 0.0, 500000.0, 0.0, -2.0, 5000000.0)
    reading = read_control_file(path, size=(10, 20), crs=UTM)
    assert reading.format == "world"
    np.testing.assert_array_equal(reading.control.colrow[0], [0.5, 0.5])
    np.testing.assert_array_equal(reading.control.xy[0], [500001.0, 4999999.0])
    np.testing.assert_array_equal(reading.control.xy[2], [500000 + 2 * 9.5, 5000000 - 2 * 19.5])
    with pytest.raises(InputError, match="without its image"):
        read_control_file(path, crs=UTM)
    with pytest.raises(InputError, match="onto a line"):
        read_control_file(write("2\n0\n0\n0\n5\n5\n"), size=(9, 9), crs=UTM)


def test_world_file_means_what_gdal_means(tmp_path: Path) -> None:
    path = tmp_path / "turned.tif"
    with rasterio.open(path, "w", driver="GTiff", width=4, height=3, count=1, dtype="uint8"):
        pass
    path.with_suffix(".tfw").write_text("1.5\n0.25\n0.5\n-2\n100\n200\n")
    with rasterio.open(path) as file:
        expected = tuple(file.transform)[:6]
    assert read_world_transform(path.with_suffix(".tfw")) == pytest.approx(expected, abs=1e-12)


def test_options_that_have_no_meaning(write: Write) -> None:
    path = write(TABLES["commas"])
    for option in ({"format": "xml"}, {"sign": "up"}, {"count": "edge"}, {"count": "centre", "format": "qgis"}):
        with pytest.raises(InputError):
            read_control_file(path, crs=UTM, **option)
    for missing in (path.parent, path.parent / "absent.csv"):
        with pytest.raises(GeomosaicError):
            recognise(missing)


def test_real_files_of_control_are_read(real_data: Callable[[str], Path]) -> None:
    scene = read_control_file(real_data("rio-tiler-gcps") / "cog_gcps.tif")
    assert (scene.format, len(scene.control), scene.control.crs.to_epsg()) == ("raster", 210, 4326)
    assert scene.control.ground[0, 2] == pytest.approx(255.3009, abs=1e-4)
    landsat = read_control_file(real_data("rasterio-fixtures") / "RGB.byte.gcp.vrt")
    assert (landsat.format, len(landsat.control)) == ("raster", 4)
    kite = real_data("odm-copr") / "gcp_list.txt"
    photo = read_control_file(kite, image="images/IMG_0031.jpg")
    assert (photo.format, len(photo.control), photo.control.crs.to_epsg()) == ("odm", 3, 32611)
    first = read_control_file(kite, image="IMG_0037").control
    np.testing.assert_array_equal(first.colrow, [[3609.8727839973153, 2294.2951481487607]])
    np.testing.assert_array_equal(first.ground, [[235269.88, 3811198.11, 0.0]])
    assert str(first.origins[0]) == f"{kite}, line 2"
    with pytest.raises(InputError, match="points of 22 images"):
        read_control_file(kite)


@pytest.mark.parametrize("crs", [UTM, "EPSG:2263", "EPSG:4326"])
def test_standard_deviations_on_the_ground_count_with_those_in_the_image(crs: str, write: Write) -> None:
    """A pixel is 0.5 m: 2 m on the ground are 4 px, beside 3 px in the image 5 in all."""
    metres = {UTM: (1.0, 1.0), "EPSG:2263": (0.3048006096,) * 2, "EPSG:4326": (111_195.0 * np.cos(0.7), 111_195.0)}[crs]
    corner = (np.degrees(0.7), np.degrees(0.7)) if crs == "EPSG:4326" else (5e5, 2e5)
    lines = [f"#CRS: {crs}", "id,x,y,col,row,sigma_px,sigma_xy"]
    for i, (c, r) in enumerate([(0, 0), (100, 0), (0, 100), (100, 100), (50, 30)]):
        x, y = corner[0] + 0.5 * c / metres[0], corner[1] - 0.5 * r / metres[1]
        lines.append(f"p{i},{x:.12f},{y:.12f},{c},{r},3,{2 if i else 0}")
    reading = read_control_file(write("\n".join(lines), "control.csv"))
    np.testing.assert_allclose(reading.control.sigma, [3.0, 5.0, 5.0, 5.0, 5.0], rtol=2e-3)
    assert any("sigma_xy" in note for note in reading.notes)
    with pytest.raises(InputError, match="sigma_xy"):
        read_control_file(write("#CRS: EPSG:32633\nx,y,col,row,sigma_xy\n1,2,3,4,-1\n5,2,9,4,1\n", "control.csv"))


def test_a_height_that_is_not_known_is_no_observation_of_a_block() -> None:
    ground = CRS("EPSG:32633").to_3d()
    block = gm.Block(["one.tif", "two.tif"], "frame", crs=UTM, heights="ellipsoidal", control={
        image: control(roles=("control", "control"), colrow=np.array([[100.0, 50.0], [700.0, 400.0]]))
        for image in ("one.tif", "two.tif")
    })  # fmt: skip
    points = control_of([block], ("one.tif", "two.tif"), ground)
    sizes = {"one.tif": (1000, 800), "two.tif": (1000, 800)}
    measured, _ = measurements(sizes, None, points, AdjustmentOptions())
    assert np.isnan(measured.given[1, 2])
    assert np.isfinite(measured.given[0]).all()
    assert measured.sigma_given[1, 2] == np.inf
    assert np.isfinite(measured.sigma_given[1, :2]).all()
