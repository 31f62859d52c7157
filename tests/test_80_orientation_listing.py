"""Printed lists: read as told, held against the printed matrix, and refused where not all is told."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from geomosaic.errors import InputError
from geomosaic.geo.local_frames import omega_phi_kappa
from geomosaic.inputs.build import build_block
from geomosaic.inputs.exterior_orientation import MATRIX
from geomosaic.inputs.orientation_listing import read_listing
from geomosaic.options.inputs import ListingLayout
from geomosaic.project.load import load_project
from geomosaic.project.sample_block import copy_sample
from geomosaic.types import FloatArray

W, P, K = 3.0, -5.0, 70.0


def about(axis: int, degrees: float) -> FloatArray:
    """Turn of the axes, written out as in textbooks."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    m = np.eye(3)
    m[i, i] = m[j, j] = c
    m[i, j], m[j, i] = s, -s
    return m


def read(path: Path, text: str, unit: str | None = "gon", direction: str | None = None, **how: Any) -> FloatArray:
    path.write_text(text)
    table = read_listing(path, ListingLayout(**{"axes": "right up", **how}), unit, direction)
    row = table.row("101.tif")
    assert row.position == (1000.0, 2000.0, 3000.0)
    return np.array([row.angles[key] for key in MATRIX]).reshape(3, 3)


ANGLES = ("image", "x", "y", "z", "omega", "phi", "kappa")


@pytest.mark.parametrize(
    ("sequence", "truth"),
    [
        (("omega", "phi", "kappa"), about(2, K) @ about(1, P) @ about(0, W)),
        (("phi", "omega", "kappa"), about(2, K) @ about(0, W) @ about(1, P)),
        (("kappa", "phi", "omega"), about(0, W) @ about(1, P) @ about(2, K)),
    ],
)
def test_the_sequence_of_rotations_is_that_declared(
    tmp_path: Path, sequence: tuple[str, ...], truth: FloatArray
) -> None:
    line = f"101 1000.0 2000.0 3000.0 {W / 0.9!r} {P / 0.9!r} {K / 0.9!r}\n"
    found = read(tmp_path / "list", f"PROTOCOL 7\n\n{line}", columns=ANGLES, sequence=sequence, skip=1)
    assert np.abs(found - truth).max() < 1e-14


@pytest.mark.parametrize(
    ("axes", "to_image"),
    [
        ("right up", np.eye(3)),
        ("right down", np.diag([1.0, -1.0, -1.0])),
        ("left down", np.diag([-1.0, -1.0, 1.0])),
        ("up left", np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])),
        ("down right", np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])),
    ],
)
def test_the_axes_are_those_declared(tmp_path: Path, axes: str, to_image: FloatArray) -> None:
    """A matrix to other axes, four decimals and over three lines, as lists print it."""
    m = omega_phi_kappa(*np.radians([W, P, K]))
    rows = "\n".join(" ".join(f"{v:.7f}" for v in row) for row in (to_image @ m).T)
    columns = ("image", "x", "y", "z", "-", *MATRIX)
    text = f"101 1000.0 2000.0 3.0D+03 4711\n{rows}\n"
    found = read(tmp_path / "list", text, None, "image_to_ground", columns=columns, axes=axes, lines=4)
    assert np.abs(found - m).max() < 1e-6
    assert np.abs(found @ found.T - np.eye(3)).max() < 1e-14


def test_records_of_pat_b_are_read_by_their_published_fields(tmp_path: Path) -> None:
    """Number, position in I16, 16X, 3F16.5; the matrix in 5F16.12 and 4F16.12, as PCI Geomatics describes the file."""
    m = omega_phi_kappa(*np.radians([W, P, K])).T.ravel()
    lines = [
        f"{101:16d}{'':16}{1000.0:16.5f}{2000.0:16.5f}{3000.0:16.5f}",
        "".join(f"{value:16.12f}" for value in m[:5]),
        "".join(f"{value:16.12f}" for value in m[5:]),
    ]
    columns = ("image", "x", "y", "z", *MATRIX)
    found = read(tmp_path / "list", "\n".join(lines), None, "image_to_ground", columns=columns, lines=3)
    assert np.abs(found - m.reshape(3, 3).T).max() < 1e-11


def both(sense: float = 1.0) -> str:
    m = about(2, K) @ about(0, W) @ about(1, P)
    angles = " ".join(f"{sense * v:.5f}" for v in (W, P, K))
    return f"101, 1000, 2000, 3000, {angles.replace(' ', ', ')}, " + ", ".join(f"{v:.6f}" for v in m.ravel()) + "\n"


