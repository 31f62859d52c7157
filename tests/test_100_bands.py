"""Some bands of the images: `--bidx` and `bands` in a project, from the file to the product."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio

from geomosaic.cli.main import run
from geomosaic.cli.options import band_numbers

NAMES = ("blue", "green", "red", "near", "heat")


def image(path: Path, bands: int, left: float = 500_000.0) -> Path:
    """A georeferenced image of 64 x 48 pixels of 1 m, whose bands are 40, 80, ... with some noise."""
    values = np.random.default_rng(int(left) + bands).integers(0, 9, (bands, 48, 64))
    values += 40 * np.arange(1, bands + 1)[:, None, None]
    transform = rasterio.Affine(1, 0, left, 0, -1, 5_500_000)
    with rasterio.open(
        path, "w", driver="GTiff", width=64, height=48, count=bands, dtype="uint8", crs="EPSG:32633",
        transform=transform, photometric="minisblack",
    ) as file:  # fmt: skip
        file.write(values.astype(np.uint8))
        file.descriptions = NAMES[:bands]
    return path


def read(path: Path) -> tuple[np.ndarray, tuple[str | None, ...]]:
    with rasterio.open(path) as file:
        return file.read(), file.descriptions


@pytest.mark.parametrize("flags", [["--bidx", "4,2"], ["-b", "4", "--bidx", "2"]])
def test_an_ortho_of_some_bands_in_their_order(tmp_path: Path, flags: list[str]) -> None:
    source, out = image(tmp_path / "five.tif", 5), tmp_path / "o.tif"
    words = ["ortho", str(source), *flags, "--resampling", "nearest", "--res", "1", "-o", str(out)]
    assert run(words) == 0
    values, names = read(out)
    assert names == ("near", "green")
    assert np.array_equal(values, read(source)[0][[3, 1]])


def test_a_mosaic_of_images_with_other_numbers_of_bands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(image(tmp_path / "a.tif", 4)), str(image(tmp_path / "b.tif", 3, 500_040.0))]
    words = ["mosaic", *files, "--res", "1", "--resampling", "nearest", "--no-balance", "--feather", "0", "-o"]
    assert run([*words, str(tmp_path / "none.tif")]) == 1
    assert "--bidx" in capsys.readouterr().err
    assert run([*words, str(tmp_path / "m.tif"), "--bidx", "3,2,1"]) == 0
    values, names = read(tmp_path / "m.tif")
    assert names == ("red", "green", "blue")
    assert values.shape == (3, 48, 104)
    assert np.array_equal(values[:, :, :40], read(Path(files[0]))[0][[2, 1, 0], :, :40])
    assert np.array_equal(values[:, :, 64:], read(Path(files[1]))[0][[2, 1, 0], :, 24:])
    # With balance too, and as many gains as bands.
    assert run(["mosaic", *files, "--res", "1", "-b", "1,2", "-o", str(tmp_path / "c.tif"), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out.splitlines()[-1])["overlap_difference_after"]) == 2


def test_a_project_of_some_bands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(image(tmp_path / "a.tif", 4)), str(image(tmp_path / "b.tif", 3, 500_040.0))]
    project = tmp_path / "some.toml"
    assert run(["new", str(project), *files, "--bidx", "3,1"]) == 0
    assert "2 x uint8" in capsys.readouterr().out
    assert "\nbands = [3, 1]" in project.read_text()
    assert run(["run", str(project)]) == 0
    assert read(tmp_path / "output" / "some.tif")[1] == ("red", "blue")
    project.write_text(project.read_text().replace("[3, 1]", "[2]"))
    assert run(["run", str(project)]) == 0
    assert read(tmp_path / "output" / "some.tif")[1] == ("green",)
    capsys.readouterr()
    project.write_text(project.read_text().replace("bands = [2]", "bands = [0]"))
    assert run(["run", str(project)]) == 1
    assert "[project] bands.0: 0 is out of range: give a number of 1 or more" in capsys.readouterr().err


def test_a_band_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = image(tmp_path / "a.tif", 3), tmp_path / "o.tif"
    assert run(["ortho", str(source), "--bidx", "1,4", "-o", str(out)]) == 1
    said = capsys.readouterr().err
    assert "no band 4: the file has bands 1 to 3" in said
    assert "a.tif" in said
    for words in ("0", "red", "1,,2", "-1", "1.5", ""):
        assert run(["ortho", str(source), "--bidx", words, "-o", str(out)]) == 2
        assert "band numbers" in capsys.readouterr().err
    assert not out.exists()


def test_no_choice_is_no_choice() -> None:
    assert band_numbers(None, None, ()) is None
