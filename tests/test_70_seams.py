"""Seams by likeness through the whole pipe: what two images show differently comes from one of them, whole."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine

from geomosaic.cli.main import run
from geomosaic.raster.vector import read_layer

LEFT, TOP, WIDTH, HEIGHT, STEP = 500_000.0, 5_500_000.0, 600, 420, 300
HOUSE = (410, 180, 480, 250)
"""Columns and rows of the ground: across the line halfway between both centres, at column 450."""


def tile(path: Path, col: int, house: int) -> Path:
    rng = np.random.default_rng(0)
    ground = rng.integers(90, 110, (3, HEIGHT, WIDTH + STEP), dtype=np.uint8)
    left, top, right, bottom = HOUSE
    ground[:, top:bottom, left:right] = house
    profile = {"driver": "GTiff", "width": WIDTH, "height": HEIGHT, "count": 3, "dtype": "uint8", "crs": "EPSG:32631"}
    with rasterio.open(path, "w", transform=Affine(1.0, 0.0, LEFT + col, 0.0, -1.0, TOP), **profile) as dataset:
        dataset.write(ground[:, :, col : col + WIDTH])
    return path


@pytest.fixture
def tiles(tmp_path) -> list[Path]:
    return [tile(tmp_path / "a.tif", 0, 220), tile(tmp_path / "b.tif", STEP, 20)]


@pytest.fixture
def tell(capsys) -> Callable[..., tuple[int, str, str]]:
    def call(*words: object) -> tuple[int, str, str]:
        capsys.readouterr()
        code = run([str(word) for word in words])
        return code, *capsys.readouterr()

    return call


def house(path: Path) -> np.ndarray:
    """What the mosaic shows of the house, without its rim."""
    with rasterio.open(path) as dataset:
        (c0, r0), (c1, r1) = (~dataset.transform @ (LEFT + c, TOP - r) for c, r in (HOUSE[:2], HOUSE[2:]))
        return dataset.read()[:, round(r0) + 2 : round(r1) - 2, round(c0) + 2 : round(c1) - 2]


def test_a_house_comes_from_one_image(tell, tiles, tmp_path):
    options = ("--res", 1, "--no-balance", "--feather", 6)
    for seams, whole in (("nearest", False), ("alike", True)):
        out = tmp_path / f"{seams}.tif"
        code, said, _ = tell("mosaic", *tiles, *options, "--seams", seams, "-o", out, "--json", "--threads", 1)
        assert code == 0
        assert (len(np.unique(house(out))) == 1) == whole
        assert json.loads(said)["valid_pixels"] == HEIGHT * (WIDTH + STEP)
    again = tmp_path / "again.tif"
    assert tell("mosaic", *tiles, *options, "--seams", "alike", "-o", again, "--threads", 3)[0] == 0
    assert hashlib.sha256(again.read_bytes()).digest() == hashlib.sha256((tmp_path / "alike.tif").read_bytes()).digest()


def test_the_shares_divide_the_footprints_among_them(tell, sample, tmp_path):
    out = tmp_path / "m.tif"
    words = [
        "--sensor", "frame", "--camera", sample / "camera.toml", "--exterior", sample / "exterior.csv",
        "--crs", "EPSG:32633", "--heights", "egm96", "--dem", sample / "dem.tif", "--res", 4, "--seams", "alike",
    ]  # fmt: skip
    assert tell("mosaic", *sorted((sample / "photos").glob("*.jpg")), *words, "-o", out)[0] == 0
    shares, prints = (read_layer(out.with_suffix(".gpkg"), name) for name in ("seams", "footprints"))
    everything = shapely.union_all(prints.geometry)
    assert all(share.is_valid for share in shares.geometry)
    assert shares.area.sum() == pytest.approx(shapely.union_all(shares.geometry).area, rel=1e-9)
    assert shares.area.sum() == pytest.approx(everything.area, rel=2e-3)  # corners cut where footprints meet
    assert shapely.union_all(shares.geometry).difference(everything).area < 1e-6 * everything.area
    # Each image shows its share, but for the cells that a simplified border cuts.
    by_image = dict(zip(prints["image"], prints.geometry, strict=True))
    beyond = sum(
        share.difference(by_image[name]).area for name, share in zip(shares["image"], shares.geometry, strict=True)
    )
    assert beyond < 0.002 * everything.area
    lines = read_layer(out.with_suffix(".gpkg"), "seamlines")
    assert len(lines) >= 11
