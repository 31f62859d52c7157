"""A sensor of someone else: a wheel, installed, and used through every door by a process that knows only that."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

pytestmark = pytest.mark.ci

ROOT = Path(__file__).resolve().parent.parent
SAMPLE = ROOT / "tests" / "sample_plugin"
PLACE, FOCAL, SIZE = (500000.0, 5500000.0, 1000.0), 800.0, (900, 700)


class Failed(Exception):
    """A command that failed: its exit code and what it said."""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder that the wheel of the sample was installed into; nothing is fetched."""
    pytest.importorskip("hatchling", reason="wheels are built with hatchling, which the extra 'test' brings")
    base = tmp_path_factory.mktemp("wheel")
    quiet = ["--quiet", "--disable-pip-version-check", "--no-index", "--no-deps"]
    pip = [sys.executable, "-m", "pip"]
    wheels, target = base / "wheels", base / "site"
    subprocess.run(
        [*pip, "wheel", *quiet, "--no-build-isolation", "-w", str(wheels), str(SAMPLE)], check=True, cwd=base
    )
    (wheel,) = wheels.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        assert "geomosaic_sample_vertical.py" in file.namelist()
    subprocess.run([*pip, "install", *quiet, "--target", str(target), str(wheel)], check=True, cwd=base)
    return target


