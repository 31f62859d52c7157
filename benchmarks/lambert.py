"""A map in Lambert-93: made, and two reprojections of it held against every pixel computed exactly.

python -m benchmarks.lambert make FOLDER [--small]      makes map.tif, bands.tif (4 bands of 16 bits), and col-row.tif
                                                        that holds its own coordinates
python -m benchmarks.lambert errors RASTER MAP          prints JSON: values of a reprojection of MAP, in grey levels
python -m benchmarks.lambert places RASTER MAP          prints JSON: the same for one of col-row.tif, in pixels of MAP
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from pyproj import Transformer
from rasterio.transform import from_origin
from rasterio.windows import Window

from benchmarks.data import TILED, texture
from benchmarks.projection import Floats
from benchmarks.scene import CENTRE

LAMBERT, UTM = "EPSG:2154", "EPSG:32631"
RESOLUTION = 0.3
CORNER = (575_000.0, 6_281_000.0)
"""Upper left, near Toulouse: 1.5 degrees west of the central meridian of both projections."""

ROWS = 16
"""Every so many rows are compared, whole; a number that is no divisor of a block's side."""


def side(small: bool) -> int:
    """Pixels along a side."""
    return 2500 if small else 10_000


def make(folder: Path, small: bool) -> None:
    """Make what is not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    size = side(small)
    place = from_origin(*CORNER, RESOLUTION, RESOLUTION)
    shape = {"width": size, "height": size, "interleave": "pixel", "crs": LAMBERT, "transform": place}
    if not (folder / "map.tif").exists():
        _write(folder / "map.tif", _colours(size, 3), {**shape, "count": 3, "dtype": "uint8", "photometric": "RGB"})
    if not (folder / "bands.tif").exists():
        _write(folder / "bands.tif", _colours(size, 4, 40), {**shape, "count": 4, "dtype": "uint16"})
    if not (folder / "col-row.tif").exists():
        _write(folder / "col-row.tif", _coordinates(size), {**shape, "count": 2, "dtype": "float32"})


def _write(path: Path, strips: Any, profile: dict[str, Any]) -> None:
    hidden = path.with_suffix(".part")
    with rasterio.open(hidden, "w", **profile, **TILED) as file:
        for first, strip in strips:
            file.write(strip, window=Window(0, first, strip.shape[2], strip.shape[1]))
    hidden.rename(path)


def _colours(size: int, bands: int, scale: int = 1) -> Any:
    """Land of 8 bits with noise of 2 grey levels, or of 16 with as many times of both, in strips."""
    chance = np.random.default_rng(11)
    x = CENTRE[0] + (np.arange(size) + 0.5) * RESOLUTION
    for first in range(0, size, 512):
        y = CENTRE[1] - (np.arange(first, min(first + 512, size)) + 0.5) * RESOLUTION
        here = np.stack([*np.meshgrid(x, y), np.zeros((len(y), size))], axis=-1)
        noise = chance.normal(0, 2, (bands, len(y), size)).astype(np.float32)
        grey = np.clip(np.stack([texture(here, band) for band in range(bands)]) + noise, 0, 255)
        yield first, np.rint(grey * scale).astype(np.uint8 if scale == 1 else np.uint16)


def _coordinates(size: int) -> Any:
    """(col, row) from the image's centre, to keep digits."""
    for first in range(0, size, 512):
        rows = np.arange(first, min(first + 512, size)) + 0.5 - size / 2
        cols = np.arange(size) + 0.5 - size / 2
        yield first, np.stack(np.meshgrid(cols, rows)).astype(np.float32)


def _exact(file: Any, source: Any, row: int) -> tuple[Floats, Floats]:
    """(col, row) in the source of a row of output pixels, through PROJ at every pixel."""
    c = np.arange(file.width) + 0.5
    xy = file.transform @ (c, np.full_like(c, row + 0.5))
    to_source = Transformer.from_crs(file.crs, source.crs, always_xy=True)
    col, line = ~source.transform @ to_source.transform(*xy)
    return col, line


def errors(path: str, source: str) -> dict[str, Any]:
    """Difference of the values from bilinear ones computed in double precision where PROJ says."""
    worst, above, total, count = 0, 0, 0.0, 0
    with rasterio.open(path) as file, rasterio.open(source) as whole:
        values = whole.read().astype(np.int32)
        valid = file.read_masks(1) > 0
        for row in range(0, file.height, ROWS + 1):
            col, line = _exact(file, whole, row)
            inside = (col > 1) & (line > 1) & (col < whole.width - 1) & (line < whole.height - 1) & valid[row]
            i, j = np.floor(col[inside] - 0.5).astype(int), np.floor(line[inside] - 0.5).astype(int)
            u, v = col[inside] - 0.5 - i, line[inside] - 0.5 - j
            top = values[:, j, i] * (1 - u) + values[:, j, i + 1] * u
            low = values[:, j + 1, i] * (1 - u) + values[:, j + 1, i + 1] * u
            true = np.floor(top * (1 - v) + low * v + 0.5)
            shown = file.read(window=Window(0, row, file.width, 1))[:, 0, inside]
            away = np.abs(shown - true)
            worst, above = max(worst, int(away.max(initial=0))), above + int((away > 1).sum())
            total, count = total + float(away.sum()), count + away.size
    return {
        "values": count, "mean_grey": total / count, "max_grey": worst, "share_above_1_grey": above / count,
    }  # fmt: skip


def places(path: str, source: str) -> dict[str, Any]:
    """Distance of what the reprojected coordinates show from what PROJ says, pixels of the source."""
    squares, worst, count = 0.0, 0.0, 0
    with rasterio.open(path) as file, rasterio.open(source) as whole:
        valid = file.read_masks(1) > 0
        for row in range(0, file.height, ROWS + 1):
            col, line = _exact(file, whole, row)
            inside = (col > 1) & (line > 1) & (col < whole.width - 1) & (line < whole.height - 1) & valid[row]
            shown = file.read(window=Window(0, row, file.width, 1))[:, 0, inside].astype(np.float64)
            away = np.hypot(shown[0] + whole.width / 2 - col[inside], shown[1] + whole.height / 2 - line[inside])
            squares, count = squares + float((away**2).sum()), count + len(away)
            worst = max(worst, float(away.max(initial=0.0)))
    return {
        "treatment": "PROJ at every pixel", "pixels": count, "rms_px": float(np.sqrt(squares / count)), "max_px": worst
    }  # fmt: skip


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--small"]
    if words[0] == "make":
        make(Path(words[1]), "--small" in sys.argv)
    else:
        print(json.dumps({"errors": errors, "places": places}[words[0]](words[1], words[2])))
