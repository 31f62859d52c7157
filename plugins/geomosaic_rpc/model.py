"""The RPC sensor model, corrected in the image by shift, drift or affine.

    (c, r) = RPC(longitude, latitude, height)
    col = c + col_shift + col_per_row·v + col_per_col·u,   u = (c − width/2) / half,   half = max(width, height) / 2
    row = r + row_shift + row_per_row·v + row_per_col·u,   v = (r − height/2) / half

so that every parameter is in pixels: what its term does at the longer image edge. The terms are those of Grodecki and
Dial (Block Adjustment of High-Resolution Satellite Images Described by Rational Polynomials, PE&RS 69(1), 2003) and of
Fraser and Hanley (Bias-Compensated RPCs, PE&RS 71(8), 2005), whose drift goes along the rows: the lines of a scanner
are taken one after the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.units import metres_per_unit
from geomosaic.sensor.plugin import ControlBlunder, Parameters
from geomosaic.types import FloatArray
from geomosaic_rpc.coefficients import Rpc

NAMES = ("col_shift", "row_shift", "col_per_row", "row_per_row", "col_per_col", "row_per_col")
# Refinements and how many of the parameters they free.
KINDS = {"none": 0, "shift": 2, "drift": 4, "affine": 6}

WGS84 = CRS.from_epsg(4979)


@dataclass(frozen=True)
class RpcModel:
    """RPC sensor model of one scene, with corrections in the image.

    Attributes
    ----------
    rpc : Rpc
        As the producer made it.
    size : tuple of int
        Width and height in pixels.
    parameters : Parameters
        The six corrections in pixels (see above); those that the kind of refinement leaves out are held fixed.
    seed : tuple of float
        Longitude, latitude and height near the middle of the image.
    notes : tuple of str
        Where the coefficients come from and what was done to them.
    left_out : tuple of ControlBlunder
        Control points that contradict the others; a record of the fit, and no part of the state.
    """

    rpc: Rpc
    size: tuple[int, int]
    parameters: Parameters
    seed: tuple[float, float, float]
    notes: tuple[str, ...] = ()
    left_out: tuple[ControlBlunder, ...] = ()

    @classmethod
    def of(
        cls, rpc: Rpc, size: tuple[int, int], kind: str = "shift", *, where: str = "RPC", notes: tuple[str, ...] = ()
    ) -> Self:
        """Model that is not corrected yet.

        Parameters
        ----------
        rpc : Rpc
        size : tuple of int
            Width and height in pixels.
        kind : str
            What an adjustment may change: 'none', 'shift', 'drift' (shift and drift) or 'affine'.
        where : str
            Named in errors.
        notes : tuple of str

        Raises
        ------
        InputError
            The coefficients do not show the middle of an image of this size.
        """
        sigmas = np.where(np.arange(len(NAMES)) < KINDS[kind], np.inf, 0.0)
        zero = np.zeros(len(NAMES))
        parameters = Parameters(NAMES, ("px",) * len(NAMES), zero, sigmas, zero + 1.0)
        return cls(rpc, size, parameters, _middle(rpc, size, where), notes)

    def freed(self, kind: str) -> Self:
        """Model with the parameters of another kind of refinement free."""
        sigmas = np.where(np.arange(len(NAMES)) < KINDS[kind], np.inf, 0.0)
        return replace(self, parameters=replace(self.parameters, sigmas=sigmas))

    @property
    def crs(self) -> CRS:
        """WGS 84, longitude, latitude and ellipsoidal height."""
        return WGS84

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3), degrees and metres, to image (N, 2) in pixels; NaN far outside the scene."""
        image = self.rpc.image(xyz)
        values = self.parameters.values
        if not values.any():
            return image
        u, v = self._edges(image)
        return image + values[:2] + v[:, None] * values[2:4] + u[:, None] * values[4:]

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by parameters (N, 2, 6), and by ground (N, 2, 3) per degree and metre."""
        image, by_ground = self.rpc.jacobian(xyz)
        values, half = self.parameters.values, max(self.size) / 2.0
        by_parameters = np.zeros((len(image), 2, len(NAMES)))
        for k, term in enumerate((np.where(np.isnan(image[:, 0]), np.nan, 1.0), *self._edges(image)[::-1])):
            by_parameters[:, 0, 2 * k] = by_parameters[:, 1, 2 * k + 1] = term
        # The corrections are functions of the uncorrected image: by the chain rule, I + their gradient multiplies its
        # derivatives.
        turn = np.eye(2) + np.column_stack([values[4:], values[2:4]]) / half
        return by_parameters, np.einsum("ij,njk->nik", turn, by_ground)

    def _edges(self, image: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places (N,) across and along, ±1 at the longer image edge."""
        half = max(self.size) / 2.0
        return (image[:, 0] - self.size[0] / 2.0) / half, (image[:, 1] - self.size[1] / 2.0) / half

    def with_values(self, values: FloatArray) -> Self:
        """Scene with other corrections (6,)."""
        return replace(self, parameters=self.parameters.with_values(values))

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance (6, 6) of shifts that move the ground by the errors of the file; None where it states none."""
        # ERR_BIAS and ERR_RAND are RMS errors in metres along each horizontal axis (STDI-0002, RPC00B). Both move a
        # pixel, and independently. Of a corrected scene they say no more.
        if self.rpc.errors is None or self.parameters.values.any():
            return None
        seed = np.array([self.seed])
        by_metre = (self.rpc.jacobian(seed)[1] / metres_per_unit(WGS84, seed))[0, :, :2]
        found = np.zeros((len(NAMES), len(NAMES)))
        found[:2, :2] = np.square(self.rpc.errors).sum() * by_metre @ by_metre.T
        return found

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "rpc": self.rpc.to_dict(),
            "size": list(self.size),
            **self.parameters.to_dict(),
            "seed": list(self.seed),
            "notes": list(self.notes),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it."""
        parameters = Parameters.from_dict(NAMES, ("px",) * len(NAMES), state)
        width, height = state["size"]
        lon, lat, h = state["seed"]
        return cls(Rpc.from_dict(state["rpc"]), (width, height), parameters, (lon, lat, h), tuple(state["notes"]))


def _middle(rpc: Rpc, size: tuple[int, int], where: str) -> tuple[float, float, float]:
    """Ground at the middle of an image and the middle height of its RPC, by Newton's method."""
    target = np.array(size) / 2.0
    place = rpc.ground_offset.copy()
    for _ in range(60):
        image, by_ground = (a[0] for a in rpc.jacobian(place[None]))
        left = target - image
        if np.abs(left).max() < 1e-3:  # NaN goes on to the error
            return float(place[0]), float(place[1]), float(place[2])
        matrix = by_ground[:, :2]
        if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) == 0.0:
            break
        # Half a scene at most: a full step from a far start may leave the range of the polynomials.
        step = np.linalg.solve(matrix, left)
        longest = float(np.max(np.abs(step / rpc.ground_scale[:2])))
        place[:2] += step * min(1.0, 0.5 / longest if longest > 0.0 else 1.0)
    low, high = rpc.image_offset - np.abs(rpc.image_scale), rpc.image_offset + np.abs(rpc.image_scale)
    raise InputError(
        f"the RPC does not show the middle of this image of {size[0]} x {size[1]} pixels; it is made for columns "
        f"{low[0]:.0f} to {high[0]:.0f} and rows {low[1]:.0f} to {high[1]:.0f}",
        where=where,
        hint="check that the RPC belongs to this image; for a part of a scene give offset = [col, row] of its corner",
    )
