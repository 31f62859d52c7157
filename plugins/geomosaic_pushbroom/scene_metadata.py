"""Scene metadata in one form for all formats, and the reading of numbers and times from their XML."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import date
from xml.etree.ElementTree import Element

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import finite_numbers, parse_xml
from geomosaic.types import FloatArray
from geomosaic_pushbroom.paths import Path
from geomosaic_pushbroom.pose import LookDirections

_TIME = re.compile(r"(\d{4})-(\d\d)-(\d\d)[T ](\d\d):(\d\d):(\d\d(?:\.\d*)?)Z?")


@dataclass(frozen=True)
class AprioriSigmas:
    """A-priori standard deviations of what the metadata reports: how far control points may correct it.

    Attributes
    ----------
    angles : float
        Degrees, of roll, pitch and yaw.
    rates : float
        Degrees per second.
    position : float
        Metres, each of across, along and up.
    """

    angles: float
    rates: float
    position: float


# SPOT 1 to 4: location without control within some 350 m RMS; angular speeds are integrated, so they drift.
GYROSCOPES = AprioriSigmas(angles=0.03, rates=3e-4, position=30.0)
# SPOT 5 with star tracker and DORIS: location without control within some 50 m RMS.
STARS = AprioriSigmas(angles=0.003, rates=3e-5, position=5.0)
# Pléiades: location without control within some 10 m.
AGILE = AprioriSigmas(angles=0.001, rates=3e-5, position=2.0)


@dataclass(frozen=True)
class SceneMetadata:
    """Orbit, attitude, look directions and times of one scene, as reported; times count from the row `middle`.

    Attributes
    ----------
    title : str
        Mission, instrument and date.
    path : Path
        Positions and axes over time.
    look : LookDirections
        Directions over columns.
    period : float
        Seconds per row.
    middle : float
        Row at t = 0.
    size : tuple of int
        Width and height of the whole scene in pixels.
    quality : AprioriSigmas
        Those of the mission.
    notes : tuple of str
        What was assumed in reading.
    """

    title: str
    path: Path
    look: LookDirections
    period: float
    middle: float
    size: tuple[int, int]
    quality: AprioriSigmas
    notes: tuple[str, ...] = ()


def seconds(text: str, where: str, since: tuple[int, float] = (0, 0.0)) -> float:
    """Seconds of a UTC time since another.

    Parameters
    ----------
    text : str
        Such as 2005-03-13T05:18:28.000000.
    where : str
        Named in errors.
    since : tuple
        Day and second of the day, see `utc_time`.

    Raises
    ------
    InputError
        The text is no time.
    """
    day, second = utc_time(text, where)
    return (day - since[0]) * 86400.0 + (second - since[1])


def utc_time(text: str, where: str) -> tuple[int, float]:
    """Day number and second of the day of a UTC time, apart, so that microseconds are not lost.

    Parameters
    ----------
    text : str
        Such as 2005-03-13T05:18:28.000000.
    where : str
        Named in errors.

    Returns
    -------
    day : int
        Proleptic Gregorian ordinal.
    second : float

    Raises
    ------
    InputError
        The text is no time.
    """
    found = _TIME.fullmatch(text.strip())
    try:
        if found is None:
            raise ValueError
        year, month, day, hour, minute = (int(found[i]) for i in range(1, 6))
        if hour > 23 or minute > 59 or not float(found[6]) < 61.0:
            raise ValueError
        return date(year, month, day).toordinal(), hour * 3600.0 + minute * 60.0 + float(found[6])
    except ValueError:
        raise InputError(
            f"'{text[:40]}' is not a time like 2005-03-13T05:21:07.332158", where=where, hint="get the file again"
        ) from None


def since_times(texts: list[str], where: str, since: tuple[int, float]) -> FloatArray:
    """Seconds of several UTC times since another.

    Parameters
    ----------
    texts : list of str
    where : str
        Named in errors.
    since : tuple
        Day and second of the day, see `utc_time`.

    Returns
    -------
    array (K,)

    Raises
    ------
    InputError
        A text is no time.
    """
    return np.array([seconds(text, where, since) for text in texts])


# Parts of a DIMAP file that are long and say nothing of geometry.
_SKIPPED = frozenset({"Sensor_Calibration", "Image_Display"})


def parse_dimap(data: bytes, where: str) -> Element:
    """Root of a DIMAP document, without the parts that say nothing of geometry; see `geomosaic.sensor.inputs`.

    Parameters
    ----------
    data : bytes
        Whole file.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The document is damaged, or has a document type.
    """
    return parse_xml(data, where, _SKIPPED)


def find(element: Element, path: str, where: str) -> Element:
    """Element at a path that must be there.

    Parameters
    ----------
    element : Element
    path : str
        Of ElementTree, below the element.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        It is missing; names the path.
    """
    found = element.find(path)
    if found is None:
        raise InputError(
            f"the metadata has no <{path.removeprefix('.//')}>",
            where=where,
            hint="give the whole metadata of a level 1A, SENSOR or 1B product; a rectified one has lost its geometry",
        )
    return found


def text(element: Element, path: str, where: str) -> str:
    """Text of the element at a path that must be there, without blanks at its ends.

    Parameters
    ----------
    element, path, where
        As for `find`.

    Raises
    ------
    InputError
        The element is missing.
    """
    return (find(element, path, where).text or "").strip()


def number(element: Element, path: str, where: str) -> float:
    """Finite number at a path that must be there.

    Parameters
    ----------
    element, path, where
        As for `find`.

    Raises
    ------
    InputError
        The element is missing, or no number.
    """
    return _number(text(element, path, where), path, where)


def numbers(element: Element, path: str, where: str) -> FloatArray:
    """Finite numbers, separated by blanks, at a path that must be there.

    Parameters
    ----------
    element, path, where
        As for `find`.

    Returns
    -------
    array (K,)

    Raises
    ------
    InputError
        The element is missing, or one is no number.
    """
    return np.array([_number(word, path, where) for word in text(element, path, where).split()])


def children(element: Element, path: str, names: tuple[str, ...], where: str) -> FloatArray:
    """Table of numbers: one row for each element at a path, one column for each of its children.

    Parameters
    ----------
    element : Element
    path : str
        Of ElementTree, below the element.
    names : tuple of str
        Of the children.
    where : str
        Named in errors.

    Returns
    -------
    array (K, len(names))
        K may be 0.

    Raises
    ------
    InputError
        A child is missing, or no number.
    """
    rows = [[number(child, name, where) for name in names] for child in element.iterfind(path)]
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(names))


def _number(word: str, path: str, where: str) -> float:
    return finite_numbers(word.split(), 1, f"<{path.removeprefix('.//')}>", where)[0]
