"""Hypotheses on implausible orientations: other readings, each with the similarity of the overlaps that it leads to.

None of these is ever applied: `plausibility.py` tests them against the evidence and proposes the one that fits.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from pyproj import CRS

from geomosaic.block.block import OrientedImage
from geomosaic.errors import GeomosaicError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.exterior_orientation import MATRIX, SYSTEMS, TO_DEGREES
from geomosaic.inputs.photos import Photo
from geomosaic.raster.pictures import preview
from geomosaic.sensor.solve.inverse import image_to_ground
from geomosaic.surface.model import Surface, undulation
from geomosaic.types import BoolArray, FloatArray

SIDE = 240
"""Longer side of the small copies, pixels."""
EVERY = 5
"""Pixels of a small copy between places that are compared."""
REACH = 2
"""Pixels of a small copy by which the pictures may lie off each other."""
AROUND = 4
"""Pixels of a small copy on each side of one that it is compared with to see what stands out."""
FEWEST = 120
"""Places that must be seen in both."""


@dataclass(frozen=True)
class ReducedImage:
    """Reduced image, each pixel less the mean of its surroundings.

    Attributes
    ----------
    detail : array (rows, cols)
        Grey minus its local mean, over its local deviation; 0 where nothing is known.
    valid : array (rows, cols)
    """

    detail: FloatArray
    valid: BoolArray


def reduced_image(path: str) -> ReducedImage:
    """Reduced copy of an image, its grey values normalised by local mean and deviation.

    Parameters
    ----------
    path : str

    Returns
    -------
    ReducedImage
        At most `SIDE` pixels along the longer side.
    """
    rgb, valid = preview(path, SIDE)
    grey = rgb.mean(axis=2, dtype=np.float64)
    mean = _box_mean(grey)
    spread = np.sqrt(np.maximum(_box_mean(grey * grey) - mean * mean, 1.0))
    return ReducedImage((grey - mean) / spread, valid != 0)


def _box_mean(values: FloatArray) -> FloatArray:
    """Mean of 9 x 9 pixels about each pixel; edges repeat."""
    sums = np.pad(values, ((AROUND + 1, AROUND), (AROUND + 1, AROUND)), mode="edge")
    sums[0], sums[:, 0] = 0.0, 0.0
    sums = sums.cumsum(axis=0).cumsum(axis=1)
    n = 2 * AROUND + 1
    mean: FloatArray = (sums[n:, n:] - sums[:-n, n:] - sums[n:, :-n] + sums[:-n, :-n]) / n**2
    return mean


def correlation_of_pair(
    first: OrientedImage, second: OrientedImage, copies: tuple[ReducedImage, ReducedImage], surface: Surface
) -> float:
    """Correlation of the details of two images where both show the same ground.

    Places of a lattice in the first image go to the surface and from there into the second. The largest correlation
    over small shifts is taken, since orientations may be rough.

    Parameters
    ----------
    first, second : OrientedImage
    copies : (ReducedImage, ReducedImage)
        Their reduced copies.
    surface : Surface

    Returns
    -------
    float
        0 to 1; 0 where fewer than `FEWEST` places are shown by both.
    """
    here, there = copies
    rows, cols = here.detail.shape
    c, r = (v.ravel() for v in np.meshgrid(np.arange(EVERY, cols, EVERY), np.arange(EVERY, rows, EVERY)))
    scale = np.array(first.model.size) / (cols, rows)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            ground = image_to_ground(first.model, (np.column_stack([c, r]) + 0.5) * scale, surface)
            seen = second.model.ground_to_image(Transform(surface.crs, second.model.crs)(ground))
    except GeomosaicError:
        return 0.0
    place = seen / (np.array(second.model.size) / there.detail.shape[::-1]) - 0.5
    limit = np.array(there.detail.shape[::-1]) - 1 - REACH
    good = np.isfinite(place).all(axis=1) & (place >= REACH).all(axis=1) & (place <= limit).all(axis=1)
    good &= here.valid[r, c]
    if np.count_nonzero(good) < FEWEST:
        return 0.0
    values, at = here.detail[r[good], c[good]], np.rint(place[good]).astype(np.int64)
    best = 0.0
    for down in range(-REACH, REACH + 1):
        for right in range(-REACH, REACH + 1):
            col, row = at[:, 0] + right, at[:, 1] + down
            known = there.valid[row, col]
            if np.count_nonzero(known) >= FEWEST:
                best = max(best, _correlation(values[known], there.detail[row[known], col[known]]))
    return best


def neighbours(places: FloatArray, pairs: int) -> list[tuple[int, int]]:
    """Pairs of nearest photos, spread over the block.

    Parameters
    ----------
    places : array (N, 2)
        Positions in one map CRS; NaN for those not known.
    pairs : int
        At most so many.

    Returns
    -------
    list of (int, int)
        Indices of each pair, the lower first.
    """
    found: dict[tuple[int, int], None] = {}
    for first in np.unique(np.linspace(0, len(places) - 1, pairs).round().astype(int)):
        distance = np.hypot(*(places - places[first]).T)
        distance[first] = np.inf
        second = int(np.argmin(distance))
        if np.isfinite(distance[second]):
            found[min(int(first), second), max(int(first), second)] = None
    return list(found)


def together(scenes: Sequence[OrientedImage], copies: Sequence[ReducedImage], surface: Surface) -> float:
    """Median correlation of pairs of images.

    Parameters
    ----------
    scenes : sequence of OrientedImage
        The first pairs with the second, the third with the fourth, and so on.
    copies : sequence of ReducedImage
        In the order of the scenes.
    surface : Surface

    Returns
    -------
    float
        0 to 1; 0 without pairs.
    """
    each = [
        correlation_of_pair(scenes[i], scenes[i + 1], (copies[i], copies[i + 1]), surface)
        for i in range(0, len(scenes) - 1, 2)
    ]
    return float(np.median(each)) if each else 0.0


def _correlation(a: FloatArray, b: FloatArray) -> float:
    a, b = a - a.mean(), b - b.mean()
    both = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / both if both > 0.0 else 0.0


Angles = dict[str, float]

TILTS: Mapping[str, tuple[str, str]] = {
    "opk": ("omega", "phi"),
    "pok": ("omega", "phi"),
    "rpy": ("roll", "pitch"),
    "dji": ("gimbal_roll", "gimbal_pitch"),
}
HEADING: Mapping[str, str] = {"opk": "kappa", "pok": "kappa", "rpy": "yaw", "dji": "gimbal_yaw"}
NORTH: Mapping[str, str] = {"rpy": "local", "dji": "local"}
"""North that a system's angles refer to unless declared; 'grid' for all others."""


