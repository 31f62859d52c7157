"""Coordinate reference systems, horizontal and vertical: always named, never guessed; their areas of use.

A 3-D CRS here is a geocentric CRS, a CRS with ellipsoidal heights (`to_3d`), or a compound of a horizontal
CRS and a vertical one whose heights are reached through a geoid grid. EGM96 comes with the package.
"""

from __future__ import annotations

import os
import re
from functools import lru_cache
from pathlib import Path

import pyproj
from pyproj import CRS
from pyproj.crs import CompoundCRS
from pyproj.exceptions import CRSError

from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.engineering_crs import LOCAL, VERTICAL, local_frame_crs
from geomosaic.stores.path import to_path
from geomosaic.types import PathLike

DATA = Path(__file__).parent / "data"

# The one setting of its process that the library changes: PROJ must find the geoid that comes with the package, and
# grids in the folders that the user names; pyproj itself looks only in its own.
for _folder in (str(DATA), *os.environ.get("PROJ_DATA", os.environ.get("PROJ_LIB", "")).split(os.pathsep)):
    if _folder and Path(_folder).is_dir():
        pyproj.datadir.append_data_dir(_folder)

EGM96 = "EPSG:5773"

# They separate, comment or assign in the text of an operation, and no quotes shield them there ('=' would give NaN).
_NOT_IN_PROJ = "#,;{="

_CARTESIAN = "CS[Cartesian,3]," + ",".join(
    f'AXIS["({axis})",geocentric{axis},ORDER[{i}],LENGTHUNIT["metre",1]]' for i, axis in enumerate("XYZ", start=1)
)
_DEGREES = (
    'CS[ellipsoidal,3],AXIS["geodetic latitude (Lat)",north,ORDER[1],ANGLEUNIT["degree",0.0174532925199433]],'
    'AXIS["geodetic longitude (Lon)",east,ORDER[2],ANGLEUNIT["degree",0.0174532925199433]],'
    'AXIS["ellipsoidal height (h)",up,ORDER[3],LENGTHUNIT["metre",1]]'
)


def image_crs() -> CRS:
    """CRS of the pixels of an image: engineering coordinates, which no map program takes for metres somewhere."""
    return CRS.from_wkt(
        'ENGCRS["image pixels",EDATUM["image"],CS[Cartesian,2],AXIS["col",east],AXIS["row",south],'
        'LENGTHUNIT["pixel",1]]'
    )


def parse_crs(text: str | CRS, where: str | None = None) -> CRS:
    """CRS of a text: an EPSG code, a PROJ string, WKT, the path of a .prj file, or 'local' for a frame without a place.

    Parameters
    ----------
    text : str or CRS
        A CRS is returned as it is.
    where : str, optional
        File or option that the text comes from, named in errors.

    Raises
    ------
    InputError
        The text names no CRS.
    """
    if isinstance(text, CRS):
        return text
    if not text or not text.strip():
        raise InputError("no CRS given", where=where, hint="name one, for example EPSG:32633")
    if text.strip().lower() == LOCAL:
        return local_frame_crs()
    try:
        return CRS.from_user_input(Path(text).read_text("utf-8") if text.lower().endswith(".prj") else text)
    except (CRSError, OSError, UnicodeDecodeError) as error:
        raise InputError(
            # Cut: PROJ's message repeats the text, which may be a whole file.
            f"'{text[:80]}' is not a coordinate reference system ({str(error)[:400]})",
            where=where,
            hint="give an EPSG code such as EPSG:32633, a PROJ string, WKT, the path of a .prj file, or 'local'",
        ) from error


def parse_map(text: str, where: str | None = None) -> CRS:
    """CRS of a map: the horizontal part of a CRS, which must have two axes.

    Parameters
    ----------
    text : str
        As `parse_crs` takes it.
    where : str, optional
        Named in errors.

    Returns
    -------
    CRS
        Projected, geographic or engineering, two-dimensional.

    Raises
    ------
    InputError
        The text names no CRS, or one in which no map can be drawn (geocentric, vertical).
    """
    crs = horizontal(parse_crs(text, where))
    if len(crs.axis_info) != 2 or crs.is_geocentric:
        raise InputError(
            f"'{text[:80]}' ({crs.name}) has not two axes, so no map can be drawn in it",
            where=where,
            hint="give a projected or a geographic CRS, such as EPSG:32633",
        )
    return crs


