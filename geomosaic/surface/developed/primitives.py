"""Geometric primitives and their developments: contract, and the developable ones: plane, circular cylinder and cone.

u = R·θ is the length of the arc from the zero direction, v the length along the axis.

With s the distance from the apex along the surface and θ the angle about the axis from the zero direction,
u = s·sin(θ·sin α), v = −s·cos(θ·sin α): the apex lies at (0, 0), and the line of the zero direction runs straight down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray

Bounds = tuple[float, float, float, float]


class Primitive(Protocol):
    """Primitive in its own axes, and its surface developed onto (u, v).

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
        """Primitive axes (N, 3) to developed coordinates and offset (N, 3)."""

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

        Parameters
        ----------
        origin : array (3,)
            Metres.
        axis, zero : array (3,)
            Directions.
        where : str
            Named in errors.

        Raises
        ------
        InputError
            A direction has no length, or zero runs along the axis.
        """
        along = _unit(axis, "axis", where)
        first = _beside(along, "axis", zero, "zero", np.eye(3)[[0, 1]], where)
        return cls(np.asarray(origin, dtype=np.float64), np.array([first, np.cross(along, first), along]))

    @classmethod
    def facing(cls, origin: FloatArray, normal: FloatArray, up: FloatArray | None, where: str) -> Axes:
        """Put z' along a normal and y' upwards: towards `up`, else the frame's z, and y where that is the normal.

        Parameters
        ----------
        origin : array (3,)
            Metres.
        normal, up : array (3,)
            Directions.
        where : str
            Named in errors.

        Raises
        ------
        InputError
            A direction has no length, or up runs along the normal.
        """
        out = _unit(normal, "normal", where)
        top = _beside(out, "normal", up, "up", np.eye(3)[[2, 1]], where)
        return cls(np.asarray(origin, dtype=np.float64), np.array([np.cross(top, out), top, out]))

    def to_body(self, xyz: FloatArray) -> FloatArray:
        """Local frame (N, 3) to body axes (N, 3)."""
        return turned(self.rotation, np.asarray(xyz, dtype=np.float64) - self.origin)

    def to_local(self, xyz: FloatArray) -> FloatArray:
        """Primitive axes (N, 3) to the local frame (N, 3)."""
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


def _unit(vector: FloatArray, name: str, where: str) -> FloatArray:
    """Unit vector along a direction, refused where it has no length or is not finite."""
    given = np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(given))
    if not (np.isfinite(length) and length > 1e-12):
        raise InputError(
            f"{name} = {given.tolist()} is no direction", where=where, hint="give three numbers, not all 0"
        )
    return given / length


def _beside(
    along: FloatArray, main: str, given: FloatArray | None, name: str, else_towards: FloatArray, where: str
) -> FloatArray:
    """Unit vector across a direction: towards what is given, else towards the first (2, 3) that does not run along."""
    wanted = else_towards if given is None else _unit(given, name, where)[None]
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


@dataclass(frozen=True)
class Flat:
    """The plane z' = 0 of its axes."""

    kind = "plane"
    domain = (-np.inf, -np.inf, np.inf, np.inf)

    def point(self, uvh: FloatArray) -> FloatArray:
        """Developed (N, 3) to body axes (N, 3): the same."""
        return np.array(uvh, dtype=np.float64)

    def coordinates(self, xyz: FloatArray) -> FloatArray:
        """Primitive axes (N, 3) to developed (N, 3): the same."""
        return np.array(xyz, dtype=np.float64)

    def normal(self, xyz: FloatArray) -> FloatArray:
        """Normals (N, 3)."""
        return np.tile([0.0, 0.0, 1.0], (len(xyz), 1))

    def meetings(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Distances (N, 2) along rays; the second is NaN."""
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -origins[:, 2] / directions[:, 2]
        distance[~np.isfinite(distance)] = np.nan
        return np.column_stack([distance, np.full(len(distance), np.nan)])

    def to_dict(self) -> dict[str, Any]:
        """Kind as JSON values."""
        return {"kind": self.kind}


@dataclass(frozen=True)
class Cylinder:
    """A cylinder about z'.

    Attributes
    ----------
    radius : float
        Metres.
    """

    radius: float
    kind = "cylinder"

    @property
    def domain(self) -> Bounds:
        """One turn, cut opposite the zero direction."""
        return -np.pi * self.radius, -np.inf, np.pi * self.radius, np.inf

    def point(self, uvh: FloatArray) -> FloatArray:
        """Developed (N, 3) to body axes (N, 3); u goes on over the cut, turn after turn."""
        u, v, h = np.asarray(uvh, dtype=np.float64).T
        theta, out = u / self.radius, self.radius + h
        return np.column_stack([out * np.cos(theta), out * np.sin(theta), v])

    def coordinates(self, xyz: FloatArray) -> FloatArray:
        """Primitive axes (N, 3) to developed (N, 3)."""
        x, y, z = np.asarray(xyz, dtype=np.float64).T
        return np.column_stack([self.radius * np.arctan2(y, x), z, np.hypot(x, y) - self.radius])

    def normal(self, xyz: FloatArray) -> FloatArray:
        """Normals (N, 3)."""
        x, y, _ = np.asarray(xyz, dtype=np.float64).T
        with np.errstate(invalid="ignore"):
            out = np.hypot(x, y)
            return np.column_stack([x / out, y / out, np.zeros_like(x)])

    def meetings(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Distances (N, 2) along rays."""
        o, d = origins[:, :2], directions[:, :2]
        return roots((d * d).sum(axis=1), (o * d).sum(axis=1), (o * o).sum(axis=1) - self.radius**2)

    def to_dict(self) -> dict[str, Any]:
        """Kind and sizes as JSON values."""
        return {"kind": self.kind, "radius": self.radius}


@dataclass(frozen=True)
class Cone:
    """A cone with its apex at the origin, open towards −z'.

    Attributes
    ----------
    half_angle : float
        Between axis and surface, radians, above 0 and below π/2.
    """

    half_angle: float
    kind = "cone"
    # No bounds but those of its sector, beyond which `point` is NaN.
    domain = (-np.inf, -np.inf, np.inf, np.inf)

    def point(self, uvh: FloatArray) -> FloatArray:
        """Developed (N, 3) to body axes (N, 3); NaN beyond the sector, which is cut opposite the zero direction."""
        u, v, h = np.asarray(uvh, dtype=np.float64).T
        sine, cosine = np.sin(self.half_angle), np.cos(self.half_angle)
        along, theta = np.hypot(u, v), np.arctan2(u, -v) / sine
        theta = np.where(np.abs(theta) <= np.pi * (1 + 1e-12), theta, np.nan)
        out = along * sine + h * cosine
        down = -along * cosine + h * sine + 0.0 * theta
        return np.column_stack([out * np.cos(theta), out * np.sin(theta), down])

    def coordinates(self, xyz: FloatArray) -> FloatArray:
        """Primitive axes (N, 3) to developed (N, 3); NaN where the apex is nearest."""
        x, y, z = np.asarray(xyz, dtype=np.float64).T
        sine, cosine, out = np.sin(self.half_angle), np.cos(self.half_angle), np.hypot(x, y)
        along = out * sine - z * cosine
        along = np.where(along >= 0.0, along, np.nan)
        turn = np.arctan2(y, x) * sine
        return np.column_stack([along * np.sin(turn), -along * np.cos(turn), out * cosine + z * sine + 0.0 * along])

    def normal(self, xyz: FloatArray) -> FloatArray:
        """Normals (N, 3); NaN on the axis."""
        x, y, _ = np.asarray(xyz, dtype=np.float64).T
        with np.errstate(invalid="ignore"):
            out = np.hypot(x, y) / np.cos(self.half_angle)
            return np.column_stack([x / out, y / out, np.sin(self.half_angle) + 0.0 * x])

    def meetings(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Distances (N, 2) along rays; crossings of the mirrored cone beyond the apex are NaN."""
        slope = np.tan(self.half_angle) ** 2
        weight = np.array([1.0, 1.0, -slope])
        found = roots(
            (directions**2 * weight).sum(axis=1),
            (origins * directions * weight).sum(axis=1),
            (origins**2 * weight).sum(axis=1),
        )
        with np.errstate(invalid="ignore"):
            found[origins[:, 2:] + found * directions[:, 2:] > 0.0] = np.nan
        return found

    def to_dict(self) -> dict[str, Any]:
        """Kind and sizes as JSON values."""
        return {"kind": self.kind, "half_angle_radians": self.half_angle}
