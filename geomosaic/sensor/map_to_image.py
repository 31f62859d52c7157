"""Map to image: output map and heights of a block through every CRS in between; direction and scale of the view."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import has_heights, horizontal, longitude_latitude_crs
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.projection_domain import Domain, DomainBoundary, domain, near, whole_turn
from geomosaic.geo.transform import Transform
from geomosaic.interpolation import bilinear
from geomosaic.sensor.plugin import SensorModel
from geomosaic.surface.model import HeightPatch, Surface
from geomosaic.types import FloatArray

# Degrees along a seam that belong to neither side.
SLIVER = 1e-9


@dataclass(frozen=True, eq=False)
class MapToImage:
    """Map (x, y) of the output and height z of the surface to image (col, row).

    The map point is first brought to the surface's own map, where z has its meaning; only then do both go together to
    the model's frame. So heights never change their datum by accident.

    Attributes
    ----------
    model : SensorModel
    to_surface : Transform
        Output map → horizontal CRS of the surface (or of the model, where heights play no part).
    to_model : Transform
        Surface CRS → CRS of the model.
    turn : float, optional
        A whole turn of longitude, where the image lies in longitude and latitude: of places that are the same, the one
        nearest to its middle is meant.
    rim : DomainBoundary, optional
        End of the output's map, where that has one and the image lies in longitude and latitude: places beyond it are
        none.
    axis : tuple of float, optional
        Of a cylindrical map, x in the middle, its longitude, and whether longitudes grow (1) or fall (-1) with x: a
        place beyond one side goes on from there.
    branch : float
        Longitudes are those near the image's middle and so much farther east: half a turn brings together what lies
        on both sides of the seam of a picture of the whole globe.
    """

    model: SensorModel
    to_surface: Transform
    to_model: Transform
    turn: float | None = None
    rim: DomainBoundary | None = None
    axis: tuple[float, float, float] | None = None
    branch: float = 0.0

    @classmethod
    def between(cls, output: CRS, surface: CRS | None, model: SensorModel) -> MapToImage:
        """Chain output map, surface (None: heights play no part) and model.

        Parameters
        ----------
        output : CRS
            Map, 2-D.
        surface : CRS or None
            CRS of the surface, None where heights play no part.
        model : SensorModel
        """
        if surface is None or not has_heights(model.crs):
            flat = horizontal(model.crs)
            there, turn = Transform(horizontal(output), flat), whole_turn(flat)
            if turn is None or not output.is_projected:
                return cls(model, there, Transform(flat, flat), turn)
            shown = domain(horizontal(output))
            rim = DomainBoundary.of(output) if shown.folds else None
            axis = _axis(horizontal(output), there, shown) if shown.torn else None
            return cls(model, there, Transform(flat, flat), turn, rim, axis)
        return cls(model, Transform(horizontal(output), horizontal(surface)), Transform(surface, model.crs))

    @property
    def uses_heights(self) -> bool:
        """Whether the image position depends on height."""
        return self.to_model.spatial

    def surface_xy(self, xy: FloatArray) -> FloatArray:
        """Output map (N, 2) to the surface's map (N, 2)."""
        found = self.to_surface(xy)
        if self.rim is not None:
            found[self.rim.beyond(xy)] = np.nan
        if self.turn is None:
            return found
        if self.axis is None:
            return near(found, self.model.seed[0] + self.branch, self.turn)
        return self._beside_the_seam(xy, found, self.turn, *self.axis)

    def _beside_the_seam(
        self, xy: FloatArray, found: FloatArray, turn: float, x: float, middle: float, way: float
    ) -> FloatArray:
        """Longitudes that go on beyond the sides of a map, turned as those just within are."""
        side = np.where(xy[:, 0] < x, -way, way)
        # Longitude from the map's middle, −½ to ½ turn; beyond a side it has wrapped to the other sign and is put back.
        off = (found[:, 0] - middle + turn / 2) % turn - turn / 2
        off += side * turn * (side * off < -turn / 4)
        within = found.copy()
        within[:, 0] = middle + np.clip(off, -turn / 2 + SLIVER, turn / 2 - SLIVER)
        turned = near(within, self.model.seed[0] + self.branch, turn)
        turned[:, 0] += middle + off - within[:, 0]
        return turned

    def beside(self) -> tuple[MapToImage, MapToImage]:
        """The same with longitudes west and east of the image's seam, where this one has a turn."""
        half = (self.turn or 0.0) / 2
        return replace(self, branch=-half), replace(self, branch=half)

    def torn(self, places: FloatArray) -> bool:
        """Whether longitudes of neighbours in an array (rows, cols, 2) of surface places jump by a turn."""
        if self.turn is None:
            return False
        with np.errstate(invalid="ignore"):
            return any(bool((np.abs(np.diff(places[..., 0], axis=k)) > self.turn / 2).any()) for k in (0, 1))

    def image(self, surface_xy: FloatArray, z: FloatArray) -> FloatArray:
        """Surface map (N, 2) and heights (N,) to image (N, 2)."""
        return self.model.ground_to_image(self.to_model(np.column_stack([surface_xy, z])))

    def __call__(self, xy: FloatArray, z: FloatArray) -> FloatArray:
        """Output map (N, 2) and surface heights (N,) to image (N, 2)."""
        return self.image(self.surface_xy(xy), z)


