"""Film camera: a lens in millimetres about the principal point of symmetry, and the scan of its film.

With x, y the measured image coordinates from the principal point of autocollimation, y up, and (dx, dy) the same from
the principal point of symmetry at (sx, sy), r = |(dx, dy)|, the ideal image is at (manuals of calibration
laboratories; Manual of Photogrammetry, ch. 4)

    x + dx·g(r)/r + p1·(r² + 2·dx²) + 2·p2·dx·dy
    y + dy·g(r)/r + 2·p1·dx·dy + p2·(r² + 2·dy²)

and the ray goes to (x, y, −c) of the ideal image.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from geomosaic.types import BoolArray, FloatArray
from geomosaic_frame.distortion import Columns, Perspective
from geomosaic_frame.interior_orientation import apply
from geomosaic_frame.radial_tables import Radial, radial_from_dict

ROUNDS = 30


@dataclass(frozen=True)
class FilmLens(Perspective):
    """Lens of a film camera, whose corrections apply to the measured image: ideal = formula(measured).

    Attributes
    ----------
    constant : float
        Camera constant in mm.
    radial : Radial
        g(r), mm.
    symmetry : tuple of float
        Principal point of symmetry from that of autocollimation, mm, x right, y up.
    tangential : tuple of float
        p1, p2 in mm⁻¹.
    """

    constant: float
    radial: Radial
    symmetry: tuple[float, float] = (0.0, 0.0)
    tangential: tuple[float, float] = (0.0, 0.0)

    def _ideal(self, u: FloatArray, v: FloatArray) -> tuple[Columns, tuple[FloatArray, ...]]:
        """Ideal (x, y) and the four derivatives by the measured (u, v), in focal lengths, y down."""
        c = self.constant
        dx, dy = u * c - self.symmetry[0], -v * c - self.symmetry[1]
        r = np.hypot(dx, dy)
        g, slope = self.radial.correction(r)
        safe = np.where(r > 0.0, r, 1.0)
        ratio = np.where(r > 0.0, g / safe, slope)
        # d(g/r)/dr / r, which vanishes in the centre.
        # g/r tends to g'(0) at the centre, where the quotient would be 0/0.
        bend = np.where(r > 0.0, (slope - ratio) / safe**2, 0.0)
        p1, p2 = self.tangential
        # Beyond the end of g, terms of degree two go on linearly along the ray: times end·(2r − end)/r².
        end = self.radial.end
        fade, fading = np.ones_like(r), np.zeros_like(r)
        if (p1 or p2) and np.isfinite(end):
            far = r > end
            fade[far] = end * (2.0 * r[far] - end) / r[far] ** 2
            fading[far] = 2.0 * end * (end - r[far]) / r[far] ** 4  # d fade/dr / r
        tx = p1 * (r**2 + 2.0 * dx**2) + 2.0 * p2 * dx * dy
        ty = 2.0 * p1 * dx * dy + p2 * (r**2 + 2.0 * dy**2)
        x, y = u * c + dx * ratio + fade * tx, -v * c + dy * ratio + fade * ty
        xx = 1.0 + ratio + dx * dx * bend + fade * (6.0 * p1 * dx + 2.0 * p2 * dy) + fading * tx * dx
        xy = dx * dy * bend + fade * (2.0 * p1 * dy + 2.0 * p2 * dx) + fading * tx * dy
        yx = dx * dy * bend + fade * (2.0 * p1 * dy + 2.0 * p2 * dx) + fading * ty * dx
        yy = 1.0 + ratio + dy * dy * bend + fade * (2.0 * p1 * dx + 6.0 * p2 * dy) + fading * ty * dy
        return (x / c, -y / c), (xx, -xy, -yx, yy)

    def _undistort(self, u: FloatArray, v: FloatArray) -> Columns:
        return self._ideal(u, v)[0]

    def _distort(self, x: FloatArray, y: FloatArray) -> Columns:
        """Measured from ideal image by Newton's method, to rounding; NaN where it does not converge."""
        u, v = x.copy(), y.copy()
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(ROUNDS):
                (a, b), (xx, xy, yx, yy) = self._ideal(u, v)
                a, b = x - a, y - b
                det = xx * yy - xy * yx
                du, dv = (yy * a - xy * b) / det, (xx * b - yx * a) / det
                u, v = u + du, v + dv
                step = np.maximum(np.abs(du), np.abs(dv)) / (1.0 + np.maximum(np.abs(u), np.abs(v)))
                if not (step > 2e-15).any():
                    break
            a, b = self._ideal(u, v)[0]
            lost = ~(np.maximum(np.abs(a - x), np.abs(b - y)) <= 1e-12 * (1.0 + np.maximum(np.abs(x), np.abs(y))))
        return np.where(lost, np.nan, u), np.where(lost, np.nan, v)

    def _slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Derivatives of the measured by the ideal image: the inverse of those of the corrections."""
        xx, xy, yx, yy = self._ideal(*self._distort(x, y))[1]
        det = xx * yy - xy * yx
        return yy / det, -xy / det, -yx / det, xx / det

    def trusted(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether the corrections are used there as given, not their continuation (N,)."""
        c = self.constant
        return np.hypot(u * c - self.symmetry[0], -v * c - self.symmetry[1]) <= self.radial.end

    def for_corners(self, u: FloatArray, v: FloatArray) -> Self:
        """The lens itself: its limit does not depend on the image."""
        return self

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "model": "film",
            "constant": self.constant,
            "radial": self.radial.to_dict(),
            "symmetry": list(self.symmetry),
            "tangential": list(self.tangential),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        (sx, sy), (p1, p2) = state["symmetry"], state["tangential"]
        return cls(float(state["constant"]), radial_from_dict(state["radial"]), (sx, sy), (p1, p2))


