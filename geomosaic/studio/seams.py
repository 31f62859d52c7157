"""Seams in the studio: the seams as they are saved, edits of them, images at a place, and colours of one image."""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from geomosaic.errors import GeomosaicError, InputError
from geomosaic.geo.units import axis_unit
from geomosaic.jobs.manifest import Layout
from geomosaic.mosaicking.seams.seam_edits import beyond_outlines, cut, dragged, given, redrawn
from geomosaic.mosaicking.seams.seamlines import seam_segments
from geomosaic.raster.cog.codec import BLOCK
from geomosaic.raster.cog.tiff import LENGTH, WIDTH
from geomosaic.raster.cog.tiles import EarlierTiles
from geomosaic.studio.history import text_of
from geomosaic.studio.seam_file import SeamFile
from geomosaic.studio.toml_edit import with_value
from geomosaic.studio.workspace import Workspace, kept_mosaic, version_of

# Vertices of a drawn line, and the largest number that is a coordinate.
_LONGEST, _LARGEST = 10_000, 1e12
# Pixels of ground that an image may get beyond its footprint: a drawn line follows its edge that well.
_SPARE = 4.0


class SeamDesk:
    """Seams of a workspace's mosaic."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace

    def state(self) -> dict[str, Any]:
        """Seams and images as the page shows them.

        Returns
        -------
        dict
            `file` (None while the seams are the mosaic's own), `seams` (`first`, `second`, `line`), `images` (`name`,
            `shown`, `gain`, `offset`), `history`; where there are no seams instead `reason` and `hint`.
        """
        history = self._workspace.history.titles
        try:
            file = self._file()
        except GeomosaicError as error:
            return {"reason": error.what, "hint": error.hint, "seams": [], "images": [], "history": history}
        retouch = file.project.options.colours.retouch
        images = []
        for name, share in zip(file.names, file.shares, strict=True):
            own = retouch.get(name)
            colours = {"gain": 1.0, "offset": 0.0} if own is None else {"gain": own.gain, "offset": own.offset}
            images.append({"name": name, "shown": not share.is_empty, **colours})
        seams = [
            {"first": file.names[part.first], "second": file.names[part.second], "line": list(part.line.coords)}
            for part in seam_segments(file.shares, file.pixel, math.inf)
        ]
        drawn = file.path.name if file.drawn is not None else None
        return {"reason": None, "file": drawn, "seams": seams, "images": images, "history": history}

    def candidates(self, values: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Images that show a place, or some of an area, the most suitable first.

        Parameters
        ----------
        values : mapping
            `place` (x, y) or `area` (vertices), in the map.

        Returns
        -------
        list of dict
            `name`, `shows` (share of the place or area that is this image's now), `covers` (share that it can show),
            `distance` in metres of the place that it sees best.

        Raises
        ------
        InputError
        """
        file = self._file()
        area = _area(values) if "area" in values else shapely.Point(_places(values, "place", 1)[0])
        middle = np.array(area.centroid.coords[0])
        centres = Layout(file.project).vectors
        found = []
        for name, outline, share, centre in zip(file.names, file.outlines, file.shares, _centres(centres), strict=True):
            if name in file.excluded or not outline.intersects(area):
                continue
            part = (lambda shape: shape.intersection(area).area / area.area) if area.area else _whole(area)
            distance = float(np.hypot(*(centre - middle))) * axis_unit(file.crs)
            found.append({"name": name, "shows": part(share), "covers": part(outline), "distance": distance})
        return sorted(found, key=lambda one: (one["covers"] < 0.999, one["distance"]))

    def pieces(self, values: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Pieces that a line cuts off: `image` and `area` (vertices of the outline), the smallest first.

        Parameters
        ----------
        values : mapping
            `line`, vertices in the map.
        """
        file = self._file()
        found = cut(file.shares, _line(values), file.step)
        return [{"image": file.names[image], "area": list(piece.exterior.coords)} for image, piece in found]

    def give(self, values: Mapping[str, Any]) -> None:
        """Give an `area` to an `image`.

        Raises
        ------
        InputError
            The image does not show all of it, or shows it already.
        """
        name = values.get("image")
        area = _area(values)

        def act(file: SeamFile) -> list[Any]:
            return given(file.shares, area, file.number(name), file.step)

        self._save(f"area given to {name}", act)

    def redraw(self, values: Mapping[str, Any]) -> None:
        """Lay seams along a `line` that begins on one and ends on the same or another."""
        line = _line(values)
        self._save("seam redrawn", lambda file: redrawn(file.shares, line, file.step))

    def drag(self, values: Mapping[str, Any]) -> None:
        """Drag a seam from a `place` `to` another, with as much of it as is within `reach` map units."""
        place, to = _places(values, "place", 1)[0], _places(values, "to", 1)[0]
        reach = _number(values, "reach", 1e-9)
        self._save("seam moved", lambda file: dragged(file.shares, place, to, reach, file.step))

    def retouch(self, values: Mapping[str, Any]) -> None:
        """Set `gain` and `offset` of one `image` in the project file; 1 and 0 take them out."""
        gain, offset = _number(values, "gain", 1e-6), _number(values, "offset", -_LARGEST)
        with self._workspace.history.lock:
            file = self._file()
            name = file.names[file.number(values.get("image"))]
            path = self._workspace.path
            before = text_of(path) or ""
            table = ("mosaic", "retouch", name)
            after = with_value(before, table, "gain", None if gain == 1.0 else gain)
            after = with_value(after, table, "offset", None if offset == 0.0 else offset)
            self._workspace.history.save(f"colours of {name}", {path: before}, {path: after})

    def keep_mosaic(self) -> None:
        """Keep the mosaic as it is, for comparison with that of the run that follows."""
        project = self._workspace.project()
        if project is None or not Layout(project).mosaic.is_file():
            return
        made, kept = Layout(project).mosaic, kept_mosaic(project)
        with suppress(OSError):  # no room: then there is nothing to compare with
            kept.parent.mkdir(parents=True, exist_ok=True)
            unfinished = kept.with_name(f".{kept.name}.partial-{os.getpid()}")
            unfinished.unlink(missing_ok=True)
            try:  # a run replaces the mosaic and never writes into it: a second name keeps the old one
                os.link(made, unfinished)
            except OSError:
                shutil.copy2(made, unfinished)
            unfinished.replace(kept)

    def changes(self, since: str) -> dict[str, Any]:
        """Pixels of the mosaic that are others than in an earlier version.

        Parameters
        ----------
        since : str
            Version, as layers of the project have it.

        Returns
        -------
        dict
            `windows`: left, top, right, bottom in pixels of each tile that differs; None where that is not known.
        """
        project = self._workspace.project()
        if project is None or version_of(kept_mosaic(project)) != since:
            return {"windows": None}
        return {"windows": _differing(kept_mosaic(project), Layout(project).mosaic)}

    def _file(self) -> SeamFile:
        return SeamFile.of(self._workspace.sound_project())

    def _save(self, title: str, act: Callable[[SeamFile], list[Any]]) -> None:
        with self._workspace.history.lock:
            file = self._file()
            after = act(file)
            _refuse_unseen(file, after)
            self._workspace.history.make(file.edit(title, after))


def _refuse_unseen(file: SeamFile, after: list[Any]) -> None:
    """Check that images show what they get."""
    beyond = beyond_outlines(file.shares, after, file.outlines)
    for number, lost in beyond.items():
        if lost.area > _SPARE * file.pixel**2:
            x, y = lost.representative_point().coords[0]
            metres = lost.area * axis_unit(file.crs) ** 2
            digits = 7 if file.crs.is_geographic else 1
            size = f"{metres:.3g} m² of it" if not file.crs.is_geographic else "a part of it"
            raise InputError(
                f"'{file.names[number]}' does not show {size}, about x {x:.{digits}f}, y {y:.{digits}f}",
                hint="stay within its footprint, or choose another image",
            )


def _differing(one: Path, other: Path) -> list[list[int]] | None:
    """Windows of the tiles of full resolution that differ; None where the files cannot be compared."""
    try:
        with EarlierTiles(one) as before, EarlierTiles(other) as after:
            sizes = [[found.levels[0][tag].integers[0] for tag in (WIDTH, LENGTH)] for found in (before, after)]
            if sizes[0] != sizes[1]:
                return None
            across = -(-sizes[0][0] // BLOCK)
            count = across * -(-sizes[0][1] // BLOCK)
            differ = [
                divmod(index, across)
                for index in range(count)
                if before.tile(0, index) != after.tile(0, index) or before.mask(0, index) != after.mask(0, index)
            ]
    except (OSError, ValueError):
        return None
    return [[col * BLOCK, row * BLOCK, (col + 1) * BLOCK, (row + 1) * BLOCK] for row, col in differ]


def _centres(path: Path) -> list[np.ndarray[Any, np.dtype[np.float64]]]:
    """Places that the images see best."""
    from geomosaic.raster.vector import read_layer

    frame = read_layer(path, "footprints")
    return list(starmap(lambda x, y: np.array([x, y]), zip(frame["centre_x"], frame["centre_y"], strict=True)))


def _whole(place: Any) -> Callable[[Any], float]:
    return lambda shape: float(shape.intersects(place))


def _number(values: Mapping[str, Any], name: str, least: float) -> float:
    value = values.get(name)
    if not isinstance(value, int | float) or isinstance(value, bool) or not least <= value < _LARGEST:
        raise InputError(f"`{name}` is not an allowed number", hint="give another one")
    return float(value)


def _places(values: Mapping[str, Any], name: str, least: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Places (N, 2) in the map; one may be given alone."""
    given = values.get(name)
    if isinstance(given, list) and given and not isinstance(given[0], list):
        given = [given]
    try:
        found = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    fits = found.ndim == 2 and found.shape[1:] == (2,) and least <= len(found) <= _LONGEST
    if not fits or not (np.abs(found) < _LARGEST).all():
        raise InputError(f"`{name}` is no list of places on the map", hint="draw it again")
    return found


def _line(values: Mapping[str, Any]) -> Any:
    return shapely.LineString(_places(values, "line", 2))


def _area(values: Mapping[str, Any]) -> Any:
    area = shapely.Polygon(_places(values, "area", 3))
    if not area.is_valid or area.area <= 0:
        raise InputError("the outline of the area crosses itself", hint="draw it again, without crossing lines")
    return area
