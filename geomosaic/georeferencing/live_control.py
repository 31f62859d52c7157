"""Control of one image while it is measured: states of the points, their solution, and what is wrong, in words.

The adjustment and the search for wrong points are those of `orientation.single.live_solution`; which model suits best,
and what a finished georeference is refused for, says `georeference`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geomosaic.control.coordinate_diagnostics import Diagnostic
from geomosaic.control.diagnostics import contradictions
from geomosaic.control.points import ControlPoints
from geomosaic.errors import GeomosaicError, InputError, SolveError, listed
from geomosaic.estimation.statistics import total_rms
from geomosaic.geo.crs import has_heights
from geomosaic.georeferencing.blunder_check import SMALLEST_BLUNDER
from geomosaic.georeferencing.model_trial import problem_of
from geomosaic.georeferencing.run import fit_crs
from geomosaic.orientation.single.fit import ControlAdjustment
from geomosaic.orientation.single.live_solution import Blunder, LiveSolution, live_solution, resection_build
from geomosaic.orientation.single.next_point import (
    ImageGrid,
    NextPoints,
    expected_accuracy,
    measured_covariance,
    missing_points,
    parameter_covariance,
)
from geomosaic.sensor.plugin import SensorModel
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray

# Models of plane transformations that predict places until there are points enough for the one asked for.
SIMPLER = ("affine", "conformal")
# Places along each side of an image that its plane transformation is made of before anything is measured.
_NOMINAL = 7


@dataclass(frozen=True)
class Subscene:
    """Part of an image that a fit uses, pixels.

    Attributes
    ----------
    left, top, right, bottom : float
    """

    left: float
    top: float
    right: float
    bottom: float

    def holds(self, colrow: FloatArray) -> BoolArray:
        """Whether places (N, 2) lie in it (N,)."""
        low, high = (self.left, self.top), (self.right, self.bottom)
        return np.asarray(((colrow >= low) & (colrow <= high)).all(axis=1))

    def within(self, size: tuple[int, int]) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of what lies in an image of that width and height.

        Raises
        ------
        InputError
            Nothing does.
        """
        width, height = size
        left, top, right, bottom = (
            max(self.left, 0.0),
            max(self.top, 0.0),
            min(self.right, width),
            min(self.bottom, height),
        )
        if left >= right or top >= bottom:
            raise InputError("the part lies outside the image", hint=f"the image has {width} x {height} pixels")
        return left, top, right, bottom


@dataclass(frozen=True, eq=False)
class LiveControl:
    """Control of one image as measured so far.

    Attributes
    ----------
    control : ControlPoints
        All N points, in the CRS of the fit.
    states : tuple of str
        'control' (in the fit), 'check' (judges it), 'off', or 'outside' (of the part of the image that the fit uses).
    model : SensorModel or None
        Of the solution; where there is none, one that predicts places by fewer points or as the image came; None where
        nothing does.
    solution : LiveSolution or None
    reason : str
        Why there is no solution; empty where there is one.
    diagnostics : tuple of Diagnostic
        What is wrong with the points.
    """

    control: ControlPoints
    states: tuple[str, ...]
    model: SensorModel | None
    solution: LiveSolution | None
    reason: str
    diagnostics: tuple[Diagnostic, ...]

    @property
    def used(self) -> BoolArray:
        """Points that take part in the fit (N,)."""
        return np.array([state == "control" for state in self.states], dtype=np.bool_)

    @property
    def check_rms(self) -> float:
        """RMS length of the residuals at check points, pixels; NaN without any."""
        if self.solution is None:
            return float("nan")
        judges = np.array([state == "check" for state in self.states], dtype=np.bool_)
        return total_rms(self.solution.residuals[judges]) if judges.any() else float("nan")


