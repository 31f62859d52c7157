"""Pictures of a project to digitize in, and the place under a pixel of a photo with its error ellipse."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.block import OrientedImage
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.units import metres_per_unit
from geomosaic.inputs.build import build_block
from geomosaic.jobs.manifest import Layout
from geomosaic.jobs.steps.orient import restore_block
from geomosaic.monoplotting.line_drawing import View
from geomosaic.monoplotting.pictures import MapPicture, PhotoPicture, Picture, RasterPicture
from geomosaic.monoplotting.places import ground_crs, locate, outside_image
from geomosaic.monoplotting.run import oriented
from geomosaic.project.load import Project
from geomosaic.project.scenes import project_scene
from geomosaic.raster.info import inspect
from geomosaic.sensor.error_propagation import InputUncertainty
from geomosaic.studio.workspace import Workspace, file_stamp
from geomosaic.surface.dem import height_sigmas
from geomosaic.surface.model import Surface

# Standard deviation of a place that a hand points at, where the project names none: pixels.
_HAND = 0.5
_CORNERS = 48


@dataclass(frozen=True, eq=False)
class Photo:
    """Image with its orientation, the surface it sees and how well both are known.

    Attributes
    ----------
    scene : OrientedImage
    surface : Surface or None
    uncertainty : InputUncertainty
    adjusted : bool
        Whether the step "orient" has run, else the orientation is as declared.
    """

    scene: OrientedImage
    surface: Surface | None
    uncertainty: InputUncertainty
    adjusted: bool


class FeaturePictures:
    """Pictures of a workspace."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._lock = threading.Lock()
        self._photos: dict[Path, Photo] = {}
        self._key: tuple[Any, ...] = ()

    def map_crs(self, layer: str) -> CRS:
        """CRS of the map that a georeferenced layer is shown on.

        Parameters
        ----------
        layer : str
            Its id.
        """
        crs, _ = self._georeference(layer)
        return crs

    def map_picture(self, layer: str, crs: CRS) -> MapPicture:
        """Map of a georeferenced layer.

        Parameters
        ----------
        layer : str
            Its id.
        crs : CRS
            Of the features.
        """
        return MapPicture(crs, self.map_crs(layer))

    def image_picture(self, image: str, crs: CRS) -> Picture:
        """Raw photo by its model, or another raster by its georeference.

        Parameters
        ----------
        image : str
            Its id.
        crs : CRS
            Of the features.

        Raises
        ------
        InputError
            Nothing says where the image lies.
        """
        project, path = self._workspace.project(), self._workspace.raster(image)
        if project is not None and path in project.images:
            photo = self.photo(image)
            return PhotoPicture(View.of(photo.scene.model, photo.surface, crs))
        raster, transform = self._georeference(image)
        return RasterPicture(MapPicture(crs, raster), transform)

    def photo(self, image: str) -> Photo:
        """Image of the project as the last run oriented it, or as the project declares it.

        Parameters
        ----------
        image : str
            Its id.
        """
        project, path = self._workspace.image(image)
        with self._lock:
            key = _stamps(project)
            if key != self._key:
                self._key, self._photos = key, {}
            if path not in self._photos:
                self._photos |= _photos(project, path)
            if path not in self._photos:
                raise InputError(f"{path.name} was set aside: it has no orientation", hint="choose another image")
            return self._photos[path]

    def place(self, image: str, layer: str, place: tuple[float, float], *, on_map: bool) -> dict[str, Any]:
        """Place of a pixel on the map with its error ellipse, or pixel of a place of the map.

        Parameters
        ----------
        image : str
            Photo by its id.
        layer : str
            Georeferenced layer of the map by its id.
        place : tuple of float
            Column and row, or x and y of the map.
        on_map : bool
            Whether `place` is of the map.

        Returns
        -------
        dict
            `pixel`, `xy`, `z`, and with a known error `semi_axes` and `sigma_z` (metres), `azimuth` (degrees), `known`
            (what it is of) and `outline` (N, 2) on the map; None where nothing is seen.
        """
        photo, crs = self.photo(image), self.map_crs(layer)
        model, surface = photo.scene.model, photo.surface
        colrow = np.array([place])
        if on_map:
            colrow = View.of(model, surface, crs).drape_to_image(colrow)[0]
        nothing = {"pixel": None, "xy": None}
        if not np.isfinite(colrow).all() or outside_image(colrow, model.size)[0]:
            return nothing
        found = locate(model, surface, colrow, ground_crs(model, surface, crs, None), photo.uncertainty)
        if not found.seen[0]:
            return nothing
        xyz = found.xyz[0]
        metres = metres_per_unit(found.crs, found.xyz)[0]
        values, vectors = np.linalg.eigh(np.nan_to_num(found.ellipses.covariance[0, :2, :2]))
        turn = np.linspace(0.0, 2.0 * np.pi, _CORNERS + 1)
        circle = np.column_stack([np.cos(turn), np.sin(turn)]) * np.sqrt(np.maximum(values, 0.0))
        known = bool(np.isfinite(found.ellipses.semi_axes).all())
        return {
            "pixel": colrow[0].tolist(), "xy": xyz[:2].tolist(), "z": xyz[2],
            "semi_axes": found.ellipses.semi_axes[0].tolist(), "azimuth": found.ellipses.azimuth[0],
            "sigma_z": found.ellipses.sigma_z[0], "known": list(photo.uncertainty.known),
            "notes": list(photo.uncertainty.notes), "adjusted": photo.adjusted,
            "outline": (xyz[:2] + circle @ vectors.T / metres[:2]).tolist() if known else None,
        }  # fmt: skip

    def _georeference(self, layer: str) -> tuple[CRS, Affine]:
        path = self._workspace.raster(layer)
        if path is None:
            raise InputError("there is no such layer", hint="load the page again")
        info = inspect(path)
        if info.crs is None or info.transform is None:
            raise InputError(f"nothing says where {path.name} lies", hint="choose an oriented photo, an ortho or a map")
        return horizontal(info.crs), info.transform


def _photos(project: Project, path: Path) -> dict[Path, Photo]:
    """All images as the last run left them, or one as it is declared."""
    options = project.options
    layout = Layout(project)
    hand = options.uncertainty.sigma_px if options.uncertainty.sigma_px is not None else _HAND
    given = options.uncertainty.sigma_dem
    if layout.facts("orient").is_file() and all(model.is_file() for model in layout.models):
        block = restore_block(project, options.render.dem_memory)
        height = getattr(block.surface, "sigma", None) if given is None else height_sigmas(given)
        return {
            Path(scene.path): Photo(
                scene, block.surface, InputUncertainty(hand, height, scene.covariance, (scene.known_by,)), True
            )
            for scene in block.scenes
        }
    inputs = project_scene(project, path)
    block = build_block(inputs)
    height = getattr(block.surface, "sigma", None) if given is None else height_sigmas(given)
    scene, covariance, note = oriented(inputs, options.uncertainty.sigmas or {}, block, block.scenes[0])
    return {path: Photo(replace(scene), block.surface, InputUncertainty(hand, height, covariance, (note,)), False)}


def _stamps(project: Project) -> tuple[Any, ...]:
    """Sizes and times of the files that orientations come from."""
    layout = Layout(project)
    tables = [table for part in project.blocks for table in part.tables]
    files = [
        project.path,
        *tables,
        *layout.models,
        layout.facts("orient"),
        *(part.dem for part in project.blocks if part.dem),
    ]
    return tuple((file, file_stamp(file)) for file in files)
