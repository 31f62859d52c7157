"""Control and check points from a table: one row per image measurement."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np
from pyproj import CRS

from geomosaic.block.block import ControlPoint
from geomosaic.control.points import ControlPoints
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.inputs.tables import Row, file_name, read_table, stem
from geomosaic.types import PathLike

COLUMNS = ("id", "x", "y", "z", "image", "col", "row")
ROLES = ("control", "check")


def read_control(path: PathLike, images: Sequence[str]) -> tuple[ControlPoint, ...]:
    """Control points of a table.

    Parameters
    ----------
    path : path
        Text with the columns id, x, y, z, image, col, row and optionally sigma_xy, sigma_z (metres), sigma_px, role.
        Image coordinates in pixels, corner-based: (0.5, 0.5) is the centre of the upper-left pixel.
    images : sequence of str
        Names of the block's images; measurements in other images are left out.

    Raises
    ------
    InputError
        Names file and line.
    """
    table = read_table(path, "control point table", ",".join(COLUMNS))
    table.require(*COLUMNS, what="control points")
    by_stem = {stem(file_name(image)): image for image in images}
    points: list[ControlPoint] = []
    ground: dict[str, tuple[tuple[float, float, float], int]] = {}
    measured: dict[tuple[str, str], int] = {}
    for row in table:
        identity, image = row.text("id"), by_stem.get(stem(file_name(row.text("image"))))
        xyz = (row.number("x"), row.number("y"), row.number("z"))
        known = ground.setdefault(identity, (xyz, row.line))
        if known[0] != xyz:
            raise InputError(
                f"point '{identity}' has other coordinates than on line {known[1]}",
                where=row.where,
                hint="one point has one place; rename one of them",
            )
        role = (row.values.get("role") or "control").strip().lower()
        if role not in ROLES:
            raise InputError(
                f"role '{role}' is neither 'control' nor 'check'", where=row.where, hint="write one of them, or nothing"
            )
        if image is None:
            continue
        first = measured.setdefault((identity, image), row.line)
        if first != row.line:
            raise InputError(
                f"point '{identity}' is measured in {image} already, on line {first}",
                where=row.where,
                hint="keep the one that is right",
            )
        points.append(
            ControlPoint(
                id=identity,
                xyz=xyz,
                image=image,
                colrow=(row.number("col"), row.number("row")),
                sigma_xy=_sigma(row, "sigma_xy", 0.0),
                sigma_z=_sigma(row, "sigma_z", 0.0),
                sigma_px=_sigma(row, "sigma_px", 1.0),
                role=role,
                where=row.where,
            )
        )
    if ground and not points:
        other = table.rows[0].text("image")
        warnings.warn(
            f"{path}: no point is measured in an image of the block; the table has others, such as '{other}'",
            GeomosaicWarning,
            stacklevel=2,
        )
    return tuple(points)


def control_values(given: Mapping[str, ControlPoints], crs: CRS) -> tuple[ControlPoint, ...]:
    """Measurements of control points that are given as values, brought to a block's CRS.

    Parameters
    ----------
    given : mapping of str to ControlPoints
        By image name; points that are not enabled are left out.
    crs : CRS
        Of the block.

    Returns
    -------
    tuple of ControlPoint
        Ground x, y, z in `crs`, image (col, row) in pixels. A point without a height lies at 0.
    """
    found = []
    for image, points in given.items():
        xyz = np.zeros((len(points), 3))
        ground = points.to_crs(crs).ground
        xyz[:, : ground.shape[1]] = np.nan_to_num(ground)
        for index in np.flatnonzero(points.enabled).tolist():
            place, measured = xyz[index].tolist(), points.colrow[index].tolist()
            found.append(
                ControlPoint(
                    id=points.names[index],
                    xyz=(place[0], place[1], place[2]),
                    image=image,
                    colrow=(measured[0], measured[1]),
                    sigma_px=float(points.sigma[index]),
                    role=points.roles[index],
                    where=str(points.origins[index]),
                )
            )
    return tuple(found)


def _sigma(row: Row, name: str, default: float) -> float:
    """Standard deviation; an exact place on the ground has 0, a measurement never."""
    sigma = row.number(name, default)
    if sigma < 0.0 or (name == "sigma_px" and sigma == 0.0):
        raise InputError(
            f"{name} is {sigma:g}",
            where=row.where,
            hint="a standard deviation is greater than 0; leave the field empty where it is not known",
        )
    return sigma
