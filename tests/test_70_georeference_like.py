"""Image to image: an image registered to another, whose pixels it takes, with or without a CRS."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from test_70_georeference import CRS, PLAIN, affine_map, image, places, projective_map, table, texture

from geomosaic.cli.main import run
from geomosaic.errors import InputError
from geomosaic.georeferencing.run import Georeferenced, georeference

# Of the reference: 2.5 m, over the whole image.
GRID, COLS, ROWS = Affine(2.5, 0.0, 611_350.0, 0.0, -2.5, 5_411_600.0), 460, 400
# Columns to the right, rows down: a raw image has no other frame.
RAW = Affine(1.0, 0.0, 0.0, 0.0, -1.0, 0.0)


def reference(path: Path, crs: str | None, transform: Affine | None) -> Path:
    """The texture itself on the grid."""
    c, r = np.meshgrid(np.arange(COLS) + 0.5, np.arange(ROWS) + 0.5)
    x, y = GRID @ (c, r)
    values = texture(np.column_stack([x.ravel(), y.ravel()])).reshape(ROWS, COLS, 2)
    place = {} if transform is None else {"transform": transform}
    with rasterio.open(
        path, "w", driver="GTiff", width=COLS, height=ROWS, count=2, dtype="float32", crs=crs, **place
    ) as file:
        file.write(np.moveaxis(values, -1, 0).astype(np.float32))
    return path


def pairs(path: Path, colrow: np.ndarray, xy: np.ndarray) -> Path:
    there = np.column_stack((~GRID) @ xy.T)
    rows = [
        ",".join(map(repr, [k, *a, *b])) for k, (a, b) in enumerate(zip(colrow.tolist(), there.tolist(), strict=True))
    ]
    path.write_text("\n".join(["id,col,row,ref_col,ref_row", *rows]) + "\n")
    return path


def difference(made: Georeferenced, other: Path) -> tuple[float, float]:
    """RMS difference of grey values where the product has some, and the part of the reference that it covers."""
    with rasterio.open(made.path) as file, rasterio.open(other) as base:
        assert file.shape == base.shape
        seen = file.dataset_mask() > 0
        return float(np.sqrt(np.mean((file.read() - base.read())[:, seen] ** 2))), float(seen.mean())


@pytest.mark.parametrize("place", ["map", "transform alone", "nothing"])
def test_pairs_of_positions_register_an_image_to_another(tmp_path: Path, place: str) -> None:
    """The same ground appears in the same pixel of both, whatever the reference says of its own place."""
    own = {"map": (CRS, GRID), "transform alone": (None, GRID), "nothing": (None, None)}[place]
    base = reference(tmp_path / "june.tif", *own)
    colrow = places(5, 4)
    table_ = pairs(tmp_path / "pairs.csv", colrow, projective_map(colrow))
    made = georeference(
        image(tmp_path / "may.tif", projective_map), tmp_path / "out.tif", table_, like=base, model="projective",
        render=PLAIN,
    )  # fmt: skip
    assert made.solution.fit.rms_total < 1e-6
    rms, covered = difference(made, base)
    assert rms < 1.0  # of 255; half a pixel aside it is 6
    assert covered > 0.5
    with rasterio.open(made.path) as file:
        assert file.transform.almost_equals(own[1] or RAW)
        assert (file.crs is not None and file.crs.to_epsg() == 32633) == (place == "map")


def test_ground_coordinates_and_pairs_make_the_same_product(tmp_path: Path) -> None:
    base, scan, colrow = reference(tmp_path / "june.tif", CRS, GRID), image(tmp_path / "may.tif", affine_map), places()
    by_pairs = pairs(tmp_path / "pairs.csv", colrow, affine_map(colrow))
    by_place = table(tmp_path / "gcps.csv", colrow, affine_map(colrow))
    one = georeference(scan, tmp_path / "a.tif", by_pairs, like=base, model="affine", report=False, render=PLAIN)
    two = georeference(
        scan, tmp_path / "b.tif", by_place, crs=CRS, like=base, model="affine", report=False, render=PLAIN
    )
    np.testing.assert_allclose(one.read().filled(-1), two.read().filled(-1), atol=1e-3)
    # Counted by the centres of pixels, from 0, in both images.
    shifted = pairs(tmp_path / "centres.csv", colrow - 0.5, affine_map(colrow) - np.array([1.25, -1.25]))
    three = georeference(
        scan, tmp_path / "c.tif", shifted, pixels="centre", like=base, model="affine", report=False, render=PLAIN
    )
    np.testing.assert_allclose(three.read().filled(-1), two.read().filled(-1), atol=1e-3)


def test_coordinates_of_an_arbitrary_frame_need_no_crs(tmp_path: Path) -> None:
    base, scan, colrow = reference(tmp_path / "june.tif", None, GRID), image(tmp_path / "may.tif", affine_map), places()
    control = table(tmp_path / "gcps.csv", colrow, affine_map(colrow))
    made = georeference(scan, tmp_path / "a.tif", control, like=base, model="affine", render=PLAIN)
    assert difference(made, base)[0] < 1.0
    assert "unit" in (tmp_path / "a-control.html").read_text()
    assert made.facts["accuracy"]


def test_pairs_without_the_image_that_they_were_measured_in_are_refused(tmp_path: Path) -> None:
    base, scan, colrow = reference(tmp_path / "june.tif", CRS, GRID), image(tmp_path / "may.tif", affine_map), places()
    measured = pairs(tmp_path / "pairs.csv", colrow, affine_map(colrow))
    with pytest.raises(InputError, match="positions in another image, and none is given") as caught:
        georeference(scan, tmp_path / "a.tif", measured, dst_crs=CRS)
    assert "`like`" in str(caught.value.hint)
    with pytest.raises(InputError, match="and a CRS is given"):
        georeference(scan, tmp_path / "a.tif", measured, like=base, crs=CRS)
    measured.write_text("id,x,y,col,row,ref_col,ref_row\n1,1,2,3,4,5,6\n")
    with pytest.raises(InputError, match="column of ground coordinates"):
        georeference(scan, tmp_path / "a.tif", measured, like=base)


def test_the_command_takes_like(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base, scan, colrow = reference(tmp_path / "june.tif", None, None), image(tmp_path / "may.tif", affine_map), places()
    measured = pairs(tmp_path / "pairs.csv", colrow, affine_map(colrow))
    words = ["--gcps", str(measured), "--like", str(base), "--model", "affine", "-o", str(tmp_path / "out.tif")]
    assert run(["georeference", str(scan), *words]) == 0
    said = capsys.readouterr().out
    assert "frame of an image" in said
    assert " m;" not in said
    assert "Residual, pixel" in (tmp_path / "out-control.html").read_text()
    assert f"{COLS} x {ROWS} pixels of 1 pixel" in said
