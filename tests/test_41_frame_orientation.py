"""Angle systems: directions that can be checked in the head, and each system against another."""

from __future__ import annotations

import math

import numpy as np
import pytest

from geomosaic.errors import InputError
from geomosaic.geo.local_frames import omega_phi_kappa
from geomosaic.types import FloatArray
from geomosaic_frame.orientation import MATRIX, SYSTEMS, read_attitude

EAST, NORTH, UP = np.eye(3)
WEST, SOUTH, DOWN = -np.eye(3)


def rotation(unit: str = "deg", **row: object) -> FloatArray:
    return read_attitude(row, unit, "photo 7").rotation


def looks(m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Line of sight and image top in east, north, up."""
    return -m[2], m[1]


def angle_between(a: FloatArray, b: FloatArray) -> float:
    return math.degrees(math.acos(min(1.0, (float(np.trace(a @ b.T)) - 1.0) / 2.0)))


def test_opk_is_the_textbook_matrix() -> None:
    """Elements of the image → ground matrix as printed in textbooks (Kraus; Albertz/Wiggenhagen)."""
    w, p, k = (math.radians(v) for v in (7.0, -11.0, 130.0))
    cw, sw, cp, sp, ck, sk = math.cos(w), math.sin(w), math.cos(p), math.sin(p), math.cos(k), math.sin(k)
    to_ground = [
        [cp * ck, -cp * sk, sp],
        [cw * sk + sw * sp * ck, cw * ck - sw * sp * sk, -sw * cp],
        [sw * sk - cw * sp * ck, sw * ck + cw * sp * sk, cw * cp],
    ]
    assert np.abs(rotation(system="opk", omega=7, phi=-11, kappa=130).T - to_ground).max() < 1e-15


def test_opk_turns_the_right_way() -> None:
    s, c = math.sin(math.radians(20)), math.cos(math.radians(20))
    # Omega about east: the line of sight swings from down to north. Phi about north: from down to west.
    assert np.allclose(looks(rotation(system="opk", omega=20, phi=0, kappa=0))[0], s * NORTH + c * DOWN)
    assert np.allclose(looks(rotation(system="opk", omega=0, phi=20, kappa=0))[0], s * WEST + c * DOWN)
    # Kappa counter-clockwise seen from above: the image top goes from north to west.
    assert np.allclose(looks(rotation(system="opk", omega=0, phi=0, kappa=90))[1], WEST)


def test_pok_differs_from_opk_by_the_order() -> None:
    opk, pok = (rotation(system=name, omega=2, phi=3, kappa=40) for name in ("opk", "pok"))
    assert angle_between(opk, pok) == pytest.approx(0.1047, abs=2e-4)  # 1.8 m at 1000 m
    for angles in ({"omega": 2, "phi": 0, "kappa": 40}, {"omega": 0, "phi": 3, "kappa": 40}):
        assert np.allclose(rotation(system="opk", **angles), rotation(system="pok", **angles), atol=1e-15)
    # Camera → world is Ry(φ)·Rx(ω)·Rz(κ), written out.
    w, p = math.radians(2), math.radians(3)
    sight = np.array([math.sin(p) * math.cos(w), -math.sin(w), math.cos(p) * math.cos(w)])
    assert np.allclose(pok[2], sight, atol=1e-15)


def test_rpy_of_an_aircraft() -> None:
    s, c = 0.5, math.sqrt(0.75)
    assert np.allclose(rotation(system="rpy", roll=0, pitch=0, yaw=0), np.eye(3))
    sight, top = looks(rotation(system="rpy", roll=0, pitch=30, yaw=90))
    assert np.allclose(sight, s * EAST + c * DOWN)  # nose up: sees forward
    assert np.allclose(top, c * EAST + s * UP)
    sight, top = looks(rotation(system="rpy", roll=30, pitch=0, yaw=0))
    assert np.allclose(sight, s * WEST + c * DOWN)  # right wing down: sees to the left
    assert np.allclose(top, NORTH)


@pytest.mark.parametrize(
    ("yaw", "pitch", "roll", "sight", "top"),
    [
        (0, -90, 0, DOWN, NORTH),
        (90, -90, 0, DOWN, EAST),
        (180, -90, 0, DOWN, SOUTH),
        (-90, -90, 0, DOWN, WEST),
        (0, -90, 180, DOWN, SOUTH),
        (-90, -90, -180, DOWN, EAST),
        (0, 0, 0, NORTH, UP),
        (90, 0, 0, EAST, UP),
        (180, 0, 0, SOUTH, UP),
        (-90, 0, 0, WEST, UP),
        (90, 0, 180, EAST, DOWN),
        (0, -45, 0, (NORTH + DOWN) / math.sqrt(2), (NORTH + UP) / math.sqrt(2)),
    ],
)
def test_gimbal_angles_of_dji_point_the_camera(
    yaw: float, pitch: float, roll: float, sight: FloatArray, top: FloatArray
) -> None:
    m = rotation(system="dji", gimbal_yaw=yaw, gimbal_pitch=pitch, gimbal_roll=roll)
    assert np.allclose(looks(m), (sight, top), atol=1e-15)
    assert np.linalg.det(m) == pytest.approx(1.0)


def test_dji_is_rpy_turned_down() -> None:
    dji = rotation(system="dji", gimbal_yaw=33, gimbal_pitch=-60, gimbal_roll=0)
    assert np.allclose(dji, rotation(system="rpy", roll=0, pitch=30, yaw=33), atol=1e-15)


def test_angles_in_gon_and_radians_are_those_in_degrees() -> None:
    deg = rotation(system="opk", omega=9, phi=-18, kappa=171)
    assert np.allclose(rotation("gon", system="opk", omega=10, phi=-20, kappa=190), deg, atol=1e-15)
    rad = {name: math.radians(value) for name, value in (("omega", 9), ("phi", -18), ("kappa", 171))}
    assert np.allclose(rotation("rad", system="opk", **rad), deg, atol=1e-15)


@pytest.mark.parametrize(
    ("unit", "kappa", "words"),
    [("deg", 390.0, "'gon'"), ("gon", 401.0, "check the value"), ("rad", 90.0, "'deg' or 'gon'")],
)
def test_more_than_a_circle_names_image_value_and_unit(unit: str, kappa: float, words: str) -> None:
    with pytest.raises(InputError) as caught:
        rotation(unit, system="opk", omega=0, phi=0, kappa=kappa)
    text = str(caught.value)
    assert "photo 7" in text
    assert f"kappa = {kappa:g}" in text
    assert words in text


def printed(m: FloatArray, digits: int = 9) -> dict[str, float]:
    return dict(zip(MATRIX, np.round(m, digits).ravel().tolist(), strict=True))


@pytest.mark.parametrize("system", ["matrix", "patb"])
def test_matrix_in_both_directions(system: str) -> None:
    m = omega_phi_kappa(0.02, -0.03, 2.5)
    there = rotation(system=system, matrix="ground_to_image", **printed(m))
    back = rotation(system=system, matrix="image_to_ground", **printed(m.T))
    assert np.abs(there - m).max() < 1e-9
    assert np.abs(back - m).max() < 1e-9
    assert np.abs(there @ there.T - np.eye(3)).max() < 1e-15  # the print's rounding is gone
    angles = {"omega": math.degrees(0.02), "phi": math.degrees(-0.03), "kappa": math.degrees(2.5)}
    assert np.abs(rotation(system=system, matrix="ground_to_image", **printed(m), **angles) - m).max() < 1e-9


def test_matrix_is_refused_where_it_is_no_rotation() -> None:
    m = omega_phi_kappa(0.02, -0.03, 2.5)
    angles = {"omega": math.degrees(0.02), "phi": math.degrees(-0.03), "kappa": math.degrees(2.5)}
    for row, words in (
        ({"matrix": "ground_to_image", **printed(m, 5)}, "no rotation"),
        ({"matrix": "ground_to_image", **printed(m * [[1], [1], [-1]])}, "mirror"),
        ({**printed(m)}, "'matrix' is missing"),
        ({"matrix": "image_to_ground", **printed(m), **angles}, "disagree"),
        ({"matrix": "down", **printed(m)}, "choose from: ground_to_image, image_to_ground"),
    ):
        with pytest.raises(InputError, match=words):
            rotation(system="matrix", **row)


def test_opensfm_of_a_camera_that_looks_down() -> None:
    """Half a turn about x: camera x east, y south, z down; the centre is −Rᵀt."""
    row = {"system": "opensfm", "rotation": [math.pi, 0, 0], "translation": [-10, 20, 100], "reference": [9, 48, 0]}
    attitude = read_attitude(row, "deg", "photo 7")
    assert attitude.frame == "topocentric"
    assert np.allclose(attitude.rotation, np.eye(3), atol=1e-15)
    assert attitude.position is not None
    assert np.allclose(attitude.position, [10, 20, 100])


def test_frames_are_named() -> None:
    assert {name: system.frame for name, system in SYSTEMS.items()} == {
        "opk": "grid",
        "pok": "grid",
        "matrix": "grid",
        "patb": "grid",
        "rpy": "local",
        "dji": "local",
        "opensfm": "topocentric",
        "odm": "offset",
        **dict.fromkeys(("colmap", "pix4d", "metashape", "ori", "tsai"), "world"),  # told by the file or by the user
    }
    row = {"system": "opk", "omega": 0, "phi": 0, "kappa": 0, "frame": "local"}
    assert read_attitude(row, "deg", "photo 7").frame == "local"


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ({"omega": 1}, "'system' is missing"),
        ({"system": "opkk", "omega": 1}, "did you mean 'opk'"),
        ({"system": "opk", "omega": 1, "phi": 2}, "'kappa' is missing"),
        ({"system": "opk", "omega": 1, "phi": 2, "kapa": 3}, "did you mean 'kappa'"),
        ({"system": "opk", "omega": 1, "phi": 2, "kappa": "x"}, "kappa = 'x' is not a finite number"),
        ({"system": "opk", "omega": 1, "phi": 2, "kappa": float("nan")}, "not a finite number"),
        ({"system": "opk", "omega": 1, "phi": 2, "kappa": 3, "frame": "map"}, "choose from: grid, local"),
        ({"system": "opensfm", "rotation": [1, 2], "translation": [0, 0, 0], "reference": [0, 0, 0]}, "not 3"),
    ],
)
def test_errors_name_the_image(row: dict[str, object], words: str) -> None:
    with pytest.raises(InputError) as caught:
        read_attitude(row, "deg", "photo 7")
    assert words in str(caught.value)
    assert "photo 7" in str(caught.value)
