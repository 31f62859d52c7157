"""Seamlines in segments, and how well the two images of each agree: colour step, difference and shift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.geo.grid import Window
from geomosaic.matching.shifts import shifts
from geomosaic.mosaicking.blending.block import Blender
from geomosaic.mosaicking.colour.corrections import corrected
from geomosaic.options.render import RenderOptions
from geomosaic.raster.source import Source
from geomosaic.render.regions import map_by_regions
from geomosaic.resample.warp import Colour, Target
from geomosaic.types import AnyArray, BoolArray

# Distance in pixels within which edges of two shares coincide, despite rounding in the overlay.
SNAP = 1e-5


@dataclass(frozen=True)
class Segment:
    """Segment of the seam between two images.

    Attributes
    ----------
    first, second : int
        Numbers of the images, first < second.
    number : int
        Among the segments between these two, from 1, from west to east.
    line : LineString
        In the output map.
    """

    first: int
    second: int
    number: int
    line: Any


def seam_segments(shares: Sequence[Any], pixel: float, longest: float) -> list[Segment]:
    """Segments of the seams between all shares, of equal length along each seam.

    Parameters
    ----------
    shares : sequence of Polygon or MultiPolygon
        One per image; they share no area.
    pixel : float
        Size of a pixel in map units.
    longest : float
        Largest length of a segment in map units; infinite for whole seams.

    Returns
    -------
    list of Segment
        By number of the first image, of the second, and of the segment.
    """
    import shapely

    snap = SNAP * pixel
    tree = shapely.STRtree(list(shares))
    found = []
    for i, share in enumerate(shares):
        if share.is_empty:
            continue
        for j in sorted(int(k) for k in tree.query(share, predicate="dwithin", distance=snap)):
            if j <= i or shares[j].is_empty:
                continue
            common = share.boundary.intersection(shares[j].buffer(snap))
            # Shares that touch in a corner only have a common line too, as long as the tolerance.
            if common.length <= 100 * snap:
                continue
            parts = [part for part in shapely.get_parts(common) if part.geom_type == "LineString"]
            merged = shapely.get_parts(shapely.line_merge(shapely.MultiLineString(parts)))
            lines = sorted((shapely.normalize(part) for part in merged), key=lambda part: part.bounds)
            pieces = [piece for line in lines for piece in _cut(line, longest)]
            found += [Segment(i, j, number, piece) for number, piece in enumerate(pieces, start=1)]
    return found


def _cut(line: Any, longest: float) -> list[Any]:
    from shapely.ops import substring

    # Rounding must not cut a line of n whole lengths into n + 1.
    count = max(1, int(np.ceil(line.length / longest - 1e-9)))
    if count == 1:
        return [line]
    return [substring(line, k / count, (k + 1) / count, normalized=True) for k in range(count)]


# Pixels: side of the tile that is matched, and the largest shift searched for.
TILE, SEARCH = 64, 8
# Pixels to both sides of the seam in which colours are compared.
BAND = 8
# Largest error in image pixels of the interpolated geometry, well below the shifts that are measured.
LATTICE_TOLERANCE = 0.1
MIN_SEGMENTS, MAX_SEGMENTS = 20, 400
# Seam places in the report.
WORST_PLACES = 10


@dataclass(frozen=True)
class SeamQuality:
    """Agreement of two images at the middle of a segment; NaN where it cannot be measured.

    Attributes
    ----------
    step_before, step_after : float
        Difference of the images' means beside the seam, RMS over bands, in grey values, before and after the balance.
    difference : float
        RMS difference of the balanced images beside the seam: colour steps, shifts and whatever else does not fit.
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
    """Place on a seam as both images and the mosaic show it.

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


NOT_MEASURED = SeamQuality(*(float("nan"),) * 6)


def sample_size(pixels: int) -> int:
    """Number of seam segments to measure in a mosaic: both images of a twentieth of its area are rendered again.

    Parameters
    ----------
    pixels : int
        Of the mosaic.

    Returns
    -------
    int
        From `MIN_SEGMENTS` to `MAX_SEGMENTS`.
    """
    return min(max(pixels // (40 * (TILE + 2 * (SEARCH + 2)) ** 2), MIN_SEGMENTS), MAX_SEGMENTS)


def measure_seams(blender: Blender, segments: Sequence[Segment], options: RenderOptions) -> list[SeamQuality]:
    """Agreement of both images in the middle of each segment, at the resolution of the output.

    Parameters
    ----------
    blender : Blender
    segments : sequence of Segment
    options : RenderOptions
        Threads and progress.

    Returns
    -------
    list of SeamQuality
        One per segment.
    """
    found, images = [], len(blender.photos)
    measured = map_by_regions(
        lambda near: partial(_measured, blender if near is None else blender.only(near)), segments,
        lambda segment: (segment.first, segment.second), images, options,
    )  # fmt: skip
    for done, (_, quality) in enumerate(measured):
        found.append(quality)
        options.report(done + 1, len(segments), "seam quality")
    return found


def _measured(blender: Blender, segment: Segment) -> SeamQuality:
    """Agreement of both images in the middle of a segment."""
    # The tile, and room on all sides for the search.
    window = _window(blender, segment, TILE + 2 * (SEARCH + 2))
    if window.empty:
        return NOT_MEASURED
    (a, a0, seen_a), (b, b0, seen_b) = (
        _values_before_and_after(blender, k, window) for k in (segment.first, segment.second)
    )
    return _compare_images(a, b, a0, b0, seen_a & seen_b, _seam_band(blender, segment, window))


def _compare_images(
    a: AnyArray, b: AnyArray, a0: AnyArray, b0: AnyArray, both: BoolArray, near: BoolArray
) -> SeamQuality:
    """Agreement of two images (rows, cols, bands), balanced and before: step and difference beside the seam, shift.

    `NOT_MEASURED` where fewer than `BAND`² pixels beside the seam are shown by both.
    """
    here = both & near
    if here.sum() < BAND**2:
        return NOT_MEASURED
    before, after = ((x[here].astype(np.float64) - y[here]).mean(axis=0) for x, y in ((a0, b0), (a, b)))
    difference = float(np.sqrt(((a[here].astype(np.float64) - b[here]) ** 2).mean()))
    found = shifts(a.mean(axis=2), b.mean(axis=2), both, TILE, SEARCH)
    col, row, correlation = float("nan"), float("nan"), float("nan")
    if len(found.shifts):
        (col, row), correlation = found.shifts[0].tolist(), float(found.correlation[0])
    step_before, step_after = (float(np.sqrt((step**2).mean())) for step in (before, after))
    return SeamQuality(step_before, step_after, difference, col, row, correlation)


def worst_places(
    blender: Blender, segments: Sequence[Segment], quality: Sequence[SeamQuality], mosaic: Path, side: int = 160
) -> list[SeamPlace]:
    """Seam places of the largest differences, worst first, with what both images and the mosaic show.

    Parameters
    ----------
    blender : Blender
    segments : sequence of Segment
    quality : sequence of SeamQuality
        Of the segments.
    mosaic : Path
    side : int
        Of a place, in output pixels.

    Returns
    -------
    list of SeamPlace
        At most `WORST_PLACES`.
    """
    known = [k for k, one in enumerate(quality) if np.isfinite(one.difference)]
    found = []
    with Source(str(mosaic)) as source:
        for k in sorted(known, key=lambda k: (-quality[k].difference, k))[:WORST_PLACES]:
            window = _window(blender, segments[k], side)
            first, second = (
                _values_before_and_after(blender, i, window)[0] for i in (segments[k].first, segments[k].second)
            )
            values, valid = source.read(window)
            found.append(SeamPlace(k, window, first, second, values if valid is None else values * valid[..., None]))
    return found


def _window(blender: Blender, segment: Segment, side: int) -> Window:
    middle = segment.line.interpolate(0.5, normalized=True)
    col, row = blender.grid.colrow(np.array([[middle.x, middle.y]]))[0]
    return Window(int(col) - side // 2, int(row) - side // 2, side, side).intersection(blender.grid.window)


def _values_before_and_after(blender: Blender, index: int, window: Window) -> tuple[AnyArray, AnyArray, BoolArray]:
    """Values of an image after and before its correction, and where they are valid; resampled once."""
    shape, bands = (window.height, window.width), blender.photos.info.bands
    before, seen = np.zeros((*shape, bands), dtype=np.float32), np.zeros(shape, dtype=np.uint8)
    ground, plain = blender.ground.block(window), Colour.identity(bands)
    with blender.photos.using(index) as photo:
        rectifier = replace(blender.rectifier, tolerance=max(blender.rectifier.tolerance, LATTICE_TOLERANCE))
        rectifier.fill(photo, ground, plain, Target(before, seen))
    after = corrected(blender.colours[index], before, window, blender.grid, blender.grid)
    return np.where(seen[..., None] > 0, after, 0.0).astype(np.float32), before, seen > 0


def _seam_band(blender: Blender, segment: Segment, window: Window) -> BoolArray:
    """Pixels within `BAND` of the segment."""
    from geomosaic.raster.validity import rasterized

    return np.asarray(
        rasterized([(segment.line.buffer(BAND * blender.grid.resolution[0]), 1)], blender.grid.crop(window)) == 1
    )
