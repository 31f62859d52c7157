"""Orientations of other programs: files written here by their published formulas give the same pixels."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import CRS, Transformer

from geomosaic.errors import GeomosaicWarning, HeightDatumError, InputError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.interchange.formats import read_reconstruction, write_reconstruction
from geomosaic.sensor import registry
from geomosaic.sensor.inputs import parse_yaml
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.types import FloatArray
from geomosaic_frame.other_programs import orthority_table

SIZE = (4000, 3000)
MAP = with_heights(parse_crs("EPSG:32633"), "ellipsoidal")
LON, LAT = 15.2, 52.1
GEO = CRS.from_epsg(4979)
ECEF = CRS.from_epsg(4978)
CLOSE = 1e-6

# Two cameras: name, position and omega, phi, kappa in some right-handed axes x east, y north, z up, metres.
POSES = {
    "one.jpg": ([120.0, -80.0, 900.0], (4.0, -7.0, 130.0)),
    "two.jpg": ([260.0, -60.0, 880.0], (-28.0, 3.0, -40.0)),
}


def to_camera(angles: tuple[float, float, float]) -> FloatArray:
    """World → camera with x right, y down, z forward, from R = Rx(ω)·Ry(φ)·Rz(κ), camera → world, y up (textbooks)."""
    w, p, k = map(math.radians, angles)
    rx = np.array([[1, 0, 0], [0, math.cos(w), -math.sin(w)], [0, math.sin(w), math.cos(w)]])
    ry = np.array([[math.cos(p), 0, math.sin(p)], [0, 1, 0], [-math.sin(p), 0, math.cos(p)]])
    rz = np.array([[math.cos(k), -math.sin(k), 0], [math.sin(k), math.cos(k), 0], [0, 0, 1]])
    return np.diag([1.0, -1.0, -1.0]) @ (rx @ ry @ rz).T


def ground(name: str) -> FloatArray:
    """Places in front of a camera, in the same axes: rays through a lattice of directions, at several depths."""
    position, angles = POSES[name]
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(-0.6, 0.6, 7), np.linspace(-0.45, 0.45, 7)))
    depth = np.linspace(700.0, 1100.0, len(x))
    camera = np.column_stack([x, y, np.ones_like(x)]) * depth[:, None]
    return camera @ to_camera(angles) + np.array(position)


def seen(name: str, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """x = X/Z, y = Y/Z of places in camera axes, y down."""
    position, angles = POSES[name]
    c = (xyz - np.array(position)) @ to_camera(angles).T
    return c[:, 0] / c[:, 2], c[:, 1] / c[:, 2]


def opencv(x: FloatArray, y: FloatArray, k: tuple[float, ...], p1: float, p2: float) -> tuple[FloatArray, FloatArray]:
    r2 = x * x + y * y
    radial = 1 + sum(c * r2 ** (i + 1) for i, c in enumerate(k))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def build(file: Path, system: str, name: str, crs: CRS | None, **options: Any) -> SensorModel:
    row = {"system": system, "reconstruction": file.name}
    return registry.build("frame", SensorRequest(name, SIZE, {"orientation": row, **options}, crs, str(file.parent)))


def enu() -> tuple[FloatArray, FloatArray]:
    """Origin of east, north, up at (LON, LAT, 100 m) and its axes as rows, geocentric, written out."""
    lon, lat = math.radians(LON), math.radians(LAT)
    origin = np.array(Transformer.from_crs(4979, 4978, always_xy=True).transform(LON, LAT, 100.0))
    east = [-math.sin(lon), math.cos(lon), 0]
    up = [math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)]
    return origin, np.array([east, np.cross(up, east), up])


# --- COLMAP -----------------------------------------------------------------------------------------------------------

F, FX, FY, CX, CY = 3100.0, 3100.0, 3104.0, 2011.5, 1490.25


def theta(x: FloatArray, y: FloatArray, k: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    r = np.hypot(x, y)
    t = np.arctan(r)
    scale = t * (1 + sum(c * t ** (2 * i + 2) for i, c in enumerate(k))) / r
    return x * scale, y * scale


COLMAP: dict[str, tuple[str, Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]]] = {
    "SIMPLE_PINHOLE": (f"{F} {CX} {CY}", lambda x, y: (F * x + CX, F * y + CY)),
    "PINHOLE": (f"{FX} {FY} {CX} {CY}", lambda x, y: (FX * x + CX, FY * y + CY)),
    "SIMPLE_RADIAL": (
        f"{F} {CX} {CY} -0.05",
        lambda x, y: (F * x * (1 - 0.05 * (x * x + y * y)) + CX, F * y * (1 - 0.05 * (x * x + y * y)) + CY),
    ),
    "RADIAL": (
        f"{F} {CX} {CY} -0.05 0.02",
        lambda x, y: tuple(F * v + c for v, c in zip(opencv(x, y, (-0.05, 0.02), 0, 0), (CX, CY), strict=True)),
    ),
    "OPENCV": (
        f"{FX} {FY} {CX} {CY} -0.05 0.02 0.001 -0.002",
        lambda x, y: tuple(
            f * v + c for f, v, c in zip((FX, FY), opencv(x, y, (-0.05, 0.02), 0.001, -0.002), (CX, CY), strict=True)
        ),
    ),
    "OPENCV_FISHEYE": (
        f"{FX} {FY} {CX} {CY} -0.01 0.003 -0.001 0.0005",
        lambda x, y: tuple(
            f * v + c for f, v, c in zip((FX, FY), theta(x, y, (-0.01, 0.003, -0.001, 0.0005)), (CX, CY), strict=True)
        ),
    ),
}


def quaternion(m: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(m).as_quat()
    return np.array([w, x, y, z])


def write_colmap(
    folder: Path, kind: str, world: Callable[[FloatArray], FloatArray], axes: FloatArray, gap: str = ""
) -> Path:
    """`axes` rows are the axes of the poses in the world."""
    (folder / "cameras.txt").write_text(f"# Camera list\n7 {kind} {SIZE[0]} {SIZE[1]} {COLMAP[kind][0]}\n")
    lines = [
        "# Image list with two lines of data per image:",
        "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
    ]
    for number, (name, (position, angles)) in enumerate(POSES.items(), 3):
        rotation = to_camera(angles) @ axes
        t = -rotation @ world(np.array(position))
        values = " ".join(repr(float(v)) for v in (*quaternion(rotation), *t))
        lines += [f"{number} {values} 7 flight 1/{name}", gap]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    return folder / "images.txt"


@pytest.mark.parametrize("kind", COLMAP)
@pytest.mark.parametrize("world", ["local", "geocentric", "map"])
def test_a_colmap_reconstruction_is_read(tmp_path: Path, kind: str, world: str) -> None:
    origin, axes = enu()
    corner = np.array([512345.0, 5771000.0, 0.0])
    to_world: dict[str, Callable[[FloatArray], FloatArray]] = {
        "local": lambda p: p,
        "geocentric": lambda p: p @ axes + origin,
        "map": lambda p: p + corner,
    }
    file = write_colmap(
        tmp_path,
        kind,
        to_world[world],
        axes if world == "geocentric" else np.eye(3),
        "" if world == "local" else "1 2 3",
    )
    options: dict[str, Any] = {"world": world}
    if world == "local":
        options["reference"] = [LON, LAT, 100.0]
    if world == "map":
        options["treatment"] = "planar"
    crs = {"local": None, "geocentric": ECEF, "map": MAP}[world]
    for name in POSES:
        model = build(file, "colmap", name, crs, **options)
        xyz = ground(name)
        places = to_world["geocentric" if world == "local" else world](xyz)
        expected = np.column_stack(COLMAP[kind][1](*seen(name, xyz)))
        assert np.abs(model.ground_to_image(places) - expected).max() < CLOSE
        assert ((expected > 0) & (expected < SIZE)).all(axis=1).mean() > 0.6


def test_colmap_in_map_coordinates_less_an_offset(tmp_path: Path) -> None:
    file = write_colmap(tmp_path, "PINHOLE", lambda p: p, np.eye(3))
    corner = [512345.0, 5771000.0, 0.0]
    model = build(file, "colmap", "one.jpg", MAP, world="map", offset=corner, treatment="planar")
    xyz = ground("one.jpg")
    expected = np.column_stack(COLMAP["PINHOLE"][1](*seen("one.jpg", xyz)))
    assert np.abs(model.ground_to_image(xyz + np.array(corner)) - expected).max() < CLOSE


def test_colmap_needs_a_declared_world(tmp_path: Path) -> None:
    file = write_colmap(tmp_path, "PINHOLE", lambda p: p, np.eye(3))
    with pytest.raises(InputError, match="do not say what their world is"):
        build(file, "colmap", "one.jpg", MAP)
    with pytest.raises(InputError, match="'reference' is missing"):
        build(file, "colmap", "one.jpg", MAP, world="local")
    with pytest.raises(InputError, match="km from the centre of the Earth"):
        build(file, "colmap", "one.jpg", ECEF, world="geocentric")
    with pytest.raises(HeightDatumError, match="vertical datum"):
        build(file, "colmap", "one.jpg", CRS.from_epsg(32633), world="map")
    with pytest.raises(InputError, match=r"no image named 'three\.jpg'"):
        build(file, "colmap", "three.jpg", MAP, world="map")


# --- Pix4D ------------------------------------------------------------------------------------------------------------

R123, T12 = (0.0383, -0.0175, 0.0205), (0.0024, -0.0029)
PIX4D_HEADER = (
    "fileName imageWidth imageHeight \ncamera matrix K [3x3]\nradial distortion [3x1]\ntangential distortion [2x1]\n"
    "camera position t [3x1]\ncamera rotation R [3x3]\ncamera model m = K [R|-Rt] X\n\n"
)


def write_pix4d(folder: Path) -> Path:
    lines = []
    for name, (position, angles) in POSES.items():
        rows = [[F, 0, CX], [0, F, CY], [0, 0, 1], R123, T12, position, *to_camera(angles)]
        lines += [f"{name} {SIZE[0]} {SIZE[1]}", *(" ".join(repr(float(v)) for v in row) for row in rows)]
    path = folder / "flight_calibrated_camera_parameters.txt"
    path.write_text(PIX4D_HEADER + "\n".join(lines) + "\n")
    (folder / "flight_offset.xyz").write_text("512345.000 5771000.000 0.000")
    return path


def test_a_model_of_pix4d_is_the_camera_it_describes(tmp_path: Path) -> None:
    file = write_pix4d(tmp_path)
    corner = np.array([512345.0, 5771000.0, 0.0])
    for name in POSES:
        model = build(file, "pix4d", name, MAP, treatment="planar")
        xyz = ground(name)
        u, v = opencv(*seen(name, xyz), R123, *T12)
        assert np.abs(model.ground_to_image(xyz + corner) - np.column_stack([F * u + CX, F * v + CY])).max() < CLOSE


def test_pix4d_without_its_offset_is_reported(tmp_path: Path) -> None:
    file = write_pix4d(tmp_path)
    (tmp_path / "flight_offset.xyz").unlink()
    with pytest.warns(GeomosaicWarning, match="no PROJECT_offset.xyz beside it"):
        build(file, "pix4d", "one.jpg", MAP, treatment="planar")


def test_a_binary_colmap_reconstruction_is_the_same_as_its_text(tmp_path: Path) -> None:
    write_colmap(tmp_path, "OPENCV", lambda p: p + np.array([512345.0, 5771000.0, 0.0]), np.eye(3), "1 2 3")
    write_reconstruction(read_reconstruction(tmp_path, "colmap"), tmp_path, "colmap")
    for name in POSES:
        text, binary = (build(tmp_path / f"images{end}", "colmap", name, MAP, world="map") for end in (".txt", ".bin"))
        assert np.abs(text.ground_to_image(ground(name)) - binary.ground_to_image(ground(name))).max() < CLOSE


def test_a_damaged_binary_colmap_reconstruction_is_reported(tmp_path: Path) -> None:
    (tmp_path / "cameras.bin").write_bytes(b"\0" * 8)
    (tmp_path / "images.bin").write_bytes(b"\0\1")
    with pytest.raises(InputError, match="the file ends") as caught:
        build(tmp_path / "images.bin", "colmap", "one.jpg", MAP, world="map")
    assert "images.bin, byte 0" in str(caught.value.where)


def test_pix4d_projection_matrices(tmp_path: Path) -> None:
    """P = K [R | −R·t] of any scale and sign, with a shear: the pixels are those of the product."""
    corner = np.array([512345.0, 5771000.0, 0.0])
    k = np.array([[F, 1.25, CX], [0.0, 1.01 * F, CY], [0.0, 0.0, 1.0]])
    matrices = {}
    for scale, (name, (position, angles)) in zip((1.0, -0.003), POSES.items(), strict=False):
        turn = np.array(to_camera(angles))
        matrices[name] = scale * k @ np.column_stack([turn, -turn @ np.array(position)])
    lines = [f"{name} {' '.join(repr(float(v)) for v in p.ravel())}" for name, p in matrices.items()]
    file = tmp_path / "flight_pmatrix.txt"
    file.write_text("\n".join(lines) + "\n")
    (tmp_path / "flight_offset.xyz").write_text("512345.000 5771000.000 0.000")
    for name, p in matrices.items():
        with pytest.warns(GeomosaicWarning, match="freed of distortion"):
            model = build(file, "pix4d", name, MAP, treatment="planar")
        xyz = ground(name)
        u, v, w = p @ np.column_stack([xyz, np.ones(len(xyz))]).T
        assert np.abs(model.ground_to_image(xyz + corner) - np.column_stack([u / w, v / w])).max() < CLOSE
    for text, words in ((lines[0].rpartition(" ")[0], "not 12 finite numbers"), (f"a.jpg {'0 ' * 12}", "singular")):
        file.write_text(text)
        with pytest.warns(GeomosaicWarning), pytest.raises(InputError, match=words):
            build(file, "pix4d", "one.jpg", MAP, treatment="planar")


# --- Metashape --------------------------------------------------------------------------------------------------------

CAL = {
    "f": 3100.0, "cx": 11.5, "cy": -9.75, "b1": 2.5, "b2": -1.25, "k1": -0.05, "k2": 0.02, "k3": -0.004, "k4": 0.001,
    "p1": 0.0011, "p2": -0.0007,
}  # fmt: skip


def appendix(x: FloatArray, y: FloatArray, kind: str) -> FloatArray:
    """The manual's formulas, in its own letters."""
    c = CAL if kind == "frame" else {**CAL, "p1": 0.0, "p2": 0.0}
    if kind == "fisheye":
        r0 = np.hypot(x, y)
        x, y = x * np.arctan(r0) / r0, y * np.arctan(r0) / r0
    r2 = x * x + y * y
    radial = 1 + c["k1"] * r2 + c["k2"] * r2**2 + c["k3"] * r2**3 + c["k4"] * r2**4
    x1 = x * radial + c["p1"] * (r2 + 2 * x * x) + 2 * c["p2"] * x * y
    y1 = y * radial + c["p2"] * (r2 + 2 * y * y) + 2 * c["p1"] * x * y
    u = SIZE[0] * 0.5 + c["cx"] + x1 * c["f"] + x1 * c["b1"] + y1 * c["b2"]
    return np.column_stack([u, SIZE[1] * 0.5 + c["cy"] + y1 * c["f"]])


