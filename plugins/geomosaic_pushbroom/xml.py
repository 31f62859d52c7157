"""Metadata in XML, read without what XML can do beyond naming values: no document types, no entities."""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.etree.ElementTree import Element

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.plain_xml import parse as parse_plain
from geomosaic.types import FloatArray

_SKIPPED = frozenset({"Sensor_Calibration", "Image_Display"})
"""Parts of a DIMAP file that are long and say nothing of geometry."""


def parse(data: bytes, where: str) -> Element:
    """Parse the parts of a metadata file that say something of geometry; see `geomosaic.sensor.plain_xml`."""
    return parse_plain(data, where, _SKIPPED)


def find(element: Element, path: str, where: str) -> Element:
    """Element at a path that must be there.

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
            mend="a level 1A scene with its whole METADATA.DIM is needed; a cut or rectified one has lost its geometry",
        )
    return found


def text(element: Element, path: str, where: str) -> str:
    """Text of the element at a path that must be there."""
    return (find(element, path, where).text or "").strip()


def number(element: Element, path: str, where: str) -> float:
    """Finite number at a path."""
    return _number(text(element, path, where), path, where)


def numbers(element: Element, path: str, where: str) -> FloatArray:
    """Finite numbers, parted by blanks, at a path."""
    return np.array([_number(word, path, where) for word in text(element, path, where).split()])


def children(element: Element, path: str, names: tuple[str, ...], where: str) -> FloatArray:
    """Table (K, len(names)) of all elements at a path, each with one child per name."""
    rows = [[number(child, name, where) for name in names] for child in each(element, path)]
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(names))


def each(element: Element, path: str) -> Iterator[Element]:
    """All elements at a path."""
    yield from element.iterfind(path)


def _number(word: str, path: str, where: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            f"<{path.removeprefix('.//')}> is '{word[:40]}', not a finite number",
            where=where,
            mend="get the file again",
        )
    return value