@dataclass(frozen=True)
class Reading:
    """Hypothesis on an orientation table: one way to read it.

    Attributes
    ----------
    what : str
        Follows 'with': what would be different.
    hint : str
        The key to set, or the column to change.
    inputs : Block
        With that key.
    photos : tuple of Photo
        With those columns.
    """

    what: str
    hint: str
    inputs: Block
    photos: tuple[Photo, ...]


def readings(inputs: Block, photos: Sequence[Photo], crs: CRS) -> Iterator[Reading]:
    """Other readings of the orientations of some photos: those that one key of the project sets come first.

    Parameters
    ----------
    inputs : Block
        As declared.
    photos : sequence of Photo
        Those to read otherwise, with their rows of the table.
    crs : CRS
        Of the positions.
    """
    several = tuple(photos)
    yield from _by_key(inputs, several)
    yield from _by_datum(inputs, several, crs)
    yield from _by_column(inputs, several)
    yield from _by_height(inputs, several, crs)


def _by_key(inputs: Block, photos: tuple[Photo, ...]) -> Iterator[Reading]:
    if inputs.angles not in SYSTEMS:
        return
    unit, north = inputs.angle_unit or "deg", inputs.angle_frame or NORTH.get(inputs.angles, "grid")
    if inputs.angles in HEADING:
        for other in TO_DEGREES:
            if other != unit:
                yield Reading(
                    f"angles in {other}", f"set angle_unit = '{other}'", replace(inputs, angle_unit=other), photos
                )
    for system, columns in SYSTEMS.items():
        if system != inputs.angles and {*columns} == {*SYSTEMS[inputs.angles]} and inputs.angles in HEADING:
            yield Reading(f"angle system {system}", f"set angles = '{system}'", replace(inputs, angles=system), photos)
    if inputs.matrix is not None and inputs.angles not in HEADING:
        other = "image_to_ground" if inputs.matrix == "ground_to_image" else "ground_to_image"
        yield Reading(
            "the matrix the other way round", f"set matrix = '{other}'", replace(inputs, matrix=other), _bare(photos)
        )
    other = "local" if north == "grid" else "grid"
    words = "true north" if other == "local" else "grid north"
    yield Reading(f"angles from {words}", f"set angle_frame = '{other}'", replace(inputs, angle_frame=other), photos)


def _by_datum(inputs: Block, photos: tuple[Photo, ...], crs: CRS) -> Iterator[Reading]:
    """Heights of the positions from the ellipsoid instead of the geoid, and the other way round."""
    if inputs.heights is None or crs.is_geocentric:
        return
    other = "egm96" if inputs.heights == "ellipsoidal" else "ellipsoidal"
    words = "the geoid" if other == "egm96" else "the ellipsoid"
    yield Reading(
        f"heights of the positions from {words}",
        f"set heights = '{other}' under [exterior]; or, where that is right as it is, check heights under [dem]",
        replace(inputs, heights=other),
        photos,
    )