def spaced(values: Any) -> str:
    return " ".join(repr(float(v)) for v in np.ravel(values))


def write_metashape(folder: Path, kind: str = "frame", component: bool = True, wkt: str | None = None) -> Path:
    """Cameras in a chunk of its own scale and turn."""
    from scipy.spatial.transform import Rotation

    origin, axes = enu()
    if wkt is not None:
        origin, axes = np.zeros(3), np.eye(3)
    turn, scale = Rotation.from_euler("xyz", [20, -35, 110], degrees=True).as_matrix(), 37.5
    cameras = []
    for number, (name, (position, angles)) in enumerate(POSES.items()):
        to_world = axes.T @ to_camera(angles).T
        place = np.array(position) @ axes + origin
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn.T @ to_world, turn.T @ (place - (origin + 50.0)) / scale
        part = ' component_id="4"' if component else ""
        label = name.removesuffix(".jpg")
        head = f'<camera id="{number}" sensor_id="2"{part} label="{label}">'
        cameras.append(f"{head}<transform>{spaced(matrix)}</transform></camera>")
    transform = (
        f"<transform><rotation>{spaced(turn)}</rotation><translation>{spaced(origin + 50.0)}</translation>"
        f"<scale>{scale}</scale></transform>"
    )
    cal = {**CAL, **({} if kind == "frame" else {"p1": 0.0, "p2": 0.0})}
    values = "".join(f"<{key}>{value!r}</{key}>" for key, value in cal.items() if value)
    (folder / "cameras.xml").write_text(
        '<?xml version="1.0" encoding="UTF-8"?><document version="2.0.0"><chunk label="Chunk 1" enabled="true">'
        f'<sensors next_id="3"><sensor id="2" label="lens" type="{kind}"><resolution width="4000" height="3000"/>'
        f'<calibration type="{kind}" class="adjusted"><resolution width="4000" height="3000"/>{values}</calibration>'
        "</sensor></sensors>"
        + (f'<components><component id="4">{transform}</component></components>' if component else "")
        + f'<cameras><group id="0" label="strip">{cameras[0]}</group>{cameras[1]}'
        '<camera id="9" sensor_id="2" label="not aligned"/></cameras>'
        + ("" if component else transform)
        + f"<reference>{CRS.from_epsg(4326).to_wkt('WKT1_GDAL') if wkt is None else wkt}</reference></chunk></document>"
    )
    return folder / "cameras.xml"


