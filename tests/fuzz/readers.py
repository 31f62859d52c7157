"""Readers of every kind of file, each with a small sound file, and the outcome of reading a damaged one."""

from __future__ import annotations

import bz2
import io
import json
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from helpers import PinholeOverMap
from refined_rig import Agile
from rpc_rig import digital_globe, ossim, rpb, rpc_txt
from rpc_rig import dimap as rpc_dimap
from sar_annotation_rig import calibration, noise, published, terrasar
from sar_rig import Scene as RadarScene
from spot_rig import Satellite

from geomosaic.accuracy.product_check import read_target
from geomosaic.block import OrientedImage
from geomosaic.control.read import read_control_file as read_image_control
from geomosaic.control.table import has_positions, read_positions
from geomosaic.developed.surface_file import read_surface
from geomosaic.errors import GeomosaicError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.pixel_axes import PixelAxes
from geomosaic.inputs.control_points import read_block, read_control
from geomosaic.inputs.correction_grids import read_corrections
from geomosaic.inputs.declarations import Block, read_camera
from geomosaic.inputs.exterior_orientation import read_exterior
from geomosaic.inputs.images import Photo, with_usable
from geomosaic.inputs.orientation_listing import read_listing
from geomosaic.inputs.tables import read_fiducials
from geomosaic.interchange.asp import match_bytes, read_adjustment
from geomosaic.interchange.colmap import CameraRecord, ImageRecord, PointRecords, SparseModel
from geomosaic.interchange.colmap_binary import bytes_of
from geomosaic.interchange.files import program_of
from geomosaic.interchange.files import read_text as file_text
from geomosaic.interchange.formats import read_reconstruction
from geomosaic.jobs.engine import status
from geomosaic.jobs.step import Job, Step
from geomosaic.monoplotting.places import read_pixels
from geomosaic.mosaicking.result_cache import ResultCache, encode
from geomosaic.options.inputs import ListingLayout
from geomosaic.options.sheet import SheetOptions
from geomosaic.options.terrain import DtmOptions
from geomosaic.products.edges import read_common
from geomosaic.project.load import load_project
from geomosaic.radiometry.corrections import ToneCurve
from geomosaic.raster.environment import environment
from geomosaic.raster.image_metadata import read_photo_tags, read_rpc_tags
from geomosaic.raster.info import inspect, open_raster
from geomosaic.raster.vector import read_layer
from geomosaic.relief.terrain_data import read_terrain
from geomosaic.rpc.refine import read_ties
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sheets.inputs import foreign_style, read_layout, sheet_inputs
from geomosaic.sheets.svg import read_svg
from geomosaic_pushbroom.metadata import read_bytes
from geomosaic_rpc.build import read_rpc_bytes
from geomosaic_sar.metadata import read_bytes as read_radar_bytes
from geomosaic_sar.sentinel1_calibration import read_calibration_bytes, read_noise_bytes

MAP = with_heights(parse_crs("EPSG:32633"), "ellipsoidal")
SPOTS = "#CRS: EPSG:32633\nid,x,y,z\ntop,500100,5000200,312.5\nsaddle,500300.5,5000150,287\n"
MATRIX = "1 0 0 0 1 0 0 0 1"


def frame(system: str, **options: Any) -> Callable[[Path], object]:
    def read(path: Path) -> object:
        row = {"system": system, "reconstruction": path.name}
        request = SensorRequest("a.jpg", (40, 30), {"orientation": row, **options}, MAP, str(path.parent))
        return registry.build("frame", request)

    return read


def printed(path: Path) -> object:
    columns = ("image", "x", "y", "z", "omega", "phi", "kappa")
    return read_listing(path, ListingLayout(columns, "right up", ("phi", "omega", "kappa")), "gon", None)


