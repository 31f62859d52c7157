"""Damaged text and XML of every kind that is read: a clear error or a value, never a crash, never a hang."""

from __future__ import annotations

import math
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from helpers import examples
from hypothesis import HealthCheck, example, given
from hypothesis import strategies as st

from geomosaic.control.read import read_control as read_image_control
from geomosaic.developed.surface_file import read_surface
from geomosaic.errors import GeomosaicError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.inputs.control_points import read_block, read_control
from geomosaic.inputs.correction_grids import read_corrections
from geomosaic.inputs.declarations import read_camera
from geomosaic.inputs.exterior_orientation import program_of, read_exterior
from geomosaic.inputs.photos import Photo
from geomosaic.inputs.printed_orientation import read_printed
from geomosaic.inputs.tables import read_fiducials
from geomosaic.options.inputs import PrintedList
from geomosaic.project.image_metadata import photo_facts
from geomosaic.project.load import load_project
from geomosaic.raster.image_metadata import PhotoTags
from geomosaic.rpc.refine import read_ties
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest

SETTINGS = examples(25, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
MAP = with_heights(parse_crs("EPSG:32633"), "ellipsoidal")
MATRIX = "1 0 0 0 1 0 0 0 1"


def frame(system: str, **options: Any) -> Callable[[Path], object]:
    def read(path: Path) -> object:
        row = {"system": system, "reconstruction": path.name}
        request = SensorRequest("a.jpg", (40, 30), {"orientation": row, **options}, MAP, str(path.parent))
        return registry.build("frame", request)

    return read


def printed(path: Path) -> object:
    columns = ("image", "x", "y", "z", "omega", "phi", "kappa")
    return read_printed(path, PrintedList(columns, "right up", ("phi", "omega", "kappa")), "gon", None)


def track(path: Path) -> object:
    options = {"track": path.name, "focal_length_px": 900.0, "columns": "left", "start_time": 1.0, "line_period": 0.01}
    return registry.build("pushbroom", SensorRequest("a", (40, 30), options, MAP, str(path.parent)))


def strip(path: Path) -> object:
    """The track of an across-track scanner: another table."""
    options = {"kind": "scanner", "field_of_view": 60.0, "track": path.name, "start_time": 1.0, "period": 0.01}
    return registry.build("panoramic", SensorRequest("a", (40, 30), options, MAP, str(path.parent)))


def certificate(path: Path) -> object:
    options = {
        "camera": dict(read_camera(path)),
        "fiducials": {"1": [1.0, 1.0], "2": [39.0, 1.0], "3": [39.0, 29.0], "4": [1.0, 29.0]},
        "position": [500000.0, 5500000.0, 900.0],
        "orientation": {"system": "opk", "omega": 0.0, "phi": 0.0, "kappa": 0.0},
    }
    return registry.build("frame", SensorRequest("a.jpg", (40, 30), options, MAP, str(path.parent)))


def colmap(path: Path) -> object:
    if path.name != "cameras.txt":
        path.with_name("cameras.txt").write_text("1 PINHOLE 40 30 40 40 20 15\n")
    else:
        path.with_name("images.txt").write_text(IMAGES)
    return frame("colmap", world="map")(path)


IMAGES = "# list\n1 0.0 1.0 0.0 0.0 -500000.0 5500000.0 900.0 1 a.jpg\n\n"
SHOT = (
    '[{"cameras": {"c": {"projection_type": "brown", "width": 40, "height": 30, "focal_x": 0.9, "focal_y": 0.9, '
    '"c_x": 0.0, "c_y": 0.0, "k1": 0.01}}, "shots": {"a.jpg": {"rotation": [3.14, 0.0, 0.0], "translation": '
    '[1.0, 2.0, 50.0], "camera": "c"}}, "reference_lla": {"latitude": 52.0, "longitude": 15.0, "altitude": 10.0}}]'
)
PIX4D = (
    "camera model m = K [R|-Rt] X\n\na.jpg 40 30\n40 0 20\n0 40 15\n0 0 1\n0.01 0 0\n0 0\n"
    "500000 5500000 900\n1 0 0\n0 -1 0\n0 0 -1\n"
)
METASHAPE = (
    '<document version="2.0.0"><chunk><sensors><sensor id="0" type="frame"><resolution width="40" height="30"/>'
    '<calibration class="adjusted"><f>40</f><cx>1</cx><k1>0.01</k1><b2>0.5</b2></calibration></sensor></sensors>'
    '<cameras><camera id="0" sensor_id="0" label="a"><transform>1 0 0 0 0 -1 0 0 0 0 -1 900 0 0 0 1'
    f"</transform></camera></cameras><transform><rotation>{MATRIX}</rotation><translation>5e5 5.5e6 0</translation>"
    '<scale>1</scale></transform><reference>LOCAL_CS["m"]</reference></chunk></document>'
)
ROWS = ("<x>1</x><y>0</y><z>0</z>", "<x>0</x><y>-1</y><z>0</z>", "<x>0</x><y>0</y><z>-1</z>")
IGN = (
    "<orientation><auxiliarydata><image_name>a</image_name></auxiliarydata><geometry><extrinseque><sommet><easting>5e5"
    "</easting><northing>5.5e6</northing><altitude>900</altitude></sommet><rotation><Image2Ground>true</Image2Ground>"
    f"<mat3d>{''.join(f'<l{i}><pt3d>{row}</pt3d></l{i}>' for i, row in enumerate(ROWS, 1))}</mat3d></rotation>"
    "</extrinseque><intrinseque><sensor><image_size><width>40</width><height>30</height></image_size><ppa><c>20</c>"
    "<l>15</l><focale>40</focale></ppa><distortion><pps><c>21</c><l>15</l></pps><r3>1e-6</r3><r5>0</r5><r7>0</r7>"
    "</distortion></sensor></intrinseque></geometry></orientation>"
)
TEXT = "# Cameras (1)\n# PhotoID, X, Y, Z, Omega, Phi, Kappa, r11\na\t500000\t5500000\t900\t0.5\t-0.2\t10\n"
CAMERA = {"focal_length_px": 40.0}


def ties(path: Path) -> object:
    info: Any = SimpleNamespace(size=(40, 30), width=40, height=30)
    return read_block([Photo(Path(name), info, None) for name in ("a.jpg", "b.jpg")], path, None)


TABLE = "image,x,y,z,omega,phi,kappa\na.jpg,1,2,3,0.1,0.2,0.3\n'b',1,2,3,1,2,3\n"
GCPS = "id,x,y,z,image,col,row,sigma_px,role\n1,1,2,3,a.jpg,4,5,0.5,check\n"
QGIS = "#CRS: EPSG:32633\nmapX,mapY,sourceX,sourceY,enable\n500000,5500000,1,-2,1\n500001,5500000,3,-4,1\n"
CAMERA_FILE = 'focal_length = 24.0\nsensor_size = [36, 24]\n[distortion]\nmodel = "brown"\nk1 = 0.1\n'
PROJECT = 'format = 1\n[project]\nimages = ["*.toml"]\n[sensor]\nname = "frame"\n[dem]\nheight = 3.0\n'
TRACK = "time,x,y,z,roll,pitch,heading\n" + "".join(f"{t},{500000 + t},5500000,900,0,0,90\n" for t in range(9))

STRIP = "time,x,y,z,heading,pitch,roll\n" + "".join(f"{t},{500000 + t},5500000,900,90,0,0\n" for t in range(9))
FILM = (
    "focal_length = 150.0\nprincipal_point_autocollimation = [0.01, 0.0]\n[fiducials]\n1 = [-95.0, 70.0]\n"
    "2 = [95.0, 70.0]\n3 = [95.0, -70.0]\n4 = [-95.0, -70.0]\n[distortion]\nmodel = 'radial'\n"
    "radius = [0, 50, 100, 150]\ndistortion = [0, 2, -3, 4]\n"
)
TOWER = 'kind = "cylinder"\npoint = [10.0, 20.0, 0.0]\naxis = [0, 0, 1]\nradius = 4.0\nbottom = 0.0\ntop = 15.0\n'
DOME = 'kind = "ellipsoid"\ncentre = [1.0, 2.0, 0.0]\nsemi_axes = [4.0, 3.0]\nprojection = "dome-plan"\nbottom = 1.0\n'

KINDS: dict[str, tuple[str, str, Callable[[Path], object]]] = {
    "orientation table": ("t.csv", TABLE, lambda path: read_exterior(path, "opk")),
    "printed list": ("t.lst", "101 1000.0 2000.0 3000.0 1.0D+00 2.0 3.0\n102 1 2 3 4 5 6\n", printed),
    "control table": ("g.csv", GCPS, lambda path: read_control(path, ["a.jpg"])),
    "QGIS points": ("g.points", QGIS, lambda path: read_image_control(path, image="a.jpg", size=(40, 30))),
    "ODM points": (
        "gcp_list.txt",
        "EPSG:32633\n500000 5500000 10 1 2 a.jpg\n500001 5500001 10 3 4 a.jpg p\n",
        lambda path: read_image_control(path, image="a.jpg", size=(40, 30)),
    ),
    "tie points": ("ties.csv", "id,image,col,row\n1,a.jpg,1,2\n1,b.jpg,3,4\n", ties),
    "fiducials": (
        "f.csv",
        "image,id,col,row\na.jpg,1,1,2\na.jpg,2,3,4\n",
        lambda path: read_fiducials(path, ["a.jpg"]),
    ),
    "correction grid": ("c.csv", "col,row,d_col,d_row\n0,0,0.1,0\n9,0,0,0\n0,9,0,0\n9,9,0,0.1\n", read_corrections),
    "camera": ("c.toml", CAMERA_FILE, read_camera),
    "project": ("p.toml", PROJECT, load_project),
    "certificate": ("film.toml", FILM, certificate),
    "track": ("track.csv", TRACK, track),
    "track of a scanner": ("track.csv", STRIP, strip),
    "tie points of scenes": (
        "ties.csv",
        "id,image,col,row\n1,a.jpg,1,2\n1,b.jpg,3,4\n",
        lambda path: read_ties(path, ["a.jpg", "b.jpg"]),
    ),
    "surface": ("tower.toml", TOWER, read_surface),
    "dome": ("dome.toml", DOME, read_surface),
    "OpenSfM": ("reconstruction.json", SHOT, frame("opensfm")),
    "ODM": ("reconstruction.json", SHOT, frame("odm")),
    "Pix4D": ("p_calibrated_camera_parameters.txt", PIX4D, frame("pix4d")),
    "Metashape XML": ("cameras.xml", METASHAPE, frame("metashape", world="map")),
    "IGN": ("a.ori.xml", IGN, frame("ori")),
    "Metashape text": ("opk.txt", TEXT, frame("metashape", camera=CAMERA)),
    "COLMAP images": ("images.txt", IMAGES, colmap),
    "COLMAP cameras": ("cameras.txt", "# list\n1 OPENCV 40 30 40 40 20 15 0.01 0 0 0\n", colmap),
}


@contextmanager
def file_of(name: str, data: bytes) -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        yield path


def outcome(kind: str, data: bytes) -> GeomosaicError | None:
    """What is said of a file; None where it can be read."""
    name, _, read = KINDS[kind]
    with file_of(name, data) as path, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            program_of(path)
            read(path)
        except GeomosaicError as error:
            return error
    return None


@pytest.mark.parametrize("kind", KINDS)
def test_whole_files_are_read(kind: str) -> None:
    assert outcome(kind, KINDS[kind][1].encode()) is None


@pytest.mark.parametrize("kind", KINDS)
@SETTINGS
@given(data=st.binary(max_size=200))
def test_any_bytes(kind: str, data: bytes) -> None:
    error = outcome(kind, data)
    assert error is None or error.what


PIECES = st.one_of(
    st.sampled_from(
        ["", "nan", "inf", "-1", "0", "1e308", "1e-320", "9" * 400, '"', "'", ",", ";", "\t", "\n", "\0", "{}", "[]",
         "null", "true", "<", "&a;", "]", "=", "é", "\ud7ff", "a.jpg", "1_0", "٣"]
    ),
    st.text(max_size=12),
    st.floats().map(repr),
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@SETTINGS
@given(cuts=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 30), PIECES), min_size=1, max_size=3))
def test_a_replaced_piece_is_read_or_refused(kind: str, cuts: list[tuple[float, int, str]]) -> None:
    text = KINDS[kind][1]
    for place, length, piece in cuts:
        at = math.floor(place * len(text))
        text = text[:at] + piece + text[at + length :]
    error = outcome(kind, text.encode("utf-8", "surrogatepass"))
    assert error is None or error.what


