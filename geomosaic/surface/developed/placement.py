"""A developed surface where it stands: developed coordinates to points of its local frame, and back.

(u, v, h) are metres: u to the right and v up as the drawn side is looked at, h towards the one who looks. From inside
u runs the other way round, so that no picture is a mirror image.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.geo.engineering_crs import developed_crs
from geomosaic.geo.local_frames import LocalFrame
from geomosaic.surface.developed.ellipsoid import Ellipsoid, Triaxial
from geomosaic.surface.developed.primitives import Axes, Bounds, Cone, Cylinder, Flat, Primitive, turned
from geomosaic.types import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Developed:
    """A body at its place.

    Attributes
    ----------
    body : Primitive
    axes : Axes
        Of the body in the local frame.
    inside : bool
        Whether it is looked at from inside.
    bottom, top : float
        Least and largest height along the body's axis (along v on a plane), metres from its origin; may be infinite.
    frame : LocalFrame or None
        The local frame on the Earth; None where it is tied to nothing.
    """

    body: Primitive
    axes: Axes
    inside: bool = False
    bottom: float = -np.inf
    top: float = np.inf
    frame: LocalFrame | None = None

    @cached_property
    def crs(self) -> CRS:
        """3-D CRS of u, v and h."""
        return developed_crs(self.body.kind)

    @property
    def _side(self) -> FloatArray:
        return np.array([-1.0, 1.0, -1.0]) if self.inside else np.ones(3)

    @property
    def domain(self) -> Bounds:
        """Left, bottom, right, top of all that may be drawn; may be infinite."""
        left, low, right, high = self.body.domain
        if self.body.kind in ("plane", "cylinder"):
            low, high = max(low, self.bottom), min(high, self.top)
        return left, low, right, high

    def point(self, uvh: FloatArray) -> FloatArray:
        """Developed coordinates (N, 3) to the local frame (N, 3); NaN off the development.

        On a plane and a cylinder bottom and top are straight edges of the drawing, see `domain`; elsewhere what lies
        beyond them is NaN.
        """
        flat = np.asarray(uvh, dtype=np.float64) * self._side
        body = self.body.point(flat)
        if self.body.kind not in ("plane", "cylinder") and np.isfinite([self.bottom, self.top]).any():
            foot = self.body.point(flat * [1.0, 1.0, 0.0])[:, 2]
            with np.errstate(invalid="ignore"):
                body[~((foot >= self.bottom - 1e-9) & (foot <= self.top + 1e-9))] = np.nan
        return self.axes.to_local(body)

    def coordinates(self, xyz: FloatArray) -> FloatArray:
        """Local frame (N, 3) to developed coordinates (N, 3); NaN where there are none."""
        return self.body.coordinates(self.axes.to_body(xyz)) * self._side

    def normal(self, xyz: FloatArray) -> FloatArray:
        """Unit normals (N, 3) towards the drawn side, local frame, at the feet of points (N, 3)."""
        outward = turned(self.axes.rotation.T, self.body.normal(self.axes.to_body(xyz)))
        return -outward if self.inside else outward

    def above(self, xyz: FloatArray) -> FloatArray:
        """Heights (N,) of points of the local frame along the body's axis (along v on a plane)."""
        return self.axes.to_body(xyz)[:, 1 if self.body.kind == "plane" else 2]

    def within(self, xyz: FloatArray) -> BoolArray:
        """Which points (N, 3) of the local frame lie between bottom and top."""
        height = self.above(xyz)
        with np.errstate(invalid="ignore"):
            return (height >= self.bottom) & (height <= self.top)

    def meeting(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """First points (N, 3) at which rays meet the drawn side, local frame.

        Parameters
        ----------
        origins, directions : array (N, 3)
            Local frame; directions of unit length, towards the object.

        Returns
        -------
        array (N, 3)
            NaN where a ray meets no drawn side between bottom and top.
        """
        o, d = self.axes.to_body(origins), turned(self.axes.rotation, directions)
        distances = np.sort(self.body.meetings(o, d), axis=1)  # NaN last
        best = np.full(len(o), np.nan)
        for column in (1, 0):
            there = self.axes.to_local(o + distances[:, column, None] * d)
            with np.errstate(invalid="ignore"):
                faces = (self.normal(there) * directions).sum(axis=1) < 0.0
                good = faces & (distances[:, column] > 0.0) & self.within(there)
            best[good] = distances[good, column]
        return np.asarray(origins + best[:, None] * directions, dtype=np.float64)

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            **self.body.to_dict(),
            "origin": self.axes.origin.tolist(),
            "rotation": self.axes.rotation.tolist(),
            "inside": self.inside,
            "bottom": self.bottom if np.isfinite(self.bottom) else None,
            "top": self.top if np.isfinite(self.top) else None,
            "frame": self.frame and self.frame.to_dict(),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Rebuild from `to_dict`."""
        bottom, top = state["bottom"], state["top"]
        return cls(
            _primitive_from_dict(state),
            Axes(np.array(state["origin"]), np.array(state["rotation"])),
            bool(state["inside"]),
            -np.inf if bottom is None else float(bottom),
            np.inf if top is None else float(top),
            state["frame"] and LocalFrame.from_dict(state["frame"]),
        )


def _primitive_from_dict(state: dict[str, Any]) -> Primitive:
    """Primitive rebuilt from its state, the inverse of its `to_dict`."""
    kind = state["kind"]
    if kind == "plane":
        return Flat()
    if kind == "cylinder":
        return Cylinder(float(state["radius"]))
    if kind == "cone":
        return Cone(float(state["half_angle_radians"]))
    if len(state["semi_axes"]) == 3:
        a, b, c = map(float, state["semi_axes"])
        return Triaxial((a, b, c))
    across, along = state["semi_axes"]
    return Ellipsoid(float(across), float(along), str(state["projection"]))
