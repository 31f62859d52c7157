"""Projects whose mosaic is in tiles: outputs, what is stale, and what a rerun keeps."""

from __future__ import annotations

import json
from pathlib import Path

import rasterio

from geomosaic.jobs.project import run_project
from geomosaic.project.sample_block import copy_sample


def test_a_missing_or_edited_tile_makes_the_mosaic_stale_and_a_rerun_renders_it_alone(tmp_path) -> None:
    file = copy_sample(tmp_path)
    text = file.read_text().partition("[quality]")[0]
    text = text.replace("[mosaic]\n", '[mosaic]\ntiling = "1024px"\nseam_quality = false\n').replace(
        "balance = true", "balance = false"
    )
    file.write_text(text.replace("resolution = 1.0 ", "bounds = [399100, 5500300, 400700, 5500500]\nresolution = 1.0 "))
    first = run_project(file)
    assert [state.reason for state in run_project(file, dry_run=True).states] == ["fresh"] * 4
    output = tmp_path / "output"
    tiles = [output / name for name in first.facts["mosaic"]["tiles"]]
    assert len(tiles) == 2 * 2
    with rasterio.open(output / "sample.vrt") as mosaic:
        assert mosaic.count == 3
    assert first.facts["outputs"]["mosaic"].endswith("sample.vrt")
    named = {one["path"]: one["sha256"] for one in json.loads((output / "report.json").read_text())["outputs"]}
    assert "sample.vrt" in {Path(name).name for name in named}

    before = {path: path.read_bytes() for path in tiles}
    tiles[0].unlink()
    with tiles[2].open("ab") as edited:  # the labels of the same tile
        edited.write(b"more")
    stale = {state.name: state.reason for state in run_project(file, dry_run=True).states}
    assert stale["mosaic"] == f"output {tiles[0].name} is missing"
    assert stale["report"] == "step 'mosaic' is stale"
    again = run_project(file)
    assert (again.facts["mosaic"]["reused"], again.facts["mosaic"]["units"]) == (1, 2)
    assert {path: path.read_bytes() for path in tiles} == before
    assert [state.fresh for state in run_project(file, dry_run=True).states] == [True] * 4
