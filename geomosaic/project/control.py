"""Control and check points from a table: one row per image measurement."""

from __future__ import annotations

from collections.abc import Sequence

from geomosaic.block.block import ControlPoint
from geomosaic.errors import InputError
from geomosaic.project.names import stem
from geomosaic.project.tables import read_table
from geomosaic.types import PathLike

COLUMNS = ("id", "x", "y", "z", "image", "col", "row")
ROLES = ("control", "check")


def read_control(path: PathLike, images: Sequence[str]) -> tuple[ControlPoint, ...]:
    """Read control points.

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
    by_stem = {stem(image): image for image in images}
    points: list[ControlPoint] = []
    ground: dict[str, tuple[tuple[float, float, float], int]] = {}
    measured: dict[tuple[str, str], int] = {}
    for row in table:
        identity, image = row.text("id"), by_stem.get(stem(row.text("image")))
        xyz = (row.number("x"), row.number("y"), row.number("z"))
        known = ground.setdefault(identity, (xyz, row.line))
        if known[0] != xyz:
            raise InputError(
                f"point '{identity}' has other coordinates than on line {known[1]}",
                where=row.where,
                mend="one point has one place; rename one of them",
            )
        role = (row.values.get("role") or "control").strip().lower()
        if role not in ROLES:
            raise InputError(f"role '{role}' is neither 'control' nor 'check'", where=row.where)
        if image is None:
            continue
        first = measured.setdefault((identity, image), row.line)
        if first != row.line:
            raise InputError(f"point '{identity}' is measured in {image} already, on line {first}", where=row.where)
        points.append(
            ControlPoint(
                id=identity,
                xyz=xyz,
                image=image,
                colrow=(row.number("col"), row.number("row")),
                sigma_xy=row.number("sigma_xy", 0.0),
                sigma_z=row.number("sigma_z", 0.0),
                sigma_px=row.number("sigma_px", 1.0),
                role=role,
                where=row.where,
            )
        )
    return tuple(points)
