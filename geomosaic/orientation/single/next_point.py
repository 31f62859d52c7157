"""Next control point: where in an image one more point would improve the mapped positions most, before it is measured.

The measure is the trace of the covariance of positions on the map, in the mean over the image (A-optimality, see
`estimation.optimal_design`). With nothing measured yet the greedy order of given points is an order of optimum
distribution, as the orientation program of Müller and Sauleda (Orthophoto Production in the new ContextMAPPER System,
ISPRS Kyoto 1988, section 4.1) sorts control points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError, SolveError
from geomosaic.estimation.equations import Equations
from geomosaic.estimation.optimal_design import Order, greedy_order, mean_weight, updated_covariance, variance_decreases
from geomosaic.geo.crs import has_heights
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import metres_per_unit
from geomosaic.orientation.single.problem import map_by_image
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve import image_to_ground, image_to_height
from geomosaic.sensor.solve.newton import jacobian
from geomosaic.surface.model import Surface
from geomosaic.types import FloatArray

# Cells along the longer side of the image.
CELLS = 16
# Condition number of the scaled design beyond which rounding decides what the points do not.
WORST = 1e9


@dataclass(frozen=True, eq=False)
class ImageGrid:
    """Grid of places over an image and where they lie on the ground.

    Attributes
    ----------
    colrow : array (R, C, 2)
        Centres of equal cells, pixels.
    xyz : array (R, C, 3)
        On the ground, in the CRS of the model; NaN where the image shows none.
    """

    colrow: FloatArray
    xyz: FloatArray

    @classmethod
    def of(
        cls,
        model: SensorModel,
        surface: Surface | None = None,
        cells: int = CELLS,
        part: tuple[float, float, float, float] | None = None,
    ) -> ImageGrid:
        """Grid of an image or of a part of it, whose longer side has `cells` cells.

        Parameters
        ----------
        model : SensorModel
        surface : Surface, optional
            Heights of the ground; not needed where the model uses none.
        cells : int
        part : tuple of float, optional
            Left, top, right and bottom, pixels.
        """
        left, top, right, bottom = (0.0, 0.0, *model.size) if part is None else part
        width, height = right - left, bottom - top
        side = max(width, height) / cells
        cols, rows = max(2, round(width / side)), max(2, round(height / side))
        c, r = np.meshgrid(left + (np.arange(cols) + 0.5) * width / cols, top + (np.arange(rows) + 0.5) * height / rows)
        colrow = np.stack([c, r], axis=2)
        xyz = ground_of(model, colrow.reshape(-1, 2), surface)
        return cls(colrow, xyz.reshape(rows, cols, 3))


def ground_of(model: SensorModel, colrow: FloatArray, surface: Surface | None) -> FloatArray:
    """Ground points (N, 3) of image points, in the CRS of the model; NaN where there is none.

    Parameters
    ----------
    model : SensorModel
    colrow : array (N, 2)
        Pixels.
    surface : Surface or None
        None where the model uses no heights.
    """
    if not has_heights(model.crs):
        return image_to_height(model, colrow, 0.0, model.crs)
    if surface is None:
        raise InputError("the sensor needs heights, and no surface is given", hint="give a DEM or a height")
    return Transform(surface.crs, model.crs)(image_to_ground(model, colrow, surface))


def parameter_covariance(model: SensorModel, xyz: FloatArray, sigma: FloatArray) -> FloatArray:
    """Covariance (P, P) of a model's parameters from a-priori values and control points, be they few or none.

    Parameters
    ----------
    model : SensorModel
        Parameters with sigma 0 are held, with a finite one observed. Where the points do not determine those that are
        free, these count as known to the diagonal of the image.
    xyz : array (N, 3)
        Control points measured so far, in `model.crs`.
    sigma : array (N,)
        Standard deviations of their image coordinates, pixels.

    Raises
    ------
    SolveError
        Every parameter is held.
    """
    parameters = model.parameters
    free = parameters.sigmas > 0.0
    if not free.any():
        raise SolveError("every parameter of the model is held: no point changes it", hint="free one")
    by_parameters = _by_parameters(model, xyz)[:, :, free] / np.reshape(sigma, (-1, 1, 1))
    measured = by_parameters[np.isfinite(by_parameters).all(axis=(1, 2))].reshape(-1, int(free.sum()))
    apriori = np.diag(1.0 / parameters.sigmas[free])
    equations = _equations(measured, apriori)
    if len(measured) + np.isfinite(parameters.sigmas[free]).sum() < free.sum() or equations.condition()[0] > WORST:
        # Steps move the image by about a pixel.
        unknown = np.minimum(parameters.sigmas, float(np.hypot(*model.size)) * parameters.steps)[free]
        equations = _equations(measured, np.diag(1.0 / unknown))
    whole = np.zeros((len(free), len(free)))
    whole[np.ix_(free, free)] = equations.parameter_cofactors()
    return whole


def measured_covariance(model: SensorModel, covariance: FloatArray, xyz: FloatArray, sigma: FloatArray) -> FloatArray:
    """Covariance (P, P) of a model's parameters once control points are measured in its image.

    Parameters
    ----------
    model : SensorModel
    covariance : array (P, P)
        Before.
    xyz : array (N, 3)
        Points, in `model.crs`.
    sigma : array (N,)
        Standard deviations of their image coordinates, pixels.
    """
    design = _by_parameters(model, xyz)
    seen = np.isfinite(design).all(axis=(1, 2))
    rows = design[seen].reshape(-1, design.shape[2])
    if not len(rows):
        return covariance
    return updated_covariance(covariance, rows, np.diag(np.repeat(np.asarray(sigma)[seen] ** 2, 2)))


def missing_points(model: SensorModel, measured: int) -> int:
    """Number of points that the free parameters of a model still need.

    Parameters
    ----------
    model : SensorModel
    measured : int
        Points measured so far.
    """
    return max(0, -(-int(np.isinf(model.parameters.sigmas).sum()) // 2) - measured)


def _equations(measured: FloatArray, apriori: FloatArray) -> Equations:
    stacked = np.vstack([measured, apriori])
    return Equations(stacked, np.zeros(len(stacked)))


@dataclass(frozen=True, eq=False)
class NextPoints:
    """What one more control point would do, and the order in which points help most.

    Attributes
    ----------
    grid : ImageGrid
    sigma : array (R, C)
        Expected length of the error of the mapped position now, √trace of its covariance, metres; NaN where there is
        no ground.
    rms : float
        Root mean square of it over the image.
    rms_with : array (R, C)
        The same RMS if one more point were measured there.
    order : Order
        Numbers of the candidates, the most useful one first; of the cells, row by row, unless candidates were given.
    """

    grid: ImageGrid
    sigma: FloatArray
    rms: float
    rms_with: FloatArray
    order: Order

    @property
    def predicted(self) -> FloatArray:
        """RMS over the image before the first point of the order, and after each (K + 1,)."""
        return np.sqrt(np.maximum(self.order.variances, 0.0))


def expected_accuracy(
    model: SensorModel,
    grid: ImageGrid,
    covariance: FloatArray,
    candidates: FloatArray | None = None,
    *,
    sigma_px: float = 1.0,
    count: int = 10,
    missing: int = 0,
) -> NextPoints:
    """Expected accuracy over an image now and with one more control point at each place.

    Parameters
    ----------
    model : SensorModel
        With its current values.
    grid : ImageGrid
        Places over which accuracy is averaged, and which are candidates.
    covariance : array (P, P)
        Of the model's parameters: `parameter_covariance` for a single image, that of its image from the adjustment of a
        block, whose other images count in it.
    candidates : array (N, 3), optional
        Points that can be measured, in `model.crs`, to be ordered instead of the cells.
    sigma_px : float
        Standard deviation of an image coordinate of the next point, pixels, with the share of its ground position.
    count : int
        Length of the order.
    missing : int
        Points without which the parameters are not determined, see `missing_points`: these are chosen as a set.

    Raises
    ------
    SolveError
        The image shows no ground by its model.
    """
    rows, cols = grid.colrow.shape[:2]
    places = grid.xyz.reshape(-1, 3)
    by_parameters = _by_parameters(model, places)
    targets = np.full_like(by_parameters, np.nan)
    seen = np.isfinite(by_parameters).all(axis=(1, 2))
    if not seen.any():
        raise SolveError("the image shows no ground by its model", hint="check the surface and the control points")
    targets[seen] = _metres_by_image(model, places[seen]) @ by_parameters[seen]
    weight = mean_weight(targets)
    noise = sigma_px**2 * np.eye(2)

    def repeated(number: int) -> FloatArray:
        return np.broadcast_to(noise, (number, 2, 2))

    now = float(np.trace(weight @ covariance))
    falls = variance_decreases(covariance, weight, by_parameters, repeated(len(places)))
    design = by_parameters if candidates is None else _by_parameters(model, np.asarray(candidates, dtype=np.float64))
    order = greedy_order(covariance, weight, design, repeated(len(design)), count, max(missing, 1))
    variance = np.einsum("nip,pq,niq->n", targets, covariance, targets)
    return NextPoints(
        grid,
        np.sqrt(variance).reshape(rows, cols),
        float(np.sqrt(now)),
        np.sqrt(np.maximum(now - falls, 0.0)).reshape(rows, cols),
        order,
    )


def _metres_by_image(model: SensorModel, xyz: FloatArray) -> FloatArray:
    """Derivatives (N, 2, 2) of metres along x and y, or east and north, by (col, row)."""
    matrices = map_by_image(model, xyz)
    if model.crs.is_geocentric:
        return matrices
    return matrices * metres_per_unit(model.crs, xyz)[:, :2, None]


def _by_parameters(model: SensorModel, xyz: FloatArray) -> FloatArray:
    """Derivatives (N, 2, P) of (col, row) by the parameters; NaN where the model sees nothing."""
    found = np.full((len(xyz), 2, len(model.parameters)), np.nan)
    known = np.isfinite(xyz).all(axis=1)
    if known.any():
        found[known] = jacobian(model, xyz[known])[0]
    return found
