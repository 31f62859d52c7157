"""Lakes, planes, lines and rigs from tables: what they bring a block, and what is told where they are wrong."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from adjust_project_rig import Block, grid_block, write_project
from block_rig import GROUND, SIZE, photo
from test_60_object_constraints import LAKE, UNIT, shaped

import geomosaic as gm
from geomosaic.block_adjustment.constraints import of_points, of_rigs
from geomosaic.block_adjustment.measurements import Measurements
from geomosaic.errors import GeomosaicWarning, InputError, SolveError
from geomosaic.geo.local_frames import angles_of, omega_phi_kappa
from geomosaic.options.adjustment import AdjustmentOptions
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.poses import Pose, pose_of

OPTIONS: dict[str, Any] = {"sigma_px": 0.3, "position_sigma": 20.0, "attitude_sigma": 0.5}


def declared(folder: Path, **more: Any) -> gm.Block:
    given = {
        "camera": folder / "camera.toml", "exterior": folder / "exterior.csv", "crs": "EPSG:32633",
        "heights": "ellipsoidal", "control": folder / "control.csv", **more,
    }  # fmt: skip
    return gm.Block(sorted((folder / "photos").glob("*.tif")), "frame", **given)


@pytest.fixture(scope="module", params=["lake", "line", pytest.param("plane", marks=pytest.mark.slow)])
def shape(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path, np.ndarray]:
    folder = tmp_path_factory.mktemp(request.param)
    block, on = shaped(request.param, control=5)
    write_project(folder, block)
    lines = [f"t{point},upper" for point in on]
    (folder / "shape.csv").write_text("\n".join([f"id,{request.param}", *lines]) + "\n")
    return request.param, folder, on


def test_lakes_planes_and_lines_of_a_table_are_found(shape: tuple[str, Path, np.ndarray]) -> None:
    kind, folder, on = shape
    found = gm.adjust(declared(folder), ties=folder / "ties.csv", **{f"{kind}s": folder / "shape.csv"}, **OPTIONS)
    assert found.facts["sigma0_as_expected"]
    group = found.facts["observations"][-1]
    assert group["used"] == len(on)
    assert group["unit"] == "m"
    assert 0.2 < group["variance_factor"] < 1.8
    (told,) = [each for each in found.facts["further"] if each["name"] == f"{kind} upper"]
    assert told["observations"] == len(on)
    if kind == "lake":
        (height,) = told["parameters"]
        assert abs(height["value"] - 300.0 - LAKE) < 4.0 * height["sigma"]
        assert f"lake upper: height {height['value']:.2f}" in found.summary
    else:
        direction = np.array(told["direction" if kind == "line" else "normal"])
        assert abs(direction @ UNIT[kind]) > np.cos(np.radians(0.3))
        assert told["parameters"][0]["unit"] == "deg"
        assert f"{kind} upper" in found.summary
    assert "upper" in found.page("block")


BASE, ANGLES = np.array([0.5, 0.2, -0.1]), np.array([0.5, 12.0, -1.0])
FLIP = np.diag([1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def stereo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Block]:
    """Strip whose photos are taken by two cameras, the second of which looks aside."""
    block = grid_block(2, 4, 40, seed=3, control=5)
    random, turn = np.random.default_rng(8), FLIP @ omega_phi_kappa(*np.radians(ANGLES)) @ FLIP
    for one, other in zip(range(4), range(4, 8), strict=True):
        x, y, z, *angles = block.models[one].exterior(block.frame.ground)
        rotation = omega_phi_kappa(*np.radians(angles))
        centre = np.array([x, y, z]) + rotation.T @ FLIP @ BASE
        aside = np.degrees(angles_of(turn @ rotation))
        block.models[other] = photo(block.names[other], centre, aside)
        off = random.normal(size=6)
        block.start[other] = photo(block.names[other], centre + 20.0 * off[:3], aside + 0.5 * off[3:])
    seen = []
    for image, model in enumerate(block.models):
        colrow = model.ground_to_image(block.frame.places(model.crs, block.points))
        inside = np.flatnonzero(((colrow > 5.0) & (colrow < np.array(SIZE) - 5.0)).all(axis=1))
        seen += [(image, point, *colrow[point]) for point in inside]
    table = np.array(seen)
    block.image, block.point, block.colrow = table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2:]
    block.noise = 0.3 * random.normal(size=block.colrow.shape)
    folder = tmp_path_factory.mktemp("stereo")
    write_project(folder, block)
    return folder, block


def rigs(folder: Path, header: str = "", *values: str) -> Path:
    """Table of the four exposures of a rig."""
    rest = [*values, *[""] * 4]
    lines = [f"s1p{k}.tif,s2p{k}{',' + rest[k - 1] if header else ''}" for k in range(1, 5)]
    table = folder / "rigs.csv"
    table.write_text("\n".join(["from,to" + (f",{header}" if header else ""), *lines]) + "\n")
    return table


def test_a_rig_of_unknown_base_and_rotation_is_found(stereo: tuple[Path, Block]) -> None:
    folder, _ = stereo
    found = gm.adjust(declared(folder), ties=folder / "ties.csv", rigs=rigs(folder), **OPTIONS)
    assert found.facts["sigma0_as_expected"]
    base, rotation = found.facts["further"]
    assert base["name"] == "rig 1, base"
    for each, true in zip(base["parameters"], BASE, strict=True):
        assert abs(each["value"] - true) < 4.0 * each["sigma"]
    sigmas = np.array([each["sigma"] for each in rotation["parameters"]])
    assert (np.abs(np.array(rotation["omega, phi, kappa"]) - ANGLES) < 4.0 * sigmas + 1e-3).all()
    named = {each["name"]: each for each in found.facts["observations"]}
    assert named["relative positions"]["used"] == named["relative attitudes"]["used"] == 4
    assert named["relative attitudes"]["unit"] == "deg"


def test_a_calibrated_rig_holds_an_image_of_two_points(stereo: tuple[Path, Block], tmp_path: Path) -> None:
    folder, block = stereo
    lines = (folder / "ties.csv").read_text().splitlines()
    own = [line for line in lines if "s2p2" in line]
    ties = tmp_path / "ties.csv"
    control = tmp_path / "control.csv"
    rows = (folder / "control.csv").read_text().splitlines()
    control.write_text("\n".join(line for line in rows if "s2p2" not in line) + "\n")
    once = {line.partition(",")[0] for line in own}
    kept = [line for line in lines if line not in own[2:]]
    many = [line.partition(",")[0] for line in kept]
    ties.write_text(
        "\n".join(line for line, name in zip(kept, many, strict=True) if many.count(name) > 1 or name not in once)
    )
    alone = declared(folder, control=control)
    plain = {"sigma_px": 0.3}
    with pytest.raises(SolveError, match=r"s2p2\.tif lie on one line, or are too few"):
        gm.adjust(alone, ties=ties, **plain)
    text = ",".join(f"{value:g}" for value in (*BASE, *ANGLES))
    header = "rig,dx,dy,dz,omega,phi,kappa,sigma_base,sigma_angle"
    table = rigs(folder, header, *(f"twin,{text},0.002,0.003" if k == 0 else "twin,,,,,,,," for k in range(4)))
    found = gm.adjust(alone, ties=ties, rigs=table, **plain)
    assert found.facts["sigma0_as_expected"]
    off = pose_of(found.models["s2p2.tif"], block.frame).centre - pose_of(block.models[5], block.frame).centre
    sigmas = np.array(list(found.facts["images"][5]["sigmas"].values())[:3])
    assert (np.abs(off) < 4.0 * sigmas).all()
    assert sigmas.max() < 2.0
    base = found.facts["further"][0]
    assert base["name"] == "rig twin, base"
    assert all(each["sigma"] < 0.0021 for each in base["parameters"])


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("lakes", "id,lake\nt1,a\n", r"lakes.csv.*: no lake has enough points"),
        ("lakes", "id,lake\nt1,a\nt2,a\nt1,b\n", r"point 't1' is on lake 'a' already \(.*line 2\)"),
        ("lakes", "id,lake,sigma\nt1,a,0\nt2,a,1\n", "line 2: the standard deviation is 0 m"),
        ("lakes", "id,lake\nnone,a\nt2,a\n", "line 2: point 'none' is not measured in two images"),
        ("lakes", "id,shore\nt1,a\n", "points on lakes need the column lake"),
        ("planes", "id,plane\nt1,a\nt2,a\nt3,a\n", "no plane has enough points"),
        ("lines", "id,line\nt1,a\nt2,a\n", "no line has enough points"),
        ("rigs", "from,to\ns1p1,s9p9\n", "line 2: no image of the block is named 's9p9'"),
        ("rigs", "from,to\ns1p1,s1p1.tif\n", "line 2: s1p1.tif is both images"),
        ("rigs", "from,to\ns1p1,s2p1\n", "rig '1' has one exposure"),
        ("rigs", "from,to\ns1p1,s2p1\ns1p2,s2p1\n", "line 3: s2p1.tif hangs on another image already"),
        ("rigs", "from,to,dx\ns1p1,s2p1,0.5\ns1p2,s2p2,\n", "line 2: only some of dx, dy, dz are given"),
        ("rigs", "from,to,dx,dy,dz\ns1p1,s2p1,1,0,0\ns1p2,s2p2,2,0,0\n", "line 3: dx, dy, dz differ from those in"),
        ("rigs", "from,to,spread_base\ns1p1,s2p1,0\ns1p2,s2p2,\n", "line 2: spread_base is 0"),
    ],
)
def test_tables_that_cannot_be_are_refused_with_their_line(tmp_path: Path, name: str, text: str, said: str) -> None:
    table = tmp_path / f"{name}.csv"
    table.write_text(text)
    frame = BlockFrame.at(GROUND, np.array([[500_000.0, 5_500_000.0, 300.0]]))
    none, count = np.zeros(0, dtype=np.int64), 3
    measured = Measurements(
        ("t1", "t2", "t3"), none, none, np.zeros((0, 2)), np.zeros((0, 2, 2)), np.full((count, 3), np.nan),
        np.full((count, 3), np.inf), np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros(count, dtype=bool),
    )  # fmt: skip
    images = ("s1p1.tif", "s1p2.tif", "s2p1.tif", "s2p2.tif")

    def read() -> None:
        if name == "rigs":
            of_rigs(images, [Pose(np.zeros(3), np.eye(3))] * 4, table, [])
        else:
            of_points(measured, frame, np.eye(3), AdjustmentOptions(ties=tmp_path, **{name: table}), [])

    with pytest.raises(InputError) as error:
        read()
    assert re.search(said, str(error.value))
    assert error.value.hint


def test_a_plane_whose_points_are_on_one_line_is_refused(tmp_path: Path) -> None:
    block, on = shaped("line", control=5)
    block.start = block.models
    write_project(tmp_path, block)
    table = tmp_path / "planes.csv"
    table.write_text("id,plane\n" + "\n".join(f"t{point},wall" for point in on) + "\n")
    with pytest.raises(InputError, match="the points of plane wall lie on one line") as error:
        gm.adjust(declared(tmp_path), ties=tmp_path / "ties.csv", planes=table, **OPTIONS)
    assert "`lines`" in (error.value.hint or "")


@pytest.mark.parametrize("shape", ["lake"], indirect=True)
def test_a_lake_of_one_point_is_left_out_aloud(shape: tuple[str, Path, np.ndarray], tmp_path: Path) -> None:
    _, folder, on = shape
    table = tmp_path / "lakes.csv"
    table.write_text("\n".join(["id,lake", f"t{on[0]},small", *(f"t{point},large" for point in on[1:])]) + "\n")
    with pytest.warns(GeomosaicWarning, match="1 lake with too few points, left out: small"):
        found = gm.adjust(declared(folder), ties=folder / "ties.csv", lakes=table, **OPTIONS)
    assert [each["name"] for each in found.facts["further"]] == ["lake large"]
