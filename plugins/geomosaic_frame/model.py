"""The frame camera as a sensor model: collinearity through a lens.

    (X, Y, Z) = F·M·(A·(ground − O) − c),   (u, v) = lens(X, Y, Z),   col = cx + fx·u,   row = cy + fy·v

O is the nominal projection centre and A the rotation to east, north, up there (`LocalFrame`); c is the offset of the
projection centre, M = R3(κ)·R2(φ)·R1(ω), and F = diag(1, −1, −1) turns image axes (x right, y up) into camera axes (x
right, y down, z forward). With an ideal lens this is the collinearity equation with −f of the textbooks (Kraus,
Photogrammetry, ch. 5). In the planar treatment A is the identity: map axes, as if the Earth were flat. Where refraction
or the Earth's curvature is corrected, A·(ground − O) − c is bent first (`bending.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.geo.local_frames import LocalFrame
from geomosaic.geo.rotation import omega_phi_kappa, r1, r2, r3
from geomosaic.sensor.model import Parameters
from geomosaic.types import FloatArray
from geomosaic_frame.camera_capabilities import CameraModel, camera_model_from_dict
from geomosaic_frame.orientation import FLIP
from geomosaic_frame.ray_corrections import Columns, RayCorrection

NAMES = ("east", "north", "up", "omega", "phi", "kappa")

# Derivative of R(t)·v by t is −e×(R·v): the cross-product matrices of the axes, negated.
_TURN = (
    np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
    np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
)


@dataclass(frozen=True, eq=False)
class FrameModel:
    """Frame sensor model: one photo of a frame camera.

    Attributes
    ----------
    camera : CameraModel
        Interior orientation for this image's size: in pixels, or a film with its scan.
    frame : LocalFrame
        East, north, up at the nominal projection centre; or the map's axes (planar treatment).
    parameters : Parameters
        east, north, up: offset of the projection centre from the frame's origin in metres (map units if planar); omega,
        phi, kappa in degrees, ground → image in that frame.
    seed : tuple of float
        Ground point in `crs` near the middle of the image.
    notes : tuple of str
        What was assumed when the model was made.
    bending : RayCorrection
        Refraction and, in the planar treatment, the Earth's curvature; none unless asked for.
    """

    camera: CameraModel
    frame: LocalFrame
    parameters: Parameters
    seed: tuple[float, float, float]
    notes: tuple[str, ...] = ()
    bending: RayCorrection = field(default_factory=RayCorrection)

    @property
    def crs(self) -> CRS:
        """Geocentric, or the map CRS of the planar treatment."""
        return self.frame.crs

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.camera.size

    @cached_property
    def rotation(self) -> FloatArray:
        """Local frame → image, x right, y up (3, 3)."""
        omega, phi, kappa = np.radians(self.parameters.values[3:])
        return omega_phi_kappa(omega, phi, kappa)

    @cached_property
    def centre(self) -> FloatArray:
        """Projection centre in `crs` (3,)."""
        centre: FloatArray = self.frame.to_geocentric(self.parameters.values[None, :3])[0]
        return centre

    @cached_property
    def _to_camera(self) -> FloatArray:
        """`crs` → camera axes (3, 3)."""
        turned: FloatArray = FLIP @ self.rotation @ self.frame.axes
        return turned

    def _camera_axes(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Ground (N, 3) to camera axes, (N,) each.

        Written out instead of a matrix product: BLAS may round a point differently from one array length to the next.
        """
        points = np.asarray(xyz, dtype=np.float64)
        x, y, z = (points[:, i] - self.centre[i] for i in range(3))
        if self.bending.none:
            return _product(self._to_camera, x, y, z)
        return _product(FLIP @ self.rotation, *self.bending.seen(*_product(self.frame.axes, x, y, z)))

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) in `crs` to image (N, 2) in pixels; NaN behind the camera."""
        return self.camera.project(*self._camera_axes(xyz))

    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to origins (N, 3) and unit directions (N, 3) towards the ground, in `crs`."""
        seen = self.camera.directions(colrow)
        if self.bending.none:
            directions: FloatArray = seen @ self._to_camera
        else:
            directions = self.bending.true(seen @ (FLIP @ self.rotation)) @ self.frame.axes
            directions /= np.linalg.norm(directions, axis=1)[:, None]
        return np.tile(self.centre, (len(directions), 1)), directions

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by parameters (N, 2, 6), per metre and degree, and by ground (N, 2, 3)."""
        points = np.asarray(xyz, dtype=np.float64)
        by_camera = self.camera.derivatives(*self._camera_axes(points))
        local = (points - self.centre) @ self.frame.axes.T
        bent = np.eye(3) if self.bending.none else self.bending.slopes(*local.T)
        seen = local if self.bending.none else np.column_stack(self.bending.seen(*local.T))
        omega, phi, kappa = np.radians(self.parameters.values[3:])
        turned = (
            self.rotation @ _TURN[0],
            r3(kappa) @ _TURN[1] @ r2(phi) @ r1(omega),
            _TURN[2] @ self.rotation,
        )
        out = np.empty((len(points), 2, 6))
        by_local = by_camera @ (FLIP @ self.rotation) @ bent
        out[:, :, :3] = -by_local
        for i, matrix in enumerate(turned):
            # Parameters are in degrees, the derivatives of rotations per radian: hence π/180 below.
            moved = seen @ (FLIP @ matrix).T
            out[:, :, 3 + i] = np.einsum("nij,nj->ni", by_camera, moved) * (np.pi / 180.0)
        return out, by_local @ self.frame.axes

    def with_values(self, values: FloatArray) -> Self:
        """Photo with other parameter values (6,)."""
        return replace(self, parameters=self.parameters.with_values(values))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values; a free parameter's sigma is null."""
        p = self.parameters
        return {
            "camera": self.camera.to_dict(),
            "crs": self.crs.to_wkt(),
            "origin": self.frame.origin.tolist(),
            "axes": self.frame.axes.tolist(),
            "values": p.values.tolist(),
            "sigmas": [None if np.isinf(s) else float(s) for s in p.sigmas],
            "steps": p.steps.tolist(),
            "units": list(p.units),
            "seed": list(self.seed),
            "notes": list(self.notes),
            "bending": self.bending.to_dict(),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it."""
        frame = LocalFrame(CRS.from_wkt(state["crs"]), np.array(state["origin"]), np.array(state["axes"]))
        sigmas = np.array([np.inf if s is None else s for s in state["sigmas"]])
        parameters = Parameters(
            NAMES, tuple(state["units"]), np.array(state["values"]), sigmas, np.array(state["steps"])
        )
        x, y, z = state["seed"]
        bending = RayCorrection.from_dict(state.get("bending", {}))
        return cls(
            camera_model_from_dict(state["camera"]), frame, parameters, (x, y, z), tuple(state["notes"]), bending
        )


def _product(matrix: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> Columns:
    """Product of a matrix (3, 3) and columns (N,), rounded alike for a point alone and among others."""
    a, b, c = (t[0] * x + t[1] * y + t[2] * z for t in matrix)
    return a, b, c
