"""The inside of a film camera: a lens in millimetres, and the scan that brought the film to pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from geomosaic.types import FloatArray
from geomosaic_frame.filmlens import FilmLens
from geomosaic_frame.interior import apply


@dataclass(frozen=True)
class FilmCamera:
    """A film camera seen through a scan.

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
        """Rebuild a camera from `to_dict`."""
        (w, h), (x, y) = state["size"], state["autocollimation"]
        return cls((int(w), int(h)), FilmLens.from_dict(state["lens"]), (x, y), np.array(state["film"]))