def live_control(
    control: ControlPoints | None,
    size: tuple[int, int],
    model: str | SensorModel,
    area: Subscene | None = None,
    start: FloatArray | None = None,
) -> LiveControl:
    """Solution of one image's control points as measured so far.

    Parameters
    ----------
    control : ControlPoints or None
        All points of the image, of any role, switched on or off; None before the first.
    size : tuple of int
        Width and height of the image, pixels.
    model : str or SensorModel
        Name of a plane transformation ('conformal', 'affine', 'projective', 'poly1' to 'poly5', 'tps'), or the sensor
        model that the image comes with: its parameters with sigma 0 are held, with a finite one observed.
    area : Subscene, optional
        Part of the image whose points alone take part.
    start : array (P,), optional
        Parameters of the solution before, from which a sensor model is fitted sooner.

    Returns
    -------
    LiveControl
        Without a solution, and with the reason, where the points do not determine one.

    Raises
    ------
    InputError
        Coordinates that have no place in the CRS of the model.
    """
    own = None if isinstance(model, str) else model
    if control is None or not len(control):
        return LiveControl(_NONE, (), own, None, "no point is measured yet", ())
    points = _in_crs(control, model)
    inside = np.ones(len(points), dtype=np.bool_) if area is None else area.holds(points.colrow)
    states = tuple(
        "off" if not on else "check" if role == "check" else "control" if there else "outside"
        for on, role, there in zip(points.enabled.tolist(), points.roles, inside.tolist(), strict=True)
    )
    used = np.array([state == "control" for state in states], dtype=np.bool_)
    found = LiveControl(points, states, own, None, "", tuple(contradictions(points.select(points.enabled))))
    try:
        solution = live_solution(_problem(points, size, model, start), used)
    except GeomosaicError as error:
        nearest = own if own is not None else _predicting(points.select(used), size)
        return replace(found, model=nearest, reason=f"{error.what}{'; ' if error.hint else ''}{error.hint or ''}")
    said = tuple(
        _blunder_diagnostic(solution, points, one) for one in solution.blunders if one.error > SMALLEST_BLUNDER
    )
    return replace(
        found,
        model=solution.fit.model,
        solution=solution,
        diagnostics=(*said, *_undecided(solution, points), *_unchecked(solution), *found.diagnostics),
    )


_NONE = ControlPoints.from_arrays(np.zeros((0, 2)), np.zeros((0, 2)), "EPSG:32631")


def _in_crs(control: ControlPoints, model: str | SensorModel) -> ControlPoints:
    """Points in the CRS of the fit."""
    if isinstance(model, str):
        flat = replace(control, ground=control.xy)
        return flat.to_crs(fit_crs(flat, None, None))
    if not has_heights(model.crs):
        return replace(control, ground=control.xy).to_crs(model.crs)
    if control.ground.shape[1] == 2 or np.isnan(control.ground[:, 2]).any():
        lost = np.flatnonzero(np.isnan(control.ground[:, 2])) if control.ground.shape[1] == 3 else np.array([0])
        raise InputError(f"point '{control.names[lost[0]]}' has no height, which the sensor needs", hint="give its z")
    return control.to_crs(model.crs)


def _problem(
    points: ControlPoints, size: tuple[int, int], model: str | SensorModel, start: FloatArray | None
) -> ControlAdjustment:
    if isinstance(model, str):
        return problem_of(model, "image", size, points)
    xyz = np.zeros((len(points), 3))
    xyz[:, : points.ground.shape[1]] = points.ground
    build = resection_build(model, xyz, points.colrow, start)
    return ControlAdjustment.of(build, points.names, xyz, points.colrow, points.sigma)


def _predicting(points: ControlPoints, size: tuple[int, int]) -> SensorModel | None:
    """Simpler plane transformation of few points; None where not even that is determined."""
    for name in SIMPLER:
        try:
            return problem_of(name, "image", size, points).model()
        except GeomosaicError:
            continue
    return None


def _blunder_diagnostic(solution: LiveSolution, points: ControlPoints, one: Blunder) -> Diagnostic:
    name = points.names[one.index]
    chance = f"1 in {1.0 / one.probability:,.0f}" if one.probability > 1e-9 else "less than 1 in a billion"
    what = (
        f"point {name} contradicts the others: {one.error:.1f} px from where they put it (by chance {chance}); without "
        f"what contradicts, the RMS is {solution.clean_rms:.2f} px instead of {solution.fit.rms_total:.2f}"
    )
    return Diagnostic("blunder", "error", what, (name,), f"measure point {name} again, or switch it off")


