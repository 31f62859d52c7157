"""Seams judged piece by piece: known steps and known shifts come out, before and after the balance."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from scipy.ndimage import gaussian_filter

from geomosaic.raster.vector import read_layer
from geomosaic.report.report import seam_limit, strip

LEFT, TOP, SIDE, STEP = 500_000.0, 5_500_000.0, 500, 250
SHIFT, OFFSET = (2.0, -1.0), 12


def tile(path: Path, col: int, shift: tuple[float, float] = (0, 0), offset: float = 0) -> Path:
    """A window of one random ground, of whole pixels of 1 m; its content lies (col, row) pixels too far."""
    ground = gaussian_filter(np.random.default_rng(0).normal(0, 1, (SIDE, SIDE + STEP)), 1.5) * 150 + 110
    profile = {"driver": "GTiff", "width": SIDE, "height": SIDE, "count": 1, "dtype": "uint8", "crs": "EPSG:32631"}
    place = Affine(1.0, 0.0, LEFT + col + shift[0], 0.0, -1.0, TOP - shift[1])
    with rasterio.open(path, "w", transform=place, **profile) as dataset:
        dataset.write(np.clip(ground[None, :, col : col + SIDE] + offset, 0, 255).astype("uint8"))
    return path


@pytest.mark.parametrize("balance", [True, False])
def test_a_known_shift_and_a_known_step_are_found(tell, tmp_path, balance):
    tiles = tile(tmp_path / "a.tif", 0), tile(tmp_path / "b.tif", STEP, SHIFT, OFFSET)
    out = tmp_path / "m.tif"
    words = ("--res", 1, "--seam-quality", "--balance" if balance else "--no-balance", "--bounds")
    bounds = (LEFT, TOP - SIDE, LEFT + SIDE + STEP, TOP)
    assert tell("mosaic", *tiles, *words, *bounds, "-o", out)[0] == 0
    lines = read_layer(out.with_suffix(".gpkg"), "seamlines")
    assert lines["id"].tolist() == ["a.tif|b.tif|1", "a.tif|b.tif|2"]  # longer than 512 pixels: in two pieces
    assert lines["length"].sum() == pytest.approx(lines.length.sum())
    for found in lines.to_dict("records"):
        assert (found["shift_col"], found["shift_row"]) == pytest.approx(SHIFT, abs=0.05)
        assert found["mismatch"] == pytest.approx(np.hypot(*SHIFT), abs=0.05)
        assert found["correlation"] > 0.98
        assert found["step_before"] == pytest.approx(OFFSET, abs=3)  # moved ground is other ground beside a seam
        assert (found["step_after"] < 4.0) == balance


def test_images_that_agree_have_no_step_and_no_mismatch(tell, tmp_path):
    tiles = tile(tmp_path / "a.tif", 0), tile(tmp_path / "b.tif", STEP)
    out = tmp_path / "m.tif"
    assert tell("mosaic", *tiles, "--res", 1, "--no-balance", "--seam-quality", "-o", out)[0] == 0
    (found,) = read_layer(out.with_suffix(".gpkg"), "seamlines").to_dict("records")
    assert found["step_after"] == found["difference"] == 0
    assert found["mismatch"] < 1e-3


def test_the_report_shows_the_worst_places(tell, tmp_path):
    tiles = tile(tmp_path / "a.tif", 0), tile(tmp_path / "b.tif", STEP, SHIFT, OFFSET)
    project = tmp_path / "p.toml"
    assert tell("new", project, *tiles)[0] == 0
    text = project.read_text()
    project.write_text(text.replace("# max_seam_mismatch_px = 2.0", "max_seam_mismatch_px = 2.0"))
    code, _, err = tell("run", project)
    assert code != 0
    assert "mismatch of images along seams, largest: 2.2" in err
    page = (tmp_path / "output" / "report.html").read_text()
    assert "The 2 places where images differ most" in page
    assert page.count('<figure><img src="data:image/png;base64,') == 2
    facts = json.loads((tmp_path / "output" / "report.json").read_text())["mosaic"]["seam_quality"]
    assert facts["mismatch_rms_px"] == pytest.approx(np.hypot(*SHIFT), abs=0.1)
    assert facts["step_before"] > 5 * facts["step_after"]


def test_admissible_is_twice_the_rmse_in_pixels_of_the_mosaic():
    assert seam_limit({"rms_check_px": 0.8}, {"scale": 4.0}) == pytest.approx(0.4)
    assert seam_limit({"rms_check_px": None}, {"scale": 4.0}) is None


def test_pictures_of_a_place_have_one_stretch():
    views = [np.full((5, 7, 4), value, dtype=np.float32) for value in (100, 200, 150)]
    picture = strip(views)
    assert picture.shape == (5, 3 * 7 + 2 * 6, 3)
    assert picture[2, 3, 0] < picture[2, 30, 0] < picture[2, 15, 0]
    assert strip([view[:, :, :1] for view in views]).shape == picture.shape


def test_a_mosaic_without_a_project_names_the_checksums_of_its_sources_too(tell, tmp_path):
    tiles = tile(tmp_path / "a.tif", 0), tile(tmp_path / "b.tif", STEP)
    out = tmp_path / "m.tif"
    assert tell("mosaic", *tiles, "--res", 4, "-o", out)[0] == 0
    sums = [hashlib.sha256(path.read_bytes()).hexdigest() for path in tiles]
    assert read_layer(out.with_suffix(".gpkg"), "footprints")["sha256"].tolist() == sums
    sources = json.loads(out.with_suffix(".stac.json").read_text())["properties"]["geomosaic:sources"]
    assert [source["sha256"] for source in sources] == sums
