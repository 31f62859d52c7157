"""How many photos and strips an area takes, and how large its raster becomes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from geomosaic.errors import InputError
from geomosaic.plan.quantities import checked


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
    def photos(self) -> int:
        """All of them."""
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
) -> Coverage:
    """Photos over a rectangle of `length` along and `width` across the strips, metres.

    Strips are spread so that their outer edges reach those of the area: n = ⌈(width - side) / spacing⌉ + 1. In a strip,
    n = ⌈(length - side) / base⌉ + 1; with `stereo`, n = ⌈length / base⌉ + 1, so that everything up to both ends lies
    between the nadir points of two photos.
    """
    if not (length > 0 and width > 0):
        raise InputError(f"{length:g} x {width:g} m is no area", where="--area", mend="give two lengths in metres")
    scale = checked("photo_scale", photo_scale) / 1000
    side = (checked("format_along", format_along) * scale, checked("format_across", format_across) * scale)
    base = (1 - checked("overlap", overlap) / 100) * side[0]
    spacing = (1 - checked("sidelap", sidelap) / 100) * side[1]
    hair = 1e-9
    strips = max(0, math.ceil((width - side[1]) / spacing - hair)) + 1
    along = length if stereo else max(0.0, length - side[0])
    return Coverage(strips, math.ceil(along / base - hair) + 1, base, spacing, side)


def raster_size(length: float, width: float, pixel: float) -> tuple[int, int]:
    """Columns and rows of a raster over `width` (east) by `length` (north) metres: whole pixels that cover it."""
    size = checked("ortho_pixel", pixel)
    return math.ceil(width / size - 1e-9), math.ceil(length / size - 1e-9)