def _axis(output: CRS, there: Transform, shown: Domain) -> tuple[float, float, float] | None:
    """X in the middle of a cylindrical map, its longitude there, and the sign with which longitudes go along x."""
    degrees = np.array([[shown.centre or 0.0, 0.0], [(shown.centre or 0.0) + 1.0, 0.0]])
    middle, beside = Transform(longitude_latitude_crs(output), output)(degrees)
    longitude = float(there(middle[None])[0, 0])
    way = float(np.sign(beside[0] - middle[0]))
    return (float(middle[0]), longitude, way) if way and np.isfinite(longitude) else None


@dataclass(frozen=True, eq=False)
class BlockGround:
    """Heights over one block of output pixels.

    Attributes
    ----------
    window : Window
        The block, in pixels of the output grid.
    patch : HeightPatch or None
        Heights of the surface; None where they play no part or none is known.
    heights : (float, float)
        Lowest and highest, in metres of the surface's datum; NaN where none is known.
    """

    window: Window
    patch: HeightPatch | None
    heights: tuple[float, float]

    @property
    def unknown(self) -> bool:
        """Whether no height is known here."""
        return bool(np.isnan(self.heights[0]))

    def over(self, surface_xy: FloatArray) -> tuple[float, float]:
        """Lowest and highest height within the bounds of some places (N, 2) of the surface's map; NaN where unknown."""
        if self.patch is None:
            return self.heights
        t = self.patch.transform
        x, y = surface_xy[:, 0], surface_xy[:, 1]
        col, row = t.a * x + t.b * y + t.c - 0.5, t.d * x + t.e * y + t.f - 0.5
        # One node more on each side, as heights are interpolated between nodes; 1e-6 of a cell is rounding.
        first_col, first_row = (max(0, int(np.floor(np.nanmin(v) - 1e-6)) - 1) for v in (col, row))
        last_col, last_row = (max(0, int(np.ceil(np.nanmax(v) + 1e-6)) + 2) for v in (col, row))
        return HeightPatch(self.patch.heights[first_row:last_row, first_col:last_col], t).range

    def height(self, surface_xy: FloatArray) -> FloatArray:
        """Heights (N,) at places (N, 2) of the surface's map, where and as the kernels find them; NaN elsewhere."""
        if self.patch is None:
            return np.full(len(surface_xy), self.heights[0])
        rows, cols = self.patch.heights.shape
        t, (x, y) = self.patch.transform, surface_xy.T
        node = np.column_stack([t.a * x + t.b * y + t.c, t.d * x + t.e * y + t.f]) - 0.5
        inside = np.all((node >= -0.5) & (node <= (cols - 0.5, rows - 0.5)), axis=1)
        node = np.clip(np.where(inside[:, None], node, 0.0), 0.0, (cols - 1.0, rows - 1.0))
        first = np.floor(node).astype(np.int64)
        return np.where(inside, bilinear(self.patch.heights, first, node - first), np.nan)


