"""Measurements of a block: image positions of tie, control and check points, and the coordinates that were given."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint
from geomosaic.errors import HeightDatumError, InputError, counted, did_you_mean, listed, warn
from geomosaic.geo.crs import has_heights, in_degrees
from geomosaic.geo.transform import Transform
from geomosaic.image_names import file_name, stem
from geomosaic.inputs.control_diagnostics import refuse_misplaced
from geomosaic.inputs.control_points import control_and_others, control_values, images_not_of_the_block
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.tie_points import TiePoints
from geomosaic.inputs.vertical_datums import positions_crs, undeclared_heights_error
from geomosaic.options.adjustment import AdjustmentOptions
from geomosaic.types import BoolArray, FloatArray, IntArray

# Pixels by which a point of the control table may lie beside the tie point of the same name: one of two roundings.
SAME = 1.0
# Share of an image's longer side by which a measurement may lie outside it.
OUTSIDE = 0.1
# Share of the images' size within which the tie points of a block cannot all lie, and the number that tells.
CORNER, MANY = 0.03, 10


@dataclass(frozen=True, eq=False)
class Measurements:
    """Image positions of a block and given coordinates of its points.

    Attributes
    ----------
    ids : tuple of str (S,)
        Of the points.
    image, point : int array (N,)
        Of each image position, sorted by image and point.
    colrow : array (N, 2)
        Pixels.
    covariance : array (N, 2, 2)
        Square pixels.
    given : array (S, 3)
        Given coordinates in the CRS of the ground; NaN where none are.
    sigma_given : array (S, 3)
        Their standard deviations, metres; inf of axes that are not given.
    correlation : array (S, 3, 3)
        Correlations of the given coordinates.
    check : bool array (S,)
        Points whose given coordinates only check the result.
    """

    ids: tuple[str, ...]
    image: IntArray
    point: IntArray
    colrow: FloatArray
    covariance: FloatArray
    given: FloatArray
    sigma_given: FloatArray
    correlation: FloatArray
    check: BoolArray

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations (N,) of the image positions, the mean of both axes, pixels."""
        sigma: FloatArray = np.sqrt(np.trace(self.covariance, axis1=1, axis2=2) / 2.0)
        return sigma

    @property
    def control(self) -> IntArray:
        """Points with given coordinates that take part."""
        return np.flatnonzero(np.isfinite(self.sigma_given).any(axis=1) & ~self.check)

    @property
    def controlled(self) -> IntArray:
        """Images that show a control point."""
        return np.unique(self.image[np.isin(self.point, self.control)])

    @property
    def rays(self) -> IntArray:
        """Number of image positions (S,) of each point."""
        return np.bincount(self.point, minlength=len(self.ids))

    def of_images(self, kept: BoolArray) -> Measurements:
        """Measurements in some images (M,), which are numbered anew, without the points that say nothing then.

        Parameters
        ----------
        kept : bool array (M,)
        """
        mine = kept[self.image]
        rays = np.bincount(self.point[mine], minlength=len(self.ids))
        alone = np.zeros(len(self.ids), dtype=bool)
        alone[self.control] = np.isfinite(self.given[self.control]).all(axis=1)
        there = (rays > 1) | (alone & (rays == 1))
        rows = np.flatnonzero(mine & there[self.point])
        return Measurements(
            tuple(name for name, wanted in zip(self.ids, there.tolist(), strict=True) if wanted),
            (np.cumsum(kept) - 1)[self.image[rows]], (np.cumsum(there) - 1)[self.point[rows]], self.colrow[rows],
            self.covariance[rows], self.given[there], self.sigma_given[there], self.correlation[there],
            self.check[there],
        )  # fmt: skip