@pytest.mark.parametrize("kind", ["frame", "fisheye"])
@pytest.mark.parametrize("component", [True, False])
@pytest.mark.parametrize("crs", [None, MAP, with_heights(parse_crs("EPSG:32633"), "egm96"), parse_crs("EPSG:32633")])
def test_metashape_xml(tmp_path: Path, kind: str, component: bool, crs: CRS | None) -> None:
    file = write_metashape(tmp_path, kind, component)
    origin, axes = enu()
    for name in POSES:
        model = build(file, "metashape", name, crs)
        xyz = ground(name)
        expected = appendix(*seen(name, xyz), kind)
        assert np.abs(model.ground_to_image(xyz @ axes + origin) - expected).max() < 2 * CLOSE
        again = registry.plugin("frame").model.from_dict(model.to_dict())
        assert np.array_equal(again.ground_to_image(xyz @ axes + origin), model.ground_to_image(xyz @ axes + origin))


def test_metashape_in_local_coordinates_must_be_declared(tmp_path: Path) -> None:
    file = write_metashape(tmp_path, wkt='LOCAL_CS["Local Coordinates (m)"]')
    with pytest.raises(InputError, match="does not say where these are"):
        build(file, "metashape", "one.jpg", MAP)
    model = build(file, "metashape", "one.jpg", None, world="local", reference=[LON, LAT, 100.0])
    origin, axes = enu()
    xyz = ground("one.jpg")
    assert np.abs(model.ground_to_image(xyz @ axes + origin) - appendix(*seen("one.jpg", xyz), "frame")).max() < CLOSE