def track(path: Path) -> object:
    options = {"track": path.name, "focal_length_px": 900.0, "columns": "left", "start_time": 1.0, "line_period": 0.01}
    return registry.build("pushbroom", SensorRequest("a", (40, 30), options, MAP, str(path.parent)))


def strip(path: Path) -> object:
    """The track of an across-track scanner: another table."""
    options = {"kind": "scanner", "field_of_view": 60.0, "track": path.name, "start_time": 1.0, "period": 0.01}
    return registry.build("panoramic", SensorRequest("a", (40, 30), options, MAP, str(path.parent)))


def bar(path: Path) -> object:
    return registry.build("panoramic", SensorRequest("a", (40, 30), {"optical_bar": path.name}, None, str(path.parent)))


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


def interior(path: Path) -> object:
    options = {
        "camera": path.name,
        "position": [500000.0, 5500000.0, 900.0],
        "orientation": {"system": "opk", "omega": 0.0, "phi": 0.0, "kappa": 0.0},
    }
    return registry.build("frame", SensorRequest("a.jpg", (40, 30), options, MAP, str(path.parent)))


IMAGES = "# list\n1 0.0 1.0 0.0 0.0 -500000.0 5500000.0 900.0 1 a.jpg\n\n"
SHOT = (
    '[{"cameras": {"c": {"projection_type": "brown", "width": 40, "height": 30, "focal_x": 0.9, "focal_y": 0.9, '
    '"c_x": 0.0, "c_y": 0.0, "k1": 0.01}}, "shots": {"a.jpg": {"rotation": [3.14, 0.0, 0.0], "translation": '
    '[1.0, 2.0, 50.0], "camera": "c"}}, "reference_lla": {"latitude": 52.0, "longitude": 15.0, "altitude": 10.0}}]'
)
ORTHORITY = (
    "A camera:\n    type: brown\n    im_size: [40, 30]\n    focal_len: 0.9  # unitless\n    cx: 0.01\n    k1: -0.1\n"
)
TSAI = (
    "VERSION_4\nPINHOLE\nfu = 40\nfv = 40\ncu = 20\ncv = 15\nu_direction = 1 0 0\nC = 4000000 1000000 4900000\n"
    "R = 0 0 -1 1 0 0 0 -1 0\npitch = 1\nPhotometrix\nxp = 0.1\nyp = 0\nk1 = 1e-6\nk2 = 0\nk3 = 0\np1 = 0\np2 = 0\n"
)
PIX4D = (
    "camera model m = K [R|-Rt] X\n\na.jpg 40 30\n40 0 20\n0 40 15\n0 0 1\n0.01 0 0\n0 0\n"
    "500000 5500000 900\n1 0 0\n0 -1 0\n0 0 -1\n"
)
BAR = (
    "VERSION_4\nOPTICAL_BAR\nimage_size = 40 30\nimage_center = 20 15\npitch = 7e-6\nf = 0.61\nscan_time = 0.5\n"
    "forward_tilt = 0.26\niC = 4000000 1000000 4900000\niR = 0 0 -1 1 0 0 0 -1 0\nspeed = 7700\n"
    "mean_earth_radius = 6371000\nmean_surface_elevation = 400\nmotion_compensation_factor = 0.9\nscan_dir = right\n"
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


def positions(path: Path) -> object:
    return read_exterior(path, "opk")


def places(path: Path) -> object:
    return read_positions(path, crs="EPSG:32633") if has_positions(path) else None


def usable(path: Path) -> object:
    scene = OrientedImage("a.jpg", "a.jpg", "test", PinholeOverMap(size=(40, 30)))
    return with_usable(Block((Path("a.jpg"),), "frame", usable=path), [scene])


def fitted(path: Path) -> object:
    """A cylinder through points of a table."""
    surface = path.with_name("surface.toml")
    surface.write_text(f'kind = "cylinder"\npoints = "{path.name}"\nbottom = 0.0\ntop = 9.0\n')
    return read_surface(surface)


ON_A_CYLINDER = "id,x,y,z\n" + "".join(f"{k},{3 * np.cos(k):.3f},{3 * np.sin(k):.3f},{k % 5}\n" for k in range(12))
RUNS = (
    '{"format": 1, "owned": ["a.tif"], "hashes": {"a.tif": [5, 7, "0f"]}, "records": {"orient": {"ingredients": '
    '{"code": "0f"}, "outputs": {"a.tif": "0f"}, "facts": {"n": 1}, "seconds": 0.5, "finished": "2020-01-01"}}}'
)


def runs(path: Path) -> object:
    """What is stale, by the record of earlier runs: one that is damaged counts as none."""
    output = path.with_name("a.tif")
    output.write_bytes(b"12345")
    return status(Job((Step("orient", len, {}, (), (output,)),), path.parent, path.parent))


KEPT = json.dumps({"a": encode((1.5, "b", frozenset("c"), ToneCurve([(np.arange(3.0), np.arange(3.0))])))})

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

# Name and content of a sound file, or a function that makes it, and what reads it.
READERS: dict[str, tuple[str, str | Callable[[], str | bytes], Callable[[Path], object]]] = {
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
    "common points": (
        "common.csv",
        "id,image,col,row,z\n1,a.jpg,1,2,5\n1,b.jpg,3,4,5\n",
        lambda path: read_common(path, ("a.jpg", "b.jpg")),
    ),
    "pixels to locate": (
        "p.csv",
        "id,col,row\na,1,2\nb,3.5,4\n",
        lambda path: read_pixels(path, PixelAxes(30), (40, 30)),
    ),
    "usable areas": ("usable.csv", "image,col,row\na.jpg,1,2\na.jpg,30,2\na.jpg,30,20\n", usable),
    "points on a surface": ("points.csv", ON_A_CYLINDER, fitted),
    "positions without a header": ("camera_pos_ori.txt", "a.jpg 500000 5500000 900 0.1 0.2 0.3\n", positions),
    "check points": ("c.csv", "id,x,y,measured_x,measured_y\na,1,2,1.1,2.1\nb,3,4,3.1,4.1\n", places),
    "projection": ("a.prj", parse_crs("EPSG:32633").to_wkt("WKT1_ESRI"), lambda path: parse_crs(str(path))),
    "record of runs": ("manifest.json", RUNS, runs),
    "kept results": ("balance.json", KEPT, lambda path: ResultCache(path.parent).table("balance")),
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
    "Ames pinhole": ("a.tsai", TSAI, frame("tsai")),
    "Ames optical bar": ("a.tsai", BAR, bar),
    "orthority": ("camera.yaml", ORTHORITY, interior),
    "Metashape text": ("opk.txt", TEXT, frame("metashape", camera=CAMERA)),
    "COLMAP images": ("images.txt", IMAGES, colmap),
    "COLMAP cameras": ("cameras.txt", "# list\n1 OPENCV 40 30 40 40 20 15 0.01 0 0 0\n", colmap),
}

BUNDLE = (
    "# Bundle file v0.3\n1 2\n40 0.1 -0.1\n1 0 0\n0 1 0\n0 0 1\n0 0 -9\n1.0 2.0 0\n255 0 9\n1 0 0 4.5 9.5\n"
    "0 0 1\n9 9 9\n0\n"
)
BAL = "1 2 2\n0 0 4.5 9.5\n0 1 -1.5 2.5\n0.1\n0\n0\n0\n0\n-9\n40\n0.1\n-0.1\n1\n2\n0\n0\n0\n1\n"
TRACKS = "OPENSFM_TRACKS_VERSION_v2\na.jpg\t7\t0\t0.1\t-0.2\t0.001\t9\t9\t9\t-1\t-1\n"
SURVEYED = (
    '{"points": [{"id": "a", "position": {"latitude": 52.0, "longitude": 15.0, "altitude": 9.0}, "observations": '
    '[{"shot_id": "a.jpg", "projection": [0.1, -0.2]}]}]}'
)
FEATURES = "# list\n1 0.0 1.0 0.0 0.0 -5.0 5.0 9.0 1 a.jpg\n4.5 5.5 7 6.5 7.5 -1\n"


def whole(path: Path) -> object:
    """A reconstruction, whichever of its files is the damaged one."""
    for name, text in (
        ("cameras.txt", "1 PINHOLE 40 30 40 40 20 15\n"),
        ("points3D.txt", "7 1.0 2.0 3.0 9 9 9 0.5 1 0\n"),
        ("images.txt", FEATURES),
        ("reconstruction.json", SHOT),
    ):
        if not path.with_name(name).exists():
            path.with_name(name).write_text(text)
    beside = (
        path.with_name("reconstruction.json") if path.name in ("tracks.csv", "ground_control_points.json") else path
    )
    return read_reconstruction(beside)


def model_bytes(name: str) -> Callable[[], bytes]:
    """Bytes of a file of a binary model of COLMAP."""

    def make() -> bytes:
        camera, points = (
            CameraRecord("1", "PINHOLE", (40, 30), (40.0, 40.0, 20.0, 15.0)),
            PointRecords(np.array([7]), np.ones((1, 3)), np.ones((1, 3), np.uint8)),
        )
        image = ImageRecord("1", np.array([1.0, 0, 0, 0]), np.ones(3), "1", "a.jpg", np.ones((2, 2)), np.array([7, -1]))
        return bytes_of(SparseModel([camera], [image], points))[name]

    return make


def binary(path: Path) -> object:
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        if not path.with_name(name).exists():
            path.with_name(name).write_bytes(model_bytes(name)())
    return read_reconstruction(path.parent, "colmap")


READERS |= {
    "COLMAP features": ("images.txt", FEATURES, whole),
    "COLMAP points": ("points3D.txt", "7 1.0 2.0 3.0 9 9 9 0.5 1 0\n", whole),
    "COLMAP binary cameras": ("cameras.bin", model_bytes("cameras.bin"), binary),
    "COLMAP binary images": ("images.bin", model_bytes("images.bin"), binary),
    "COLMAP binary points": ("points3D.bin", model_bytes("points3D.bin"), binary),
    "OpenSfM tracks": ("tracks.csv", TRACKS, whole),
    "OpenSfM control": ("ground_control_points.json", SURVEYED, whole),
    "Bundler": ("bundle.out", BUNDLE, read_reconstruction),
    "BAL": ("a.txt", BAL, lambda path: read_reconstruction(path, "bal")),
    "packed BAL": ("a.bz2", lambda: bz2.compress(BAL.encode()), read_reconstruction),
    "ASP matches": ("a__b.match", lambda: match_bytes(np.ones((2, 2)), np.ones((2, 2))), read_reconstruction),
    "ASP adjustment": (
        "a.adjust",
        "1 2 3\n1 0 0 0\n",
        lambda path: read_adjustment(file_text(path, path.name), path.name),
    ),
}

SYMBOL = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 24 24"><g transform="rotate(9 12 12) scale(.9)" stroke="red">'
    '<path d="M2 2 9.5-3h4v2C1 2 3 4 5 6s1 2 3 4Q1 1 2 2t4 4a5 3 20 01 4 4z" fill-rule="evenodd" style="fill:#0af"/>'
    '<rect x="1" y="2" width="6" height="5" rx="1"/><circle cx="12" cy="12" r="3" fill="param(outline)"/>'
    '<polygon points="1,1 5,2 3,8" opacity=".5"/></g></svg>'
)
QML = (
    '<qgis version="3.34" labelsEnabled="1"><renderer-v2 type="graduatedSymbol" attr="v"><ranges><range lower="1.5" '
    'upper="9" symbol="0" label="a"/></ranges><symbols><symbol name="0" alpha="0.5"><layer class="SimpleFill"><prop '
    'k="color" v="10,20,30,255"/><prop k="outline_width" v="0.4"/><prop k="offset" v="0,0"/></layer></symbol></symbols>'
    '</renderer-v2><labeling type="simple"><settings><text-style fieldName="name" fontSize="9" textColor="1,2,3,255">'
    '<text-buffer bufferDraw="1" bufferSize="1.5"/></text-style></settings></labeling></qgis>'
)
SLD = (
    '<StyledLayerDescriptor version="1.0.0" xmlns="http://www.opengis.net/sld" xmlns:ogc="http://www.opengis.net/ogc">'
    "<NamedLayer><UserStyle><FeatureTypeStyle><Rule><Title>a</Title><ogc:Filter><ogc:PropertyIsLessThan>"
    "<ogc:PropertyName>v</ogc:PropertyName><ogc:Literal>5.5</ogc:Literal></ogc:PropertyIsLessThan></ogc:Filter>"
    '<LineSymbolizer><Stroke><CssParameter name="stroke">#102030</CssParameter><CssParameter name="stroke-width">2.5'
    '</CssParameter><CssParameter name="stroke-dasharray">4 2</CssParameter></Stroke></LineSymbolizer></Rule>'
    "</FeatureTypeStyle></UserStyle></NamedLayer></StyledLayerDescriptor>"
)
LAYOUT = (
    '[sheet]\npaper = "A4"\ndpi = 300\ntitle = "Hill"\nsubtitle = "of 1950"\n[map]\nscale = "1:5000"\n'
    "[contours]\ninterval = 2.5\n[grid]\ninterval = 100\n"
)
TARGET = "position_error = 0.5\northo_pixel = 0.1\n"
PLAN = (
    '{"requirements":[{"name":"ortho_pixel","least":null,"most":0.1,"unit":"m","source":"a"},{"name":"position_error",'
    '"least":null,"most":0.5,"unit":"m","source":"b"}]}'
)
REPORT = (
    '{"type":"Feature","stac_version":"1.0.0","properties":{"datetime":"2020-01-01T00:00:00Z"},"mosaic":{"colour":"g"},'
    '"orient":{"sigma":0.5},"check":{},"outputs":[{"path":"a.tif","bytes":1}],"assets":{"data":{"href":"a.tif"}}}'
)
SQUARE = "[[[500000,5500000],[500010,5500000],[500010,5500010],[500000,5500000]]]"
GEOJSON = (
    '{"type":"FeatureCollection","crs":{"type":"name","properties":{"name":"urn:ogc:def:crs:EPSG::32633"}},"features":['
    f'{{"type":"Feature","properties":{{"v":1.5}},"geometry":{{"type":"Polygon","coordinates":{SQUARE}}}}}]}}'
)
WORLD = "0.5\n0.0\n0.0\n-0.5\n500000.25\n5500000.25\n"


