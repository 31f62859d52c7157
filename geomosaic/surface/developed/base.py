"""Contract of a body and its development, and what bodies have in common: their own axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray

Bounds = tuple[float, float, float, float]


class Body(Protocol):
    """Body in its own axes, and its surface developed onto (u, v).

    Lengths are metres. h is the offset from the surface along its outward normal. What lies outside of the development
    is NaN.
    """

    @property
    def kind(self) -> str:
        """'plane', 'cylinder', 'cone' or 'ellipsoid'."""

    @property
    def domain(self) -> Bounds:
        """Least and largest u and v (left, bottom, right, top) that show each place once; may be infinite."""

    def point(self, uvh: FloatArray) -> FloatArray:
        """Developed coordinates and offset (N, 3) to body axes (N, 3)."""

    def coordinates(self, xyz: FloatArray) -> FloatArray:
        """Body axes (N, 3) to developed coordinates and offset (N, 3)."""

    def normal(self, xyz: FloatArray) -> FloatArray:
        """Outward unit normals (N, 3), body axes, at the feet of points (N, 3) near the surface."""

    def meetings(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Distances (N, 2) along rays (N, 3) at which they cross the surface, NaN where they do not."""

    def to_dict(self) -> dict[str, Any]:
        """Kind and sizes as JSON values."""


@dataclass(frozen=True)
class Axes:
    """Axes of a body in the local frame.

    Attributes
    ----------
    origin : array (3,)
        Metres in the local frame.
    rotation : array (3, 3)
        Rows are the unit vectors x', y', z' of the body in the local frame.
    """

    origin: FloatArray
    rotation: FloatArray

    @classmethod
    def about(cls, origin: FloatArray, axis: FloatArray, zero: FloatArray | None, where: str) -> Axes:
        """Put z' along an axis and x' towards `zero`, made perpendicular to it; towards the frame's x unless given.

        Raises
        ------
        InputError
            A direction has no length, or zero runs along the axis.
        """
        along = unit(axis, "axis", where)
        first = _beside(along, "axis", zero, "zero", np.eye(3)[[0, 1]], where)
        return cls(np.asarray(origin, dtype=np.float64), np.array([first, np.cross(along, first), along]))

    @classmethod
    def facing(cls, origin: FloatArray, normal: FloatArray, up: FloatArray | None, where: str) -> Axes:
        """Put z' along a normal and y' upwards: towards `up`, else the frame's z, and y where that is the normal.

        Raises
        ------
        InputError
            A direction has no length, or up runs along the normal.
        """
        out = unit(normal, "normal", where)
        top = _beside(out, "normal", up, "up", np.eye(3)[[2, 1]], where)
        return cls(np.asarray(origin, dtype=np.float64), np.array([np.cross(top, out), top, out]))

    def to_body(self, xyz: FloatArray) -> FloatArray:
        """Local frame (N, 3) to body axes (N, 3)."""
        return turned(self.rotation, np.asarray(xyz, dtype=np.float64) - self.origin)

    def to_local(self, xyz: FloatArray) -> FloatArray:
        """Body axes (N, 3) to the local frame (N, 3)."""
        return turned(self.rotation.T, xyz) + self.origin


def turned(matrix: FloatArray, xyz: FloatArray) -> FloatArray:
    """Matrix product with vectors, written out: a point comes out the same alone and among others.

    Parameters
    ----------
    matrix : array (3, 3)
    xyz : array (N, 3)

    Returns
    -------
    array (N, 3)
    """
    x, y, z = np.asarray(xyz, dtype=np.float64).T
    return np.column_stack([row[0] * x + row[1] * y + row[2] * z for row in matrix])


def unit(vector: FloatArray, name: str, where: str) -> FloatArray:
    """Unit vector along a direction.

    Parameters
    ----------
    vector : array (3,)
    name, where : str
        Of the parameter and of what it belongs to, for errors.

    Returns
    -------
    array (3,)

    Raises
    ------
    InputError
        The vector has no length, or is not finite.
    """
    given = np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(given))
    if not (np.isfinite(length) and length > 1e-12):
        raise InputError(
            f"{name} = {given.tolist()} is no direction", where=where, hint="give three numbers, not all 0"
        )
    direction: FloatArray = given / length
    return direction


def _beside(
    along: FloatArray, main: str, given: FloatArray | None, name: str, else_towards: FloatArray, where: str
) -> FloatArray:
    """Unit vector across a direction: towards what is given, else towards the first (2, 3) that does not run along."""
    wanted = else_towards if given is None else unit(given, name, where)[None]
    across = wanted - (wanted @ along)[:, None] * along
    lengths = np.linalg.norm(across, axis=1)
    k = 0 if given is not None or lengths[0] >= 0.1 else 1
    if lengths[k] < 1e-6:
        raise InputError(f"{name} runs along the {main}", where=where, hint="give a direction across it")
    beside: FloatArray = across[k] / lengths[k]
    return beside


def roots(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Both real roots of a·t² + 2·b·t + c, in the form that loses no digits.

    Parameters
    ----------
    a, b, c : array (N,)

    Returns
    -------
    array (N, 2)
        NaN where there are none.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        # The sum of two numbers of one sign: -b + √… would cancel where a·c is small against b².
        q = -(b + np.copysign(np.sqrt(b * b - a * c), b))
        found = np.column_stack([q / a, c / q])
    found[~np.isfinite(found)] = np.nan
    return found
