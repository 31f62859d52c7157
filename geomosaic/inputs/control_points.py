"""Control, check and tie points from tables: one row per image measurement."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint
from geomosaic.control.coordinate_diagnostics import Diagnostic, misplaced
from geomosaic.control.diagnostics import contradictions
from geomosaic.control.points import ControlPoints, Origin, mean_sigmas, possible_covariances
from geomosaic.control.table import FLAGS
from geomosaic.errors import InputError, counted, did_you_mean, listed, warn
from geomosaic.image_names import file_name, stem
from geomosaic.inputs.images import Photo
from geomosaic.inputs.tables import Row, Table, read_table
from geomosaic.inputs.tie_points import covariances_of
from geomosaic.orientation.planar.measurements import Control, PlanarBlock, PlanarPhoto, Tie
from geomosaic.types import FloatArray, PathLike

COLUMNS = ("id", "x", "y", "z", "image", "col", "row")
_ROLES = ("control", "check")
# Columns of the covariance of an image position, as tables of tie points have them.
SIGMAS_OF_POSITION = ("sigma_col", "sigma_row", "correlation")
# Columns of an accuracy that differs between axes, or is correlated: block adjustment alone uses it.
SIGMAS_OF_AXES = ("sigma_x", "sigma_y")
CORRELATIONS = ("cor_x_y", "cor_x_z", "cor_y_z")
# Least eigenvalue of correlations: below it one coordinate would follow from the others.
_POSITIVE = 1e-6


def read_control(
    path: PathLike, images: Sequence[str], *, partial: bool = False, plane: bool = False
) -> tuple[ControlPoint, ...]:
    """Control points of a table.

    Parameters
    ----------
    path : path-like
        Text with the columns id, x, y, z, image, col, row and optionally sigma_xy, sigma_z (metres), sigma_px, or
        sigma_col, sigma_row and correlation, role, enabled; with `partial` also sigma_x and sigma_y in place of
        sigma_xy, and cor_x_y, cor_x_z, cor_y_z.
        Image coordinates in pixels, corner-based: (0.5, 0.5) is the centre of the upper-left pixel.
        Or OpenDroneMap's list.
    images : sequence of str
        Names of the block's images; measurements in other images are left out.
    partial : bool
        Whether points may be known in plan or in height alone: an empty coordinate, or one whose sigma is 'inf', is not
        given; its sigma is infinite, and NaN stands for an empty one.
    plane : bool
        Whether models know no heights: the column z may be missing or empty, and 0 stands for it.

    Returns
    -------
    tuple of ControlPoint

    Raises
    ------
    InputError
        Names file and line.
    """
    return control_and_others(path, images, partial=partial, plane=plane)[0]


def control_and_others(
    path: PathLike, images: Sequence[str], *, partial: bool = False, plane: bool = False
) -> tuple[tuple[ControlPoint, ...], dict[str, int]]:
    """Control points of a table, and the rows of other images that are left out.

    Parameters
    ----------
    path : path-like
    images : sequence of str
    partial, plane : bool
        See `read_control`.

    Returns
    -------
    points : tuple of ControlPoint
    others : dict
        Number of rows by the name of their image, of images that are not of the block.

    Raises
    ------
    InputError
        Names file and line.
    """
    table = _control_table(path)
    table.require(*(_CONTROL_COLUMNS if plane else COLUMNS), what="control points")
    if not partial:
        _refuse_each(table)
    by_stem = {stem(file_name(image)): image for image in images}
    points: list[ControlPoint] = []
    others: dict[str, int] = {}
    ground: dict[str, tuple[tuple[float, float, float], int]] = {}
    measured: dict[tuple[str, str], int] = {}
    for row in table:
        identity, image = row.text("id"), by_stem.get(stem(file_name(row.text("image"))))
        empty = float("nan") if partial else None
        xyz = (row.number("x", empty), row.number("y", empty), row.number("z", 0.0 if plane else empty))
        known = ground.setdefault(identity, (xyz, row.line))
        if not np.array_equal(known[0], xyz, equal_nan=True):
            raise InputError(
                f"point '{identity}' has other coordinates than on line {known[1]}",
                where=row.where,
                hint="correct the coordinates, or rename one of the points",
            )
        role = _role(row)
        if not _enabled(row):
            continue
        if image is None:
            name = file_name(row.text("image"))
            others[name] = others.get(name, 0) + 1
            continue
        first = measured.setdefault((identity, image), row.line)
        if first != row.line:
            raise InputError(
                f"point '{identity}' is measured in {image} already, on line {first}",
                where=row.where,
                hint="keep the one that is right",
            )
        sigma, covariance = _of_position(row, identity, 0.0 if partial else 1.0)
        each, correlations = _accuracy(row, identity, xyz) if partial else (None, (0.0, 0.0, 0.0))
        points.append(
            ControlPoint(
                id=identity,
                xyz=xyz,
                image=image,
                colrow=(row.number("col"), row.number("row")),
                sigma_x_y=each,
                correlations=correlations,
                sigma_xy=_plan_sigma(row, xyz, each) if partial else _sigma(row, "sigma_xy", 0.0),
                sigma_z=_ground_sigma(row, "sigma_z", xyz[2:]) if partial else _sigma(row, "sigma_z", 0.0),
                sigma_px=sigma,
                covariance=covariance,
                role=role,
                where=row.where,
            )
        )
    if ground and not points:
        other = table.rows[0].text("image")
        warn(f"{path}: no point is measured in an image of the block; the table has others, such as '{other}'")
    return tuple(points), others


def _control_table(path: PathLike) -> Table:
    """Table of control points; OpenDroneMap's list has no header, and its points of one place one name."""
    # Imported here: a project is loaded before it reads any control.
    from geomosaic.control.read import is_odm_list, odm_measurements

    if not is_odm_list(path):
        return read_table(path, "control point table", ",".join(COLUMNS))
    rows = []
    for image, point in odm_measurements(path)[1]:
        z = "" if math.isnan(point.xyz[2]) else repr(point.xyz[2])
        values = (point.name, repr(point.xyz[0]), repr(point.xyz[1]), z, image, *map(repr, point.colrow))
        rows.append(Row(str(path), point.origin.number, dict(zip(COLUMNS, values, strict=True))))
    return Table(str(path), COLUMNS, tuple(rows))


