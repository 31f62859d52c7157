"""The picture of docs/colour.md: photos as they are, with gain and offset, and with what is warranted."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from PIL import Image

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.inputs.declarations import Block
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.render import RenderOptions
from geomosaic.products.mosaics import make_mosaic
from geomosaic.testing.synthetic import AnalyticGround

CRS = "EPSG:32633"
WIDTH, HEIGHT, PIXEL = 300, 220, 2.0


def shoot(folder: Path) -> list[Path]:
    """Three strips of four photos, straight down."""
    ground = AnalyticGround(with_heights(parse_crs(CRS), "ellipsoidal"), (500000.0, 5500000.0), wavelength=6.0)
    random, files = np.random.default_rng(3), []
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    right, up = (x - WIDTH / 2, HEIGHT / 2 - y) / (np.hypot(WIDTH, HEIGHT) / 2)
    falloff = 1 - 0.35 * (right**2 + up**2)
    hotspot = 1 + 0.22 * np.exp(-((right - 0.25) ** 2 + (up - 0.3) ** 2) / (2 * 0.25**2))
    for strip in range(3):
        for number in range(4):
            corner = 499500.0 + number * 130 * PIXEL, 5500420.0 - strip * 140 * PIXEL
            places = np.column_stack([(corner[0] + x * PIXEL).ravel(), (corner[1] - y * PIXEL).ravel()])
            light = 200 * ground.texture(places).reshape(HEIGHT, WIDTH, 3) * (falloff * hotspot)[..., None]
            values = np.exp(random.normal(0, 0.09, 3)) * light + random.uniform(-3, 3, 3)
            values += random.normal(0, 1, values.shape)
            files.append(folder / f"{strip}-{number}.tif")
            with rasterio.open(
                files[-1], "w", driver="GTiff", width=WIDTH, height=HEIGHT, count=3, dtype="uint8", crs=CRS,
                transform=Affine(PIXEL, 0, corner[0], 0, -PIXEL, corner[1]),
            ) as file:  # fmt: skip
                file.write(np.clip(np.rint(values), 0, 255).astype(np.uint8).transpose(2, 0, 1))
    return files


def main() -> None:
    """Make docs/images/colour.jpg."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files, shown = shoot(folder), []
        for more in ({"balance": False}, {"colour": ("gain",)}, {}):
            render = RenderOptions(overwrite=True)
            options = MosaicOptions(render, labels=False, vectors=False, stac=False, **more)
            made = make_mosaic(Block(tuple(files), "planar"), Area(None, PIXEL), folder / "mosaic.tif", options)
            print(more, made.balance.before, made.balance.after)
            with rasterio.open(made.path) as file:
                shown.append(file.read([1, 2, 3]).transpose(1, 2, 0))
            shown.append(np.full((shown[-1].shape[0], 8, 3), 255, dtype=np.uint8))
    whole = Image.fromarray(np.concatenate(shown[:-1], axis=1))
    whole.thumbnail((1400, 1400))
    whole.save(Path(__file__).parent / "images" / "colour.jpg", quality=88)


if __name__ == "__main__":
    main()
