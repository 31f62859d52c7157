"""Tiles for the web: whole or not at all, each level the mean of the one above it."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
import zipfile
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from affine import Affine
from PIL import Image

from geomosaic.geo.crs import parse_crs
from geomosaic.geo.grid import Grid
from geomosaic.raster.export_formats import SIDE, write_mbtiles, write_web

FULL = """
import resource, sys
from pathlib import Path
import numpy as np
from affine import Affine
from geomosaic.errors import OutputError
from geomosaic.geo.crs import parse_crs
from geomosaic.geo.grid import Grid
from geomosaic.raster.export_formats import write_web

pixels = np.random.default_rng(1).integers(0, 256, (600, 600, 4), dtype=np.uint8)
grid = Grid(parse_crs("EPSG:32633"), Affine(1, 0, 5e5, 0, -1, 5.5e6), 600, 600)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
try:
    write_web(Path(sys.argv[1]), grid, pixels, title="T")
except OutputError as error:
    print("told:", error.what)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="the limit of a file's size is POSIX")
@pytest.mark.parametrize("suffix", ["mbtiles", "kmz"])
def test_a_full_disk_is_reported_and_leaves_nothing(tmp_path: Path, suffix: str) -> None:
    """No file may grow beyond 100 kB: an error, not an empty map."""
    words = [sys.executable, "-c", FULL, str(tmp_path / f"map.{suffix}")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.stdout.startswith("told: writing failed"), done.stderr
    assert list(tmp_path.iterdir()) == []


def test_all_tiles_of_all_levels(tmp_path: Path) -> None:
    """Put together again, each level is the picture it was made of, halved; empty tiles are not there."""
    rng = np.random.default_rng(2)
    pixels = rng.integers(0, 256, (700, 900, 4), dtype=np.uint8)
    pixels[..., 3] = 255 * (rng.uniform(size=(700, 900)) < 0.7)
    pixels[:, 400:] = 0
    level, col, row = 12, SIDE + 100, 3 * SIDE - 30
    write_mbtiles(tmp_path / "a.mbtiles", pixels, level, col, row, title="T")
    base = sqlite3.connect(tmp_path / "a.mbtiles")
    assert base.execute("PRAGMA application_id").fetchone() == (0x4D504258,)
    facts = dict(base.execute("SELECT * FROM metadata"))
    assert (facts["name"], facts["format"], facts["maxzoom"]) == ("T", "png", "12")
    whole = np.zeros((8 * SIDE, 8 * SIDE, 4), dtype=np.float32)
    whole[row : row + 700, col : col + 900] = pixels
    for zoom in range(level, int(facts["minzoom"]) - 1, -1):
        seen = np.zeros_like(whole)
        for x, y, blob in base.execute(
            "SELECT tile_column, tile_row, tile_data FROM tiles WHERE zoom_level=?", (zoom,)
        ):
            tile = np.asarray(Image.open(BytesIO(blob)))
            assert tile[..., 3].any()
            top = (2**zoom - 1 - y) * SIDE
            seen[top : top + SIDE, x * SIDE : (x + 1) * SIDE] = tile
        weight = whole[..., 3:] > 0
        assert np.abs((seen - whole) * weight).max() <= 1.5 * (level - zoom)
        blocks = whole.reshape(len(whole) // 2, 2, len(whole) // 2, 2, 4)
        alpha = blocks[..., 3:].sum(axis=(1, 3))
        mean = (blocks[..., :3] * blocks[..., 3:]).sum(axis=(1, 3)) / np.maximum(alpha, 1)
        whole = np.concatenate([mean, alpha / 4], axis=2)
    base.close()


def test_the_title_of_an_overlay_is_kept(tmp_path: Path) -> None:
    """Capitals and all; GDAL's own name for it would be in capitals only."""
    grid = Grid(parse_crs("EPSG:32633"), Affine(1, 0, 5e5, 0, -1, 5.5e6), 300, 300)
    write_web(tmp_path / "a.kmz", grid, np.full((300, 300, 4), 255, np.uint8), title="Wzgórza & <hills>")
    with zipfile.ZipFile(tmp_path / "a.kmz") as archive:
        root = ElementTree.fromstring(archive.read("doc.kml"))
    assert root.findtext(".//{*}Document/{*}name") == "Wzgórza & <hills>"
