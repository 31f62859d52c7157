"""Histogram matching through the whole pipe: tiles of known exposures become one picture of the ground."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

LEFT, TOP, SIZE, STEP = 500_000.0, 5_500_000.0, 300, 180
BENDS: list[Callable[[np.ndarray], np.ndarray]] = [
    lambda v: v,
    lambda v: 255 * (v / 255) ** 0.75,
    lambda v: 20 + 0.8 * v,
]


def ground(cols: np.ndarray, rows: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(3)
    bands = [
        120 + 55 * np.sin(a * cols + b * rows) + 25 * np.cos(c * cols - 2 * b * rows) + 0.03 * cols
        for a, b, c in rng.uniform(0.02, 0.09, (3, 3))
    ]
    return np.stack(bands)


def tile(path: Path, col: int, bend: Callable[[np.ndarray], np.ndarray], width: int = SIZE) -> Path:
    c, r = np.meshgrid(np.arange(col, col + width) + 0.5, np.arange(SIZE) + 0.5)
    transform = Affine(1.0, 0.0, LEFT + col, 0.0, -1.0, TOP)
    profile = {"driver": "GTiff", "width": width, "height": SIZE, "count": 3, "dtype": "uint8", "crs": "EPSG:32631"}
    with rasterio.open(path, "w", transform=transform, **profile) as dataset:
        dataset.write(np.round(bend(ground(c, r))).astype(np.uint8))
    return path


@pytest.fixture
def tiles(tmp_path) -> list[Path]:
    return [tile(tmp_path / f"t{i}.tif", i * STEP, bend) for i, bend in enumerate(BENDS)]


def miss(path: Path) -> np.ndarray:
    """Mosaic minus ground, (3, rows, cols)."""
    with rasterio.open(path) as dataset:
        values, transform = dataset.read().astype(np.float64), dataset.transform
    c, r = np.meshgrid(np.arange(values.shape[2]) + 0.5, np.arange(values.shape[1]) + 0.5)
    x, y = transform @ (c, r)
    return values - ground(x - LEFT, TOP - y)


def test_over_the_overlaps_from_a_master(tell, tiles, tmp_path):
    plain, out = tmp_path / "plain.tif", tmp_path / "matched.tif"
    assert tell("mosaic", *tiles, "--res", 1, "--no-balance", "-o", plain)[0] == 0
    code, said, _ = tell(
        "mosaic", *tiles, "--res", 1, "--histogram", "overlap", "--master", "t0", "-o", out, "--json", "--threads", 1
    )
    assert code == 0
    facts = json.loads(said)
    assert max(facts["overlap_difference_after"]) < 0.1 * min(facts["overlap_difference_before"])
    assert np.abs(miss(plain)).mean() > 9
    assert np.abs(miss(out)).mean() < 0.8
    assert np.quantile(np.abs(miss(out)), 0.999) < 6
    other = tmp_path / "threads.tif"
    assert (
        tell("mosaic", *tiles, "--res", 1, "--histogram", "overlap", "--master", "t0", "-o", other, "--threads", 3)[0]
        == 0
    )
    assert hashlib.sha256(out.read_bytes()).digest() == hashlib.sha256(other.read_bytes()).digest()


def test_to_a_reference_raster(tell, tiles, tmp_path):
    reference = tile(tmp_path / "reference.tif", -50, lambda v: v, 2 * STEP + SIZE + 100)
    for method in ("overlap", "whole"):
        out = tmp_path / f"{method}.tif"
        assert tell("mosaic", *tiles, "--res", 1, "--histogram", method, "--reference", reference, "-o", out)[0] == 0
        worst = 0.8 if method == "overlap" else 12.0  # whole: the tiles do not show what the reference shows
        assert np.abs(miss(out)).mean() < worst
    assert np.abs(miss(tmp_path / "overlap.tif")).mean() < np.abs(miss(tmp_path / "whole.tif")).mean()


def test_a_stranger_is_named_and_left_as_it_is(tell, tiles, tmp_path):
    far = tile(tmp_path / "far.tif", 2000, lambda v: v / 2)
    code, _, err = tell(
        "mosaic", tiles[0], tiles[1], far, "--res", 2, "--histogram", "overlap", "-o", tmp_path / "o.tif"
    )
    assert code == 0
    assert "no overlaps join far" in err


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--no-balance", "--master", "t0"), 1, "leave out --master"),
        (("--histogram", "overlap", "--master", "tt0.tif"), 1, "did you mean"),
        (("--histogram", "sideways"), 2, "sideways"),
        (("--histogram", "whole", "--reference", "grey.tif"), 1, "bands"),
    ],
)
def test_what_cannot_be_matched(tell, tiles, tmp_path, monkeypatch, words, code, said):
    monkeypatch.chdir(tmp_path)
    with rasterio.open(tiles[0]) as dataset:
        profile, values = {**dataset.profile, "count": 1}, dataset.read(1)
    with rasterio.open("grey.tif", "w", **profile) as dataset:
        dataset.write(values, 1)
    got, _, err = tell("mosaic", *tiles, *words, "-o", "o.tif")
    assert got == code
    assert said in err.lower()
    assert not Path("o.tif").exists()


@pytest.mark.parametrize(("width", "height", "step"), [(600, 300, 400), (600, 600, 300)])
@pytest.mark.parametrize("resolution", [1, 1.5, 2])
def test_crops_of_one_noisy_image_are_compared_pixel_by_pixel(tell, tmp_path, width, height, step, resolution):
    """Centres of cells of two or four pixels lie on corners of pixels, where rounding chose what each crop shows."""
    noise = np.random.default_rng(1).integers(0, 256, (height, width + step), dtype=np.uint8)
    crops = [tmp_path / f"crop{k}.tif" for k in range(2)]
    profile = {"driver": "GTiff", "width": width, "height": height, "count": 1, "dtype": "uint8", "crs": "EPSG:32631"}
    for k, path in enumerate(crops):
        transform = Affine(1.0, 0.0, LEFT + k * step, 0.0, -1.0, TOP)
        with rasterio.open(path, "w", transform=transform, **profile) as dataset:
            dataset.write(noise[:, k * step : k * step + width], 1)
    shown = []
    for words in (("--histogram", "overlap"), ("--no-balance",)):
        code, said, err = tell(
            "mosaic", *crops, *words, "--res", resolution, "--json", "-o", tmp_path / "m.tif", "--overwrite"
        )
        assert code == 0, err
        with rasterio.open(tmp_path / "m.tif") as dataset:
            shown.append((dataset.read(), json.loads(said)))
    assert shown[0][1]["overlap_difference_before"] == [0.0]
    assert np.array_equal(shown[0][0], shown[1][0])
