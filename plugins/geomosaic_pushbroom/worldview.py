"""DigitalGlobe XML of basic products (1B) of QuickBird and WorldView: ephemeris, attitudes, detector line."""

from __future__ import annotations

from dataclasses import replace
from xml.etree.ElementTree import Element

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray
from geomosaic_pushbroom.dimap2 import orbit_about
from geomosaic_pushbroom.paths import QuaternionTable
from geomosaic_pushbroom.pose import LookDirections, choose_band, matrices_of_quaternions, quaternions_of
from geomosaic_pushbroom.scene_metadata import AGILE, SceneMetadata, find, number, numbers, seconds, text, utc_time

ROOT = "isd"
LIGHT = 299792458.0
# Metres: n − 1 = 2.77e-4 at 15 °C and 1013 hPa, over the 8434 m that the atmosphere would reach at that density.
ZENITH = 2.336
_WGS84 = np.array([6378137.0, 6378137.0, 6356752.314245])
_RPC = "use the sensor 'rpc', whose polynomials the same file has"


def read_worldview(root: Element, where: str, band: str | None = None) -> SceneMetadata:
    """Metadata of a basic product (1B) of DigitalGlobe.

    Parameters
    ----------
    root : Element
        Of the document.
    where : str
        Named in errors.
    band : str, optional
        Band whose detectors are taken; needed where those of the bands differ by more than a tenth of a pixel.

    Raises
    ------
    InputError
        Something is missing or wrong, or no product of scan lines; names it.

    Notes
    -----
    Row 0.5 is scanned at TLCTIME plus the time of line 0 in TLCLIST. Quaternions, scalar last, turn the axes of the
    satellite (forward, right, to the ground) to geocentric ones, and QCS those of the camera to the satellite's.
    Detector k of the line, from 0, is at DETORIGIN + DETPITCH · R(DETROTANGLE) · (0, −k) mm, at the distance PD.
    """
    if None in map(root.find, ("EPH", "ATT", "GEO")) or root.find(".//MAP_PROJECTED_PRODUCT") is not None:
        raise InputError(
            "this product has no ephemeris, attitudes and camera, or was rectified: its rows are no scan lines",
            where=where,
            hint=f"order it as Basic (1B), or {_RPC}",
        )
    size = (int(number(root, "IMD/NUMCOLUMNS", where)), int(number(root, "IMD/NUMROWS", where)))
    first, period = _lines(root, where)
    half = 0.5 * (size[1] - 1) * period
    middle = (first[0], first[1] + half)
    times, ephemeris = _samples(root, "EPH", "EPHEMLIST", 7, middle, where)
    orbit = orbit_about(times, ephemeris[:, 1:4], ephemeris[:, 4:7], half, where)
    times, attitudes = _samples(root, "ATT", "ATTLIST", 5, middle, where)
    near = np.abs(times) <= 1.5 * half
    times, turns = times[near], matrices_of_quaternions(attitudes[near][:, [4, 1, 2, 3]])
    lengths = np.linalg.norm(attitudes[near][:, 1:5], axis=1)
    if len(times) < 2 or times[0] > -half or times[-1] < half or np.abs(lengths - 1.0).max() > 1e-3:
        raise InputError("the attitudes do not cover the scene, or are no rotations", where=where, hint=_RPC)
    position, velocity = orbit.at(times)
    turns = turns @ matrices_of_quaternions(np.array([[number(root, f".//QCS{i}", where) for i in (4, 1, 2, 3)]]))[0]
    if any(number(root, f".//PERSPECTIVE_CENTER/C{axis}", where) for axis in "XYZ"):
        raise InputError("the perspective centre is off the satellite's own", where=where, hint=_RPC)
    look, notes = _look(root, size[0], band, where)
    middle_look = np.array([look.along.mean(), look.across.mean(), 1.0])
    seen, nearer = _bent(turns, position, velocity, middle_look / np.linalg.norm(middle_look), where)
    look = replace(look, along=_nearer(look.along, nearer), across=_nearer(look.across, nearer))
    title = f"{text(root, 'IMD/IMAGE/SATID', where)[:20]}, {text(root, 'IMD/IMAGE/TLCTIME', where)[:10]}"
    path = QuaternionTable(orbit, times, quaternions_of(seen))
    return SceneMetadata(title, path, look, period, 0.5 * size[1], size, AGILE, notes)


