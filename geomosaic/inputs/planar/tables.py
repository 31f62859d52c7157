"""Tie and control tables of planar blocks, and their diagnostics."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from pyproj import CRS

from geomosaic.block.block import ControlPoint
from geomosaic.control.coordinate_diagnostics import Diagnostic, misplaced
from geomosaic.control.diagnostics import contradictions
from geomosaic.control.points import ControlPoints, Origin
from geomosaic.errors import GeomosaicWarning, InputError, counted, did_you_mean
from geomosaic.inputs.control_points import ROLES
from geomosaic.inputs.photos import Photo
from geomosaic.inputs.tables import Row, Table, read_table, stem
from geomosaic.orientation.planar.measurements import Control, PlanarBlock, PlanarPhoto, Tie

TIE_COLUMNS = ("id", "image", "col", "row")
OUTSIDE = 0.1
"""Share of an image's longer side by which a measurement may lie outside it."""
CONTROL_COLUMNS = ("id", "x", "y", "image", "col", "row")


def read_block(
    photos: Sequence[Photo], ties: Path | None, control: Path | None
) -> tuple[PlanarBlock, tuple[ControlPoint, ...]]:
    """Tables of a planar block.

    Parameters
    ----------
    photos : sequence of Photo
        Measurements in other images are left out, and a note names those images.
    ties : Path, optional
        Columns id, image, col, row and optionally sigma_px.
    control : Path, optional
        Columns id, x, y, image, col, row and optionally sigma_px, sigma_xy, role (control or check). Others, as z, are
        not looked at.

    Returns
    -------
    block : PlanarBlock
        Check points take no part in it.
    points : tuple of ControlPoint
        Control and check points, to hold the result against; their heights count nothing and are 0.

    Raises
    ------
    InputError
        Names file and line. A measurement far outside its image is one: axes exchanged, another size or unit.
    """
    names = {stem(photo.name): photo.name for photo in photos}
    found: list[Tie] = []
    if ties is not None:
        table = read_table(ties, "tie point table", ",".join(TIE_COLUMNS))
        table.require(*TIE_COLUMNS, what="tie points")
        for row, image in _rows(table, names):
            found.append(Tie(row.text("id"), image, row.number("col"), row.number("row"), _sigma(row), row.where))
    points: list[ControlPoint] = []
    if control is not None:
        table = read_table(control, "control point table", ",".join(CONTROL_COLUMNS))
        table.require(*CONTROL_COLUMNS, what="control points")
        for row, image in _rows(table, names):
            role = (row.values.get("role") or "control").strip().lower()
            if role not in ROLES:
                raise InputError(f"role '{role}' is neither 'control' nor 'check'", where=row.where)
            points.append(
                ControlPoint(
                    id=row.text("id"),
                    xyz=(row.number("x"), row.number("y"), 0.0),
                    image=image,
                    colrow=(row.number("col"), row.number("row")),
                    sigma_xy=row.number("sigma_xy", 0.0),
                    sigma_px=_sigma(row),
                    role=role,
                    where=row.where,
                )
            )
    sizes = {photo.name: photo.info.size for photo in photos}
    for place in ((t.id, t.photo, t.col, t.row, t.where) for t in found):
        _inside(*place, sizes)
    for point in points:
        _inside(point.id, point.image, *point.colrow, point.where, sizes)
    known = [
        Control(p.id, p.xyz[0], p.xyz[1], p.image, *p.colrow, p.sigma_px, p.sigma_xy, p.where)
        for p in points
        if p.role == "control"
    ]
    own = {(point.id, point.photo) for point in known}
    # A control point may stand in the table of ties too, so that it ties photos in which it is not listed as control.
    also = tuple(tie for tie in found if (tie.id, tie.photo) not in own)
    try:
        block = PlanarBlock(tuple(PlanarPhoto(photo.name, photo.info.size) for photo in photos), also, tuple(known))
    except InputError as error:
        files = " or ".join(str(path) for path in (ties, control) if path is not None)
        raise InputError(f"{error.where}: {error.what}", where=files, hint=error.hint) from None
    return block, tuple(points)


