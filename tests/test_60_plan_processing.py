"""Planned processing: held against runs that its rates do not come from, and by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import geomosaic as gm
from geomosaic.cli.main import run
from geomosaic.errors import InputError
from geomosaic.planning.processing import ProcessingPlan

RATES = {
    "date": "2026-01-01", "machine": {"processor": "abacus", "cores": 2}, "features_s_per_megapixel": 0.1,
    "photos": {}, "match_s_per_pair": 0.5, "positions_per_photo": 1000.0, "adjust_s_per_position": 1e-4,
    "seams_s_per_photo": 0.3, "input_s_per_megapixel": 0.02, "output_s_per_megapixel": 0.05,
    "output_bytes_per_pixel": 2.0, "match_mb": 400.0,
    "match_mb_per_photo": 2.0, "adjust_mb": 200.0, "adjust_mb_per_position": 1e-3, "mosaic_mb": 900.0,
}  # fmt: skip
BLOCK = {"photos": 1000, "photo_size": (5000, 4000), "ground_pixel": 0.1, "overlap": 60.0, "sidelap": 30.0}


def planned(folder: Path, **given: Any) -> ProcessingPlan:
    """Plan of the block above by the round rates above."""
    path = folder / "rates.json"
    path.write_text(json.dumps(RATES))
    found = gm.plan("run", **{**BLOCK, "rates": path, **given})
    assert isinstance(found, ProcessingPlan)
    return found


def test_stages_are_what_their_formulas_say(tmp_path: Path) -> None:
    found = planned(tmp_path, workers=5, cores=4, core_hour=0.1)
    # Two neighbours on either side along the strip, one across: 14 of which each pair counts once.
    assert (found.pairs, found.positions) == (7000, 1_000_000)
    assert found.area == pytest.approx(1000 * 0.4 * 0.7 * 500.0 * 400.0)
    assert found.pixels == pytest.approx(5.6e9)
    match, adjust, mosaic = found.stages
    assert match.processor_seconds == pytest.approx(1000 * 20 * 0.1 + 7000 * 0.5)
    assert (match.seconds, match.cores) == (pytest.approx(5500.0 / 20), 20)
    assert match.memory == pytest.approx(2.4e9)
    assert (adjust.processor_seconds, adjust.memory) == (pytest.approx(100.0), pytest.approx(1.2e9))
    assert mosaic.processor_seconds == pytest.approx(1000 * 20 * 0.02 + 5600 * 0.05)
    assert (mosaic.cores, mosaic.seconds) == (20, pytest.approx(680.0 / 20))
    assert mosaic.written_bytes == pytest.approx(11.2e9)
    assert found.core_hours == pytest.approx(found.seconds / 3600 * 20)
    assert found.cost == pytest.approx(found.core_hours * 0.1)
    assert not found.misfits


def test_seams_by_graph_cuts_are_a_stage_that_reads_the_photos_once(tmp_path: Path) -> None:
    found = planned(tmp_path, workers=5, cores=4, oriented=True, seams="graph-cut")
    assert [stage.name for stage in found.stages] == ["seams", "mosaic"]
    seams = found.stages[0]
    assert (seams.processor_seconds, seams.seconds) == (pytest.approx(300.0), pytest.approx(15.0))
    assert (seams.read_bytes, seams.memory) == (pytest.approx(8e9), pytest.approx(9e8))


def test_a_few_photos_have_no_more_pairs_than_there_are(tmp_path: Path) -> None:
    assert [planned(tmp_path, photos=number).pairs for number in (1, 2, 4)] == [0, 1, 6]


def test_what_limits_a_stage_is_named(tmp_path: Path) -> None:
    """8 GB of photos, read twice by five machines at 20 MB/s, and 11.2 GB written by one of them."""
    mosaic = planned(tmp_path, workers=5, cores=4, bandwidth=20.0, oriented=True).stages[-1]
    assert (mosaic.limited_by, mosaic.seconds) == ("writing", pytest.approx(11.2e9 / 20e6))
    coarse = planned(tmp_path, workers=5, cores=4, bandwidth=20.0, oriented=True, ortho_pixel=1.0).stages[-1]
    assert (coarse.limited_by, coarse.seconds) == ("reading", pytest.approx(2 * 8e9 / 100e6))
    (misfit,) = planned(tmp_path, memory="2G").misfits
    assert misfit == "match takes 2.4 GB of memory, and there are 2.15"
    (misfit,) = planned(tmp_path, disk="10G").misfits
    assert misfit == "the mosaic takes 11.2 GB of disk, and there are 10.7"
    assert not planned(tmp_path, disk="11G").misfits


def test_the_rates_of_the_package_foretell_runs_that_they_were_not_made_from() -> None:
    """Processor seconds measured apart (docs/tie-points.md, benchmarks/results.md) on a machine of the same kind."""
    folder = gm.plan("run", photos=75, photo_size=(4000, 3000), ground_pixel=0.3, overlap=60.0, sidelap=30.0)
    assert 0.5 < folder.processor_seconds / 357.0 < 2.0
    # 12 photos of 24 Mpx and an output of 140 Mpx that is not compressed, as the benchmark `mosaic` has them.
    strips = gm.plan(
        "run", photos=12, photo_size=(6000, 4000), ground_pixel=1.0, overlap=60.0, sidelap=0.0, oriented=True
    )
    assert 0.5 < strips.pixels / 140e6 < 2.0
    assert 5.2 < strips.processor_seconds < 4.0 * 5.2
    assert strips.positions == strips.pairs == 0


def test_the_command_prints_a_table_and_its_source(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["plan", "run", "--photos", "100000", "--photo-size", "6000", "4000", "--ground-pixel", "20cm"]
    assert run([*words, "--workers", "50", "--cores", "8", "--core-hour", "0.04"]) == 0
    text = capsys.readouterr().out
    assert "gigapixels" in text
    assert "core hours, cost" in text
    assert "rates of 20" in text
    assert "does not fit: match" in text  # of one machine of 8 GB
    assert run([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["stages"][0]["name"] == "match"
    assert found["seconds"] == pytest.approx(sum(stage["seconds"] for stage in found["stages"]))


@pytest.mark.parametrize(
    ("given", "part"),
    [
        ({"photos": 0}, "`photos`"), ({"overlap": 100.0}, "`overlap`"), ({"ground_pixel": 0.0}, "`ground_pixel`"),
        ({"photo_size": (5000, 0)}, "`photo_size`"), ({"rates": __file__}, "test_60_plan_processing.py"),
    ],
)  # fmt: skip
def test_numbers_that_make_no_sense_are_refused(given: dict[str, Any], part: str) -> None:
    with pytest.raises(InputError) as caught:
        gm.plan("run", **{**BLOCK, **given})
    assert part in str(caught.value)


def test_columns_of_the_table_do_not_run_into_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    for photos in ("1", "1000000000000"):
        assert run(["plan", "run", "--photos", photos, "--photo-size", "4000", "3000", "--ground-pixel", "0.3"]) == 0
        match, adjust, mosaic = capsys.readouterr().out.splitlines()[2:5]
        for line in (match, adjust, mosaic):
            assert len(line.split()) == 13, line  # name, six columns of which one has no unit, and what limits
