"""Projects whose control is measured in the studio: a scan beside a reference, and a SPOT scene."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from pyproj import Transformer
from reference_rig import ANGLES, CAMERA, ORIGIN, POSITION, dem, land, photo, reference
from rpc_rig import SIZE as RPC_SIZE
from rpc_rig import ground, rpc_txt
from rpc_rig import model as rpc_model
from spot_rig import SIZE, Satellite

from geomosaic.testing.synthetic.block import PlainCamera

SCAN = (700, 600)
# Ground of a scan's pixel: metres, turned by 25°, 1.5 m a pixel.
TO_GROUND = (
    Affine.translation(*ORIGIN) @ Affine.rotation(25.0) @ Affine.scale(1.5, -1.5) @ Affine.translation(-350.0, -300.0)
)
SCAN_PROJECT = """\
format = 1
[project]
name = "scan"
images = ["scan.tif"]
[sensor]
name = "planar"
kind = "affine"
[exterior]
crs = "EPSG:32633"
[control]
file = "gcps.csv"
[quality]
reference = "{reference}"
[output]
orthos = true
"""


def scan_ground(colrow: np.ndarray) -> np.ndarray:
    """True map places (N, 2) of pixels of the scan."""
    return np.column_stack(TO_GROUND @ np.asarray(colrow, dtype=float).T)


def scan_pixels(xy: np.ndarray) -> np.ndarray:
    """True pixels (N, 2) of map places."""
    return np.column_stack(~TO_GROUND @ np.asarray(xy, dtype=float).T)


@dataclass(frozen=True)
class ScanProject:
    """Project of one scan without any place, and a reference ortho that shows the same land."""

    path: Path
    reference: Path

    @property
    def table(self) -> Path:
        return self.path.parent / "gcps.csv"

    def on_reference(self, xy: np.ndarray) -> np.ndarray:
        """Pixels (N, 2) of the reference at map places."""
        with rasterio.open(self.reference) as file:
            return np.column_stack(~file.transform @ np.asarray(xy, dtype=float).T)


def scan_project(folder: Path, half: int = 560) -> ScanProject:
    """Write the scan, the reference and the project."""
    width, height = SCAN
    c, r = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    grey = land(scan_ground(np.column_stack([c.ravel(), r.ravel()]))).reshape(height, width)
    noise = np.random.default_rng(8).normal(0.0, 0.01, grey.shape)
    values = np.clip(np.rint(255.0 * (0.1 + 0.85 * grey + noise)), 1, 255).astype(np.uint8)
    with rasterio.open(
        folder / "scan.tif", "w", driver="GTiff", width=width, height=height, count=1, dtype="uint8"
    ) as file:
        file.write(values, 1)
    shown = reference(folder, half=half, season=False)
    path = folder / "project.toml"
    path.write_text(SCAN_PROJECT.format(reference=shown.name), encoding="utf-8")
    return ScanProject(path, shown)


FRAME_PROJECT = """\
format = 1
[project]
name = "flight"
images = ["photo.tif"]
[sensor]
name = "frame"
camera = "camera.toml"
[exterior]
file = "exterior.csv"
crs = "EPSG:32633"
heights = "ellipsoidal"
angles = "opk"
[dem]
file = "dem.tif"
heights = "ellipsoidal"
[control]
file = "gcps.csv"
[quality]
reference = "{reference}"
"""


def frame_project(folder: Path) -> tuple[ScanProject, PlainCamera]:
    """Write a project of one photo whose given orientation is some pixels wrong, and its true camera."""
    _, camera = photo(folder)
    dem(folder)
    shown = reference(folder, season=False)
    lines = [f"{key} = {list(value) if isinstance(value, tuple) else value!r}" for key, value in CAMERA.items()]
    (folder / "camera.toml").write_text("\n".join(lines).replace("'", '"'), encoding="utf-8")
    x, y, z, omega, phi, kappa = np.array([*POSITION, *ANGLES]) + np.array([4.0, -3.0, 2.0, 0.1, 0.1, 0.2])
    header = "image,x,y,z,omega,phi,kappa"
    text = f"{header}\nphoto.tif,{x},{y},{z},{omega},{phi},{kappa}\n"
    (folder / "exterior.csv").write_text(text, encoding="utf-8")
    path = folder / "project.toml"
    path.write_text(FRAME_PROJECT.format(reference=shown.name), encoding="utf-8")
    return ScanProject(path, shown), camera


SPOT_PROJECT = """\
format = 1
[project]
name = "spot"
images = ["IMAGERY.TIF"]
[sensor]
name = "pushbroom"
[exterior]
crs = "EPSG:32624"
heights = "ellipsoidal"
[dem]
height = 400.0
heights = "ellipsoidal"
[control]
file = "gcps.csv"
[quality]
reference = "map.tif"
"""


def spot_ground(colrow: np.ndarray) -> np.ndarray:
    """True map places (N, 2) that a SPOT scene shows at pixels (N, 2): its attitude is not what its file tells."""
    satellite = Satellite()
    earth = np.array([satellite.ground(*place, 400.0) for place in colrow])
    return np.column_stack(Transformer.from_crs(4978, 32624, always_xy=True).transform(*earth.T)[:2])


def spot_project(folder: Path, points: np.ndarray, noise: float, seed: int = 1) -> ScanProject:
    """Write a SPOT scene, a map and control points at pixels (N, 2), measured with noise (pixels)."""
    told = Satellite(attitude=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0))
    (folder / "METADATA.DIM").write_text(told.dimap())
    width, height = SIZE
    rows, cols = np.mgrid[0:height, 0:width]
    values = (120 + 60 * np.sin(cols / 37.0) * np.sin(rows / 41.0)).astype(np.uint8)
    write_raster(folder / "IMAGERY.TIF", values)
    corners = spot_ground(np.array([[0, height], [0, 0], [width, 0], [width, height]]))
    low, high = corners.min(axis=0) - 1500.0, corners.max(axis=0) + 1500.0
    across, down = np.ceil((high - low) / 20.0).astype(int)
    rows, cols = np.mgrid[0:down, 0:across]
    values = (120 + 60 * np.sin(cols / 37.0) * np.sin(rows / 41.0)).astype(np.uint8)
    write_raster(folder / "map.tif", values, Affine(20.0, 0.0, low[0], 0.0, -20.0, low[1] + 20.0 * down), 32624)
    measured = points + np.random.default_rng(seed).normal(0.0, noise, points.shape)
    lines = [
        f"{number},{x:.3f},{y:.3f},400.0,IMAGERY.TIF,{col:.3f},{row:.3f}"
        for number, ((x, y), (col, row)) in enumerate(zip(spot_ground(points), measured, strict=True), start=1)
    ]
    (folder / "gcps.csv").write_text("\n".join(["id,x,y,z,image,col,row", *lines]) + "\n", encoding="utf-8")
    path = folder / "project.toml"
    path.write_text(SPOT_PROJECT, encoding="utf-8")
    return ScanProject(path, folder / "map.tif")


RPC_PROJECT = """\
format = 1
[project]
name = "scene"
images = ["scene.tif"]
[sensor]
name = "rpc"
refine = "{kind}"
[exterior]
crs = "EPSG:32738"
heights = "ellipsoidal"
[dem]
height = 420.0
heights = "ellipsoidal"
[control]
file = "gcps.csv"
[quality]
reference = "map.tif"
"""


def rpc_project(
    folder: Path, count: int, noise: float, kind: str = "affine"
) -> tuple[ScanProject, np.ndarray, np.ndarray]:
    """Write a scene whose RPCs are some pixels off, a map and control; pixels and map places of ten more points."""
    to_map = Transformer.from_crs(4979, 32738, always_xy=True)
    lonlath = np.column_stack([ground(count + 10)[:, :2], np.full(count + 10, 420.0)])
    places = rpc_model().ground_to_image(lonlath) + np.array([6.0, -4.0])
    xy = np.column_stack(to_map.transform(*lonlath.T)[:2])
    low, high = xy.min(axis=0) - 500.0, xy.max(axis=0) + 500.0
    across, down = np.ceil((high - low) / 20.0).astype(int)
    write_raster(folder / "scene.tif", np.full(RPC_SIZE[::-1], 90, np.uint8))
    (folder / "scene_rpc.txt").write_text(rpc_txt())
    map_values = np.full((down, across), 90, np.uint8)
    write_raster(folder / "map.tif", map_values, Affine(20.0, 0.0, low[0], 0.0, -20.0, low[1] + 20.0 * down), 32738)
    measured = places + np.random.default_rng(1).normal(0.0, noise, places.shape)
    lines = [
        f"{number},{x:.3f},{y:.3f},420.0,scene.tif,{col:.3f},{row:.3f}"
        for number, ((x, y), (col, row)) in enumerate(zip(xy[:count], measured[:count], strict=True), start=1)
    ]
    (folder / "gcps.csv").write_text("\n".join(["id,x,y,z,image,col,row", *lines]) + "\n", encoding="utf-8")
    path = folder / "project.toml"
    path.write_text(RPC_PROJECT.format(kind=kind), encoding="utf-8")
    return ScanProject(path, folder / "map.tif"), places[count:], xy[count:]


def write_raster(path: Path, values: np.ndarray, place: Affine | None = None, crs: int | None = None) -> None:
    """Write one band, tiled."""
    rows, cols = values.shape
    more = {} if place is None else {"transform": place, "crs": f"EPSG:{crs}"}
    with rasterio.open(
        path, "w", driver="GTiff", width=cols, height=rows, count=1, dtype="uint8", tiled=True, compress="lzw", **more
    ) as file:
        file.write(values, 1)