def test_metashape_entities_are_refused(tmp_path: Path) -> None:
    file = write_metashape(tmp_path)
    text = file.read_text().replace("<document", '<!DOCTYPE d [<!ENTITY a "b">]><document', 1)
    file.write_text(text)
    with pytest.raises(InputError, match="document type"):
        build(file, "metashape", "one.jpg", None)


def test_metashape_text(tmp_path: Path) -> None:
    lines = ["# Cameras (2)", "# PhotoID, X, Y, Z, Omega, Phi, Kappa, r11, r12, r13, r21, r22, r23, r31, r32, r33"]
    corner = np.array([512345.0, 5771000.0, 0.0])
    for name, (position, angles) in POSES.items():
        m = np.diag([1.0, -1.0, -1.0]) @ to_camera(angles)
        values = [*(corner + np.array(position)), *angles, *m.ravel()]
        lines.append("\t".join([name.removesuffix(".jpg"), *(f"{v:.9f}" for v in values)]))
    file = tmp_path / "opk.txt"
    file.write_text("\n".join(lines) + "\n")
    camera = {"focal_length_px": [FX, FY], "principal_point_px": [CX, CY]}
    for name in POSES:
        model = build(file, "metashape", name, MAP, camera=camera, treatment="planar")
        xyz = ground(name)
        expected = np.column_stack(COLMAP["PINHOLE"][1](*seen(name, xyz)))
        assert np.abs(model.ground_to_image(xyz + corner) - expected).max() < CLOSE
    file.write_text("\n".join(lines).replace("130.000000000", "131.000000000"))
    with pytest.raises(InputError, match="printed matrix is not that of omega, phi, kappa"):
        build(file, "metashape", "one.jpg", MAP, camera=camera)
    file.write_text("\n".join(lines))
    with pytest.raises(InputError, match="'camera' is missing"):
        build(file, "metashape", "one.jpg", MAP)


