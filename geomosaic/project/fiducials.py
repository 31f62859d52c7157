"""Fiducial marks as measured in the scans of films: one row per mark and image."""

from __future__ import annotations

from collections.abc import Sequence

from geomosaic.errors import InputError
from geomosaic.project.names import find_by_name, missing_row
from geomosaic.project.tables import read_table
from geomosaic.types import PathLike

COLUMNS = ("image", "id", "col", "row")


def read_fiducials(path: PathLike, images: Sequence[str]) -> dict[str, dict[str, list[float]]]:
    """Read the marks of each image.

    Parameters
    ----------
    path : path
        Text with the columns image, id, col, row. Image coordinates in pixels, corner-based: (0.5, 0.5) is the centre
        of the upper-left pixel. Where there is one image, the column image may be left out.
    images : sequence of str
        Names of the images; each needs its marks, and the marks of others are left out.

    Returns
    -------
    dict
        Image → mark → [col, row].

    Raises
    ------
    InputError
        Names file and line.
    """
    table = read_table(path, "table of fiducials", ",".join(COLUMNS))
    alone = "image" not in table.columns and len(images) == 1
    table.require(*(COLUMNS[1:] if alone else COLUMNS), what="fiducials")
    rows: dict[str, dict[str, list[float]]] = {}
    for row in table:
        marks = rows.setdefault(images[0] if alone else row.text("image"), {})
        mark = row.text("id")
        if mark in marks:
            raise InputError(f"fiducial '{mark}' is measured twice", where=row.where, mend="leave one of them out")
        marks[mark] = [row.number("col"), row.number("row")]
    found = {}
    for image in images:
        measured = find_by_name(rows, image)
        if measured is None:
            raise missing_row(str(path), image, rows)
        found[image] = measured
    return found
