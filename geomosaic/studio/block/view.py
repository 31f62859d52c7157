"""View of a block for the page: images with their footprints and flight lines, tie points with their rays."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block_adjustment.image_residuals import ImageResiduals
from geomosaic.errors import InputError
from geomosaic.geo.units import axis_unit
from geomosaic.image_names import find_by_name
from geomosaic.inputs.tables import read_table
from geomosaic.jobs.manifest import Layout
from geomosaic.orientation.block.flight_lines import flight_lines
from geomosaic.project.commented_images import commented_images, with_commented_image
from geomosaic.project.load import Project
from geomosaic.studio.block.reading import BlockReading, facts_of, files_of, read_block
from geomosaic.studio.control.places import map_frame, map_places
from geomosaic.studio.history import text_of
from geomosaic.studio.toml_edit import with_list
from geomosaic.studio.workspace import Workspace
from geomosaic.types import FloatArray, IntArray


class BlockView:
    """Block of a workspace."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._lock = threading.Lock()
        self._read: tuple[object, BlockReading] | None = None

    def overview(self, layer: str | None = None) -> dict[str, Any]:
        """Images of the block, and how they hang together.

        Parameters
        ----------
        layer : str, optional
            Georeferenced layer by its id, on whose map places are told; the block's own map unless given.
        """
        project = self._workspace.sound_project()
        reading = self._reading(project)
        crs = self._crs(reading, layer)
        prints = {} if crs is None else reading.footprints(crs)
        centres = np.array([prints[p.name].centre if p.name in prints else (np.nan, np.nan) for p in project.images])
        lines = _lines(project, centres)
        aside = dict(facts_of(Layout(project).facts("orient")).get("set_aside", {}))  # by the adjustment, with reasons
        own, facts = _ties_by_image(reading.residuals), reading.facts
        weak = {one["name"]: one["weak"] for one in facts.get("ties", {}).get("images", ())}
        images = []
        for path, line in zip(project.images, lines.tolist(), strict=True):
            ring = prints[path.name].ring.tolist() if path.name in prints else None
            images.append(
                {
                    "id": self._id(path.name),
                    "name": path.name,
                    "line": line,
                    "footprint": ring,
                    "centre": list(prints[path.name].centre) if path.name in prints else None,
                    "aside": aside.get(path.name),
                    "by": "adjustment" if path.name in aside else None,
                    "weak": weak.get(path.name, ""),
                    **own.get(path.name, _NO_TIES),
                }
            )
        for path in project.set_aside:
            images.append({"id": self._id(path.name), "name": path.name, "line": -1, "by": "project", **_NOWHERE})
        return {
            "state": reading.state,
            "reason": reading.reason,
            "sigma0": facts.get("sigma0"),
            "lines": int(lines.max(initial=-1)) + 1,
            "images": images,
            "commented": commented_images(text_of(self._workspace.path) or ""),
            "rays": _ray_counts(reading.residuals),
            "frame": None if crs is None or layer is not None else _frame(crs, prints),
        }

    def ties(self, image: str, layer: str | None = None) -> dict[str, Any]:
        """Image positions of an image with their residuals and rays.

        Parameters
        ----------
        image : str
            By its id.
        layer : str, optional
            As for `overview`.
        """
        project = self._workspace.sound_project()
        reading = self._reading(project)
        found, name = reading.residuals, self._name(image)
        if found is None or name not in found.names:
            return {"image": name, "points": [], "rms": None}
        rows = np.flatnonzero(found.image == found.names.index(name))
        places = _on_map(found, found.point[rows], self._crs(reading, layer))
        columns = (rows.tolist(), places.tolist(), found.rays[found.point[rows]].tolist())
        points = [
            {
                "id": found.ids[found.point[row]],
                "col": found.colrow[row, 0],
                "row": found.colrow[row, 1],
                "residual": found.residual[row].tolist(),
                "rays": rays,
                "left_out": bool(found.left_out[row]),
                "on_map": place,
            }
            for row, place, rays in zip(*columns, strict=True)
        ]
        return {"image": name, "points": points, "rms": found.rms(found.names.index(name))}

    def rays(self, point: str, layer: str | None = None) -> dict[str, Any]:
        """Rays of a point: the images that show it, where, and with which residuals.

        Parameters
        ----------
        point : str
            By its name.
        layer : str, optional
            As for `overview`.
        """
        reading = self._reading(self._workspace.sound_project())
        found = reading.residuals
        if found is None or point not in found.ids:
            raise InputError(f"there is no tie point '{point}'", hint="load the page again")
        number = found.ids.index(point)
        rows = np.flatnonzero(found.point == number)
        place = _on_map(found, np.array([number]), self._crs(reading, layer))[0]
        return {
            "id": point,
            "on_map": place.tolist(),
            "ground": found.ground[number].tolist(),
            "rays": [
                {
                    "image": self._id(found.names[found.image[row]]),
                    "name": found.names[found.image[row]],
                    "col": found.colrow[row, 0],
                    "row": found.colrow[row, 1],
                    "residual": found.residual[row].tolist(),
                    "left_out": bool(found.left_out[row]),
                }
                for row in rows.tolist()
            ],
        }

    def set_aside(self, image: str, aside: bool) -> None:
        """Set an image aside in the project file, or take it back.

        Parameters
        ----------
        image : str
            By its id.
        aside : bool

        Raises
        ------
        InputError
            It is as wanted already, or the last image would go.
        """
        name, project = self._name(image), self._workspace.sound_project()
        with self._workspace.history.lock:
            text = text_of(self._workspace.path) or ""
            before = list(project.settings.project.set_aside)
            if aside == (name in before):
                raise InputError(f"{name} is {'set aside' if aside else 'not set aside'} already", hint="look again")
            if aside and len(project.images) == 1:
                raise InputError("the last image cannot be set aside", hint="take another one back first")
            after = [*before, name] if aside else [one for one in before if one != name]
            changed = with_list(text, "project", "set_aside", after)
            title = f"{name} set aside" if aside else f"{name} taken back"
            self._workspace.history.save(title, {self._workspace.path: text}, {self._workspace.path: changed})

    def take_back(self, name: str) -> None:
        """Take an image back that stands in the project file as a comment, as `new` leaves out images of a folder.

        Parameters
        ----------
        name : str
            Path as the comment has it.

        Raises
        ------
        InputError
            No comment names it.
        """
        self._workspace.sound_project()
        with self._workspace.history.lock:
            text = text_of(self._workspace.path) or ""
            changed = with_commented_image(text, name)
            self._workspace.history.save(
                f"{name} taken back", {self._workspace.path: text}, {self._workspace.path: changed}
            )

    def _reading(self, project: Project) -> BlockReading:
        """Block as its files are now."""
        with self._lock:
            key = files_of(project)
            if self._read is None or self._read[0] != key:
                self._read = key, read_block(project)
            return self._read[1]

    def _crs(self, reading: BlockReading, layer: str | None) -> CRS | None:
        return reading.crs if layer is None else map_frame(self._workspace.raster(layer))[0]

    def _id(self, name: str) -> str:
        return next(one.id for one in self._workspace.layers() if one.role == "image" and one.path.name == name)

    def _name(self, image: str) -> str:
        path = self._workspace.raster(image)
        if path is None:
            raise InputError("there is no such image in the project", hint="load the page again")
        return path.name