def control_of(parts: Sequence[Block], images: Sequence[str], ground: CRS) -> list[ControlPoint]:
    """Control and check points of all parts of a block, in the CRS of the ground.

    Parameters
    ----------
    parts : sequence of Block
        Each table counts for all images.
    images : sequence of str
    ground : CRS
        3-D.

    Returns
    -------
    list of ControlPoint
        NaN stands for coordinates that are not given; a sigma of 0 says that none was.

    Raises
    ------
    InputError
        A table cannot be read, has no CRS, or its coordinates do not fit it.
    """
    found: list[ControlPoint] = []
    read = set()
    for part in parts:
        if part.control is None:
            continue
        if not part.crs:
            raise InputError("the control points have no CRS", where=str(part.control), hint="name it with `crs`")
        crs = positions_crs(part.crs, part.heights)
        if isinstance(part.control, Mapping):
            points = [
                replace(p, sigma_px=0.0 if p.sigma_px == 1.0 else p.sigma_px)
                for p in control_values(part.control, crs, partial=True)
            ]
            where = "`control`"
        else:
            where = str(part.control)
            if (where, part.crs, part.heights) in read:
                continue
            read.add((where, part.crs, part.heights))
            table, others = control_and_others(part.control, images, partial=True)
            if table and others:  # a table without any point is told of by its reader
                text = f"{counted(sum(others.values()), 'measurement')} of control points left out, in "
                text = f"{where}: {text}{images_not_of_the_block(others, images)}"
                warn(text)
            points = list(table)
        whole = [point for point in points if np.isfinite(point.xyz).all()]
        if whole and not part.trusted:
            refuse_misplaced(whole, crs, where)
        if points and not has_heights(crs):
            place = (points[0].xyz[0], points[0].xyz[1])
            raise undeclared_heights_error("the control points", where, "`heights`", crs, place)
        found += _moved(points, crs, ground, where)
    return found


def _moved(points: Sequence[ControlPoint], crs: CRS, ground: CRS, where: str) -> list[ControlPoint]:
    """Control points in the CRS of the ground."""
    if crs == ground or not points:
        return list(points)
    xyz = np.array([point.xyz for point in points])
    if not np.isfinite(xyz).all():
        what = "points that are known in plan or in height alone are in another CRS than the block"
        raise InputError(what, where=where, hint=f"give them in {ground.name}")
    try:
        moved = Transform(crs, ground)(xyz)
    except HeightDatumError as error:
        raise HeightDatumError(error.what, where=where, hint=error.hint) from error
    found = [replace(point, xyz=tuple(place)) for point, place in zip(points, moved.tolist(), strict=True)]
    return [_turned(point, np.array(own.xyz), crs, ground) for point, own in zip(found, points, strict=True)]


def _turned(point: ControlPoint, xyz: FloatArray, crs: CRS, ground: CRS) -> ControlPoint:
    """Control point with the accuracy in plan along the axes of the ground, from those of its table at (3,) there."""
    if point.sigma_x_y is None and not any(point.correlations):
        return point
    if not np.isfinite(point.sigma_x_y or (0.0,)).all():
        what = f"point '{point.id}' is known along one axis of another CRS than the block's"
        raise InputError(what, where=point.where, hint=f"give it in {ground.name}")
    step = np.eye(3)[:2] * (1e-5 if in_degrees(crs) else 1.0)
    along = (Transform(crs, ground)(xyz + step) - Transform(crs, ground)(xyz - step))[:, :2]
    turn = (along / np.linalg.norm(along, axis=1, keepdims=True)).T
    sigma_x, sigma_y = point.sigma_x_y or (point.sigma_xy, point.sigma_xy)
    xy, xz, yz = point.correlations
    covariance = np.array([[sigma_x**2, xy * sigma_x * sigma_y], [xy * sigma_x * sigma_y, sigma_y**2]])
    plan, up = turn @ covariance @ turn.T, turn @ np.array([xz * sigma_x, yz * sigma_y])
    x, y = np.sqrt(np.diag(plan)).tolist()
    return replace(
        point, sigma_x_y=(x, y), correlations=(float(plan[0, 1] / (x * y)), float(up[0] / x), float(up[1] / y))
    )


def measurements(
    images: Mapping[str, tuple[int, int]],
    ties: TiePoints | None,
    control: Sequence[ControlPoint],
    options: AdjustmentOptions,
) -> tuple[Measurements, list[str]]:
    """Measurements of a block, those of no use left out.

    Parameters
    ----------
    images : mapping of str to (int, int)
        Width and height of each image by its name, in order.
    ties : TiePoints, optional
    control : sequence of ControlPoint
        In the CRS of the ground.
    options : AdjustmentOptions
        Standard deviations where none are told.

    Returns
    -------
    measured : Measurements
    notes : list of str
        What was left out.

    Raises
    ------
    InputError
        A point is measured twice in an image or lies outside it, or no measurement is left; names file and line.
    """  # fmt: skip
    names, sizes = list(images), np.array(list(images.values()), dtype=np.float64)
    given = _given(control)
    rows = _rows(names, ties, control, options)
    margin = OUTSIDE * sizes.max(axis=1)[rows.image, None]
    outside = ((rows.colrow < -margin) | (rows.colrow > sizes[rows.image] + margin)).any(axis=1)
    if outside.any():
        row = int(np.argmax(outside))
        image, (col, down) = int(rows.image[row]), rows.colrow[row].tolist()
        raise InputError(
            f"point '{rows.ids[rows.point[row]]}' at col {col:g}, row {down:g} lies outside {names[image]}, which has "
            f"{sizes[image, 0]:g} x {sizes[image, 1]:g} pixels",
            where=rows.origin(row),
            hint="col counts to the right and row down, in pixels of the image as it is stored; no millimetres",
        )
    of_ties = slice(len({(point.image, point.id) for point in control}), None)
    _spread_out(rows.colrow[of_ties], sizes[rows.image[of_ties]])
    return _gathered(rows, given, options)


