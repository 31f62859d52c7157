"""Positions of a table against those that the photos record themselves."""

from __future__ import annotations

from pathlib import Path

import pytest
from photo_rig import PLACES, photo

import geomosaic as gm
from geomosaic.errors import InputError
from geomosaic.geo.crs import parse_crs
from geomosaic.geo.transform import Transform
from geomosaic.inputs.build import build_block

CAMERA = "size = [400, 300]\nfocal_length_px = 400.0\n"


def block(folder: Path, code: str, *, trusted: bool = False, east: float = 0.0) -> gm.Block:
    """Photos whose table has their places in UTM zone 33, declared as another."""
    files = [photo(folder / f"{k}.jpg", place) for k, place in enumerate(PLACES)]
    lines = ["image,x,y,z,omega,phi,kappa"]
    for path, (x, y) in zip(files, Transform(parse_crs("EPSG:4326"), parse_crs("EPSG:32633"))(PLACES), strict=True):
        lines.append(f"{path.name},{x + east:.3f},{y:.3f},150.0,0,0,0")
    (folder / "exterior.csv").write_text("\n".join(lines) + "\n")
    (folder / "camera.toml").write_text(CAMERA)
    return gm.Block(
        files, "frame", camera=folder / "camera.toml", exterior=folder / "exterior.csv", crs=code,
        heights="ellipsoidal", height=40.0, trusted=trusted,
    )  # fmt: skip


def test_a_block_in_the_wrong_zone_is_told_by_what_its_photos_record(tmp_path: Path) -> None:
    for read in (build_block, lambda inputs: gm.adjust(inputs, ties=tmp_path / "ties.csv", position_sigma=3.0)):
        with pytest.raises(InputError, match=r"positions lie 40[0-9] km from where the photos record") as told:
            read(block(tmp_path, "EPSG:32634"))
        assert "in EPSG:32633 they agree with the photos" in (told.value.hint or "")


def test_positions_a_few_kilometres_off_and_those_that_are_trusted_pass(tmp_path: Path) -> None:
    build_block(block(tmp_path, "EPSG:32633", trusted=False, east=5000.0))
    build_block(block(tmp_path, "EPSG:32634", trusted=True))
