"""Bad input: each with a message, exit code 1, and nothing under the final name."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from cli_rig import PHOTOS, elsewhere, flags, photos

from geomosaic.cli.output import failed
from geomosaic.errors import InputError


def spoil(block: Path, tmp_path: Path, kind: str) -> tuple[list[str], dict[str, object], tuple[str, ...]]:
    """Image, changed flags, and words that the message must have."""
    image = photos(block)[0]
    table = (block / "exterior.csv").read_text()
    spoiled = tmp_path / "exterior.csv"

    def angles(change: Callable[[list[str]], list[str]]) -> Path:
        lines = table.splitlines()
        spoiled.write_text("\n".join([lines[0], *(",".join(change(line.split(","))) for line in lines[1:])]))
        return spoiled

    if kind == "missing image":
        return [str(tmp_path / "none.jpg")], {}, ("none.jpg", "does not exist")
    if kind == "truncated image":
        cut = tmp_path / PHOTOS[0]
        cut.write_bytes(Path(image).read_bytes()[:90_000])
        return [str(cut)], {}, (PHOTOS[0],)
    if kind == "no vertical datum":
        return [image], {"heights": None}, ("no vertical datum", " m here", " px", "--heights")
    if kind == "no vertical datum of the DEM":
        bare = tmp_path / "dem.tif"
        with rasterio.open(block / "dem.tif") as source:
            profile = source.profile | {"crs": "EPSG:32633"}
            with rasterio.open(bare, "w", **profile) as target:
                target.write(source.read())
        return [image], {"dem": bare}, ("no vertical datum", " m here", " px", "--dem-heights")
    if kind == "DEM elsewhere":
        away = tmp_path / "dem.tif"
        with rasterio.open(block / "dem.tif") as source:
            t = source.transform
            profile = source.profile | {"transform": rasterio.Affine(t.a, t.b, t.c + 1e5, t.d, t.e, t.f)}
            with rasterio.open(away, "w", **profile) as target:
                target.write(source.read())
        return [image], {"dem": away}, ("outside the DEM", PHOTOS[0])
    if kind == "DEM of NaN":
        empty = tmp_path / "dem.tif"
        with rasterio.open(block / "dem.tif") as source, rasterio.open(empty, "w", **source.profile) as target:
            target.write(np.full((1, *source.shape), np.nan, np.float32))
        return [image], {"dem": empty}, ("DEM", "no height")
    if kind == "sky":
        return [image], {"exterior": angles(lambda row: [*row[:4], str(float(row[4]) + 180), *row[5:]])}, ("sky",)
    if kind == "radians":
        turn = angles(lambda row: [*row[:4], *(str(float(v) * np.pi / 180) for v in row[4:])])
        return photos(block), {"exterior": turn}, ("radians", "rad")
    if kind == "wrong CRS":
        return [image], {"crs": "EPSG:99999"}, ("EPSG:99999", "not a coordinate reference system")
    if kind == "vertical CRS":
        return [image], {"crs": "EPSG:5773"}, ("EPSG:5773", "vertical CRS", "horizontal CRS")
    if kind == "geocentric CRS with a geoid":
        return [image], {"crs": "EPSG:4978"}, ("geocentric", "egm96")
    if kind == "unknown sensor":
        return [image], {"sensor": "farme"}, ("did you mean 'frame'",)
    if kind == "unknown input":
        return [image], {"option": "treatmnet=planar"}, ("did you mean 'treatment'",)
    if kind == "no camera":
        return [image], {"camera": tmp_path / "none.toml"}, ("none.toml", "does not exist")
    if kind == "height for a DEM":
        return [image], {"dem": "300"}, ("300: the file of --dem", "--height")
    if kind == "not an image":
        text = tmp_path / PHOTOS[0]
        text.write_text("this is no image")
        return [str(text)], {}, ("not a raster",)
    raise ValueError(kind)


KINDS = (
    "missing image", "truncated image", "no vertical datum", "no vertical datum of the DEM", "DEM elsewhere",
    "DEM of NaN", "sky", "radians", "wrong CRS", "vertical CRS", "geocentric CRS with a geoid",
    "unknown sensor", "unknown input", "no camera", "height for a DEM", "not an image",
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_bad_input_is_named_and_leaves_nothing(tell, block, tmp_path, kind):
    images, change, said = spoil(block, tmp_path, kind)
    out = tmp_path / "out"
    out.mkdir()
    words = ["mosaic", *images, *flags(block, **change), "--res", 8, "-o", out / "m.tif"]
    code, printed, err = tell(*words)
    assert (code, printed) == (1, ""), err
    for word in said:
        assert word in err, err
    assert "fault of geomosaic" not in err
    assert not list(out.iterdir())
    code, printed, err = tell(*words, "--json")
    assert code == 1
    assert set(json.loads(printed)["error"]) == {"what", "where", "hint"}


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limits")
def test_a_full_disk_leaves_nothing_behind(block, tmp_path):
    import resource

    out = tmp_path / "out"
    out.mkdir()
    done = elsewhere(
        "ortho", photos(block)[0], *flags(block), "--res", 2, "-f", "GTiff", "-o", out / "o.tif",
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000)),
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "o.tif" in done.stderr
    assert "fault of geomosaic" not in done.stderr
    assert not list(out.iterdir())


@pytest.mark.parametrize(
    ("path", "shown"),
    [
        ("{here}/sub/../b.tif", "b.tif"),
        ("{here}/../b.tif", "../b.tif"),
        ("{here}/my data/../your data/b.tif", "your data/b.tif"),
        ("{here}/a/b/../../c/b.tif", "c/b.tif"),
        ("{here}-other/b.tif", "{here}-other/b.tif"),
        ("/far/sub/../b.tif", "/far/b.tif"),
        ("../../b.tif", "../../b.tif"),
        ("1/../2 of a/b", "1/../2 of a/b"),
    ],
)
def test_paths_in_errors_are_those_that_the_user_typed(
    path: str, shown: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    where = path.format(here=here)
    failed(InputError("it is damaged", where=where, hint=f"look at '{where}'"), as_json=False, debug=False)
    told = capsys.readouterr().err
    assert told == f"error: {shown.format(here=here)}: it is damaged\n  hint: look at '{shown.format(here=here)}'\n"


@pytest.mark.parametrize(
    ("turned", "words"), [((0.5, 4e5, 0.0, -0.5), "a line of the map"), ((0.5, 4e5, 4e5, -0.5), "400000 metre")]
)
def test_a_world_file_of_a_great_turn_ends_at_once(tell, tmp_path, turned, words):
    image, out = tmp_path / "a.tif", tmp_path / "o.tif"
    profile = {"driver": "GTiff", "width": 40, "height": 30, "count": 1, "dtype": "uint8"}
    with rasterio.open(image, "w", **profile) as file:
        file.write(np.full((1, 30, 40), 7, np.uint8))
    image.with_suffix(".tfw").write_text("".join(f"{value}\n" for value in (*turned, 500000.25, 5500000.25)))
    _, said, err = tell("mosaic", image, "--crs", "EPSG:32633", "-o", out)
    assert words in said + err
    assert "unexpected" not in err
    assert "share no ground" not in err
