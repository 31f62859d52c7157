"""Uncertainty of monoplotting: of its inputs, and the error ellipse and height error of a point found.

A line of sight f(X, p) = l meets a surface z = h(x, y) + e. Small changes keep both equations,

    A·(dx, dy) = dl − Jp·dp − Jz·e,   A = Jxy + Jz·∇h,   dz = ∇h·(dx, dy) + e,

with J the derivatives of the image by ground and parameters, so the covariance of (x, y, z) follows from those of the
measurement l, of the parameters p and of the surface e by propagation (Kraus, Photogrammetry, appendix on error
propagation). The semi-axes are the roots of the eigenvalues of its (x, y) part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint
from geomosaic.errors import InputError, did_you_mean
from geomosaic.geo.crs import has_heights, horizontal
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import metres_per_unit
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve import agreeing, jacobian, resect
from geomosaic.sensor.solve.newton import pixel_step
from geomosaic.surface.model import Surface
from geomosaic.types import FloatArray

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
    table: FloatArray | None = None,
) -> tuple[SensorModel, FloatArray | None, str]:
    """Covariance of a sensor's parameters, and its source.

    The first available of: standard deviations given by the user; the adjustment of the model to its control
    points; the orientation table; standard deviations the sensor comes with.

    Parameters
    ----------
    model : SensorModel
    given : mapping of str to float
        Standard deviations by parameter, in its unit.
    control : sequence of ControlPoint
        Points measured in this image.
    crs : CRS, optional
        3-D CRS of the points.
    table : array (P, P), optional
        Covariance of the parameters that the orientation table tells.

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
    if table is not None and not given:
        return model, table, "orientation: standard deviations and correlations of its table"
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
            f"the orientation takes no part in the error: nothing says how well {', '.join(free)} are known (`sigmas`, "
            "control points or the columns sigma_x ... of the orientation table would)",
        )
    source = "standard deviations as given" if given else "a-priori standard deviations of the sensor"
    return model, np.diag(sigmas**2), f"orientation: {source}"


def _adjusted(model: SensorModel, control: Sequence[ControlPoint], crs: CRS) -> tuple[SensorModel, FloatArray, str]:
    """Model adjusted to control points, its covariance and a note; outliers are left out."""
    ground = Transform(crs, model.crs)(np.array([point.xyz for point in control], dtype=np.float64))
    image = np.array([point.colrow for point in control], dtype=np.float64)
    sigmas = np.array([point.sigma_px for point in control])
    used, solved = agreeing(model, ground, image, sigmas), None
    for _ in range(_ROUNDS):
        solved = resect(model, ground[used], image[used], sigmas[used])
        again = agreeing(solved.model, ground, image, sigmas)
        if (again == used).all():
            break
        used = again
    assert solved is not None
    count = int(np.isfinite(solved.residuals).all(axis=1).sum())
    left = f", {len(control) - count} left out" if count < len(control) else ""
    note = f"orientation: adjusted to {count} control points{left}, sigma0 {solved.sigma0:.2f}"
    return solved.model, solved.pooled_covariance, note


