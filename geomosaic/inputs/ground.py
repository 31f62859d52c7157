"""Ground of a block: its surface, the cost of undeclared heights, and its height below a photo."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from pyproj import CRS

from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import geocentric, geographic, has_heights, horizontal, is_local, with_local_heights
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.exterior_orientation import SELF_PLACED
from geomosaic.inputs.images import Photo
from geomosaic.inputs.vertical_datums import undeclared_heights_error, with_declared_heights
from geomosaic.raster.info import inspect
from geomosaic.sensor.registry import capabilities, carried_sensors, plane_sensor
from geomosaic.surface.dem import Dem
from geomosaic.surface.model import Surface
from geomosaic.types import FloatArray

OF_POSITIONS = "`heights`"
_OF_DEM = "`dem_heights`"
# Bytes that the DEM of a block may hold where nothing is rendered: plans and checks keep the least limits with it.
DEM_MEMORY = 64 << 20


def build_surface(
    inputs: Block,
    crs: CRS | None,
    photos: Sequence[Photo] = (),
    of_model: Callable[[], float | None] = lambda: None,
    memory: int = DEM_MEMORY,
) -> Surface | None:
    """Surface of a DEM or of one height; None where neither is given.

    Parameters
    ----------
    inputs : Block
    crs : CRS or None
        CRS of the positions; a height without a datum of its own takes theirs.
    photos : sequence of Photo
        Photos for the figures in errors.
    of_model : callable
        Pixels that a metre of height moves the image, for errors about images without a table of positions.
    memory : int
        Bytes that a DEM may hold between reads.

    Raises
    ------
    InputError
        Neither is given, or a height has no CRS.
    HeightDatumError
        Heights have no vertical datum, or one whose grid is missing.
    """
    if inputs.height is not None:
        from geomosaic.surface.model import Plane

        if crs is None and (capabilities(inputs.sensor).carries_placement or inputs.angles in SELF_PLACED):
            # Images that carry their own placement need no CRS of positions: any serves to attach a vertical datum to.
            crs = CRS.from_epsg(4326)
        if crs is None:
            found = [(path, inspect(path).size) for path in inputs.images] if inputs.sensor == plane_sensor() else []
            own = " or ".join(f"`sensor={name}`" for name in carried_sensors(found)) if found else ""
            hint = (
                f"the image carries a model of its own: take it with {own}"
                if own
                else "name it with `crs`; of a raw image name its `sensor` too"
            )
            raise InputError("a height needs a CRS", hint=hint)
        frame = with_declared_heights(crs, inputs.dem_heights, "`dem_heights`")
        if not has_heights(frame):
            raise undeclared_heights_error(
                "the ground", "`height`", _OF_DEM, frame, _place(photos), _reach(photos, inputs.height)
            )
        return Plane(frame, inputs.height)
    if inputs.dem is not None:
        if isinstance(inputs.dem, Dem):
            return inputs.dem
        info = inspect(inputs.dem)
        # Never guessed: geoid and ellipsoid differ by up to 100 m, and a wrong guess shifts orthos without an error.
        if inputs.dem_heights is None and info.crs is not None and not has_heights(with_local_heights(info.crs)):
            raise _undeclared_dem(inputs.dem, crs, photos, of_model)
        surface = Dem.open(inputs.dem, heights=inputs.dem_heights, memory_limit=memory)
        if is_local(surface.crs):
            return surface
        try:
            Transform(surface.crs, geocentric(surface.crs))
        except HeightDatumError as error:
            raise HeightDatumError(
                error.what,
                where=str(inputs.dem),
                hint="name a vertical datum whose grid is here: `dem_heights` "
                "with 'egm96', 'ellipsoidal' or the path of a geoid grid",
            ) from error
        return surface
    if inputs.dem_from_tie_points:
        raise InputError(
            "the ground is to be made of tie points, and the block is not adjusted",
            where="`dem_from_tie_points`",
            hint="adjust it (`gm.adjust`), and give the adjusted block",
        )
    if inputs.exterior is None:
        return None
    raise InputError(
        "there is no ground to project the images onto",
        hint="give a DEM (`dem`) or one height in metres (`height`); or adjust the block, which gives it tie points",
    )


def undeclared_positions(inputs: Block, crs: CRS, photos: Sequence[Photo]) -> HeightDatumError:
    """Error about positions without a vertical datum, with the cost of a wrong guess at the first photo.

    Parameters
    ----------
    inputs : Block
    crs : CRS
        CRS of the positions.
    photos : sequence of Photo
        Photos; the first above the ground gives place and flying height.

    Returns
    -------
    HeightDatumError
        To be raised by the caller.
    """
    ground = 0.0 if inputs.height is None else inputs.height
    if inputs.dem is not None:
        ground = _as_written(inputs.dem, crs, photos)[1]
    reach = _reach(photos, ground)
    return undeclared_heights_error("the positions", str(inputs.exterior), OF_POSITIONS, crs, _place(photos), reach)


def _undeclared_dem(
    path: Path, crs: CRS | None, photos: Sequence[Photo], of_model: Callable[[], float | None]
) -> HeightDatumError:
    """Error of a DEM without a vertical datum, with its cost at the first photo, else in its middle."""
    dem = Dem.open(path, heights="ellipsoidal")
    grid = dem.grid
    dem.close()
    place = grid.xy(np.array([[grid.width / 2, grid.height / 2]]))
    reach = None if any(photo.exterior for photo in photos) else of_model()
    if crs is not None and photos:
        under, ground = _as_written(path, crs, photos)
        place, reach = (under, _reach(photos, ground)) if math.isfinite(ground) else (place, None)
    return undeclared_heights_error(
        "the DEM", str(path), _OF_DEM, grid.crs, (float(place[0, 0]), float(place[0, 1])), reach
    )


def _as_written(path: Path | Dem, crs: CRS, photos: Sequence[Photo]) -> tuple[FloatArray, float]:
    """First photo's place in the CRS of the DEM (1, 2), and the height stored there; NaN where there is none."""
    given = isinstance(path, Dem)
    # Any datum will do, as heights are taken as they are stored.
    dem = path if isinstance(path, Dem) else Dem.open(path, heights="ellipsoidal")
    try:
        under = Transform(horizontal(crs), dem.grid.crs)(np.array([_place(photos)]))
        return under, float(dem.height(under)[0])
    finally:
        if not given:
            dem.close()


