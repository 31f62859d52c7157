"""Control of several photos: what does not fit its CRS, or itself, is refused before anything is computed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from geomosaic.block import ControlPoint
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import parse_crs
from geomosaic.inputs.control_points import check_control, read_control

UTM = parse_crs("EPSG:32633")


def points(scale: float = 1.0, *, swap: bool = False) -> list[ControlPoint]:
    """Points of two photos on a square kilometre, pixels of 1 m."""
    random = np.random.default_rng(2)
    made = []
    for image, shift in (("a.tif", 0.0), ("b.tif", 400.0)):
        for i, (c, r) in enumerate(random.uniform(0.0, 600.0, (5, 2))):
            x, y = (500_000.0 + c + shift) * scale, (5_400_000.0 - r) * scale
            x, y = (y, x) if swap else (x, y)
            made.append(ControlPoint(f"{image}{i}", (x, y, 0.0), image, (float(c), float(r))))
    return made


def test_good_control_passes() -> None:
    check_control(points(), UTM, None)


@pytest.mark.parametrize(
    ("wrong", "said"), [(points(swap=True), "x and y|exchanged|swapped"), (points(1e-5), "degrees")]
)
def test_coordinates_that_do_not_fit_their_crs(wrong: list[ControlPoint], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        check_control(wrong, UTM, None)
    assert caught.value.hint


def test_one_place_with_two_grounds_is_named() -> None:
    made = points()
    made.append(ControlPoint("twice", (500_900.0, 5_399_000.0, 0.0), "a.tif", made[0].colrow))
    with pytest.raises(InputError, match=r"twice.*one-place-two-grounds|one-place-two-grounds") as caught:
        check_control(made, UTM, None)
    assert "a.tif" in str(caught.value)


def test_who_insists_goes_on_and_is_warned() -> None:
    with pytest.warns(GeomosaicWarning, match="swapped-axes"):
        check_control(points(swap=True), UTM, None, "keep")
    with pytest.raises(InputError, match="`insist`"):
        check_control(points(swap=True), UTM, None, "leave")


def test_points_that_are_switched_off_do_not_count(tmp_path: Path) -> None:
    path = tmp_path / "gcps.csv"
    header = "id,x,y,z,image,col,row,enabled"
    path.write_text(f"{header}\na,1,2,3,a.tif,5,6,1\nb,4,5,6,a.tif,7,8,0\nc,7,8,9,a.tif,9,9,\n")
    assert [point.id for point in read_control(path, ["a.tif"])] == ["a", "c"]
    path.write_text(f"{header}\na,1,2,3,a.tif,5,6,maybe\n")
    with pytest.raises(InputError, match="enabled") as caught:
        read_control(path, ["a.tif"])
    assert "line 2" in str(caught.value.where)
