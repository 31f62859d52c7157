"""Photos of a drone, whose orientation from EXIF and XMP is off by metres: overlaps of other ground say nothing."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from geomosaic.cli.main import run

RealData = Callable[[str], Path]


def test_misregistered_overlaps_change_no_colour(
    real_data: RealData, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Trusted, they gave gains of 0.79 to 1.34 and offsets to −61, and 3 % of the pixels a band at 0."""
    images = [real_data("drone-brighton-block") / "images" / f"DJI_00{number}.JPG" for number in (21, 22)]
    (tmp_path / "images").mkdir()
    copies = [str(shutil.copy(path, tmp_path / "images")) for path in images]
    heights = ("--height", "158.5", "--heights", "egm96", "--dem-heights", "egm96")
    project = tmp_path / "p.toml"
    assert run(["new", str(project), *copies, *heights]) == 0
    text = project.read_text().replace("# resolution = 0.5 ", "resolution = 1.2 ")
    text = text.replace("# max_clipped_percent", "max_clipped_percent")
    # As the camera tells the orientation: tie points would mend it.
    text = re.sub(r"(?ms)^\[(match|adjust)\].*?(?=^\[)", "", text)
    project.write_text(text)
    assert run(["run", str(project)]) == 0, capsys.readouterr().err
    facts: dict[str, Any] = json.loads((tmp_path / "output" / "report.json").read_text())["mosaic"]
    for image in facts["images"]:
        assert image["gain"] == [1.0] * 3
        assert image["offset"] == [0.0] * 3
    assert facts["colour"]["radiometric_change"] == dict.fromkeys(facts["colour"]["radiometric_change"], 0.0)
    (note,) = facts["colour"]["notes"]
    assert note.startswith("misregistered, ")
    assert "DJI_0021.JPG and DJI_0022.JPG" in note