@dataclass(frozen=True)
class Ellipses:
    """Covariances of N monoplotted points; figures are one standard deviation.

    Attributes
    ----------
    covariance : array (N, 3, 3)
        Covariance of x, y, z in square metres: along the map's axes, or east, north and up where the map is in degrees.
    """

    covariance: FloatArray

    @property
    def semi_axes(self) -> FloatArray:
        """Larger and smaller semi-axis (N, 2) on the map, metres."""
        a, b, c = self._plane
        middle, apart = 0.5 * (a + b), np.hypot(0.5 * (a - b), c)
        return np.sqrt(np.maximum(np.column_stack([middle + apart, middle - apart]), 0.0))

    @property
    def azimuth(self) -> FloatArray:
        """Direction (N,) of the larger semi-axis in degrees, clockwise from the map's north, 0 to 180."""
        a, b, c = self._plane
        return np.asarray(np.mod(np.degrees(0.5 * np.arctan2(2.0 * c, b - a)), 180.0))

    @property
    def sigma_z(self) -> FloatArray:
        """Standard deviation (N,) of the height, metres."""
        return np.asarray(np.sqrt(self.covariance[:, 2, 2]))

    @property
    def _plane(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.covariance[:, 0, 0], self.covariance[:, 1, 1], self.covariance[:, 0, 1]


def ellipses(
    model: SensorModel, surface: Surface | None, crs: CRS, ground: FloatArray, uncertainty: InputUncertainty
) -> Ellipses:
    """Error ellipses of points by propagation of the inputs' covariances.

    Parameters
    ----------
    model : SensorModel
    surface : Surface or None
        None where heights play no part.
    crs : CRS
        Of `ground`: 3-D, or 2-D where heights play no part.
    ground : array (N, 3)
        Points on the surface; rows that are NaN stay NaN.
    uncertainty : InputUncertainty
        Standard deviations of the inputs; unknown ones contribute nothing.
    """
    to_model = Transform(crs, model.crs) if has_heights(model.crs) else Transform(horizontal(crs), model.crs)
    metres = metres_per_unit(crs, ground)

    def image(points: FloatArray) -> FloatArray:
        return model.ground_to_image(_through(to_model, points))

    good = np.isfinite(ground).all(axis=1)
    covariance = np.full((len(ground), 3, 3), np.nan)
    if not good.any():
        return Ellipses(covariance)
    places, unit = ground[good], metres[good]
    step = pixel_step(lambda xy: image(_raised(xy, places[0, 2])), places[0, :2], 1.0 if crs.is_projected else 1e-5)
    steps = step * np.array([1.0, 1.0, float(unit[0, 0] / unit[0, 2])])
    by_ground = np.stack([_slope(image, places, axis, steps[axis]) / unit[:, axis, None] for axis in range(3)], axis=2)
    if not has_heights(model.crs):
        by_ground[:, :, 2] = 0.0
    hill = np.zeros((len(places), 2)) if surface is None else _hillside(surface, crs, places, steps) / unit[:, :2]
    hill = hill * (1.0 if surface is None else unit[:, 2:])
    across = by_ground[:, :, :2] + by_ground[:, :, 2:] * hill[:, None, :]
    determinant = across[:, 0, 0] * across[:, 1, 1] - across[:, 0, 1] * across[:, 1, 0]
    adjugate = np.stack([across[:, 1, 1], -across[:, 0, 1], -across[:, 1, 0], across[:, 0, 0]], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = (adjugate / determinant[:, None]).reshape(-1, 2, 2)
    to_space = np.concatenate([inverse, hill[:, None, :] @ inverse], axis=1)  # (N, 3, 2): pixels to metres
    total = np.zeros((len(places), 3, 3))
    if uncertainty.pixel is not None:
        total += uncertainty.pixel**2 * to_space @ to_space.transpose(0, 2, 1)
    if uncertainty.orientation is not None:
        by_parameters = to_space @ jacobian(model, _through(to_model, places))[0]
        total += by_parameters @ uncertainty.orientation @ by_parameters.transpose(0, 2, 1)
    if uncertainty.height is not None and surface is not None:
        lifted = -to_space @ by_ground[:, :, 2:]
        lifted[:, 2, 0] += 1.0
        total += uncertainty.height**2 * lifted @ lifted.transpose(0, 2, 1)
    covariance[good] = total
    return Ellipses(covariance)


def _through(transform: Transform, points: FloatArray) -> FloatArray:
    """Transform (N, 3), or only x and y of it where the CRS have no heights."""
    if has_heights(transform.source):
        return transform(points)
    return np.column_stack([transform(points[:, :2]), np.zeros(len(points))])


def _raised(xy: FloatArray, z: float) -> FloatArray:
    return np.column_stack([xy, np.full(len(xy), z)])


def _slope(image: Callable[[FloatArray], FloatArray], points: FloatArray, axis: int, step: float) -> FloatArray:
    """Change (N, 2) of the image per unit of one ground axis, by a central difference."""
    high, low = points.copy(), points.copy()
    high[:, axis] += 0.5 * step
    low[:, axis] -= 0.5 * step
    change: FloatArray = (image(high) - image(low)) / (high[:, axis] - low[:, axis])[:, None]
    return change


def _hillside(surface: Surface, crs: CRS, points: FloatArray, steps: FloatArray) -> FloatArray:
    """Slope (N, 2) of the surface: units of height per unit of x and of y, over about a pixel or half a node."""
    flat = Transform(horizontal(crs), horizontal(surface.crs))
    up = Transform(surface.crs, crs)
    low, high = surface.range
    if low == high:
        return np.zeros((len(points), 2))

    def height(xy: FloatArray) -> FloatArray:
        place = flat(xy)
        return up(np.column_stack([place, surface.height(place)]))[:, 2]

    slopes = np.zeros((len(points), 2))
    here = height(points[:, :2])
    for axis in range(2):
        shift = np.zeros(2)
        shift[axis] = 0.5 * steps[axis]
        above, below = height(points[:, :2] + shift), height(points[:, :2] - shift)
        # Beside unknown heights the side that is known tells.
        above, below = (
            np.where(np.isfinite(above), above, 2.0 * here - below),
            np.where(np.isfinite(below), below, 2.0 * here - above),
        )
        slopes[:, axis] = (above - below) / steps[axis]
    return slopes
