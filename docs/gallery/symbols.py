"""Points and lines of the sheet of symbols: every symbol once, named in several scripts."""

from __future__ import annotations

from pathlib import Path

import geopandas
import numpy as np
import shapely

from geomosaic.sheets.pictograms import GROUPS

LEFT, TOP = 398_800.0, 5_501_050.0
COLUMNS, ACROSS, DOWN = 8, 290.0, 250.0
LINES = ("stream", "narrow-gauge", "power-line", "fence", "embankment", "cliff")
# Names in scripts that run from right to left, are joined, or carry marks.
NAMES = {
    "mosque": "الجامع الكبير", "synagogue": "בית הכנסת", "temple": "Ναός", "church": "Церковь", "well": "بئر",
    "castle": "Zámek",
}  # fmt: skip


def write(path: Path, crs: str) -> None:
    """Write the layers `points` and `lines`, with columns `symbol` and `name`."""
    names, points, row = [], [], 0
    for group, members in GROUPS.items():
        if group == "along lines":
            continue
        for k, name in enumerate(members):
            names.append(name)
            x, y = LEFT + 110.0 + ACROSS * (k % COLUMNS), TOP - 150.0 - DOWN * (row + k // COLUMNS)
            points.append(shapely.Point(x, y))
        row += -(-len(members) // COLUMNS)
    shown = [NAMES.get(name, name.replace("-", " ")) for name in names]
    geopandas.GeoDataFrame({"symbol": names, "name": shown}, geometry=points, crs=crs).to_file(path, layer="points")
    along = np.linspace(0.0, 1000.0, 80)
    lines = []
    for k in range(len(LINES)):
        x, y = LEFT + 110.0 + 1150.0 * (k % 2) + along, TOP - 1_480.0 - 200.0 * (k // 2) + 45.0 * np.sin(along / 170.0)
        lines.append(shapely.LineString(np.column_stack([x, y])))
    shown = [name.replace("-", " ") for name in LINES]
    geopandas.GeoDataFrame({"symbol": LINES, "name": shown}, geometry=lines, crs=crs).to_file(path, layer="lines")
