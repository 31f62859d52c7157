"""Projects of synthetic blocks: files of photos without pixels, tie points, control and camera positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from block_rig import CAMERA, SIZE, Block, grid_block, heights

from geomosaic.geo.transform import Transform

CAMERA_TOML = f"""size = {list(SIZE)}
focal_length_px = {CAMERA["focal_length_px"]}
principal_point_px = {CAMERA["principal_point_px"]}
"""
PROJECT = """format = 1
[project]
name = "block"
images = ["photos/*.tif"]
[sensor]
name = "frame"
camera = "camera.toml"
[exterior]
file = "exterior.csv"
crs = "EPSG:32633"
heights = "ellipsoidal"
[dem]
file = "dem.tif"
heights = "ellipsoidal"
[control]
file = "control.csv"
[adjust]
ties = "ties.csv"
sigma_px = 0.3
position_sigma = 20.0
attitude_sigma = 0.5
[output]
folder = "output"
resolution = 4.0
"""


def write_photo(path: Path, size: tuple[int, int] = SIZE) -> None:
    """Write an image of one colour: sparse tiles take no room."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with rasterio.open(
        path, "w", driver="GTiff", width=size[0], height=size[1], count=1, dtype="uint8", tiled=True, SPARSE_OK=True
    ):
        pass


def write_dem(path: Path, block: Block) -> None:
    places = block.frame.to_ground(block.points)
    low, high = places[:, :2].min(axis=0) - 1500.0, places[:, :2].max(axis=0) + 1500.0
    step = 10.0
    count = np.ceil((high - low) / step).astype(int)
    x = low[0] + (np.arange(count[0]) + 0.5) * step
    y = high[1] - (np.arange(count[1]) + 0.5) * step
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    with rasterio.open(
        path, "w", driver="GTiff", width=int(count[0]), height=int(count[1]), count=1, dtype="float32",
        crs="EPSG:32633", transform=Affine(step, 0.0, low[0], 0.0, -step, high[1]),
    ) as sink:  # fmt: skip
        sink.write(heights(grid).reshape(count[1], count[0]).astype(np.float32), 1)


def tables(block: Block, *, seed: int = 5, sigma_control: float = 0.02, checks: int = 2) -> dict[str, list[str]]:
    """Lines of the tables of a block: start values of the orientation, ties, control and check points."""
    random = np.random.default_rng(seed)
    measured = block.colrow + block.noise
    ground = block.frame.to_ground(block.points)
    exterior = ["image,x,y,z,omega,phi,kappa"]
    crs = block.frame.ground
    for name, model in zip(block.names, block.start, strict=True):
        exterior.append(",".join([f"{name}.tif", *(f"{value:.9f}" for value in model.exterior(crs))]))
    ties = ["id,image,col,row"]
    control = ["id,x,y,z,image,col,row,sigma_xy,sigma_z,role"]
    given = ground[block.control] + sigma_control * random.normal(size=(len(block.control), 3))
    number = {int(point): index for index, point in enumerate(block.control)}
    seen = np.bincount(block.point)
    for image, point, (col, row) in zip(block.image, block.point, measured, strict=True):
        if seen[point] < 2:
            continue
        place = f"{block.names[image]}.tif,{col:.4f},{row:.4f}"
        index = number.get(int(point))
        if index is None:
            ties.append(f"t{point},{place}")
        else:
            x, y, z = given[index]
            role = "check" if index >= len(block.control) - checks else "control"
            control.append(f"c{index},{x:.4f},{y:.4f},{z:.4f},{place},{sigma_control},{sigma_control},{role}")
    return {"exterior.csv": exterior, "ties.csv": ties, "control.csv": control}


def write_project(folder: Path, block: Block, text: str = PROJECT, **options: object) -> Path:
    """Write a project with all its files; returns the project file."""
    for name in block.names:
        write_photo(folder / "photos" / f"{name}.tif")
    for name, lines in tables(block, **options).items():  # type: ignore[arg-type]
        (folder / name).write_text("\n".join(lines) + "\n")
    (folder / "camera.toml").write_text(CAMERA_TOML)
    write_dem(folder / "dem.tif", block)
    file = folder / "block.toml"
    file.write_text(text)
    return file


__all__ = ["PROJECT", "Transform", "grid_block", "tables", "write_dem", "write_photo", "write_project"]