@dataclass(frozen=True, eq=False)
class Ground:
    """A surface under an output grid.

    Attributes
    ----------
    surface : Surface or None
        None where heights play no part.
    grid : Grid
    to_surface : Transform or None
        Output map to the surface's map.
    spacing : float
        Over which heights may be means, in units of the surface's map: the size of an output pixel at the middle of the
        grid, or a part of it.
    """

    surface: Surface | None
    grid: Grid
    to_surface: Transform | None
    spacing: float = 0.0

    @classmethod
    def under(cls, grid: Grid, surface: Surface | None, detail: float = 1.0) -> Self:
        """Surface under a grid; `detail` is in how many parts of an output pixel its heights may differ.

        Parameters
        ----------
        grid : Grid
        surface : Surface or None
        detail : float
            Parts of an output pixel in which heights may differ.
        """
        if surface is None:
            return cls(None, grid, None)
        to_surface = Transform(horizontal(grid.crs), horizontal(surface.crs))
        middle = np.array([grid.width / 2, grid.height / 2])
        place, right, below = to_surface(grid.xy(middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])))
        spacing = float(min(np.hypot(*(right - place)), np.hypot(*(below - place))))
        return cls(surface, grid, to_surface, spacing / detail if np.isfinite(spacing) else 0.0)

    def block(self, window: Window) -> BlockGround:
        """Heights of one block."""
        if self.surface is None or self.to_surface is None:
            return BlockGround(window, None, (0.0, 0.0))
        # Five places along each side: in another CRS the edges of the block are curved.
        cols = np.linspace(window.col, window.stop_col, 5)
        rows = np.linspace(window.row, window.stop_row, 5)
        c, r = np.meshgrid(cols, rows)
        xy = self.to_surface(self.grid.xy(np.column_stack([c.ravel(), r.ravel()])))
        xy = xy[np.isfinite(xy).all(axis=1)]
        if not len(xy):
            return BlockGround(window, None, (float("nan"), float("nan")))
        (left, bottom), (right, top) = xy.min(axis=0), xy.max(axis=0)
        # What the edges may bulge between those places.
        margin = 0.01 * max(right - left, top - bottom)
        bounds = left - margin, bottom - margin, right + margin, top + margin
        patch = self.surface.patch(bounds, self.spacing)
        return BlockGround(window, patch, patch.range)


@dataclass(frozen=True)
class Views:
    """View geometry at places on the ground.

    Attributes
    ----------
    angle : array (N,)
        Between the line of sight and the vertical, in degrees; NaN where the model does not see the place.
    azimuth : array (N,)
        From the place towards the sensor, in degrees from the map's north, clockwise; any where the angle is 0.
    sampling : array (N,)
        Ground sampling distance in metres, of level ground.
    """

    angle: FloatArray
    azimuth: FloatArray
    sampling: FloatArray


def views(mapper: MapToImage, xy: FloatArray, z: FloatArray, metres: FloatArray, step: float) -> Views:
    """Directions and scale in which an image sees places.

    Parameters
    ----------
    mapper : MapToImage
    xy : array (N, 2)
        Places in the output map.
    z : array (N,)
        Heights of the surface there, in metres.
    metres : array (2,)
        Metres per unit of the output map's x and y.
    step : float
        For the differences, in metres; about an image pixel on the ground or larger.
    """
    # The image position does not change along the line of sight, so its direction v solves J · v = 0 with the
    # derivatives J (2, 3) of (col, row) after (x, y, z): v is the cross product of J's rows. Models without heights
    # look down.
    jacobian = np.zeros((len(xy), 2, 3))
    for axis in range(3 if mapper.uses_heights else 2):
        move = np.zeros(3)
        move[axis] = step
        ahead, behind = (
            mapper(xy + sign * move[:2] / metres, z + sign * move[2]) if len(xy) else np.zeros((0, 2))
            for sign in (1.0, -1.0)
        )
        jacobian[:, :, axis] = (ahead - behind) / (2 * step)
    sight = np.cross(jacobian[:, 0], jacobian[:, 1])
    sight *= np.where(sight[:, 2:] < 0, -1.0, 1.0)  # upwards
    with np.errstate(divide="ignore"):
        sampling = 1 / np.sqrt(np.abs(sight[:, 2]))
    angle = np.degrees(np.arctan2(np.hypot(sight[:, 0], sight[:, 1]), sight[:, 2]))
    azimuth = np.degrees(np.arctan2(sight[:, 0], sight[:, 1])) % 360
    unseen = ~np.isfinite(sight).all(axis=1) | (np.abs(sight).max(axis=1, initial=0) == 0)
    return Views(*(np.where(unseen, np.nan, value) for value in (angle, azimuth, sampling)))
