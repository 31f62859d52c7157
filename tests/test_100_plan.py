"""`geomosaic plan` from the command line, and `geomosaic check` against its target."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner

from geomosaic.cli.commands.plan import command
from geomosaic.cli.main import run
from geomosaic.planning.relations import TOPICS


def told(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    """The JSON of a run that works."""
    assert run(["plan", *words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert isinstance(found, dict)
    return found


def test_each_topic_gives_its_derived_values(capsys: pytest.CaptureFixture[str]) -> None:
    assert told(capsys, "swath", "--field", "90", "--height", "6000")["derived"]["swath"] == pytest.approx(12000)
    found = told(capsys, "photo", "--photo-scale", "1:8000", "--ortho-scale", "1:2000")
    assert found["derived"]["scan_dpi"] == pytest.approx(1280)
    assert found["formulas"]["scan_dpi"].startswith("scan dpi >= 320 dpi")
    assert told(capsys, "accuracy", "--position-error", "3", "--position-mm", "0.3")["derived"] == {
        "ortho_scale": pytest.approx(10000)
    }
    area = told(capsys, "area", "--area", "10000", "8000", "--photo-scale", "1:10000", "--ortho-pixel", "0.5")
    assert area["raster"] == [16000, 20000]
    back = told(capsys, "area", "--area", "10km", "8km", "--photo-scale", "1:10000", "--strips", str(area["strips"]))
    assert back["sidelap"] >= area["sidelap"]
    assert back["photos"] == area["photos"]
    block = told(capsys, "control", "--model", "conformal", "--photos", "12", "--ties", "63", "--points", "5")
    assert block["block"]["unknowns"] == 48
    assert len(block["layout"]) == 5
    assert set(block["determined"]) == {"conformal", "affine", "projective", "frame", "poly1"}
    assert block["redundant"] == ["conformal"]
    tables = told(capsys, "tables")["tables"]
    assert tables[2]["dem_error"]["300"]["35"] == pytest.approx(24.0)
    assert [one["photo_scale"] for one in tables] == [[5000, 8000], [12000, 18000], [20000, 30000]]
    assert tables[0]["scan_pixel"] == {"grey": [12, 25], "colour": [20, 30]}
    names = [
        item["name"]
        for item in told(capsys, "product", "--ortho-scale", "1:5000", "--camera-constant", "150")["requirements"]
    ]
    assert "scan_dpi" in names


def test_numbers_in_other_units(capsys: pytest.CaptureFixture[str]) -> None:
    """Jensen's flight in feet and inches; a field in gon; a radius in cm, as K-2.8 has it."""
    feet = told(capsys, "photo", "--height", "20000ft", "--camera-constant", "12in")
    assert feet["derived"]["photo_scale"] == pytest.approx(20000)
    assert told(capsys, "swath", "--field", "100gon", "--height", "6km")["derived"]["swath"] == pytest.approx(12000)
    limit = told(
        capsys, "relief", "--radius", "3.5cm", "--camera-constant", "15cm", "--ortho-scale", "1:2000"
    )  # fmt: skip
    assert limit["derived"]["dem_limit"] == pytest.approx(2.4)
    for words, part in (
        (["photo", "--height", "3kg", "--camera-constant", "150"], "'3kg' has a unit that does not fit"),
        (["photo", "--height", "3,5", "--camera-constant", "150"], "'3,5' is no number"),
    ):
        assert run(["plan", *words]) == 2
        assert part in capsys.readouterr().err
    assert (
        run(["plan", "area", "--area", "1km", "1km", "--photo-scale", "5000", "--strips", "3", "--sidelap", "9"]) == 1
    )
    assert "leave out --sidelap or --strips" in capsys.readouterr().err


