"""Coverage of an area: photos, strips, size of the raster; number and layout of control points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError, did_you_mean
from geomosaic.options.check import check_idle
from geomosaic.options.planning import ControlNeedOptions, CoverageOptions
from geomosaic.planning.relations import checked
from geomosaic.types import FloatArray


@dataclass(frozen=True)
class Coverage:
    """Photos that cover a rectangle.

    Attributes
    ----------
    strips, photos_in_strip : int
    base, spacing : float, metres between exposures and between strips
    footprint : tuple of float, metres that a photo covers along and across the strip
    raster : tuple of int, optional, columns across and rows along of the raster of the area
    """

    strips: int
    photos_in_strip: int
    base: float
    spacing: float
    footprint: tuple[float, float]
    raster: tuple[int, int] | None = None

    @property
    def overlap(self) -> float:
        """Forward overlap in per cent."""
        return 100 * (1 - self.base / self.footprint[0])

    @property
    def sidelap(self) -> float:
        """Side overlap of strips in per cent."""
        return 100 * (1 - self.spacing / self.footprint[1])

    @property
    def photos(self) -> int:
        """Number of photos in all strips."""
        return self.strips * self.photos_in_strip


def coverage(wanted: CoverageOptions) -> Coverage:
    """Photos and strips that cover a rectangle, and the size of its raster.

    Parameters
    ----------
    wanted : CoverageOptions

    Raises
    ------
    InputError
        A value makes no sense, the given numbers do not cover the area, without `monoscopic` the overlap is below
        50 %, or an overlap is given beside the number that it follows from.
    """
    check_idle(wanted)
    length, width = wanted.area
    if not (0 < length < math.inf and 0 < width < math.inf):
        what = f"{length:.10g} x {width:.10g} m is no area"
        raise InputError(what, where="`area`", hint="give two lengths in metres")
    scale = checked("photo_scale", wanted.photo_scale) / 1000
    side = (
        checked("format_along", wanted.format_along) * scale,
        checked("format_across", wanted.format_across) * scale,
    )
    base = (1 - checked("overlap", wanted.overlap) / 100) * side[0]
    spacing = (1 - checked("sidelap", wanted.sidelap) / 100) * side[1]
    # Strips are spread so that their outer edges reach those of the area: n = ⌈(width - side) / spacing⌉ + 1. In a
    # strip n = ⌈(length - side) / base⌉ + 1 with `monoscopic`, else n = ⌈length / base⌉ + 1, so that everything up to
    # both ends lies between the nadir points of two photos. A number that is given makes the overlap the largest with
    # which it reaches.
    along, across = max(0.0, length - side[0]) if wanted.monoscopic else length, max(0.0, width - side[1])
    strips, spacing = _spread(across, spacing, side[1], wanted.strips, "`strips`")
    photos_in_strip, base = _spread(along, base, side[0], wanted.photos_in_strip, "`photos_in_strip`")
    if not wanted.monoscopic:
        check_stereo(base, side[0])
    raster = None if wanted.ortho_pixel is None else raster_size(length, width, wanted.ortho_pixel)
    return Coverage(strips, photos_in_strip, base, spacing, side, raster)


def check_stereo(base: float, side: float) -> None:
    """Refusal of a base that leaves places which only one photo shows: beyond half a side, between two nadir points.

    Parameters
    ----------
    base : float, metres between exposures
    side : float, metres that a photo covers along the strip

    Raises
    ------
    InputError
    """
    if base > side / 2 + _HAIR:
        raise InputError(
            f"with {100 * (1 - base / side):.3g} % of overlap there are places that only one photo shows",
            where="`overlap`",
            hint="50 % or more, or more photos in a strip; with `monoscopic` one photo is enough",
        )


# Part of a step by which rounding may exceed a whole number: it must not add a photo or a pixel.
_HAIR = 1e-9


def _spread(reach: float, step: float, side: float, count: int | None, where: str) -> tuple[int, float]:
    """Number of steps that cover a reach, plus one; or the step with which a number of them does."""
    if count is None:
        return math.ceil(reach / step - _HAIR) + 1, step
    least = math.ceil(reach / side - _HAIR) + 1
    if count < least:
        raise InputError(f"{count} leave gaps in the area", where=where, hint=f"{least} or more, or a smaller scale")
    if count == 1:
        return count, step
    return count, reach / (count - 1)


def raster_size(length: float, width: float, pixel: float) -> tuple[int, int]:
    """Size of the raster that covers a rectangle with whole pixels.

    Parameters
    ----------
    length, width : float, of the rectangle, north and east, metres
    pixel : float, metres

    Returns
    -------
    cols, rows : int

    Raises
    ------
    InputError
        A pixel that is not above 0.
    """
    # Quotients such as 0.3 / 0.1 exceed a whole number in the last bit, which must not add a pixel.
    size = checked("ortho_pixel", pixel)
    return math.ceil(width / size - _HAIR), math.ceil(length / size - _HAIR)


# Unknowns of one image: each point gives two equations. 'frame' is resection of a photo with a known camera; 'spot' the
# line scanner of Müller and Sauleda with six elements of orientation and eight additional parameters.
COEFFICIENTS = {"conformal": 4, "affine": 6, "projective": 8, "frame": 6, "spot": 14} | {
    f"poly{n}": (n + 1) * (n + 2) for n in range(1, 6)
}
# Points per image that Wolf recommends (section 9-3), depending on the transformation and the accuracy.
ROUGHLY = (8, 15)
# Points that Jensen begins with, to leave out the worst until the RMS is below its threshold.
FOR_FILTERING = 20


@dataclass(frozen=True)
class ControlNumber:
    """Number of control points that a model needs.

    Attributes
    ----------
    unknowns : int
    least : int, points that determine the model without redundancy
    redundant : int, points with which there are twice as many equations as unknowns
    recommended : tuple of int, range: `ROUGHLY`, and more where `redundant` is
    """

    unknowns: int
    least: int
    redundant: int
    recommended: tuple[int, int]


def control_number(model: str) -> ControlNumber:
    """Number of control points that one image needs.

    Parameters
    ----------
    model : str, of `COEFFICIENTS`

    Raises
    ------
    InputError
        The model is not known.
    """
    if model not in COEFFICIENTS:
        raise InputError(
            f"there is no model '{model}'",
            where="`model`",
            hint=did_you_mean(model, COEFFICIENTS) or f"one of {', '.join(COEFFICIENTS)}",
        )
    unknowns = COEFFICIENTS[model]
    least, twice = math.ceil(unknowns / 2), unknowns
    return ControlNumber(unknowns, least, twice, (max(ROUGHLY[0], twice), max(ROUGHLY[1], twice)))


def models_of(count: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Models that a number of control points determines.

    Parameters
    ----------
    count : int, points in one image

    Returns
    -------
    determined : tuple of str, names of models with at least as many equations as unknowns
    redundant : tuple of str, names of those with at least twice as many
    """
    need = {name: control_number(name) for name in COEFFICIENTS}
    return (
        tuple(name for name, number in need.items() if number.least <= count),
        tuple(name for name, number in need.items() if number.redundant <= count),
    )


