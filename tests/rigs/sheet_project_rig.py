"""A project with a small mosaic and a layout of a sheet, nothing of it run."""

from __future__ import annotations

from pathlib import Path

import geopandas
import numpy as np
import shapely
from sheet_rig import LEFT, TOP, write
from studio_rig import write_project

LAYOUT = """\
# made by hand
[sheet]
title = "Old title"   # what stands above the map
paper = "A4"

[grid]
interval = 200.0

# roads last
[[layer]]
file = "roads.gpkg"
style = "road"
"""


def sheet_project(folder: Path) -> Path:
    """Project file; beside it `wall.toml`, the layout, and `roads.gpkg`."""
    project = write_project(folder)
    y, x = np.mgrid[0:250, 0:300]
    values = np.stack([70 + 40 * np.sin(x / 17), 110 + 30 * np.cos(y / 23), 60 + 20 * np.sin((x + y) / 31)])
    (folder / "output").mkdir()
    write(folder / "output" / "scan.tif", values.astype(np.uint8), "EPSG:32633", 4.0)
    road = shapely.LineString([(LEFT + 100, TOP - 500), (LEFT + 600, TOP - 380), (LEFT + 1100, TOP - 700)])
    geopandas.GeoDataFrame({"name": ["Long Street"]}, geometry=[road], crs="EPSG:32633").to_file(folder / "roads.gpkg")
    (folder / "wall.toml").write_text(LAYOUT)
    return project
