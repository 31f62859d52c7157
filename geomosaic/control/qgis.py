"""Points of the QGIS georeferencer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pyproj import CRS

from geomosaic.control.points import Origin
from geomosaic.control.reading import Measured, Reading, control_of, ground_crs
from geomosaic.control.table import comment_crs, rows
from geomosaic.control.text import delimiter_of, has_decimal_commas, number, read_lines, split
from geomosaic.errors import InputError
from geomosaic.types import FloatArray, PathLike

HEADERS = (("mapx", "mapy", "sourcex", "sourcey"), ("mapx", "mapy", "pixelx", "pixely"))
"""Of newer and of older versions."""
SIGNS = ("up", "down")


def is_qgis(header: str) -> bool:
    """Say whether a header is one that QGIS writes."""
    fields = tuple(field.casefold() for field in split(header, delimiter_of(header)))
    return fields[:4] in HEADERS


def read_qgis(
    path: PathLike,
    *,
    crs: str | CRS | None = None,
    size: tuple[int, int] | None = None,
    sign: str | None = None,
) -> Reading:
    """Read a `.points` file.

    QGIS counts x and y of an image without georeference from the upper left corner of the upper-left pixel, y upwards:
    it is negative in the image. Other programs write rows downwards, positive, under the same header. An image that
    was georeferenced already has map coordinates there, which are no image coordinates.

    Parameters
    ----------
    path : path
    crs : str or CRS, optional
        Needed where the file has no line '#CRS: ...', as in older versions.
    size : tuple of int, optional
        Width and height of the image, pixels: tells rows downwards from map coordinates.
    sign : str, optional
        'up' (as QGIS writes) or 'down': settles it where the file does not.

    Raises
    ------
    InputError
        Both signs in one file, positive ones that nothing explains, or a value that cannot be read; the line is named.
    """
    where = str(path)
    if sign is not None and sign not in SIGNS:
        raise InputError(f"the sign of rows is '{sign}'", mend=f"give {' or '.join(SIGNS)}")
    lines = read_lines(path)
    header, body, delimiter = rows(lines, where)
    cells = [(line.origin, text) for line in body for text in line.fields[:4]]
    commas = delimiter != "," and has_decimal_commas(cells)
    points, values = [], []
    for index, line in enumerate(body):
        x, y, col, row = (number(line.fields[i], header[i], line.origin, commas=commas) for i in range(4))
        flag = dict(zip(header, line.fields, strict=True)).get("enable") or "1"
        if flag not in ("0", "1"):
            raise InputError(f"column 'enable' has '{flag}'", where=str(line.origin), mend="write 1 or 0")
        points.append((str(index), x, y, line.origin, flag == "1"))
        values.append((col, row))
    image = np.array(values).reshape(-1, 2)
    sign, note = (sign, f"rows {sign}wards, as given") if sign else _sign(image, size, points, where)
    image[:, 1] *= -1.0 if sign == "up" else 1.0
    image += 0.0  # no negative zero
    measured = [
        Measured(name, (float(at[0]), float(at[1])), (x, y, float("nan")), origin, enabled=enabled)
        for (name, x, y, origin, enabled), at in zip(points, image, strict=True)
    ]
    control = control_of(measured, ground_crs(comment_crs(lines), crs, where), where)
    return Reading(control, "qgis", (note, "points named by their number in the table of QGIS, from 0"))


def _sign(
    image: FloatArray,
    size: tuple[int, int] | None,
    points: Sequence[tuple[str, float, float, Origin, bool]],
    where: str,
) -> tuple[str, str]:
    rows_ = image[:, 1]
    if (rows_ <= 0).all():
        return "up", "rows upwards (negative in the image), as QGIS writes them: sign changed"
    if (rows_ < 0).any():
        few = np.flatnonzero(rows_ > 0) if (rows_ < 0).mean() >= 0.5 else np.flatnonzero(rows_ < 0)
        raise InputError(
            f"rows have both signs: point {points[few[0]][0]} has {rows_[few[0]]:g}, most others not",
            where=str(points[few[0]][3]),
            mend="correct the sign; or, where a point lies beyond the upper edge, give the sign: 'up' as QGIS writes",
        )
    if size is None:
        raise InputError(
            "rows are positive, which QGIS does not write for an image without georeference",
            where=where,
            mend="give the sign 'down' where they count from the top; map coordinates of an image that was "
            "georeferenced already are no image coordinates",
        )
    inside = (image >= 0).all() and (image <= size).all()
    if not inside:
        raise InputError(
            f"rows are positive and points lie outside the image of {size[0]} × {size[1]} pixels: these look like map "
            "coordinates of an image that was georeferenced already",
            where=where,
            mend="take away the georeference of the image and set the points anew, or give the sign 'down'",
        )
    return "down", "rows downwards (positive), which QGIS does not write: taken as they are, all inside the image"
