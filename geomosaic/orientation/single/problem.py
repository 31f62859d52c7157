"""Single-image control problem: points, a fitting function, and image errors on the map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from geomosaic.errors import InputError, SolveError
from geomosaic.geo.crs import geographic
from geomosaic.geo.local_frames import enu_axes
from geomosaic.geo.transform import Transform
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.sensor.registry import build as build_model
from geomosaic.sensor.solve.newton import ground_jacobian
from geomosaic.types import AnyArray, FloatArray, IntArray


class Build(Protocol):
    """Function that fits a sensor model to some of the control points."""

    def __call__(self, selection: IntArray, sigma: FloatArray, /) -> SensorModel:
        """Model fitted to the points chosen.

        Parameters
        ----------
        selection : int array (K,)
            Indices of the points that take part.
        sigma : array (K,)
            Standard deviations of their image coordinates in pixels; a robust fit enlarges those of suspects.

        Raises
        ------
        SolveError
            The points do not determine the model.
        """


def registry_build(sensor: str, request: SensorRequest, ground: FloatArray, colrow: FloatArray) -> Build:
    """Fitting function of a sensor of the registry that takes the input 'points' (x, y, col, row, sigma).

    Parameters
    ----------
    sensor : str
        Name of the plugin.
    request : SensorRequest
        Image, size, CRS and the other options, such as kind and order.
    ground : array (N, 2) or (N, 3)
        Places in the CRS of the request.
    colrow : array (N, 2)
        Pixels.
    """
    points = [
        {"x": float(place[0]), "y": float(place[1]), "col": float(c), "row": float(r)}
        for place, (c, r) in zip(ground, colrow, strict=True)
    ]

    def build(selection: IntArray, sigma: FloatArray) -> SensorModel:
        chosen = [{**points[i], "sigma": float(s)} for i, s in zip(selection, sigma, strict=True)]
        return build_model(sensor, replace(request, options={**request.options, "points": chosen}))

    return build


@dataclass(frozen=True, eq=False)
class ControlProblem:
    """Control points of one image, with the function that fits a model to them.

    Attributes
    ----------
    build : Build
    ids : tuple of str
        Names of the points.
    xyz : array (N, 3)
        Places in the CRS of the models; z is 0 where only x and y were given.
    colrow : array (N, 2)
        Measured image coordinates, pixels.
    sigma : array (N,)
        Standard deviations of them, pixels; relative ones will do.
    """

    build: Build
    ids: tuple[str, ...]
    xyz: FloatArray
    colrow: FloatArray
    sigma: FloatArray

    @classmethod
    def of(
        cls,
        build: Build,
        ids: Sequence[str],
        ground: AnyArray,
        colrow: AnyArray,
        sigma: AnyArray | float | None = None,
    ) -> Self:
        """Problem with shapes and values checked.

        Parameters
        ----------
        build : Build
        ids : sequence of str
            Names of the points.
        ground : array (N, 2) or (N, 3)
            Places in the CRS of the model.
        colrow : array (N, 2)
            Measured pixels.
        sigma : float or array (N,), optional
            Standard deviations of the measurements, pixels; 1 when left out.

        Raises
        ------
        InputError
            No points, a coordinate that is not finite, or a sigma that is not positive; the point is named.
        """
        places, image = np.array(ground, dtype=np.float64), np.array(colrow, dtype=np.float64)
        count = len(ids)
        if places.ndim != 2 or places.shape[1] not in (2, 3) or image.shape != (len(places), 2) or len(places) != count:
            raise ValueError(f"{count} ids with shapes {places.shape} and {image.shape}, not (N, 2 or 3) and (N, 2)")
        if not count:
            raise InputError("there are no control points", hint="give some, or look whether all are disabled")
        xyz = np.zeros((count, 3))
        xyz[:, : places.shape[1]] = places
        given = np.asarray(1.0 if sigma is None else sigma, dtype=np.float64)
        spread = np.array(np.broadcast_to(given, (count,)))
        bad = ~(np.isfinite(xyz).all(axis=1) & np.isfinite(image).all(axis=1))
        if bad.any():
            raise InputError(
                f"point '{ids[int(np.argmax(bad))]}' has a coordinate that is not finite",
                hint="correct it, or leave the point out",
            )
        wrong = ~(np.isfinite(spread) & (spread > 0.0))
        if wrong.any():
            raise InputError(
                f"point '{ids[int(np.argmax(wrong))]}' has a sigma that is not a positive number of pixels",
                hint="give pixels above 0, such as 1",
            )
        return cls(build, tuple(map(str, ids)), xyz, image, spread)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def magnitude(self) -> float:
        """Largest absolute image coordinate, pixels."""
        return float(np.abs(self.colrow).max())

    def model(self, selection: AnyArray | None = None, sigma: FloatArray | None = None) -> SensorModel:
        """Model fitted to the points of a bool (N,) or int (K,) selection; `sigma` (N,) replaces that of all points."""
        chosen = np.arange(len(self)) if selection is None else np.asarray(selection)
        if chosen.dtype == np.bool_:
            chosen = np.flatnonzero(chosen)
        spread = self.sigma if sigma is None else sigma
        return self.build(chosen.astype(np.int64), spread[chosen])

    def free_parameters(self, model: SensorModel) -> int:
        """Number of parameters that were estimated."""
        return int(np.count_nonzero(model.parameters.sigmas > 0.0))

    def errors(self, model: SensorModel) -> FloatArray:
        """Measured minus computed (col, row) (N, 2) in pixels; NaN where a model does not see a point."""
        return self.colrow - model.ground_to_image(self.xyz)

    def need_seen(self, errors: FloatArray) -> None:
        """Check that a fit sees its own points."""
        lost = ~np.isfinite(errors).all(axis=1)
        if lost.any():
            names = ", ".join(np.array(self.ids)[lost][:6])
            raise SolveError(
                f"the fit has no place in the image for its own control point{'s' * (lost.sum() > 1)} {names}",
                hint="look for swapped or wrong points, or choose a simpler kind",
            )


def image_by_map(model: SensorModel, xyz: FloatArray) -> FloatArray:
    """Derivatives (N, 2, 2) of (col, row) by x and y of the CRS, or by metres east and north where it is geocentric.

    Parameters
    ----------
    model : SensorModel
    xyz : array (N, 3)
        Places in the CRS of the model.
    """
    by_ground = ground_jacobian(model, xyz)
    if not model.crs.is_geocentric:
        return by_ground[:, :, :2]
    places = Transform(model.crs, geographic(model.crs))(xyz)
    axes = np.array([enu_axes(longitude, latitude)[:2] for longitude, latitude, _ in places])
    level: FloatArray = np.einsum("nij,nkj->nik", by_ground, axes.reshape(-1, 2, 3))
    return level


def map_by_image(model: SensorModel, xyz: FloatArray) -> FloatArray:
    """Derivatives (N, 2, 2) of x and y by (col, row); NaN where the image is folded.

    Parameters
    ----------
    model : SensorModel
    xyz : array (N, 3)
        Places in the CRS of the model.
    """
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
    """Whether ground and image (rows downwards) run the same way round: the image axes are right-handed then.

    Parameters
    ----------
    model : SensorModel
    xyz : array (N, 3)
        Places in the CRS of the model.
    """
    return bool(np.nanmedian(np.sign(np.linalg.det(image_by_map(model, xyz)))) > 0.0)
