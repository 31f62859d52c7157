"""Memory of a product, in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import rasterio
from affine import Affine

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


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from /proc")
def test_wide_pixels_of_a_coarse_output_keep_the_least_limit(tmp_path: Path) -> None:
    """A block shows ten times as many columns and rows of four bands of 32 bits: half a gigabyte."""
    source, out = tmp_path / "sparse.tif", tmp_path / "out.tif"
    with rasterio.open(
        source, "w", driver="GTiff", width=3072, height=3072, count=4, dtype="float32", crs="EPSG:32633", tiled=True,
        transform=Affine(1, 0, 499000, 0, -1, 5600000), sparse_ok=True,
    ):  # fmt: skip
        pass
    words = ["reproject", str(source), "--dst-crs", "EPSG:32634", "--res", "14", "--threads", "1", "-o", str(out)]
    call, peaks = [sys.executable, "-c", PEAK, *words, "--mem-limit", "300M", "--overwrite"], []
    # The first run after installing compiles kernels, in memory that no limit holds; the second loads them.
    while len(peaks) < 2 and not any(peak <= 300 for peak in peaks):
        done = subprocess.run(call, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        peaks.append(float(done.stdout.split()[-1]))
    assert peaks[-1] <= 300, peaks


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from /proc")
@pytest.mark.parametrize("command", ["ortho", pytest.param("mosaic", marks=pytest.mark.slow)])
def test_memory_does_not_grow_with_the_output(sample: Path, tmp_path: Path, command: str) -> None:
    limit, fine = 512, 0.14 if command == "ortho" else 0.4
    compiled = "--resampling", "cubic"  # the small one too has work enough for the compiled kernels
    small, few = peak(sample, tmp_path / "out.tif", command, fine * 10**0.5, limit, *compiled)
    large, many = peak(sample, tmp_path / "out.tif", command, fine, limit, *compiled)
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