def raster(path: Path) -> object:
    """Metadata of all sorts, and the pixels."""
    found = inspect(path)
    read_photo_tags(path)
    read_rpc_tags(path)
    with environment(), open_raster(path) as dataset:
        dataset.gcps  # noqa: B018
    return found


def world(path: Path) -> object:
    """A world file as control, and as the georeference of an image beside it."""
    path.with_suffix(".jpg").write_bytes(picture())
    inspect(path.with_suffix(".jpg"))
    return read_image_control(path, size=(40, 30), crs="EPSG:32633")


def sidecar(path: Path) -> object:
    path.with_suffix("").with_suffix("").with_suffix(".jpg").write_bytes(picture())
    return raster(path.with_suffix("").with_suffix("").with_suffix(".jpg"))


def virtual(path: Path) -> object:
    path.with_name("a.jpg").write_bytes(picture())
    return raster(path)


def records(path: Path) -> object:
    """Report and STAC item beside a raster; as they are, or asked for."""
    raster = path.with_name("a.tif")
    raster.write_bytes(tiff())
    sheet_inputs(raster, SheetOptions(scale=1000.0))
    return sheet_inputs(raster, SheetOptions(scale=1000.0, report=path)) if path.name == "report.json" else None


def style(path: Path) -> object:
    return foreign_style(path.read_text(encoding="utf-8", errors="replace"), path.name)


