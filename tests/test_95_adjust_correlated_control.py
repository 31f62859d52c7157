"""Control whose accuracy differs between axes, or is correlated, from the table to the solution."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from adjust_project_rig import grid_block, write_project
from block_rig import GROUND, MIDDLE
from pyproj import CRS

import geomosaic as gm
from geomosaic.block_adjustment.groups import control_group
from geomosaic.block_adjustment.measurements import control_of, measurements
from geomosaic.errors import InputError
from geomosaic.geo.transform import Transform
from geomosaic.inputs.control_points import read_block, read_control
from geomosaic.inputs.declarations import Block
from geomosaic.options.adjustment import AdjustmentOptions
from geomosaic.orientation.block.frame import BlockFrame

HEADER = "id,x,y,z,image,col,row"
EACH = "sigma_x,sigma_y,sigma_z,cor_x_y,cor_x_z,cor_y_z"
SIGMAS, CORRELATION = np.array([0.3, 0.1, 0.2]), np.array([[1.0, 0.8, -0.3], [0.8, 1.0, 0.1], [-0.3, 0.1, 1.0]])
COVARIANCE = CORRELATION * np.outer(SIGMAS, SIGMAS)
TOLD = "0.3,0.1,0.2,0.8,-0.3,0.1"


def table(path: Path, columns: str, values: str, xyz: str = "500000,5500000,300") -> Path:
    images = ("a.tif", "b.tif")
    rows = [f"p,{xyz},{image},{100 + k},200,{values}" for k, image in enumerate(images)]
    path.write_text("\n".join([f"{HEADER},{columns}", *rows]) + "\n")
    return path


def reaching(path: Path, crs: str) -> np.ndarray:
    """Covariance (3, 3) of the table's point in the block's frame, as the adjustment is told it."""
    block = Block((Path("a.tif"), Path("b.tif")), "frame", control=path, crs=crs, heights="ellipsoidal")
    control = control_of([block], ("a.tif", "b.tif"), GROUND)
    measured, _ = measurements({"a.tif": (400, 400), "b.tif": (400, 400)}, None, control, AdjustmentOptions())
    group = control_group(measured, FRAME, FRAME.from_ground(measured.given))
    return np.linalg.inv(group.root[0].T @ group.root[0])


FRAME = BlockFrame.at(GROUND, np.array([[*MIDDLE, 300.0]]))


def test_a_covariance_of_the_table_reaches_the_adjustment_along_its_axes(tmp_path: Path) -> None:
    found = reaching(table(tmp_path / "c.csv", EACH, TOLD), "EPSG:32633")
    # On the central meridian grid north is north.
    assert np.allclose(found, COVARIANCE, rtol=0.0, atol=1e-5)


def test_a_covariance_along_the_axes_of_another_crs_is_turned(tmp_path: Path) -> None:
    place = np.array([[*MIDDLE, 300.0]])
    zone = CRS("EPSG:32632").to_3d()
    x, y, z = Transform(GROUND, zone)(place)[0]
    found = reaching(table(tmp_path / "c.csv", EACH, TOLD, f"{x},{y},{z}"), "EPSG:32632")
    # Six degrees from its meridian, at 49.6 degrees north: by the convergence of the zone's meridians.
    latitude = Transform(GROUND, CRS("EPSG:4326").to_3d())(place)[0][1]
    angle = np.arctan(np.tan(np.radians(6.0)) * np.sin(np.radians(latitude)))
    turn = np.array([[np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    expected = turn @ COVARIANCE @ turn.T
    assert np.allclose(found, expected, rtol=0.0, atol=1e-4)
    assert np.abs(found - COVARIANCE).max() > 5e-3


def test_standard_deviations_of_each_axis_need_no_correlations(tmp_path: Path) -> None:
    found = reaching(table(tmp_path / "c.csv", "sigma_x,sigma_y", "0.3,0.1"), "EPSG:32633")
    assert np.allclose(found, np.diag([0.09, 0.01, 0.0009]), rtol=0.0, atol=1e-6)


def test_control_may_be_off_along_its_long_axis_and_no_other(tmp_path: Path) -> None:
    block = grid_block(2, 3, 30, seed=3, control=9)
    block.start = block.models
    write_project(tmp_path, block)
    lines = (tmp_path / "control.csv").read_text().splitlines()
    moved = []
    for line in lines[1:]:
        name, x, y, *rest = line.split(",")
        off = 0.6 if name == "c0" else 0.0
        more = ["0.5,0.5,0.02,0.999,0,0"] if name == "c0" else ["0.02,0.02,0.02,,,"]
        moved.append(",".join([name, f"{float(x) + off:.4f}", f"{float(y) + off:.4f}", *rest[:4], *more, rest[-1]]))
    control = tmp_path / "each.csv"

    def adjusted(text: str) -> gm.AdjustedBlock:
        control.write_text("\n".join([f"{HEADER},{EACH},role", *text.splitlines()]) + "\n")
        photos = gm.Block(
            sorted((tmp_path / "photos").glob("*.tif")), "frame", camera=tmp_path / "camera.toml", crs="EPSG:32633",
            exterior=tmp_path / "exterior.csv", heights="ellipsoidal", control=control,
        )  # fmt: skip
        return gm.adjust(photos, ties=tmp_path / "ties.csv", sigma_px=0.3)

    assert not adjusted("\n".join(moved)).blunders
    across = "\n".join(moved).replace("0.999", "-0.999")
    assert {each.point for each in adjusted(across).blunders if each.kind == "control"} == {"c0"}


@pytest.mark.parametrize(
    ("columns", "values", "said"),
    [
        (EACH, "0.3,0.1,0.2,0.9,0.9,-0.9", "line 2: the correlations of point 'p' cannot be"),
        (EACH, "0.3,0.1,0.2,1.2,0,0", "line 2: the correlations of point 'p' cannot be"),
        (EACH, "0.3,0.1,,0.1,0.2,0", "line 2: point 'p' has cor_x_z, and no standard deviations of both"),
        (EACH, "0.3,,0.2,0,0,0", "line 2: one of sigma_x and sigma_y is given"),
        ("sigma_xy,sigma_x,sigma_y", "0.3,0.1,0.1", "line 2: point 'p' has sigma_xy, and sigma_x and sigma_y"),
        ("sigma_x,sigma_y", "-1,0.1", "line 2: sigma_x is -1"),
        ("sigma_x,sigma_y", "0,0.1", "line 2: sigma_x or sigma_y is 0"),
        (EACH, "0.3,0.1,0.2,nan,0,0", "line 2: column 'cor_x_y' has 'nan'"),
    ],
)
def test_accuracies_that_cannot_be_are_refused_with_line_and_point(
    tmp_path: Path, columns: str, values: str, said: str
) -> None:
    with pytest.raises(InputError, match=said) as error:
        read_control(table(tmp_path / "c.csv", columns, values), ("a.tif", "b.tif"), partial=True)
    assert error.value.hint


def test_lines_of_a_point_must_tell_one_accuracy(tmp_path: Path) -> None:
    path = table(tmp_path / "c.csv", EACH, TOLD)
    path.write_text(path.read_text().replace("101,200,0.3", "101,200,0.4"))
    with pytest.raises(InputError, match=r"line 3: point 'p' has other standard deviations .* than in .*line 2"):
        reaching(path, "EPSG:32633")


@pytest.mark.parametrize("planar", [False, True])
def test_commands_that_would_ignore_such_an_accuracy_refuse_it(tmp_path: Path, planar: bool) -> None:
    path = table(tmp_path / "c.csv", EACH, TOLD)
    with pytest.raises(InputError, match="line 2: column 'sigma_x' would do nothing") as error:
        read_block((), None, path) if planar else read_control(path, ("a.tif", "b.tif"))
    assert "geomosaic adjust" in (error.value.hint or "")
    # Empty columns say nothing.
    empty = table(tmp_path / "e.csv", EACH, ",,0.2,,,")
    (one, _) = read_control(empty, ("a.tif", "b.tif"))
    assert replace(one, image="b.tif").sigma_z == 0.2
