"""Image errors on the map: the local derivative of ground → image, turned round."""

from __future__ import annotations

import numpy as np

from geomosaic.geo.crs import geographic
from geomosaic.geo.local import enu_axes
from geomosaic.geo.transform import Transform
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.solve.derivatives import jacobian
from geomosaic.types import FloatArray


def image_by_map(model: SensorModel, xyz: FloatArray) -> FloatArray:
    """Derivatives (N, 2, 2) of (col, row) by x and y of the CRS, or by metres east and north where it is geocentric."""
    by_ground = jacobian(model, xyz)[1]
    if not model.crs.is_geocentric:
        flat: FloatArray = by_ground[:, :, :2]
        return flat
    places = Transform(model.crs, geographic(model.crs))(xyz)
    axes = np.array([enu_axes(longitude, latitude)[:2] for longitude, latitude, _ in places])
    level: FloatArray = np.einsum("nij,nkj->nik", by_ground, axes.reshape(-1, 2, 3))
    return level


def map_by_image(model: SensorModel, xyz: FloatArray) -> FloatArray:
    """Derivatives (N, 2, 2) of x and y by (col, row); NaN where the image is folded."""
    matrices = image_by_map(model, xyz)
    (a, b), (c, d) = matrices[:, 0].T, matrices[:, 1].T
    determinant = a * d - b * c
    size = np.abs(matrices).max(axis=(1, 2))
    good = np.abs(determinant) > 1e-12 * size**2
    determinant = np.where(good, determinant, np.nan)
    inverse: FloatArray = np.stack([np.stack([d, -b], axis=1), np.stack([-c, a], axis=1)], axis=1)
    inverse /= determinant[:, None, None]
    return inverse


def is_mirrored(model: SensorModel, xyz: FloatArray) -> bool:
    """Say whether ground and image (rows downwards) run the same way round: the image axes are right-handed then."""
    return bool(np.nanmedian(np.sign(np.linalg.det(image_by_map(model, xyz)))) > 0.0)
