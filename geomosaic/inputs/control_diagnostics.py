"""Likeliest slips in the control of a block: exchanged axes, heights, units, pixels counted otherwise, another zone."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint, OrientedImage
from geomosaic.control.coordinate_diagnostics import misplaced
from geomosaic.errors import GeomosaicError, InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.transform import Transform
from geomosaic.inputs.control_points import image_control
from geomosaic.inputs.orientation_plausibility import BETTER, FAR, PLAUSIBLE, median_distance
from geomosaic.surface.model import undulation

# Slips that leave no doubt; a place beyond the area of use may be meant.
_CERTAIN = ("degrees-in-metres", "metres-in-degrees", "latitude-longitude-swapped", "swapped-axes")


_SHARED = "bring the points into the CRS of the positions (crs under [exterior]), which is theirs too"
_HINTS = {
    "degrees-in-metres": f"{_SHARED}; or, where both are in degrees, name that CRS, such as EPSG:4326",
    "metres-in-degrees": f"{_SHARED}; or, where both are in a projection, name that",
}


def refuse_misplaced(points: Sequence[ControlPoint], crs: CRS, where: str) -> None:
    """Check of control coordinates against their CRS: another unit, or exchanged axes.

    Parameters
    ----------
    points : sequence of ControlPoint
    crs : CRS
        CRS in which they are declared.
    where : str
        Table, for the message.

    Raises
    ------
    InputError
        More than half of the points show a slip that leaves no doubt; names it, with a hint.
    """
    # A point measured in several images is one point on the ground.
    once = list({point.id: point for point in points}.values())
    for finding in misplaced(image_control(once, horizontal(crs), where)):
        if finding.code in _CERTAIN and len(finding.points) > len(once) / 2:
            raise InputError(finding.what, where=where, hint=_HINTS.get(finding.code, finding.hint))


# Metres of the international foot.
_FOOT = 0.3048
# Metres of geoid height below which a wrong vertical datum explains nothing.
_LEAST_UNDULATION = 0.5

_Sizes = dict[str, tuple[int, int]]


@dataclass(frozen=True)
class _PointReading:
    """Hypothesis on control points: one way to read them; `what` follows 'with', `points` are in the block's CRS."""

    what: str
    hint: str
    points: tuple[ControlPoint, ...]


def _point_readings(points: Sequence[ControlPoint], crs: CRS, sizes: _Sizes) -> Iterator[_PointReading]:
    """Other readings of control points, the likeliest slips first."""
    if not crs.is_geocentric:
        yield from _by_axes(points, crs)
        yield from _by_height(points, crs)
    yield from _by_pixels(points, sizes)
    utm = horizontal(crs).to_epsg() if horizontal(crs).utm_zone else None
    if utm is not None:
        yield from _by_zone(points, crs, utm)


def _by_axes(points: Sequence[ControlPoint], crs: CRS) -> Iterator[_PointReading]:
    names = ("longitude", "latitude") if horizontal(crs).is_geographic else ("east", "north")
    yield _PointReading(
        "x and y exchanged",
        f"exchange the names x and y in the header of the control points: x is {names[0]}, y is {names[1]}",
        tuple(replace(point, xyz=(point.xyz[1], point.xyz[0], point.xyz[2])) for point in points),
    )


def _by_height(points: Sequence[ControlPoint], crs: CRS) -> Iterator[_PointReading]:
    shift = undulation(horizontal(crs), *points[0].xyz[:2])
    if math.isfinite(shift) and abs(shift) >= _LEAST_UNDULATION:
        for by, of in ((shift, "the geoid (EGM96)"), (-shift, "the ellipsoid")):
            yield _PointReading(
                f"their heights counted from {of}, {abs(shift):.1f} m {'above' if by > 0 else 'below'} where they lie",
                f"add {by:+.1f} m to z of the control points (which share the vertical datum of the positions, heights "
                "under [exterior]), or declare the datum that is theirs",
                _heights(points, 1.0, by),
            )
    for factor, unit in ((_FOOT, "feet"), (1.0 / _FOOT, "metres that were taken for feet")):
        yield _PointReading(
            f"their heights in {unit}",
            f"multiply z of the control points by {factor:.4f}",
            _heights(points, factor, 0.0),
        )


def _by_pixels(points: Sequence[ControlPoint], sizes: _Sizes) -> Iterator[_PointReading]:
    def moved(change: str) -> tuple[ControlPoint, ...]:
        out = []
        for point in points:
            (col, row), (width, height) = point.colrow, sizes[point.image]
            place = {"rows": (col, height - row), "swap": (row, col), "minus": (col, -row), "turn": (width - col, row)}
            out.append(replace(point, colrow=place[change]))
        return tuple(out)

    yield _PointReading("col and row exchanged", "exchange the names col and row in the header", moved("swap"))
    yield _PointReading("rows counted from the bottom", "write row = height of the image - row", moved("rows"))
    yield _PointReading("rows counted with a minus sign, as QGIS does", "change the sign of row", moved("minus"))
    yield _PointReading("columns counted from the right", "write col = width of the image - col", moved("turn"))


def _by_zone(points: Sequence[ControlPoint], crs: CRS, code: int) -> Iterator[_PointReading]:
    # Consecutive EPSG codes are neighbouring UTM zones; at the ends of a series the code is another CRS or none.
    for other in (code - 1, code + 1):
        try:
            elsewhere = CRS.from_epsg(other)
            if not elsewhere.utm_zone:
                continue
            xy = Transform(elsewhere, horizontal(crs))(np.array([point.xyz[:2] for point in points]))
        except (GeomosaicError, ValueError, RuntimeError):
            continue
        if np.isfinite(xy).all():
            yield _PointReading(
                f"the points in {elsewhere.name}",
                f"bring the control points from EPSG:{other} to the CRS of [exterior], which is also theirs",
                tuple(replace(p, xyz=(float(x), float(y), p.xyz[2])) for p, (x, y) in zip(points, xy, strict=True)),
            )


def _heights(points: Sequence[ControlPoint], factor: float, shift: float) -> tuple[ControlPoint, ...]:
    return tuple(replace(p, xyz=(p.xyz[0], p.xyz[1], factor * p.xyz[2] + shift)) for p in points)


# With fewer points some reading fits by chance.
_FEWEST = 3


def likeliest_cause(
    scenes: Sequence[OrientedImage], points: Sequence[ControlPoint], crs: CRS, given: float
) -> tuple[str, str]:
    """Likeliest slip in the reading of control points, with its hint; two empty texts for none.

    Parameters
    ----------
    scenes : sequence of OrientedImage
        Images before an adjustment on these points.
    points : sequence of ControlPoint
    crs : CRS
        CRS of the points.
    given : float
        Median distance of the points as they were read, pixels.

    Returns
    -------
    cause, hint : str
    """
    if len(points) < _FEWEST or given <= FAR:
        return "", ""
    sizes = {scene.name: scene.model.size for scene in scenes}
    tried = [(median_distance(scenes, reading.points, crs), reading) for reading in _point_readings(points, crs, sizes)]
    least, best = min(tried, key=lambda pair: pair[0])
    plausible = PLAUSIBLE * min(math.hypot(*size) for size in sizes.values())
    if BETTER * least < given and least < plausible:
        return f"with {best.what} it would be {least:.3g} px", best.hint
    return "", ""
