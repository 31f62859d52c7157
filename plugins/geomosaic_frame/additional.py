"""Additional parameters of self-calibration: Ebner's twelve and Grün's forty-four.

Systematic errors of the image that no lens explains (film, flatness, joined sensors) as orthogonal polynomials over a
regular grid of image points: Ebner (1976), over 3 × 3 points at −b, 0, b; Grün (1978), over 5 × 5 at −b, −b/2, 0, b/2,
b. With Pᵢ(x), Pⱼ(y) the orthogonal polynomials over the places of the grid, x right and y up, both over b,

    Δx = Σ a·Pᵢ(x)·Pⱼ(y),   Δy = Σ b·Pᵢ(x)·Pⱼ(y)

without the six combinations that the exterior orientation of a vertical photo of flat ground makes: the two shifts,
the scale, the rotation, and the two tilts, of which only what is orthogonal to them is kept (b3 and b4 of Ebner, a22
and b22 of Grün). Coefficients are in the unit of the image, so that each says by how much its term moves a point; those
of the literature, in powers of that unit, are these over the base to the degree of the term.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self, TypeVar

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import choice, known_keys, need, number, positive, table_of
from geomosaic.types import FloatArray
from geomosaic_frame.distortion import Columns, Slopes, newton_inverse

Kind = TypeVar("Kind", bound=Any)
# (i, j, factor) of Pᵢ(x)·Pⱼ(y) in Δx, and in Δy.
Terms = tuple[tuple[tuple[int, int, float], ...], tuple[tuple[int, int, float], ...]]

# Orthogonal polynomials over the places of each grid, by powers of x.
POLYNOMIALS = {
    "ebner": ((1.0,), (0.0, 1.0), (-2.0 / 3.0, 0.0, 1.0)),
    "gruen": (
        (1.0,),
        (0.0, 1.0),
        (-1.0 / 2.0, 0.0, 1.0),
        (0.0, -17.0 / 20.0, 0.0, 1.0),
        (9.0 / 70.0, 0.0, -31.0 / 28.0, 0.0, 1.0),
    ),
}
# The same, all of one degree: (I, I).
_MATRICES = {model: np.array([[*p, *(0.0,) * (len(own) - len(p))] for p in own]) for model, own in POLYNOMIALS.items()}
# Of x² against xy, so that a tilt (x², xy) or (xy, y²) is orthogonal to it: Σx²y² over Σ P₂², of 9 and of 25 points.
TILT = {"ebner": -2.0, "gruen": -10.0 / 7.0}


def _ebner() -> dict[str, Terms]:
    """Terms b1 to b12, as Ebner counts them."""
    tilt = TILT["ebner"]
    one = 1.0
    x: list[tuple[tuple[int, int, float], ...]] = [
        ((1, 0, one),), ((0, 1, one),), ((2, 0, tilt),), ((1, 1, one),), ((0, 2, one),), (),
        ((1, 2, one),), (), ((2, 1, one),), (), ((2, 2, one),), (),
    ]  # fmt: skip
    y: list[tuple[tuple[int, int, float], ...]] = [
        ((0, 1, -one),), ((1, 0, one),), ((1, 1, one),), ((0, 2, tilt),), (), ((2, 0, one),),
        (), ((2, 1, one),), (), ((1, 2, one),), (), ((2, 2, one),),
    ]  # fmt: skip
    return {f"b{i}": both for i, both in enumerate(zip(x, y, strict=True), 1)}


def _gruen() -> dict[str, Terms]:
    """Terms aᵢⱼ (x) and bᵢⱼ (y), of degree j − 1 in x and i − 1 in y."""
    tilt = TILT["gruen"]
    found: dict[str, Terms] = {
        "a12": (((1, 0, 1.0),), ((0, 1, -1.0),)),
        "a21": (((0, 1, 1.0),), ((1, 0, 1.0),)),
        "a22": (((1, 1, 1.0),), ((0, 2, tilt),)),
        "b22": (((2, 0, tilt),), ((1, 1, 1.0),)),
        "a31": (((0, 2, 1.0),), ()),
        "b13": ((), ((2, 0, 1.0),)),
    }
    for degree in range(3, 9):
        pairs = [(i, degree - i) for i in range(5) if 0 <= degree - i < 5]
        found |= {f"a{i + 1}{j + 1}": (((j, i, 1.0),), ()) for i, j in pairs}
        found |= {f"b{i + 1}{j + 1}": ((), ((j, i, 1.0),)) for i, j in pairs}
    return found


TERMS: Mapping[str, Mapping[str, Terms]] = {"ebner": _ebner(), "gruen": _gruen()}
# Names that the parameters have among those of an interior orientation.
NAMES = {model: tuple(f"{model}_{name}" for name in terms) for model, terms in TERMS.items()}

# Beyond this share of the image's half size polynomials mean nothing, and would fold the image back on itself: their
# arguments go on ever more slowly, by so much of it in all.
REACH, FADE = 1.1, 0.1
# Largest slope of a correction anywhere in the image: far more than film or a sensor does.
STEEPEST = 0.2


@dataclass(frozen=True)
class AdditionalParameters:
    """Additional parameters of an image plane: x right, y DOWN, from the principal point.

    Attributes
    ----------
    model : str
        'ebner' or 'gruen'.
    base : float
        b, in the unit of the image plane.
    values : tuple of float
        Coefficients, in that unit.
    half : tuple of float
        Half the size of the image, in that unit.
    """

    model: str
    base: float
    values: tuple[float, ...]
    half: tuple[float, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients among the parameters of an interior orientation."""
        return NAMES[self.model]

    @classmethod
    def none(cls, model: str, half: tuple[float, float]) -> Self:
        """Parameters that are all 0, on a base that fits the image."""
        return cls(model, (half[0] + half[1]) / 2.0, (0.0,) * len(TERMS[model]), half)

    @classmethod
    def from_table(cls, table: Mapping[str, Any], half: tuple[float, float], where: str) -> Self:
        """Parameters of a table: `model`, `base` (default the mean of the half sides), and the coefficients not 0.

        Raises
        ------
        InputError
            A key is unknown or no number, or the corrections are too large.
        """
        model = choice(need(table, "model", where, f"one of {', '.join(TERMS)}"), TERMS, "model", where)
        known_keys(table, ("model", "base", *TERMS[model]), where)
        base = positive(table["base"], "base", where) if "base" in table else cls.none(model, half).base
        found = cls(model, base, tuple(number(table.get(name, 0.0), name, where) for name in TERMS[model]), half)
        x, y = (axis.ravel() for axis in np.meshgrid(*(np.linspace(-side, side, 21) for side in half)))
        steepest = float(np.abs(found.slopes(x, y) - np.eye(2)).max())
        if not steepest <= STEEPEST:
            raise InputError(
                f"the additional parameters move places of the image by {steepest:.2g} of their distance",
                where=where,
                hint="give the coefficients in pixels (of film in mm): what their terms move at x = y = base",
            )
        return found

    def with_values(self, values: Iterable[float]) -> Self:
        """Other values of the coefficients."""
        return replace(self, values=tuple(float(value) for value in values))

    def scaled(self, factor: float) -> Self:
        """Parameters of the image in another resolution."""
        return replace(
            self, base=self.base * factor, values=tuple(value * factor for value in self.values),
            half=(self.half[0] * factor, self.half[1] * factor),
        )  # fmt: skip

    @cached_property
    def _coefficients(self) -> FloatArray:
        """Of Pᵢ(x)·Pⱼ(y) in Δx and in Δy, (2, I, J)."""
        size = len(POLYNOMIALS[self.model])
        out = np.zeros((2, size, size))
        for value, term in zip(self.values, TERMS[self.model].values(), strict=True):
            for axis, parts in enumerate(term):
                for i, j, factor in parts:
                    out[axis, i, j] += value * factor
        return out

    def _polynomials(self, places: FloatArray, axis: int) -> tuple[FloatArray, FloatArray]:
        """Pᵢ at places (N,) along an axis, and their slopes: (I, N) each."""
        limit = REACH * self.half[axis]
        over = np.maximum(np.abs(places) - limit, 0.0) / (FADE * limit)
        fading = np.exp(-over)
        inside = np.where(over > 0.0, np.sign(places) * limit * (1.0 + FADE * (1.0 - fading)), places) / self.base
        matrix = _MATRICES[self.model]
        powers = np.ones((len(matrix), len(places)))
        for i in range(1, len(matrix)):
            np.multiply(powers[i - 1], inside, out=powers[i])
        by_power = matrix[:, 1:] * np.arange(1.0, len(matrix))
        return matrix @ powers, by_power @ powers[:-1] * (fading / self.base)

    def shifted(self, x: FloatArray, y: FloatArray) -> Columns:
        """Places (N,) of the image without these errors to places with them."""
        (px, _), (py, _) = self._polynomials(x, 0), self._polynomials(-y, 1)
        dx, dy = (px * (self._coefficients @ py)).sum(axis=1)
        return x + dx, y - dy

    def slopes(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Derivatives (N, 2, 2) of `shifted`."""
        (px, sx), (py, sy) = self._polynomials(x, 0), self._polynomials(-y, 1)
        by_x, by_y = ((a * (self._coefficients @ b)).sum(axis=1).T for a, b in ((sx, py), (px, sy)))
        out: FloatArray = np.eye(2) + np.stack([by_x, -by_y], axis=2) * np.array([[1.0], [-1.0]])
        return out

    def by_values(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Derivatives (N, 2, K) of `shifted` by the coefficients."""
        px, py = self._polynomials(x, 0)[0], self._polynomials(-y, 1)[0]
        out = np.zeros((len(x), 2, len(self.values)))
        for index, term in enumerate(TERMS[self.model].values()):
            for axis, parts in enumerate(term):
                for i, j, factor in parts:
                    out[:, axis, index] += factor * px[i] * py[j]
        out[:, 1] *= -1.0
        return out

    def undone(self, x: FloatArray, y: FloatArray) -> Columns:
        """Inverse of `shifted` by Newton's method, to rounding; NaN where it does not converge."""

        def forward(u: FloatArray, v: FloatArray) -> tuple[Columns, Slopes]:
            (xu, xv), (yu, yv) = np.moveaxis(self.slopes(u, v), 0, -1)
            return self.shifted(u, v), (xu, xv, yu, yv)

        return newton_inverse(forward, (x, y), (x, y), self.base, (1e-14, 1e-10))

    def to_dict(self) -> dict[str, Any]:
        """Table of `from_table`."""
        given = {name: value for name, value in zip(TERMS[self.model], self.values, strict=True) if value}
        return {"model": self.model, "base": self.base, **given}


def additional_of(table: Mapping[str, Any], half: tuple[float, float], where: str) -> AdditionalParameters | None:
    """Additional parameters of a camera's table or state, of an image of half its size; None without.

    Parameters
    ----------
    table : mapping
    half : tuple of float
        In the unit of the image plane: pixels, mm of film.
    where : str
        Named in errors.
    """
    if "additional" not in table:
        return None
    own = table_of(table["additional"], "additional", where)
    return AdditionalParameters.from_table(own, half, f"{where}, additional")


def with_requested(camera: Kind, names: Iterable[str], half: tuple[float, float]) -> Kind:
    """Camera with the additional parameters, all 0, that names of an interior orientation ask for.

    Parameters
    ----------
    camera : CameraModel
        With `additional`; the same where it has such parameters, or none are asked for.
    names : iterable of str
    half : tuple of float
        As for `AdditionalParameters`.

    Raises
    ------
    InputError
        Two sets of parameters are asked for, or another than the camera has.
    """
    given = camera.additional
    named = {*names, *(given.names if given else ())}
    found = [model for model, own in NAMES.items() if named & set(own)]
    if len(found) > 1:
        what = f"{' and '.join(found)} are two sets of additional parameters, of which a camera has one"
        raise InputError(what, where="`interior`", hint="choose one of them")
    return (
        camera
        if given is not None or not found
        else replace(camera, additional=AdditionalParameters.none(found[0], half))
    )
