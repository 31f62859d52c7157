"""What goes wrong with a product is said, and leaves nothing behind."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from product_rig import GROUND, GSD, MAP, SMALL, Strip, job, make_strip, write

from geomosaic.errors import GeomosaicError, InputError, OutputExistsError, RasterReadError
from geomosaic.mosaicking.mosaic import mosaic
from geomosaic.render.extent import output_grid
from geomosaic.render.ortho import ortho
from geomosaic.testing.synthetic import CAMERA, SyntheticPhoto


@pytest.fixture(scope="module")
def strip(tmp_path_factory: pytest.TempPathFactory) -> Strip:
    return make_strip(tmp_path_factory.mktemp("strip"))


def refused(call: Callable[[], object], folder: Path, kind: type[GeomosaicError] = InputError) -> GeomosaicError:
    """Call what must fail; nothing may be left of the output, whole or partial."""
    before = {path.name for path in folder.iterdir()}
    with pytest.raises(kind) as caught:
        call()
    assert {path.name for path in folder.iterdir()} == before
    assert caught.value.what
    assert caught.value.hint
    return caught.value


def test_an_image_outside_the_dem(strip: Strip, tmp_path: Path) -> None:
    x, y, z = strip.photos[0].position
    away = replace(strip.photos[0], position=(x + 9000.0, y, z))
    error = refused(lambda: job(strip.dem, strip.files[:1], [away], GSD), tmp_path)
    assert error.where == away.name
    assert "DEM" in error.what


def test_an_image_of_the_sky(strip: Strip, tmp_path: Path) -> None:
    up = replace(strip.photos[0], angles=(180.0, 0.0, 0.0))
    error = refused(lambda: job(strip.dem, strip.files[:1], [up], GSD), tmp_path)
    assert "sky" in error.what
    assert "angle" in str(error.hint)


def test_an_image_that_is_not_the_models(strip: Strip, tmp_path: Path) -> None:
    other = write(tmp_path / "other.tif", np.zeros((30, 40, 3), dtype=np.uint8))
    made = job(strip.dem, [other, *strip.files[1:]], strip.photos, GSD)
    for call in (made.ortho, made.mosaic):
        error = refused(lambda call=call: call(tmp_path / "out.tif"), tmp_path)
        assert error.where == str(other)
        assert "40 x 30" in error.what
        assert "400 x 300" in error.what


@pytest.mark.parametrize(("values", "word"), [((300, 400, 1), "1 band"), ((300, 400, 3), "uint16")])
def test_images_that_do_not_go_together(strip: Strip, tmp_path: Path, values: tuple[int, ...], word: str) -> None:
    other = write(tmp_path / "other.tif", np.ones(values, dtype="uint16" if word == "uint16" else "uint8"))
    made = job(strip.dem, [*strip.files[:3], other], strip.photos, GSD)
    error = refused(lambda: made.mosaic(tmp_path / "out.tif"), tmp_path)
    assert error.where == str(other)
    assert word in error.what


def test_a_missing_image(strip: Strip, tmp_path: Path) -> None:
    made = job(strip.dem, [tmp_path / "none.tif", *strip.files[1:]], strip.photos, GSD)
    for call in (made.ortho, made.mosaic):
        error = refused(lambda call=call: call(tmp_path / "out.tif"), tmp_path)
        assert "none.tif" in str(error.where)


def test_bounds_that_miss(strip: Strip, tmp_path: Path) -> None:
    made = job(strip.dem, strip.files, strip.photos, GSD)
    error = refused(lambda: output_grid(MAP, made.outlines, GSD, (0.0, 0.0, 1000.0, 1000.0)), tmp_path)
    assert "bounds" in error.what
    # Bounds within the outlines' box, where nevertheless no photo is: a corner of the grid.
    left, _, _, top = made.grid.bounds
    corner = replace(made, grid=output_grid(MAP, made.outlines, 0.1, (left, top - 2.0, left + 2.0, top)))
    for call in (corner.ortho, corner.mosaic):
        refused(lambda call=call: call(tmp_path / "out.tif"), tmp_path)


def test_an_output_that_exists_stays(strip: Strip, tmp_path: Path) -> None:
    made = job(strip.dem, strip.files, strip.photos, GSD)
    old = tmp_path / "out.tif"
    old.write_bytes(b"precious")
    for call in (
        lambda: ortho(made.block.scenes[0], made.block.surface, made.grid, made.outlines[0], old),
        lambda: mosaic(made.block, made.grid, made.outlines, old),
    ):
        refused(call, tmp_path, OutputExistsError)
        assert old.read_bytes() == b"precious"


@pytest.mark.parametrize("kind", ["jpg", "tif"])
def test_a_truncated_image(strip: Strip, sample: Path, tmp_path: Path, kind: str) -> None:
    if kind == "jpg":
        whole = sample / "photos" / "strip1_01.jpg"
        camera, photo = CAMERA, SyntheticPhoto("cut", (400_010.0, 5_500_020.0, GROUND.base + 1000.0), (0.0, 0.0, 0.0))
    else:
        whole, camera, photo = strip.files[0], SMALL, strip.photos[0]
    cut = tmp_path / f"cut.{kind}"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])

    def run(product: str) -> None:
        made = job(strip.dem, [cut], [photo], GSD, camera)
        getattr(made, product)(tmp_path / "out.tif")

    for product in ("ortho", "mosaic"):
        error = refused(lambda product=product: run(product), tmp_path, RasterReadError)
        assert "cut" in str(error.where)


FULL_DISK = """
import resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
from geomosaic.cli.main import main
main(sys.argv[1:])
"""


@pytest.mark.parametrize(
    ("command", "driver"),
    [
        ("ortho", "COG"),
        ("mosaic", "GTiff"),
        pytest.param("ortho", "GTiff", marks=pytest.mark.slow),
        pytest.param("mosaic", "COG", marks=pytest.mark.slow),
    ],
)
def test_a_full_disk(sample: Path, tmp_path: Path, command: str, driver: str) -> None:
    """A limit on the size of files stands in for the disk: writing fails halfway through."""
    images = sorted((sample / "photos").glob("strip1_0[12].jpg"))
    words = [
        command, *map(str, images[: 1 if command == "ortho" else 2]), "--sensor", "frame", "--camera", "camera.toml",
        "--exterior", "exterior.csv", "--crs", "EPSG:32633", "--heights", "egm96", "--dem", "dem.tif", "--res", "1",
        "-f", driver, "--co", "COMPRESS=NONE", "-o", str(tmp_path / "out.tif"),
    ]  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, *words], cwd=sample, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 1, done.stderr
    assert "out" in done.stderr
    assert "hint" in done.stderr
    assert "fault of geomosaic" not in done.stderr
    assert not list(tmp_path.iterdir())
