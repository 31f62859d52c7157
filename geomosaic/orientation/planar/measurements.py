"""Measurements in a block of photos of flat ground: tie points and control points."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

from geomosaic.errors import InputError, did_you_mean


@dataclass(frozen=True)
class PlanarPhoto:
    """Photo of a planar block.

    Attributes
    ----------
    name : str
        Unique in the block.
    size : (int, int)
        Width and height in pixels.
    """

    name: str
    size: tuple[int, int]


@dataclass(frozen=True)
class Tie:
    """Tie point, without known ground coordinates, as measured in one photo.

    Attributes
    ----------
    id : str
        Measurements of one name are of one point. A control point of that name is the same point too.
    photo : str
    col, row : float
        Pixels, corner-based.
    sigma : float
        Standard deviation of each coordinate in pixels.
    where : str
        File and line, for messages.
    """

    id: str
    photo: str
    col: float
    row: float
    sigma: float = 1.0
    where: str = ""


@dataclass(frozen=True)
class Control:
    """Control point, known on the ground, as measured in one photo.

    Attributes
    ----------
    id : str
    x, y : float
        Map coordinates.
    photo : str
    col, row : float
        Pixels, corner-based.
    sigma : float
        Standard deviation of each image coordinate in pixels.
    sigma_xy : float
        Standard deviation of each map coordinate in map units; 0 where they are held fixed.
    where : str
        File and line, for messages.
    """

    id: str
    x: float
    y: float
    photo: str
    col: float
    row: float
    sigma: float = 1.0
    sigma_xy: float = 0.0
    where: str = ""


@dataclass(frozen=True)
class PlanarBlock:
    """Planar block: photos with tie and control points.

    Attributes
    ----------
    photos : tuple of PlanarPhoto
    ties : tuple of Tie
    control : tuple of Control

    Raises
    ------
    InputError
        A photo is unknown or doubled, a point is measured twice in one photo or has two places on the ground, a
        coordinate is no number or a standard deviation is not positive.
    """

    photos: tuple[PlanarPhoto, ...]
    ties: tuple[Tie, ...] = ()
    control: tuple[Control, ...] = ()

    def __post_init__(self) -> None:
        names = [photo.name for photo in self.photos]
        if not names:
            raise InputError("a block needs at least one photo", hint="give photos")
        doubled = next((name for name, count in Counter(names).items() if count > 1), None)
        if doubled is not None:
            raise InputError(f"two photos share the name '{doubled}'", hint="name each photo once")
        known, measured, ground = set(names), dict[tuple[str, str], str](), dict[str, tuple[float, float, float]]()
        for point in self.measurements:
            where = f"point '{point.id}' in '{point.photo}'"
            if point.photo not in known:
                raise InputError("the photo is not in the block", where=where, hint=did_you_mean(point.photo, known))
            _numbers(point, where)
            if (point.id, point.photo) in measured:
                lines = [one for one in (measured[point.id, point.photo], point.where) if one]
                lines_of = f" ({' and '.join(lines)})" if lines else ""
                raise InputError(
                    f"the point is measured twice in this photo{lines_of}", where=where, hint="keep one of them"
                )
            measured[point.id, point.photo] = point.where
            if isinstance(point, Control):
                place = (point.x, point.y, point.sigma_xy)
                if ground.setdefault(point.id, place) != place:
                    raise InputError(
                        "the control point has other ground coordinates elsewhere",
                        where=where,
                        hint="one point has one place; rename one of them",
                    )

    @property
    def measurements(self) -> tuple[Tie | Control, ...]:
        """All points as measured in the photos: ties, then control."""
        return (*self.ties, *self.control)

    @cached_property
    def by_photo(self) -> dict[str, dict[str, Tie | Control]]:
        """Measurements by photo, then by point."""
        found: dict[str, dict[str, Tie | Control]] = {photo.name: {} for photo in self.photos}
        for measured in self.measurements:
            found[measured.photo][measured.id] = measured
        return found

    @cached_property
    def sharing(self) -> dict[str, list[str]]:
        """Photos that show each point, in the order of the block."""
        found: dict[str, list[str]] = {}
        for photo, own in self.by_photo.items():
            for point in own:
                found.setdefault(point, []).append(photo)
        return found

    @cached_property
    def index(self) -> dict[str, int]:
        """Number of each photo."""
        return {photo.name: i for i, photo in enumerate(self.photos)}

    def photo(self, name: str) -> PlanarPhoto:
        """Photo of a name."""
        return self.photos[self.index[name]]

    def part(self, names: Iterable[str]) -> PlanarBlock:
        """Block of some of the photos, with what is measured in them."""
        wanted = set(names)
        return PlanarBlock(
            tuple(photo for photo in self.photos if photo.name in wanted),
            tuple(tie for tie in self.ties if tie.photo in wanted),
            tuple(point for point in self.control if point.photo in wanted),
        )


def _numbers(point: Tie | Control, where: str) -> None:
    values = [point.col, point.row, point.sigma]
    if isinstance(point, Control):
        values += [point.x, point.y, point.sigma_xy]
        if point.sigma_xy < 0.0:
            raise InputError("the standard deviation on the ground is negative", where=where, hint="0 holds it fixed")
    if not all(map(math.isfinite, values)):
        raise InputError(
            "a coordinate or standard deviation is not a finite number",
            where=where,
            hint="correct it, or leave the point out",
        )
    if point.sigma <= 0.0:
        raise InputError("the standard deviation in the image is not positive", where=where, hint="give pixels, as 0.5")
