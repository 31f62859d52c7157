"""Rational polynomial coefficients: cubic polynomials of RPC00B, normalised, with derivatives.

    col = col_scale · N_c(L, P, H) / D_c(L, P, H) + col_off,   row likewise,
    L = (longitude − lon_off) / lon_scale,   P = (latitude − lat_off) / lat_scale,   H = (height − h_off) / h_scale

NITF extension RPC00B (STDI-0002); longitude and latitude of WGS 84 in degrees, height above its ellipsoid in metres.

Terms in the order of the NITF extension RPC00B (STDI-0002, Compendium of Controlled Extensions, table 8-2), with
normalised longitude L, latitude P and height H:

    1, L, P, H, LP, LH, PH, L², P², H², PLH, L³, LP², LH², L²P, P³, PH², L²H, P²H, H³

RPC00A has the same terms in another order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from geomosaic.kernels.library import native
from geomosaic.types import BoolArray, FloatArray

COUNT = 20
_cubic_polynomials = native("cubic_polynomials", "ddd")


def terms(lph: FloatArray) -> FloatArray:
    """Cubic terms of RPC00B.

    Parameters
    ----------
    lph : array (N, 3)
        Normalised longitude, latitude, height.

    Returns
    -------
    array (20, N)
        In the order of the head of this module.
    """
    out = np.empty((COUNT, len(lph)))
    L, P, H = lph.T
    out[0] = 1.0
    out[1], out[2], out[3] = L, P, H
    out[4], out[5], out[6] = L * P, L * H, P * H
    out[7], out[8], out[9] = L * L, P * P, H * H
    out[10] = out[4] * H
    out[11], out[12], out[13] = out[7] * L, L * out[8], L * out[9]
    out[14], out[15], out[16] = out[7] * P, out[8] * P, P * out[9]
    out[17], out[18], out[19] = out[7] * H, out[8] * H, out[9] * H
    return out


def _slopes(lph: FloatArray) -> FloatArray:
    """Derivatives (3, 20, N) of the cubic terms by L, P and H."""
    out = np.zeros((3, COUNT, len(lph)))
    L, P, H = lph.T
    by_l, by_p, by_h = out
    by_l[1], by_l[4], by_l[5], by_l[7], by_l[10] = 1.0, P, H, 2.0 * L, P * H
    by_l[11], by_l[12], by_l[13], by_l[14], by_l[17] = 3.0 * L * L, P * P, H * H, 2.0 * L * P, 2.0 * L * H
    by_p[2], by_p[4], by_p[6], by_p[8], by_p[10] = 1.0, L, H, 2.0 * P, L * H
    by_p[12], by_p[14], by_p[15], by_p[16], by_p[18] = 2.0 * L * P, L * L, 3.0 * P * P, H * H, 2.0 * P * H
    by_h[3], by_h[5], by_h[6], by_h[9], by_h[10] = 1.0, L, P, 2.0 * H, L * P
    by_h[13], by_h[16], by_h[17], by_h[18], by_h[19] = 2.0 * L * H, 2.0 * P * H, L * L, P * P, 3.0 * H * H
    return out


def evaluate(coefficients: FloatArray, lph: FloatArray) -> FloatArray:
    """Values of cubic polynomials.

    Parameters
    ----------
    coefficients : array (K, 20)
        Of K polynomials, in the order of RPC00B.
    lph : array (N, 3)
        Normalised longitude, latitude, height.

    Returns
    -------
    array (K, N)
    """
    out = np.empty((len(coefficients), len(lph)))
    _cubic_polynomials(coefficients, lph, out)
    return out


def combine(coefficients: FloatArray, each: FloatArray) -> FloatArray:
    """Sums of coefficients times terms, in the order of the terms.

    Parameters
    ----------
    coefficients : array (K, 20)
    each : array (20, N)
        Terms, or their derivatives.

    Returns
    -------
    array (K, N)
    """
    # Written out instead of a matrix product: BLAS may round a point differently from one array length to the next.
    out = np.zeros((len(coefficients), each.shape[1]))
    for k in range(COUNT):
        out += coefficients[:, k, None] * each[k]
    return out


# Cubics bend back far outside the ground they were fitted to, and would put distant ground into the image. Longitude
# and latitude are normalised to about ±1 over the scene; heights may well exceed a scale made for flat land.
_FARTHEST = np.array([10.0, 10.0, 100.0])


@dataclass(frozen=True)
class Rpc:
    """Rational polynomial map from WGS 84 (longitude, latitude, ellipsoidal height) to the image.

    Attributes
    ----------
    image_offset, image_scale : array (2,)
        (col, row) in pixels. The offset counts from the outer corner of the upper-left pixel, as everywhere in
        geomosaic: readers have added what their format counts otherwise.
    ground_offset, ground_scale : array (3,)
        Longitude and latitude in degrees, height in metres.
    coefficients : array (4, 20)
        Numerator and denominator for columns, numerator and denominator for rows, in the order of RPC00B.
    errors : tuple of float, optional
        Accuracy as the producer states it, root mean square: bias and random error per point, metres.
    """

    image_offset: FloatArray
    image_scale: FloatArray
    ground_offset: FloatArray
    ground_scale: FloatArray
    coefficients: FloatArray
    errors: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        shapes = {
            "image_offset": (2,), "image_scale": (2,), "ground_offset": (3,), "ground_scale": (3,),
            "coefficients": (4, COUNT),
        }  # fmt: skip
        for name, shape in shapes.items():
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.shape != shape:
                raise ValueError(f"{name} has shape {array.shape}, not {shape}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def normalised(self, lonlath: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Normalised ground and its validity.

        Parameters
        ----------
        lonlath : array (N, 3)
            Longitude, latitude in degrees, ellipsoidal height in metres.

        Returns
        -------
        lph : array (N, 3)
            Normalised longitude, latitude, height; 0 where not valid.
        inside : bool array (N,)
            Whether a point lies where the polynomials are valid.
        """
        offset = np.asarray(lonlath, dtype=np.float64) - self.ground_offset
        lon = offset[:, 0]
        with np.errstate(invalid="ignore"):
            # A scene at the date line: 179.9 and -179.9 are 0.2 degrees apart. Elsewhere nothing is rounded.
            beyond = np.abs(lon) > 180.0
            if beyond.any():
                offset[:, 0] = np.where(beyond, np.mod(lon + 180.0, 360.0) - 180.0, lon)
            lph = offset / self.ground_scale
            near = np.abs(lph) <= _FARTHEST
        # `all` over an axis of three takes several times as long.
        inside: BoolArray = near[:, 0] & near[:, 1] & near[:, 2]
        return (lph if inside.all() else np.where(inside[:, None], lph, 0.0)), inside

    def image(self, lonlath: FloatArray) -> FloatArray:
        """Ground (N, 3) to image (N, 2) in pixels; NaN far outside the scene and where a denominator passes zero."""
        lph, inside = self.normalised(lonlath)
        image, good = self._divided(evaluate(self.coefficients, lph))
        image[~(inside & good)] = np.nan
        return image

    def jacobian(self, lonlath: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) and its derivatives by ground (N, 2, 3), in pixels per degree and per metre."""
        lph, inside = self.normalised(lonlath)
        values = combine(self.coefficients, terms(lph))
        image, good = self._divided(values)
        by_ground = np.empty((len(lph), 2, 3))
        for axis, each in enumerate(_slopes(lph)):
            change = combine(self.coefficients, each)
            for k in range(2):
                top, bottom = values[2 * k], values[2 * k + 1]
                with np.errstate(divide="ignore", invalid="ignore"):
                    # Divided twice by the denominator instead of once by its square, which may overflow.
                    quotient = (change[2 * k] - change[2 * k + 1] * (top / bottom)) / bottom
                by_ground[:, k, axis] = quotient * (self.image_scale[k] / self.ground_scale[axis])
        bad = ~(inside & good)
        image[bad], by_ground[bad] = np.nan, np.nan
        return image, by_ground

    def _divided(self, values: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Image (N, 2) of polynomial values (4, N), and where both denominators have the sign of the scene's middle."""
        bottom = values[1::2]
        # The constant term is the denominator's value at the middle of the scene. Past a zero the quotient is finite
        # again, but of another branch of the map, which the image does not show.
        good: BoolArray = np.all(bottom * np.sign(self.coefficients[1::2, :1]) > 0.0, axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = values[0::2] / bottom
        return np.ascontiguousarray((ratio * self.image_scale[:, None] + self.image_offset[:, None]).T), good

    def moved(self, cols: float, rows: float) -> Self:
        """RPC of the same map with image coordinates larger by a shift in pixels."""
        return replace(self, image_offset=self.image_offset + np.array([cols, rows]))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        names = ("image_offset", "image_scale", "ground_offset", "ground_scale", "coefficients")
        state: dict[str, Any] = {name: getattr(self, name).tolist() for name in names}
        return {**state, "errors": None if self.errors is None else list(self.errors)}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        arrays = {name: np.array(value) for name, value in state.items() if name != "errors"}
        errors = state["errors"]
        return cls(**arrays, errors=None if errors is None else (errors[0], errors[1]))