@SETTINGS
@example(exif={"FocalLengthIn35mmFilm": "1e308"}, xmp="")
@example(exif={"FocalLengthIn35mmFilm": "50", "FocalLength": "1e9", "PixelXDimension": "1e-300"}, xmp="")
@given(
    exif=st.dictionaries(
        st.sampled_from(
            ["GPSLatitude", "GPSLatitudeRef", "GPSLongitude", "GPSLongitudeRef", "GPSAltitude", "FocalLength",
             "FocalLengthIn35mmFilm", "FocalPlaneXResolution", "FocalPlaneResolutionUnit", "PixelXDimension"]
        ),
        st.one_of(PIECES, st.floats().map(lambda v: f"({v})")),
    ),
    xmp=st.text(max_size=60).map(lambda text: f'drone-dji:GimbalYawDegree="{text}" drone-dji:GpsLatitude="{text}"'),
)  # fmt: skip
def test_tags_of_photos(exif: dict[str, str], xmp: str) -> None:
    facts = photo_facts(PhotoTags(exif, xmp), (40, 30))
    assert facts.focal is None or math.isfinite(facts.focal)
    assert facts.position is None or (abs(facts.position[0]) <= 180 and abs(facts.position[1]) <= 90)


BOMB = '<!DOCTYPE d [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'


@pytest.mark.parametrize("kind", ["Metashape XML", "IGN"])
@pytest.mark.parametrize("bomb", [BOMB, '<!DOCTYPE d SYSTEM "file:///etc/hostname">', "<a>" * 5000])
def test_xml_entities_are_refused(kind: str, bomb: str) -> None:
    error = outcome(kind, (bomb + KINDS[kind][1]).encode())
    assert error is not None
    assert "document type" in error.what or "nested" in error.what
