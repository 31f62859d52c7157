"""Path data of SVG 1.1 (section 8.3) and basic shapes as outlines of lines and Bézier curves."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from geomosaic.types import FloatArray, IntArray

# Kinds of vertices: where a part starts, end of a line, points of a quadratic and of a cubic curve, end of a ring.
MOVE, LINE, QUADRATIC, CUBIC, CLOSE = 1, 2, 3, 4, 79

_NUMBER = re.compile(r"[\s,]*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)")
_FLAG = re.compile(r"[\s,]*([01])")
_COMMAND = re.compile(r"[\s,]*([MmLlHhVvCcSsQqTtAaZz])")
# Numbers that each command takes.
_COUNT = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
# Largest number that is taken for a coordinate: beyond, products overflow.
MOST = 1e7
# Circle by four cubic curves: distance of the control points from the ends, in radii; it errs by 0.03 % of the radius.
_KAPPA = 4.0 / 3.0 * (math.sqrt(2.0) - 1.0)


@dataclass
class PathBuilder:
    """Outline under construction.

    Attributes
    ----------
    points : list of (x, y)
    codes : list of int
        Kind of each vertex: `MOVE`, `LINE`, `QUADRATIC`, `CUBIC` or `CLOSE`.
    """

    points: list[tuple[float, float]] = field(default_factory=list)
    codes: list[int] = field(default_factory=list)

    def add(self, code: int, *points: tuple[float, float]) -> None:
        """Add the vertices of one segment."""
        self.points += points
        self.codes += [code] * len(points)

    def arrays(self) -> tuple[FloatArray, IntArray]:
        """Vertices (N, 2) and their kinds (N,)."""
        return np.array(self.points, dtype=np.float64).reshape(-1, 2), np.array(self.codes, dtype=np.int64)


def path_outline(data: str) -> tuple[FloatArray, IntArray]:
    """Outline of the path data of an attribute `d`.

    Parameters
    ----------
    data : str

    Returns
    -------
    points : array (N, 2)
        Vertices in user units, y down.
    codes : int array (N,)
        Kind of each, see `PathBuilder`.

    Raises
    ------
    ValueError
        The text is no path data.
    """
    made, at, command = PathBuilder(), 0, ""
    x = y = start_x = start_y = 0.0
    before: tuple[str, float, float] = ("", 0.0, 0.0)  # the last curve's kind and second control point
    while data[at:].strip(" \t\r\n,"):
        found = _COMMAND.match(data, at)
        if found:
            command, at = found[1], found.end()
        elif command in "Zz":  # numbers repeat a command, but not that one, and not before any
            raise ValueError(f"'{data[at : at + 12].strip()}' where a command is expected")
        elif command in "Mm":
            command = "l" if command == "m" else "L"
        values, at = _numbers(data, at, command.upper())
        dx, dy = (x, y) if command.islower() else (0.0, 0.0)
        kind = command.upper()
        if not made.codes and kind != "M":
            raise ValueError("path data starts with a move")
        ends = [(values[k] + dx, values[k + 1] + dy) for k in range(0, len(values) - 1, 2)] if kind in "MLCSQT" else []
        mirrored = (2 * x - before[1], 2 * y - before[2])
        control = (x, y)
        if kind == "M":
            made.add(MOVE, ends[0])
            start_x, start_y = ends[0]
        elif kind == "L":
            made.add(LINE, ends[0])
        elif kind == "H":
            ends = [(values[0] + dx, y)]
            made.add(LINE, ends[0])
        elif kind == "V":
            ends = [(x, values[0] + dy)]
            made.add(LINE, ends[0])
        elif kind in "CS":
            first = ends[0] if kind == "C" else mirrored if before[0] == "C" else (x, y)
            control = ends[-2]
            made.add(CUBIC, first, control, ends[-1])
        elif kind in "QT":
            control = ends[0] if kind == "Q" else mirrored if before[0] == "Q" else (x, y)
            made.add(QUADRATIC, control, ends[-1])
        elif kind == "A":
            ends = [(values[5] + dx, values[6] + dy)]
            _arc(made, (x, y), ends[0], values)
        else:
            made.add(CLOSE, (start_x, start_y))
            ends = [(start_x, start_y)]
        before = ("C" if kind in "CS" else "Q" if kind in "QT" else "", *control)
        x, y = ends[-1]
    return made.arrays()


def _numbers(data: str, at: int, kind: str) -> tuple[list[float], int]:
    """Numbers of one command, and where the text goes on."""
    values = []
    for k in range(_COUNT[kind]):
        pattern = _FLAG if kind == "A" and k in (3, 4) else _NUMBER  # flags may stand without blanks between
        found = pattern.match(data, at)
        if found is None:
            raise ValueError(f"'{kind}' needs {_COUNT[kind]} numbers, not '{data[at : at + 12].strip()}'")
        values.append(float(found[1]))
        at = found.end()
    return checked_numbers(values), at


def checked_numbers(values: list[float]) -> list[float]:
    """Return the numbers, none of which is too large to be a coordinate.

    Parameters
    ----------
    values : list of float

    Raises
    ------
    ValueError
    """
    if not all(abs(value) <= MOST for value in values):
        raise ValueError(f"a number is larger than {MOST:g}")
    return values


def _arc(made: PathBuilder, start: tuple[float, float], end: tuple[float, float], values: list[float]) -> None:
    """Elliptical arc as cubic curves of at most a quarter turn (SVG 1.1, appendix F.6)."""
    rx, ry, turn, large, sweep = abs(values[0]), abs(values[1]), math.radians(values[2]), values[3], values[4]
    if start == end:
        return
    if rx == 0.0 or ry == 0.0:
        made.add(LINE, end)
        return
    c, s = math.cos(turn), math.sin(turn)
    half_x, half_y = (start[0] - end[0]) / 2, (start[1] - end[1]) / 2
    u, v = c * half_x + s * half_y, c * half_y - s * half_x
    grow = math.sqrt((u / rx) ** 2 + (v / ry) ** 2)
    if grow > 1.0:
        rx, ry = rx * grow, ry * grow
    apart = (rx * v) ** 2 + (ry * u) ** 2
    if apart == 0.0:  # the ends are one point but for rounding
        made.add(LINE, end)
        return
    k = math.sqrt(max(0.0, (rx * ry) ** 2 - apart) / apart) * (-1.0 if large == sweep else 1.0)
    cu, cv = k * rx * v / ry, -k * ry * u / rx
    middle = c * cu - s * cv + (start[0] + end[0]) / 2, s * cu + c * cv + (start[1] + end[1]) / 2
    first = math.atan2((v - cv) / ry, (u - cu) / rx)
    last = math.atan2((-v - cv) / ry, (-u - cu) / rx)
    span = (last - first) % (2 * math.pi) if sweep else -((first - last) % (2 * math.pi))
    pieces = max(1, math.ceil(abs(span) / (math.pi / 2) - 1e-9))
    step = span / pieces
    reach = 4.0 / 3.0 * math.tan(step / 4)

    def place(angle: float, ahead: float) -> tuple[float, float]:
        px = rx * (math.cos(angle) - ahead * math.sin(angle))
        py = ry * (math.sin(angle) + ahead * math.cos(angle))
        return c * px - s * py + middle[0], s * px + c * py + middle[1]

    for n in range(pieces):
        a, b = first + n * step, first + (n + 1) * step
        made.add(CUBIC, place(a, reach), place(b, -reach), end if n == pieces - 1 else place(b, 0.0))


def shape_outline(name: str, attributes: Mapping[str, str]) -> tuple[FloatArray, IntArray]:
    """Outline of a path or of a basic shape.

    Parameters
    ----------
    name : str
        'path', 'rect', 'circle', 'ellipse', 'line', 'polyline' or 'polygon'.
    attributes : mapping of str to str

    Returns
    -------
    points : array (N, 2)
    codes : int array (N,)

    Raises
    ------
    ValueError
        An attribute cannot be read.
    """

    def number(key: str) -> float:
        return length(attributes.get(key, "0"))

    if name == "path":
        return path_outline(attributes.get("d", ""))
    if name in ("polyline", "polygon"):
        values = [float(text) for text in re.split(r"[\s,]+", attributes.get("points", "").strip()) if text]
        if len(values) % 2:
            raise ValueError("points has an odd number of coordinates")
        points = np.array(checked_numbers(values), dtype=np.float64).reshape(-1, 2)
        return _polygon(points, closed=name == "polygon")
    if name == "line":
        return _polygon(np.array([(number("x1"), number("y1")), (number("x2"), number("y2"))]), closed=False)
    if name == "rect":
        x, y, w, h = (number(key) for key in ("x", "y", "width", "height"))
        rx = number("rx") if "rx" in attributes else number("ry")
        ry = number("ry") if "ry" in attributes else rx
        rx, ry = min(rx, w / 2), min(ry, h / 2)
        if rx <= 0.0 or ry <= 0.0:
            return _polygon(np.array([(x, y), (x + w, y), (x + w, y + h), (x, y + h)]), closed=True)
        arc = f"a{rx} {ry} 0 0 1"
        return path_outline(
            f"M{x + rx} {y}H{x + w - rx}{arc} {rx} {ry}V{y + h - ry}{arc} {-rx} {ry}"
            f"H{x + rx}{arc} {-rx} {-ry}V{y + ry}{arc} {rx} {-ry}Z"
        )
    x, y = number("cx"), number("cy")
    rx, ry = (number("r"), number("r")) if name == "circle" else (number("rx"), number("ry"))
    quarter = np.array([(1.0, 0.0), (1.0, _KAPPA), (_KAPPA, 1.0), (0.0, 1.0)])
    turns = [np.array([(0, 1), (-1, 0)]), np.array([(-1, 0), (0, -1)]), np.array([(0, -1), (1, 0)])]
    points = np.vstack([quarter, *((quarter @ turn)[1:] for turn in turns), quarter[:1]])
    return points * (rx, ry) + (x, y), np.array([MOVE, *[CUBIC] * 12, CLOSE])


def _polygon(points: FloatArray, *, closed: bool) -> tuple[FloatArray, IntArray]:
    """Outline of straight sides."""
    if not len(points):
        return np.zeros((0, 2)), np.zeros(0, dtype=np.int64)
    codes = [MOVE, *[LINE] * (len(points) - 1)]
    if closed:
        points, codes = np.vstack([points, points[:1]]), [*codes, CLOSE]
    return points, np.array(codes)


def length(text: str) -> float:
    """Length in user units; px count one, physical units by 96 px to the inch (CSS).

    Parameters
    ----------
    text : str

    Raises
    ------
    ValueError
        No number, or another unit.
    """
    found = re.fullmatch(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(px|mm|cm|in|pt)?\s*", text)
    if found is None:
        raise ValueError(f"'{text}' is no length")
    return checked_numbers([float(found[1])])[0] * {"mm": 96 / 25.4, "cm": 96 / 2.54, "in": 96.0, "pt": 96 / 72}.get(
        found[2], 1.0
    )


def flattened(points: FloatArray, codes: IntArray, pieces: int = 16) -> list[FloatArray]:
    """Parts of an outline as polylines, curves divided into pieces.

    Parameters
    ----------
    points : array (N, 2)
    codes : int array (N,)
    pieces : int
        Of each curve.

    Returns
    -------
    list of array (M, 2)
    """
    parts: list[list[FloatArray]] = []
    t = np.linspace(0.0, 1.0, pieces + 1)[1:, None]
    k = 0
    while k < len(codes):
        code, here = int(codes[k]), points[k]
        if code == MOVE or not parts:
            parts.append([here[None]])
            k += 1
            continue
        last = parts[-1][-1][-1]
        if code == QUADRATIC:
            one, end = points[k], points[k + 1]
            parts[-1].append((1 - t) ** 2 * last + 2 * t * (1 - t) * one + t**2 * end)
            k += 2
        elif code == CUBIC:
            one, two, end = points[k], points[k + 1], points[k + 2]
            curve = (1 - t) ** 3 * last + 3 * t * (1 - t) ** 2 * one + 3 * t**2 * (1 - t) * two + t**3 * end
            parts[-1].append(curve)
            k += 3
        else:
            parts[-1].append(here[None])
            k += 1
    return [np.vstack(part) for part in parts]
