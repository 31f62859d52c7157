"""Lenses from tables and saved states, with their modifiers: decentred lens, sheared sensor axes.

s is the principal point of symmetry, counted from the principal point in focal lengths, x right, y down.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import choice, known_keys, need, number, numbers
from geomosaic.types import BoolArray, FloatArray
from geomosaic_frame.distortion import Columns, Lens, NoDistortion
from geomosaic_frame.fisheye import Fisheye
from geomosaic_frame.polynomial import Brown, Rational
from geomosaic_frame.radial_tables import Corrections


@dataclass(frozen=True)
class DecentredLens:
    """Perspective lens whose distortion is about another centre than the principal point.

    Attributes
    ----------
    lens : Lens
        A perspective one: a shift of its image is a shear of the directions.
    centre : tuple of float
        s, in focal lengths.
    """

    lens: Lens
    centre: tuple[float, float]

    @property
    def edge(self) -> float:
        """Distorted radius up to which the polynomial is used as given; inf without end."""
        return self.lens.edge

    def project(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Columns:
        """Camera axes (N,) in any unit to distorted u, v (N,); NaN where the lens cannot see."""
        u, v = self.lens.project(x - self.centre[0] * z, y - self.centre[1] * z, z)
        return u + self.centre[0], v + self.centre[1]

    def unproject(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distorted u, v (N,) to a direction x, y, z (N,) in camera axes, not normalised."""
        x, y, z = self.lens.unproject(u - self.centre[0], v - self.centre[1])
        return x + self.centre[0] * z, y + self.centre[1] * z, z

    def derivatives(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by (x, y, z), (N, 2, 3)."""
        s, t = self.centre
        out = self.lens.derivatives(x - s * z, y - t * z, z).copy()
        out[:, :, 2] -= s * out[:, :, 0] + t * out[:, :, 1]
        return out

    @property
    def coefficients(self) -> dict[str, float]:
        """Those of the lens, and its centre."""
        return {**self.lens.coefficients, "centre_x": self.centre[0], "centre_y": self.centre[1]}

    def with_coefficients(self, values: Mapping[str, float]) -> Lens:
        """Lens with other values of the coefficients."""
        own = {name: value for name, value in values.items() if not name.startswith("centre_")}
        return DecentredLens(self.lens.with_coefficients(own), (values["centre_x"], values["centre_y"]))

    def by_coefficients(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by the K coefficients, (N, 2, K)."""
        s, t = self.centre
        moved = x - s * z, y - t * z, z
        by_centre = np.eye(2) - self.lens.derivatives(*moved)[:, :, :2] * z[:, None, None]
        return np.concatenate([self.lens.by_coefficients(*moved), by_centre], axis=2)

    def in_calibrated_range(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether the polynomial is used there as given, not its continuation (N,)."""
        return self.lens.in_calibrated_range(u - self.centre[0], v - self.centre[1])

    def for_corners(self, u: FloatArray, v: FloatArray) -> Lens:
        """Lens that knows how far the image reaches, whose corners are at distorted u, v (N,)."""
        return replace(self, lens=self.lens.for_corners(u - self.centre[0], v - self.centre[1]))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {**self.lens.to_dict(), "centre": list(self.centre)}


@dataclass(frozen=True)
class ShearedLens:
    """Lens in front of a sensor with sheared axes.

    Attributes
    ----------
    lens : Lens
    shear : float
        Of u per v, without unit.
    """

    lens: Lens
    shear: float

    @property
    def edge(self) -> float:
        """Distorted radius up to which the polynomial is used as given; inf without end."""
        return self.lens.edge

    def project(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Columns:
        """Camera axes (N,) in any unit to distorted u, v (N,); NaN where the lens cannot see."""
        u, v = self.lens.project(x, y, z)
        return u + self.shear * v, v

    def unproject(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distorted u, v (N,) to a direction x, y, z (N,) in camera axes, not normalised."""
        return self.lens.unproject(u - self.shear * v, v)

    def derivatives(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by (x, y, z), (N, 2, 3)."""
        out = self.lens.derivatives(x, y, z).copy()
        out[:, 0] += self.shear * out[:, 1]
        return out

    @property
    def coefficients(self) -> dict[str, float]:
        """Those of the lens, and the shear."""
        return {**self.lens.coefficients, "shear": self.shear}

    def with_coefficients(self, values: Mapping[str, float]) -> Lens:
        """Lens with other values of the coefficients."""
        own = {name: value for name, value in values.items() if name != "shear"}
        return ShearedLens(self.lens.with_coefficients(own), values["shear"])

    def by_coefficients(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by the K coefficients, (N, 2, K)."""
        v = self.lens.project(x, y, z)[1]
        own = self.lens.by_coefficients(x, y, z).copy()
        own[:, 0] += self.shear * own[:, 1]
        return np.concatenate([own, np.column_stack([v, np.zeros_like(v)])[:, :, None]], axis=2)

    def in_calibrated_range(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether the polynomial is used there as given, not its continuation (N,)."""
        return self.lens.in_calibrated_range(u - self.shear * v, v)

    def for_corners(self, u: FloatArray, v: FloatArray) -> Lens:
        """Lens that knows how far the image reaches, whose corners are at distorted u, v (N,)."""
        return replace(self, lens=self.lens.for_corners(u - self.shear * v, v))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {**self.lens.to_dict(), "shear": self.shear}


# Lens of each `model` of a `[distortion]` table.
LENSES: Mapping[str, Callable[..., Lens]] = {
    "none": NoDistortion,
    "brown": Brown,
    "opencv": Rational,
    "fisheye": Fisheye,
}
# Its coefficients: keys of the table and parameters of the lens.
COEFFICIENTS = {
    "none": (),
    "brown": ("k1", "k2", "k3", "p1", "p2", "k4"),
    "opencv": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
CONVENTIONS = ("opencv", "photogrammetric")
CORRECTS = ("ideal", "measured")


def lens_from_table(table: Mapping[str, Any], focal: float | None, where: str) -> Lens:
    """Lens of a `[distortion]` table.

    Parameters
    ----------
    table : mapping
        `model`: a key of `LENSES`; its coefficients, 0 where not given; for 'brown' a `convention`: 'opencv' (default:
        without unit, y down, ideal to distorted) or 'photogrammetric' (mm, y up, corrections added to the measured
        coordinates); with the former `corrects` = 'measured', where the formula turns measured into ideal coordinates;
        `shear`: columns per row by which the axes of the sensor are off the right angle, u + shear·v (Metashape's b2
        over its focal length along columns); `centre` = [x, y] of the distortion, from the principal point in focal
        lengths, x right, y down (not for 'fisheye').
    focal : float or None
        Focal length in mm where it is known.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        A key is unknown, or no number, or millimetres are given without a focal length.
    """
    model = choice(need(table, "model", where, f"one of {', '.join(COEFFICIENTS)}"), COEFFICIENTS, "model", where)
    more = ("convention", "centre", "corrects") if model == "brown" else ("centre",) if model == "opencv" else ()
    known_keys(table, ("model", *COEFFICIENTS[model], "shear", *more), where)
    values = {key: number(table[key], key, where) for key in COEFFICIENTS[model] if key in table}
    convention = choice(table.get("convention", "opencv"), CONVENTIONS, "convention", where)
    if convention == "photogrammetric":
        if focal is None:
            raise InputError(
                "photogrammetric distortion is in millimetres, but the focal length is not",
                where=where,
                hint="give focal_length in mm with sensor_size or pixel_size, or use convention = 'opencv'",
            )
        k1, k2, k3, p1, p2, k4 = (values.get(key, 0.0) for key in COEFFICIENTS["brown"])
        if k4 or table.get("shear") or table.get("centre"):
            what = "k4, shear and centre belong to the convention 'opencv'"
            raise InputError(what, where=where, hint="leave them out")
        return Corrections.photogrammetric((k1, k2, k3), (p1, p2), focal)
    centre = numbers(table.get("centre", (0.0, 0.0)), 2, "centre", where)
    lens = LENSES[model](**values)
    if choice(table.get("corrects", "ideal"), CORRECTS, "corrects", where) == "measured":
        lens = Corrections(Brown(**values))
    return _sheared(_moved(lens, centre), number(table.get("shear", 0.0), "shear", where))


def lens_from_dict(state: Mapping[str, Any]) -> Lens:
    """Lens of a saved state.

    Parameters
    ----------
    state : mapping
        As `to_dict` of the lens gives it.
    """
    if state["model"] == "corrections":
        formula = {key: value for key, value in state["formula"].items() if key != "model"}
        lens: Lens = Corrections(Brown(**formula))
    else:
        values = {key: value for key, value in state.items() if key not in ("model", "shear", "centre")}
        lens = LENSES[state["model"]](**values)
    return _sheared(_moved(lens, state.get("centre", (0.0, 0.0))), state.get("shear", 0.0))


def adjustable(lens: Lens) -> Lens:
    """Same lens with all that an adjustment may give it: Brown's coefficients where it has no distortion, and a shear.

    Parameters
    ----------
    lens : Lens
        As a table or a state gives it.
    """
    if isinstance(lens, ShearedLens):
        return replace(lens, lens=Brown()) if isinstance(lens.lens, NoDistortion) else lens
    return ShearedLens(Brown() if isinstance(lens, NoDistortion) else lens, 0.0)


def coefficient_groups(lens: Lens) -> dict[str, tuple[str, ...]]:
    """Names for all coefficients of a lens together: 'distortion', and 'brown' where it is Brown's.

    Parameters
    ----------
    lens : Lens
    """
    names = tuple(name for name in adjustable(lens).coefficients if name != "shear")
    # k4 is Metashape's alone.
    brown = {"brown": ("k1", "k2", "k3", "p1", "p2")} if set(names) >= set(Brown.names) and "s1" not in names else {}
    return {"distortion": names, **brown} if names else {}


def plain(lens: Lens) -> Lens:
    """Same lens without what does nothing in it: `adjustable` back.

    Parameters
    ----------
    lens : Lens
    """
    if isinstance(lens, ShearedLens):
        return _sheared(plain(lens.lens), lens.shear)
    return NoDistortion() if lens == Brown() else lens


def _moved(lens: Lens, centre: Sequence[float]) -> Lens:
    if not any(centre):
        return lens

    return DecentredLens(lens, (float(centre[0]), float(centre[1])))


def _sheared(lens: Lens, shear: float) -> Lens:
    if shear == 0.0:
        return lens

    return ShearedLens(lens, shear)
