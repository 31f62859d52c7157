"""Holes of the DEM, and its end: told with the pixels they cost, in words, JSON and report."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio

from geomosaic.cli.main import run

PHOTOS = sorted(p.name for p in (Path(__file__).parent.parent / "data" / "sample" / "photos").glob("*.jpg"))[:2]
RES = 5.0


@pytest.fixture(scope="module")
def folder(sample: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two photos, the DEM, one with a hole of 13 x 9 nodes under the first photo, and one that ends too soon."""
    home = tmp_path_factory.mktemp("holes")
    (home / "photos").mkdir()
    for name in PHOTOS:
        shutil.copy(sample / "photos" / name, home / "photos")
    for name in ("camera.toml", "exterior.csv", "dem.tif"):
        shutil.copy(sample / name, home)
    row = next(line for line in (home / "exterior.csv").read_text().splitlines() if line.startswith(PHOTOS[0][:-4]))
    x, y = (float(value) for value in row.split(",")[1:3])
    with rasterio.open(home / "dem.tif") as file:
        heights, profile, tags = file.read(1), file.profile, file.crs
        at_row, at_col = file.index(x, y)
        assert tags is not None
    holed = heights.copy()
    holed[at_row - 4 : at_row + 5, at_col - 6 : at_col + 7] = -9999.0
    profile.update(nodata=-9999.0)
    with rasterio.open(home / "holed.tif", "w", **profile) as out:
        out.write(holed, 1)
    profile.update(width=at_col)  # the corner stays
    with rasterio.open(home / "ends.tif", "w", **profile) as out:
        out.write(heights[:, :at_col], 1)
    (home / "place.json").write_text(json.dumps([x, y]))
    return home


@pytest.fixture
def made(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[list[str], Path]]:
    def call(command: str, dem: str, *more: str) -> tuple[list[str], Path]:
        photos = [str(folder / "photos" / name) for name in (PHOTOS if command == "mosaic" else PHOTOS[:1])]
        out = tmp_path / f"{command}-{dem}"
        words = [
            command, *photos, "--sensor", "frame", "--camera", str(folder / "camera.toml"), "--exterior",
            str(folder / "exterior.csv"), "--exterior-crs", "EPSG:32633", "--heights", "egm96", "--dem",
            str(folder / dem), "--res", str(RES), "-o", str(out), "--json", *more,
            *(["--no-balance"] if command == "mosaic" else []),
        ]  # fmt: skip
        capsys.readouterr()
        assert run(words) == 0
        return json.loads(capsys.readouterr().out)["notes"], out

    return call


def empty(path: Path) -> np.ndarray:
    with rasterio.open(path) as file:
        return file.dataset_mask() == 0


@pytest.mark.parametrize("command", ["ortho", "mosaic"])
def test_a_dem_gap_is_reported_with_its_pixels_and_its_place(made, folder, command) -> None:
    whole, before = made(command, "dem.tif")
    assert not any("hole" in note for note in whole)
    notes, after = made(command, "holed.tif")
    lost = int((empty(after) & ~empty(before)).sum())
    assert lost > 100
    (note,) = (note for note in notes if "the DEM has holes" in note)
    pixels = int(re.search(r"holes: (\d+) pixels", note).group(1))
    assert abs(pixels - lost) <= 0.02 * lost  # on the hole's edge the kernels' lattice errs some thousandths of a pixel
    x, y = (float(v) for v in re.search(r"about x ([\d.]+), y ([\d.]+);", note).groups())
    assert np.hypot(*(np.array([x, y]) - json.loads((folder / "place.json").read_text()))) < 4 * RES
    assert "gdal_fillnodata" in note


def test_an_image_past_the_end_of_the_dem_is_reported(made) -> None:
    notes, _ = made("ortho", "ends.tif")
    assert any(note.startswith("the image reaches past the heights of the DEM") for note in notes)
    assert not any("holes" in note for note in notes)


def test_the_report_of_a_project_has_it(sample, folder, tmp_path, capsys) -> None:
    home = tmp_path / "block"
    shutil.copytree(folder, home)
    text = (sample / "project.toml").read_text().replace('file = "dem.tif"', 'file = "holed.tif"')
    text = (
        re.sub(r"\[control\]\nfile = .*\n", "", text.partition("[quality]")[0])
        .replace("resolution = 1.0", f"resolution = {2 * RES}")
        .replace("balance = true", "balance = false")
    )
    (home / "project.toml").write_text(text)
    assert run(["run", str(home / "project.toml")]) == 0
    assert "the DEM has holes" in capsys.readouterr().err
    (report,) = (home / "output").glob("*report*.json")
    assert any("the DEM has holes" in note for note in json.loads(report.read_text())["warnings"])
    (page,) = (home / "output").glob("*report*.html")
    assert "the DEM has holes" in page.read_text()
