"""Calibration certificate of a film camera: a TOML table that reads like it, to the lens and the fiducials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import choice, known_keys, need, number, numbers, positive, table_of
from geomosaic_frame.film import FilmLens
from geomosaic_frame.radial_tables import Radial, RadialPolynomial, RadialTable

KEYS = (
    "name",
    "date",
    "focal_length",
    "principal_point_autocollimation",
    "principal_point_symmetry",
    "fiducials",
    "distortion",
    "additional",
)
MODELS: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "radial": ("radius", "angle", "distortion", "correction", "radius_is"),
    "polynomial": ("k0", "k1", "k2", "k3", "k4", "p1", "p2", "sign"),
}
SIGNS = ("distortion", "correction")
RADII = ("measured", "ideal")
# µm; a lens of a mapping camera that distorts by more is a table in another unit.
LARGEST = 2000.0


@dataclass(frozen=True)
class Certificate:
    """Calibration certificate of a film camera in the axes of the fiducials: mm, x right, y up.

    Attributes
    ----------
    lens : FilmLens
    autocollimation : tuple of float
        Principal point of autocollimation: where the axis that collinearity refers to meets the film.
    fiducials : mapping
        Mark → (x, y).
    """

    lens: FilmLens
    autocollimation: tuple[float, float]
    fiducials: Mapping[str, tuple[float, float]]


def read_certificate(table: Mapping[str, Any], where: str) -> Certificate:
    """Calibration certificate of a table.

    Parameters
    ----------
    table : mapping
        - `focal_length`: camera constant in mm;
        - `principal_point_autocollimation`: [x, y] in mm in the axes of the fiducials;
        - `principal_point_symmetry`: [x, y] in mm, the centre of the distortion; default that of autocollimation;
        - `fiducials`: table of mark = [x, y] in mm, x right, y up;
        - `distortion`: see `_radial`; default none; `additional`: see `AdditionalParameters`, in mm;
        - `name`, `date`: free text.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        A key is missing, unknown, or no number of a likely size.
    """
    known_keys(table, KEYS, where)
    text = "the camera constant in mm"
    constant = positive(need(table, "focal_length", where, text), "focal_length", where)
    text = "[x, y] in mm in the axes of the fiducials, [0, 0] where the certificate has no other"
    key = "principal_point_autocollimation"
    point = need(table, key, where, text)
    ax, ay = numbers(point, 2, key, where)
    key = "principal_point_symmetry"
    sx, sy = numbers(table.get(key, (ax, ay)), 2, key, where)
    marks = table_of(need(table, "fiducials", where, "a table of mark = [x, y] in mm"), "fiducials", where)
    fiducials: dict[str, tuple[float, float]] = {}
    for name, place in marks.items():
        x, y = numbers(place, 2, f"fiducials.{name}", where)
        fiducials[str(name)] = (x, y)
    if len(fiducials) < 2:
        raise InputError(f"{len(fiducials)} fiducials are no interior orientation", where=where, hint="give all marks")
    reach = float(np.hypot(*np.array(list(fiducials.values())).T).max())
    for words, x, y in (("autocollimation", ax, ay), ("symmetry", sx, sy)):
        if np.hypot(x, y) > 0.2 * reach:
            raise InputError(
                f"principal_point_{words} = [{x:g}, {y:g}] is far from the middle of the fiducials, which reach "
                f"{reach:.1f}",
                where=where,
                hint="give both in mm, in the axes of the fiducials",
            )
    given = table_of(table.get("distortion", {"model": "none"}), "distortion", where)
    radial, tangential = _lens(given, constant, f"{where}, distortion")
    return Certificate(FilmLens(constant, radial, (sx - ax, sy - ay), tangential), (ax, ay), fiducials)


def _lens(table: Mapping[str, Any], constant: float, where: str) -> tuple[Radial, tuple[float, float]]:
    """Corrections of a `[distortion]` table; a distortion is what the lens does, a correction what undoes it."""
    model = choice(need(table, "model", where, f"one of {', '.join(MODELS)}"), MODELS, "model", where)
    known_keys(table, ("model", *MODELS[model]), where)
    if model == "none":
        return RadialPolynomial(()), (0.0, 0.0)
    if model == "radial":
        return _table(table, constant, where), (0.0, 0.0)
    text = (
        "distortion (the image lies farther out by the polynomial) or correction (to be added to the measured radius)"
    )
    sign = -1.0 if choice(need(table, "sign", where, text), SIGNS, "sign", where) == "distortion" else 1.0
    k = [sign * number(table.get(f"k{i}", 0.0), f"k{i}", where) for i in range(5)]
    p1, p2 = (sign * number(table.get(name, 0.0), name, where) for name in ("p1", "p2"))
    while k and k[-1] == 0.0:
        k.pop()
    worst = 1000.0 * abs(float(RadialPolynomial(tuple(k)).correction(np.array([0.6 * constant]))[0][0]))
    if worst > LARGEST:
        raise InputError(
            f"the polynomial distorts by {worst:.0f} µm at a radius of {0.6 * constant:.0f} mm",
            where=where,
            hint="give the coefficients in mm (k1 in mm^-2, k2 in mm^-4, ...), as certificates print them",
        )
    return RadialPolynomial(tuple(k)), (p1, p2)


def _table(table: Mapping[str, Any], constant: float, where: str) -> RadialTable:
    """Radial table: `radius` in mm or `angle` in degrees, and `distortion` (outwards) or `correction` in µm.

    `radius_is` names the radius: 'measured', on the film, or 'ideal', that of the undistorted image. An angle is that
    of the ray, whose radius c·tan α is ideal.
    """
    for first, second, text in (
        ("radius", "angle", "radii in mm, or angles from the axis in degrees"),
        ("distortion", "correction", "µm, positive outwards; or correction, µm to be added to the measured radius"),
    ):
        if (first in table) == (second in table):
            raise InputError(
                f"{'both' if first in table else 'neither'} '{first}' {'and' if first in table else 'nor'} '{second}' "
                "are given",
                where=where,
                hint=f"give one: {first}: {text}",
            )
    places, sign = ("radius" if "radius" in table else "angle"), -1.0 if "distortion" in table else 1.0
    values = "distortion" if "distortion" in table else "correction"
    if not isinstance(table[places], list | tuple) or not table[places]:
        raise InputError(
            f"{places} is {table[places]!r}, not a list of numbers",
            where=where,
            hint="give all its numbers in brackets: [0, 20, 40]",
        )
    count = len(table[places])
    at = np.array(numbers(table[places], count, places, where))
    shift = np.array(numbers(table[values], count, values, where))
    if (np.diff(at) <= 0.0).any() or at[0] < 0.0:
        raise InputError(
            f"{places} does not rise from line to line",
            where=where,
            hint="sort the table from the principal point outwards, each place once",
        )
    if places == "angle":
        if at[-1] >= 80.0:
            raise InputError(
                f"an angle of {at[-1]:g}° is no angle in a mapping camera",
                where=where,
                hint="give degrees from the axis, below 80",
            )
        at = constant * np.tan(np.radians(at))
    if at[0] == 0.0:
        if shift[0] != 0.0:
            raise InputError(
                f"the table has {shift[0]:g} µm at the principal point, where a radial distortion is 0",
                where=where,
                hint="give it about the principal point of symmetry",
            )
        at, shift = at[1:], shift[1:]
    if not len(at):
        raise InputError(
            "the table has no radius but 0", where=where, hint="give the radii up to the corner of the photo"
        )
    if np.abs(shift).max() > LARGEST:
        raise InputError(
            f"the table has {np.abs(shift).max():g} µm, which no mapping camera has",
            where=where,
            hint="give micrometres",
        )
    correction = sign * shift / 1000.0
    usual = "ideal" if places == "angle" else "measured"
    if choice(table.get("radius_is", usual), RADII, "radius_is", where) == "ideal":
        at = at - correction  # the measured radius of each line
        if (np.diff(at, prepend=0.0) <= 0.0).any():
            raise InputError(
                "the measured radius does not rise with the ideal one", where=where, hint="give micrometres"
            )
    return RadialTable(tuple(at.tolist()), tuple(correction.tolist()))
