"""Stretch of a finished mosaic to eight bits, between two percentiles or two values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError
from geomosaic.mosaicking.colour.balance import ThumbnailOfImage, comparison_grid
from geomosaic.mosaicking.colour.corrections import Correction, corrected, with_gain_offset
from geomosaic.options.render import RenderOptions
from geomosaic.render.photos import Photos
from geomosaic.render.regions import map_images
from geomosaic.types import FloatArray

DTYPE = "uint8"
# 0 is left for missing pixels.
LOWEST, HIGHEST = 1.0, 255.0


@dataclass(frozen=True)
class Stretch:
    """Linear stretch of corrected values to eight bits.

    Attributes
    ----------
    low, high : float
        Corrected values that go to 1 and to 255.
    how : str
        Where the ends come from, in words.
    """

    low: float
    high: float
    how: str


def parse_stretch(text: str) -> tuple[bool, float, float]:
    """Ends of a stretch from text.

    Parameters
    ----------
    text : str
        '2,98' (percentiles) or 'v100,v3000' (values).

    Returns
    -------
    values : bool
        Whether the ends are values.
    low, high : float

    Raises
    ------
    InputError
        Another form, or ends that do not rise.
    """
    hint = "give two percentiles such as 2,98, or two values such as v100,v3000"
    parts = [part.strip() for part in text.split(",")]
    values = all(part.lower().startswith("v") for part in parts)
    try:
        low, high = (float(part[1:] if values else part) for part in parts)
    except ValueError:
        raise InputError(f"'{text}' is no stretch", where="`stretch`", hint=hint) from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"'{text}' does not rise from one finite number to another", where="`stretch`", hint=hint)
    if not values and not (low >= 0 and high <= 100):
        raise InputError(f"'{text}' holds no percentiles, 0 to 100", where="`stretch`", hint=hint)
    return values, low, high


def stretch_of(photos: Photos, options: RenderOptions, applied: Sequence[Correction], text: str) -> Stretch:
    """Stretch between two percentiles or two values of the corrected images.

    Parameters
    ----------
    photos : Photos
    options : RenderOptions
        Threads.
    applied : sequence of Correction
        Of all images.
    text : str
        As in `parse_stretch`.

    Returns
    -------
    Stretch

    Raises
    ------
    InputError
        No valid text, or nothing between the ends.
    """
    values, low, high = parse_stretch(text)
    how = "values" if values else f"percentiles {low:g} and {high:g}"
    if not values:
        # Over all bands together: one stretch for all keeps the hues.
        low, high = (float(end) for end in np.percentile(_corrected_values(photos, options, applied), [low, high]))
    if not low < high:
        raise InputError(f"all of the mosaic is {low:g}: it cannot be stretched", hint="leave out `stretch`")
    return Stretch(low, high, how)


def stretched(stretch: Stretch, applied: Sequence[Correction]) -> list[Correction]:
    """Corrections followed by a stretch.

    Parameters
    ----------
    stretch : Stretch
    applied : sequence of Correction
        Of all images.

    Returns
    -------
    list of Correction
    """
    gain = (HIGHEST - LOWEST) / (stretch.high - stretch.low)
    offset = LOWEST - gain * stretch.low
    return [with_gain_offset(colour, gain, offset) for colour in applied]


def _corrected_values(photos: Photos, options: RenderOptions, applied: Sequence[Correction]) -> FloatArray:
    """Corrected values of all images on a coarse grid, all bands together."""
    # From the images before the mosaic is made, so that the stretch goes into each image's correction and the mosaic is
    # still made in one pass.
    grid, parts = comparison_grid(photos), []
    for index, found in map_images(lambda some: ThumbnailOfImage(some, grid), photos, options):
        values = corrected(applied[index], found.values, found.window, grid, photos.grid)
        parts.append(np.asarray(values[found.valid > 0].ravel()))
    values = np.concatenate(parts) if parts else np.zeros(0)
    if not len(values):
        raise InputError("no image shows anything to stretch", hint="leave out `stretch`")
    return values
