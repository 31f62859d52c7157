"""Uncertainty of the inputs of monoplotting: image measurement, orientation, DEM."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.block.block import ControlPoint
from geomosaic.errors import InputError, SolveError, did_you_mean
from geomosaic.geo.transform import Transform
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.solve import resect
from geomosaic.types import BoolArray, FloatArray

_REJECTION = 3.5
_ROUNDS = 10


@dataclass(frozen=True)
class InputUncertainty:
    """Standard deviations and covariance of the inputs of monoplotting.

    Attributes
    ----------
    pixel : float or None
        Standard deviation of a measured image coordinate, pixels; None if unknown.
    height : float or None
        Standard deviation of the heights of the surface, metres.
    orientation : array (P, P) or None
        Covariance of the sensor's parameters in their units.
    notes : tuple of str
        Source of the orientation's covariance, or why there is none.
    """

    pixel: float | None = None
    height: float | None = None
    orientation: FloatArray | None = None
    notes: tuple[str, ...] = ()

    @property
    def known(self) -> tuple[str, ...]:
        """Names of the inputs that contribute to the error ellipse."""
        parts = {"measurement": self.pixel, "orientation": self.orientation, "surface": self.height}
        return tuple(name for name, value in parts.items() if value is not None)


def orientation(
    model: SensorModel,
    given: Mapping[str, float],
    control: Sequence[ControlPoint] = (),
    crs: CRS | None = None,
) -> tuple[SensorModel, FloatArray | None, str]:
    """Covariance of a sensor's parameters, and its source.

    The first available of: standard deviations given by the user; the adjustment of the model to its control
    points; standard deviations the sensor comes with.

    Parameters
    ----------
    model : SensorModel
    given : mapping of str to float
        Standard deviations by parameter, in its unit.
    control : sequence of ControlPoint
        Points measured in this image.
    crs : CRS, optional
        3-D CRS of the points.

    Returns
    -------
    model : SensorModel
        Adjusted to the control points, where there are any.
    covariance : array (P, P) or None
        None where the standard deviation of any parameter is unknown.
    note : str

    Raises
    ------
    InputError
        A standard deviation is given for a parameter the sensor does not have, or one is missing.
    SolveError
        The control points do not determine the parameters.
    """
    parameters = model.parameters
    for name in given:
        if name not in parameters.names:
            hint = did_you_mean(name, parameters.names)
            raise InputError(
                f"the sensor has no parameter '{name}'",
                where="`sigmas`",
                hint=f"{hint} it has {', '.join(parameters.names) or 'none'}".strip(),
            )
    if control and given:
        raise InputError(
            "control points and standard deviations of the orientation are both given",
            where="`sigmas`",
            hint="leave one of them out: control points tell how well the orientation is known",
        )
    if control and (parameters.sigmas > 0.0).any():
        if crs is None:
            raise InputError("the control points have no CRS", hint="name it with `crs`")
        return _adjusted(model, control, crs)
    sigmas = np.array([given.get(n, s) for n, s in zip(parameters.names, parameters.sigmas.tolist(), strict=True)])
    free = [name for name, sigma in zip(parameters.names, sigmas.tolist(), strict=True) if not np.isfinite(sigma)]
    if free and given:
        raise InputError(
            f"nothing says how well {', '.join(free)} {'is' if len(free) == 1 else 'are'} known",
            where="`sigmas`",
            hint=f"give `sigmas`: {free[0]}=..., 0 where it is exact",
        )
    if free:
        return (
            model,
            None,
            f"the orientation takes no part in the error: nothing says how well {', '.join(free)} are known",
        )
    source = "standard deviations as given" if given else "a-priori standard deviations of the sensor"
    return model, np.diag(sigmas**2), f"orientation: {source}"


def _adjusted(model: SensorModel, control: Sequence[ControlPoint], crs: CRS) -> tuple[SensorModel, FloatArray, str]:
    """Model adjusted to control points, its covariance and a note; outliers are left out."""
    ground = Transform(crs, model.crs)(np.array([point.xyz for point in control], dtype=np.float64))
    image = np.array([point.colrow for point in control], dtype=np.float64)
    sigmas = np.array([point.sigma_px for point in control])
    used, solved = _inliers(model, ground, image, sigmas), None
    for _ in range(_ROUNDS):
        solved = resect(model, ground[used], image[used], sigmas[used])
        again = _inliers(solved.model, ground, image, sigmas)
        if (again == used).all():
            break
        used = again
    assert solved is not None
    # Residuals larger than the sigmas allow enlarge the covariance; smaller ones may be chance, and do not reduce it.
    scale = max(1.0, solved.sigma0) if np.isfinite(solved.sigma0) else 1.0
    count = int(np.isfinite(solved.residuals).all(axis=1).sum())
    left = f", {len(control) - count} left out" if count < len(control) else ""
    note = f"orientation: adjusted to {count} control points{left}, sigma0 {solved.sigma0:.2f}"
    return solved.model, solved.covariance * scale**2, note


def _inliers(model: SensorModel, ground: FloatArray, image: FloatArray, sigmas: FloatArray) -> BoolArray:
    """Inliers: residuals within 3.5 times the robust scatter (1.4826 median), or within 3.5 sigmas."""
    lengths = np.hypot(*(image - model.ground_to_image(ground)).T) / sigmas
    if not np.isfinite(lengths).any():
        raise SolveError(
            "the image shows none of the control points", hint="check their CRS, and the order of their coordinates"
        )
    scatter = 1.4826 * float(np.nanmedian(lengths))
    good: BoolArray = lengths <= _REJECTION * max(scatter, 1.0)
    return good
