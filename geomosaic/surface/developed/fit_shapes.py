"""Shapes of bodies for a fit: place, axis and sizes, and the distances of points with their derivatives.

The derivative of a distance by anything that moves the body is −n · (the movement of the foot), n being the normal
there. A body that turns by a small ω about its origin o moves a foot x by ω × (x − o).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geomosaic.geo.rotation import angle_axis
from geomosaic.surface.developed.ellipsoid import Ellipsoid
from geomosaic.types import FloatArray

LEAST = {"plane": 3, "sphere": 4, "cylinder": 5, "cone": 6, "ellipsoid": 7}
"""Unknowns of each kind, which is also how many points it needs; two fewer with a known axis."""
SIZES = {"plane": (), "sphere": ("radius",), "cylinder": ("radius",), "cone": ("half_angle",), "ellipsoid": ("a", "c")}


@dataclass(frozen=True)
class Shape:
    """Body with its place, axis and sizes.

    Attributes
    ----------
    kind : str
        A key of `LEAST`.
    origin : array (3,)
        A point of the plane, a point of the cylinder's axis, the apex, or the centre.
    rotation : array (3, 3)
        Rows x', y', z'; z' is the normal or the axis.
    sizes : array
        As in `SIZES`; metres, the half angle in radians.
    """

    kind: str
    origin: FloatArray
    rotation: FloatArray
    sizes: FloatArray

    def names(self, *, axis_known: bool) -> tuple[str, ...]:
        """Names of the unknowns: shifts along x', y', z' of the origin, turns about x' and y', sizes."""
        shifts = {"plane": ("z'",), "cylinder": ("x'", "y'")}.get(self.kind, ("x'", "y'", "z'"))
        turns = () if axis_known or self.kind == "sphere" else ("about x'", "about y'")
        return (*shifts, *turns, *SIZES[self.kind])

    def distances(self, points: FloatArray, names: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
        """Signed distances (N,) of points (N, 3), outwards positive, and their derivatives (N, P)."""
        own = (points - self.origin) @ self.rotation.T
        away, normal, by_size = self._measured(own)
        columns = {f"{'xyz'[i]}'": -normal[:, i] for i in range(3)}
        # n · (e × x) = e · (x × n)
        moment = np.cross(own, normal)
        columns |= {"about x'": -moment[:, 0], "about y'": -moment[:, 1]}
        columns |= dict(zip(SIZES[self.kind], by_size, strict=True))
        return away, np.column_stack([columns[name] for name in names])

    def _measured(self, own: FloatArray) -> tuple[FloatArray, FloatArray, tuple[FloatArray, ...]]:
        """Distances, outward normals (N, 3) and derivatives by the sizes of points in body axes."""
        out = np.hypot(own[:, 0], own[:, 1])
        east, north = own[:, 0] / np.maximum(out, 1e-300), own[:, 1] / np.maximum(out, 1e-300)
        if self.kind == "plane":
            return own[:, 2], np.tile([0.0, 0.0, 1.0], (len(own), 1)), ()
        if self.kind == "sphere":
            reach = np.linalg.norm(own, axis=1)
            return reach - self.sizes[0], own / reach[:, None], (-np.ones(len(own)),)
        if self.kind == "cylinder":
            return out - self.sizes[0], np.column_stack([east, north, np.zeros_like(out)]), (-np.ones(len(own)),)
        if self.kind == "cone":
            sine, cosine = np.sin(self.sizes[0]), np.cos(self.sizes[0])
            normal = np.column_stack([east * cosine, north * cosine, np.full_like(out, sine)])
            return out * cosine + own[:, 2] * sine, normal, (own[:, 2] * cosine - out * sine,)
        body = Ellipsoid(float(self.sizes[0]), float(self.sizes[1]), "equidistant")
        away, normal = body.coordinates(own)[:, 2], body.normal(own)
        foot = own - away[:, None] * normal
        across = (foot[:, :2] * normal[:, :2]).sum(axis=1) / self.sizes[0]
        return away, normal, (-across, -foot[:, 2] * normal[:, 2] / self.sizes[1])

    def moved(self, names: tuple[str, ...], step: FloatArray) -> Shape:
        """Shape after a step (P,) of the unknowns."""
        change = dict(zip(names, step, strict=True))
        shift = np.array([change.get(f"{axis}'", 0.0) for axis in "xyz"])
        turn = angle_axis(np.array([change.get("about x'", 0.0), change.get("about y'", 0.0), 0.0]))
        sizes = self.sizes + np.array([change[name] for name in SIZES[self.kind]])
        rotation = turn.T @ self.rotation
        return replace(self, origin=self.origin + shift @ self.rotation, rotation=rotation, sizes=sizes)

    @property
    def sound(self) -> bool:
        """Whether the sizes are those of a body."""
        limit = np.pi / 2 if self.kind == "cone" else np.inf
        return bool(((self.sizes > 0.0) & (self.sizes < limit)).all())


def basis(axis: FloatArray) -> FloatArray:
    """Rotation whose last row is a given axis; the other two are free.

    Parameters
    ----------
    axis : array (3,)
        Unit vector.

    Returns
    -------
    array (3, 3)
    """
    # Crossed with an axis of the frame that is far from parallel to it, so that the product has length.
    first = np.cross([0.0, 1.0, 0.0] if abs(axis[0]) > 0.7 else [1.0, 0.0, 0.0], axis)
    first = first / np.linalg.norm(first)
    return np.array([first, np.cross(axis, first), axis])