def control_values(given: Mapping[str, ControlPoints], crs: CRS, *, partial: bool = False) -> tuple[ControlPoint, ...]:
    """Control points given as values, transformed to a block's CRS.

    Parameters
    ----------
    given : mapping of str to ControlPoints
        Points by image name; those that are not enabled are left out.
    crs : CRS
        CRS of the block.
    partial : bool
        Whether points may be known in plan alone: NaN stands for the height, and its sigma is infinite. Else a point
        without a height lies at 0.

    Returns
    -------
    tuple of ControlPoint
        Ground x, y, z in `crs`, image (col, row) in pixels.
    """
    found = []
    for image, points in given.items():
        xyz = np.full((len(points), 3), np.nan)
        ground = points.to_crs(crs).ground
        xyz[:, : ground.shape[1]] = ground
        xyz = xyz if partial else np.nan_to_num(xyz)
        sigmas = np.zeros((len(points), 3)) if points.sigma_ground is None else points.sigma_ground
        whole = [_matrix(each) for each in points.covariance] if points.covariance is not None else [None] * len(points)
        for index in np.flatnonzero(points.enabled).tolist():
            place, measured = xyz[index].tolist(), points.colrow[index].tolist()
            plan, height = float(np.hypot(*sigmas[index, :2]) / np.sqrt(2.0)), float(sigmas[index, 2])
            found.append(
                ControlPoint(
                    id=points.names[index],
                    xyz=(place[0], place[1], place[2]),
                    image=image,
                    colrow=(measured[0], measured[1]),
                    sigma_xy=plan,
                    sigma_z=height if np.isfinite(place[2]) else math.inf,
                    sigma_px=float(points.sigma[index]),
                    covariance=whole[index],
                    role=points.roles[index],
                    where=str(points.origins[index]),
                )
            )
    return tuple(found)


