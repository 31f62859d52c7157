"""Errors name the parameter of the library, the flag of the command, the section and key of the project."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mosaic_rig as rig
import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

import geomosaic as gm
from geomosaic.cli.main import run
from geomosaic.errors import GeomosaicError
from geomosaic.inputs.build import build_block


def rig_scene() -> gm.Scene:
    """Scene of a georeferenced image, which its own tags place."""
    return gm.Scene("a.tif", "planar")


MADE: list[tuple[Callable[[], Any], str, str]] = [
    (lambda: gm.Scene("a.tif", kamera=1), "", "no option is named `kamera`"),
    (lambda: gm.MosaicOptions.of(seam_weights={"colour": -1}), "`seam_weights`", "colour: -1 is out of range"),
    (lambda: gm.SeamOptions(rul="last"), "", "no option is named `rul`"),  # type: ignore[call-arg]
    (lambda: gm.Block("a.tif", heigth=1), "", "no option is named `heigth`"),
    (lambda: gm.Grid("EPSG:32633", Affine.identity(), 3, 3), "`crs`", "str is no CRS"),
    (lambda: gm.Grid(CRS(32633), None, 3, 3), "`transform`", "NoneType is no Affine"),
    (lambda: gm.Exterior(1, 2, 3, 0, 0, 0, crs="EPSG:99999"), "`crs`", "is not a coordinate reference system"),
    (lambda: build_block(gm.Block("a.tif", "frame", camera="no.toml")), "no.toml", "the file of `camera` does not"),
    (lambda: build_block(gm.Block("a.tif", "frame", dem="no.tif")), "no.tif", "the file of `dem` does not exist"),
    (lambda: gm.Block("a.tif", "frame", angles="okp"), "`angles`", "'okp' is not known here"),
    (lambda: gm.mosaic("a.tif", "b.tif", blend=gm.BlendOptions()), "", "`blend` takes no BlendOptions"),
    (lambda: gm.enhance("a.tif", "b.tif", gamma=-1), "`gamma`", "-1 is out of range"),
    (lambda: gm.locate(rig_scene(), [[5, 5]], dst_crs="EPSG:99999"), "`dst_crs`", "'EPSG:99999' is not a"),
    (lambda: build_block(gm.Block("a.tif", "planr")), "`sensor`", "no sensor named 'planr'"),
]


@pytest.mark.parametrize(("make", "where", "what"), MADE, ids=[case[2] for case in MADE])
def test_a_wrong_value_of_the_library_is_refused_by_its_name(
    make: Callable[[], Any], where: str, what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rig.write(tmp_path / "a.tif", np.full((20, 20, 1), 90, np.uint8))
    with pytest.raises(GeomosaicError, match=what) as caught:
        make()
    assert (caught.value.where or "") == where
    assert caught.value.hint


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--master", "no"], "--master: no image is called 'no'"),
        (["--base", "no"], "--base: no image is called 'no'"),
        (["--exclude", "no"], "--exclude: 'no' is no image of this mosaic"),
        (["--co", "COMPRES=LZW"], "no option of --co is named COMPRES"),
        (["--co", "COMPRESS=NO"], "--co COMPRESS=NO is not possible"),
        (["--tolerance", "-1"], "'--tolerance': -1 is out of range; give a number"),
        (["--tolerance", "nan"], "'--tolerance': nan is no finite number; give a number"),
        (["--threads", "1.5"], "'--threads': '1.5' is not a whole number; give a whole number"),
        (["--sensor", "planr"], "--sensor: no sensor named 'planr'"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_a_wrong_value_of_a_command_is_refused_by_its_flag(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = rig.write(tmp_path / "a.tif", np.full((20, 20, 1), 90, np.uint8))
    assert run(["mosaic", str(image), "-o", str(tmp_path / "out.tif"), *words]) in (1, 2)
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ('[sensor]\nname = "planar"\n[exterior]\ncrs = "EPSG:99999"', "[exterior] crs: 'EPSG:99999' is not a"),
        ('[sensor]\nname = "planar"\n[output]\ncrs = "EPSG:99999"', "[output] crs: 'EPSG:99999' is not a"),
        ('[sensor]\nname = "planr"', "[sensor] name: no sensor named 'planr'"),
        ('[sensor]\nname = "frame"\n[exterior]\ncrs = "EPSG:9"\n[dem]\nheight = 1', "[exterior] crs: 'EPSG:9' is not"),
        ('[sensor]\nname = "frame"\n[exterior]\nangles = "okp"', "[exterior] angles: 'okp' is not known here: did you"),
        ('[sensor]\nname = "planar"\n[output]\ntolerance = -1', "[output] tolerance: -1 is out of range: give a"),
        ('[sensor]\nname = "planar"\n[studio]\nbase_map_zoom = 30', "[studio] base_map_zoom: 30 is out of range: give"),
        ('[sensor]\nname = "planar"\n[control]\nfile = ["a"]', "[control] file"),
        ("sensor = 3", "[project] sensor: unknown key"),
    ],
    ids=lambda value: value[:40],
)
def test_a_wrong_value_of_a_project_is_refused_by_its_key(
    lines: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig.write(tmp_path / "a.tif", np.full((20, 20, 1), 90, np.uint8))
    project = tmp_path / "block.toml"
    project.write_text(f'format = 1\n[project]\nimages = ["a.tif"]\n{lines}\n')
    assert run(["run", str(project)]) == 1
    assert said in capsys.readouterr().err
