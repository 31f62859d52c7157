"""Memory of a product, in a process of its own."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

pytestmark = pytest.mark.ci

# Not ru_maxrss: on Linux a child starts with the peak of the process that it was forked from.
PEAK = """
import sys
from pathlib import Path
from geomosaic.cli.main import run
code = run(sys.argv[1:])
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
print(int(status["VmHWM"].split()[0]) / 1024)
sys.exit(code)
"""


def peak(sample: Path, out: Path, command: str, resolution: float, limit: int, *more: str) -> tuple[float, int]:
    """Peak resident megabytes of a run of its own, and its output's pixels."""
    images = sorted((sample / "photos").glob("*.jpg"))
    words = [
        command, *map(str, images[: 1 if command == "ortho" else 12]), "--sensor", "frame", "--camera", "camera.toml",
        "--exterior", "exterior.csv", "--crs", "EPSG:32633", "--heights", "egm96", "--dem", "dem.tif",
        "--res", str(resolution), "--mem-limit", f"{limit}M", "--overwrite", "-o", str(out), *more,
    ]  # fmt: skip
    done = subprocess.run([sys.executable, "-c", PEAK, *words], cwd=sample, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    with rasterio.open(out) as file:
        return float(done.stdout.split()[-1]), file.width * file.height


MEASURED = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from /proc")


def keeps_its_least_limit(words: list[str], folder: Path) -> None:
    """Run a command with the least limit that it names when it is refused, once."""
    call = [sys.executable, "-c", PEAK, *words, "--threads", "1", "--overwrite", "--mem-limit"]
    told = subprocess.run([*call, "1M"], cwd=folder, capture_output=True, text=True, timeout=60)
    assert told.returncode == 2, told.stderr
    least = re.search(r"write (\d+)M", told.stderr)
    assert least is not None, told.stderr
    done = subprocess.run([*call, f"{least[1]}M"], cwd=folder, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout.split()[-1]) <= 1.02 * int(least[1])


@MEASURED
def test_wide_pixels_of_a_coarse_output_keep_the_least_limit(tmp_path: Path) -> None:
    """A block shows ten times as many columns and rows of four bands of 32 bits: half a gigabyte."""
    with rasterio.open(
        tmp_path / "sparse.tif", "w", driver="GTiff", width=3072, height=3072, count=4, dtype="float32",
        crs="EPSG:32633", tiled=True, transform=Affine(1, 0, 499000, 0, -1, 5600000), sparse_ok=True,
    ):  # fmt: skip
        pass
    words = ["reproject", "sparse.tif", "--dst-crs", "EPSG:32634", "--res", "14", "-o", "out.tif"]
    keeps_its_least_limit(words, tmp_path)


def over_fine_heights(sample: Path, folder: Path, side: int) -> list[str]:
    """Words of photos over the sample's DEM, each node written `side` times along and across, in compressed strips."""
    with rasterio.open(sample / "dem.tif") as dem:
        heights = np.kron(dem.read(1), np.ones((side, side), dtype=np.float32))
        profile = {"crs": dem.crs, "nodata": dem.nodata, "transform": dem.transform @ Affine.scale(1 / side)}
    with rasterio.open(
        folder / "strips.tif", "w", driver="GTiff", width=heights.shape[1], height=heights.shape[0], count=1,
        dtype="float32", compress="deflate", zlevel=1, blockysize=64, **profile,
    ) as fine:  # fmt: skip
        fine.write(heights, 1)
    return [
        "--sensor", "frame", "--camera", str(sample / "camera.toml"), "--exterior", str(sample / "exterior.csv"),
        "--crs", "EPSG:32633", "--heights", "egm96", "--dem", "strips.tif", "-o", "out.tif",
    ]  # fmt: skip


@MEASURED
def test_heights_that_are_not_read_by_windows_count_under_the_limit(sample: Path, tmp_path: Path) -> None:
    """A DEM of 180 MB in compressed strips, which is decoded from its beginning."""
    photo, words = sample / "photos" / "strip1_01.jpg", over_fine_heights(sample, tmp_path, 16)
    keeps_its_least_limit(["ortho", str(photo), *words, "--res", "2"], tmp_path)


@MEASURED
@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "more"),
    [
        ("ortho", ["--res", "0.3", "--resampling", "lanczos"]),
        ("ortho", ["--res", "0.5", "--true-ortho", "--resampling", "lanczos"]),
        ("mosaic", ["--res", "1"]),
        ("mosaic", ["--res", "1", "--seams", "graph-cut", "--true-ortho"]),
        ("mosaic", ["--res", "1.5", "--seams", "graph-cut", "--blend", "multiband"]),
    ],
)
def test_products_keep_their_least_limits(sample: Path, tmp_path: Path, command: str, more: list[str]) -> None:
    photos = sorted(map(str, (sample / "photos").glob("*.jpg")))[: 1 if command == "ortho" else 12]
    keeps_its_least_limit([command, *photos, *over_fine_heights(sample, tmp_path, 16), *more], tmp_path)


@MEASURED
@pytest.mark.parametrize("command", ["ortho", pytest.param("mosaic", marks=pytest.mark.slow)])
def test_memory_does_not_grow_with_the_output(sample: Path, tmp_path: Path, command: str) -> None:
    limit, fine = 512, 0.14 if command == "ortho" else 0.4
    words = "--resampling", "cubic"
    small, few = peak(sample, tmp_path / "out.tif", command, fine * 10**0.5, limit, *words)
    large, many = peak(sample, tmp_path / "out.tif", command, fine, limit, *words)
    assert many > 9.5 * few
    assert large <= limit, f"{large:.0f} MB ({small:.0f} MB for a tenth of the output)"
    assert large - small < 150, f"{small:.0f} MB to {large:.0f} MB"  # the ten times larger output has up to 270 MB


@pytest.mark.slow
@pytest.mark.parametrize("command", ["ortho", "mosaic"])
def test_memory_of_a_large_output(sample: Path, tmp_path: Path, command: str) -> None:
    limit, fine = 512, 0.07 if command == "ortho" else 0.12
    small, few = peak(sample, tmp_path / "out.tif", command, fine * 10**0.5, limit)
    large, many = peak(sample, tmp_path / "out.tif", command, fine, limit)
    assert many > 9.5 * few
    assert many * 3 > 0.35e9  # three bands of it would not fit beside the program
    assert large <= limit, f"{large:.0f} MB ({small:.0f} MB for a tenth of the output)"
