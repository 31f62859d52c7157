"""The report of a project."""

from __future__ import annotations

import base64

import numpy as np
from cli_rig import PHOTOS
from html_rig import Page
from PIL import Image

from geomosaic.jobs.manifest import read_json


def test_the_report_is_one_file_with_its_numbers(project):
    output = project.parent / "output"
    text = (output / "report.html").read_text()
    data = read_json(output / "report.json")
    page = Page(text)
    assert "script" not in page.tags
    assert "link" not in page.tags
    assert all(link.startswith(("data:image/png;base64,", "data:image/jpeg;base64,")) for link in page.links)
    assert base64.b64decode(page.links[0].partition(",")[2]).startswith(b"\xff\xd8\xff")
    assert "://" not in text
    for file in [*data["inputs"], *data["outputs"]]:
        path = project.parent / file["path"]
        assert path.is_file()
        assert len(file["sha256"]) == 64
        assert file["sha256"] in text
    for words in ("EGM96 height", "opk", "tolerance", *PHOTOS, data["versions"]["numpy"]):
        assert words in text
    assert len(data["mosaic"]["images"]) == len(PHOTOS)
    assert {point["role"] for point in data["orient"]["control"]} == {"control", "check"}
    assert data["orient"]["rms_check_px"] < 0.5


def test_what_files_are_called_cannot_become_part_of_the_page(project):
    from geomosaic.report.report import render_html

    output = project.parent / "output"
    data = read_json(output / "report.json")
    evil = "<script>alert(1)</script>"
    data["name"] = evil
    data["mosaic"]["images"][0]["name"] = evil
    data["orient"]["control"][0]["id"] = evil
    data["warnings"] = [evil]
    page = Page(render_html(data, output / "trial.tif", output / "trial.gpkg"))
    assert "script" not in page.tags


def test_numbers_of_the_report_have_the_decimals_their_units_ask_for(project):
    """A map in degrees and values between 0 and 1 are not rounded to nothing."""
    from geomosaic.report.page import decimals
    from geomosaic.report.report import render_html

    assert [decimals(scale) for scale in (500.0, 0.5, 9e-6, 0.0, None)] == [0, 3, 8, 0, 0]
    assert decimals(500.0, 2) == 2
    output = project.parent / "output"
    data = read_json(output / "report.json")
    made = data["mosaic"]
    made["grid"] |= {"resolution": [9e-6, 9e-6], "bounds": [14.1, 49.2, 14.123456789, 49.212345678]}
    made["images"][0] |= {"sampling": 8.7e-6, "offset": [0.00123]}
    made |= {"feather": 0.000288, "before": [0.0213], "after": [0.00414]}
    text = render_html(data, output / "trial.tif", output / "trial.gpkg")
    for shown in ("0.00000870", "0.00028800", "14.12345679, 49.21234568", "0.0012", "0.0213 → 0.0041"):
        assert shown in text


def test_pictures_of_the_report_show_the_mosaic(project):
    from io import BytesIO

    from geomosaic.raster.pictures import preview

    page = Page((project.parent / "output" / "report.html").read_text())
    shown = np.asarray(Image.open(BytesIO(base64.b64decode(page.links[0].partition(",")[2]))).convert("RGB"))
    rgb, valid = preview(project.parent / "output" / "trial.tif", max(shown.shape))
    assert shown.shape == rgb.shape
    off = np.abs(shown.astype(float) - rgb)[valid > 0]
    assert off.mean() < 1.5
    assert off.max() < 20


def test_maps_are_pale_where_nothing_is_seen():
    from io import BytesIO

    from geomosaic.raster.pictures import jpeg_bytes

    rgb = np.full((40, 64, 3), 90, dtype=np.uint8)
    valid = np.ones((40, 64), dtype=np.uint8)
    valid[:16] = 0
    shown = np.asarray(Image.open(BytesIO(jpeg_bytes(rgb, valid)))).astype(int)
    assert np.abs(shown[:16] - (238, 241, 244)).max() <= 2
    assert np.abs(shown[16:] - 90).max() <= 2
