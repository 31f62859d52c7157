"""Values of XML annotations of radar products, by paths of elements; errors name what is missing."""

from __future__ import annotations

from xml.etree.ElementTree import Element

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import finite_numbers
from geomosaic.types import FloatArray
from geomosaic_sar.orbit import StateVectors
from geomosaic_sar.scene import Epoch

AGAIN = "get the annotation of the product again"
# Lines or columns of a scene; the longest products have some hundred thousand.
_MOST_PIXELS = 10_000_000


def text(root: Element, path: str, where: str) -> str:
    """Text of an element; `where` is named in errors.

    Parameters
    ----------
    root : Element
    path : str
        From it, as ElementTree has them.
    where : str

    Raises
    ------
    InputError
        There is none.
    """
    found = root.findtext(path)
    if found is None or not found.strip():
        raise InputError(f"<{path}> is missing", where=where, hint=AGAIN)
    return found.strip()


def number(root: Element, path: str, where: str) -> float:
    """Finite number of an element; see `text`.

    Parameters
    ----------
    root : Element
    path, where : str
    """
    return finite_numbers([text(root, path, where)], 1, f"<{path}>", where)[0]


def above_zero(root: Element, path: str, where: str) -> float:
    """Number above zero of an element; see `text`.

    Parameters
    ----------
    root : Element
    path, where : str
    """
    found = number(root, path, where)
    if not found > 0.0:
        raise InputError(f"<{path}> is {found:g}, not above 0", where=where, hint=AGAIN)
    return found


def pixels(root: Element, columns: str, rows: str, where: str) -> tuple[int, int]:
    """Width and height of an image.

    Parameters
    ----------
    root : Element
    columns, rows : str
        Paths of the two elements.
    where : str
        Named in errors.
    """
    width, height = (number(root, path, where) for path in (columns, rows))
    if not (1 < width < _MOST_PIXELS and 1 < height < _MOST_PIXELS):
        raise InputError(f"the image has {width:g} x {height:g} pixels", where=where, hint=AGAIN)
    return int(width), int(height)


def state_vectors(
    nodes: list[Element],
    time: str,
    position: tuple[str, str, str],
    velocity: tuple[str, str, str],
    epoch: Epoch,
    where: str,
) -> StateVectors:
    """State vectors of elements, one for each.

    Parameters
    ----------
    nodes : list of Element
    time : str
        Path of the UTC time.
    position, velocity : tuple of str
        Paths of x, y, z.
    epoch : Epoch
    where : str
        Named in errors.
    """
    times, rows = list[float](), list[list[float]]()
    for node in nodes:
        times.append(epoch.seconds(text(node, time, where), where))
        rows.append([number(node, path, where) for path in (*position, *velocity)])
    table = np.array(rows).reshape(-1, 6)
    return StateVectors.checked(np.array(times), table[:, :3], table[:, 3:], where)


def coefficients(root: Element, path: str, where: str) -> FloatArray:
    """Numbers of an element that lists them; see `text`.

    Parameters
    ----------
    root : Element
    path, where : str
    """
    words = text(root, path, where).split()
    return np.array(finite_numbers(words, len(words), f"<{path}>", where))
