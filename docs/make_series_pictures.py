"""Pictures of the page on sheet series: a sheet of PUWG 1992 and the index, of invented ground, in docs/images.

Run it from the root of the project: python docs/make_series_pictures.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pypdfium2
import rasterio
from affine import Affine
from PIL import Image

from geomosaic.cli.main import run

IMAGES = Path(__file__).resolve().parent / "images"
LEFT, TOP, PIXEL, SIZE = 551_500.0, 248_500.0, 8.0, (1700, 1560)


def ground(folder: Path) -> tuple[Path, Path]:
    """A photo map of hills with fields, and its DEM."""
    row, col = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].astype(float)
    x, y = col * PIXEL, row * PIXEL
    z = (
        260
        + 45 * np.sin(x / 1900 + np.sin(y / 2600))
        + 40 * np.cos(y / 1500 + x / 5200)
        + 9 * np.sin(x / 420 + y / 610)
    )
    slope = np.gradient(z, PIXEL)
    light = (1 + (slope[0] + slope[1]) * 1.4) / np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    u, v = (x + 0.35 * y) // 430, (y - 0.3 * x) // 260
    kind = ((u * 7 + v * 13 + u * v) % 6) / 5
    wood = z > 305
    colour = np.stack([98 + 78 * kind, 128 + 34 * kind, 66 + 30 * kind])
    colour = np.where(wood, np.array([44, 74, 46])[:, None, None], colour)
    noise = np.random.default_rng(2).normal(0, 5, z.shape)
    picture = np.clip(colour * light + noise, 0, 255).astype(np.uint8)
    place = Affine(PIXEL, 0, LEFT, 0, -PIXEL, TOP)
    for name, values, crs, kind_ in (
        ("map.tif", picture, "EPSG:2180", "uint8"),
        ("dem.tif", z.astype(np.float32)[None], "EPSG:2180+5773", "float32"),
    ):
        with rasterio.open(
            folder / name, "w", driver="GTiff", width=SIZE[0], height=SIZE[1], count=len(values), dtype=kind_, crs=crs,
            transform=place,
        ) as out:  # fmt: skip
            out.write(values)
    return folder / "map.tif", folder / "dem.tif"


def main() -> None:
    """Make both."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        picture, dem = ground(folder)
        words = ["sheets", "make", str(picture), "--scheme", "puwg1992", "--scale", "1:25000", "--contours", str(dem)]
        words += [
            "--sharpen",
            "0.5",
            "--paper",
            "A2",
            "--dpi",
            "200",
            "--title",
            "Invented hills",
            "-o",
            str(folder / "out"),
        ]
        if run(words) != 0:
            raise SystemExit("the sheets were not made")
        for source, target, width in (
            ("M-34-64-D-c.pdf", "sheet-series.jpg", 1400),
            ("index.pdf", "sheet-index.jpg", 700),
        ):
            page = pypdfium2.PdfDocument(folder / "out" / source)[0].render(scale=2.5).to_pil().convert("RGB")
            page = page.resize((width, round(page.height * width / page.width)), Image.Resampling.LANCZOS)
            page.save(IMAGES / target, quality=82)


if __name__ == "__main__":
    main()
