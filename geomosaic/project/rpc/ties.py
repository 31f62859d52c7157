"""Tie points between scenes, from a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geomosaic.errors import InputError
from geomosaic.project.names import stem
from geomosaic.project.tables import read_table
from geomosaic.types import FloatArray, IntArray

COLUMNS = ("id", "image", "col", "row")


def read_ties(path: Path, images: Sequence[str]) -> tuple[IntArray, IntArray, FloatArray]:
    """Read tie points.

    Parameters
    ----------
    path : Path
        Text with the columns id, image, col, row: one line per measurement. Measurements in other images are left out.
    images : sequence of str

    Returns
    -------
    image, point : int array (M,)
        Which image and which tie point each measurement is of, from 0.
    colrow : array (M, 2)

    Raises
    ------
    InputError
        Names file and line.
    """
    table = read_table(path, "tie point table", ",".join(COLUMNS))
    table.require(*COLUMNS, what="tie points")
    numbers = {stem(name): number for number, name in enumerate(images)}
    points: dict[str, int] = {}
    met: dict[tuple[int, str], int] = {}
    image, point, colrow = [], [], []
    for row in table:
        where, identity = numbers.get(stem(row.text("image"))), row.text("id")
        if where is None:
            continue
        first = met.setdefault((where, identity), row.line)
        if first != row.line:
            raise InputError(
                f"tie point '{identity}' is measured in {images[where]} already, on line {first}", where=row.where
            )
        image.append(where)
        point.append(points.setdefault(identity, len(points)))
        colrow.append((row.number("col"), row.number("row")))
    if not image:
        raise InputError(
            "no tie point is measured in these images", where=str(path), mend=f"the images are {', '.join(images)}"
        )
    return np.array(image), np.array(point), np.array(colrow, dtype=np.float64)
