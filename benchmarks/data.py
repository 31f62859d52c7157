"""Make the inputs of a run once: `python -m benchmarks.data FOLDER [--small]`. The same numbers give the same bytes."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from rasterio.transform import from_origin
from rasterio.windows import Window

from benchmarks.projection import Floats, ground, relief
from benchmarks.scene import CENTRE, CRS, DEM_SIZE, DEM_SPACING, RESOLUTION, Camera, Scene, Shot, scenes, tiny_bounds

TILED = {"driver": "GTiff", "tiled": True, "blockxsize": 512, "blockysize": 512}
LATTICE = 64
FORMAT = "4"


def make(folder: Path, small: bool) -> None:
    """Make what is not there yet."""
    whole = folder / "made"
    folder.mkdir(parents=True, exist_ok=True)
    write_control(folder / "control.csv", scenes(small)["single"].camera)
    if whole.exists() and whole.read_text() == FORMAT:
        return
    write_dem(folder / "dem.tif")
    for scene in scenes(small).values():
        home = folder / scene.name
        home.mkdir(exist_ok=True)
        write_tables(home, scene)
        for number, shot in enumerate(scene.shots):
            write_photo(home / shot.name, scene.camera, shot, number)
    single = scenes(small)["single"]
    home = folder / "coordinates"
    home.mkdir(exist_ok=True)
    write_tables(home, single)
    write_coordinates(home / single.shots[0].name, single.camera)
    x, y = middle_of_crop(single)
    write_crop(folder / "dem.tif", home / "dem.tif", x, y)
    sides = [round(side / RESOLUTION) * RESOLUTION for side in (x - 290, y - 290, x + 290, y + 290)]
    (home / "bounds.json").write_text(json.dumps(sides))
    write_map(folder / "map512.tif")
    whole.write_text(FORMAT)


def write_dem(path: Path) -> None:
    """Relief at nodes 5 m apart."""
    half = DEM_SIZE * DEM_SPACING / 2
    steps = (np.arange(DEM_SIZE) + 0.5) * DEM_SPACING - half
    x, y = np.meshgrid(CENTRE[0] + steps, CENTRE[1] - steps)
    place = from_origin(CENTRE[0] - half, CENTRE[1] + half, DEM_SPACING, DEM_SPACING)
    shape = {"width": DEM_SIZE, "height": DEM_SIZE, "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", crs=CRS, transform=place, **shape, **TILED) as file:
        file.write(relief(x, y).astype(np.float32), 1)


def write_crop(source: Path, path: Path, x: float, y: float, size: int = 120) -> None:
    """Part of the DEM about a place."""
    with rasterio.open(source) as whole:
        row, col = whole.index(x, y)
        window = Window(col - size // 2, row - size // 2, size, size)
        profile = {**whole.profile, "width": size, "height": size, "transform": whole.window_transform(window)}
        profile.update(blockxsize=128, blockysize=128)
        with rasterio.open(path, "w", **profile) as file:
            file.write(whole.read(1, window=window), 1)


def middle_of_crop(scene: Scene) -> tuple[float, float]:
    """Ground near a corner of the photo, where distortion and the lean of the relief are large."""
    width, height = scene.camera.size
    x, y, _ = ground(scene.camera, scene.shots[0], np.array([[0.82 * width, 0.2 * height]]))[0]
    return float(x), float(y)


def texture(xyz: Floats, band: int) -> Floats:
    """Colour of the ground, 0 to 255."""
    x, y = xyz[..., 0] - CENTRE[0], xyz[..., 1] - CENTRE[1]
    broad = 40 * np.sin(x / 61 + band) * np.cos(y / 47)
    fine = 22 * np.sin((x + 0.6 * y) / 3.1) + 18 * np.sin((0.4 * x - y) / 2.3 + band)
    return np.asarray(118 + 9 * band + broad + fine, dtype=np.float64)


def write_photo(path: Path, camera: Camera, shot: Shot, number: int) -> None:
    """Render the ground as the camera saw it (exact every 64 pixels, linear between), with noise of 2 grey values."""
    width, height = camera.size
    chance = np.random.default_rng([5, number])
    noise = chance.normal(0, 2, (LATTICE, width + 4096)).astype(np.float32)
    cols, rows = np.arange(0, width + LATTICE, LATTICE), np.arange(0, height + LATTICE, LATTICE)
    c, r = np.meshgrid(cols.astype(np.float64), rows.astype(np.float64))
    nodes = ground(camera, shot, np.column_stack([c.ravel(), r.ravel()])).reshape(*c.shape, 3)
    across, down = (np.arange(width) + 0.5) / LATTICE, (np.arange(LATTICE) + 0.5) / LATTICE
    left, part = across.astype(int), (across % 1)[None, :, None]
    shape = {"width": width, "height": height, "count": 3, "dtype": "uint8", "interleave": "pixel"}
    with rasterio.open(path, "w", photometric="RGB", **shape, **TILED) as file:
        strips: list[Any] = []
        for strip in range(-(-height // LATTICE)):
            first = strip * LATTICE
            some = min(LATTICE, height - first)
            ends = nodes[strip : strip + 2]
            lines = ends[:, left] * (1 - part) + ends[:, left + 1] * part
            here = lines[0] * (1 - down[:some, None, None]) + lines[1] * down[:some, None, None]
            strips.append(np.empty((3, some, width), dtype=np.uint8))
            for band in range(3):
                shift = int(chance.integers(4096))
                grey = texture(here, band) * shot.gain + shot.offset + noise[:some, shift : shift + width]
                strips[-1][band] = np.clip(np.rint(grey), 0, 255)
            if len(strips) == 8 or first + some == height:
                rows_now = np.concatenate(strips, axis=1)
                file.write(rows_now, window=Window(0, first + some - rows_now.shape[1], width, rows_now.shape[1]))
                strips = []


def write_coordinates(path: Path, camera: Camera) -> None:
    """Photo of two float bands that hold their own (col, row), from the image's centre to keep digits."""
    width, height = camera.size
    shape = {"width": width, "height": height, "count": 2, "dtype": "float32", "interleave": "pixel"}
    col = np.broadcast_to(np.arange(width) + 0.5 - width / 2, (512, width))
    with rasterio.open(path, "w", **shape, **TILED) as file:
        for first in range(0, height, 512):
            some = min(512, height - first)
            row = np.broadcast_to((np.arange(first, first + some) + 0.5 - height / 2)[:, None], (some, width))
            file.write(np.stack([col[:some], row]).astype(np.float32), window=Window(0, first, width, some))


