"""Photos of an analytic ground, and products of them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine

from geomosaic.block import Footprint, OrientedBlock, OrientedImage
from geomosaic.geo.crs import horizontal, parse_crs, with_heights
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.mosaic import mosaic
from geomosaic.mosaicking.records import MosaicResult
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.render import RenderOptions
from geomosaic.render.extent import footprints, output_grid
from geomosaic.render.ortho import OrthoResult, ortho
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.registry import build
from geomosaic.surface.dem import Dem
from geomosaic.surface.model import Surface
from geomosaic.testing.synthetic import CAMERA, AnalyticGround, FlightPlan, SyntheticPhoto, render, synthetic_block

CRS3 = with_heights(parse_crs("EPSG:32633"), "egm96")
MAP = horizontal(CRS3)
GROUND = AnalyticGround(CRS3, origin=(400_000.0, 5_500_000.0), wavelength=8.0, spacing=1.0)
SIZE, GSD = (400, 300), 2.0
SMALL = {**CAMERA, "size": list(SIZE)}


def model_of(photo: SyntheticPhoto, camera: dict[str, Any]) -> Any:
    """The photo's model by the public door."""
    omega, phi, kappa = photo.angles
    options = {
        "camera": camera,
        "position": list(photo.position),
        "orientation": {"system": "opk", "omega": omega, "phi": phi, "kappa": kappa},
        "ground_height": GROUND.base,
    }
    return build("frame", SensorRequest(photo.name, tuple(camera["size"]), options, CRS3))


def write(path: Path, values: np.ndarray, **more: Any) -> Path:
    """Write an image (rows, cols, bands) that knows nothing of its place."""
    rows, cols, bands = values.shape
    with rasterio.open(
        path, "w", driver="GTiff", width=cols, height=rows, count=bands, dtype=values.dtype, tiled=True,
        blockxsize=128, blockysize=128, **more,
    ) as file:  # fmt: skip
        file.write(values.transpose(2, 0, 1))
    return path


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Values (rows, cols, bands) and whether they are valid (rows, cols)."""
    with rasterio.open(path) as file:
        return file.read().transpose(1, 2, 0), file.dataset_mask() > 0


def sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@dataclass(frozen=True)
class Job:
    """Photos of one block, ready for a product."""

    block: OrientedBlock
    grid: Grid
    outlines: list[Footprint]

    def ortho(self, path: Path, index: int = 0, **options: Any) -> OrthoResult:
        scene, outline = self.block.scenes[index], self.outlines[index]
        return ortho(scene, self.block.surface, self.grid, outline, path, RenderOptions(overwrite=True, **options))

    def mosaic(self, path: Path, feather: float | None = None, balance: bool = True, **options: Any) -> MosaicResult:
        render_options = RenderOptions(overwrite=True, **options)
        return mosaic(
            self.block,
            self.grid,
            self.outlines,
            path,
            MosaicOptions.of(render=render_options, feather=feather, balance=balance, stac=False),
        )


def job(
    surface: Surface,
    files: Sequence[Path],
    photos: Sequence[SyntheticPhoto],
    resolution: float,
    camera: dict[str, Any] | None = None,
    nodata: float | None = None,
) -> Job:
    scenes = tuple(
        OrientedImage(photo.name, str(file), "frame", model_of(photo, camera or SMALL), nodata)
        for file, photo in zip(files, photos, strict=True)
    )
    outlines = footprints(scenes, surface, MAP)
    return Job(OrientedBlock(scenes, surface), output_grid(MAP, outlines, resolution), outlines)


@dataclass(frozen=True)
class Strip:
    """Four photos that overlap, their radiance as rendered, and the DEM."""

    folder: Path
    photos: list[SyntheticPhoto]
    radiance: list[np.ndarray]
    files: list[Path]
    dem: Dem

    def exposed(self, folder: Path, effect: Callable[[int, np.ndarray], np.ndarray], **more: Any) -> list[Path]:
        """The photos with an effect each."""
        folder.mkdir(exist_ok=True)
        return [
            write(folder / f"{photo.name}.tif", effect(i, values), **more)
            for i, (photo, values) in enumerate(zip(self.photos, self.radiance, strict=True))
        ]


def bytes_of(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(20 + 200 * values), 0, 255).astype(np.uint8)


def make_strip(folder: Path) -> Strip:
    """Render the photos, and write them and the DEM of their ground into a folder."""
    photos = synthetic_block(GROUND, SMALL, FlightPlan(2, 2, 0.6, 0.35, gsd=GSD), seed=5)
    radiance = [render(photo.camera(SMALL, GROUND), GROUND, dtype=np.float32) for photo in photos]
    files = [write(folder / f"{p.name}.tif", bytes_of(values)) for p, values in zip(photos, radiance, strict=True)]
    nodes = np.arange(-1000.0, 1000.0, 2.0) + 1.0
    x, y = np.meshgrid(nodes + GROUND.origin[0], nodes[::-1] + GROUND.origin[1])
    heights = GROUND.height(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape).astype(np.float32)
    path = folder / "dem.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=1000, height=1000, count=1, dtype="float32", crs="EPSG:32633+5773",
        transform=Affine(2, 0, GROUND.origin[0] - 1000, 0, -2, GROUND.origin[1] + 1000), tiled=True,
    ) as file:  # fmt: skip
        file.write(heights, 1)
    return Strip(folder, photos, radiance, files, Dem.open(path))
