"""Planar models of a geotransform, of control points or of coefficients."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.sensor.inputs import choice, numbers, point_rows, positive, suggestion
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.types import FloatArray
from geomosaic_planar.model import PlanarModel, Transformation
from geomosaic_planar.terms import AXES, KINDS, MAX_ORDER, parameter_names

POINT = ("x", "y", "col", "row")
SOURCES = ("transform", "geotransform", "points", "coefficients")


def build_model(request: SensorRequest) -> PlanarModel:
    """Planar model of one image, from a geotransform, control points or coefficients.

    Parameters
    ----------
    request : SensorRequest
        Image size in pixels, CRS (horizontal, or with a horizontal part) and the options of the sensor; exactly one of
        `SOURCES` among them.

    Returns
    -------
    PlanarModel
        Ground in the horizontal part of the request's CRS; pixel origin at the outer corner of the upper-left pixel.

    Raises
    ------
    InputError
        An input is missing, unknown or out of range.
    SolveError
        The control points do not determine the transformation.
    """
    where = request.image
    options = request.options
    given = [source for source in SOURCES if source in options]
    if len(given) != 1:
        what = f"{' and '.join(given)} are given together" if given else "there is nothing to place the image with"
        raise InputError(what, where=where, hint=f"give one of {', '.join(SOURCES)}")
    if request.crs is None or request.crs.is_geocentric:
        raise InputError("sensor 'planar' needs a horizontal CRS", where=where, hint="name one, e.g. EPSG:32633")
    crs = horizontal(request.crs)
    if given[0] in ("transform", "geotransform"):
        return _georeferenced(request, crs, given[0])
    kind, order = _kind(options, where)
    axes = _axes(options, kind, where)
    if given[0] == "points":
        from geomosaic_planar.fit import fit_planar

        xy, colrow, weights = _points(options["points"], where)
        fitted = fit_planar(kind, xy, colrow, weights, order=order, axes=axes, where=where)
        return PlanarModel.of(fitted, crs, request.size, where=where)
    if kind == "tps":
        raise InputError("a thin plate spline has no coefficients to give", where=where, hint="give 'points'")
    values = _coefficients(options["coefficients"], kind, order, where)
    centre = np.array(numbers(options.get("centre", (0.0, 0.0)), 2, "centre", where))
    scale = positive(options.get("scale", 1.0), "scale", where)
    transformation = Transformation(kind, order, centre, scale, values, axes or "left")
    return PlanarModel.of(transformation, crs, request.size, where=where)


def _georeferenced(request: SensorRequest, crs: CRS, option: str) -> PlanarModel:
    """Affine model, held fixed, from a pixel → map transform."""
    where = request.image
    raw = request.options[option]
    if isinstance(raw, Affine):
        raw = [raw.a, raw.b, raw.c, raw.d, raw.e, raw.f]
    elif isinstance(raw, list | tuple) and len(raw) == 9:  # an affine matrix with its last line
        raw = raw[:6]
    given = numbers(raw, 6, option, where)
    a, b, c, d, e, f = (given[i] for i in (1, 2, 0, 4, 5, 3)) if option == "geotransform" else given
    width, height = request.size
    half = np.array([width, height]) / 2.0
    matrix = np.array([[a, b], [d, e]])
    pixel = float(np.abs(matrix).max())
    if pixel == 0.0 or abs(np.linalg.det(matrix)) < 1e-12 * pixel**2:
        raise InputError(
            f"input '{option}' maps the image onto a line",
            where=where,
            hint="correct it: columns and rows must run in two directions",
        )
    # The inverse is written about the middle of the image: no cancellation of large map coordinates.
    centre = matrix @ half + [c, f]
    scale = float(np.abs(matrix @ (half * [[1, 1], [1, -1]]).T).max())
    inverse = np.linalg.inv(matrix) * scale
    values = np.column_stack([half, inverse]).ravel()
    return PlanarModel.of(Transformation("affine", 1, centre, scale, values), crs, request.size, sigma=0.0, where=where)


def _kind(options: Mapping[str, Any], where: str) -> tuple[str, int]:
    """Kind of the transformation and degree of its polynomial."""
    kind, order = choice(options.get("kind", "affine"), KINDS, "kind", where), options.get("order", 1)
    if isinstance(order, bool) or not isinstance(order, int) or not 1 <= order <= MAX_ORDER:
        raise InputError(f"input 'order' is {order}", where=where, hint=f"give a whole number from 1 to {MAX_ORDER}")
    if kind != "polynomial" and order != 1:
        raise InputError(f"input 'order' has no meaning for kind '{kind}'", where=where, hint="use kind = polynomial")
    return kind, order


def _axes(options: Mapping[str, Any], kind: str, where: str) -> str | None:
    """Handedness of the image's axes; None where a conformal fit is to recognise it."""
    if options.get("axes") is None:
        return None
    axes = choice(options["axes"], AXES, "axes", where)
    if kind != "conformal":
        raise InputError(
            f"input 'axes' has no meaning for kind '{kind}', which takes either handedness as it is",
            where=where,
            hint="leave it out",
        )
    return axes


def _points(points: Any, where: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Map positions, image positions and weights of control points."""
    if not isinstance(points, Sequence) or isinstance(points, str) or not points:
        raise InputError(
            "input 'points' is not a list of points", where=where, hint="give points = [{x, y, col, row}, ...]"
        )
    table = _table(points, where)
    return table[:, :2], table[:, 2:4], 1.0 / table[:, 4] ** 2


def _table(points: Sequence[Any], where: str) -> FloatArray:
    """x, y, col, row, sigma of points (N, 5): at once where nothing is wrong, one by one to say what is."""
    try:
        table = np.array([(*map(point.__getitem__, POINT), point.get("sigma", 1.0)) for point in points])
        if table.dtype.kind in "fi" and np.isfinite(table).all() and (table[:, 4] > 0.0).all():
            return table.astype(np.float64)
    except (TypeError, ValueError, KeyError, AttributeError):
        pass
    return np.array(point_rows(points, POINT, where)[1])


def _coefficients(given: Any, kind: str, order: int, where: str) -> FloatArray:
    """Coefficients (P,) in the order of `parameter_names`, from a table or a list."""
    names = parameter_names(kind, order)
    if isinstance(given, Mapping):
        if set(given) != set(names):
            odd = next((str(key) for key in given if key not in names), "")
            raise InputError(
                "input 'coefficients' does not name what this kind has",
                where=where,
                hint=suggestion(odd, "give", names),
            )
        given = [given[name] for name in names]
    return np.array(numbers(given, len(names), "coefficients", where))