@lru_cache(maxsize=256)
def horizontal(crs: CRS) -> CRS:
    """Two-dimensional part of a CRS (itself when it has no vertical part).

    Parameters
    ----------
    crs : CRS

    Returns
    -------
    CRS
        A geocentric CRS has no horizontal part and is returned as it is.
    """
    if crs.is_compound:
        return horizontal(crs.sub_crs_list[0])
    if crs.is_bound and crs.source_crs is not None:
        return horizontal(crs.source_crs) if crs.source_crs.is_compound else crs
    if crs.is_engineering and len(crs.axis_info) == 3:  # PROJ leaves it as it is
        parts = crs.to_json_dict()
        parts["coordinate_system"]["axis"] = parts["coordinate_system"]["axis"][:2]
        return CRS.from_json_dict(parts)
    return crs.to_2d() if len(crs.axis_info) == 3 and not crs.is_geocentric else crs


def in_degrees(crs: CRS) -> bool:
    """Whether x and y are longitude and latitude, so that a metre is about 1e-5 of them.

    Parameters
    ----------
    crs : CRS
        2-D or 3-D. A geographic CRS in grads counts too.
    """
    return not crs.is_geocentric and bool(horizontal(crs).is_geographic)


def is_local(crs: CRS) -> bool:
    """Whether a CRS is a local engineering frame, such as that of a developed wall: metres, and no place on Earth.

    Parameters
    ----------
    crs : CRS
    """
    return bool(horizontal(crs).is_engineering)


def with_local_heights(crs: CRS) -> CRS:
    """CRS of a local frame with the heights of that frame, where it names no others; any other CRS as it is.

    Parameters
    ----------
    crs : CRS
    """
    # Nothing ties such heights to a geoid or an ellipsoid: there is no vertical datum to ask for.
    if crs.is_compound or not is_local(crs):
        return crs
    above = CRS.from_wkt(VERTICAL.format(name="height in the local frame", datum="local frame", z="Z"))
    return _compound(horizontal(crs), above)


def same_local(one: CRS, other: CRS) -> bool:
    """Whether two CRS are one local frame: their parts have the same names and units.

    Parameters
    ----------
    one, other : CRS
    """
    # GeoTIFF keeps of a local frame its name and unit only, so neither its datum nor its axes can be compared.
    if not (is_local(one) and is_local(other)):
        return False
    parts = (crs.sub_crs_list or [crs] for crs in (one, other))
    first, second = (
        [(part.name.casefold(), *(axis.unit_conversion_factor for axis in part.axis_info)) for part in each]
        for each in parts
    )
    return first == second


def authority_code(crs: CRS) -> str | None:
    """Code of a CRS in a registry, such as EPSG:32633; None where no registry has exactly this one.

    Parameters
    ----------
    crs : CRS
    """
    code = crs.to_authority(min_confidence=100)
    return ":".join(code) if code else None


def crs_code(crs: CRS) -> str:
    """Code of a CRS in a registry, else its name: what one line has room for.

    Parameters
    ----------
    crs : CRS
    """
    return authority_code(crs) or str(crs.name)


def crs_name(crs: CRS) -> str:
    """Name of the horizontal part of a CRS; its projection, or its ellipsoid, where it has no name of its own.

    Parameters
    ----------
    crs : CRS
    """
    flat = horizontal(crs)
    if flat.name.lower() not in ("unnamed", "unknown", "undefined"):
        return str(flat.name)
    if flat.coordinate_operation is not None:
        return f"{flat.coordinate_operation.method_name} (custom)"
    return f"geographic on {flat.ellipsoid.name}" if flat.is_geographic and flat.ellipsoid is not None else flat.name


