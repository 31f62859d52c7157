"""Hypotheses on orientation tables: other readings of the same numbers, the likeliest first.

None of these is ever applied: `orientation_plausibility.py` tests them and proposes the one that fits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from pyproj import CRS

from geomosaic.geo.crs import horizontal
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.exterior_orientation import MATRIX, SYSTEMS, TO_DEGREES
from geomosaic.inputs.images import Photo
from geomosaic.surface.model import undulation

_Angles = dict[str, float]

_TILTS: Mapping[str, tuple[str, str]] = {
    "opk": ("omega", "phi"),
    "pok": ("omega", "phi"),
    "rpy": ("roll", "pitch"),
    "dji": ("gimbal_roll", "gimbal_pitch"),
}
_HEADING: Mapping[str, str] = {"opk": "kappa", "pok": "kappa", "rpy": "yaw", "dji": "gimbal_yaw"}
# North that a system's angles refer to unless declared; 'grid' for all others.
_NORTH: Mapping[str, str] = {"rpy": "local", "dji": "local"}


@dataclass(frozen=True)
class Hypothesis:
    """Hypothesis on an orientation table: one way to read it.

    Attributes
    ----------
    what : str
        The difference, as it follows 'with'.
    hint : str
        Key to set or column to change.
    inputs : Block
        Inputs with that key.
    photos : tuple of Photo
        Photos with those columns.
    """

    what: str
    hint: str
    inputs: Block
    photos: tuple[Photo, ...]


def hypotheses(inputs: Block, photos: Sequence[Photo], crs: CRS) -> Iterator[Hypothesis]:
    """Other readings of the orientations of some photos: those that one key of the project sets come first.

    Parameters
    ----------
    inputs : Block
        Inputs as declared.
    photos : sequence of Photo
        Photos with their rows of the table.
    crs : CRS
        CRS of the positions.

    Yields
    ------
    Hypothesis
    """
    several = tuple(photos)
    # In the order of likelihood: the tests take the first of those that fit about as well.
    yield from _by_key(inputs, several)
    yield from _by_datum(inputs, several, crs)
    yield from _by_column(inputs, several)
    yield from _by_height(inputs, several, crs)


def _by_key(inputs: Block, photos: tuple[Photo, ...]) -> Iterator[Hypothesis]:
    if inputs.angles not in SYSTEMS:
        return
    unit, north = inputs.angle_unit or "deg", inputs.angle_frame or _NORTH.get(inputs.angles, "grid")
    if inputs.angles in _HEADING:
        for other in TO_DEGREES:
            if other != unit:
                yield Hypothesis(
                    f"angles in {other}", f"set angle_unit = '{other}'", replace(inputs, angle_unit=other), photos
                )
    for system, columns in SYSTEMS.items():
        if system != inputs.angles and {*columns} == {*SYSTEMS[inputs.angles]} and inputs.angles in _HEADING:
            yield Hypothesis(
                f"angle system {system}", f"set angles = '{system}'", replace(inputs, angles=system), photos
            )
    if inputs.matrix is not None and inputs.angles not in _HEADING:
        other = "image_to_ground" if inputs.matrix == "ground_to_image" else "ground_to_image"
        yield Hypothesis(
            "the matrix the other way round", f"set matrix = '{other}'", replace(inputs, matrix=other), _bare(photos)
        )
    other = "local" if north == "grid" else "grid"
    words = "true north" if other == "local" else "grid north"
    yield Hypothesis(f"angles from {words}", f"set angle_frame = '{other}'", replace(inputs, angle_frame=other), photos)


def _by_datum(inputs: Block, photos: tuple[Photo, ...], crs: CRS) -> Iterator[Hypothesis]:
    """Heights of the positions from the ellipsoid instead of the geoid, and the other way round."""
    # Geocentric coordinates have no vertical datum.
    if inputs.heights is None or crs.is_geocentric:
        return
    other = "egm96" if inputs.heights == "ellipsoidal" else "ellipsoidal"
    words = "the geoid" if other == "egm96" else "the ellipsoid"
    yield Hypothesis(
        f"heights of the positions from {words}",
        f"set heights = '{other}' under [exterior]; or, where that is right as it is, check heights under [dem]",
        replace(inputs, heights=other),
        photos,
    )


def _by_column(inputs: Block, photos: tuple[Photo, ...]) -> Iterator[Hypothesis]:
    table = inputs.exterior.name if inputs.exterior is not None else "the table"
    half = 180.0 / TO_DEGREES[inputs.angle_unit or "deg"]

    def changed(change: Callable[[_Angles], _Angles]) -> tuple[Photo, ...]:
        return tuple(_with_angles(photo, change(dict(photo.exterior.angles))) for photo in photos if photo.exterior)

    if inputs.angles not in _HEADING:
        # Rotations by 180 degrees about one axis: the three conventions of camera axes that are still right-handed.
        for signs, what in (
            ((1.0, -1.0, -1.0), "camera axes x right, y down, z forward"),
            ((-1.0, -1.0, 1.0), "the images turned by 180 degrees"),
            ((-1.0, 1.0, -1.0), "camera axes x left, y up, z forward"),
        ):
            # Camera axes are the rows of a matrix ground to image, into which printed lists are brought on reading.
            by_row = inputs.angles == "printed" or inputs.matrix == "ground_to_image"
            lines = [str(i + 1) for i, sign in enumerate(signs) if sign < 0]
            where = f"{'rows' if by_row else 'columns'} {' and '.join(lines)} of the matrix"
            yield Hypothesis(
                what,
                f"set axes = '{_turned_axes(inputs.printed.axes, signs)}' under [exterior.printed]"
                if inputs.printed is not None
                else f"change the signs of {where} in {table}",
                inputs,
                changed(partial(_signed, signs=signs, by_row=by_row)),
            )
        return
    turn, (first, second) = _HEADING[inputs.angles], _TILTS[inputs.angles]

    def reverse(*names: str) -> Callable[[_Angles], _Angles]:
        return lambda angles: {name: -value if name in names else value for name, value in angles.items()}

    def add(name: str, by: float) -> Callable[[_Angles], _Angles]:
        return lambda angles: {**angles, name: math.remainder(angles[name] + by, 2.0 * half)}

    named = f"in {table}"
    steps: list[tuple[str, str, Callable[[_Angles], _Angles]]] = [
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
        yield Hypothesis(what, hint, inputs, changed(change))


def _by_height(inputs: Block, photos: tuple[Photo, ...], crs: CRS) -> Iterator[Hypothesis]:
    """Positions off by the geoid's height: with control, whose datum they share, the declared datum may be right."""
    if inputs.control is None or crs.is_geocentric or not photos or photos[0].exterior is None:
        return
    x, y, _ = photos[0].exterior.position
    shift = undulation(horizontal(crs), x, y)
    if not math.isfinite(shift) or abs(shift) < 1.0:
        return
    table = inputs.exterior.name if inputs.exterior is not None else "the table"
    for by in (shift, -shift):
        yield Hypothesis(
            f"flying heights {'raised' if by > 0 else 'lowered'} by the geoid's {abs(shift):.1f} m",
            f"add {by:+.1f} m to z in {table}: its heights have another vertical datum than the control points",
            inputs,
            tuple(_raised(photo, by) for photo in photos),
        )


def _turned_axes(axes: str, signs: tuple[float, float, float]) -> str:
    """Declared image axes, reversed along x (right, left) and y (up, down) of the picture where the sign is -1."""
    other = {"right": "left", "left": "right", "up": "down", "down": "up"}
    turned = {word for words, sign in zip((("right", "left"), ("up", "down")), signs, strict=False) if sign < 0
              for word in words}  # fmt: skip
    return " ".join(other[word] if word in turned else word for word in axes.lower().split())


def _with_angles(photo: Photo, angles: _Angles) -> Photo:
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


def _signed(angles: _Angles, signs: tuple[float, float, float], by_row: bool) -> _Angles:
    """Elements of a matrix with other signs of its rows or columns."""
    return {
        f"r{row}{col}": angles[f"r{row}{col}"] * signs[(row if by_row else col) - 1]
        for row in (1, 2, 3)
        for col in (1, 2, 3)
    }
