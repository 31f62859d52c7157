"""Control of OpenDroneMap, `gcp_list.txt`."""

from __future__ import annotations

import math
import re

from pyproj import CRS

from geomosaic.control.reading import Measured, Reading, choose_image, control_of, ground_crs
from geomosaic.control.text import number, read_lines
from geomosaic.errors import InputError, counted
from geomosaic.types import PathLike

_UTM = re.compile(r"WGS\s?84\s+UTM\s+(?:zone\s+)?(\d{1,2})\s*([NS]?)", re.IGNORECASE)
_CRS = re.compile(r"\+(proj|init)=|epsg:\d|wgs\s?84\s+utm|(proj|geog|compd)(crs|cs)\[", re.IGNORECASE)
_COLUMNS = ("geo_x", "geo_y", "geo_z", "im_x", "im_y", "image_name")


def is_odm(first: str) -> bool:
    """Say whether a first line is that of OpenDroneMap: a CRS and nothing else."""
    return _CRS.match(first.strip()) is not None


def odm_crs(text: str, where: str) -> str:
    """Return the CRS of the first line: EPSG code, PROJ string, or 'WGS84 UTM 16N'.

    Raises
    ------
    InputError
        A UTM zone without hemisphere, or one that does not exist.
    """
    match = _UTM.fullmatch(text.strip())
    if match is None:
        return text.strip()
    zone, hemisphere = int(match[1]), match[2].upper()
    if not hemisphere or not 1 <= zone <= 60:
        what = f"there is no UTM zone {zone}" if hemisphere else f"UTM zone {zone} has no hemisphere"
        raise InputError(f"'{text.strip()}': {what}", where=where, mend="write for example: WGS84 UTM 16N")
    return f"EPSG:{(32600 if hemisphere == 'N' else 32700) + zone}"


def read_odm(path: PathLike, *, image: str | None = None, crs: str | CRS | None = None, half: float = 0.5) -> Reading:
    """Read control of one image: lines of x, y, z, image x, image y, image name and optionally the point's name.

    Parameters
    ----------
    path : path
    image : str, optional
        Needed where the file has several.
    crs : str or CRS, optional
        Must agree with the first line.
    half : float
        Added to image coordinates. OpenSfM, which OpenDroneMap reads them with, counts pixels by their centres from
        0 (its normalised coordinates are (x + 0.5 - width / 2) / size).

    Raises
    ------
    InputError
        Names file, line and column.
    """
    where = str(path)
    lines = [(origin, line) for origin, line in read_lines(path) if not line.lstrip().startswith("#")]
    if not lines or not is_odm(lines[0][1]):
        raise InputError("the first line names no CRS", where=where, mend="write one, for example: EPSG:32633")
    stated = odm_crs(lines[0][1], str(lines[0][0]))
    split = [(origin, line.split()) for origin, line in lines[1:]]
    for origin, fields in split:
        if len(fields) < len(_COLUMNS):
            raise InputError(
                f"{len(fields)} values where at least {len(_COLUMNS)} are needed",
                where=str(origin),
                mend=f"write: {' '.join(_COLUMNS)} [name], parted by tabs or blanks; names of images have no blanks",
            )
    if not split:
        raise InputError("there are no points in the file", where=where, mend="is it the right file?")
    chosen = choose_image([fields[5] for _, fields in split], image, where)
    points, made = [], 0
    for origin, fields in split:
        if fields[5] not in chosen:
            continue
        x, y, col, row = (number(fields[i], _COLUMNS[i], origin) for i in (0, 1, 3, 4))
        z = math.nan if fields[2].casefold() == "nan" else number(fields[2], "geo_z", origin)
        made += len(fields) == len(_COLUMNS)
        name = fields[6] if len(fields) > 6 else f"line {origin.number}"
        points.append(Measured(name, (col + half, row + half), (x, y, z), origin))
    notes = [f"{half:g} added to image coordinates: pixels are counted by their centres"] * bool(half)
    notes += [f"{counted(len(split) - len(points), 'point')} of other images left out"] * (len(split) > len(points))
    notes += [f"{counted(made, 'point')} without a name called by line"] * bool(made)
    return Reading(control_of(points, ground_crs(stated, crs, where), where), "odm", tuple(notes))
