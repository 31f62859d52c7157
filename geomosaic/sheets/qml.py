"""QML, the styles of QGIS 3: simple lines, fills and markers; single, categorised and graduated; simple labels."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from xml.etree.ElementTree import Element

from geomosaic.sheets.style import (
    MARKERS,
    Fill,
    Label,
    Line,
    Marker,
    Remarks,
    Rule,
    Style,
    Symbol,
    blend,
    cased,
    dashes,
)

UNITS = {"MM": 1.0, "Point": 25.4 / 72, "Inch": 25.4, "Pixel": 25.4 / 96}
SHAPES = {
    "cross2": "cross",
    "cross": "plus",
    "cross_fill": "plus",
    "equilateral_triangle": "triangle",
    "rectangle": "square",
}
_SYMBOL_LAYERS = {"SimpleLine", "SimpleFill", "SimpleMarker"}


def read_qml(root: Element, remarks: Remarks) -> Style:
    """Style of a QML document; what is not understood goes to `remarks`.

    Parameters
    ----------
    root : Element
    remarks : Remarks

    Raises
    ------
    ValueError
        A number cannot be read.
    """
    renderer = root.find("renderer-v2")
    label = None if root.get("labelsEnabled") == "0" else _label(root.find("labeling"), remarks)
    _layer_remarks(root, remarks)
    if renderer is None:
        remarks.add("the file has no renderer")
        return Style(label=label)
    symbols = {node.get("name", ""): _symbol(node, remarks) for node in renderer.findall("symbols/symbol")}
    for extra in ("rotation", "sizescale"):
        node = renderer.find(extra)
        if node is not None and node.attrib:
            remarks.add(f"{extra} of the renderer")
    kind, column = renderer.get("type", ""), renderer.get("attr", "").strip('"')
    if kind == "singleSymbol":
        return Style(symbol=next(iter(symbols.values()), Symbol()), label=label)
    if kind == "categorizedSymbol":
        rules, rest = [], Symbol()
        for node in renderer.findall("categories/category"):
            symbol = symbols.get(node.get("symbol", ""), Symbol())
            hide = node.get("render", "true") == "false"
            # Several values that were merged to one category stand below it.
            values = [part.get("value", "") for part in node.findall("val")] or [node.get("value", "")]
            if values == [""]:
                rest = Symbol() if hide else symbol
                continue
            rules += [_rule(symbol, node.get("label") or value, Rule(value=value, hide=hide)) for value in values]
        return Style(symbol=rest, column=column, rules=tuple(rules), label=label)
    if kind == "graduatedSymbol":
        rules = []
        for node in renderer.findall("ranges/range"):
            low, high = float(node.get("lower", "nan")), float(node.get("upper", "nan"))
            # The upper limit of a class belongs to it, and the first class that holds is taken; ours end before it.
            high = math.nextafter(high, math.inf)
            symbol = symbols.get(node.get("symbol", ""), Symbol())
            hide = node.get("render", "true") == "false"
            rules.append(_rule(symbol, node.get("label", ""), Rule(least=low, below=high, hide=hide)))
        return Style(column=column, rules=tuple(rules), label=label)
    remarks.add(f"renderer '{kind}'; its first symbol is used for all")
    return Style(symbol=next(iter(symbols.values()), Symbol()), label=label)


def _layer_remarks(root: Element, remarks: Remarks) -> None:
    """Remarks on properties of the layer as a whole, which are not drawn."""
    opacity = root.findtext("layerOpacity") or "1"
    if float(opacity) != 1.0:
        remarks.add(f"opacity {opacity} of the layer")
    for name in ("blendMode", "featureBlendMode"):
        if (root.findtext(name) or "0") != "0":
            remarks.add(f"{name} of the layer")
    if root.get("hasScaleBasedVisibilityFlag") == "1":
        remarks.add("scales at which the layer is hidden")


def _rule(symbol: Symbol, name: str, limits: Rule) -> Rule:
    return replace(limits, title=name, line=symbol.line, fill=symbol.fill, marker=symbol.marker)


def _options(layer: Element) -> dict[str, str]:
    """Properties of a symbol layer."""
    # QGIS 3.26 and later write options, earlier ones props.
    found = {node.get("k", ""): node.get("v", "") for node in layer.findall("prop")}
    found |= {
        n.get("name", ""): n.get("value", "") for n in layer.findall("Option/Option") if n.get("value") is not None
    }
    return found


def _symbol(node: Element, remarks: Remarks) -> Symbol:
    opacity = float(node.get("alpha", "1"))
    line: Line | None = None
    fill: Fill | None = None
    marker: Marker | None = None
    seen: set[str] = set()
    for layer in node.findall("layer"):
        if layer.get("enabled", "1") == "0":
            continue
        kind, values = layer.get("class", ""), _options(layer)
        data = layer.find("data_defined_properties/Option/Option[@name='properties']")
        if data is not None and len(data):
            remarks.add(f"values of {kind} that come from the data")
        if kind in _SYMBOL_LAYERS:
            _displacement_remarks(kind, values, remarks)
        if kind in seen and kind != "SimpleLine":
            remarks.add(f"more than one {kind}, the last one drawn")
        seen.add(kind)
        if kind not in _SYMBOL_LAYERS:
            remarks.add(f"symbol layer '{kind}'")
        elif kind == "SimpleLine":
            drawn = _line(values, "line_color", "line_width", "line_style", opacity, remarks)
            if line is not None and line.casing is not None:
                remarks.add("more than two strokes of a line")
            if line is not None and drawn is not None:
                line = cased(line, drawn)
            else:
                line = drawn or line
        elif kind == "SimpleFill":
            if values.get("style", "solid") != "no":
                if values.get("style", "solid") != "solid":
                    remarks.add(f"fill pattern '{values['style']}', filled evenly")
                color, alpha = _color(values.get("color", ""), remarks)
                fill = Fill(color, alpha * opacity)
            line = _line(values, "outline_color", "outline_width", "outline_style", opacity, remarks) or line
        else:
            shape = SHAPES.get(values.get("name", "circle"), values.get("name", "circle"))
            if shape not in MARKERS:
                remarks.add(f"marker '{shape}', drawn as a circle")
                shape = "circle"
            size = _length(values, "size", 2.0, remarks)
            edge = _color(values.get("outline_color", "0,0,0,255"), remarks)[0]
            none = values.get("outline_style") == "no"
            wide = 0.0 if none else _length(values, "outline_width", 0.0, remarks) or 0.1
            color, alpha = _color(values.get("color", ""), remarks)
            marker = Marker(shape, size, color, edge, wide, alpha * opacity)
    return Symbol(line, fill, marker)


def _displacement_remarks(kind: str, values: Mapping[str, str], remarks: Remarks) -> None:
    """Remarks on offsets and rotations, which are not drawn."""
    for name in ("offset", "angle"):
        parts = values.get(name, "0").split(",")
        # The angle of a fill turns nothing that is drawn: patterns are filled evenly.
        if any(float(part or 0) for part in parts) and (name, kind) != ("angle", "SimpleFill"):
            remarks.add(f"{name} of {kind}")


def _line(
    values: Mapping[str, str], color: str, width: str, style: str, opacity: float, remarks: Remarks
) -> Line | None:
    kind = values.get(style, "solid")
    if kind == "no":
        return None
    name, alpha = _color(values.get(color, ""), remarks)
    wide = _length(values, width, 0.26, remarks) or 0.1
    dash: tuple[float, ...] = ()
    if values.get("use_custom_dash") == "1":
        scale = _unit(values, "customdash", remarks)
        dash = dashes((float(v) * scale for v in values.get("customdash", "").split(";") if v), remarks)
    elif kind != "solid":
        # Dashes of Qt, in widths of the line.
        known = {"dash": (4, 2), "dot": (1, 2), "dash dot": (4, 2, 1, 2), "dash dot dot": (4, 2, 1, 2, 1, 2)}
        if kind not in known:
            remarks.add(f"line style '{kind}', drawn whole")
        dash = tuple(v * wide for v in known.get(kind, ()))
    return Line(name, wide, dash, opacity=alpha * opacity)


def _unit(values: Mapping[str, str], name: str, remarks: Remarks) -> float:
    unit = values.get(f"{name}_unit", "MM")
    if unit not in UNITS:
        remarks.add(f"lengths in '{unit}', taken as millimetres")
    return UNITS.get(unit, 1.0)


def _length(values: Mapping[str, str], name: str, default: float, remarks: Remarks) -> float:
    return float(values.get(name, default)) * _unit(values, name, remarks)


def _color(text: str, remarks: Remarks) -> tuple[str, float]:
    """Colour and opacity of 'r,g,b,a'; later QGIS adds the same in words after that."""
    parts = text.split(",")
    try:
        red, green, blue, alpha = (int(v) for v in (*parts[:3], *(parts[3:4] or ["255"])))
        if not all(0 <= value <= 255 for value in (red, green, blue, alpha)):
            raise ValueError(text)
    except ValueError:
        remarks.add(f"colour '{text}', drawn black")
        return "#000000", 1.0
    return f"#{red:02x}{green:02x}{blue:02x}", alpha / 255


def _label(node: Element | None, remarks: Remarks) -> Label | None:
    if node is None:
        return None
    style = node.find("settings/text-style")
    if node.get("type") != "simple" or style is None:
        remarks.add(f"labels of type '{node.get('type')}'")
        return None
    column = style.get("fieldName", "")
    if style.get("isExpression") == "1":
        plain = re.fullmatch(r'\s*"([^"]+)"\s*', column)
        if plain is None:
            remarks.add(f"labels by the expression {column}")
            return None
        column = plain[1]
    size = float(style.get("fontSize", "10"))
    unit = style.get("fontSizeUnit", "Point")
    if unit not in UNITS:
        remarks.add(f"text sizes in '{unit}', taken as points")
    size *= UNITS.get(unit, UNITS["Point"]) / UNITS["Point"]
    if style.get("capitalization", "0") != "0" or style.get("fontCapitals", "0") != "0":
        remarks.add("capitals of labels")
    drawn = node.find("settings/background")
    if drawn is not None and drawn.get("shapeDraw") == "1":
        remarks.add("backgrounds of labels")
    scales = node.find("settings/rendering")
    if scales is not None and scales.get("scaleVisibility") == "1":
        remarks.add("labels at some scales only, drawn at this one")
    buffer = style.find("text-buffer")
    halo, wide = None, 0.5
    if buffer is not None and buffer.get("bufferDraw") == "1":
        halo = _color(buffer.get("bufferColor", "255,255,255,255"), remarks)[0]
        wide = float(buffer.get("bufferSize", "1")) * UNITS.get(buffer.get("bufferSizeUnits", "MM"), 1.0)
    color = blend("#ffffff", *_color(style.get("textColor", "0,0,0,255"), remarks))  # text has no opacity here
    bold = float(style.get("fontWeight", "50")) >= 75 or "bold" in style.get("namedStyle", "").lower()
    italic = style.get("fontItalic") == "1"
    return Label(column, size, color, halo, wide, bold, italic)