def crs_label(crs: CRS) -> str:
    """Name of the horizontal part of a CRS with its code, where it has one.

    Parameters
    ----------
    crs : CRS
    """
    code = authority_code(horizontal(crs))
    return f"{crs_name(crs)} ({code})" if code else crs_name(crs)


def has_heights(crs: CRS) -> bool:
    """Whether a CRS declares the vertical datum of its heights.

    Parameters
    ----------
    crs : CRS
    """
    return crs.is_geocentric or crs.is_vertical or len(crs.axis_info) == 3


def height_name(crs: CRS) -> str:
    """Name of the vertical datum of a CRS.

    Parameters
    ----------
    crs : CRS

    Returns
    -------
    str
        'geocentric', 'ellipsoidal', the name of the vertical CRS, or 'undeclared'.
    """
    if crs.is_geocentric:
        return "geocentric"
    if crs.is_compound:
        return str(crs.sub_crs_list[1].name)
    return "ellipsoidal" if has_heights(crs) else "undeclared"


def with_heights(crs: CRS, heights: str, where: str | None = None) -> CRS:
    """Join a horizontal CRS and a vertical datum into one 3-D CRS.

    Parameters
    ----------
    crs : CRS
        Horizontal CRS; a vertical part it may have is replaced.
    heights : str
        'ellipsoidal', 'egm96', an EPSG code of a vertical CRS, or the path of a geoid grid (.tif or .gtx) whose
        values are the height of the geoid above the ellipsoid in metres.
    where : str, optional
        Named in errors.

    Returns
    -------
    CRS
        A 3-D CRS.

    Raises
    ------
    HeightDatumError
        The vertical datum is unknown or its grid file is missing.
    """
    flat = horizontal(crs)
    key = heights.strip()
    if key.lower() == "ellipsoidal":
        if is_local(flat):
            raise HeightDatumError(
                f"'{flat.name}' is a local frame: it has no ellipsoid for heights to count from",
                where=where,
                hint="leave the vertical datum out: heights are then those of the local frame",
            )
        return _ellipsoidal(flat)
    if key.lower() == "egm96":
        key = EGM96
    if key.lower().endswith((".tif", ".gtx")):
        return _compound(flat, _geoid_grid(key, where))
    try:
        vertical = CRS.from_user_input(key)
    except CRSError as error:
        raise HeightDatumError(
            f"'{heights}' is not a vertical datum",
            where=where,
            hint="give 'ellipsoidal', 'egm96', an EPSG code of a vertical CRS, or the path of a geoid grid",
        ) from error
    if not vertical.is_vertical:
        raise HeightDatumError(
            f"'{heights}' ({vertical.name}) is not a vertical CRS",
            where=where,
            hint="give a vertical CRS, such as EPSG:5773, or 'ellipsoidal'",
        )
    return _compound(flat, vertical)


@lru_cache(maxsize=32)
def in_space(crs: CRS) -> CRS:
    """CRS of places in space: ellipsoidal heights on top of a horizontal one, whose users ignore them; others as is.

    Parameters
    ----------
    crs : CRS
    """
    return crs if crs.is_geocentric or is_local(crs) or has_heights(crs) else with_heights(crs, "ellipsoidal")


def _compound(flat: CRS, vertical: CRS) -> CRS:
    return CompoundCRS(f"{flat.name} + {vertical.name}", [flat, vertical])


def _geoid_grid(path: PathLike, where: str | None) -> CRS:
    file = to_path(path)
    if not file.is_file():
        raise HeightDatumError("the geoid grid does not exist", where=where or str(path), hint="check the path")
    odd = "".join(sorted({mark for mark in str(file.resolve()) if mark in _NOT_IN_PROJ or not mark.isprintable()}))
    if odd:
        raise HeightDatumError(
            f"PROJ cannot open a geoid grid whose path has {odd!r} in it",
            where=where or str(path),
            hint="rename the file or its folder, or copy it to a path without such marks",
        )
    return _bound_vertical(str(file.resolve()))