def control_layout(count: int) -> FloatArray:
    """Layout of control points: one in each corner, then each in the middle of the largest gap (Wolf, section 9-3).

    Parameters
    ----------
    count : int, at least 2

    Returns
    -------
    array (count, 2)
        Parts of width and height, from 0.05 to 0.95, in the order of measurement: the first n are well spread too.

    Raises
    ------
    InputError
        Fewer than 2.
    """
    if count < 2:
        raise InputError("one point places no image", where="`points`", hint="give 2 or more")
    axis = np.linspace(0.05, 0.95, 37)
    places = np.array([(x, y) for y in axis for x in axis])
    # Opposite corners first: the first two points already span the whole image.
    chosen = [np.array(corner) for corner in ((0.05, 0.05), (0.95, 0.95), (0.95, 0.05), (0.05, 0.95))]
    gap = np.full(len(places), np.inf)
    for corner in chosen:
        gap = np.minimum(gap, np.hypot(*(places - corner).T))
    while len(chosen) < count:
        # Rounded, so that the choice among equal gaps does not hang on the last bit.
        chosen.append(places[int(np.argmax(np.round(gap, 9)))])
        gap = np.minimum(gap, np.hypot(*(places - chosen[-1]).T))
    return np.array(chosen[:count])


@dataclass(frozen=True)
class BlockBalance:
    """Equations and unknowns of photos that are adjusted together (Wolf, section 9-8).

    Attributes
    ----------
    unknowns : int, of all photos
    tie_equations, control_equations : int, from tie points and from control points
    """

    unknowns: int
    tie_equations: int
    control_equations: int

    @property
    def redundancy(self) -> int:
        """Number of equations beyond the unknowns."""
        return self.tie_equations + self.control_equations - self.unknowns


@dataclass(frozen=True, eq=False)
class ControlPlan:
    """Number and layout of control points.

    Attributes
    ----------
    model : str
    number : ControlNumber, of one image
    determined, redundant : tuple of str, models that the points determine, and those that they check
    layout : array (N, 2), optional, shares of width and height in the order of measurement
    block : BlockBalance, optional
    """

    model: str
    number: ControlNumber
    determined: tuple[str, ...] = ()
    redundant: tuple[str, ...] = ()
    layout: FloatArray | None = None
    block: BlockBalance | None = None


def control_plan(wanted: ControlNeedOptions) -> ControlPlan:
    """Number and layout of the control points of an image, and balance of a block.

    Parameters
    ----------
    wanted : ControlNeedOptions

    Raises
    ------
    InputError
        The model is not known, or ties are given without photos.
    """
    check_idle(wanted)
    number = control_number(wanted.model)
    determined, redundant = models_of(wanted.points) if wanted.points is not None else ((), ())
    layout = None if wanted.points is None else control_layout(wanted.points)
    # Each measurement of control (Wolf, 9-3) and each connection of two photos (9-4) gives two equations.
    block = (
        None
        if wanted.photos is None
        else BlockBalance(wanted.photos * number.unknowns, 2 * wanted.ties, 2 * wanted.control)
    )
    return ControlPlan(wanted.model, number, determined, redundant, layout, block)
