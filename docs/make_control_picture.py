"""The picture of docs/georeferencing.md: a scanned map of synthetic land, its control, and the control report.

Run it with an empty folder; the scan, the table and the report stay there. The picture needs a Chromium browser.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from make_pictures import BROWSERS, IMAGES
from PIL import Image

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.georeferencing.run import georeference
from geomosaic.testing.synthetic import AnalyticGround

SIZE, PIXEL, MIDDLE = (1200, 840), 0.9, (400000.0, 5500000.0)


def to_map(colrow: np.ndarray) -> np.ndarray:
    """Sheet of paper on a scanner: turned by 4°, shrunk by 0.3 % across, wavy by some pixels."""
    u, v = (colrow / SIZE - 0.5).T
    c, r = ((colrow - np.array(SIZE) / 2) * PIXEL).T
    c = 1.003 * c + PIXEL * (7 * u * v + 5 * v**2)
    r = r + PIXEL * (6 * u**2 - 4 * u * v)
    angle = np.radians(4.0)
    return np.column_stack([c * np.cos(angle) + r * np.sin(angle), c * np.sin(angle) - r * np.cos(angle)]) + MIDDLE


def scan(folder: Path) -> Path:
    """Draw the sheet as the scanner sees it."""
    ground = AnalyticGround(with_heights(parse_crs("EPSG:32633"), "ellipsoidal"), origin=MIDDLE, wavelength=2 * PIXEL)
    rows = []
    for row in range(SIZE[1]):
        places = np.column_stack([np.arange(SIZE[0]) + 0.5, np.full(SIZE[0], row + 0.5)])
        rows.append(ground.texture(to_map(places)))
    picture = (np.clip(np.stack(rows), 0, 1) * 255).astype(np.uint8)
    Image.fromarray(picture).save(folder / "sheet.png")
    return folder / "sheet.png"


def table(folder: Path) -> Path:
    """Write 20 control and 5 check points, measured within 0.4 px; one was typed in wrong."""
    random = np.random.default_rng(12)
    c, r = np.meshgrid(np.linspace(0.05, 0.95, 5), np.linspace(0.06, 0.94, 5))
    colrow = np.column_stack([c.ravel(), r.ravel()]) * SIZE + random.uniform(-30, 30, (25, 2))
    measured = colrow + random.normal(0, 0.4, colrow.shape)
    xy = to_map(colrow)
    xy[8, 0] += 10.0
    lines = ["#CRS: EPSG:32633", "id,x,y,col,row,role"]
    for i in range(25):
        role = "check" if i in (6, 10, 12, 14, 18) else "control"
        lines.append(f"{i + 1},{xy[i, 0]:.2f},{xy[i, 1]:.2f},{measured[i, 0]:.2f},{measured[i, 1]:.2f},{role}")
    (folder / "points.csv").write_text("\n".join(lines) + "\n")
    return folder / "points.csv"


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    made = georeference(scan(folder), folder / "map.tif", table(folder), model="auto", robust=True)
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is not None and made.page is not None:
        shot = folder / "page.png"
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--window-size=1240,1240"]
        page = made.page.resolve().as_uri()
        subprocess.run([browser, *options, f"--screenshot={shot}", page], check=True, capture_output=True)
        Image.open(shot).convert("RGB").save(IMAGES / "control-report.jpg", quality=86)
