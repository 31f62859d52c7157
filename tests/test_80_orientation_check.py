"""Implausible orientations: every wrong reading is found with its hint, and right data never trips."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from project_rig import PHOTOS, sample_block

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.local_frames import omega_phi_kappa
from geomosaic.inputs.build import build_block
from geomosaic.project.sample_block import sample_folder

Rows = list[dict[str, Any]]


def rows() -> Rows:
    with (sample_folder() / "exterior.csv").open() as file:
        return [
            {"image": row["image"], **{key: float(value) for key, value in row.items() if key != "image"}}
            for row in csv.DictReader(file)
            if row["image"] in PHOTOS
        ]


def write(path: Path, table: Rows) -> Path:
    lines = [",".join(table[0]), *(",".join(str(value) for value in row.values()) for row in table)]
    path.write_text("\n".join(lines) + "\n")
    return path


def change(**how: Callable[[dict[str, Any]], float]) -> Rows:
    return [{**row, **{key: value(row) for key, value in how.items()}} for row in rows()]


def matrices(axes: tuple[int, int, int] = (1, 1, 1), *, transposed: bool = False) -> Rows:
    table = []
    for row in rows():
        m = np.diag(axes) @ omega_phi_kappa(*(math.radians(row[name]) for name in ("omega", "phi", "kappa")))
        m = m.T if transposed else m
        elements = {f"r{i + 1}{j + 1}": m[i, j] for i in range(3) for j in range(3)}
        table.append({**{key: row[key] for key in ("image", "x", "y", "z")}, **elements})
    return table


WRONG: dict[str, tuple[Rows, dict[str, Any], str]] = {
    "exchanged": (
        change(omega=lambda r: r["phi"], phi=lambda r: r["omega"]),
        {},
        "exchange the names omega and phi in the header",
    ),
    "about": (change(kappa=lambda r: r["kappa"] + 180), {}, "add half a circle to kappa"),
    "all senses": (
        change(omega=lambda r: -r["omega"], phi=lambda r: -r["phi"], kappa=lambda r: -r["kappa"]),
        {},
        "change the signs of omega, phi and kappa",
    ),
    "tilts' sense": (
        change(omega=lambda r: -r["omega"], phi=lambda r: -r["phi"]),
        {},
        "change the signs of omega and phi",
    ),
    "kappa's sense": (change(kappa=lambda r: -r["kappa"]), {}, "change the sign of kappa"),
    "omega's sense": (change(omega=lambda r: -r["omega"]), {}, "change the sign of omega"),
    "gons for degrees": (rows(), {"angle_unit": "gon"}, "angle_unit = 'deg'"),
    "matrix": (
        matrices(transposed=True),
        {"angles": "matrix", "matrix": "ground_to_image"},
        "matrix = 'image_to_ground'",
    ),
    "matrix turned": (
        matrices((-1, -1, 1)),
        {"angles": "matrix", "matrix": "ground_to_image"},
        "change the signs of rows 1 and 2",
    ),
}


SEEN = ("exchanged", "matrix turned")
SEEN_TOO = ("about", "all senses", "gons for degrees")


@pytest.mark.parametrize(
    ("case", "witness"),
    [
        *((case, "control") for case in WRONG),
        *((case, "pictures") for case in SEEN),
        *(pytest.param(case, "pictures", marks=pytest.mark.slow) for case in SEEN_TOO),
    ],
)
def test_a_wrong_reading_is_found_with_its_correction(tmp_path: Path, case: str, witness: str) -> None:
    table, more, hint = WRONG[case]
    control = {"control": sample_folder() / "gcps.csv"} if witness == "control" else {}
    inputs = sample_block(exterior=write(tmp_path / "table.csv", table), **more, **control)
    with pytest.raises(InputError) as caught:
        build_block(inputs)
    assert hint in str(caught.value.hint), str(caught.value)
    assert caught.value.where == str(tmp_path / "table.csv")
    assert ("control points" if control else "neighbouring photos") in caught.value.what
    build_block(replace(inputs, trusted=True))  # said to be right, it goes on


@pytest.mark.parametrize("witness", ["pictures", "control"])
def test_right_data_says_nothing(tmp_path: Path, witness: str, recwarn: pytest.WarningsRecorder) -> None:
    control = {"control": sample_folder() / "gcps.csv"} if witness == "control" else {}
    build_block(sample_block(**control))
    table = write(tmp_path / "table.csv", matrices(transposed=True))
    build_block(sample_block(exterior=table, angles="matrix", matrix="image_to_ground", **control))
    # Other libraries' warnings may slip through while threads change the filters.
    assert not [str(each.message) for each in recwarn.list if issubclass(each.category, GeomosaicWarning)]


@pytest.mark.parametrize("error", [0.3, pytest.param(3.0, marks=pytest.mark.slow)])
def test_poor_orientations_are_not_refused(tmp_path: Path, error: float) -> None:
    """Raw positions and angles are off, but no other reading makes them good."""
    rng = np.random.default_rng(7)
    table = change(**{k: lambda r, k=k: r[k] + rng.normal(0, error) for k in ("omega", "phi", "kappa")})
    table = [{**row, **{k: row[k] + rng.normal(0, 10 * error) for k in "xyz"}} for row in table]
    path = write(tmp_path / "table.csv", table)
    for control in (None, sample_folder() / "gcps.csv"):
        build_block(sample_block(exterior=path, control=control))


def test_heights_off_by_the_geoid_are_found_by_the_pictures() -> None:
    """46.8 m at 1000 m above ground: neighbours meet at the wrong height."""
    with pytest.raises(InputError, match="heights of the positions from the geoid") as caught:
        build_block(sample_block(heights="ellipsoidal"))
    assert "set heights = 'egm96' under [exterior]" in str(caught.value.hint)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_flying_heights_off_by_the_geoid_are_found_by_control(tmp_path: Path, sign: float) -> None:
    path = write(tmp_path / "table.csv", change(z=lambda r: r["z"] + sign * 46.8))
    with pytest.raises(InputError, match=f"flying heights {'lowered' if sign > 0 else 'raised'}") as caught:
        build_block(sample_block(exterior=path, control=sample_folder() / "gcps.csv"))
    assert f"add {-sign * 46.8:+.1f} m to z in table.csv" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("table", "more", "hint"),
    [
        (change(omega=lambda r: r["omega"] + 180 - 360 * (r["omega"] > 0)), {}, "add half a circle to omega"),
        (
            matrices((1, -1, -1)),
            {"angles": "matrix", "matrix": "ground_to_image"},
            "change the signs of rows 2 and 3 of the matrix",
        ),
        (
            matrices((1, -1, -1), transposed=True),
            {"angles": "matrix", "matrix": "image_to_ground"},
            "change the signs of columns 2 and 3 of the matrix",
        ),
    ],
)
def test_photos_that_look_at_the_sky(tmp_path: Path, table: Rows, more: dict[str, Any], hint: str) -> None:
    with pytest.raises(InputError, match="looks at the sky") as caught:
        build_block(sample_block(exterior=write(tmp_path / "table.csv", table), **more))
    assert f"all photos would look down if you {hint}" in str(caught.value.hint)


@pytest.mark.parametrize(("unit", "factor"), [("rad", math.pi / 180), ("gon", 1 / 0.9)])
def test_another_unit_than_degrees(tmp_path: Path, unit: str, factor: float) -> None:
    """Told by the flight alone, or by control where a unit was declared."""
    table = change(**{k: lambda r, k=k: r[k] * factor for k in ("omega", "phi", "kappa")})
    inputs = sample_block(exterior=write(tmp_path / "table.csv", table), control=sample_folder() / "gcps.csv")
    with pytest.raises(InputError, match="rad" if unit == "rad" else "angle_unit = 'gon'"):
        build_block(inputs)
    with pytest.warns(UserWarning, match="declared as 'deg'"), pytest.raises(InputError) as caught:
        build_block(replace(inputs, angle_unit="deg"))
    assert f"set angle_unit = '{unit}'" in str(caught.value.hint)