@pytest.mark.parametrize("shear", [0.0, 3e-4, -0.02])
def test_a_sheared_sensor_both_ways(shear: float) -> None:
    from geomosaic_frame.camera import Camera

    table = {
        "focal_length_px": 3000.0,
        "distortion": {"model": "brown", "k1": -0.05, "k4": 0.01, "p1": 1e-3, "shear": shear},
    }
    camera = Camera.from_table(table, SIZE, "photo")
    pixels = np.array([[10.0, 20.0], [2000.0, 1500.0], [3990.0, 2990.0]])
    d = camera.directions(pixels)
    assert np.abs(camera.project(*d.T) - pixels).max() < 1e-8
    step = 1e-6
    numeric = np.stack(
        [(camera.project(*(d + e).T) - camera.project(*(d - e).T)) / (2 * step) for e in step * np.eye(3)], axis=2
    )
    assert np.abs(camera.derivatives(*d.T) - numeric).max() < 1e-2
    assert Camera.from_dict(camera.to_dict()).lens == camera.lens


# --- Ames Stereo Pipeline ---------------------------------------------------------------------------------------------

PITCH, XP, YP = 0.0064, 0.04, -0.09
K = (-3.1e-5, 2.4e-8, -1.1e-11)


def corrected(x: FloatArray, y: FloatArray, centre: tuple[float, float], p: tuple[float, float]) -> Any:
    """Measured to ideal millimetres, as Australis and the pipeline's manual have it."""
    dx, dy = x - centre[0], y - centre[1]
    r2 = dx * dx + dy * dy
    radial = K[0] * r2 + K[1] * r2**2 + K[2] * r2**3
    return (
        x + dx * radial + p[0] * (r2 + 2 * dx * dx) + 2 * p[1] * dx * dy,
        y + dy * radial + p[1] * (r2 + 2 * dy * dy) + 2 * p[0] * dx * dy,
    )


