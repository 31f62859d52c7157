"""Photos of two cameras that are declared as one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from photo_rig import PLACES, photo

import geomosaic as gm
from geomosaic.errors import GeomosaicError, InputError
from geomosaic.geo.crs import parse_crs
from geomosaic.geo.transform import Transform

SECOND: dict[str, dict[str, Any]] = {"model": {"camera": "Other"}, "focal length": {"equivalent": 50}}


def block(folder: Path, *, trusted: bool = False, **second: Any) -> gm.Block:
    """Photos of one size, the last of which another camera has taken."""
    last = len(PLACES) - 1
    files = [photo(folder / f"{k}.jpg", place, **(second if k == last else {})) for k, place in enumerate(PLACES)]
    lines = ["image,x,y,z,omega,phi,kappa"]
    for path, (x, y) in zip(files, Transform(parse_crs("EPSG:4326"), parse_crs("EPSG:32633"))(PLACES), strict=True):
        lines.append(f"{path.name},{x:.3f},{y:.3f},150.0,0,0,0")
    (folder / "exterior.csv").write_text("\n".join(lines) + "\n")
    (folder / "camera.toml").write_text("size = [400, 300]\nfocal_length_px = 400.0\n")
    (folder / "ties.csv").write_text("id,image,col,row\na,0.jpg,10,10\na,1.jpg,10,10\n")
    return gm.Block(
        files, "frame", camera=folder / "camera.toml", exterior=folder / "exterior.csv", crs="EPSG:32633",
        heights="ellipsoidal", height=40.0, trusted=trusted,
    )  # fmt: skip


@pytest.mark.parametrize("recorded", SECOND)
def test_two_cameras_of_one_size_declared_as_one_are_told_by_what_their_photos_record(
    tmp_path: Path, recorded: str
) -> None:
    mixed = block(tmp_path, **SECOND[recorded])
    with pytest.raises(
        InputError, match=rf"0\.jpg and {len(PLACES) - 1}\.jpg are .* record another {recorded}"
    ) as told:
        gm.adjust(mixed, ties=tmp_path / "ties.csv", position_sigma=3.0, interior=["focal_length"])
    assert "[[images]]" in (told.value.hint or "")


def test_trusted_photos_and_a_camera_that_is_not_to_be_found_pass(tmp_path: Path) -> None:
    for trusted, interior in ((True, ["focal_length"]), (False, [])):
        given = block(tmp_path, trusted=trusted, camera="Other")
        with pytest.raises(GeomosaicError) as told:  # one point is too little
            gm.adjust(given, ties=tmp_path / "ties.csv", interior=interior)
        assert "record another" not in str(told.value)
