"""SVG files as symbols: their outlines with fills and strokes, and nothing else of them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sheets.svg_path import CLOSE, LINE, MOVE, checked_numbers, flattened, length, shape_outline
from geomosaic.types import FloatArray, IntArray

# Colours of the marker, in place of those of the file.
COLOR, OUTLINE = "color", "outline"
# The sixteen colours that SVG takes over from HTML 4.
_NAMES = {
    "black": "#000000", "silver": "#c0c0c0", "gray": "#808080", "grey": "#808080", "white": "#ffffff",
    "maroon": "#800000", "red": "#ff0000", "purple": "#800080", "fuchsia": "#ff00ff", "green": "#008000",
    "lime": "#00ff00", "olive": "#808000", "yellow": "#ffff00", "navy": "#000080", "blue": "#0000ff",
    "teal": "#008080", "aqua": "#00ffff",
}  # fmt: skip
# Vertices of a symbol, and depth of its groups: more is a drawing.
MOST_VERTICES, _DEEPEST = 20_000, 64
# Sides of the box by which an outline may lie beside it.
_FARTHEST = 1e3
_SHAPES = {"path", "rect", "circle", "ellipse", "line", "polyline", "polygon"}
_GROUPS = {"svg", "g", "a", "switch"}
# What has no look of its own.
_SILENT = {"title", "desc", "metadata", "defs", "namedview"}
_INHERITED = {
    "fill": "black", "stroke": "none", "stroke-width": "1", "fill-rule": "nonzero", "stroke-linecap": "butt",
    "stroke-linejoin": "miter", "fill-opacity": "1", "stroke-opacity": "1", "color": "currentColor",
    "visibility": "visible",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class PaintedOutline:
    """Outline that is filled or stroked in one colour.

    Attributes
    ----------
    points : array (N, 2)
        Vertices in parts of the larger side of the symbol from its middle, y up.
    codes : int array (N,)
        Kinds of vertices, see `svg_path.PathBuilder`.
    color : str
        #rrggbb, or `COLOR` or `OUTLINE` of the marker.
    width : float or None
        Of a stroke, in the same unit; None where the outline is filled.
    opacity : float
        0 to 1.
    cap, join : str
        Ends and corners of a stroke: 'butt', 'round', 'square'; 'miter', 'round', 'bevel'.
    """

    points: FloatArray
    codes: IntArray
    color: str
    width: float | None
    opacity: float = 1.0
    cap: str = "butt"
    join: str = "miter"


def read_svg(text: str, where: str) -> tuple[PaintedOutline, ...]:
    """Outlines of an SVG document, the lowest first.

    Colours `currentColor` and `param(fill)` stand for that of the marker, `param(outline)` for that of its outline.

    Parameters
    ----------
    text : str
    where : str
        File, named in errors.

    Raises
    ------
    InputError
        It is no SVG, declares entities, has what is no outline (pictures, texts, gradients, scripts, style sheets), or
        nothing to draw.
    """
    if "<!ENTITY" in text:
        raise InputError("the symbol declares entities", where=where, hint="save it again without a document type")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"the symbol is no XML: {error}", where=where, hint="save it again as plain SVG") from None
    if _local(root.tag) != "svg":
        raise InputError(f"the file is no SVG but '{_local(root.tag)}'", where=where, hint="give an SVG file")
    found: list[PaintedOutline] = []
    try:
        box = _box(root)
        scale = 1.0 / max(box[2], box[3])
        place = np.array([[scale, 0.0, -scale * (box[0] + box[2] / 2)], [0.0, -scale, scale * (box[1] + box[3] / 2)]])
        _collect(root, place, dict(_INHERITED), 1.0, found)
    except ValueError as error:
        hint = "save it as plain SVG of paths in plain colours: text and objects converted to paths"
        raise InputError(f"the symbol cannot be read: {error}", where=where, hint=hint) from None
    if not found:
        raise InputError("the symbol draws nothing", where=where, hint="give it paths with a fill or a stroke")
    if sum(len(one.points) for one in found) > MOST_VERTICES:
        raise InputError(
            f"the symbol has more than {MOST_VERTICES} vertices", where=where, hint="simplify its paths for its size"
        )
    return tuple(found)


def _local(tag: object) -> str:
    """Name of an element without its namespace; comments have none."""
    return tag.rpartition("}")[2] if isinstance(tag, str) else ""


def _box(root: ElementTree.Element) -> tuple[float, float, float, float]:
    """Left, upper edge, width and height of the symbol in user units."""
    view = root.get("viewBox")
    values = [float(part) for part in re.split(r"[\s,]+", view.strip())] if view else []
    if not view:
        values = [0.0, 0.0, length(root.get("width", "")), length(root.get("height", ""))]
    if len(values) != 4 or min(values[2:]) <= 0.0:
        raise ValueError("it has neither a viewBox of four numbers nor width and height")
    left, top, width, height = checked_numbers(values)
    return left, top, width, height


def _collect(
    node: ElementTree.Element,
    place: FloatArray,
    look: Mapping[str, str],
    opacity: float,
    found: list[PaintedOutline],
    depth: int = 0,
) -> None:
    """Outlines of an element and of those in it, with inherited looks and transformations."""
    name = _local(node.tag)
    if not name or name in _SILENT:
        return
    if name not in _SHAPES | _GROUPS:
        raise ValueError(f"'{name}' is no outline")
    if depth > _DEEPEST:
        raise ValueError(f"groups lie more than {_DEEPEST} deep")
    own = dict(look)
    styled = {
        key.strip(): value.strip()
        for key, mark, value in (item.partition(":") for item in node.get("style", "").split(";"))
        if mark
    }
    given = {key: value.strip() for key, value in node.attrib.items()} | styled
    own.update({key: given[key] for key in _INHERITED if given.get(key, "inherit") != "inherit"})
    if given.get("display") == "none":
        return
    for key in ("clip-path", "mask", "filter"):
        if given.get(key, "none") != "none":
            raise ValueError(f"'{key}' is not drawn")
    opacity *= _share(given.get("opacity", "1"))
    if "transform" in given:
        place = _joined(place, _transform(given["transform"]))
    for child in node if name in _GROUPS else ():
        _collect(child, place, own, opacity, found, depth + 1)
    if name not in _SHAPES or own["visibility"] != "visible":
        return
    points, codes = shape_outline(name, given)
    if len(points) < 2:
        return
    moved: FloatArray = points @ place[:, :2].T + place[:, 2]
    if not np.abs(moved).max() <= _FARTHEST:
        raise ValueError("an outline lies far outside the symbol's box")
    fill, stroke = _color(own["fill"], own["color"]), _color(own["stroke"], own["color"])
    if fill is not None and name != "line" and (share := opacity * _share(own["fill-opacity"])) > 0.0:
        area = _even_odd(moved, codes) if own["fill-rule"] == "evenodd" else (moved, codes)
        found.append(PaintedOutline(*area, fill, None, share))
    width = length(own["stroke-width"]) * math.sqrt(abs(float(np.linalg.det(place[:, :2]))))
    if stroke is not None and width > 0.0 and (share := opacity * _share(own["stroke-opacity"])) > 0.0:
        ends = own["stroke-linecap"], own["stroke-linejoin"]
        if ends[0] not in ("butt", "round", "square") or ends[1] not in ("miter", "round", "bevel"):
            raise ValueError(f"'{ends[0]}' or '{ends[1]}' is no end or corner of a line")
        found.append(PaintedOutline(moved, codes, stroke, width, share, *ends))


def _share(text: str) -> float:
    """Opacity, 0 to 1."""
    value = float(text[:-1]) / 100 if text.endswith("%") else float(text)
    return min(1.0, max(0.0, value))


def _color(text: str, current: str) -> str | None:
    """Colour as #rrggbb, `COLOR` or `OUTLINE`; None for nothing."""
    text = text.strip()
    if text == "currentColor":
        text = current if current != "currentColor" else "param(fill)"
    parameter = re.match(r"param\((fill|outline)\)", text)
    if parameter:
        return COLOR if parameter[1] == "fill" else OUTLINE
    if text in ("none", "transparent"):
        return None
    if re.fullmatch(r"#[0-9a-fA-F]{3}", text):
        return "#" + "".join(2 * c for c in text[1:].lower())
    if re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        return text.lower()
    parts = re.fullmatch(r"rgb\(\s*(\d+)\s*,\s*(\d+)\s*,\s*(\d+)\s*\)", text)
    if parts and all(int(part) < 256 for part in parts.groups()):
        return "#" + "".join(f"{int(part):02x}" for part in parts.groups())
    if text.lower() in _NAMES:
        return _NAMES[text.lower()]
    raise ValueError(f"'{text}' is no plain colour")


