"""Error propagation from the image, its orientation and the heights to places on the ground.

A line of sight f(X, p) = l meets a surface z = h(x, y) + e. Small changes keep both equations,

    A·(dx, dy) = dl − Jp·dp − Jz·e,   A = Jxy + Jz·∇h,   dz = ∇h·(dx, dy) + e,

with J the derivatives of the image by ground and parameters, so the covariance of (x, y, z) follows from those of the
measurement l, of the parameters p and of the surface e by propagation (Kraus, Photogrammetry, appendix on error
propagation). On level ground (dx, dy) = u + t·e, where u = Jxy⁻¹·(dl − Jp·dp) is smooth over an image, and
t = −Jxy⁻¹·Jz is the tangent of the view angle, towards the sensor: the textbooks' r / c of a vertical photo.
A slope g = ∇h lengthens both by one matrix, S = I + t·gᵀ / (1 − g·t), as A = Jxy·(I − t·gᵀ) (Sherman and Morrison).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import has_heights, horizontal
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import metres_per_unit
from geomosaic.sensor.plugin import HasInterior, SensorModel
from geomosaic.sensor.solve import jacobian
from geomosaic.sensor.solve.newton import pixel_step
from geomosaic.surface.model import Surface
from geomosaic.types import FloatArray


@dataclass(frozen=True)
class InputUncertainty:
    """Standard deviations and covariance of what places on the ground depend on.

    Attributes
    ----------
    pixel : float or None
        Standard deviation of an image coordinate, pixels; None if unknown.
    height : float, Surface or None
        Standard deviation of the heights of the ground, metres: one, or another one at each place.
    orientation : array (P, P) or (P + Q, P + Q), or None
        Covariance of the sensor's parameters in their units, after which may come those of its interior orientation.
    notes : tuple of str
        Source of the orientation's covariance, or why there is none.
    """

    pixel: float | None = None
    height: float | Surface | None = None
    orientation: FloatArray | None = None
    notes: tuple[str, ...] = ()

    @property
    def known(self) -> tuple[str, ...]:
        """Names of the inputs that contribute to errors on the ground."""
        parts = {"measurement": self.pixel, "orientation": self.orientation, "surface": self.height}
        return tuple(name for name, value in parts.items() if value is not None)


@dataclass(frozen=True, eq=False)
class LevelErrors:
    """Errors of N places as they would be on level ground.

    Attributes
    ----------
    root : array (N, 2, K)
        Metres along the map's x and y per unit of K independent errors: the covariance is root · rootᵀ.
    tangent : array (N, 2)
        Tangent of the view angle by axis: metres that a place moves on the map where the height is a metre too large.
    sampling : array (N,)
        Side in metres of a square as large as an image pixel on the map.
    """

    root: FloatArray
    tangent: FloatArray
    sampling: FloatArray

    @classmethod
    def at(
        cls,
        model: SensorModel,
        to_model: Callable[[FloatArray], FloatArray],
        places: FloatArray,
        metres: FloatArray,
        uncertainty: InputUncertainty,
    ) -> LevelErrors:
        """Errors at places, without those of heights.

        Parameters
        ----------
        model : SensorModel
        to_model : callable
            Map places and heights (N, 3) to ground points (N, 3) of the model.
        places : array (N, 3)
            At least one.
        metres : array (N, 3)
            Metres in a unit of each coordinate.
        uncertainty : InputUncertainty
            `pixel` and `orientation` count; unknown ones contribute nothing.
        """

        def image(points: FloatArray) -> FloatArray:
            return model.ground_to_image(to_model(points))

        steps = _difference_steps(image, places, metres)
        by_ground = np.stack([_slope(image, places, axis, steps[axis]) / metres[:, axis, None] for axis in range(3)], 2)
        if not has_heights(model.crs):
            by_ground[:, :, 2] = 0.0
        to_map = _inverse(by_ground[:, :, :2])
        parts = [np.zeros((len(places), 2, 0))]
        if uncertainty.pixel is not None:
            parts.append(uncertainty.pixel * to_map)
        if uncertainty.orientation is not None:
            ground = to_model(places)
            by_parameters = jacobian(model, ground)[0]
            # A covariance of more than the parameters goes on with the interior orientation.
            if len(uncertainty.orientation) > by_parameters.shape[2] and isinstance(model, HasInterior):
                by_parameters = np.concatenate([by_parameters, model.interior_jacobian(ground)], axis=2)
            parts.append(to_map @ by_parameters @ _root(uncertainty.orientation))
        sampling = np.sqrt(np.abs(np.linalg.det(to_map)))
        return cls(np.concatenate(parts, axis=2), -(to_map @ by_ground[:, :, 2:])[:, :, 0], sampling)

    @property
    def covariance(self) -> FloatArray:
        """Covariance (N, 2, 2) on level ground, square metres."""
        return self.root @ self.root.transpose(0, 2, 1)


def _difference_steps(image: Callable[[FloatArray], FloatArray], places: FloatArray, metres: FloatArray) -> FloatArray:
    """Steps (3,) along the axes of the ground that move the image by about a pixel."""
    first = places[np.isfinite(image(places)).all(axis=1)][:1]
    first = first if len(first) else places[:1]
    step = pixel_step(
        lambda xy: image(np.column_stack([xy, np.full(len(xy), first[0, 2])])), first[0, :2], 1.0 / metres[0, 1]
    )
    return step * np.array([1.0, 1.0, float(metres[0, 0] / metres[0, 2])])


def _on_slope(slope: FloatArray, tangent: FloatArray) -> FloatArray:
    """Matrices (N, 2, 2) that bring errors on level ground to a slope (N, 2), by the tangent of `LevelErrors`."""
    with np.errstate(divide="ignore", invalid="ignore"):
        facing = 1.0 - (slope * tangent).sum(axis=1)
        lengthened: FloatArray = np.eye(2) + tangent[:, :, None] * slope[:, None, :] / facing[:, None, None]
    return lengthened


def _inverse(matrices: FloatArray) -> FloatArray:
    """Inverse of (N, 2, 2); not finite where there is none."""
    (a, b), (c, d) = matrices[:, 0].T, matrices[:, 1].T
    adjugate = np.stack([d, -b, -c, a], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse: FloatArray = (adjugate / (a * d - b * c)[:, None]).reshape(-1, 2, 2)
    return inverse


def _root(covariance: FloatArray) -> FloatArray:
    """Root R with R·Rᵀ = covariance, singular ones included: held parameters have none of their own."""
    scale = np.sqrt(np.diag(covariance))
    scale = np.where(scale > 0.0, scale, 1.0)
    # Parameters of metres and of radians differ by many powers of ten: roots are taken of correlations.
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    root: FloatArray = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return root


@dataclass(frozen=True)
class Ellipses:
    """Covariances of N places on the ground; figures are one standard deviation.

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
    transform = Transform(crs, model.crs) if has_heights(model.crs) else Transform(horizontal(crs), model.crs)

    def to_model(points: FloatArray) -> FloatArray:
        if has_heights(transform.source):
            return transform(points)
        return np.column_stack([transform(points[:, :2]), np.zeros(len(points))])

    good = np.isfinite(ground).all(axis=1)
    covariance = np.full((len(ground), 3, 3), np.nan)
    if not good.any():
        return Ellipses(covariance)
    places = ground[good]
    metres = metres_per_unit(crs, ground)[good]
    level = LevelErrors.at(model, to_model, places, metres, uncertainty)
    slope = np.zeros((len(places), 2))
    if surface is not None:
        steps = _difference_steps(lambda points: model.ground_to_image(to_model(points)), places, metres)
        slope = _hillside(surface, crs, places, steps) / metres[:, :2] * metres[:, 2:]
    lengthened = _on_slope(slope, level.tangent)
    to_space = np.concatenate([lengthened, slope[:, None, :] @ lengthened], axis=1)  # (N, 3, 2)
    root = to_space @ level.root
    total = root @ root.transpose(0, 2, 1)
    if uncertainty.height is not None and surface is not None:
        lifted = to_space @ level.tangent[:, :, None]
        lifted[:, 2, 0] += 1.0
        total += _height_variance(uncertainty.height, crs, places)[:, None, None] * lifted @ lifted.transpose(0, 2, 1)
    covariance[good] = total
    return Ellipses(covariance)


def _height_variance(height: float | Surface, crs: CRS, places: FloatArray) -> FloatArray:
    """Variance (N,) of the heights at places."""
    if isinstance(height, float | int):
        return np.full(len(places), float(height) ** 2)
    return np.asarray(height.height(Transform(horizontal(crs), horizontal(height.crs))(places[:, :2])) ** 2)


def _slope(image: Callable[[FloatArray], FloatArray], points: FloatArray, axis: int, step: float) -> FloatArray:
    """Change (N, 2) of the image per unit of one ground axis, by a central difference."""
    high, low = points.copy(), points.copy()
    high[:, axis] += 0.5 * step
    low[:, axis] -= 0.5 * step
    return (image(high) - image(low)) / (high[:, axis] - low[:, axis])[:, None]


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
