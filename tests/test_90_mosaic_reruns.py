"""An edited seam costs what it touches: the rest is taken from the run before, and the bytes are the same."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
from project_rig import PHOTOS, edit_south, make_project
from scipy.ndimage import distance_transform_edt

from geomosaic.cli.main import run
from geomosaic.options.render import CELL
from geomosaic.raster.vector import read_layer
from geomosaic.render.regions import map_by_regions


@pytest.fixture(scope="module")
def done(sample, tmp_path_factory) -> Path:
    """A project of four photos, run once."""
    file = make_project(tmp_path_factory.mktemp("reuse") / "one", sample)
    assert run(["run", str(file), "mosaic"]) == 0
    return file


@pytest.fixture
def own(done, tmp_path) -> Path:
    shutil.copytree(done.parent, tmp_path / "own")
    return tmp_path / "own" / done.name


def facts(project: Path) -> dict[str, int]:
    found = json.loads((project.parent / ".geomosaic" / "trial" / "facts" / "mosaic.json").read_text())
    return {name: found[name] for name in ("reused", "units")}


def hashes(project: Path) -> list[str]:
    names = ("trial.tif", "trial-labels.tif", "trial.gpkg")
    return [hashlib.sha256((project.parent / "output" / name).read_bytes()).hexdigest() for name in names]


def test_the_first_run_computes_all(done):
    assert facts(done)["reused"] == 0
    assert facts(done)["units"] >= 3


def test_an_edited_seam_costs_what_it_touches(own, tell, tmp_path, monkeypatch):
    asked = []

    def noted(*parts):
        asked.append(parts[-1].threads)
        return map_by_regions(*parts)

    monkeypatch.setattr("geomosaic.mosaicking.rendering.map_by_regions", noted)
    before = hashes(own)
    edit_south(own)
    code, out, _ = tell("run", own, "mosaic", "--threads", "16")
    assert code == 0
    found = facts(own)
    assert 0 < found["reused"] < found["units"]
    assert asked == [found["units"] - found["reused"]]  # threads
    assert f"{found['units'] - found['reused']} of {found['units']} units computed" in out
    assert "as before: balance, " in out
    assert "pieces of seams" in out
    after = hashes(own)
    assert after[0] != before[0]
    assert after[1] != before[1]
    # The same project without a memory gives the same bytes.
    shutil.rmtree(own.parent / ".geomosaic")
    shutil.rmtree(own.parent / "output")
    assert tell("run", own, "mosaic")[0] == 0
    assert facts(own)["reused"] == 0
    assert hashes(own) == after


CORNER = "strip2_03.jpg"


def pixels(project: Path) -> np.ndarray:
    with rasterio.open(project.parent / "output" / "trial.tif") as dataset:
        return dataset.read()


def shown_by(project: Path) -> np.ndarray:
    with rasterio.open(project.parent / "output" / "trial-labels.tif") as dataset:
        return dataset.read(1)


EDITS = {
    "left out": (lambda text: text.replace("[mosaic]\n", f'[mosaic]\nexclude = ["{CORNER}"]\n'), True),
    "colour": (lambda text: f'{text}\n[mosaic.retouch."{CORNER}"]\ngain = 1.1\noffset = -4\n', False),
}


@pytest.mark.parametrize("seams", ["nearest", pytest.param("graph-cut", marks=pytest.mark.slow)])
@pytest.mark.parametrize("edit", EDITS)
def test_an_edited_photo_costs_what_it_touches(edit, seams, done, own, tell):
    change, gone = EDITS[edit]
    own.write_text(own.read_text().replace("[mosaic]\n", f'[mosaic]\nseams = "{seams}"\n'))
    if seams != "nearest":
        assert tell("run", own, "mosaic")[0] == 0
    before, label, number = pixels(own), shown_by(own), PHOTOS.index(CORNER) + 1
    assert (label == number).any()
    own.write_text(change(own.read_text()))
    assert tell("run", own, "mosaic")[0] == 0
    found, after = facts(own), pixels(own)
    assert 0 < found["reused"] < found["units"]
    assert (shown_by(own) == number).any() == (not gone)
    # What lies farther from the photo's share than the feather reaches is the same; photos are blended in whole cells.
    far = distance_transform_edt(label != number) > (60 + CELL if seams == "nearest" else 400)
    assert far.sum() > 10_000
    assert (before[:, far] == after[:, far]).all()
    assert (before[:, label == number] != after[:, label == number]).any()
    kept = hashes(own)
    shutil.rmtree(own.parent / ".geomosaic")
    shutil.rmtree(own.parent / "output")
    assert tell("run", own, "mosaic")[0] == 0
    assert facts(own)["reused"] == 0
    assert hashes(own) == kept


def test_the_report_tells_what_a_rerun_cost_and_a_forced_one_takes_nothing(own, tell):
    edit_south(own)
    assert tell("run", own)[0] == 0
    page, found = (own.parent / "output" / "report.html").read_text(), facts(own)
    assert f"{found['units'] - found['reused']} of {found['units']} computed; {found['reused']} taken from" in page
    assert "<dt>As before</dt><dd>balance, " in page
    assert "s of processors" in page
    # Nothing to do: nothing is said of what an earlier run did.
    code, out, _ = tell("run", own)
    assert (code, "computed" in out, "as before" in out) == (0, False, False)
    assert found["reused"] > 0
    kept = hashes(own)
    assert tell("run", own, "mosaic", "--force")[0] == 0
    assert facts(own)["reused"] == 0
    assert hashes(own) == kept


def test_a_changed_photo_or_option_is_no_reason_to_reuse(own, tell):
    text = own.read_text()
    own.write_text(text.replace('resampling = "bilinear"', 'resampling = "cubic"'))
    assert tell("run", own, "mosaic")[0] == 0
    assert facts(own)["reused"] == 0


def test_a_file_that_was_touched_is_not_trusted(own, tell):
    edit_south(own)
    state = own.parent / ".geomosaic" / "trial" / "mosaic-units.json"
    state.write_text(state.read_text().replace('"labels": "', '"labels": "0'))
    assert tell("run", own, "mosaic")[0] == 0
    assert facts(own)["reused"] == 0
    state.write_text("{")
    text = own.read_text()
    own.write_text(text.replace("# feather = 10.0 ", "feather = 9.0 "))
    assert tell("run", own, "mosaic")[0] == 0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda shares: shares.assign(image=["nobody.jpg"] * len(shares)), "which is no image of this mosaic"),
        (lambda shares: shares.rename(columns={"image": "photo"}), "no column 'image'"),
        (lambda shares: shares.set_geometry(shares.geometry.boundary), "not an area"),
    ],
)
def test_drawn_shares_that_cannot_be_used(own, tell, change, said):
    edit_south(own)
    shares = read_layer(own.parent / "mine.gpkg", "seams")
    (own.parent / "mine.gpkg").unlink()
    change(shares).to_file(own.parent / "mine.gpkg", layer="seams")
    before = hashes(own)
    code, _, err = tell("run", own, "mosaic")
    assert code == 1
    assert said in err
    assert hashes(own) == before


@pytest.mark.slow
def test_views_are_kept_where_the_pixels_are(own, tell, monkeypatch):
    from geomosaic.mosaicking import provenance

    looked: list[object] = []
    between = provenance.view_raster

    def counted(*words: object) -> object:
        looked.append(words)
        return between(*words)

    monkeypatch.setattr(provenance, "view_raster", counted)
    text = own.read_text()
    own.write_text(text.replace("[mosaic]\n", "[mosaic]\nviews = true\n"))
    assert tell("run", own, "mosaic", "--threads", "1")[0] == 0
    assert facts(own)["reused"] == facts(own)["units"]  # asking for views changes no pixel
    every = len(looked)
    looked.clear()
    edit_south(own)
    assert tell("run", own, "mosaic", "--threads", "1")[0] == 0
    assert 0 < len(looked) < every
    views = own.parent / "output" / "trial-views.tif"
    kept = [*hashes(own), hashlib.sha256(views.read_bytes()).hexdigest()]
    shutil.rmtree(own.parent / ".geomosaic")
    shutil.rmtree(own.parent / "output")
    assert tell("run", own, "mosaic")[0] == 0
    assert [*hashes(own), hashlib.sha256(views.read_bytes()).hexdigest()] == kept
