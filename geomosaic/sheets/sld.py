"""SLD 1.0 and 1.1 (OGC 02-070, 05-078r4, 05-077r4): strokes, fills, marks, names, simple filters."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element

from geomosaic.sheets.style import Fill, Label, Line, Marker, Remarks, Rule, Style, Symbol, cased, dashes

# Millimetres of the pixel that SLD calls standardised.
_PIXEL = 0.28
SHAPES = {"circle": "circle", "square": "square", "triangle": "triangle", "star": "star", "cross": "plus", "x": "cross"}
_PLAIN = {"Name", "Title", "Abstract", "Description", "Filter", "ElseFilter", "LegendGraphic"}
_READ = {
    "LineSymbolizer": {"Stroke"}, "PolygonSymbolizer": {"Fill", "Stroke"}, "PointSymbolizer": {"Graphic"},
    "TextSymbolizer": {"Label", "Font", "Halo", "Fill"},
}  # fmt: skip
_SYMBOLIZERS = set(_READ)


def read_sld(root: Element, remarks: Remarks) -> Style:
    """Style of an SLD document; what is not understood goes to `remarks`.

    Parameters
    ----------
    root : Element
    remarks : Remarks

    Raises
    ------
    ValueError
        A number cannot be read.
    """
    layers = _all(root, "UserStyle")
    if len(layers) > 1:
        remarks.add("styles after the first one")
    kinds = _all(layers[0], "FeatureTypeStyle") if layers else []
    column, label, rest = "", None, Symbol()
    found: dict[_Limits, Rule] = {}
    plain = False  # whether there is a rule for all objects
    for number, node in enumerate((rule for kind in kinds for rule in _all(kind, "Rule")), 1):
        symbol, name = _symbol(node, remarks)
        label = name or label
        for child in node:
            if _tag(child) not in _PLAIN | _SYMBOLIZERS:
                remarks.add(_tag(child))
        title = _text(node, "Title") or _text(node, "Name")
        wanted = _find(node, "Filter")
        if wanted is None:
            plain |= _find(node, "ElseFilter") is None and symbol != Symbol()
            rest = _above(rest, symbol, remarks)
            continue
        cases = _filter(wanted)
        if cases is None or any(case[0] != (column or cases[0][0]) for case in cases):
            parts = ", ".join(_tag(part) for part in wanted) or "empty"
            called = f"'{title}'" if title else str(number)
            remarks.add(f"the rule {called} by its filter ({parts}); its objects are drawn as others")
            continue
        column = cases[0][0]
        for _, value, least, below in cases:
            key = (value, least, below)
            old = found.get(key)
            drawn = symbol if old is None else _above(Symbol(old.line, old.fill, old.marker), symbol, remarks)
            named = title if old is None else old.title or title
            found[key] = Rule(*key, named, False, drawn.line, drawn.fill, drawn.marker)
    if found and plain:
        remarks.add("a rule without filter, drawn for those objects alone that no filter names")
    return Style(symbol=rest, column=column, rules=tuple(found.values()), label=label)


# Value, least and below of a rule.
_Limits = tuple[str | None, float | None, float | None]


def _above(lower: Symbol, upper: Symbol, remarks: Remarks) -> Symbol:
    """What two rules for the same objects draw: of two strokes the wider one is the casing."""
    if lower.fill is not None and upper.fill is not None:
        remarks.add("two fills of the same objects, the upper one drawn")
    if lower.marker is not None and upper.marker is not None:
        remarks.add("two marks of the same objects, the upper one drawn")
    line = upper.line or lower.line
    if lower.line is not None and upper.line is not None:
        line = cased(lower.line, upper.line)
    return Symbol(line, upper.fill or lower.fill, upper.marker or lower.marker)


def _tag(node: Element) -> str:
    return node.tag.rpartition("}")[2]


def _all(node: Element, tag: str) -> list[Element]:
    return [child for child in node.iter() if _tag(child) == tag]


def _find(node: Element | None, tag: str) -> Element | None:
    return None if node is None else next((child for child in node if _tag(child) == tag), None)


def _text(node: Element, tag: str) -> str:
    found = next((child for child in _all(node, tag) if (child.text or "").strip()), None)
    return (found.text or "").strip() if found is not None else ""


# Column, value, least and below.
_Case = tuple[str, str | None, float | None, float | None]


def _filter(node: Element) -> list[_Case] | None:
    """Cases of a filter, one of which holds: column, value, least and below; None for other filters."""
    parts = list(node)
    if len(parts) == 1 and _tag(parts[0]) == "Or":
        cases = [_all_of([part] if _tag(part) != "And" else list(part)) for part in parts[0]]
        return None if None in cases or not cases else [case for case in cases if case is not None]
    if len(parts) == 1 and _tag(parts[0]) == "And":
        parts = list(parts[0])
    case = _all_of(parts)
    return None if case is None else [case]


def _all_of(parts: list[Element]) -> _Case | None:
    """One case of comparisons that all hold."""
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


def _symbol(rule: Element, remarks: Remarks) -> tuple[Symbol, Label | None]:
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
            remarks.add(f"lengths in '{uom.rpartition('/')[2]}', taken as pixels of {_PIXEL} mm")
        for child in node:
            if _tag(child) not in _READ[kind] | {"Name", "Description", "Geometry"}:
                remarks.add(f"{_tag(child)} of a {kind}")
        unit = 1.0 if uom.endswith(("millimeter", "mm")) else _PIXEL
        if kind == "LineSymbolizer":
            drawn = _stroke(_find(node, "Stroke"), unit, remarks)
            line = cased(line, drawn) if line is not None and drawn is not None else drawn or line
        elif kind == "PolygonSymbolizer":
            inside = _find(node, "Fill")
            if inside is not None:
                values = _parameters(inside, remarks)
                fill = Fill(_hex(values.get("fill", "#808080"), remarks), float(values.get("fill-opacity", "1")))
            line = _stroke(_find(node, "Stroke"), unit, remarks) or line
        elif kind == "PointSymbolizer":
            marker = _mark(node, unit, remarks)
        else:
            label = _label(node, unit, remarks)
    return Symbol(line, fill, marker), label


def _parameters(node: Element | None, remarks: Remarks) -> dict[str, str]:
    """Parameters of a stroke, fill or font."""
    found: dict[str, str] = {}
    if node is None:
        return found
    for child in node:
        if _tag(child) not in ("CssParameter", "SvgParameter"):
            remarks.add(f"{_tag(child)} in a {_tag(node).lower()}")
        elif value := _value(child, remarks):
            found[child.get("name", "")] = value
    return found


def _value(node: Element | None, remarks: Remarks) -> str:
    """Text of a parameter, or of the one literal that it holds; '' of an expression, with a remark."""
    if node is None:
        return ""
    if not len(node):
        return (node.text or "").strip()
    if len(node) == 1 and _tag(node[0]) == "Literal" and not len(node[0]):
        return (node[0].text or "").strip()
    remarks.add(f"an expression as {node.get('name') or _tag(node)}")
    return ""


def _stroke(node: Element | None, unit: float, remarks: Remarks) -> Line | None:
    if node is None:
        return None
    values = _parameters(node, remarks)
    dash = dashes((float(v) * unit for v in values.get("stroke-dasharray", "").replace(",", " ").split()), remarks)
    return Line(
        _hex(values.get("stroke", "#000000"), remarks), float(values.get("stroke-width", "1")) * unit, dash,
        opacity=float(values.get("stroke-opacity", "1")),
    )  # fmt: skip


def _mark(node: Element, unit: float, remarks: Remarks) -> Marker | None:
    graphic = _find(node, "Graphic")
    mark = _find(graphic, "Mark")
    if graphic is None or mark is None:
        remarks.add("a graphic that is no mark")
        return None
    name = _text(mark, "WellKnownName") or "square"
    if name not in SHAPES:
        remarks.add(f"mark '{name}', drawn as a circle")
    for child in graphic:
        if _tag(child) not in ("Mark", "Size", "Opacity"):
            remarks.add(f"{_tag(child)} of a graphic")
    stroke, values = _stroke(_find(mark, "Stroke"), unit, remarks), _parameters(_find(mark, "Fill"), remarks)
    color = _hex(values.get("fill", "#808080"), remarks)
    opacity = float(values.get("fill-opacity", "1")) * float(_value(_find(graphic, "Opacity"), remarks) or 1.0)
    size = float(_value(_find(graphic, "Size"), remarks) or 6.0) * unit
    edge, wide = ("#000000", 0.0) if stroke is None else (stroke.color, stroke.width)
    return Marker(SHAPES.get(name, "circle"), size, color, edge, wide, opacity)


def _label(node: Element, unit: float, remarks: Remarks) -> Label | None:
    named = _find(node, "Label")
    columns = [] if named is None else [(child.text or "").strip() for child in _all(named, "PropertyName")]
    loose = "" if named is None else "".join([named.text or "", *(child.tail or "" for child in named)]).strip()
    if len(columns) != 1 or loose or not columns[0]:
        remarks.add("labels that are not one property")
        return None
    column = columns[0]
    values, halo = _parameters(_find(node, "Font"), remarks), _find(node, "Halo")
    size = float(values.get("font-size", "10")) * unit / (25.4 / 72)
    color = _hex(_parameters(_find(node, "Fill"), remarks).get("fill", "#000000"), remarks)
    around, wide = None, 0.5
    if halo is not None:
        around = _hex(_parameters(_find(halo, "Fill"), remarks).get("fill", "#ffffff"), remarks)
        wide = float(_text(halo, "Radius") or 1.0) * unit
    return Label(
        column, size, color, around, wide, values.get("font-weight") == "bold",
        values.get("font-style") in ("italic", "oblique"),
    )  # fmt: skip


def _hex(text: str, remarks: Remarks) -> str:
    if len(text) == 4 and text.startswith("#"):
        text = "#" + "".join(2 * c for c in text[1:])
    if len(text) == 7 and text.startswith("#") and all(c in "0123456789abcdefABCDEF" for c in text[1:]):
        return text.lower()
    remarks.add(f"colour '{text}', drawn black")
    return "#000000"
