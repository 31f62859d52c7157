"""Oriented images and blocks, their control points, and the footprints of images on the ground."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import geographic, horizontal
from geomosaic.geo.grid import Grid
from geomosaic.geo.projection_domain import GREAT, limits, near, whole_turn
from geomosaic.geo.transform import Transform
from geomosaic.sensor.plugin import HasRays, SensorModel
from geomosaic.sensor.solve import image_to_ground, image_to_height
from geomosaic.surface.model import Plane, Surface
from geomosaic.types import FloatArray

if TYPE_CHECKING:
    from shapely import Polygon

    from geomosaic.raster.cloud_mask import CloudMask


@dataclass(frozen=True, eq=False)
class OrientedImage:
    """Oriented image: a file and the sensor model that says where its pixels lie.

    Attributes
    ----------
    name : str
        Unique in its block.
    path : str
        The image file.
    sensor : str
        Name of the sensor plugin the model comes from.
    model : SensorModel
    nodata : float, optional
        Value of missing pixels, in place of what the file says.
    bands : tuple of int, optional
        Bands to use, counted from 1, in this order; all but alpha unless given.
    usable : tuple of (col, row), optional
        Corners of the part of the image that may be used, in order: no fiducial marks, no border of the film.
    covariance : array (P, P) or (P + Q, P + Q), optional
        Of the model's parameters in their units, after which may come those of its interior orientation.
    known_by : str
        Source of the covariance, or why there is none, in words.
    group : int
        Number of the declared block it belongs to: images of one sensor, or of one survey.
    acquired : str, optional
        Day of acquisition in ISO 8601, in place of what the file says.
    clouds : CloudMask, optional
        Pixels that are cloud.
    cloud_cover : float, optional
        Percentage of the image that is cloud, in place of what the file says.
    """

    name: str
    path: str
    sensor: str
    model: SensorModel
    nodata: float | None = None
    bands: tuple[int, ...] | None = None
    usable: tuple[tuple[float, float], ...] | None = None
    covariance: FloatArray | None = None
    known_by: str = ""
    group: int = 0
    acquired: str | None = None
    clouds: CloudMask | None = None
    cloud_cover: float | None = None


@dataclass(frozen=True)
class ControlPoint:
    """One image measurement of a point known on the ground.

    Attributes
    ----------
    id : str
    xyz : tuple of float
        In the block's `crs`, metres.
    image : str
        Name of the scene it is measured in.
    colrow : tuple of float
        Pixels, corner-based.
    sigma_xy, sigma_z : float
        Standard deviations on the ground, metres.
    sigma_x_y : tuple of float, optional
        Those of x and y, where the table tells each by itself; `sigma_xy` is their RMS then.
    correlations : tuple of float
        Of x and y, x and z, y and z.
    sigma_px : float
        Standard deviation of the measurement, pixels.
    covariance : tuple of (float, float), optional
        Of `colrow`, square pixels, where it is known; `sigma_px` stands for it where one value is wanted.
    role : str
        'control' takes part in adjustments, 'check' serves as independent check.
    where : str
        File and line, for messages.
    """

    id: str
    xyz: tuple[float, float, float]
    image: str
    colrow: tuple[float, float]
    sigma_xy: float = 0.0
    sigma_z: float = 0.0
    sigma_px: float = 1.0
    role: str = "control"
    where: str = field(default="", compare=False)
    sigma_x_y: tuple[float, float] | None = None
    correlations: tuple[float, float, float] = (0.0, 0.0, 0.0)
    covariance: tuple[tuple[float, float], tuple[float, float]] | None = None


@dataclass(frozen=True, eq=False)
class OrientedBlock:
    """Oriented images over one surface, as `Block` describes them before it is built.

    Attributes
    ----------
    scenes : tuple of OrientedImage
    surface : Surface or None
        None where no model uses heights.
    control : tuple of ControlPoint
    crs : CRS, optional
        3-D CRS of the control points.
    """

    scenes: tuple[OrientedImage, ...]
    surface: Surface | None
    control: tuple[ControlPoint, ...] = ()
    crs: CRS | None = None

    def __post_init__(self) -> None:
        names = [scene.name for scene in self.scenes]
        if not names:
            raise InputError("a block needs at least one image", hint="give images")
        doubled = sorted(name for name, times in Counter(names).items() if times > 1)
        if doubled:
            raise InputError(
                f"two images share the name '{doubled[0]}'", hint="rename one, or list the files one by one"
            )

    def scene(self, name: str) -> OrientedImage:
        """Scene of a name."""
        for scene in self.scenes:
            if scene.name == name:
                return scene
        raise InputError(
            f"no image named '{name}' in the block",
            hint=f"choose one of {', '.join(scene.name for scene in self.scenes)}",
        )


# Points along each side of the image.
SIDE = 24
# Halvings towards the border: within a 4096th of the way from the centre, about a pixel of a large image.
HALVINGS = 12


@dataclass(frozen=True, eq=False)
class Footprint:
    """Footprint of an image on the surface.

    Attributes
    ----------
    name : str
        Of the scene.
    ring : array (N, 2)
        Outline in the output map, not closed.
    centre : tuple of float
        The place seen best: the nadir point where the image shows it, else what the image centre shows.
    sampling : float
        Ground sampling distance at the centre, in output map units per pixel.
    complete : bool
        Whether the whole border of the image meets the surface.
    """

    name: str
    ring: FloatArray
    centre: tuple[float, float]
    sampling: float
    complete: bool

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Left, bottom, right, top."""
        (left, bottom), (right, top) = self.ring.min(axis=0), self.ring.max(axis=0)
        return float(left), float(bottom), float(right), float(top)

    @property
    def polygon(self) -> Polygon:
        """The outline as a valid shapely polygon; `InputError` where it has no area."""
        from shapely import Polygon, make_valid
        from shapely.geometry.polygon import orient

        polygon = Polygon(self.ring)
        if not polygon.is_valid:
            whole = make_valid(polygon)
            parts = [part for part in getattr(whole, "geoms", [whole]) if part.geom_type == "Polygon"]
            if not parts:
                raise InputError(
                    "the image covers a line of the map and no area",
                    where=self.name,
                    hint="check its geotransform or world file, or its orientation",
                )
            polygon = max(parts, key=lambda part: part.area)
        return orient(polygon)