def measured(x: FloatArray, y: FloatArray, *lens: Any) -> tuple[FloatArray, FloatArray]:
    """Ideal to measured millimetres, by iteration."""
    u, v = x, y
    for _ in range(60):
        ideal = corrected(u, v, *lens)
        u, v = u + x - ideal[0], v + y - ideal[1]
    return u, v


def photometrix(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    return measured(x * 20.0, y * 20.0, (XP, YP), (4e-6, -7e-6))


def brown_conrady(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    u, v = measured(x * 20.0, y * 20.0, (0.0, 0.0), (0.0, 0.0))
    return u + XP, v + YP


def in_mm(lens: Callable[[FloatArray, FloatArray], Any]) -> Callable[[FloatArray, FloatArray], Any]:
    return lambda x, y: tuple(20.0 * value for value in lens(x, y))


RADIAL_MM = f"xp = {XP}\nyp = {YP}\nk1 = {K[0]}\nk2 = {K[1]}\nk3 = {K[2]}\n"
TSAI: dict[str, tuple[str, Callable[[FloatArray, FloatArray], Any]]] = {
    "NULL": ("", in_mm(lambda x, y: (x, y))),
    "TSAI": (
        "k1 = -0.05\nk2 = 0.02\np1 = 0.001\np2 = -0.002\nk3 = 0.003\n",
        in_mm(lambda x, y: opencv(x, y, (-0.05, 0.02, 0.003), 0.001, -0.002)),
    ),
    "AdjustableTSAI": (
        "Radial Coeff: Vector3(-0.05,0.02,0.003)\nTangential Coeff: Vector2(0.001,-0.002)\nAlpha: 0.01\n",
        in_mm(lambda x, y: (lambda u, v: (u + 0.01 * v, v))(*opencv(x, y, (-0.05, 0.02, 0.003), 0.001, -0.002))),
    ),
    "FISHEYE": (
        "k1 = -0.01\nk2 = 0.003\nk3 = -0.001\nk4 = 0.0005\n",
        in_mm(lambda x, y: theta(x, y, (-0.01, 0.003, -0.001, 0.0005))),
    ),
    "Photometrix": (f"{RADIAL_MM}p1 = 4e-6\np2 = -7e-6\nb1 = 0.0\nb2 = 0.0\n", photometrix),
    "BrownConrady": (f"{RADIAL_MM}p1 = 0\np2 = 0\nphi = 0.3\n", brown_conrady),
}


def write_tsai(folder: Path, lens: str, prefix: str = "", **changed: str) -> Path:
    """f = 20 mm, the centre at (CX, CY) from the outer corner: half a pixel less from the first pixel's centre."""
    origin, axes = enu()
    for name, (position, angles) in POSES.items():
        values = {
            "fu": "20.0",
            "fv": "20.0",
            "cu": repr((CX - 0.5) * PITCH),
            "cv": repr((CY - 0.5) * PITCH),
            **{f"{a}_direction": " ".join(str(int(a == b)) for b in "uvw") for a in "uvw"},
            "C": " ".join(repr(float(v)) for v in np.array(position) @ axes + origin),
            "R": " ".join(repr(float(v)) for v in (to_camera(angles) @ axes).T.ravel()),
            "pitch": repr(PITCH),
        } | changed
        lines = [f"{key} = {value}" for key, value in values.items()]
        text = "\n".join(["VERSION_4", "PINHOLE", *lines, lens, TSAI[lens][0]])
        (folder / f"{prefix}{Path(name).stem}.tsai").write_text(text)
    return folder / f"{prefix}one.tsai"


@pytest.mark.parametrize("lens", TSAI)
def test_pinhole_cameras_of_the_ames_stereo_pipeline(tmp_path: Path, lens: str) -> None:
    origin, axes = enu()
    file = write_tsai(tmp_path, lens, "run-" if lens == "TSAI" else "")
    for name in POSES:
        model = build(file, "tsai", name, None)
        xyz = ground(name)
        expected = np.column_stack(TSAI[lens][1](*seen(name, xyz))) / PITCH + [CX, CY]
        assert np.abs(model.ground_to_image(xyz @ axes + origin) - expected).max() < CLOSE
        again = type(model).from_dict(model.to_dict())
        assert np.abs(again.ground_to_image(xyz @ axes + origin) - expected).max() < CLOSE


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"C": "266.9 -105.5 2.1"}, "C is not geocentric"),
        ({"R": "1 0 0 0 1 0 0 0 -1"}, "R is no rotation"),
        ({"pitch": "x"}, "pitch is 'x'"),
        ({"fv": "21"}, "fu and fv differ"),
        ({"u_direction": "-1 0 0"}, "u_direction"),
    ],
)
def test_damaged_pinhole_cameras_say_what_is_wrong(tmp_path: Path, changed: dict[str, str], words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        build(write_tsai(tmp_path, "Photometrix", **changed), "tsai", "one.jpg", None)
    assert error.value.hint


def test_an_optical_bar_camera_is_named_for_what_it_is(tmp_path: Path) -> None:
    (tmp_path / "one.tsai").write_text("VERSION_4\nOPTICAL_BAR\nimage_size = 110507 7904\nf = 0.61\n")
    with pytest.raises(InputError, match="optical bar") as error:
        build(tmp_path / "one.tsai", "tsai", "one.jpg", None)
    assert "geomosaic sensors" in str(error.value.hint)


# --- orthority --------------------------------------------------------------------------------------------------------


def ortho_camera(lens: str, sensor: bool) -> tuple[str, Callable[[FloatArray, FloatArray], FloatArray]]:
    """Camera file, and its formulas; the principal point counts from the centre in units of the longer side."""
    k = {"k1": -0.05, "k2": 0.02, "p1": 0.001, "p2": -0.002, "k3": 0.003}
    lenses: dict[str, tuple[dict[str, float], Callable[[FloatArray, FloatArray], Any]]] = {
        "pinhole": ({}, lambda x, y: (x, y)),
        "brown": (k, lambda x, y: opencv(x, y, (-0.05, 0.02, 0.003), 0.001, -0.002)),
        "opencv": (k, lambda x, y: opencv(x, y, (-0.05, 0.02, 0.003), 0.001, -0.002)),
        "fisheye": ({"k1": -0.01, "k2": 0.003}, lambda x, y: theta(x, y, (-0.01, 0.003))),
    }
    given, formula = lenses[lens]
    focal = np.array([24.0 * 4000 / 36.0, 24.0 * 3000 / 27.0]) if sensor else np.full(2, 0.7 * 4000)
    scale = "focal_len: 24.\n    sensor_size: [36., 27.]   # mm" if sensor else "focal_len: 0.7"
    text = f"# made by hand\nCamera 7:\n    type: {lens}\n    im_size: [4000, 3000]\n    {scale}\n    cx: 0.01\n"
    text += "    cy: -0.02\n" + "".join(f"    {name}: {value}\n" for name, value in given.items())
    centre = np.array([2000.0 + 0.01 * 4000, 1500.0 - 0.02 * 4000])
    return text, lambda x, y: np.column_stack(formula(x, y)) * focal + centre


@pytest.mark.parametrize("lens", ["pinhole", "brown", "opencv", "fisheye"])
@pytest.mark.parametrize("sensor", [True, False])
def test_cameras_of_orthority(tmp_path: Path, lens: str, sensor: bool) -> None:
    text, formula = ortho_camera(lens, sensor)
    (tmp_path / "camera.yaml").write_text(text)
    position, (omega, phi, kappa) = POSES["one.jpg"]
    options = {
        "camera": "camera.yaml",
        "position": (np.array([512345.0, 5771000.0, 0.0]) + position).tolist(),
        "orientation": {"system": "opk", "omega": omega, "phi": phi, "kappa": kappa},
        "treatment": "planar",
    }
    model = registry.build("frame", SensorRequest("one.jpg", SIZE, options, MAP, str(tmp_path)))
    xyz = ground("one.jpg")
    found = model.ground_to_image(xyz + np.array([512345.0, 5771000.0, 0.0]))
    assert np.abs(found - formula(*seen("one.jpg", xyz))).max() < CLOSE


def test_the_camera_of_a_simple_ortho_configuration_is_taken_and_several_are_named(tmp_path: Path) -> None:
    camera = "type: pinhole\n  im_size:\n  - 4000\n  - 3000\n  focal_len: 0.7\n"
    table = parse_yaml(f"camera:\n  {camera}ortho:\n  crs:\n  dem_band: 1\n", "config.yaml")
    assert orthority_table(table, "config.yaml")["focal_length_px"] == [2800.0, 2800.0]
    two = parse_yaml(f"a:\n  {camera}b:\n  {camera}", "two.yaml")
    with pytest.raises(InputError, match="2 cameras: a, b"):
        orthority_table(two, "two.yaml")


@pytest.mark.parametrize("text", ["a: &x 3", "a", "a: 1\na: 2", "- 3", "{a: 1}", "\ta: 1", "a: 1\n- 2"])
def test_yaml_beyond_plain_tables_is_refused_with_its_line(text: str) -> None:
    with pytest.raises(InputError, match="line"):
        parse_yaml(text, "camera.yaml")


def test_transform_of_the_test_is_that_of_the_core() -> None:
    origin, _ = enu()
    assert np.abs(Transform(GEO, ECEF)(np.array([[LON, LAT, 100.0]]))[0] - origin).max() < 1e-6