def _undecided(solution: LiveSolution, points: ControlPoints) -> tuple[Diagnostic, ...]:
    """Finding that some of the points contradict each other, and that the others do not tell which is wrong."""
    if not solution.rivals:
        return ()
    names = tuple(points.names[index] for index in solution.rivals)
    what = f"one of the points {listed(names)} is wrong, most likely the first, but there are too few to be sure which"
    return (Diagnostic("contradiction", "warning", what, names, "measure them again, or one or two points more"),)


def _unchecked(solution: LiveSolution) -> tuple[Diagnostic, ...]:
    """Finding that the fit has no redundancy, or too little to tell which point is wrong."""
    redundancy = solution.fit.redundancy
    if redundancy > 2 or solution.fit.errs_by_omission:
        return ()
    what = (
        "the points just determine the model: residuals are 0 and tell nothing"
        if redundancy <= 0
        else f"{redundancy} redundant observations do not tell which point is wrong, if one is"
    )
    return (Diagnostic("unchecked", "warning", what, (), "measure one more point, better two"),)


def next_points(
    control: ControlPoints | None,
    size: tuple[int, int],
    model: str | SensorModel = "affine",
    surface: Surface | None = None,
    *,
    candidates: FloatArray | None = None,
    covariance: FloatArray | None = None,
    count: int = 10,
) -> NextPoints:
    """Where one more control point of an image would improve the mapped positions most, and the best order of points.

    Parameters
    ----------
    control : ControlPoints or None
        Points measured so far; None for the order in which an image is best measured from the first on.
    size : tuple of int
        Width and height of the image, pixels.
    model : str or SensorModel
        Plane transformation ('conformal', 'affine', 'projective', 'poly1' to 'poly5'), or the sensor model that the
        image comes with.
    surface : Surface, optional
        Heights of the ground, where the model uses them.
    candidates : array (N, 3), optional
        Points that can be measured, in the CRS of the model, to be ordered instead of places of the image.
    covariance : array (P, P), optional
        Of the parameters of `model` from the adjustment of a block, such as that of an image of `gm.adjust`: `control`
        are then the points that were measured in the image since.
    count : int
        Length of the order.

    Returns
    -------
    NextPoints
        Expected error over the image now (`sigma`, `rms`), with one more point at each place (`rms_with`), and the
        `order` with the errors `predicted` after each point; metres, or pixels where the points do not determine a
        plane transformation yet.

    Raises
    ------
    InputError
        Coordinates that have no place in the CRS of the model.
    SolveError
        The model passes through its points ('tps'), or none of its parameters is free.

    Examples
    --------
    >>> found = next_points(None, (4000, 3000), "affine", count=3)
    >>> [(round(col), round(row)) for col, row in found.grid.colrow.reshape(-1, 2)[found.order.chosen].tolist()]
    [(1875, 125), (3875, 2875), (125, 2875)]
    """
    if covariance is not None and not isinstance(model, str):
        return next_in_block(control, model, covariance, surface, candidates, count=count)
    return next_control(live_control(control, size, model), size, model, surface, candidates, count=count)


