"""`geomosaic mosaic` of georeferenced images from the command line."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path

import mosaic_rig as rig
import numpy as np

from geomosaic.cli.main import run


def call(*words: object) -> dict[str, object]:
    """Run the command; what it says as JSON."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        assert run(["mosaic", *map(str, words), "--json", "--overwrite"]) == 0
    found: dict[str, object] = json.loads(said.getvalue().splitlines()[-1])
    return found


def failing(*words: object) -> str:
    """Run the command, which is to fail; what it says."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        assert run(["mosaic", *map(str, words), "--overwrite"]) in (1, 2)
    return said.getvalue()


def flat(folder: Path) -> list[Path]:
    """Three images in a row that overlap, of values 50, 100 and 150."""
    return [
        rig.write(folder / f"{i}.tif", np.full((60, 100, 3), 50 * (i + 1), np.uint8), 60 * i, pixel=0.5)
        for i in range(3)
    ]


def test_rules_order_and_base(tmp_path: Path) -> None:
    files, out = flat(tmp_path), tmp_path / "out.tif"

    def along(*words: str) -> list[int]:
        call(*files, "-o", out, *words)
        return [int(v) for v in rig.read(out)[0][30, [10, 80, 110, 140, 200], 0]]

    assert along("--rule", "first") == [50, 50, 100, 100, 150]
    assert along("--method", "last") == [50, 100, 100, 150, 150]
    assert along("--rule", "first", "--base", "1.tif") == [50, 50, 100, 150, 150]
    assert along("--rule", "mean") == [50, 75, 100, 125, 150]
    plain = ("--no-balance", "--blend", "none")
    assert along(*plain, "--seams", "order") == [50, 50, 100, 100, 150]
    assert along(*plain, "--seams", "order", "--base", "0") == [50, 100, 100, 100, 150]
    assert along(*plain, "--base", "1") == [50, 50, 100, 150, 150]


def test_an_earlier_mosaic_among_the_images_is_left_out_and_a_photo_never_overwritten(tmp_path: Path) -> None:
    """A shell makes of *.tif the last mosaic and its labels, too."""
    files, out = flat(tmp_path), tmp_path / "out.tif"
    call(*files, "-o", out)
    once = out.read_bytes()
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        call(*sorted(tmp_path.glob("*.tif")), "-o", out)
    assert "out.tif is the file of an earlier mosaic: it is left out" in said.getvalue()
    assert "out-labels.tif is the file of an earlier mosaic's labels" in said.getvalue()
    assert out.read_bytes() == once
    assert "the output is one of the inputs" in failing(*files, "-o", files[1])


def test_widths_blends_and_depths(tmp_path: Path) -> None:
    files, out = flat(tmp_path), tmp_path / "out.tif"
    for words, width in ((("--feather", "20px"), 10.0), (("--feather", "5m"), 5.0), (("--feather", "3"), 3.0)):
        assert call(*files, "-o", out, *words)["feather"] == width
    for blend in (("overlap", "--ramp", "smooth"), ("multiband",)):
        call(*files, "-o", out, "--no-balance", "--blend", *blend)
        values = rig.read(out)[0][30, :, 0].astype(int)
        assert np.abs(np.diff(values)).max() <= 4
    call(*files, "-o", out, "--rule", "max", "--dtype", "uint16", "--convert", "range", "--bands", "blue,red")
    values = rig.read(out)[0]
    assert values.dtype == np.uint16
    assert values[30, [10, 200]].tolist() == [[50 * 257] * 2, [150 * 257] * 2]
    like = rig.write(tmp_path / "like.tif", np.zeros((20, 30, 1), np.uint8), 5, 5, pixel=2.0)
    grid = call(*files, "-o", out, "--rule", "first", "--like", like)["grid"]
    assert isinstance(grid, dict)
    assert (grid["width"], grid["height"], grid["resolution"]) == (30, 20, [2.0, 2.0])


def test_contradicting_input_is_reported(tmp_path: Path) -> None:
    files, out = flat(tmp_path), tmp_path / "out.tif"
    assert "write pixels as 20px" in failing(*files, "-o", out, "--feather", "wide")
    assert "no image is called 'x.tif'" in failing(*files, "-o", out, "--base", "x.tif")
    assert "leave out --bands or --bidx" in failing(*files, "-o", out, "--bidx", "1", "--bands", "red")
    assert "'byte' is not known here" in failing(*files, "-o", out, "--dtype", "byte")
    assert "no band is called 'nir'" in failing(*files, "-o", out, "--bands", "nir")
