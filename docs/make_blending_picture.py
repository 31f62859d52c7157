"""The picture of docs/blending.md: one seam, unblended, feathered and in bands of frequency."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from PIL import Image, ImageDraw

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.inputs.declarations import Block
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import BlendOptions, MosaicOptions, Width
from geomosaic.options.render import RenderOptions
from geomosaic.products.mosaics import make_mosaic
from geomosaic.testing.synthetic import AnalyticGround

SIZE, SHIFT, PIXEL = (360, 520), 240, 1.0


def views(folder: Path) -> list[Path]:
    """Two orthos of one ground: the second brighter and redder, each with a lorry where the other has none."""
    ground = AnalyticGround(with_heights(parse_crs("EPSG:32633"), "ellipsoidal"), (400000.0, 5500000.0))
    random = np.random.default_rng(3)
    files = []
    for number, left in enumerate((0, SHIFT)):
        cols, rows = np.meshgrid(np.arange(SIZE[1]) + left + 0.5, np.arange(SIZE[0]) + 0.5)
        xy = np.column_stack([400000 + cols.ravel() * PIXEL, 5500000 - rows.ravel() * PIXEL])
        values = 255 * ground.texture(xy).reshape(*SIZE, 3).astype(np.float64)
        if number:
            values = values * (1.18, 1.05, 0.95) + 12
        across = 372 if number == 0 else 384
        top = 120 if number == 0 else 230
        values[top : top + 44, across - left - 9 : across - left + 9] = (235, 228, 60)
        values += random.normal(0, 2, values.shape)
        files.append(folder / f"{number}.tif")
        place = Affine(PIXEL, 0, 400000 + left * PIXEL, 0, -PIXEL, 5500000)
        shape = {"width": SIZE[1], "height": SIZE[0], "count": 3, "dtype": "uint8"}
        with rasterio.open(files[-1], "w", driver="GTiff", crs="EPSG:32633", transform=place, **shape) as file:
            file.write(np.moveaxis(values.clip(1, 255).astype(np.uint8), 2, 0))
    return files


def main() -> None:
    """Write docs/images/blending.jpg."""
    width = Width(64, "px")
    kinds = {
        "none": BlendOptions("none"),
        "feather, 64 px, without limit": BlendOptions("feather", width, limit=False),
        "feather": BlendOptions("feather", width),
        "multiband": BlendOptions("multiband", Width(32, "px")),
    }
    panels = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = views(folder)
        for text, blending in kinds.items():
            options = MosaicOptions(RenderOptions(overwrite=True), balance=False, stac=False, blending=blending)
            make_mosaic(Block(tuple(files), "planar"), Area(), folder / "out.tif", options)
            with rasterio.open(folder / "out.tif") as file:
                picture = Image.fromarray(np.moveaxis(file.read(), 0, 2)[60:300, 260:500])
            picture = picture.resize((picture.width * 2, picture.height * 2), Image.Resampling.NEAREST)
            ImageDraw.Draw(picture).text((8, 8), text, fill="white", stroke_width=2, stroke_fill="black", font_size=20)
            panels.append(picture)
    wide, tall, gap = panels[0].width, panels[0].height, 8
    sheet = Image.new("RGB", (2 * wide + gap, 2 * tall + gap), "white")
    for number, picture in enumerate(panels):
        sheet.paste(picture, ((number % 2) * (wide + gap), (number // 2) * (tall + gap)))
    sheet.save(Path(__file__).parent / "images" / "blending.jpg", quality=88)


if __name__ == "__main__":
    main()