def symbol(path: Path) -> object:
    return read_svg(path.read_text(encoding="utf-8", errors="replace"), path.name)


@cache
def picture() -> bytes:
    from PIL import Image

    held = io.BytesIO()
    Image.new("L", (40, 30), 7).save(held, "JPEG")
    return held.getvalue()


@cache
def tiff() -> bytes:
    """GeoTIFF with a CRS, statistics, colours and RPC."""
    import rasterio
    from rasterio.io import MemoryFile

    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=40, height=30, count=1, dtype="uint8", crs="EPSG:32633",
            transform=rasterio.Affine(0.5, 0, 500000, 0, -0.5, 5500000), nodata=0,
        ) as target:  # fmt: skip
            target.write(np.ones((1, 30, 40), np.uint8))
            target.update_tags(TIFFTAG_DATETIME="2020:01:01 00:00:00")
            target.set_band_description(1, "grey")
        return bytes(memory.read())


@cache
def package() -> bytes:
    """GeoPackage with one area."""
    import shapely

    from geomosaic.raster.vector import Layer, write_layers

    with tempfile.TemporaryDirectory() as folder:
        area = shapely.box(500000, 5500000, 500010, 5500010)
        layer = Layer(parse_crs("EPSG:32633"), "Polygon", [area], {"v": [1.5], "name": ["a"]})
        return write_layers(Path(folder) / "a.gpkg", {"areas": layer}).read_bytes()


