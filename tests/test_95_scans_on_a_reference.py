"""Scans without any tag, and an old ortho of their land: from the folder to a mosaic that lies where the land is."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
import reference_rig as rig

from geomosaic.cli.main import run
from geomosaic.testing.synthetic.block import PlainCamera
from geomosaic.testing.synthetic.photo import render

pytestmark = pytest.mark.ci

# Columns and rows that were cut off each scan, by nobody's rule.
CUT = ((0, 0), (9, 4), (3, 12), (6, 6))


def write_scans(folder: Path, focal: float) -> None:
    """Four overlapping photos, turned and cut as scans are, with a black edge."""
    folder.mkdir()
    camera = {**rig.CAMERA, "focal_length": focal}
    height = rig.GROUND.base + rig.PIXEL * focal / 48.0 * 320.0
    for number, (cols, rows) in enumerate(CUT):
        east, north = 150.0 * (number % 2) - 75.0, 120.0 * (number // 2) - 60.0
        position = (rig.ORIGIN[0] + east, rig.ORIGIN[1] + north, height)
        photo = PlainCamera(camera, rig.GROUND.crs, position, (1.5 - number, number - 2.0, 90.0 * number + 7.0))
        values = render(photo, rig.GROUND, texture=lambda _, xyz: rig.land(xyz[:, :2])[:, None], noise=1.0 / 255.0)
        grey = values[..., 0].copy()
        grey[:5] = 0
        cv2.imwrite(str(folder / f"scan{number}.png"), grey[: 240 - rows, : 320 - cols])


def off_the_land(mosaic: Path) -> np.ndarray:
    """Shifts (N, 2) of windows of 64 pixels against the land itself, in pixels of the mosaic."""
    with rasterio.open(mosaic) as file:
        values, inside, to_map = file.read(1).astype(np.float64), file.dataset_mask() > 0, file.transform
    col, row = np.meshgrid(np.arange(values.shape[1]) + 0.5, np.arange(values.shape[0]) + 0.5)
    x, y = to_map @ (col.ravel(), row.ravel())
    truth = 255.0 * rig.land(np.column_stack([x, y])).reshape(values.shape)
    taper = cv2.createHanningWindow((64, 64), cv2.CV_64F)
    return np.array([
        cv2.phaseCorrelate(truth[r : r + 64, c : c + 64], values[r : r + 64, c : c + 64], taper)[0]
        for r in range(0, values.shape[0] - 64, 32)
        for c in range(0, values.shape[1] - 64, 32)
        if inside[r : r + 64, c : c + 64].all()
    ])  # fmt: skip


@pytest.mark.parametrize("focal", [55.0, pytest.param(40.0, marks=pytest.mark.slow)])
def test_scans_and_an_old_ortho_become_a_mosaic_in_its_place(focal, tmp_path: Path, capsys) -> None:
    """Of another season and other pixels; nothing is known of the camera, whose focal length 1.2 times the longer side
    is assumed: it is 1.15 and 0.83 times it."""
    write_scans(tmp_path / "scans", focal)
    ortho, heights, project = rig.reference(tmp_path, pixel=2.5), rig.dem(tmp_path), str(tmp_path / "p.toml")
    assert run(["new", project, str(tmp_path / "scans"), "--reference", str(ortho), "--dem", str(heights)]) == 0
    assert f"control points are looked for in {ortho.name}" in capsys.readouterr().out
    code = run(["run", project])
    assert code == 0, capsys.readouterr().err
    off = off_the_land(tmp_path / "output" / "p.tif")
    assert len(off) > 40
    assert np.sqrt((off**2).mean()) < 0.3
    assert np.linalg.norm(off, axis=1).max() < 1.0


@pytest.mark.slow
def test_scans_without_a_dem_lie_on_the_ground_of_their_tie_points(tmp_path: Path, capsys) -> None:
    """Their control points are all taken at one height, with the relief as its standard deviation."""
    write_scans(tmp_path / "scans", 55.0)
    ortho, project = rig.reference(tmp_path, pixel=2.5), str(tmp_path / "p.toml")
    assert run(["new", project, str(tmp_path / "scans"), "--reference", str(ortho)]) == 0
    assert "tie points give the ground of the mosaic" in capsys.readouterr().out
    assert run(["run", project]) == 3
    assert "largest expected error" in capsys.readouterr().err
    assert (tmp_path / "output" / "surface.tif").is_file()
    off = off_the_land(tmp_path / "output" / "p.tif")
    assert len(off) > 40
    # On flat ground 0.36 and some pixels.
    assert np.sqrt((off**2).mean()) < 0.2
    assert np.linalg.norm(off, axis=1).max() < 1.0


def test_one_scan_and_a_reference_go_another_way(tmp_path: Path, capsys) -> None:
    write_scans(tmp_path / "scans", 55.0)
    ortho = rig.reference(tmp_path, pixel=2.5)
    code = run(["new", str(tmp_path / "p.toml"), str(tmp_path / "scans" / "scan0.png"), "--reference", str(ortho)])
    assert code == 1
    assert "geomosaic georeference SCAN --reference ORTHO" in capsys.readouterr().err
