"""SLD 1.0 and 1.1 (OGC 02-070, 05-078r4, 05-077r4): strokes, fills, marks, names, simple filters."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

from geomosaic.carto.foreign.told import Told
from geomosaic.carto.style import Fill, Label, Line, Marker, Rule, Style, Symbol

PIXEL = 0.28
"""Millimetres of a pixel, as the standard has it."""
SHAPES = {"circle": "circle", "square": "square", "triangle": "triangle", "star": "star", "cross": "plus", "x": "cross"}
_PLAIN = {"Name", "Title", "Abstract", "Description", "Filter", "ElseFilter", "LegendGraphic"}
_SYMBOLIZERS = {"LineSymbolizer", "PolygonSymbolizer", "PointSymbolizer", "TextSymbolizer"}


def read_sld(root: Element, told: Told) -> Style:
    """Make a style of an SLD document; what is not understood goes to `told`."""
    layers = _all(root, "UserStyle")
    if len(layers) > 1:
        told.say("styles after the first one")
    kinds = _all(layers[0], "FeatureTypeStyle") if layers else []
    column, rules, rest, label = "", [], Symbol(), None
    for number, node in enumerate((rule for kind in kinds for rule in _all(kind, "Rule")), 1):
        symbol, name = _symbol(node, told)
        label = name or label
        for child in node:
            if _tag(child) not in _PLAIN | _SYMBOLIZERS:
                told.say(_tag(child))
        title = _text(node, "Title") or _text(node, "Name")
        found = _find(node, "Filter")
        if found is None:
            rest = symbol if symbol != Symbol() else rest
            continue
        limits = _filter(found, told)
        if limits is None or (column and limits[0] != column):
            parts = ", ".join(_tag(part) for part in found) or "empty"
            called = f"'{title}'" if title else str(number)
            told.say(f"the rule {called} by its filter ({parts}); its objects are drawn as others")
            continue
        column = limits[0]
        rules.append(Rule(limits[1], limits[2], limits[3], title, False, symbol.line, symbol.fill, symbol.marker))
    return Style(symbol=rest, column=column, rules=tuple(rules), label=label)


def _tag(node: Element) -> str:
    return node.tag.rpartition("}")[2]


def _all(node: Element, tag: str) -> list[Element]:
    return [child for child in node.iter() if _tag(child) == tag]


def _find(node: Element | None, tag: str) -> Element | None:
    return None if node is None else next((child for child in node if _tag(child) == tag), None)


def _text(node: Element, tag: str) -> str:
    found = next((child for child in _all(node, tag) if (child.text or "").strip()), None)
    return (found.text or "").strip() if found is not None else ""


def _filter(node: Element, told: Told) -> tuple[str, str | None, float | None, float | None] | None:
    """Column, value, least and below of a filter; None where it says something else."""
    parts = list(node)
    if len(parts) == 1 and _tag(parts[0]) == "And":
        parts = list(parts[0])
    column, value, least, below = "", None, None, None
    for part in parts:
        kind, name = _tag(part), _text(part, "PropertyName") or _text(part, "ValueReference")
        literals = [(child.text or "").strip() for child in _all(part, "Literal")]
        if not name or not literals or (column and name != column):
            return None
        column = name
        try:
            if kind == "PropertyIsEqualTo":
                value = literals[0]
            elif kind == "PropertyIsGreaterThanOrEqualTo":
                least = float(literals[0])
            elif kind == "PropertyIsGreaterThan":
                least = math.nextafter(float(literals[0]), math.inf)
            elif kind == "PropertyIsLessThan":
                below = float(literals[0])
            elif kind == "PropertyIsLessThanOrEqualTo":
                below = math.nextafter(float(literals[0]), math.inf)
            elif kind == "PropertyIsBetween":
                least, below = float(literals[0]), math.nextafter(float(literals[1]), math.inf)
            else:
                return None
        except (ValueError, IndexError):
            return None
    return (column, value, least, below) if column else None


def _symbol(rule: Element, told: Told) -> tuple[Symbol, Label | None]:
    line: Line | None = None
    fill: Fill | None = None
    marker: Marker | None = None
    label: Label | None = None
    for node in rule:
        kind = _tag(node)
        if kind not in _SYMBOLIZERS:
            continue
        uom = node.get("uom", "")
        if uom and not uom.endswith(("pixel", "millimeter", "mm")):
            told.say(f"lengths in '{uom.rpartition('/')[2]}', taken as pixels of {PIXEL} mm")
        unit = 1.0 if uom.endswith(("millimeter", "mm")) else PIXEL
        if kind == "LineSymbolizer":
            drawn = _stroke(_find(node, "Stroke"), unit, told)
            if line is not None and drawn is not None:
                lower, upper = (line, drawn) if line.width >= drawn.width else (drawn, line)
                drawn = Line(upper.color, upper.width, upper.dash, lower.color, lower.width, upper.opacity)
            line = drawn or line
        elif kind == "PolygonSymbolizer":
            inside = _find(node, "Fill")
            if inside is not None:
                said = _said(inside, told)
                fill = Fill(_hex(said.get("fill", "#808080"), told), float(said.get("fill-opacity", "1")))
            line = _stroke(_find(node, "Stroke"), unit, told) or line
        elif kind == "PointSymbolizer":
            marker = _mark(node, unit, told)
        else:
            label = _label(node, unit, told)
    return Symbol(line, fill, marker), label


def _said(node: Element, told: Told) -> dict[str, str]:
    """Parameters of a stroke, fill or font."""
    for child in node:
        if _tag(child) not in ("CssParameter", "SvgParameter"):
            told.say(f"{_tag(child)} in a {_tag(node).lower()}")
    return {
        child.get("name", ""): (child.text or "").strip()
        for child in node
        if _tag(child) in ("CssParameter", "SvgParameter") and not len(child)
    }


def _stroke(node: Element | None, unit: float, told: Told) -> Line | None:
    if node is None:
        return None
    said = _said(node, told)
    dash = tuple(float(v) * unit for v in said.get("stroke-dasharray", "").replace(",", " ").split())
    return Line(
        _hex(said.get("stroke", "#000000"), told), float(said.get("stroke-width", "1")) * unit, dash,
        opacity=float(said.get("stroke-opacity", "1")),
    )  # fmt: skip


def _mark(node: Element, unit: float, told: Told) -> Marker | None:
    graphic = _find(node, "Graphic")
    mark = _find(graphic, "Mark")
    if graphic is None or mark is None:
        told.say("a graphic that is no mark")
        return None
    name = _text(mark, "WellKnownName") or "square"
    if name not in SHAPES:
        told.say(f"mark '{name}', drawn as a circle")
    inside, stroke = _find(mark, "Fill"), _stroke(_find(mark, "Stroke"), unit, told)
    color = "#808080" if inside is None else _hex(_said(inside, told).get("fill", "#808080"), told)
    size = float(_text(graphic, "Size") or 6.0) * unit
    edge, wide = ("#000000", 0.0) if stroke is None else (stroke.color, stroke.width)
    return Marker(SHAPES.get(name, "circle"), size, color, edge, wide)


def _label(node: Element, unit: float, told: Told) -> Label | None:
    column = _text(node, "PropertyName")
    if not column:
        told.say("labels that are no property")
        return None
    font, halo, fill = _find(node, "Font"), _find(node, "Halo"), _find(node, "Fill")
    said = {} if font is None else _said(font, told)
    size = float(said.get("font-size", "10")) * unit / (25.4 / 72)
    color = "#000000" if fill is None else _hex(_said(fill, told).get("fill", "#000000"), told)
    around, wide = None, 0.5
    if halo is not None:
        ring = _find(halo, "Fill")
        around = "#ffffff" if ring is None else _hex(_said(ring, told).get("fill", "#ffffff"), told)
        wide = float(_text(halo, "Radius") or 1.0) * unit
    return Label(
        column, size, color, around, wide, said.get("font-weight") == "bold",
        said.get("font-style") in ("italic", "oblique"),
    )  # fmt: skip


def _hex(text: str, told: Told) -> str:
    if len(text) == 7 and text.startswith("#") and all(c in "0123456789abcdefABCDEF" for c in text[1:]):
        return text.lower()
    told.say(f"colour '{text}', drawn black")
    return "#000000"