VRT = (
    '<VRTDataset rasterXSize="40" rasterYSize="30"><SRS>EPSG:32633</SRS><GeoTransform>500000, 0.5, 0, 5500000, 0, -0.5'
    '</GeoTransform><VRTRasterBand dataType="Byte" band="1"><NoDataValue>0</NoDataValue><SimpleSource><SourceFilename '
    'relativeToVRT="1">a.jpg</SourceFilename><SourceBand>1</SourceBand><SrcRect xOff="0" yOff="0" xSize="40" ySize="30"'
    '/><DstRect xOff="0" yOff="0" xSize="40" ySize="30"/></SimpleSource></VRTRasterBand></VRTDataset>'
)
PAM = (
    "<PAMDataset><SRS>EPSG:32633</SRS><GeoTransform>500000, 0.5, 0, 5500000, 0, -0.5</GeoTransform><Metadata "
    'domain="RPC"><MDI key="LINE_OFF">15</MDI></Metadata><GCPList Projection="EPSG:32633"><GCP Id="1" Pixel="0.5" '
    'Line="0.5" X="500000" Y="5500000"/></GCPList></PAMDataset>'
)


def of_bytes(read: Callable[[bytes, str], object]) -> Callable[[Path], object]:
    return lambda path: read(path.read_bytes(), path.name)