def _matrix(covariance: FloatArray) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Covariance (2, 2) as plain values; None where it is not told."""
    (xx, xy), (_, yy) = covariance.tolist()
    return ((xx, xy), (xy, yy)) if np.isfinite(covariance).all() else None


def _of_position(
    row: Row, identity: str, default: float
) -> tuple[float, tuple[tuple[float, float], tuple[float, float]] | None]:
    """Standard deviation of an image position, and its covariance where the table has one."""
    along = [_sigma(row, name, 0.0) for name in SIGMAS_OF_POSITION[:2]]
    if not any(along):
        return _sigma(row, "sigma_px", default), None
    covariance = covariances_of(np.array([[*along, row.number("correlation", 0.0)]]))
    if covariance is None or not all(along) or not possible_covariances(covariance)[0]:
        raise InputError(
            f"sigma_col, sigma_row and correlation of point '{identity}' are those of no measurement",
            where=row.where,
            hint="give both sigmas, above 0, and a correlation between -1 and 1; or sigma_px alone",
        )
    return float(mean_sigmas(covariance)[0]), _matrix(covariance[0])


def _role(row: Row) -> str:
    """Role of a point: 'control' unless the table says 'check'."""
    role = (row.values.get("role") or "control").strip().lower()
    if role not in _ROLES:
        raise InputError(
            f"role '{role}' is neither 'control' nor 'check'", where=row.where, hint="write one of them, or nothing"
        )
    return role


def _enabled(row: Row) -> bool:
    """Whether a measurement counts: column 'enabled' is 1, empty or not there."""
    flag = (row.values.get("enabled") or "1").strip().lower()
    if flag not in FLAGS:
        raise InputError(f"column 'enabled' has '{flag}'", where=row.where, hint="write 1 or 0")
    return FLAGS[flag]


def _ground_sigma(row: Row, name: str, coordinates: Sequence[float]) -> float:
    """Standard deviation of coordinates that may be missing; 0 where the table says none."""
    missing = not np.isfinite(coordinates).all()
    return math.inf if missing or row.values.get(name, "").strip() == "inf" else _sigma(row, name, 0.0)


def _plan_sigma(row: Row, xyz: tuple[float, float, float], each: tuple[float, float] | None) -> float:
    """Standard deviation in plan, or the RMS of those of x and y."""
    return math.hypot(*each) / math.sqrt(2.0) if each is not None else _ground_sigma(row, "sigma_xy", xyz[:2])


def _accuracy(
    row: Row, identity: str, xyz: tuple[float, float, float]
) -> tuple[tuple[float, float] | None, tuple[float, float, float]]:
    """Standard deviations of x and y, None where the table has none of their own, and correlations."""
    given = [bool(row.values.get(name, "").strip()) for name in SIGMAS_OF_AXES]
    if any(given) and not all(given):
        raise InputError("one of sigma_x and sigma_y is given", where=row.where, hint="give both, or sigma_xy")
    if all(given) and row.values.get("sigma_xy", "").strip():
        what = f"point '{identity}' has sigma_xy, and sigma_x and sigma_y"
        raise InputError(what, where=row.where, hint="keep one of the two")
    each = (_ground_sigma(row, "sigma_x", xyz[:1]), _ground_sigma(row, "sigma_y", xyz[1:2])) if all(given) else None
    if each is not None and 0.0 in each:
        raise InputError("sigma_x or sigma_y is 0", where=row.where, hint="give metres greater than 0")
    coefficients = [row.number(name, 0.0) for name in CORRELATIONS]
    if not any(coefficients):
        return each, (0.0, 0.0, 0.0)
    plan = _ground_sigma(row, "sigma_xy", xyz[:2]) if each is None else 0.0
    sigmas = (*(each or (plan, plan)), _ground_sigma(row, "sigma_z", xyz[2:]))
    for name, value, axes in zip(CORRELATIONS, coefficients, ((0, 1), (0, 2), (1, 2)), strict=True):
        if value and not all(0.0 < sigmas[axis] < math.inf for axis in axes):
            what = f"point '{identity}' has {name}, and no standard deviations of both coordinates"
            raise InputError(what, where=row.where, hint="give sigma_x, sigma_y and sigma_z, or leave it out")
    matrix = np.eye(3)
    matrix[[0, 0, 1], [1, 2, 2]] = matrix[[1, 2, 2], [0, 0, 1]] = coefficients
    if np.linalg.eigvalsh(matrix)[0] < _POSITIVE:
        raise InputError(
            f"the correlations of point '{identity}' cannot be: {', '.join(map('{:g}'.format, coefficients))}",
            where=row.where,
            hint="give correlations between -1 and 1, no covariances: cor_x_y is the covariance over sigma_x * sigma_y",
        )
    return each, (coefficients[0], coefficients[1], coefficients[2])


def _refuse_each(table: Table) -> None:
    """Check that no table gives an accuracy that only a block adjustment uses."""
    for name in (*SIGMAS_OF_AXES, *CORRELATIONS):
        row = next((row for row in table if row.values.get(name, "").strip()), None)
        if row is not None:
            raise InputError(
                f"column '{name}' would do nothing: block adjustment alone uses it",
                where=row.where,
                hint="give sigma_xy and sigma_z, or adjust the images together ([adjust], `geomosaic adjust`)",
            )


def _sigma(row: Row, name: str, default: float) -> float:
    """Standard deviation; exact ground coordinates have 0, a measurement never."""
    sigma = row.number(name, default)
    if sigma < 0.0 or (name == "sigma_px" and sigma == 0.0 and row.values.get(name, "").strip()):
        raise InputError(
            f"{name} is {sigma:g}",
            where=row.where,
            hint="a standard deviation is greater than 0; leave the field empty where it is not known",
        )
    return sigma


_TIE_COLUMNS = ("id", "image", "col", "row")
# Share of an image's longer side by which a measurement may lie outside it.
_OUTSIDE = 0.1
_CONTROL_COLUMNS = ("id", "x", "y", "image", "col", "row")


def read_block(
    photos: Sequence[Photo], ties: Path | None, control: Path | None
) -> tuple[PlanarBlock, tuple[ControlPoint, ...]]:
    """Planar block of a tie and a control point table.

    Parameters
    ----------
    photos : sequence of Photo
        Measurements in other images are left out with a warning.
    ties : Path, optional
        Table with the columns id, image, col, row and optionally sigma_px.
    control : Path, optional
        Table with the columns id, x, y, image, col, row and optionally sigma_px, sigma_xy, role (control or check).

    Returns
    -------
    block : PlanarBlock
        Without check points.
    points : tuple of ControlPoint
        Control and check points for the assessment, with heights 0.

    Raises
    ------
    InputError
        Names file and line; also where a measurement lies far outside its image.
    """
    names = {stem(photo.name): photo.name for photo in photos}
    found: list[Tie] = []
    if ties is not None:
        table = read_table(ties, "tie point table", ",".join(_TIE_COLUMNS))
        table.require(*_TIE_COLUMNS, what="tie points")
        for row, image in _rows(table, names):
            sigma = _sigma(row, "sigma_px", row.number("sigma", 1.0))
            found.append(Tie(row.text("id"), image, row.number("col"), row.number("row"), sigma, row.where))
    points: list[ControlPoint] = []
    if control is not None:
        table = read_table(control, "control point table", ",".join(_CONTROL_COLUMNS))
        table.require(*_CONTROL_COLUMNS, what="control points")
        _refuse_each(table)
        for row, image in _rows(table, names):
            if not _enabled(row):
                continue
            points.append(
                ControlPoint(
                    id=row.text("id"),
                    xyz=(row.number("x"), row.number("y"), 0.0),
                    image=image,
                    colrow=(row.number("col"), row.number("row")),
                    sigma_xy=row.number("sigma_xy", 0.0),
                    sigma_px=_sigma(row, "sigma_px", row.number("sigma", 1.0)),
                    role=_role(row),
                    where=row.where,
                )
            )
    sizes = {photo.name: photo.info.size for photo in photos}
    for place in ((t.id, t.photo, t.col, t.row, t.where) for t in found):
        _check_in_image(*place, sizes)
    for point in points:
        _check_in_image(point.id, point.image, *point.colrow, point.where, sizes)
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
        text = f"{counted(sum(others.values()), 'row')} of {images_not_of_the_block(others, names)}"
        warn(f"{table.path}: {text}")
    return found


def images_not_of_the_block(others: Mapping[str, int], names: Iterable[str]) -> str:
    """Images that tables have and the block has not, in words, and what to do about them.

    Parameters
    ----------
    others : mapping of str to int
        Number of rows of each.
    names : iterable of str
        Images of the block.
    """
    known = [stem(name) for name in names]
    # Of one name among those of the block it is a slip; several are photos that are not there.
    slip = [did_you_mean(stem(name), known) if len(others) == 1 else "" for name in others]
    some = (
        f"{name} ({hint or counted(count, 'row')})" for (name, count), hint in zip(others.items(), slip, strict=True)
    )
    return (
        f"images that are not of the block: {listed(some, 4)}; correct the names in the table, or add the images to "
        "the block"
    )


def _check_in_image(
    name: str, image: str, col: float, row: float, where: str, sizes: Mapping[str, tuple[int, int]]
) -> None:
    """Check that a measurement does not lie far outside its image."""
    # A photo that was cropped after measuring loses a margin; exchanged axes, another size or unit go farther.
    width, height = sizes[image]
    margin = _OUTSIDE * max(width, height)
    if not (-margin <= col <= width + margin and -margin <= row <= height + margin):
        raise InputError(
            f"point '{name}' at col {col:g}, row {row:g} lies outside {image}, which has {width} x {height} pixels",
            where=where,
            hint="col counts to the right and row down, in pixels of the image as it is stored",
        )


def check_control(points: Sequence[ControlPoint], crs: CRS, path: Path | None, policy: str = "stop") -> None:
    """Check of control: coordinates that do not fit their CRS, or contradict each other.

    Parameters
    ----------
    points : sequence of ControlPoint
        Points of all photos.
    crs : CRS
        CRS of their ground coordinates.
    path : Path, optional
        Table, for errors.
    policy : str
        'keep' goes on with such control, and warns; see `geomosaic.inputs.declarations.blunder_policy`.

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
    found: list[tuple[str, Diagnostic]] = [(where, finding) for finding in misplaced(image_control(once, crs, where))]
    for image, own in by_image.items():
        # Repeated measurements are refused with their line where the block is built; the first counts here.
        alone = list({point.id: point for point in reversed(own)}.values())
        found += [(f"{where}, {image}", finding) for finding in contradictions(image_control(alone, crs, where))]
    for at, finding in found:
        if finding.severity == "error":
            what = f"{finding.what} ({finding.code})"
            if policy != "keep":
                hint = f"{finding.hint}; or `insist`, to go on all the same"
                raise InputError(what, where=at, hint=hint)
            warn(f"{at}: {what}; {finding.hint}")


def image_control(points: Sequence[ControlPoint], crs: CRS, where: str) -> ControlPoints:
    """Control points of an image as arrays, as the diagnostics of `geomosaic.control` take them.

    Parameters
    ----------
    points : sequence of ControlPoint
        Points of different names.
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
