"""Number and layout of control points, and the redundancy of a block of photos."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError, did_you_mean
from geomosaic.types import FloatArray

COEFFICIENTS = {"conformal": 4, "affine": 6, "projective": 8, "frame": 6, "spot": 14} | {
    f"poly{n}": (n + 1) * (n + 2) for n in range(1, 6)
}
"""Unknowns of one image: each point gives two equations. 'frame' is resection of a photo with a known camera; 'spot'
the line scanner of Müller and Sauleda with six elements of orientation and eight additional parameters."""
ROUGHLY = (8, 15)
"""Points per image that Wolf recommends (section 9-3), depending on the transformation and the accuracy."""
FOR_FILTERING = 20
"""Points that Jensen begins with, to leave out the worst until the RMS is below its threshold."""


@dataclass(frozen=True)
class ControlNumber:
    """Number of control points that a model needs.

    Attributes
    ----------
    unknowns : int
    least : int
        Points that determine the model without redundancy.
    redundant : int
        Points with which there are twice as many equations as unknowns.
    recommended : tuple of int
        Range: `ROUGHLY`, and more where `redundant` is.
    """

    unknowns: int
    least: int
    redundant: int
    recommended: tuple[int, int]


def control_number(model: str) -> ControlNumber:
    """Number of control points that one image needs.

    Parameters
    ----------
    model : str
        Of `COEFFICIENTS`.

    Returns
    -------
    ControlNumber

    Raises
    ------
    InputError
        The model is not known.
    """
    if model not in COEFFICIENTS:
        raise InputError(
            f"there is no model '{model}'",
            where="`model`",
            hint=did_you_mean(model, COEFFICIENTS) or f"one of {', '.join(COEFFICIENTS)}",
        )
    unknowns = COEFFICIENTS[model]
    least, twice = math.ceil(unknowns / 2), unknowns
    return ControlNumber(unknowns, least, twice, (max(ROUGHLY[0], twice), max(ROUGHLY[1], twice)))


def models_of(count: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Models that a number of control points determines.

    Parameters
    ----------
    count : int
        Points in one image.

    Returns
    -------
    determined : tuple of str
        Names of models with at least as many equations as unknowns.
    redundant : tuple of str
        Names of those with at least twice as many.
    """
    need = {name: control_number(name) for name in COEFFICIENTS}
    return (
        tuple(name for name, number in need.items() if number.least <= count),
        tuple(name for name, number in need.items() if number.redundant <= count),
    )


def control_layout(count: int) -> FloatArray:
    """Layout of control points: one in each corner, then each in the middle of the largest gap (Wolf, section 9-3).

    Parameters
    ----------
    count : int
        At least 4.

    Returns
    -------
    array (count, 2)
        Parts of width and height, from 0.05 to 0.95, in the order of measurement: the first n are well spread too.

    Raises
    ------
    InputError
        Fewer than 4.
    """
    if count < 4:
        raise InputError("a layout begins with the four corners", where="`points`", hint="give 4 or more")
    axis = np.linspace(0.05, 0.95, 37)
    places = np.array([(x, y) for y in axis for x in axis])
    # Opposite corners first: the first two points already span the whole image.
    chosen = [np.array(corner) for corner in ((0.05, 0.05), (0.95, 0.95), (0.95, 0.05), (0.05, 0.95))]
    gap = np.full(len(places), np.inf)
    for corner in chosen:
        gap = np.minimum(gap, np.hypot(*(places - corner).T))
    while len(chosen) < count:
        # Rounded, so that the choice among equal gaps does not hang on the last bit.
        chosen.append(places[int(np.argmax(np.round(gap, 9)))])
        gap = np.minimum(gap, np.hypot(*(places - chosen[-1]).T))
    return np.array(chosen[:count])


@dataclass(frozen=True)
class BlockBalance:
    """Equations and unknowns of photos that are adjusted together (Wolf, section 9-8).

    Attributes
    ----------
    unknowns : int
        Of all photos.
    tie_equations, control_equations : int
        From tie points and from control points.
    """

    unknowns: int
    tie_equations: int
    control_equations: int

    @property
    def redundancy(self) -> int:
        """Number of equations beyond the unknowns."""
        return self.tie_equations + self.control_equations - self.unknowns


def block_balance(photos: int, model: str, ties: int, control: int) -> BlockBalance:
    """Equations and unknowns of a semi-controlled mosaic.

    Parameters
    ----------
    photos : int
    model : str
        Of every photo; the conformal one has 4 unknowns.
    ties : int
        Connections between two photos, each with two equations (9-4).
    control : int
        Measurements of control points, each with two equations (9-3).

    Returns
    -------
    BlockBalance

    Raises
    ------
    InputError
        The model is not known.
    """
    return BlockBalance(photos * control_number(model).unknowns, 2 * ties, 2 * control)
