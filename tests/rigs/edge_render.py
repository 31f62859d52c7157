"""Roads over fields, seen by the photos of `edge_rig`, and mosaics of them with a hard seam."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from edge_rig import CORNER, SIZE, Rig, seam
from scipy.interpolate import RectBivariateSpline

from geomosaic.block import OrientedBlock
from geomosaic.inputs.area import plan
from geomosaic.mosaicking.mosaic import mosaic
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import MosaicOptions

HALF_WIDTH = 2.5
"""Metres of a road, and pixels."""


def roads(count: int) -> np.ndarray:
    """Map y of roads from west to east: through each common point, and half-way between."""
    at_points = seam(0, count)[:, 1]
    return np.sort(np.concatenate([at_points, (at_points[1:] + at_points[:-1]) / 2.0]))[::-1]


def colour(xy: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Brightness (N,): fields with a slow pattern, roads as bright Gaussian stripes."""
    x, y = (xy - CORNER).T
    fields = 70.0 + 14.0 * np.sin(x / 37.0) * np.sin(y / 53.0) + 8.0 * np.sin((x + 2.0 * y) / 110.0)
    nearest = np.abs(y[:, None] + CORNER[1] - lines).min(axis=1)
    return fields + 150.0 * np.exp(-0.5 * (nearest / HALF_WIDTH) ** 2)


def photographs(r: Rig, lines: np.ndarray, folder: Path, strip: int = 650) -> list[Path]:
    """Write what each photo sees near the seam; the rest of it is left black."""
    paths = []
    for truth, photo in zip(r.truths, r.photos, strict=True):
        first = SIZE[0] - strip if truth.index == 0 else 0
        columns, rows = np.arange(first, first + strip) + 0.5, np.arange(SIZE[1]) + 0.5
        # The inverse every ten pixels and a bicubic spline through it: 1e-6 px, in a hundredth of the time.
        some_c, some_r = (
            np.linspace(columns[0], columns[-1], strip // 10),
            np.linspace(rows[0], rows[-1], SIZE[1] // 10),
        )
        c, w = np.meshgrid(some_c, some_r)
        exact = truth.inverse(np.column_stack([c.ravel(), w.ravel()])).reshape(*c.shape, 2)
        xy = np.dstack([RectBivariateSpline(some_r, some_c, exact[..., k])(rows, columns) for k in (0, 1)])
        values = colour(xy.reshape(-1, 2), lines).reshape(xy.shape[:2])
        image = np.zeros((SIZE[1], SIZE[0]), dtype=np.uint8)
        image[:, first : first + strip] = np.round(values)
        paths.append(folder / f"{photo.name}.tif")
        profile = {"driver": "GTiff", "width": SIZE[0], "height": SIZE[1], "count": 1, "dtype": "uint8"}
        with rasterio.open(paths[-1], "w", **profile) as file:
            file.write(image, 1)
    return paths


def joined(
    r: Rig, models: Any, paths: list[Path], output: Path, reach: float = 120.0
) -> tuple[np.ndarray, np.ndarray, Any]:
    """Mosaic around the seam with the given models: values, which photo, and the transform."""
    scenes = tuple(replace(p, path=str(f), model=m) for p, f, m in zip(r.photos, paths, models, strict=True))
    middle = seam(0, 3)[:, 0].mean()
    bounds = (middle - reach, CORNER[1] - SIZE[1] + 60.0, middle + reach, CORNER[1] - 60.0)
    grid, outlines = plan(scenes, None, Area("EPSG:32633", 1.0, bounds))
    options = MosaicOptions.of(
        resampling="cubic",
        driver="GTiff",
        overwrite=True,
        feather=0.0,
        balance=False,
        vectors=False,
    )
    made = mosaic(OrientedBlock(scenes, None), grid, outlines, output, options)
    with rasterio.open(made.path) as values, rasterio.open(made.labels) as labels:
        return values.read(1).astype(float), labels.read(1), values.transform


def shifts(values: np.ndarray, labels: np.ndarray, transform: Any, lines: np.ndarray) -> np.ndarray:
    """Jump (K,) of each road along the seam in pixels: where it is right of the seam minus left of it.

    Straight lines through its centres of brightness in 24 columns on either side, carried on to the seam.
    """
    jumps = []
    for line in lines:
        row = (transform.f - line) - 0.5
        near = round(row)
        edge = int(np.argmax(labels[near] == 2))  # first column of the second photo
        assert (labels[near, edge - 30 : edge] == 1).all()
        assert (labels[near, edge : edge + 30] == 2).all()
        at = []
        for columns in (np.arange(edge - 26, edge - 2), np.arange(edge + 2, edge + 26)):
            rows = np.arange(near - 16, near + 17)
            part = values[np.ix_(rows, columns)]
            bright = np.clip(part - np.median(part, axis=0) - 25.0, 0.0, None)
            centres = (bright * rows[:, None]).sum(axis=0) / bright.sum(axis=0)
            at.append(np.polyval(np.polyfit(columns - (edge - 0.5), centres, 1), 0.0))
        jumps.append(at[1] - at[0])
    return np.array(jumps)
