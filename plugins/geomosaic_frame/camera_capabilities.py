"""Interface of camera models: interior orientation and lens, whether in pixels or in millimetres of a film."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from geomosaic.types import FloatArray
from geomosaic_frame.camera import Camera


class CameraModel(Protocol):
    """Camera model: camera axes (x right, y down, z forward) to pixels and back."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    @property
    def focal(self) -> tuple[float, float]:
        """Camera constant in pixels, along columns and rows."""

    def project(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Camera axes (N,) each to pixels (N, 2); NaN where the lens cannot see."""

    def derivatives(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by camera axes, (N, 2, 3)."""

    def directions(self, colrow: FloatArray) -> FloatArray:
        """Pixels (N, 2) to unit directions in camera axes (N, 3)."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""


def camera_model_from_dict(state: Mapping[str, Any]) -> CameraModel:
    """Camera model of a saved state.

    Parameters
    ----------
    state : mapping
        As `to_dict` of the camera gives it.

    Returns
    -------
    CameraModel
        `FilmCamera` or `Camera`.
    """
    if "film" in state:
        from geomosaic_frame.film import FilmCamera

        return FilmCamera.from_dict(state)
    return Camera.from_dict(state)