@dataclass(frozen=True, eq=False)
class _Rows:
    """Measurements one by one: those of the control table first, each in its order.

    Attributes
    ----------
    ids : list of str
        Names of points, in the order in which they appear.
    image, point : int array (N,)
    colrow : array (N, 2)
    covariance : array (N, 2, 2)
    origin : function of the number of a row
        File and line.
    """

    ids: list[str]
    image: IntArray
    point: IntArray
    colrow: FloatArray
    covariance: FloatArray
    origin: Callable[[int], str]


def _rows(
    names: Sequence[str], ties: TiePoints | None, control: Sequence[ControlPoint], options: AdjustmentOptions
) -> _Rows:
    """Measurements of control and tie points, none of them twice."""
    from pandas import factorize

    place = image_numbers(names)
    known = {(place[point.image], point.id): point for point in control}
    image, used = np.array([key[0] for key in known], dtype=np.int64), np.zeros(0, dtype=np.int64)
    colrow = np.array([point.colrow for point in known.values()], dtype=np.float64).reshape(-1, 2)
    sigma = np.array([point.sigma_px or np.nan for point in known.values()])
    labels = [key[1] for key in known]
    full_covariance: FloatArray | None = None
    if ties is not None:
        code, image_names = factorize(np.array([*ties.images], dtype=object))
        own = np.array(
            [place.get(file_name(n), place.get(stem(file_name(n)), -1)) for n in image_names], dtype=np.int64
        )[code]
        used = np.flatnonzero(own >= 0)
        others = {
            image_names[each]: int(count)
            for each, count in zip(*np.unique(code[own < 0], return_counts=True), strict=True)
        }
        _report_other_images(others, names, len(used) + len(known))
        image = np.concatenate([image, own[used]])
        colrow = np.vstack([colrow, ties.colrow[used]])
        sigma = np.concatenate([sigma, np.full(len(used), np.nan) if ties.sigma is None else ties.sigma[used]])
        labels += [ties.points[row] for row in used.tolist()]
        full_covariance = None if ties.covariance is None else ties.covariance[used]
    points, ids = factorize(np.array(labels, dtype=object))

    def origin(row: int) -> str:
        if row < len(known):
            return list(known.values())[row].where
        assert ties is not None
        return ties.origin(int(used[row - len(known)]))

    covariance = np.where(np.isfinite(sigma), sigma, options.sigma_px)[:, None, None] ** 2 * np.eye(2)
    for row, point in enumerate(known.values()):
        if point.covariance is not None:
            covariance[row] = point.covariance
    if full_covariance is not None:
        covariance[len(known) :] = np.where(np.isfinite(full_covariance), full_covariance, covariance[len(known) :])
    every = _Rows(list(ids), image, points, colrow, covariance, origin)
    first, of = np.unique(points * len(names) + image, return_index=True, return_inverse=True)[1:]
    before = first[of]
    off = np.hypot(*(colrow - colrow[before]).T)
    again = before != np.arange(len(before))
    # What the control table has is no second measurement of a tie point, but the same.
    wrong = again & ((before >= len(known)) | (off > SAME))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"point '{ids[points[row]]}' is measured in {names[image[row]]} already ({origin(int(before[row]))}), "
            f"{off[row]:.1f} px away",
            where=origin(row),
            hint="keep the one that is right; two points must not share a name",
        )
    if not again.any():
        return every
    kept = np.flatnonzero(~again)
    return replace(
        every, image=image[kept], point=points[kept], colrow=colrow[kept], covariance=covariance[kept],
        origin=lambda row: origin(int(kept[row])),
    )  # fmt: skip


def image_numbers(names: Sequence[str]) -> dict[str, int]:
    """Number of each image by the names that tables may have for it.

    Parameters
    ----------
    names : sequence of str
    """
    found: dict[str, int] = {}
    for index, name in enumerate(names):
        found.setdefault(stem(file_name(name)), index)
    return found | {file_name(name): index for index, name in enumerate(names)} | {n: i for i, n in enumerate(names)}