def _by_column(inputs: Block, photos: tuple[Photo, ...]) -> Iterator[Reading]:
    table = inputs.exterior.name if inputs.exterior is not None else "the table"
    half = 180.0 / TO_DEGREES[inputs.angle_unit or "deg"]

    def changed(change: Callable[[Angles], Angles]) -> tuple[Photo, ...]:
        return tuple(_with_angles(photo, change(dict(photo.exterior.angles))) for photo in photos if photo.exterior)

    if inputs.angles not in HEADING:
        for signs, what in (
            ((1.0, -1.0, -1.0), "camera axes x right, y down, z forward"),
            ((-1.0, -1.0, 1.0), "the images turned by 180 degrees"),
            ((-1.0, 1.0, -1.0), "camera axes x left, y up, z forward"),
        ):
            by_row = inputs.angles == "printed" or inputs.matrix == "ground_to_image"
            lines = [str(i + 1) for i, sign in enumerate(signs) if sign < 0]
            where = f"{'rows' if by_row else 'columns'} {' and '.join(lines)} of the matrix"
            yield Reading(
                what,
                f"set axes = '{_turned_axes(inputs.printed.axes, signs)}' under [exterior.printed]"
                if inputs.printed is not None
                else f"change the signs of {where} in {table}",
                inputs,
                changed(partial(_signed, signs=signs, by_row=by_row)),
            )
        return
    turn, (first, second) = HEADING[inputs.angles], TILTS[inputs.angles]

    def reverse(*names: str) -> Callable[[Angles], Angles]:
        return lambda angles: {name: -value if name in names else value for name, value in angles.items()}

    def add(name: str, by: float) -> Callable[[Angles], Angles]:
        return lambda angles: {**angles, name: math.remainder(angles[name] + by, 2.0 * half)}

    named = f"in {table}"
    steps: list[tuple[str, str, Callable[[Angles], Angles]]] = [
        (
            f"{first} and {second} exchanged",
            f"exchange the names {first} and {second} in the header of {table}",
            lambda angles: {**angles, first: angles[second], second: angles[first]},
        ),
        (f"{turn} 180 degrees about", f"add half a circle to {turn} {named}", add(turn, half)),
        (f"{turn} of the other sense", f"change the sign of {turn} {named}", reverse(turn)),
        (
            f"{first} and {second} of the other sense",
            f"change the signs of {first} and {second} {named}",
            reverse(first, second),
        ),
        (
            "all angles of the other sense",
            f"change the signs of {first}, {second} and {turn} {named}",
            reverse(first, second, turn),
        ),
        (f"{first} of the other sense", f"change the sign of {first} {named}", reverse(first)),
        (f"{second} of the other sense", f"change the sign of {second} {named}", reverse(second)),
        (f"{first} turned by 180 degrees", f"add half a circle to {first} {named}", add(first, half)),
    ]
    if inputs.angles == "dji":
        steps.append(
            (
                f"{second} counted from straight down",
                f"subtract 90 degrees from {second} {named}",
                add(second, -half / 2),
            )
        )
    for what, hint, change in steps:
        yield Reading(what, hint, inputs, changed(change))


def _by_height(inputs: Block, photos: tuple[Photo, ...], crs: CRS) -> Iterator[Reading]:
    """Positions off by the height of the geoid, where the control points, which share their datum, are right."""
    if inputs.control is None or crs.is_geocentric or not photos or photos[0].exterior is None:
        return
    x, y, _ = photos[0].exterior.position
    shift = undulation(horizontal(crs), x, y)
    if not math.isfinite(shift) or abs(shift) < 1.0:
        return
    table = inputs.exterior.name if inputs.exterior is not None else "the table"
    for by in (shift, -shift):
        yield Reading(
            f"flying heights {'raised' if by > 0 else 'lowered'} by the geoid's {abs(shift):.1f} m",
            f"add {by:+.1f} m to z in {table}: its heights have another vertical datum than the control points",
            inputs,
            tuple(_raised(photo, by) for photo in photos),
        )


def _turned_axes(axes: str, signs: tuple[float, float, float]) -> str:
    """Declared axes of the image with those along x (right, left) and y (up, down) of the picture turned round."""
    other = {"right": "left", "left": "right", "up": "down", "down": "up"}
    turned = {word for words, sign in zip((("right", "left"), ("up", "down")), signs, strict=False) if sign < 0
              for word in words}  # fmt: skip
    return " ".join(other[word] if word in turned else word for word in axes.lower().split())


def _with_angles(photo: Photo, angles: Angles) -> Photo:
    return replace(photo, exterior=replace(photo.exterior, angles=angles)) if photo.exterior else photo


def _raised(photo: Photo, by: float) -> Photo:
    if photo.exterior is None:
        return photo
    x, y, z = photo.exterior.position
    return replace(photo, exterior=replace(photo.exterior, position=(x, y, z + by)))


def _bare(photos: tuple[Photo, ...]) -> tuple[Photo, ...]:
    """Photos with the matrix alone: printed angles would contradict any other reading of it."""
    return tuple(
        _with_angles(photo, {key: photo.exterior.angles[key] for key in MATRIX}) for photo in photos if photo.exterior
    )


def _signed(angles: Angles, signs: tuple[float, float, float], by_row: bool) -> Angles:
    """Elements of a matrix with other signs of its rows or columns."""
    return {
        f"r{row}{col}": angles[f"r{row}{col}"] * signs[(row if by_row else col) - 1]
        for row in (1, 2, 3)
        for col in (1, 2, 3)
    }