def write_map(path: Path) -> None:
    """Georeferenced 512 x 512 raster, for what only reprojects."""
    left, _, _, top = tiny_bounds()
    steps = (np.arange(512) + 0.5) * RESOLUTION
    x, y = np.meshgrid(left + steps, top - steps)
    here = np.stack([x, y, np.zeros_like(x)], axis=-1)
    bands = np.stack([np.clip(np.rint(texture(here, band)), 0, 255) for band in range(3)]).astype(np.uint8)
    shape = {"width": 512, "height": 512, "count": 3, "dtype": "uint8", "interleave": "pixel", "photometric": "RGB"}
    place = from_origin(left, top, RESOLUTION, RESOLUTION)
    with rasterio.open(path, "w", crs=CRS, transform=place, **shape, **TILED) as file:
        file.write(bands)


def write_control(path: Path, camera: Camera, count: int = 200) -> None:
    """Control points as of a scanned map that is bent by a cubic, measured to a third of a pixel."""
    chance = np.random.default_rng(7)
    size = np.array(camera.size, dtype=np.float64)
    image = chance.uniform(0.005, 0.995, (count, 2))
    image[:4] = [[0.005, 0.005], [0.995, 0.005], [0.005, 0.995], [0.995, 0.995]]
    u, v = (image - 0.5).T
    x = u + 0.02 * u * u - 0.03 * u * v + 0.02 * u**3
    y = v + 0.015 * v * v + 0.02 * u * v - 0.02 * v**3
    ground = np.column_stack([x, -y]) * RESOLUTION * size + CENTRE[:2] + chance.normal(0, RESOLUTION / 3, (count, 2))
    rows = np.column_stack([ground, image * size]).tolist()
    lines = [f"p{i},{','.join(f'{value:.4f}' for value in row)}" for i, row in enumerate(rows)]
    path.write_text("\n".join(["id,x,y,col,row", *lines]) + "\n")


def write_tables(folder: Path, scene: Scene) -> None:
    """Camera and orientation in geomosaic's form and in orthority's."""
    camera = scene.camera
    (width, height), (col, row) = camera.size, camera.principal_point
    brown = "\n".join(f"{key} = {value!r}" for key, value in camera.brown.items())
    (folder / "camera.toml").write_text(
        f"size = [{width}, {height}]\nfocal_length_px = {camera.focal}\nprincipal_point_px = [{col}, {row}]\n\n"
        f'[distortion]\nmodel = "brown"\nconvention = "opencv"\n{brown}\n'
    )
    # Principal point: from the image's centre, in units of its longer side.
    longer = max(width, height)
    brown = "\n".join(f"  {key}: {value!r}" for key, value in camera.brown.items())
    (folder / "oty_int.yaml").write_text(
        f"frame:\n  type: brown\n  im_size: [{width}, {height}]\n  focal_len: {camera.focal}\n"
        f"  sensor_size: [{width}.0, {height}.0]\n  cx: {(col - width / 2) / longer!r}\n"
        f"  cy: {(row - height / 2) / longer!r}\n{brown}\n"
    )
    for name, first in (("exterior.csv", "image"), ("oty_ext.csv", "filename")):
        lines = [f"{first},x,y,z,omega,phi,kappa"]
        lines += [",".join([shot.name, *(repr(v) for v in (*shot.position, *shot.angles))]) for shot in scene.shots]
        (folder / name).write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    make(Path(sys.argv[1]), "--small" in sys.argv)