def _given(control: Sequence[ControlPoint]) -> dict[str, ControlPoint]:
    """Given coordinates by the name of the point."""
    found: dict[str, ControlPoint] = {}
    for point in control:
        first = found.setdefault(point.id, point)
        if not np.allclose(first.xyz, point.xyz, rtol=0.0, atol=1e-6, equal_nan=True) or first.role != point.role:
            raise InputError(
                f"point '{point.id}' has other coordinates, or another role, than in {first.where}",
                where=point.where,
                hint="correct them, or rename one of the points",
            )
        earlier, own = (
            (each.sigma_x_y, each.sigma_xy, each.sigma_z, each.correlations if any(each.correlations) else None)
            for each in (first, point)
        )
        if any(a and b and a != b for a, b in zip(earlier, own, strict=True)):
            raise InputError(
                f"point '{point.id}' has other standard deviations or correlations than in {first.where}",
                where=point.where,
                hint="give the same in all lines of a point, or in the first alone",
            )
    return found


def _report_other_images(others: Mapping[str, int], names: Sequence[str], used: int) -> None:
    if not others:
        return
    if not used:
        some = (
            f"{name} ({did_you_mean(stem(name), names) or counted(count, 'row')})" for name, count in others.items()
        )
        hint = f"the images are {listed(names, 4)}"
        what = f"no measurement is of an image of the block; the tie points have {listed(some, 4)}"
        raise InputError(what, where="`ties`", hint=hint)
    rows = counted(sum(others.values()), "tie point measurement")
    warn(f"{rows} left out, in {images_not_of_the_block(others, names)}")


def _spread_out(colrow: FloatArray, sizes: FloatArray) -> None:
    """Check that tie points (N, 2) do not all lie in one corner of images of sizes (N, 2), as millimetres would."""
    if len(colrow) < MANY:
        return
    extent, size = np.ptp(colrow, axis=0), sizes.max(axis=0)
    if (extent < CORNER * size).all():
        raise InputError(
            f"all {len(colrow)} measurements of tie points lie within {extent[0]:.3g} x {extent[1]:.3g} pixels of "
            f"images of {size[0]:g} x {size[1]:g}: millimetres?",
            where="`ties`",
            hint="give col and row in pixels of the image as it is stored, from its upper-left corner",
        )


def _gathered(
    rows: _Rows, given: Mapping[str, ControlPoint], options: AdjustmentOptions
) -> tuple[Measurements, list[str]]:
    """Arrays of the measurements that say something."""
    count = np.bincount(rows.point, minlength=len(rows.ids))
    alone = [n for n in np.flatnonzero(count == 1).tolist() if not _helps_alone(given.get(rows.ids[n]))]
    notes = []
    if alone:
        once = [rows.ids[n] for n in alone]
        notes.append(f"{counted(len(once), 'point')} seen once, left out: {listed(once, 6)}")
    there = count > 0
    there[alone] = False
    if not there.any():
        raise InputError(
            "no point is measured in two images",
            where="`ties`",
            hint="give tie points: id, image, col, row, the same id for the same point in all images",
        )
    ids = tuple(rows.ids[n] for n in np.flatnonzero(there).tolist())
    number, point = {identity: index for index, identity in enumerate(ids)}, (np.cumsum(there) - 1)[rows.point]
    kept = np.flatnonzero(there[rows.point])
    kept = kept[np.lexsort((point[kept], rows.image[kept]))]
    xyz, sigmas, check = np.full((len(ids), 3), np.nan), np.full((len(ids), 3), np.inf), np.zeros(len(ids), dtype=bool)
    correlation = np.broadcast_to(np.eye(3), (len(ids), 3, 3)).copy()
    for identity, known in given.items():
        if identity in number:
            index = number[identity]
            xyz[index], check[index] = known.xyz, known.role == "check"
            plan = known.sigma_x_y or (known.sigma_xy or options.sigma_xy,) * 2
            sigmas[index] = [*plan, known.sigma_z or options.sigma_z]
            correlation[index][[0, 0, 1], [1, 2, 2]] = correlation[index][[1, 2, 2], [0, 0, 1]] = known.correlations
    measured = Measurements(
        ids, rows.image[kept], point[kept], rows.colrow[kept], rows.covariance[kept], xyz, sigmas, correlation, check
    )  # fmt: skip
    return measured, notes


def _helps_alone(point: ControlPoint | None) -> bool:
    """Whether a point that one image shows says something: control, at a place that is known in full."""
    return point is not None and point.role == "control" and bool(np.isfinite(point.xyz).all())