def test_angles_are_held_against_the_matrix(tmp_path: Path) -> None:
    columns = (*ANGLES, *MATRIX)
    right = {"columns": columns, "sequence": ("phi", "omega", "kappa")}
    read(tmp_path / "list", both(), "deg", "ground_to_image", **right)
    for how, unit, direction, hint in (
        (
            {**right, "sequence": ("omega", "phi", "kappa")},
            "deg",
            "ground_to_image",
            "sequence = ['phi', 'omega', 'kappa']",
        ),
        (right, "deg", "image_to_ground", "the matrix of the other direction"),
        (right, "gon", "ground_to_image", "check the unit"),
    ):
        with pytest.raises(InputError, match="disagree") as caught:
            read(tmp_path / "list", both(), unit, direction, **how)
        assert hint in str(caught.value.hint)
    with pytest.raises(InputError, match="disagree") as caught:
        read(tmp_path / "list", both(-1.0), "deg", "ground_to_image", **right)
    assert "other sense" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("how", "unit", "direction", "words"),
    [
        ({"columns": ANGLES}, "gon", None, "the sequence of the rotations is not declared"),
        (
            {"columns": ANGLES, "sequence": ("omega", "phi", "kappa")},
            None,
            None,
            "the unit of the angles is not declared",
        ),
        ({"columns": ("image", "x", "y", "z", *MATRIX)}, None, None, "the direction of the matrix is not declared"),
        ({"columns": ("image", "x", "y", "z")}, None, None, "neither omega, phi, kappa nor"),
        ({"columns": (*ANGLES, "nu")}, None, None, "no column 'nu'"),
        ({"columns": (*ANGLES, "x")}, None, None, "'x' is named twice"),
        ({"columns": ("image", "x", *ANGLES[4:])}, None, None, "columns has no y, z"),
        (
            {"columns": ANGLES, "sequence": ("omega", "phi", "kappa"), "axes": "x y"},
            "deg",
            None,
            "does not give the directions",
        ),
        ({"columns": ANGLES, "sequence": ("omega", "phi", "kappa"), "axes": "up down"}, "deg", None, "right angles"),
        ({"columns": ANGLES, "sequence": ("omega", "phi", "kappa"), "lines": 2}, "deg", None, "where a record has"),
        ({"columns": (*ANGLES, "-"), "sequence": ("omega", "phi", "kappa")}, "deg", None, "where a record has"),
        ({"columns": ANGLES, "sequence": ("omega", "phi", "kappa"), "skip": 9}, "deg", None, "no record"),
    ],
)
def test_what_is_not_declared_is_asked_for(
    tmp_path: Path, how: dict[str, Any], unit: str | None, direction: str | None, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        read(tmp_path / "list", "101 1000 2000 3000 1 2 3\n", unit, direction, **how)


def test_a_project_with_a_printed_list_is_the_same_block(tmp_path: Path) -> None:
    project = copy_sample(tmp_path / "sample")
    folder = project.parent
    rows = [line.split(",") for line in (folder / "exterior.csv").read_text().splitlines()[1:]]
    gons = "\n".join(
        " ".join([row[0].removesuffix(".jpg"), *row[1:4], *(repr(float(v) / 0.9) for v in row[4:])]) for row in rows
    )
    (folder / "bundle.lst").write_text(f"BUNDLE ADJUSTMENT\n{gons}\n")
    text = project.read_text()
    printed = 'file = "bundle.lst"\nangles = "printed"\nangle_unit = "gon"\n'
    text = text.replace('file = "exterior.csv"\n', printed)
    text = "\n".join(
        line for line in text.splitlines() if not line.startswith(('angles = "opk"', 'angle_unit = "deg"'))
    )
    text = text.replace(
        "[dem]",
        '[exterior.printed]\ncolumns = ["image", "x", "y", "z", "omega", "phi", "kappa"]\n'
        'sequence = ["omega", "phi", "kappa"]\naxes = "right up"\nskip = 1\n\n[dem]',
        1,
    )
    original = build_block(load_project(project).inputs)
    other = folder / "other.toml"
    other.write_text(text)
    block = build_block(load_project(other).inputs)
    for a, b in zip(original.scenes, block.scenes, strict=True):
        xyz = np.array([a.model.seed])
        assert np.abs(a.model.ground_to_image(xyz) - b.model.ground_to_image(xyz)).max() < 1e-6
    other.write_text(text.replace('axes = "right up"', 'axes = "left down"'))
    with pytest.raises(InputError, match="implausible: control points") as caught:
        build_block(load_project(other).inputs)
    assert "set axes = 'right up' under [exterior.printed]" in str(caught.value.hint)
    other.write_text(text.replace('axes = "right up"', 'axes = "right down"'))
    with pytest.raises(InputError, match="looks at the sky") as caught:
        build_block(load_project(other).inputs)
    assert "set axes = 'right up' under [exterior.printed]" in str(caught.value.hint)