def python(installed: Path, *arguments: str, cwd: Path) -> str:
    """Standard output of a Python that has the wheel on its path, and not the sample's source."""
    path = os.pathsep.join([str(installed), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, cwd=cwd, env={**os.environ, "PYTHONPATH": path}
    )
    if done.returncode:
        raise Failed(done.returncode, done.stderr)
    return done.stdout


def geomosaic(installed: Path, *arguments: str, cwd: Path) -> str:
    return python(installed, "-m", "geomosaic.cli", *arguments, cwd=cwd)


def refused(installed: Path, *arguments: str, cwd: Path) -> str:
    """Standard error of a command that fails as a user's error does."""
    with pytest.raises(Failed) as caught:
        geomosaic(installed, *arguments, cwd=cwd)
    assert caught.value.args[0] == 1
    return str(caught.value.args[1])


def test_it_is_listed_and_described(installed: Path, tmp_path: Path) -> None:
    assert "vertical" in geomosaic(installed, "sensors", cwd=tmp_path)
    told = geomosaic(installed, "sensors", "vertical", cwd=tmp_path)
    assert "focal_length_px" in told
    where = python(installed, "-c", "import geomosaic_sample_vertical as m; print(m.__file__)", cwd=tmp_path)
    assert Path(where.strip()).parent == installed


def test_the_readme_runs(installed: Path, tmp_path: Path) -> None:
    """Found and adjusted, as the page says: the position comes back from 50 m off."""
    page = (ROOT / "docs" / "sensors.md").read_text(encoding="utf-8")
    example = next(e for e in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "sensors()" in e)
    out = python(installed, "-c", example, cwd=tmp_path)
    numbers = [float(word) for word in re.findall(r"-?\d+\.?\d*", out)]
    assert np.allclose(numbers[:3], PLACE, atol=1e-4)
    assert np.allclose(numbers[3:6], [500000.0, 5500000.0, 50.0], atol=1e-6)


def test_it_passes_the_kit(installed: Path, tmp_path: Path) -> None:
    """The tests of the kit, run by pytest in a folder of their own, as its author would."""
    page = (ROOT / "docs" / "sensors.md").read_text(encoding="utf-8")
    example = next(e for e in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "SensorModelTests" in e)
    (tmp_path / "test_vertical.py").write_text(example)
    (tmp_path / "pytest.ini").write_text(
        "[pytest]\nfilterwarnings = error\n    ignore::DeprecationWarning:rasterio.*\n"
    )
    out = python(installed, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_vertical.py", cwd=tmp_path)
    passed = re.search(r"(\d+) passed", out)
    assert passed
    assert int(passed[1]) > 8
    assert "failed" not in out


def test_an_ortho_a_place_and_an_adjustment(installed: Path, tmp_path: Path) -> None:
    """A picture rendered by a formula comes out where it belongs, on a slope; one place of it is located alike."""

    def slope(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 40.0 + 0.1 * (x - PLACE[0]) - 0.05 * (y - PLACE[1])

    def picture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 128.0 + 60.0 * np.sin((x - PLACE[0]) / 17.0) + 60.0 * np.sin((y - PLACE[1]) / 23.0)

    col, row = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    u, v = (col - SIZE[0] / 2) / FOCAL, (SIZE[1] / 2 - row) / FOCAL
    depth = (PLACE[2] - 40.0) / (1.0 + 0.1 * u - 0.05 * v)  # where the ray meets the slope
    x, y = PLACE[0] + u * depth, PLACE[1] + v * depth
    profile = {"driver": "GTiff", "count": 1}
    with rasterio.open(tmp_path / "photo.tif", "w", width=SIZE[0], height=SIZE[1], dtype="uint8", **profile) as file:
        file.write(np.round(picture(x, y)).astype(np.uint8), 1)
    e, n = np.meshgrid(499005.0 + 10.0 * np.arange(200), 5500995.0 - 10.0 * np.arange(200))
    grid = {"width": 200, "height": 200, "crs": 32633, "transform": Affine(10, 0, 499000, 0, -10, 5501000)}
    with rasterio.open(tmp_path / "dem.tif", "w", dtype="float64", **grid, **profile) as file:
        file.write(slope(e, n), 1)
    sensor = ["--sensor", "vertical", "--crs", "EPSG:32633", "--heights", "ellipsoidal",
              "--option", f"position={json.dumps(PLACE)}", "--option", f"focal_length_px={FOCAL}",
              "--dem", "dem.tif", "--dem-heights", "ellipsoidal"]  # fmt: skip
    area = ["--res", "2", "--bounds", "499600", "5499700", "500400", "5500300"]
    geomosaic(installed, "ortho", "photo.tif", *sensor, *area, "-o", "ortho.tif", cwd=tmp_path)
    with rasterio.open(tmp_path / "ortho.tif") as file:
        made = file.read(1).astype(float)
        valid = file.read_masks(1) > 0
    e, n = np.meshgrid(499601.0 + 2.0 * np.arange(400), 5500299.0 - 2.0 * np.arange(300))
    assert valid.mean() > 0.95
    assert np.abs(made - picture(e, n))[valid].max() < 4.0  # 4.4 grey values per metre at the steepest
    sigmas = [word for name in "xyz" for word in ("--sigma", f"{name}=0.2")]
    undeclared = [word for word in sensor if word not in ("--heights", "ellipsoidal", "--dem-heights")]
    heights = ["--dem-heights", "ellipsoidal"]
    failed = refused(installed, "ortho", "photo.tif", *undeclared, *heights, *area, "-o", "no.tif", cwd=tmp_path)
    assert re.search(r"'vertical' have no vertical datum.* differ by 45.\d m here \(up to \d+ px", failed)
    told = geomosaic(
        installed, "locate", "photo.tif", *sensor, *sigmas, "--pixel", "200.5", "100.5", "--json", cwd=tmp_path
    )
    (point,) = json.loads(told)["points"]
    assert np.allclose([point["x"], point["y"]], [x[100, 200], y[100, 200]], atol=1e-6)
    assert 0.19 < point["semi_minor_m"] < point["semi_major_m"] < 0.3


def test_a_project_adjusts_it(installed: Path, tmp_path: Path) -> None:
    """The example that is shown runs as it is shown; with the position 60 m off, control points bring it back."""
    shown = json.loads(geomosaic(installed, "sensors", "vertical", "--json", cwd=tmp_path))["example"]
    (width, height), project = shown["size"], shown["project"]
    with rasterio.open(
        tmp_path / "image.tif", "w", driver="GTiff", count=1, width=width, height=height, dtype="uint8"
    ) as file:
        file.write(np.arange(width * height, dtype=np.uint8).reshape(1, height, width))
    (tmp_path / "project.toml").write_text(project)
    geomosaic(installed, "run", "project.toml", cwd=tmp_path)
    assert (tmp_path / "output" / "mosaic.tif").exists()
    ground = [(499800.0, 5499850.0, 300.0), (500250.0, 5500200.0, 340.0), (500200.0, 5499900.0, 280.0)]
    rows = [
        f"p{i},{x},{y},{z},image.tif,{500 + 1000 * (x - 5e5) / (1300 - z)!r},{400 - 1000 * (y - 55e5) / (1300 - z)!r}"
        for i, (x, y, z) in enumerate(ground)
    ]
    (tmp_path / "gcps.csv").write_text("\n".join(["id,x,y,z,image,col,row", *rows]) + "\n")
    moved = project.replace("[500000.0, 5500000.0, 1300.0]", "[500050.0, 5499980.0, 1330.0]")
    (tmp_path / "project.toml").write_text(f'{moved}\n[control]\nfile = "gcps.csv"\n')
    geomosaic(installed, "run", "project.toml", cwd=tmp_path)
    state = json.loads((tmp_path / "output" / "models" / "image.tif.json").read_text())["state"]
    assert np.allclose(state["centre"], [500000.0, 5500000.0, 1300.0], atol=1e-5)
