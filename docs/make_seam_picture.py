"""Picture of docs/seams.md, from the sample: run this from the project's folder."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import rasterio
from PIL import Image, ImageDraw

from geomosaic.raster.vector import read_layer

HERE = Path(__file__).parent
SAMPLE = HERE.parent / "data" / "sample"
BOUNDS = ("399840", "5499960", "400560", "5500500")
WAYS = (("nearest", "--seams nearest"), ("graph-cut", "--seams graph-cut"))


def panel(seams: str, title: str, folder: Path) -> Image.Image:
    """The village of the sample with the seams laid in one way."""
    out = folder / f"{seams}.tif"
    words = [
        *sorted(map(str, (SAMPLE / "photos").glob("*.jpg"))), "--sensor", "frame",
        "--camera", SAMPLE / "camera.toml", "--exterior", SAMPLE / "exterior.csv", "--crs", "EPSG:32633",
        "--heights", "egm96", "--dem", SAMPLE / "dem.tif", "--res", "0.8", "--seams", seams, "-o", out,
    ]  # fmt: skip
    subprocess.run([sys.executable, "-m", "geomosaic.cli", "mosaic", *map(str, words)], check=True)
    left, bottom, right, top = map(float, BOUNDS)
    with rasterio.open(out) as mosaic:
        window = mosaic.window(left, bottom, right, top)
        place = mosaic.window_transform(window)
        picture = Image.fromarray(np.moveaxis(mosaic.read(window=window), 0, -1).copy())
    draw = ImageDraw.Draw(picture)
    for line in read_layer(out.with_suffix(".gpkg"), "seamlines").geometry:
        for part in getattr(line, "geoms", [line]):
            draw.line([tuple(~place @ xy[:2]) for xy in part.coords], fill=(255, 210, 63), width=4)
    draw.rectangle((0, 0, 210, 34), fill=(18, 48, 63))
    draw.text((10, 5), title, fill="white", font_size=22)
    return picture


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        panels = [panel(seams, title, Path(scratch)) for seams, title in WAYS]
    sheet = Image.new("RGB", (2 * panels[0].width + 12, panels[0].height), "white")
    for number, one in enumerate(panels):
        sheet.paste(one, (number * (one.width + 12), 0))
    sheet.save(HERE / "images" / "seams.jpg", quality=85)