def _lines(root: Element, where: str) -> tuple[tuple[int, float], float]:
    """Time of the middle of the first row, and seconds per row."""
    table = np.array([[*numbers(row, ".", where)] for row in root.iterfind(".//TLCLIST")])
    if table.ndim != 2 or table.shape[1] != 2 or len(table) < 2 or not (np.diff(table, axis=0) > 0.0).all():
        raise InputError("TLCLIST is no table of rows and times that grow", where=where, hint=_RPC)
    period, start = np.polyfit(table[:, 0], table[:, 1], 1)
    if np.abs(start + period * table[:, 0] - table[:, 1]).max() > 0.05 * period:
        raise InputError("rows are not scanned at a constant rate", where=where, hint=_RPC)
    day, second = utc_time(text(root, ".//TLCTIME", where), where)
    return (day, second + start), float(period)


def _samples(
    root: Element, part: str, name: str, least: int, middle: tuple[int, float], where: str
) -> tuple[FloatArray, FloatArray]:
    """Times, from the middle of the scene, and rows of numbers of a list at equal intervals."""
    rows = [numbers(row, ".", where) for row in root.iterfind(f"{part}/{name}List/{name}")]
    if not rows or min(map(len, rows)) < least or len({len(row) for row in rows}) != 1:
        raise InputError(f"<{name}> has not {least} numbers or more in each line", where=where, hint=_RPC)
    table = np.array(rows)
    start = seconds(text(root, f"{part}/STARTTIME", where), where, middle)
    # The numbers of the points, from 1, count the intervals: some may be left out.
    return start + (table[:, 0] - 1.0) * number(root, f"{part}/TIMEINTERVAL", where), table


def _bent(
    turns: FloatArray, position: FloatArray, velocity: FloatArray, look: FloatArray, where: str
) -> tuple[FloatArray, float]:
    """Axes (N, 3, 3), in columns, turned from where the ground appears to where it is, and the scale about `look`."""
    toward = turns @ look
    # Light comes in aslant to what moves: v/c is 15 m on the ground.
    shift = -velocity / LIGHT
    # Half of the way through a layered atmosphere a place appears nearer to the nadir, by ZENITH·tan z / cos² z.
    o, d = position / _WGS84, (toward + shift) / _WGS84
    a, b, c = (d * d).sum(axis=1), (o * d).sum(axis=1), (o * o).sum(axis=1) - 1.0
    inside = b * b - a * c
    if not (inside > 0.0).all() or not (b < 0.0).all():
        raise InputError("the satellite looks past the Earth", where=where, hint=_RPC)
    distance = (-b - np.sqrt(inside)) / a
    normal = (position + toward * distance[:, None]) / _WGS84**2
    down = -normal / np.linalg.norm(normal, axis=1)[:, None]
    cosine = (toward * down).sum(axis=1)
    # The length of down − toward·cos z is sin z; seen at an angle, the displacement is shorter by cos z.
    shift = shift + (down - toward * cosine[:, None]) * (ZENITH / (cosine**2 * distance))[:, None]
    ahead = (shift * toward).sum(axis=1)
    across = shift - toward * ahead[:, None]
    out: FloatArray = turns + across[:, :, None] * (toward[:, None, :] @ turns)
    out = out - toward[:, :, None] * (across[:, None, :] @ turns)
    return out, 1.0 + float(ahead.mean())


def _nearer(slopes: FloatArray, scale: float) -> FloatArray:
    out: FloatArray = slopes.mean() + (slopes - slopes.mean()) / scale
    return out


def _look(root: Element, width: int, band: str | None, where: str) -> tuple[LookDirections, tuple[str, ...]]:
    """Look directions over the columns."""
    order = root.find(".//OPTICAL_DISTORTION/POLYORDER")
    if order is not None and number(root, ".//OPTICAL_DISTORTION/POLYORDER", where) > 0.0:
        raise InputError("the camera has optical distortion, which is not known here", where=where, hint=_RPC)
    distance = number(root, ".//PRINCIPAL_DISTANCE/PD", where)
    if not distance > 0.0:
        raise InputError(f"PD is {distance:g} mm", where=where, hint=_RPC)
    looks = {}
    for mounted in find(root, ".//DETECTOR_MOUNTING", where):
        arrays = mounted.findall("DETECTOR_ARRAY")
        if not arrays:
            continue
        if len(arrays) > 1:
            raise InputError(f"{mounted.tag} has {len(arrays)} detector arrays", where=where, hint=_RPC)
        x, y, turn, pitch = (
            number(arrays[0], name, where) for name in ("DETORIGINX", "DETORIGINY", "DETROTANGLE", "DETPITCH")
        )
        along = np.array([0.0, width - 1.0]) * pitch
        cols = np.array([0.5, width - 0.5])
        right = (y - along * np.cos(np.radians(turn))) / distance
        looks[mounted.tag.removeprefix("BAND_")] = LookDirections.of(
            cols, right, (x + along * np.sin(np.radians(turn))) / distance, where
        )
    if not looks:
        find(root, ".//DETECTOR_ARRAY", where)
    return choose_band(looks, band, where)
