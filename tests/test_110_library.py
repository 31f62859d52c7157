"""The scripts of the README, which the library's page includes, run as they are printed."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

import geomosaic as gm

ROOT = Path(__file__).parents[1]
SCRIPTS = dict(re.findall(r"<!-- script: (\w+) -->\n```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Half of the photos of the sample, and two orthos."""
    folder = tmp_path_factory.mktemp("library") / "sample"
    left_out = shutil.ignore_patterns("output", ".*", "truth", "*_0[34].jpg")
    shutil.copytree(ROOT / "data" / "sample", folder, ignore=left_out)
    (folder / "orthos").mkdir()
    table = {"exterior": folder / "exterior.csv", "crs": "EPSG:32633", "heights": "egm96"}
    for name in ("strip1_01", "strip1_02"):
        photo = gm.Scene(folder / "photos" / f"{name}.jpg", "frame", camera=folder / "camera.toml", **table)
        gm.ortho(photo, folder / "orthos" / f"{name}.tif", dem=folder / "dem.tif", resolution=4.0)
    _scan(folder)
    return folder


def _scan(folder):
    """A picture without a place, and points in it."""
    import numpy as np
    from PIL import Image

    placed = folder / "orthos" / "strip1_01.tif"
    source = gm.reproject(placed, folder / "scanned.tif", like=placed)
    Image.fromarray(np.moveaxis(source.read().filled(0), 0, 2)).save(folder / "scan.jpg", quality=90)
    width, height = source.grid.width, source.grid.height
    colrow = np.array([[c * width, r * height] for c in (0.2, 0.5, 0.8) for r in (0.2, 0.5, 0.8)]).round(1)
    rows = np.column_stack([source.grid.xy(colrow), colrow])
    lines = [",".join([f"P{number}", *map(str, row)]) for number, row in enumerate(rows.tolist(), start=1)]
    (folder / "scan.csv").write_text("\n".join(["id,x,y,col,row", *lines]) + "\n")


def test_the_scripts_have_about_ten_lines():
    assert set(SCRIPTS) == {"ortho", "photos", "mosaic", "map"}
    assert all(len(script.splitlines()) <= 14 for script in SCRIPTS.values())


MADE = {"ortho": "ortho.tif", "photos": "photos.tif", "mosaic": "mosaic.tif", "map": "map.pdf"}


@pytest.mark.parametrize(("name", "made"), MADE.items())
def test_a_script_of_the_library_runs_as_printed(name, made, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    exec(compile(SCRIPTS[name], f"README.md, {name}", "exec"), {"__name__": name})
    assert (folder / made).stat().st_size > 1000
    assert made in capsys.readouterr().out


def test_the_page_of_the_library_includes_them():
    assert '--8<-- "README.md:scripts"' in (ROOT / "docs" / "library.md").read_text()