def next_in_block(
    control: ControlPoints | None,
    model: SensorModel,
    covariance: FloatArray,
    surface: Surface | None = None,
    candidates: FloatArray | None = None,
    *,
    sigma_px: float | None = None,
    count: int = 10,
) -> NextPoints:
    """Where one more control point of an image helps most that was adjusted in a block.

    Parameters
    ----------
    control : ControlPoints or None
        Points that were measured in the image since.
    model : SensorModel
        Adjusted.
    covariance : array (P, P)
        Of its parameters from the adjustment, in which the other images and their ties count.
    surface : Surface, optional
        Heights of the ground, where the model uses them.
    candidates : array (N, 3), optional
        Points that can be measured, in the CRS of the model.
    sigma_px : float, optional
        Standard deviation of an image coordinate of the next point, pixels; the median of those since, or 1, unless
        given.
    count : int
        Length of the order.

    Returns
    -------
    NextPoints
        What a point does to the image in which it is measured; for what it does through the ties to the others, the
        block has to be adjusted.
    """
    known = 1.0 if sigma_px is None else sigma_px
    if control is not None and len(control):
        points = _in_crs(control.select(control.enabled & (np.array(control.roles) == "control")), model)
        xyz = np.zeros((len(points), 3))
        xyz[:, : points.ground.shape[1]] = points.ground
        covariance = measured_covariance(model, covariance, xyz, points.sigma)
        known = float(np.median(points.sigma)) if sigma_px is None and len(points) else known
    return expected_accuracy(
        model, ImageGrid.of(model, surface), covariance, candidates, sigma_px=known, count=count
    )  # fmt: skip


def next_control(
    live: LiveControl,
    size: tuple[int, int],
    model: str | SensorModel,
    surface: Surface | None = None,
    candidates: FloatArray | None = None,
    *,
    area: Subscene | None = None,
    count: int = 10,
) -> NextPoints:
    """Where one more control point would help most, for the points measured so far.

    Parameters
    ----------
    live : LiveControl
    size : tuple of int
        Width and height of the image, pixels.
    model : str or SensorModel
        As for `live_control`.
    surface : Surface, optional
        Heights of the ground, where the model uses them.
    candidates : array (N, 3), optional
        Points that can be measured, in the CRS of the model.
    area : Subscene, optional
        Part of the image that is fitted, in which accuracy is expected and places are ordered.
    count : int
        Length of the order.

    Returns
    -------
    NextPoints
        Before the points determine a plane transformation, for one in which a pixel is a metre.

    Raises
    ------
    SolveError
        The model passes through its points, so that its covariance says nothing; or no parameter is free.
    """
    if model == "tps":
        raise SolveError(
            "a thin plate spline passes through its points: no covariance tells where the next one helps",
            hint="measure where points are far apart; or choose a polynomial, which averages",
        )
    if live.solution is None:
        fitted = _nominal(size, model) if isinstance(model, str) else model
        xyz, sigma = _measured(live, nominal=isinstance(model, str))
    else:
        fit = live.solution.fit
        fitted, xyz, sigma = fit.model, fit.xyz, fit.sigma
    variance = 1.0 if live.solution is None else live.solution.fit.variance_factor
    covariance = parameter_covariance(fitted, xyz, sigma)
    missing = 0 if live.solution is not None else missing_points(fitted, len(xyz))
    typical = float(np.median(sigma)) if len(sigma) else 1.0
    grid = ImageGrid.of(fitted, surface, part=None if area is None else area.within(size))
    return expected_accuracy(
        fitted, grid, variance * covariance, candidates,
        sigma_px=typical * float(np.sqrt(variance)), count=count, missing=missing,
    )  # fmt: skip


def _nominal(size: tuple[int, int], model: str) -> SensorModel:
    """Plane transformation of a map in which a pixel is a metre."""
    width, height = size
    places = np.stack(np.meshgrid(np.linspace(0, width, _NOMINAL), np.linspace(0, height, _NOMINAL)), 2).reshape(-1, 2)
    ground = places * [1.0, -1.0] + [500_000.0, 5_000_000.0]
    return problem_of(model, "image", size, ControlPoints.from_arrays(places, ground, "EPSG:32631")).model()


def _measured(live: LiveControl, *, nominal: bool) -> tuple[FloatArray, FloatArray]:
    """Ground (K, 3) of the points in use and their sigmas (K,), under a model that they do not determine."""
    used = live.used
    if not used.any():
        return np.zeros((0, 3)), np.zeros(0)
    xyz = np.zeros((int(used.sum()), 3))
    if nominal:
        xyz[:, :2] = live.control.colrow[used] * [1.0, -1.0] + [500_000.0, 5_000_000.0]
    else:
        xyz[:, : live.control.ground.shape[1]] = live.control.ground[used]
    return xyz, live.control.sigma[used]
