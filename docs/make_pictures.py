"""Pictures of the README and the docs, made from the sample: run `geomosaic demo` first, then this with its folder.

The picture of the report needs a Chromium browser on the path; without one it is left as it is.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from geomosaic.raster.pictures import preview

IMAGES = Path(__file__).parent / "images"
SHEET = Path(__file__).parent / "sheet"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


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


def head_of_report(folder: Path) -> Image.Image | None:
    """What a browser shows first of the report."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        return None
    with tempfile.TemporaryDirectory() as scratch:
        shot = Path(scratch) / "report.png"
        report = (folder / "output" / "report.html").resolve().as_uri()
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--window-size=1240,1275"]
        subprocess.run([browser, *options, f"--screenshot={shot}", report], check=True, capture_output=True)
        return Image.open(shot).convert("RGB")


def map_sheet(folder: Path) -> Image.Image:
    """The sheet of `docs/sheet/layout.toml`, of the demo's mosaic, as pixels."""
    from geomosaic.sheets.inputs import sheet

    sys.path.insert(0, str(SHEET))
    from make_map import make

    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        for file in SHEET.glob("*.toml"):
            shutil.copy(file, place)
        shutil.copy(folder / "dem.tif", place)
        make(folder / "gcps.csv", place / "map.gpkg")
        out, report = place / "sheet.png", folder / "output" / "report.json"
        sheet(folder / "output" / "sample.tif", out, layout=place / "layout.toml", report=report, dpi=150)
        return Image.open(out).convert("RGB")


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    demo = Path(sys.argv[1])
    photos_and_mosaic(demo).save(IMAGES / "photos-to-mosaic.jpg", quality=88)
    report_picture = head_of_report(demo)
    if report_picture is not None:
        report_picture.save(IMAGES / "report.jpg", quality=86)
    map_sheet(demo).save(IMAGES / "sheet.jpg", quality=88)