@dataclass(frozen=True)
class FilmCamera:
    """Film camera with the scan of its film.

    Camera axes → lens → millimetres in the axes of the fiducials → pixels.

    Attributes
    ----------
    size : tuple of int
        Width and height of the scan in pixels.
    lens : FilmLens
        With the camera constant.
    autocollimation : tuple of float
        Principal point of autocollimation in the axes of the fiducials, mm, x right, y up.
    to_film : array (3, 3)
        Homogeneous pixels → mm of the fiducial axes.
    """

    size: tuple[int, int]
    lens: FilmLens
    autocollimation: tuple[float, float]
    to_film: FloatArray
    _to_scan: FloatArray = field(init=False, repr=False, compare=False)
    _from_scan: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        # (u, v) of the lens, in focal lengths and y down, to mm to pixels.
        c, (x, y) = self.lens.constant, self.autocollimation
        matrix = np.linalg.inv(self.to_film) @ np.array([[c, 0.0, x], [0.0, -c, y], [0.0, 0.0, 1.0]])
        object.__setattr__(self, "_to_scan", matrix / matrix[2, 2])
        object.__setattr__(self, "_from_scan", np.linalg.inv(matrix))

    @property
    def focal(self) -> tuple[float, float]:
        """Camera constant in pixels, along columns and rows, at the principal point."""
        (a, b, c), (d, e, f), (g, h, _) = self._to_scan
        # The homography is not square pixels exactly: lengths of the pixel's sides seen in focal lengths.
        slopes = np.array([[a - c * g, b - c * h], [d - f * g, e - f * h]])
        across, down = 1.0 / np.linalg.norm(np.linalg.inv(slopes), axis=0)
        return float(across), float(down)

    def project(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Camera axes (N,) each to pixels (N, 2); NaN where the lens cannot see."""
        return apply(self._to_scan, np.column_stack(self.lens.project(x, y, z)))

    def derivatives(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by camera axes, (N, 2, 3)."""
        uv = np.column_stack(self.lens.project(x, y, z))
        colrow, w = apply(self._to_scan, uv), uv @ self._to_scan[2, :2] + self._to_scan[2, 2]
        by_uv = (self._to_scan[None, :2, :2] - colrow[:, :, None] * self._to_scan[2, :2]) / w[:, None, None]
        out: FloatArray = by_uv @ self.lens.derivatives(x, y, z)
        return out

    def directions(self, colrow: FloatArray) -> FloatArray:
        """Pixels (N, 2) to unit directions in camera axes (N, 3)."""
        u, v = apply(self._from_scan, colrow).T
        direction = np.column_stack(self.lens.unproject(u.copy(), v.copy()))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        return direction

    def reach(self) -> float:
        """Largest distance of the scan's corners from the principal point of symmetry, in mm."""
        w, h = self.size
        corners = apply(self.to_film, np.array([[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]]))
        middle = np.add(self.autocollimation, self.lens.symmetry)
        return float(np.hypot(*(corners - middle).T).max())

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "film": self.to_film.tolist(),
            "size": list(self.size),
            "autocollimation": list(self.autocollimation),
            "lens": self.lens.to_dict(),
        }

    @classmethod
    def from_dict(cls, state: Mapping[str, Any]) -> FilmCamera:
        """Camera of a state, as `to_dict` gives it."""
        (w, h), (x, y) = state["size"], state["autocollimation"]
        return cls((int(w), int(h)), FilmLens.from_dict(state["lens"]), (x, y), np.array(state["film"]))
