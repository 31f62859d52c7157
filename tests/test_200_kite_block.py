"""A folder of kite photos with OpenDroneMap's list of control points: from the files to an adjusted block."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from geomosaic.cli.main import run
from geomosaic.inputs.control_points import read_control


def test_the_list_of_control_points_serves_a_block(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    base = real_data("odm-copr")
    points = read_control(base / "gcp_list.txt", sorted(path.name for path in (base / "images").glob("*.jpg")))
    assert sorted({point.id for point in points}) == [f"gcp0{k}" for k in range(6)]
    assert len(points) == 12
    wrong = next(point for point in points if (point.id, point.image) == ("gcp04", "IMG_0031.jpg"))
    assert wrong.colrow == pytest.approx((3485.5056, 729.1266), abs=1e-3)
    assert run(["new", str(tmp_path / "p.toml"), str(base / "images"), "--gcps", str(base / "gcp_list.txt")]) == 0
    text = (tmp_path / "p.toml").read_text()
    assert 'crs = "EPSG:32611"' in text
    assert "[match]" in text


@pytest.mark.slow
def test_kite_photos_and_their_control_list_become_an_adjusted_block(
    real_data: Callable[[str], Path], tmp_path: Path
) -> None:
    base, project = real_data("odm-copr"), str(tmp_path / "p.toml")
    assert run(["new", project, str(base / "images"), "--gcps", str(base / "gcp_list.txt")]) == 0
    # So far off the control tells the place no better than the limit of 5 px that a mosaic is to keep.
    assert run(["run", project, "match", "orient"]) == 3
    facts = json.loads((tmp_path / "output" / "adjustment.json").read_text())
    images, control = facts["observations"][:2]
    assert images["rms"] < 0.25  # pixels of 4 mm; 0.5 was asked for
    assert images["rejected"] < 0.02 * images["used"]
    # The control is averaged GPS: its own scatter is found, and not the 2 cm that its table leaves open.
    assert (control["used"], control["rejected"]) == (6, 0)
    assert 0.4 < control["rms"] < 1.2
    assert "control points scatter" in json.dumps(facts["wrong_groups"])
    named = next(each for each in facts["blunders"] if each["point"] == "gcp04")
    assert named["image"] == "IMG_0031.jpg"
    assert "where point 'gcp00' lies" in named["cause"]
    # What is declared changes nothing: 0.2 m would have one of six points left out, and the roll free with it; with
    # 0.02 m in height, too, the first robust step threw the block away.
    text = Path(project).read_text()
    for sigma in (0.2, 0.02):
        Path(project).write_text(text.replace("[adjust]", f"[adjust]\nsigma_xy = {sigma}\nsigma_z = {sigma}", 1))
        assert run(["run", project, "match", "orient"]) == 3
        facts = json.loads((tmp_path / "output" / "adjustment.json").read_text())
        control = facts["observations"][1]
        assert (control["used"], control["rejected"]) == (6, 0)
        assert 0.4 < control["rms"] < 1.2
