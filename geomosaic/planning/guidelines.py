"""Tables of the technical guidelines K-2.8 on orthophoto maps (2001), and the formulas behind them.

The guidelines give the tables for maps 1:2000, 1:5000 and 1:10 000; the functions reproduce every number of them
and hold at other scales, except where a table is the only source.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from geomosaic.errors import InputError
from geomosaic.options.planning import FILMS, TableOptions
from geomosaic.options.sheet import scale_text
from geomosaic.planning.relations import checked

Terrain = Literal["easy", "difficult"]

# Mean error of position on the map, mm.
_POSITION_MM = 0.3
# Distance in mm of the corner of a photo of 23 cm from its principal point, as the guidelines round it, and the camera
# constant in mm that the table of height errors is built on.
CORNER, CONSTANT = 140.0, 150.0
# Pixel of the photo map on paper, mm: 317 and 254 dpi.
_PRINT_MM: dict[str, float] = {"grey": 0.08, "colour": 0.10}
# Range of the scanning pixel, µm.
SCAN_UM: dict[str, tuple[float, float]] = {"grey": (12.0, 25.0), "colour": (20.0, 30.0)}
# K = M_photo / M_ortho by scale of the map.
RATIOS = {2000: 4.0, 5000: 3.5, 10000: 3.0}
# The pixel of the photo map is this many times that of the scan on the ground.
PIXEL_GAIN = (1.1, 1.2)


@dataclass(frozen=True)
class Interval:
    """Row of the table of grid intervals.

    Attributes
    ----------
    photo : (int, int), range of photo scales, denominators
    easy, difficult : (float, float), range of the interval of the DEM in easy and difficult terrain, metres
    """

    photo: tuple[int, int]
    easy: tuple[float, float]
    difficult: tuple[float, float]


# Recommended interval of the DEM by scale of the map.
INTERVALS = {
    2000: Interval((5000, 8000), (10.0, 15.0), (5.0, 10.0)),
    5000: Interval((12000, 18000), (15.0, 20.0), (10.0, 15.0)),
    10000: Interval((20000, 30000), (20.0, 30.0), (15.0, 20.0)),
}


def position_error(ortho_scale: float) -> float:
    """Mean error of position on the ground: 0.3 mm on the map.

    Parameters
    ----------
    ortho_scale : float, denominator of the photo map's scale

    Returns
    -------
    float, metres

    Raises
    ------
    InputError
        A scale that is not above 0.
    """
    return _POSITION_MM * checked("ortho_scale", ortho_scale) / 1000


def height_error(ortho_scale: float, camera_constant: float, radius: float) -> float:
    """Largest admissible error of a DEM height: m_O · (140 / r) · (c / 150), with m_O = 0.3 mm · M.

    Parameters
    ----------
    ortho_scale : float, denominator M of the photo map's scale
    camera_constant : float, c, mm
    radius : float, r, mm from the principal point up to which the photo is used

    Returns
    -------
    float, metres

    Raises
    ------
    InputError
        A value that is not above 0.
    """
    c, r = checked("camera_constant", camera_constant), checked("radius", radius)
    # The law m_DTM = m_O · c / r alone gives 7 % more (0.64 m where the table has 0.6 m): the guidelines stay below it
    # so that the numbers are round.
    return position_error(ortho_scale) * (CORNER / r) * (c / CONSTANT)


def radial_shift(dem_error: float, ortho_scale: float, camera_constant: float, radius: float = CORNER) -> float:
    """Radial shift on the map of a pixel whose height is wrong: m_DTM · r / (c · M).

    Parameters
    ----------
    dem_error : float, error of the height m_DTM, metres
    ortho_scale : float, denominator M of the photo map's scale
    camera_constant : float, c, mm
    radius : float, r, mm from the principal point; by default that of the photo's corner

    Returns
    -------
    float, mm on the map

    Raises
    ------
    InputError
        A value out of its range.
    """
    c, r = checked("camera_constant", camera_constant), checked("radius", radius)
    return 1000 * checked("dem_error", dem_error) * r / (c * checked("ortho_scale", ortho_scale))


def ortho_pixel(ortho_scale: float, film: str) -> float:
    """Pixel of the photo map on the ground: 0.08 mm of the map in grey, 0.10 mm in colour.

    Parameters
    ----------
    ortho_scale : float, denominator of the photo map's scale
    film : 'grey' or 'colour'

    Returns
    -------
    float, metres

    Raises
    ------
    InputError
        A scale that is not above 0.
    """
    return _PRINT_MM[film] * checked("ortho_scale", ortho_scale) / 1000


def dpi_of(film: str) -> float:
    """Resolution of the photo map on paper.

    Parameters
    ----------
    film : 'grey' or 'colour'

    Returns
    -------
    float, dots per inch: 317.5 in grey, 254 in colour
    """
    # Rounded: 25.4 / 0.1 is 253.99999999999997 in binary.
    return round(25.4 / _PRINT_MM[film], 6)


def interval(ortho_scale: float, terrain: Terrain) -> tuple[float, float]:
    """Recommended range of the DEM's grid interval.

    Parameters
    ----------
    ortho_scale : float, denominator of the photo map's scale
    terrain : 'easy' or 'difficult'

    Returns
    -------
    least, most : float, metres

    Raises
    ------
    InputError
        The guidelines have no row for this scale; there is no formula behind the table.
    """
    # Scales may come out of a formula, with rounding in their last digits.
    row = INTERVALS.get(round(ortho_scale))
    if row is None:
        raise InputError(
            f"K-2.8 has no grid interval for {scale_text(ortho_scale)}",
            where="`ortho_scale`",
            hint=f"the table has {', '.join(f'1:{scale}' for scale in INTERVALS)}",
        )
    return row.easy if terrain == "easy" else row.difficult


# Distances from the principal point in mm, and errors of height in metres, that the tables have.
RADII = (35.0, 70.0, 140.0)
HEIGHT_ERRORS = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0)


@dataclass(frozen=True)
class ScaleTable:
    """Tables of one scale.

    Attributes
    ----------
    ortho_scale : float, denominator
    ratio : float, optional, K = M_photo / M_ortho
    photo_scale : tuple of float, optional, range of denominators
    scan_pixel : mapping of str to tuple of float, range in µm by film
    position_error : float, metres
    ortho_pixel, ortho_dpi : mapping of str to float, metres and dots per inch by film
    dem_interval : mapping of str to tuple of float, optional, range in metres by terrain
    dem_error : mapping of str to mapping of str to float, metres by camera constant and radius
    shift_mm : mapping of str to mapping of str to float, mm on the map by camera constant and error of height
    """

    ortho_scale: float
    ratio: float | None
    photo_scale: tuple[int, int] | None
    scan_pixel: Mapping[str, tuple[float, float]]
    position_error: float
    ortho_pixel: Mapping[str, float]
    ortho_dpi: Mapping[str, float]
    dem_interval: Mapping[str, tuple[float, float]] | None
    dem_error: Mapping[str, Mapping[str, float]]
    shift_mm: Mapping[str, Mapping[str, float]]


def scale_tables(wanted: TableOptions) -> tuple[ScaleTable, ...]:
    """Tables of the guidelines at any scale and camera constant.

    Parameters
    ----------
    wanted : TableOptions

    Raises
    ------
    InputError
        A value that is not above 0.
    """
    return tuple(_scale_table(scale, wanted.camera_constant) for scale in wanted.ortho_scale)


def _scale_table(scale: float, constants: tuple[float, ...]) -> ScaleTable:
    row = INTERVALS.get(round(scale))
    return ScaleTable(
        scale,
        RATIOS.get(round(scale)),
        None if row is None else row.photo,
        {film: SCAN_UM[film] for film in FILMS},
        position_error(scale),
        {film: ortho_pixel(scale, film) for film in FILMS},
        {film: dpi_of(film) for film in FILMS},
        None if row is None else {"easy": row.easy, "difficult": row.difficult},
        {f"{c:g}": {f"{r:g}": height_error(scale, c, r) for r in RADII} for c in constants},
        {f"{c:g}": {f"{z:g}": radial_shift(z, scale, c) for z in HEIGHT_ERRORS} for c in constants},
    )