def scene(path: Path) -> object:
    return read_bytes(path.read_bytes(), path.name)


# Calibration of radar.
LINES, PIXELS = np.array([0.0, 30.0, 60.0]), np.array([0.0, 40.0, 79.0])
TABLE = np.array([[250.0, 260.0, 270.0]] * 3)
NOISE_PARTS = [((0, 0, 60, 40), np.array([0.0, 60.0]), np.array([1.0, 1.2]))]
CALIBRATED = {"calibration": {"quantity": "beta0", "factor": [1e-5, 2e-5], "columns": [0, 79], "noise": 30.0}}

READERS |= {
    "RPC text": ("a_RPC.TXT", rpc_txt, of_bytes(read_rpc_bytes)),
    "RPB": ("a.RPB", rpb, of_bytes(read_rpc_bytes)),
    "OSSIM RPC": ("a.geom", ossim, of_bytes(read_rpc_bytes)),
    "DIMAP RPC": ("RPC_a.XML", rpc_dimap, of_bytes(read_rpc_bytes)),
    "DigitalGlobe RPC": ("a.XML", digital_globe, of_bytes(read_rpc_bytes)),
    "SPOT DIMAP": ("METADATA.DIM", lambda: Satellite().dimap(), scene),
    "OSSIM scene": ("a.geom", lambda: Satellite().keyword_list(), scene),
    "DIMAP 2": ("DIM_a.XML", lambda: Agile().refined(table=True), scene),
    "Sentinel-1": ("a.xml", lambda: published().xml(), of_bytes(read_radar_bytes)),
    "TerraSAR-X": ("a.xml", lambda: terrasar(RadarScene(), "MGD", factors={"HH": 1e-5}), of_bytes(read_radar_bytes)),
    "radar table": ("a.radar.json", lambda: json.dumps(RadarScene().table() | CALIBRATED), of_bytes(read_radar_bytes)),
    "radar table, ground range": (
        "a.radar.json",
        lambda: json.dumps(RadarScene().ground_table()[0]),
        of_bytes(read_radar_bytes),
    ),
    "Sentinel-1 calibration": (
        "calibration-a.xml",
        lambda: calibration(LINES, PIXELS, {"sigmaNought": TABLE, "betaNought": TABLE, "gamma": TABLE}),
        of_bytes(lambda data, where: read_calibration_bytes(data, where, "sigma0")),
    ),
    "Sentinel-1 noise": ("noise-a.xml", lambda: noise(LINES, PIXELS, TABLE, NOISE_PARTS), of_bytes(read_noise_bytes)),
    "Sentinel-1 noise, old": ("noise-a.xml", lambda: noise(LINES, PIXELS, TABLE), of_bytes(read_noise_bytes)),
    "WorldView": ("a.XML", lambda: Agile().basic(0.5), scene),
    "QML": ("a.qml", lambda: QML, style),
    "SLD": ("a.sld", lambda: SLD, style),
    "SVG": ("a.svg", lambda: SYMBOL, symbol),
    "accuracy": ("a.toml", lambda: TARGET, read_target),
    "plan": ("plan.json", lambda: PLAN, read_target),
    "report": ("report.json", lambda: REPORT, records),
    "STAC item": ("a.stac.json", lambda: REPORT, records),
    "layout": ("a.toml", lambda: LAYOUT, read_layout),
    "GeoJSON": ("a.geojson", lambda: GEOJSON, read_layer),
    "GeoPackage": ("a.gpkg", package, read_layer),
    "world file": ("a.jgw", lambda: WORLD, world),
    "spot heights": ("a.csv", lambda: SPOTS, lambda path: read_terrain(DtmOptions(points=path, crs="EPSG:32633"))),
    "GeoTIFF": ("a.tif", tiff, raster),
    "PAM": ("a.jpg.aux.xml", lambda: PAM, sidecar),
    "VRT": ("a.vrt", lambda: VRT, virtual),
    "JPEG": ("a.jpg", picture, raster),
}


def sound(kind: str) -> tuple[str, bytes]:
    """Name and bytes of the sound file of a kind."""
    name, given, _ = READERS[kind]
    made = given() if callable(given) else given
    return name, made.encode() if isinstance(made, str) else made


@contextmanager
def file_of(name: str, data: bytes) -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        yield path


def outcome(kind: str, data: bytes) -> GeomosaicError | None:
    """What is said of a file; None where it can be read."""
    name, _, read = READERS[kind]
    with file_of(name, data) as path, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            program_of(path)
            read(path)
        except GeomosaicError as error:
            return error
    return None