_NO_TIES: Mapping[str, Any] = {"points": 0, "left_out": 0, "mean_rays": None, "rms": None}
_NOWHERE: Mapping[str, Any] = {
    "footprint": None,
    "centre": None,
    "aside": "in the project file",
    "weak": "",
    **_NO_TIES,
}


def _lines(project: Project, places: FloatArray) -> IntArray:
    """Flight line of each image: as the table of strips has it, else by the places in the order of the images."""
    table = None if project.adjustment is None else project.adjustment.strips
    if table is None:
        return flight_lines(places)
    rows = {row.text("image"): row.text("strip") for row in read_table(table, "table of strips", "image,strip")}
    strips = [find_by_name(rows, path.name) for path in project.images]
    numbers = {name: number for number, name in enumerate(dict.fromkeys(one for one in strips if one))}
    return np.array([numbers.get(one, -1) if one else -1 for one in strips], dtype=np.int64)


def _ties_by_image(found: ImageResiduals | None) -> dict[str, dict[str, Any]]:
    """Numbers of image positions, and what they left, by the name of the image."""
    if found is None:
        return {}
    facts = {}
    for index, name in enumerate(found.names):
        mine = found.image == index
        good = mine & ~found.left_out
        rays = found.rays[found.point[good]]
        facts[name] = {
            "points": int(good.sum()),
            "left_out": int((mine & found.left_out).sum()),
            "mean_rays": float(rays.mean()) if len(rays) else None,
            "rms": found.rms(index),
        }
    return facts


def _ray_counts(found: ImageResiduals | None) -> dict[str, int]:
    """Number of points by their number of rays."""
    if found is None:
        return {}
    return {str(rays): int(count) for rays, count in enumerate(np.bincount(found.rays)) if rays > 1 and count}


def _on_map(found: ImageResiduals, points: IntArray, crs: CRS | None) -> FloatArray:
    """Map places (N, 2) of adjusted points; NaN where they have none."""
    places = np.full((len(points), 2), np.nan)
    known = np.isfinite(found.ground[points]).all(axis=1)
    if crs is not None and found.crs is not None and known.any():
        places[known] = map_places(found.ground[points[known]], found.crs, crs)
    return places


def _frame(crs: CRS, prints: Mapping[str, Any]) -> dict[str, Any] | None:
    """Map that shows all footprints, where no raster gives one."""
    if not prints:
        return None
    boxes = np.array([one.bounds for one in prints.values()])
    (left, low), (right, high) = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    pixel = float(np.median([one.sampling for one in prints.values()]))
    return {
        "id": "block",
        "affine": [pixel, 0.0, left, 0.0, -pixel, high],
        "width": (right - left) / pixel,
        "height": (high - low) / pixel,
        "geographic": crs.is_geographic,
        "metres_per_unit": axis_unit(crs),
        "crs_name": crs.name,
    }
