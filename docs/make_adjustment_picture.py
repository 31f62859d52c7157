"""The picture of docs/adjustment.md: the report of the block in its example, with control and check points.

The picture needs a Chromium browser.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from make_pictures import BROWSERS, IMAGES
from PIL import Image

import geomosaic as gm

PAGE = Path(__file__).parent / "adjustment.md"


def adjusted() -> Any:
    """The example's block, whose measurements now include five control and forty check points."""
    example: dict[str, Any] = {}
    exec(re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1], example)
    ties, xyz = example["ties"], example["xyz"]
    names, counts = np.unique(ties.points, return_counts=True)
    shown = names[counts >= 3]
    places = np.array([xyz[int(name[1:])] for name in shown])
    corners = [np.argmin(places[:, :2] @ way) for way in ([1, 1], [1, -1], [-1, 1], [-1, -1])]
    inner = int(np.argmin(np.linalg.norm(places[:, :2] - places[:, :2].mean(axis=0), axis=1)))
    held = {shown[index] for index in {*map(int, corners), inner}}
    lines = ["id,x,y,z,image,col,row,role"]
    known = held | set([name for name in shown if name not in held][:40])
    for name, image, (col, row) in zip(ties.points, ties.images, ties.colrow, strict=True):
        if name in known:
            place = ",".join(f"{value:.4f}" for value in xyz[int(name[1:])])
            lines.append(f"{name},{place},{image},{col:.3f},{row:.3f},{'control' if name in held else 'check'}")
    table = example["folder"] / "control.csv"
    table.write_text("\n".join(lines) + "\n")
    block = gm.Block(
        example["files"], "frame", camera=gm.Camera(**example["CAMERA"]), exterior=example["first"], control=table,
        crs="EPSG:32633", heights="egm96",
    )  # fmt: skip
    # One gross error, for the report to name.
    colrow = ties.colrow.copy()
    colrow[next(i for i, name in enumerate(ties.points) if name in shown and name not in known)] += [35.0, -20.0]
    wrong = gm.TiePoints(ties.points, ties.images, colrow)
    return gm.adjust(block, ties=wrong, sigma_px=0.3, position_sigma=0.1, attitude_sigma=0.5)


if __name__ == "__main__":
    browser = next(found for name in BROWSERS if (found := shutil.which(name)))
    with tempfile.TemporaryDirectory() as scratch:
        page, shot = Path(scratch) / "page.html", Path(scratch) / "page.png"
        page.write_text(adjusted().page("two strips"), encoding="utf-8")
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--window-size=1240,2560"]
        subprocess.run([browser, *options, f"--screenshot={shot}", page.as_uri()], check=True, capture_output=True)
        picture = Image.open(shot).convert("RGB")
        picture.resize((930, 1920), Image.Resampling.LANCZOS).save(IMAGES / "block-report.jpg", quality=84)
