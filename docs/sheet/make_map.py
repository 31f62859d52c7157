"""Vectors of the sample: river and roads as the analytic ground has them, and its control points.

python docs/sheet/make_map.py SAMPLE/gcps.csv map.gpkg
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
import shapely

from geomosaic.geo.crs import parse_crs
from geomosaic.raster.vector import Layer, write_layers
from geomosaic.testing.synthetic.relief import river

ORIGIN = np.array([400_000.0, 5_500_000.0])
ROADS = (
    # amplitude, wavelength / 2 pi, phase, offset (m), northward, class, name
    (34.0, 260.0, 0.7, -560.0, True, "track", ""),
    (42.0, 310.0, 2.0, 560.0, False, "track", "Upper Track"),
    (26.0, 300.0, 1.1, -470.0, False, "track", "Mill Track"),
    (70.0, 520.0, 2.4, 240.0, False, "main", "Valley Road"),
    (48.0, 430.0, 0.3, 190.0, True, "main", "Bridge Street"),
)


def make(gcps: Path, out: Path) -> None:
    """Write the layers `water`, `roads` and `points`."""
    crs = parse_crs("EPSG:32633")
    along = np.linspace(-1000.0, 1000.0, 401)
    course = shapely.LineString(ORIGIN + np.column_stack([along, river(along)[0]]))
    lines = []
    for amplitude, length, phase, offset, northward, _, _ in ROADS:
        aside = offset + amplitude * np.sin(along / length + phase)
        path = (aside, along) if northward else (along, aside)
        lines.append(shapely.LineString(ORIGIN + np.column_stack(path)))
    points: dict[str, tuple[float, float, str]] = {}
    with gcps.open(newline="") as file:
        for row in csv.DictReader(file):
            points[row["id"]] = (float(row["x"]), float(row["y"]), row["role"])
    write_layers(
        out,
        {
            "water": Layer(crs, "LineString", [course], {"name": ["Sample Brook"]}),
            "roads": Layer(crs, "LineString", lines, {"class": [r[5] for r in ROADS], "name": [r[6] for r in ROADS]}),
            "points": Layer(
                crs,
                "Point",
                [shapely.Point(x, y) for x, y, _ in points.values()],
                {"name": list(points), "role": [role for _, _, role in points.values()]},
            ),
        },
        overwrite=True,
    )


if __name__ == "__main__":
    make(Path(sys.argv[1]), Path(sys.argv[2]))
