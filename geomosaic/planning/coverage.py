"""Coverage: photos and strips over an area, and the size of its raster."""

from __future__ import annotations

import math
from dataclasses import dataclass

from geomosaic.errors import InputError
from geomosaic.planning.quantities import checked


@dataclass(frozen=True)
class Coverage:
    """Photos that cover a rectangle.

    Attributes
    ----------
    strips, photos_in_strip : int
    base, spacing : float
        Metres between exposures and between strips.
    footprint : tuple of float
        Metres that a photo covers along and across the strip.
    """

    strips: int
    photos_in_strip: int
    base: float
    spacing: float
    footprint: tuple[float, float]

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


def coverage(
    length: float,
    width: float,
    photo_scale: float,
    *,
    format_along: float = 230.0,
    format_across: float = 230.0,
    overlap: float = 60.0,
    sidelap: float = 30.0,
    stereo: bool = True,
    strips: int | None = None,
    photos_in_strip: int | None = None,
) -> Coverage:
    """Photos and strips that cover a rectangle.

    Strips are spread so that their outer edges reach those of the area: n = ⌈(width - side) / spacing⌉ + 1. In a strip,
    n = ⌈(length - side) / base⌉ + 1; with `stereo`, n = ⌈length / base⌉ + 1, so that everything up to both ends lies
    between the nadir points of two photos.

    The other way round, a number of `strips` or `photos_in_strip` replaces the overlap, which is then the largest with
    which they reach.

    Parameters
    ----------
    length, width : float
        Of the rectangle along and across the strips, metres.
    photo_scale : float
        Denominator.
    format_along, format_across : float
        Sides of the photo, mm.
    overlap, sidelap : float
        Percent of these sides.
    stereo : bool
        Whether every place is to be seen in two photos.
    strips, photos_in_strip : int, optional
        Instead of `sidelap` and `overlap`.

    Returns
    -------
    Coverage

    Raises
    ------
    InputError
        A value makes no sense, the given numbers do not cover the area, or with `stereo` the overlap is below 50 %:
        then there are places between two nadir points that only one photo shows.
    """
    if not (0 < length < math.inf and 0 < width < math.inf):
        raise InputError(f"{length:g} x {width:g} m is no area", where="`area`", hint="give two lengths in metres")
    scale = checked("photo_scale", photo_scale) / 1000
    side = (checked("format_along", format_along) * scale, checked("format_across", format_across) * scale)
    base = (1 - checked("overlap", overlap) / 100) * side[0]
    spacing = (1 - checked("sidelap", sidelap) / 100) * side[1]
    along, across = length if stereo else max(0.0, length - side[0]), max(0.0, width - side[1])
    strips, spacing = _spread(across, spacing, side[1], strips, "`strips`")
    photos_in_strip, base = _spread(along, base, side[0], photos_in_strip, "`photos_in_strip`")
    if stereo and base > side[0] / 2 + _HAIR:
        raise InputError(
            f"with {100 * (1 - base / side[0]):.3g} % of overlap there are places that only one photo shows",
            where="`overlap`",
            hint="50 % or more, or more photos in a strip; with `mono` one photo is enough",
        )
    return Coverage(strips, photos_in_strip, base, spacing, side)


_HAIR = 1e-9
"""Part of a step by which rounding may exceed a whole number: it must not add a photo."""


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
    length, width : float
        Of the rectangle, north and east, metres.
    pixel : float
        Metres.

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
    return math.ceil(width / size - 1e-9), math.ceil(length / size - 1e-9)