def test_a_flight_is_planned_from_the_scale_of_its_map_in_one_call(capsys: pytest.CaptureFixture[str]) -> None:
    """K-2.8 has K = 3.5 for 1:5000: photos 1:17 500, from which height, pixels, footprint and steps follow."""
    words = ("flight", "--ortho-scale", "1:5000", "--camera-constant", "150")
    found = told(capsys, *words, "--area", "10km", "8km")
    assert (found["photo_scale"], found["height"]) == (17_500, pytest.approx(2625))
    assert found["scan_pixel"] == pytest.approx(25_400 / (320 * 3.5))
    assert found["ground_pixel"] == pytest.approx(25.4e-3 / (320 * 3.5) * 17_500)
    assert (found["base"], found["spacing"]) == (pytest.approx(0.4 * 4025), pytest.approx(0.7 * 4025))
    assert (found["strips"], found["photos_in_strip"], found["photos"]) == (3, 8, 24)
    assert found["raster"] == [16_000, 20_000]
    digital = told(
        capsys, *words, "--ratio", "8", "--scan-pixel", "6", "--format-along", "68", "--format-across", "10cm"
    )
    assert digital["ground_pixel"] == pytest.approx(6e-6 * 40_000)
    assert digital["footprint"] == [pytest.approx(2720), pytest.approx(4000)]
    assert "photos" not in digital
    assert run(["plan", *words]) == 0
    assert "photos 1:17500 (K = 3.5), 2625 m above the ground" in capsys.readouterr().out


def test_what_is_missing_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    for words, hint in (
        (["photo", "--ortho-scale", "1:5000"], "give --photo-scale or --ratio (K = M_photo / M_ortho)"),
        (["flight"], "give --ortho-scale and --camera-constant"),
        (["flight", "--ortho-scale", "1:4000", "--camera-constant", "150"], "give --ratio"),
        (["control", "--ties", "3"], "give --photos"),
    ):
        assert run(["plan", *words]) == 1
        assert hint in capsys.readouterr().err


def test_help_has_formula_and_source() -> None:
    for name, relations in TOPICS.items():
        text = CliRunner().invoke(command, [name, "--help"]).output
        for relation in relations:
            assert relation.formula in text
            assert relation.source[:40] in text
        for quantity in {q for relation in relations for q in relation.names}:
            assert f"--{quantity.replace('_', '-')} " in text


def test_tables_are_printed_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["plan", "tables", "--ortho-scale", "1:10000"]) == 0
    text = capsys.readouterr().out
    assert "80 cm grey (317 dpi), 100 cm colour (254 dpi)" in text
    assert "scanning pixel 12-25 µm grey, 20-30 µm colour, photos 1:20000 to 1:30000" in text
    assert "24.0 m at r = 3.5 cm" in text
    for words in (["control"], ["area", "--area", "1", "1", "--photo-scale", "1:1"], ["photo", "--scan-dpi", "254"]):
        assert run(["plan", *words]) == 0
    assert run(["plan", "photo", "--height", "3"]) == 1
    assert "hint" in capsys.readouterr().err
    assert run(["plan", "photo", "--photo-scale", "2:5"]) == 2
    assert run(["plan", "photo", "--photo-scale", "1:0"]) == 2