def footprint(scene: OrientedImage, surface: Surface | None, crs: CRS) -> Footprint:
    """Footprint of an image: its border projected onto the surface and into the output map.

    Where a part of the border sees no ground (sky, or beyond the DEM), the outline follows the last point inwards that
    does. If the middle of the image looks at a hole of the DEM, or past its edge, the nearest place that sees ground
    stands for it; if it looks at the sky, that is an error: the angles are wrong.

    Parameters
    ----------
    scene : OrientedImage
    surface : Surface or None
        None where the model uses no heights.
    crs : CRS
        Of the output; a vertical part is ignored.

    Raises
    ------
    InputError
        Nothing of the image sees ground; says why as far as it can be told.
    """
    model = scene.model
    width, height = model.size
    centre = np.array([[width / 2, height / 2]])
    border = _border(width, height) if scene.usable is None else _around(scene.usable, width, height)
    ground = _ground(scene, np.vstack([centre + _STEPS, border]), surface, crs)
    if np.isnan(ground[:3]).any():
        found = _some_ground(scene, surface, crs)
        if found is None:
            raise _no_ground(scene, surface, crs)
        centre, ground[:3] = found
    # Longitudes of an image that crosses the 180th meridian must not jump by a turn along the outline.
    ground = near(ground, float(ground[0, 0]), whole_turn(crs))
    middle, ring = ground[0], ground[3:]
    # Root of the area of one pixel on the ground: a mean of both directions, whatever the image's turn.
    sampling = float(np.sqrt(abs(np.linalg.det(ground[1:3] - middle))))
    missing = np.isnan(ring).any(axis=1)
    if missing.any():
        ring = ring.copy()
        found_inwards = _inwards(scene, border[missing], centre[0], surface, crs, middle)
        ring[missing] = near(found_inwards, float(middle[0]), whole_turn(crs))
    ring = _about_pole(scene, surface, crs, ring)
    best = _nadir(scene, crs)
    if best is None or not _shows(scene, best, surface, crs):
        best = (float(middle[0]), float(middle[1]))
    return Footprint(scene.name, ring, best, sampling, not bool(missing.any()))