def _rows(table: Table, names: dict[str, str]) -> list[tuple[Row, str]]:
    """Rows of the block's images, with the images' full names."""
    found, others = [], dict[str, int]()
    for row in table:
        image = row.text("image")
        name = names.get(stem(image))
        if name is not None:
            found.append((row, name))
        else:
            others[image] = others.get(image, 0) + 1
    if not found:
        image = table.rows[0].text("image")
        raise InputError(
            f"no row is of an image of the block; the first one is of '{image}'",
            where=table.path,
            hint=did_you_mean(stem(image), names) or f"the images are {', '.join(list(names.values())[:4])}",
        )
    if others:
        some = ", ".join(f"{image} ({did_you_mean(stem(image), names) or counted(count, 'row')})"
                         for image, count in list(others.items())[:4])  # fmt: skip
        more = f" and {len(others) - 4} more" if len(others) > 4 else ""
        warnings.warn(
            f"{table.path}: {counted(sum(others.values()), 'row')} of images that are not of the block: {some}{more}",
            GeomosaicWarning,
            stacklevel=3,
        )
    return found


def _inside(name: str, image: str, col: float, row: float, where: str, sizes: Mapping[str, tuple[int, int]]) -> None:
    """Check that a measurement does not lie far outside its image: cropping takes a margin, no more."""
    width, height = sizes[image]
    margin = OUTSIDE * max(width, height)
    if not (-margin <= col <= width + margin and -margin <= row <= height + margin):
        raise InputError(
            f"point '{name}' at col {col:g}, row {row:g} lies outside {image}, which has {width} x {height} pixels",
            where=where,
            hint="col counts to the right and row down, in pixels of the image as it is stored",
        )


def _sigma(row: Row) -> float:
    """Standard deviation in pixels, 1 unless given."""
    sigma = row.number("sigma_px", row.number("sigma", 1.0))
    if sigma <= 0.0:
        raise InputError(f"sigma_px is {sigma:g}", where=row.where, hint="give a positive number of pixels")
    return sigma


def check_control(points: Sequence[ControlPoint], crs: CRS, path: Path | None, policy: str = "stop") -> None:
    """Check of control: coordinates that do not fit their CRS, or contradict each other.

    Parameters
    ----------
    points : sequence of ControlPoint
        Of all photos.
    crs : CRS
        Of their ground coordinates.
    path : Path, optional
        The table, for errors.
    policy : str
        'keep' goes on with such control, and warns; see `geomosaic.inputs.declarations.wrong_policy`.

    Raises
    ------
    InputError
        Names the points, what they look like, and a hint.
    """
    where = "control" if path is None else str(path)
    by_image: dict[str, list[ControlPoint]] = {}
    for point in points:
        by_image.setdefault(point.image, []).append(point)
    once = list({point.id: point for point in points}.values())
    found: list[tuple[str, Diagnostic]] = [(where, advice) for advice in misplaced(image_control(once, crs, where))]
    for image, own in by_image.items():
        # A point measured twice in a photo is another table's matter; the first counts here.
        alone = list({point.id: point for point in reversed(own)}.values())
        found += [(f"{where}, {image}", advice) for advice in contradictions(image_control(alone, crs, where))]
    for at, advice in found:
        if advice.severity == "error":
            what = f"{advice.what} ({advice.code})"
            if policy != "keep":
                hint = f"{advice.hint}; or `insist`, to go on all the same"
                raise InputError(what, where=at, hint=hint)
            warnings.warn(f"{at}: {what}; {advice.hint}", GeomosaicWarning, stacklevel=3)


def image_control(points: Sequence[ControlPoint], crs: CRS, where: str) -> ControlPoints:
    """Control points of an image as arrays, as the diagnostics of `geomosaic.control` take them.

    Parameters
    ----------
    points : sequence of ControlPoint
        No two of one name.
    crs : CRS
        Horizontal CRS of their ground coordinates.
    where : str
        Table, for messages about points that carry no line of their own.

    Returns
    -------
    ControlPoints
        All as enabled control with a sigma of 1 pixel; heights are left out.
    """
    count = len(points)
    return ControlPoints(
        tuple(point.id for point in points),
        np.array([point.colrow for point in points]).reshape(-1, 2),
        np.array([point.xyz[:2] for point in points]).reshape(-1, 2),
        crs,
        np.ones(count),
        ("control",) * count,
        np.ones(count, dtype=bool),
        tuple(_origin(point, where, number) for number, point in enumerate(points, 1)),
    )


def _origin(point: ControlPoint, where: str, number: int) -> Origin:
    """Line of the table, where it is known."""
    line = point.where.rpartition(", line ")[2]
    return Origin(where, int(line), "line") if line.isdigit() else Origin(where, number, "point")
