"""Pictures of the README and the docs, made from the sample block: run `geomosaic demo` first, then this with its folder."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from geomosaic.raster.preview import preview

IMAGES = Path(__file__).parent / "images"


def photos_and_mosaic(folder: Path) -> Image.Image:
    """Raw photos on the left, the mosaic made of them on the right."""
    height, gap = 760, 10
    rgb, valid = preview(folder / "output" / "sample.tif", 1600)
    rgb = np.where(valid[..., None] > 0, rgb, 255).astype(np.uint8)
    mosaic = Image.fromarray(rgb)
    mosaic = mosaic.resize((round(mosaic.width * height / mosaic.height), height), Image.Resampling.LANCZOS)
    files = sorted((folder / "photos").glob("*.jpg"))
    rows = -(-len(files) // 3)
    tile = (height - (rows - 1) * gap) // rows
    thumbs = [ImageOps.contain(Image.open(file).convert("RGB"), (10000, tile)) for file in files]
    width = thumbs[0].width
    sheet = Image.new("RGB", (3 * width + 3 * gap + mosaic.width + gap, height), "white")
    for k, thumb in enumerate(thumbs):
        sheet.paste(thumb, ((k % 3) * (width + gap), (k // 3) * (tile + gap)))
    sheet.paste(mosaic, (3 * (width + gap) + gap, 0))
    return sheet


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    photos_and_mosaic(Path(sys.argv[1])).save(IMAGES / "photos-to-mosaic.jpg", quality=88)
