"""The example of the textbook's section 9-3 through the pipe: 9 × 9 groundels from an 8 × 8 image, 0 outside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS

from geomosaic.block import OrientedImage
from geomosaic.geo.grid import Grid
from geomosaic.options.render import RenderOptions
from geomosaic.render.extent import footprints
from geomosaic.render.ortho import ortho
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.registry import build

MAP = CRS.from_epsg(32633)
GROUND = np.array([[20.4, 30.6], [70.1, 24.9], [37.1, 89.3], [75.8, 74.4]])
PIXELS = np.array([[1, 6], [6, 6], [2, 0], [6, 1]])
"""Column and row by pixel centres, as Table 9-1 prints them."""
CENTRES = np.arange(10.0, 100.0, 10.0)


def by_the_book() -> tuple[np.ndarray, np.ndarray]:
    """Parameters a, b, TX, TY of equations (9-2) by normal equations, and column and row (9, 9, 2), north up."""
    design, right = [], []
    for (x, y), (col, row) in zip(GROUND, PIXELS, strict=True):
        design += [[x, -y, 1, 0], [y, x, 0, 1]]
        right += [col, 7 - row]
    matrix = np.array(design)
    a, b, tx, ty = np.linalg.solve(matrix.T @ matrix, matrix.T @ np.array(right))
    x, y = np.meshgrid(CENTRES, CENTRES[::-1])
    return np.array([a, b, tx, ty]), np.dstack([a * x - b * y + tx, 7 - (a * y + b * x + ty)])


def test_the_books_numbers() -> None:
    parameters, colrow = by_the_book()
    np.testing.assert_allclose(parameters, [0.0992, 0.0115, -0.666, -2.270], rtol=0.0, atol=5e-4)
    np.testing.assert_allclose(colrow[4, 3], [2.73, 3.85], rtol=0.0, atol=0.005)  # point p, x = 40, y = 50
    assert colrow[8, 0, 1] == pytest.approx(8.16, abs=0.005)  # x = y = 10: beyond row 7


@pytest.mark.parametrize("nodata", [None, 0.0])
def test_nine_by_nine_groundels(tmp_path: Path, nodata: float | None) -> None:
    image = np.arange(1, 65, dtype=np.uint8).reshape(8, 8)
    path = tmp_path / "scan.tif"
    with rasterio.open(path, "w", driver="GTiff", width=8, height=8, count=1, dtype="uint8") as file:
        file.write(image, 1)
    points = [{"x": x, "y": y, "col": c + 0.5, "row": r + 0.5} for (x, y), (c, r) in zip(GROUND, PIXELS, strict=True)]
    model = build("planar", SensorRequest("scan", (8, 8), {"kind": "conformal", "points": points}, MAP))
    grid = Grid(MAP, Affine(10.0, 0.0, 5.0, 0.0, -10.0, 95.0), 9, 9)
    scene = OrientedImage("scan", str(path), "planar", model)
    outline = footprints((scene,), None, MAP)[0]
    made = ortho(
        scene,
        None,
        grid,
        outline,
        tmp_path / "map.tif",
        RenderOptions(resampling="nearest", driver="GTiff", nodata=nodata),
    )
    colrow = np.rint(by_the_book()[1]).astype(int)
    inside = ((colrow >= 0) & (colrow <= 7)).all(axis=2)
    held = np.clip(colrow, 0, 7)
    expected = np.where(inside, image[held[:, :, 1], held[:, :, 0]], 0)
    with rasterio.open(made.path) as file:
        values = file.read(1)
    np.testing.assert_array_equal(values, expected)
    assert values[4, 3] == image[4, 3]  # p takes the pixel of column 3, row 4
    assert values[8, 0] == 0
    assert 0 < np.count_nonzero(values == 0) < 40