def _about_pole(scene: OrientedImage, surface: Surface | None, crs: CRS, ring: FloatArray) -> FloatArray:
    """What an image with a pole in it shows: in longitude and latitude all longitudes, up to that pole."""
    # On a map of the globe the border of the image may lie within the map; its inner places are asked then, too.
    turn, model = whole_turn(crs), scene.model
    if surface is not None:
        return ring
    if turn is None:
        return _with_inner_places(scene, crs, ring) if np.ptp(ring, axis=0).max() > GREAT else ring
    places = Transform(horizontal(crs), horizontal(model.crs))(np.array([[0.0, turn / 4], [0.0, -turn / 4]]))
    colrow = model.ground_to_image(np.column_stack([places, np.zeros(2)]))
    with np.errstate(invalid="ignore"):
        north, south = (bool(seen) for seen in np.all((colrow > 0) & (colrow < np.array(model.size)), axis=1))
    if not (north or south):
        return ring
    low = -turn / 4 if south else float(ring[:, 1].min())
    high = turn / 4 if north else float(ring[:, 1].max())
    return _rectangle(-turn / 2, low, turn / 2, high)


def _with_inner_places(scene: OrientedImage, crs: CRS, ring: FloatArray) -> FloatArray:
    """The ring, or the rectangle about all that the image shows where that reaches well beyond the ring."""
    t = (np.arange(4 * SIDE) + 0.5) / (4 * SIDE)
    inner = _ground(scene, np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2) * scene.model.size, None, crs)
    shown = np.vstack([ring, inner[np.isfinite(inner).all(axis=1)]])
    low, high = shown.min(axis=0), shown.max(axis=0)
    if not (high - low > 1.02 * np.ptp(ring, axis=0)).any():
        return ring
    if crs.is_projected:  # an end of the map that is nearer than two of those places to each other is reached
        ends, apart = np.array(limits(crs)).reshape(2, 2), (high - low) / (2 * SIDE)
        low = np.where(low - apart < ends[0], np.minimum(low, ends[0]), low)
        high = np.where(high + apart > ends[1], np.maximum(high, ends[1]), high)
    return _rectangle(low[0], low[1], high[0], high[1])


def _rectangle(left: float, low: float, right: float, high: float) -> FloatArray:
    return np.array([[left, high], [right, high], [right, low], [left, low]])


def _looks_down(scene: OrientedImage, colrow: FloatArray, surface: Surface) -> bool:
    """Whether a line of sight would meet the surface, had it no holes and no end."""
    low, high = surface.range
    if not np.isfinite(high):
        return False
    return bool(np.isfinite(image_to_ground(scene.model, colrow[None], Plane(surface.crs, (low + high) / 2))).all())


# A place in the image and one pixel from it in each direction.
_STEPS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])