@lru_cache
def _bound_vertical(path: str) -> CRS:
    """Vertical CRS bound to WGS 84 ellipsoidal heights by a grid file."""
    name, file = (text.replace('"', '""') for text in (Path(path).stem, path))  # as WKT quotes a quote
    wkt = f"""BOUNDCRS[
        SOURCECRS[VERTCRS["geoid {name}",VDATUM["geoid {name}"],CS[vertical,1],
            AXIS["gravity-related height (H)",up],LENGTHUNIT["metre",1]]],
        TARGETCRS[{CRS.from_epsg(4979).to_wkt()}],
        ABRIDGEDTRANSFORMATION["geoid height",METHOD["GravityRelatedHeight to Geographic3D"],
            PARAMETERFILE["Geoid (height correction) model file","{file}"]]]"""
    return CRS.from_wkt(wkt)


@lru_cache(maxsize=64)
def geocentric(crs: CRS) -> CRS:
    """Earth-centred, Earth-fixed Cartesian CRS on the datum of `crs` (no datum shift between them).

    Parameters
    ----------
    crs : CRS
        Geographic, projected or geocentric.

    Returns
    -------
    CRS
        X, Y, Z in metres.

    Raises
    ------
    InputError
        The CRS is not tied to the Earth (a local engineering CRS).
    """
    geodetic = horizontal(crs).geodetic_crs
    if geodetic is None:
        raise InputError(
            f"'{crs.name}' is not tied to the Earth",
            hint="use a geodetic or projected CRS, or the planar treatment of the camera",
        )
    if geodetic.is_geocentric:
        return geodetic
    return CRS.from_wkt(_with_axes(geodetic, f"{geodetic.name} (geocentric)", _CARTESIAN))


def _with_axes(geodetic: CRS, name: str, axes: str) -> str:
    """WKT of the same datum in other axes; PROJ reads it a hundred times as fast as JSON."""
    wkt = geodetic.to_wkt()
    start = re.match(r'GEO(?:G|D)CRS\["(?:[^"]|"")*"', wkt)
    end = wkt.find(",CS[")
    if start is None or end < 0:
        raise InputError(
            f"'{geodetic.name}' is no plain geodetic CRS", hint="use a CRS without an embedded transformation"
        )
    quoted = name.replace('"', '""')
    return f'GEODCRS["{quoted}"{wkt[start.end() : end]},{axes}]'


@lru_cache(maxsize=64)
def geographic(crs: CRS) -> CRS:
    """Geographic 3-D CRS on the datum of `crs`: longitude, latitude and ellipsoidal height.

    Parameters
    ----------
    crs : CRS
        Geographic, projected or geocentric.

    Returns
    -------
    CRS
        Degrees and metres, also where the datum's own geographic CRS counts in grads.

    Raises
    ------
    InputError
        The CRS is not tied to the Earth.
    """
    geodetic = _geodetic(crs)
    if _in_degrees(geodetic):
        return _ellipsoidal(geodetic)
    return CRS.from_wkt(_with_axes(geodetic, geodetic.name, _DEGREES))


def longitude_latitude_crs(crs: CRS) -> CRS:
    """Geographic 2-D CRS on the datum of `crs`: longitude and latitude in degrees.

    Parameters
    ----------
    crs : CRS
        Geographic, projected or geocentric.

    Raises
    ------
    InputError
        The CRS is not tied to the Earth.
    """
    geodetic = _geodetic(crs)
    return geodetic if _in_degrees(geodetic) and not geodetic.is_geocentric else horizontal(geographic(crs))


def _geodetic(crs: CRS) -> CRS:
    geodetic = horizontal(crs).geodetic_crs
    if geodetic is None:
        raise InputError(f"'{crs.name}' is not tied to the Earth", hint="give a CRS of the Earth, such as an EPSG code")
    return geodetic


def _in_degrees(geodetic: CRS) -> bool:
    """Whether it counts so: NTF, for one, counts in grads."""
    return all(axis.unit_name == "degree" for axis in geodetic.axis_info)


@lru_cache(maxsize=64)
def _ellipsoidal(flat: CRS) -> CRS:
    return flat.to_3d()