def test_check_holds_a_map_against_its_scale(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Points that lie 2 m off fail a map 1:5000 (1.5 m) and pass one 1:10 000 (3 m); feet are metres there."""
    for crs, unit in (("EPSG:32633", 1.0), ("EPSG:2263", 0.3048006)):
        at = (500_000.0, 5_500_000.0) if unit == 1.0 else (980_000.0, 200_000.0)
        with rasterio.open(
            tmp_path / "map.tif", "w", driver="GTiff", width=100, height=100, count=1, dtype="uint8", crs=crs,
            transform=Affine(1 / unit, 0, at[0], 0, -1 / unit, at[1]),
        ) as out:  # fmt: skip
            out.write(np.full((1, 100, 100), 7, np.uint8))
        rows = ["id,x,y,col,row"]
        for k, (col, row) in enumerate([(10, 10), (90, 12), (50, 50), (12, 88)]):
            rows.append(f"{k},{at[0] + (col + 2) / unit},{at[1] - row / unit},{col},{row}")
        (tmp_path / "check.csv").write_text("\n".join(rows) + "\n")
        words = ["check", str(tmp_path / "map.tif"), "--points", str(tmp_path / "check.csv"), "--crs", crs]
        assert run([*words, "--map-scale", "1:10000"]) == 0
        assert run([*words, "--map-scale", "1:5000"]) == 3
        assert "limit 1.5 m" in capsys.readouterr().err


def test_a_plan_is_the_target_of_the_finished_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Points 1.2 m off on pixels of 0.5 m keep what a map 1:5000 needs and miss 1:2000, in place and in pixel."""
    with rasterio.open(
        tmp_path / "map.tif", "w", driver="GTiff", width=100, height=100, count=1, dtype="uint8", crs="EPSG:32633",
        transform=Affine(0.5, 0, 500_000, 0, -0.5, 5_500_000),
    ) as out:  # fmt: skip
        out.write(np.full((1, 100, 100), 7, np.uint8))
    places = [(10, 10), (90, 12), (50, 50), (12, 88)]
    rows = [f"{k},{500_000 + col / 2 + 1.2},{5_500_000 - row / 2},{col},{row}" for k, (col, row) in enumerate(places)]
    (tmp_path / "check.csv").write_text("\n".join(["id,x,y,col,row", *rows]) + "\n")
    words = ["check", str(tmp_path / "map.tif"), "--points", str(tmp_path / "check.csv"), "--crs", "EPSG:32633"]
    plan, judged = str(tmp_path / "plan.json"), {}
    for scale in (5000, 2000):
        assert run(["plan", "product", "--ortho-scale", str(scale), "--camera-constant", "150", "--json"]) == 0
        Path(plan).write_text(capsys.readouterr().out)
        code = run([*words, "--target", plan, "--survey-rms", "0.3", "--json"])
        found = json.loads(capsys.readouterr().out)
        judged[scale] = {
            item["name"]: (round(item["value"], 6), item["most"], item["passed"]) for item in found["target"]
        }
        assert found["passed"] == (code == 0)
    assert judged[5000] == {
        "position_error": (1.2, 1.5, True), "ortho_pixel": (0.5, 0.5, True), "control_error": (0.3, 0.5, True)
    }  # fmt: skip
    assert judged[2000] == {
        "position_error": (1.2, pytest.approx(0.6), False), "ortho_pixel": (0.5, pytest.approx(0.2), False),
        "control_error": (0.3, pytest.approx(0.2), False),
    }  # fmt: skip
    assert run([*words, "--target", plan]) == 3
    said = capsys.readouterr()
    assert "error of position at check points: 1.2 m, target <= 0.6 m: MISSED" in said.out
    assert "survey" not in said.out
    own = tmp_path / "target.toml"
    own.write_text("position_error = 1.3\n")
    assert run([*words, "--target", str(own)]) == 0
    for text, part in (
        ("position_eror = 1", "position_error"),
        ("position_error =", "cannot be read"),
        ("", "no quantity"),
    ):
        own.write_text(text)
        assert run([*words, "--target", str(own)]) == 1
        assert part in capsys.readouterr().err
    for limit in ('"much"', "-1", "NaN", "true"):
        one = f'{{"name": "position_error", "least": null, "most": {limit}, "unit": "m", "source": ""}}'
        Path(plan).write_text(f'{{"requirements": [{one}]}}')
        assert run([*words, "--target", plan]) == 1
        assert "limit is no number" in capsys.readouterr().err
    Path(plan).write_text("[]")
    assert run([*words, "--target", plan]) == 1
    assert "no plan of a product" in capsys.readouterr().err


def test_a_flight_whose_photos_do_not_overlap_by_half_is_refused_without_an_area_too(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["plan", "flight", "--ortho-scale", "1:5000", "--camera-constant", "150", "--overlap", "40"]
    assert run(words) == 1
    assert "with 40 % of overlap there are places that only one photo shows" in capsys.readouterr().err
    assert run([*words, "--monoscopic"]) == 0
    assert "exposures every 2415 m" in capsys.readouterr().out


def test_scales_of_millions_are_written_out_and_targets_are_not_those_of_the_guidelines(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(["plan", "product", "--ortho-scale", "1:10000000", "--camera-constant", "150"]) == 1
    assert "K-2.8 has no ratio K for 1:10000000" in capsys.readouterr().err
    assert run(["plan", "tables", "--ortho-scale", "1:1000000"]) == 0
    assert "pixel 8000 cm grey" in capsys.readouterr().out
    words = ["plan", "product", "--ortho-scale", "1:10000", "--camera-constant", "150", "--position-error", "4"]
    assert run(words) == 0
    assert "<= 4 m              as given" in capsys.readouterr().out