def _some_ground(scene: OrientedImage, surface: Surface | None, crs: CRS) -> tuple[FloatArray, FloatArray] | None:
    """The place (1, 2) nearest to the middle of the image that sees ground, and the ground (3, 2) about it."""
    size = np.array(scene.model.size, dtype=np.float64)
    if surface is not None and not _looks_down(scene, size / 2, surface):
        return None
    t = (np.arange(SIDE // 2) + 0.5) / (SIDE // 2) - 0.5
    offsets = np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2) * size
    offsets = offsets[np.argsort(np.hypot(*offsets.T), kind="stable")]
    places = size / 2 + offsets
    ground = _ground(scene, (places[:, None] + _STEPS).reshape(-1, 2), surface, crs).reshape(-1, 3, 2)
    seen = np.flatnonzero(np.isfinite(ground).all(axis=(1, 2)))
    return (places[seen[:1]], ground[seen[0]]) if len(seen) else None


def _border(width: int, height: int) -> FloatArray:
    t = np.arange(SIDE) / SIDE
    one, zero = np.ones(SIDE), np.zeros(SIDE)
    sides = [np.column_stack(pair) for pair in ((t, zero), (one, t), (1 - t, one), (zero, 1 - t))]
    # A hair inside, so that the outline belongs to the image.
    ring: FloatArray = (np.vstack(sides) - 0.5) * (1 - 1e-9) + 0.5
    return ring * np.array([width, height], dtype=np.float64)


def _around(usable: tuple[tuple[float, float], ...], width: int, height: int) -> FloatArray:
    """Places along the border of the usable part, within the image."""
    import shapely

    ring = shapely.Polygon(usable).intersection(shapely.box(0, 0, width, height))
    ring = max(shapely.get_parts(ring), key=lambda part: part.area).exterior
    places: FloatArray = shapely.get_coordinates(shapely.segmentize(ring, ring.length / (4 * SIDE)))[:-1]
    return places


def _ground(scene: OrientedImage, colrow: FloatArray, surface: Surface | None, crs: CRS) -> FloatArray:
    """Image (N, 2) to output map (N, 2)."""
    xyz = image_to_ground(scene.model, colrow, surface)
    source = scene.model.crs if surface is None else surface.crs
    return Transform(horizontal(source), horizontal(crs))(xyz[:, :2])


def _inwards(
    scene: OrientedImage, border: FloatArray, centre: FloatArray, surface: Surface | None, crs: CRS, middle: FloatArray
) -> FloatArray:
    """For each border point, the outermost point towards the centre that sees ground, by bisection."""
    # Between the sweeps of a scanner rows may see nothing anywhere in the image, so a point without ground on the way
    # does not mean that there is none farther out: places that come ever nearer to the border are all asked first.
    shares = 1.0 - 0.5 ** np.arange(1, HALVINGS + 1)
    tried = centre + (border - centre) * shares[:, None, None]
    found = _ground(scene, tried.reshape(-1, 2), surface, crs).reshape(HALVINGS, -1, 2)
    levels = np.arange(1, HALVINGS + 1)[:, None]
    level = np.where(np.isfinite(found).all(axis=2), levels, 0).max(axis=0)
    places = np.where((level > 0)[:, None], found[level - 1, np.arange(len(border))], middle)
    seen, unseen = 1.0 - 0.5**level, 1.0 - 0.5 ** (level + 1.0)
    left = HALVINGS - 1 - level
    for step in range(max(0, int(left.max()))):
        active = np.flatnonzero(left > step)
        trial = (seen + unseen)[active] / 2
        ground = _ground(scene, centre + (border[active] - centre) * trial[:, None], surface, crs)
        hit = ~np.isnan(ground).any(axis=1)
        places[active[hit]] = ground[hit]
        seen[active], unseen[active] = np.where(hit, trial, seen[active]), np.where(hit, unseen[active], trial)
    return places


def _origin(scene: OrientedImage) -> FloatArray | None:
    """Projection centre (1, 3) of the image's middle, in the CRS of the model, where that has rays."""
    model = scene.model
    if not isinstance(model, HasRays):
        return None
    return model.rays(np.array([[model.size[0] / 2, model.size[1] / 2]]))[0]


def _nadir(scene: OrientedImage, crs: CRS) -> tuple[float, float] | None:
    """Map position of the projection centre of the image's middle, where the model has one."""
    model, origin = scene.model, _origin(scene)
    if origin is None:
        return None
    if model.crs.is_geocentric:
        lonlat = Transform(model.crs, geographic(model.crs))(origin)[:, :2]
        place = Transform(horizontal(geographic(model.crs)), horizontal(crs))(lonlat)[0]
    else:
        place = Transform(horizontal(model.crs), horizontal(crs))(origin[:, :2])[0]
    return (float(place[0]), float(place[1])) if np.isfinite(place).all() else None


def _shows(scene: OrientedImage, place: tuple[float, float], surface: Surface | None, crs: CRS) -> bool:
    """Whether a map place falls within the image."""
    if surface is None:
        return False
    xy = Transform(horizontal(crs), horizontal(surface.crs))(np.array([place]))
    z = surface.height(xy)
    colrow = scene.model.ground_to_image(Transform(surface.crs, scene.model.crs)(np.column_stack([xy, z])))[0]
    return bool(0 <= colrow[0] <= scene.model.size[0] and 0 <= colrow[1] <= scene.model.size[1])


def _within(grid: Grid, place: FloatArray) -> bool:
    """Whether a place (2,) lies within a grid."""
    left, bottom, right, top = grid.bounds
    return bool(left <= place[0] <= right and bottom <= place[1] <= top)


def _reach(grid: Grid | None) -> str:
    """Words on where a DEM lies: degrees that pass for metres show themselves."""
    if grid is None:
        return ""
    left, bottom, right, top = (f"{value:.8g}" for value in grid.bounds)
    return f"; the DEM reaches over x {left} to {right}, y {bottom} to {top} ({horizontal(grid.crs).name})"


def _no_ground(scene: OrientedImage, surface: Surface | None, crs: CRS) -> InputError:
    where = scene.name
    nadir = _nadir(scene, crs)
    if surface is not None and nadir is not None:
        xy = Transform(horizontal(crs), horizontal(surface.crs))(np.array([nadir]))
        if np.isnan(surface.height(xy)).any():
            grid: Grid | None = getattr(surface, "grid", None)  # of a DEM
            if grid is not None and _within(grid, xy[0]):
                return InputError(
                    f"the image sees nothing but a hole of the DEM: there is no height at x {nadir[0]:.1f}, "
                    f"y {nadir[1]:.1f} ({horizontal(crs).name}), though the DEM reaches farther",
                    where=where,
                    hint="fill the hole (for example with gdal_fillnodata), or leave the image out",
                )
            return InputError(
                f"the image lies outside the DEM: there is no height under the camera at x {nadir[0]:.1f}, "
                f"y {nadir[1]:.1f} ({horizontal(crs).name}){_reach(grid)}",
                where=where,
                hint="check the CRS of the positions and of the DEM, or give a DEM that covers the image",
            )
    if surface is None:
        return InputError(
            f"the middle of the image has no place in {horizontal(crs).name}",
            where=where,
            hint="check the CRS of the image, and the size, rotation and corner in its world file or geotransform",
        )
    origin = _origin(scene)
    if origin is None:
        return _no_ground_of_scene(scene, surface)
    camera = Transform(scene.model.crs, surface.crs)(origin)[0]
    ground = surface.height(camera[None, :2])[0]
    if ground >= camera[2]:
        return InputError(
            f"the camera lies below the ground: at {camera[2]:.1f} m, where the ground is at {ground:.1f} m",
            where=where,
            hint="check the heights of the positions and of the ground: units (feet for metres) and columns",
        )
    return InputError(
        "the middle of the image sees no ground: it looks at the sky, or past the edge of the DEM",
        where=where,
        hint="check the angle system and unit (a roll turned by 180°, radians for degrees) and the DEM's extent",
    )


def _no_ground_of_scene(scene: OrientedImage, surface: Surface) -> InputError:
    """Error of an image without projection centre (radar, RPCs) whose middle shows no ground of the surface."""
    model, height = scene.model, 0.5 * sum(surface.range)
    middle = np.array([[model.size[0] / 2, model.size[1] / 2]])
    place = image_to_height(model, middle, height, surface.crs)[0]
    if not np.isfinite(place).all():
        return InputError(
            f"the middle of the image sees no ground at {height:.0f} m, the middle height of the terrain: it looks at "
            "the sky, or past the horizon",
            where=scene.name,
            hint="check the angle system and unit (a roll turned by 180°, radians for degrees), that the metadata are "
            "of this image, and the heights and the place of the DEM",
        )
    grid: Grid | None = getattr(surface, "grid", None)  # of a DEM
    at = f"x {place[0]:.8g}, y {place[1]:.8g} ({horizontal(surface.crs).name})"
    if grid is not None and _within(grid, place):
        return InputError(
            f"the middle of the image shows a hole of the DEM: there is no height at {at}",
            where=scene.name,
            hint="fill the hole (for example with gdal_fillnodata), or leave the image out",
        )
    return InputError(
        f"the image lies outside the DEM: its middle shows {at}{_reach(grid)}",
        where=scene.name,
        hint="give a DEM that covers the image, or check that the metadata (for radar: orbit, times, ranges and the "
        "side it looks to) are of this image",
    )
