"""QML, the styles of QGIS 3: simple lines, fills and markers; single, categorised and graduated; simple labels."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from xml.etree.ElementTree import Element

from geomosaic.sheets.style import MARKERS, Fill, Label, Line, Marker, Rule, Style, Symbol, Told, dashes, mixed

UNITS = {"MM": 1.0, "Point": 25.4 / 72, "Inch": 25.4, "Pixel": 25.4 / 96}
SHAPES = {
    "cross2": "cross",
    "cross": "plus",
    "cross_fill": "plus",
    "equilateral_triangle": "triangle",
    "rectangle": "square",
}
_SAID = {"SimpleLine", "SimpleFill", "SimpleMarker"}


def read_qml(root: Element, told: Told) -> Style:
    """Make a style of a QML document; what is not understood goes to `told`."""
    renderer = root.find("renderer-v2")
    label = None if root.get("labelsEnabled") == "0" else _label(root.find("labeling"), told)
    _whole_layer(root, told)
    if renderer is None:
        told.say("the file has no renderer")
        return Style(label=label)
    symbols = {node.get("name", ""): _symbol(node, told) for node in renderer.findall("symbols/symbol")}
    for extra in ("source-symbol", "rotation", "sizescale"):
        node = renderer.find(extra)
        if extra != "source-symbol" and node is not None and node.attrib:
            told.say(f"{extra} of the renderer")
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
            rules += [_rule(symbol, node.get("label") or value, value=value, hide=hide) for value in values]
        return Style(symbol=rest, column=column, rules=tuple(rules), label=label)
    if kind == "graduatedSymbol":
        rules = []
        for node in renderer.findall("ranges/range"):
            low, high = float(node.get("lower", "nan")), float(node.get("upper", "nan"))
            # The upper limit of a class belongs to it, and the first class that holds is taken; ours end before it.
            high = math.nextafter(high, math.inf)
            symbol = symbols.get(node.get("symbol", ""), Symbol())
            hide = node.get("render", "true") == "false"
            rules.append(_rule(symbol, node.get("label", ""), least=low, below=high, hide=hide))
        return Style(column=column, rules=tuple(rules), label=label)
    told.say(f"renderer '{kind}'; its first symbol is used for all")
    return Style(symbol=next(iter(symbols.values()), Symbol()), label=label)


def _whole_layer(root: Element, told: Told) -> None:
    """What the file says of the layer as a whole, and is not drawn."""
    opacity = root.findtext("layerOpacity") or "1"
    if float(opacity) != 1.0:
        told.say(f"opacity {opacity} of the layer")
    for name in ("blendMode", "featureBlendMode"):
        if (root.findtext(name) or "0") != "0":
            told.say(f"{name} of the layer")
    if root.get("hasScaleBasedVisibilityFlag") == "1":
        told.say("scales at which the layer is hidden")


def _rule(symbol: Symbol, name: str, **limits: object) -> Rule:
    return Rule(title=name, line=symbol.line, fill=symbol.fill, marker=symbol.marker, **limits)  # type: ignore[arg-type]


def _options(layer: Element) -> dict[str, str]:
    """Properties: those of QGIS 3.26 and later, and of earlier ones."""
    found = {node.get("k", ""): node.get("v", "") for node in layer.findall("prop")}
    found |= {
        n.get("name", ""): n.get("value", "") for n in layer.findall("Option/Option") if n.get("value") is not None
    }
    return found


def _symbol(node: Element, told: Told) -> Symbol:
    opacity = float(node.get("alpha", "1"))
    line: Line | None = None
    fill: Fill | None = None
    marker: Marker | None = None
    seen: set[str] = set()
    for layer in node.findall("layer"):
        if layer.get("enabled", "1") == "0":
            continue
        kind, said = layer.get("class", ""), _options(layer)
        data = layer.find("data_defined_properties/Option/Option[@name='properties']")
        if data is not None and len(data):
            told.say(f"values of {kind} that come from the data")
        if kind in _SAID:
            _moved(kind, said, told)
        if kind in seen and kind != "SimpleLine":
            told.say(f"more than one {kind}, the last one drawn")
        seen.add(kind)
        if kind not in _SAID:
            told.say(f"symbol layer '{kind}'")
        elif kind == "SimpleLine":
            drawn = _line(said, "line_color", "line_width", "line_style", opacity, told)
            if line is not None and line.casing is not None:
                told.say("more than two strokes of a line")
            if line is not None and drawn is not None:
                # Two strokes: the lower, wider one is the casing.
                lower, upper = (line, drawn) if line.width >= drawn.width else (drawn, line)
                line = replace(upper, casing=lower.color, casing_width=lower.width)
            else:
                line = drawn or line
        elif kind == "SimpleFill":
            if said.get("style", "solid") != "no":
                if said.get("style", "solid") != "solid":
                    told.say(f"fill pattern '{said['style']}', filled evenly")
                color, alpha = _color(said.get("color", ""), told)
                fill = Fill(color, alpha * opacity)
            line = _line(said, "outline_color", "outline_width", "outline_style", opacity, told) or line
        else:
            shape = SHAPES.get(said.get("name", "circle"), said.get("name", "circle"))
            if shape not in MARKERS:
                told.say(f"marker '{shape}', drawn as a circle")
                shape = "circle"
            size = _length(said, "size", 2.0, told)
            edge = _color(said.get("outline_color", "0,0,0,255"), told)[0]
            none = said.get("outline_style") == "no"
            wide = 0.0 if none else _length(said, "outline_width", 0.0, told) or 0.1
            color, alpha = _color(said.get("color", ""), told)
            marker = Marker(shape, size, color, edge, wide, alpha * opacity)
    return Symbol(line, fill, marker)


def _moved(kind: str, said: Mapping[str, str], told: Told) -> None:
    """Tell of offsets and turns, which are not drawn."""
    for name in ("offset", "angle"):
        if any(float(part or 0) for part in said.get(name, "0").split(",")) and (name, kind) != ("angle", "SimpleFill"):
            told.say(f"{name} of {kind}")


def _line(said: Mapping[str, str], color: str, width: str, style: str, opacity: float, told: Told) -> Line | None:
    kind = said.get(style, "solid")
    if kind == "no":
        return None
    name, alpha = _color(said.get(color, ""), told)
    wide = _length(said, width, 0.26, told) or 0.1
    dash: tuple[float, ...] = ()
    if said.get("use_custom_dash") == "1":
        scale = _unit(said, "customdash", told)
        dash = dashes((float(v) * scale for v in said.get("customdash", "").split(";") if v), told)
    elif kind != "solid":
        # Dashes of Qt, in widths of the line.
        known = {"dash": (4, 2), "dot": (1, 2), "dash dot": (4, 2, 1, 2), "dash dot dot": (4, 2, 1, 2, 1, 2)}
        if kind not in known:
            told.say(f"line style '{kind}', drawn whole")
        dash = tuple(v * wide for v in known.get(kind, ()))
    return Line(name, wide, dash, opacity=alpha * opacity)


def _unit(said: Mapping[str, str], name: str, told: Told) -> float:
    unit = said.get(f"{name}_unit", "MM")
    if unit not in UNITS:
        told.say(f"lengths in '{unit}', taken as millimetres")
    return UNITS.get(unit, 1.0)


def _length(said: Mapping[str, str], name: str, default: float, told: Told) -> float:
    return float(said.get(name, default)) * _unit(said, name, told)


def _color(text: str, told: Told) -> tuple[str, float]:
    """Colour and opacity of 'r,g,b,a'; later QGIS adds the same in words after that."""
    parts = text.split(",")
    try:
        red, green, blue = (int(v) for v in parts[:3])
        alpha = int(parts[3]) / 255 if len(parts) > 3 else 1.0
    except ValueError:
        told.say(f"colour '{text}', drawn black")
        return "#000000", 1.0
    return f"#{red:02x}{green:02x}{blue:02x}", alpha


def _label(node: Element | None, told: Told) -> Label | None:
    if node is None:
        return None
    style = node.find("settings/text-style")
    if node.get("type") != "simple" or style is None:
        told.say(f"labels of type '{node.get('type')}'")
        return None
    column = style.get("fieldName", "")
    if style.get("isExpression") == "1":
        plain = re.fullmatch(r'\s*"([^"]+)"\s*', column)
        if plain is None:
            told.say(f"labels by the expression {column}")
            return None
        column = plain[1]
    size = float(style.get("fontSize", "10"))
    unit = style.get("fontSizeUnit", "Point")
    if unit not in UNITS:
        told.say(f"text sizes in '{unit}', taken as points")
    size *= UNITS.get(unit, UNITS["Point"]) / UNITS["Point"]
    if style.get("capitalization", "0") != "0" or style.get("fontCapitals", "0") != "0":
        told.say("capitals of labels")
    drawn = node.find("settings/background")
    if drawn is not None and drawn.get("shapeDraw") == "1":
        told.say("backgrounds of labels")
    scales = node.find("settings/rendering")
    if scales is not None and scales.get("scaleVisibility") == "1":
        told.say("labels at some scales only, drawn at this one")
    buffer = style.find("text-buffer")
    halo, wide = None, 0.5
    if buffer is not None and buffer.get("bufferDraw") == "1":
        halo = _color(buffer.get("bufferColor", "255,255,255,255"), told)[0]
        wide = float(buffer.get("bufferSize", "1")) * UNITS.get(buffer.get("bufferSizeUnits", "MM"), 1.0)
    color = mixed(*_color(style.get("textColor", "0,0,0,255"), told))
    bold = float(style.get("fontWeight", "50")) >= 75 or "bold" in style.get("namedStyle", "").lower()
    italic = style.get("fontItalic") == "1"
    return Label(column, size, color, halo, wide, bold, italic)
