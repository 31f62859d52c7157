"""How well two images agree along their seam: steps in colour, shift of one against the other, and how it looks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geomosaic.geo.grid import Window
from geomosaic.match.shift import shifts
from geomosaic.mosaicking.blending.block import Blender
from geomosaic.mosaicking.colour.corrections import corrected
from geomosaic.mosaicking.seams.seamlines import Segment
from geomosaic.raster.source import Source
from geomosaic.render.options import RenderOptions
from geomosaic.render.photo import pull
from geomosaic.render.workers import in_order
from geomosaic.resample.warp import Colour
from geomosaic.types import AnyArray, BoolArray

TILE, REACH = 64, 8
"""Pixels: side of the place that is matched, and the largest shift looked for."""
BAND = 8
"""Pixels to both sides of the seam in which colours are compared."""
TOLERANCE = 0.1
"""Image pixels that geometry may err where shifts are measured, to about half of that."""
LEAST, MOST = 20, 400
WORST = 10
"""Places that are shown."""


@dataclass(frozen=True)
class SeamQuality:
    """Of one segment, at its middle; NaN where it cannot be told.

    Attributes
    ----------
    step_before, step_after : float
        Difference of the images' means beside the seam, RMS over bands, in grey values, before and after the balance.
    difference : float
        RMS difference of the balanced images beside the seam: steps, and whatever does not fit.
    shift_col, shift_row : float
        Of the second image's content against the first's, in output pixels; NaN where nothing matches.
    correlation : float
        Of that match.
    """

    step_before: float
    step_after: float
    difference: float
    shift_col: float
    shift_row: float
    correlation: float

    @property
    def mismatch(self) -> float:
        """Length of the shift in output pixels."""
        return float(np.hypot(self.shift_col, self.shift_row))


@dataclass(frozen=True)
class SeamPlace:
    """A place on a seam as both images and the mosaic show it.

    Attributes
    ----------
    segment : int
        Number among the segments.
    window : Window
        Of the output.
    first, second, mosaic : array (rows, cols, bands)
        Corrected values; 0 where not valid.
    """

    segment: int
    window: Window
    first: AnyArray
    second: AnyArray
    mosaic: AnyArray


NOTHING = SeamQuality(*(float("nan"),) * 6)


def most_places(pixels: int) -> int:
    """How many segments of a mosaic of so many pixels are judged: both images of a twentieth of it, 20 to 400."""
    return min(max(pixels // (40 * (TILE + 2 * (REACH + 2)) ** 2), LEAST), MOST)


def judge_seams(blender: Blender, segments: Sequence[Segment], options: RenderOptions) -> list[SeamQuality]:
    """Compare both images in the middle of each segment, as finely as the output."""

    def one(segment: Segment) -> SeamQuality:
        window = _window(blender, segment, TILE + 2 * (REACH + 2))
        if window.empty:
            return NOTHING
        (a, a0, seen_a), (b, b0, seen_b) = (_shown(blender, k, window) for k in (segment.first, segment.second))
        return compare(a, b, a0, b0, seen_a & seen_b, _beside(blender, segment, window))

    found = []
    for done, (_, quality) in enumerate(in_order(one, segments, options.threads)):
        found.append(quality)
        options.report(done + 1, len(segments), "seam quality")
    return found


def compare(a: AnyArray, b: AnyArray, a0: AnyArray, b0: AnyArray, both: BoolArray, near: BoolArray) -> SeamQuality:
    """Compare two images of a place.

    Parameters
    ----------
    a, b : array (rows, cols, bands)
        Balanced values.
    a0, b0 : array (rows, cols, bands)
        Values before.
    both : bool array (rows, cols)
        Pixels that both show.
    near : bool array (rows, cols)
        Pixels beside the seam.
    """
    here = both & near
    if here.sum() < BAND**2:
        return NOTHING
    before, after = ((x[here].astype(np.float64) - y[here]).mean(axis=0) for x, y in ((a0, b0), (a, b)))
    difference = float(np.sqrt(((a[here].astype(np.float64) - b[here]) ** 2).mean()))
    found = shifts(a.mean(axis=2), b.mean(axis=2), both, TILE, REACH)
    col, row, correlation = float("nan"), float("nan"), float("nan")
    if len(found.shifts):
        (col, row), correlation = found.shifts[0].tolist(), float(found.correlation[0])
    step_before, step_after = (float(np.sqrt((step**2).mean())) for step in (before, after))
    return SeamQuality(step_before, step_after, difference, col, row, correlation)


def worst_places(
    blender: Blender, segments: Sequence[Segment], quality: Sequence[SeamQuality], mosaic: Path, side: int = 160
) -> list[SeamPlace]:
    """The places where images differ most beside the seam, worst first, as both and the mosaic show them."""
    known = [k for k, one in enumerate(quality) if np.isfinite(one.difference)]
    found = []
    with Source(str(mosaic)) as source:
        for k in sorted(known, key=lambda k: (-quality[k].difference, k))[:WORST]:
            window = _window(blender, segments[k], side)
            first, second = (_shown(blender, i, window)[0] for i in (segments[k].first, segments[k].second))
            values, valid = source.read(window)
            found.append(SeamPlace(k, window, first, second, values if valid is None else values * valid[..., None]))
    return found


def _window(blender: Blender, segment: Segment, side: int) -> Window:
    middle = segment.line.interpolate(0.5, normalized=True)
    col, row = blender.grid.colrow(np.array([[middle.x, middle.y]]))[0]
    return Window(int(col) - side // 2, int(row) - side // 2, side, side).intersection(blender.grid.window)


def _shown(blender: Blender, index: int, window: Window) -> tuple[AnyArray, AnyArray, BoolArray]:
    """Values of an image after and before its correction, and where there are any; it is pulled once."""
    shape, bands = (window.height, window.width), blender.photos.info.bands
    before, seen = np.zeros((*shape, bands), dtype=np.float32), np.zeros(shape, dtype=np.uint8)
    ground, plain = blender.below.block(window), Colour.identity(bands)
    with blender.photos.using(index) as photo:
        tolerance = max(blender.tolerance, TOLERANCE)
        pull(blender.engine, photo, blender.grid, ground, blender.resampling, tolerance, plain, before, seen)
    after = corrected(blender.colours[index], before, window, blender.grid, blender.grid)
    return np.where(seen[..., None] > 0, after, 0.0).astype(np.float32), before, seen > 0


def _beside(blender: Blender, segment: Segment, window: Window) -> BoolArray:
    """Pixels within `BAND` of the segment."""
    from geomosaic.raster.validity import burn

    return np.asarray(
        burn([(segment.line.buffer(BAND * blender.grid.resolution[0]), 1)], blender.grid.crop(window)) == 1
    )