_TRANSFORM = re.compile(r"\s*,?\s*(matrix|translate|scale|rotate|skewX|skewY)\s*\(([^)]*)\)")


def _transform(text: str) -> FloatArray:
    """Affine transformation (2, 3) of an attribute `transform`."""
    made, at = np.eye(2, 3), 0
    while text[at:].strip():
        found = _TRANSFORM.match(text, at)
        if found is None:
            raise ValueError(f"'{text[at : at + 20]}' is no transformation")
        at = found.end()
        v = checked_numbers([float(part) for part in re.split(r"[\s,]+", found[2].strip()) if part])
        made = _joined(made, _primitive(found[1], v))
    return made


def _primitive(name: str, v: list[float]) -> FloatArray:
    """Affine transformation (2, 3) of one function."""
    counts = {"matrix": (6,), "translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "skewX": (1,), "skewY": (1,)}
    if len(v) not in counts[name]:
        raise ValueError(f"{name} with {len(v)} numbers")
    if name == "matrix":
        return np.array([[v[0], v[2], v[4]], [v[1], v[3], v[5]]])
    if name == "translate":
        return np.array([[1.0, 0.0, v[0]], [0.0, 1.0, v[1] if len(v) > 1 else 0.0]])
    if name == "scale":
        return np.array([[v[0], 0.0, 0.0], [0.0, v[-1], 0.0]])
    if name == "rotate":
        c, s = math.cos(math.radians(v[0])), math.sin(math.radians(v[0]))
        x, y = (v[1], v[2]) if len(v) == 3 else (0.0, 0.0)
        return np.array([[c, -s, x - c * x + s * y], [s, c, y - s * x - c * y]])
    slope = math.tan(math.radians(v[0]))
    return np.array([[1.0, slope if name == "skewX" else 0.0, 0.0], [slope if name == "skewY" else 0.0, 1.0, 0.0]])


def _joined(outer: FloatArray, inner: FloatArray) -> FloatArray:
    """Affine transformation (2, 3) that applies `inner` first."""
    linear = outer[:, :2] @ inner[:, :2]
    return np.column_stack([linear, outer[:, :2] @ inner[:, 2] + outer[:, 2]])


def _even_odd(points: FloatArray, codes: IntArray) -> tuple[FloatArray, IntArray]:
    """Outline that is the same area under the rule nonzero: holes run against what surrounds them."""
    import shapely

    rings = [ring for ring in flattened(points, codes, 16) if len(np.unique(ring, axis=0)) > 2]
    area = shapely.Polygon()
    for ring in rings:
        area = area.symmetric_difference(shapely.make_valid(shapely.Polygon(ring)))
    polygons = [part for part in shapely.get_parts(shapely.normalize(area)) if part.geom_type == "Polygon"]
    found = [np.asarray(ring.coords) for part in polygons for ring in (part.exterior, *part.interiors)]
    if not found:
        return points, codes
    kinds = [np.array([MOVE, *[LINE] * (len(ring) - 2), CLOSE]) for ring in found]
    return np.vstack(found), np.concatenate(kinds)
