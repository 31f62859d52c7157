"""From plain declarations to a block: images, models, surface and control points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from geomosaic.block.block import Block, ControlPoint
from geomosaic.block.scene import Scene
from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import geographic, has_heights, horizontal
from geomosaic.geo.transform import Transform
from geomosaic.project.camera import read_camera
from geomosaic.project.exterior import Exterior, read_exterior
from geomosaic.project.frames import declared, named, undeclared
from geomosaic.project.inputs import BlockInputs
from geomosaic.project.units import check_units
from geomosaic.raster.info import SourceInfo, inspect
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.registry import build as build_model
from geomosaic.surface.model import Surface

if TYPE_CHECKING:
    from geomosaic.sensor.model import SensorModel

RECONSTRUCTION = "opensfm"
"""The angle system whose file is no table: the sensor reads camera and orientation from `reconstruction.json`."""


@dataclass(frozen=True)
class Photo:
    """An image file with what is known of its orientation."""

    path: Path
    info: SourceInfo
    exterior: Exterior | None

    @property
    def name(self) -> str:
        """Name of the scene: the file's name."""
        return self.path.name


def build_block(inputs: BlockInputs) -> Block:
    """Make the block.

    Raises
    ------
    InputError
        Something is missing or wrong; names the file, line or option.
    """
    photos, crs = photos_of(inputs)
    if inputs.exterior is not None and crs is not None and not has_heights(crs):
        ground = inputs.height if inputs.height is not None else 0.0
        where = str(inputs.exterior)
        raise undeclared("the positions", where, _OF_POSITIONS, crs, _place(photos), _reach(photos, ground))
    surface = build_surface(inputs, crs, photos)
    control = _control(inputs, photos, crs)
    camera = read_camera(inputs.camera) if inputs.camera else None
    scenes = tuple(
        Scene(
            photo.name,
            str(photo.path),
            inputs.sensor,
            _model(inputs, photo, crs, camera, control),
            inputs.nodata,
            inputs.bands,
        )
        for photo in photos
    )
    return Block(scenes, surface, control, crs)


def photos_of(inputs: BlockInputs) -> tuple[list[Photo], CRS | None]:
    """Look at the images and their rows of the orientation table; no pixel is read.

    Returns
    -------
    photos : list of Photo
    crs : CRS or None
        3-D CRS of positions and control points, where one was named.
    """
    if not inputs.images:
        raise InputError("no images are given", mend="name one or more image files")
    infos = [inspect(path, inputs.bands) for path in inputs.images]
    crs = named(inputs.crs, inputs.heights, "exterior CRS") if inputs.crs else None
    if inputs.exterior is None or inputs.angles == RECONSTRUCTION:
        return [Photo(path, info, None) for path, info in zip(inputs.images, infos, strict=True)], crs
    table = read_exterior(inputs.exterior, inputs.angles)
    if crs is None:
        raise InputError(
            "the positions have no CRS",
            where=str(inputs.exterior),
            mend="name it: --exterior-crs on the command line, crs under [exterior] in the project",
        )
    photos = [Photo(path, info, table.row(path.name)) for path, info in zip(inputs.images, infos, strict=True)]
    # The whole table: one image alone tells nothing of the unit, its neighbours do.
    check_units(table, inputs.angle_unit, list(table.rows.values()))
    return photos, crs


def build_surface(inputs: BlockInputs, crs: CRS | None, photos: Sequence[Photo] = ()) -> Surface | None:
    """Make the surface of a DEM or of one height; None where neither is given.

    Parameters
    ----------
    inputs : BlockInputs
    crs : CRS or None
        Of the positions; a height without a datum of its own takes theirs.
    photos : sequence of Photo
        For what an error says.
    """
    if inputs.dem is not None and inputs.height is not None:
        raise InputError("a DEM and a height are both given", mend="give one of --dem and --height")
    if inputs.height is not None:
        from geomosaic.surface.plane import Plane

        if crs is None:
            raise InputError("a height needs a CRS", mend="name it: --exterior-crs, or crs under [exterior]")
        frame = declared(crs, inputs.dem_heights, "--dem-heights")
        if not has_heights(frame):
            raise undeclared("the ground", "--height", _OF_DEM, frame, _place(photos), _reach(photos, inputs.height))
        return Plane(frame, inputs.height)
    if inputs.dem is not None:
        from geomosaic.surface.dem import Dem

        info = inspect(inputs.dem)
        if inputs.dem_heights is None and info.crs is not None and not has_heights(info.crs):
            raise _undeclared_dem(inputs.dem, crs, photos)
        surface = Dem.open(inputs.dem, heights=inputs.dem_heights)
        try:
            Transform(surface.crs, geographic(surface.crs))
        except HeightDatumError as error:
            raise HeightDatumError(
                error.what,
                where=str(inputs.dem),
                mend="name a vertical datum whose grid is here: --dem-heights (heights under [dem] in the project) "
                "with 'egm96', 'ellipsoidal' or the path of a geoid grid",
            ) from error
        return surface
    if inputs.exterior is None:
        return None
    raise InputError(
        "there is no ground to project the images onto",
        mend="give a DEM (--dem, [dem] file) or one height in metres (--height, [dem] height)",
    )


