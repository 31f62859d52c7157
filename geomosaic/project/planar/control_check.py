"""Control of several photos looked at before anything is computed with it, as `georeference` looks at that of one."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pyproj import CRS

from geomosaic.block.block import ControlPoint
from geomosaic.control.finding import Advice
from geomosaic.control.pairs import contradictions
from geomosaic.control.placement import misplaced
from geomosaic.control.points import ImageControl, Origin
from geomosaic.errors import GeomosaicWarning, InputError


def examine(points: Sequence[ControlPoint], crs: CRS, path: Path | None, policy: str = "stop") -> None:
    """Refuse control whose coordinates do not fit their CRS, or contradict each other.

    Parameters
    ----------
    points : sequence of ControlPoint
        Of all photos.
    crs : CRS
        Of their ground coordinates.
    path : Path, optional
        The table, for errors.
    policy : str
        'keep' goes on with such control, and warns; see `geomosaic.project.inputs.wrong_policy`.

    Raises
    ------
    InputError
        Names the points, what they look like, and the mend.
    """
    where = "control" if path is None else str(path)
    by_image: dict[str, list[ControlPoint]] = {}
    for point in points:
        by_image.setdefault(point.image, []).append(point)
    once = list({point.id: point for point in points}.values())
    found: list[tuple[str, Advice]] = [(where, advice) for advice in misplaced(image_control(once, crs, where))]
    for image, own in by_image.items():
        # A point measured twice in a photo is another table's matter; the first counts here.
        alone = list({point.id: point for point in reversed(own)}.values())
        found += [(f"{where}, {image}", advice) for advice in contradictions(image_control(alone, crs, where))]
    for at, advice in found:
        if advice.severity == "error":
            what = f"{advice.what} ({advice.code})"
            if policy != "keep":
                mend = f"{advice.mend}; or --insist, to go on all the same (in a project: insist under [planar])"
                raise InputError(what, where=at, mend=mend)
            warnings.warn(f"{at}: {what}; {advice.mend}", GeomosaicWarning, stacklevel=3)


def image_control(points: Sequence[ControlPoint], crs: CRS, where: str) -> ImageControl:
    """Control points, no two of one name, as the examinations of `geomosaic.control` take them."""
    count = len(points)
    return ImageControl(
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