def _place(photos: Sequence[Photo]) -> tuple[float, float]:
    """Place of the first photo that has one; NaN where none has."""
    first = next((photo.exterior for photo in photos if photo.exterior and photo.exterior.placed), None)
    return first.position[:2] if first else (math.nan, math.nan)


def _reach(photos: Sequence[Photo], ground: float) -> float | None:
    """Pixels that one metre of height moves the corner of the first photo, for a photo that looks down."""
    for photo in photos:
        if photo.exterior and photo.exterior.position[2] > ground:
            # Relief displacement of a vertical photo: radial distance times height over flying height.
            return math.hypot(*photo.info.size) / 2 / (photo.exterior.position[2] - ground)
    return None


def height_below(surface: Surface, crs: CRS, position: Sequence[float]) -> float | None:
    """Height of the ground below a position, in the vertical datum of the position.

    Parameters
    ----------
    surface : Surface
    crs : CRS
        3-D CRS of the position; with a geocentric one heights refer to its ellipsoid.
    position : sequence of float
        x, y, z.

    Returns
    -------
    float or None
        In the vertical datum and unit of `crs`; None where the surface has no height there, or none below.
    """
    level = geographic(crs) if crs.is_geocentric else crs
    if not has_heights(level):
        return None
    points = np.array([position], dtype=np.float64)
    try:
        foot = Transform(crs, surface.crs)(points)
        foot[:, 2] = surface.height(foot[:, :2])
        below = float(Transform(surface.crs, level)(foot)[0, 2])
        own = float(Transform(crs, level)(points)[0, 2])
    except (InputError, HeightDatumError):
        return None  # the sensor's own error will name the image
    return below if below < own else None