def _undeclared_dem(path: Path, crs: CRS | None, photos: Sequence[Photo]) -> HeightDatumError:
    """Say what a DEM without a vertical datum could do at the first photo, else in its middle."""
    from geomosaic.surface.dem import Dem

    dem = Dem.open(path, heights="ellipsoidal")
    try:
        grid = dem.grid
        place, reach = grid.xy(np.array([[grid.width / 2, grid.height / 2]])), None
        if crs is not None and photos:
            under = Transform(horizontal(crs), grid.crs)(np.array([_place(photos)]))
            ground = float(dem.height(under)[0])
            place, reach = (under, _reach(photos, ground)) if math.isfinite(ground) else (place, None)
        return undeclared("the DEM", str(path), _OF_DEM, grid.crs, (float(place[0, 0]), float(place[0, 1])), reach)
    finally:
        dem.close()


_OF_DEM = "--dem-heights (in a project: heights under [dem])"
_OF_POSITIONS = "--heights (in a project: heights under [exterior])"


def _place(photos: Sequence[Photo]) -> tuple[float, float]:
    """Where the first photo was taken."""
    first = next((photo.exterior for photo in photos if photo.exterior), None)
    return first.position[:2] if first else (0.0, 0.0)


def _reach(photos: Sequence[Photo], ground: float) -> float | None:
    """Pixels that one metre of height moves the corner of the first photo, for a photo that looks down."""
    for photo in photos:
        if photo.exterior and photo.exterior.position[2] > ground:
            return math.hypot(*photo.info.size) / 2 / (photo.exterior.position[2] - ground)
    return None


def _model(
    inputs: BlockInputs,
    photo: Photo,
    crs: CRS | None,
    camera: Mapping[str, Any] | None,
    control: Sequence[ControlPoint],
) -> SensorModel:
    options = dict(inputs.options)
    if camera is not None:
        options["camera"] = dict(camera)
    row = photo.exterior
    if inputs.angles == RECONSTRUCTION and inputs.exterior is not None:
        options["orientation"] = {"system": RECONSTRUCTION, "reconstruction": str(inputs.exterior.resolve())}
    if row is not None:
        options["position"] = list(row.position)
        declared_too = {"frame": inputs.angle_frame, "matrix": inputs.matrix}
        extra = {name: word for name, word in declared_too.items() if word is not None}
        options["orientation"] = {"system": inputs.angles, **row.angles, **extra}
        options["angle_unit"] = inputs.angle_unit or "deg"
    if inputs.sensor == "planar":
        crs = _planar(options, photo, crs, control)
    request = SensorRequest(photo.name, photo.info.size, options, crs, str(inputs.base))
    try:
        return build_model(inputs.sensor, request)
    except InputError as error:
        if row is not None and error.where == photo.name and inputs.exterior is not None:
            error.where = f"{photo.name} ({inputs.exterior}, line {row.line})"
        raise


def _planar(options: dict[str, Any], photo: Photo, crs: CRS | None, control: Sequence[ControlPoint]) -> CRS | None:
    """Complete the inputs of a planar model: from control points in the image, else from its own georeference."""
    if {"transform", "geotransform", "points", "coefficients"} & set(options):
        return crs or photo.info.crs
    points = [point for point in control if point.image == photo.name and point.role == "control"]
    if points:
        options["points"] = [
            {"x": p.xyz[0], "y": p.xyz[1], "col": p.colrow[0], "row": p.colrow[1], "sigma": p.sigma_px} for p in points
        ]
        return crs
    own = photo.info.transform
    if own is None:
        raise InputError(
            "the image is not georeferenced, and nothing says where it lies",
            where=str(photo.path),
            mend="give --sensor with its inputs (see `geomosaic sensors`), or control points",
        )
    if crs is None and photo.info.crs is None:
        raise InputError("the image has a geotransform but no CRS", where=str(photo.path), mend="give --exterior-crs")
    options["transform"] = [own.a, own.b, own.c, own.d, own.e, own.f]
    return photo.info.crs or crs


def _control(inputs: BlockInputs, photos: Sequence[Photo], crs: CRS | None) -> tuple[ControlPoint, ...]:
    if inputs.control is None:
        return ()
    from geomosaic.project.control import read_control

    if crs is None:
        raise InputError(
            "the control points have no CRS", where=str(inputs.control), mend="name it: crs under [exterior]"
        )
    return read_control(inputs.control, [photo.name for photo in photos])
