"""Styles of vector layers: symbols, categories, graduated classes and labels, from a short TOML file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError, did_you_mean
from geomosaic.numbers import grouped
from geomosaic.options.check import build, parse_color
from geomosaic.options.declaration import option
from geomosaic.sheets.pictograms import GROUPS, PICTOGRAMS, is_file, pictogram

MARKERS = ("circle", "square", "triangle", "diamond", "cross", "plus", "star")


def _parse_shape(value: Any) -> str:
    """Shape of a marker: one of `MARKERS`, a pictorial symbol, or an SVG file."""
    shape = str(value)
    if shape in MARKERS or shape in PICTOGRAMS or is_file(shape):
        return shape
    hint = did_you_mean(shape, (*MARKERS, *PICTOGRAMS))
    names = f"one of {', '.join((*MARKERS, *PICTOGRAMS))}, or the path of an .svg file"
    raise InputError(f"'{shape}' is not known as a symbol", hint=hint or names)


def _parse_pattern(value: Any) -> str:
    """Symbol that is repeated along a line: a pictorial one, or an SVG file."""
    shape = str(value)
    if shape in MARKERS:
        hint = f"one of {', '.join(GROUPS['along lines'])}, or the path of an .svg file"
        raise InputError(f"'{shape}' is no symbol for lines", hint=hint)
    return _parse_shape(shape)


@dataclass(frozen=True)
class Line:
    """A line: widths in mm, dashes as lengths of stroke and gap in mm, the casing as its full width.

    A pattern is a symbol of `pattern_size` mm that is repeated every `pattern_interval` mm, turned with the line: its
    right side is forwards, its upper side left of the line.
    """

    color: str = option("#000000", parse=parse_color)
    width: float = option(0.3, above=0.0, most=20.0)
    dash: tuple[float, ...] = ()
    casing: str | None = option(None, parse=parse_color)
    casing_width: float | None = option(None, above=0.0, most=30.0)
    opacity: float = option(1.0, least=0.0, most=1.0)
    pattern: str | None = option(None, parse=_parse_pattern)
    pattern_size: float = option(1.8, above=0.0, most=50.0)
    pattern_interval: float = option(5.0, above=0.0, most=500.0)

    @property
    def full_width(self) -> float:
        """Width with the casing, mm."""
        return self.width if self.casing is None else (self.casing_width or self.width + 0.4)


@dataclass(frozen=True)
class Fill:
    """An area's colour; its edge is the symbol's line."""

    color: str = option("#cccccc", parse=parse_color)
    opacity: float = option(0.5, least=0.0, most=1.0)


@dataclass(frozen=True)
class Marker:
    """A point's symbol; size and outline in mm."""

    shape: str = option("circle", parse=_parse_shape)
    size: float = option(1.8, above=0.0, most=50.0)
    color: str = option("#d7191c", parse=parse_color)
    outline: str = option("#ffffff", parse=parse_color)
    outline_width: float = option(0.15, least=0.0, most=5.0)
    opacity: float = option(1.0, least=0.0, most=1.0)


@dataclass(frozen=True)
class Label:
    """Names: the column they stand in, text size in points, halo in mm."""

    column: str
    size: float = option(7.0, above=0.0, most=100.0)
    color: str = option("#000000", parse=parse_color)
    halo: str | None = option("#ffffff", parse=parse_color)
    halo_width: float = option(0.5, least=0.0, most=5.0)
    bold: bool = False
    italic: bool = False
    decimals: int | None = option(None, least=0, most=9)


@dataclass(frozen=True)
class Symbol:
    """What one kind of object looks like; what it has no use for is not drawn."""

    line: Line | None = None
    fill: Fill | None = None
    marker: Marker | None = None


@dataclass(frozen=True)
class Rule:
    """A `[[category]]` (`value`) or a `[[class]]` (`least` <= number < `below`)."""

    value: str | None = None
    least: float | None = None
    below: float | None = None
    title: str = ""
    hide: bool = False
    line: Line | None = None
    fill: Fill | None = None
    marker: Marker | None = None

    @property
    def name(self) -> str:
        """Text of the legend."""
        if self.title:
            return self.title
        if self.value is not None:
            return self.value
        if self.below is None:
            return f"≥ {_limit(self.least)}" if self.least is not None else "all"
        return f"< {_limit(self.below)}" if self.least is None else f"{_limit(self.least)} – {_limit(self.below)}"


def _limit(value: float) -> str:
    """Limit of a class as a legend has it: six figures, and whole numbers where these have more."""
    return grouped(value) if abs(value) >= 1e5 else f"{value:.6g}"


@dataclass(frozen=True)
class Ramp:
    """`[graduated]`: classes of a column's numbers made from the data, colours from one to another."""

    column: str
    count: int = option(5, least=2, most=20)
    method: str = option("quantile", choices=("quantile", "equal"))
    start: str = option("#ffffcc", parse=parse_color)
    end: str = option("#8b0025", parse=parse_color)


@dataclass(frozen=True)
class Style:
    """A layer's style.

    Attributes
    ----------
    title : str, in the legend; the layer's own name where empty
    symbol : Symbol, of objects that no rule claims
    column : str, of rules
    rules : tuple of Rule, the first that holds is taken
    ramp : Ramp or None
    label : Label or None
    """

    title: str = ""
    symbol: Symbol = field(default_factory=Symbol)
    column: str = ""
    rules: tuple[Rule, ...] = ()
    ramp: Ramp | None = None
    label: Label | None = None


@dataclass(frozen=True)
class _File:
    """Keys of a style file."""

    title: str = ""
    column: str = ""
    line: Line | None = None
    fill: Fill | None = None
    marker: Marker | None = None
    label: Label | None = None
    category: tuple[Rule, ...] = ()
    class_: tuple[Rule, ...] = ()
    graduated: Ramp | None = None


# Size in mm of a pictorial symbol unless one is given, and colours of groups of them that are not black.
PICTOGRAM_SIZE = 3.6
_COLORS = {"hydrography": "#0b4f9e"}


def _patterned(color_: str, width: float, pattern: str, size: float, interval: float) -> Line:
    """Line with a pattern and a white seam."""
    casing_width = width + 0.4
    return Line(
        color_, width, casing="#ffffff", casing_width=casing_width, pattern=pattern, pattern_size=size,
        pattern_interval=interval,
    )  # fmt: skip


# Styles that have names. Their lines are made for pictures, which are dark and full: strong colours, and casings where
# a line alone would be lost.
BUILT_IN: dict[str, Style] = {
    "line": Style(symbol=Symbol(line=Line("#d7191c", 0.35))),
    "outline": Style(symbol=Symbol(line=Line("#ffe119", 0.4, casing="#000000", casing_width=0.7))),
    "road": Style(symbol=Symbol(line=Line("#ffffff", 0.7, casing="#4d4d4d", casing_width=1.0))),
    "path": Style(symbol=Symbol(line=Line("#ffffff", 0.3, (1.2, 0.7), "#4d4d4d", 0.45))),
    "rail": Style(symbol=Symbol(line=Line("#ffffff", 0.35, (1.8, 1.8), "#000000", 0.6))),
    "water": Style(symbol=Symbol(Line("#1f78b4", 0.4), Fill("#a6cee3", 0.6), Marker("circle", 1.6, "#1f78b4"))),
    "boundary": Style(symbol=Symbol(line=Line("#c51b8a", 0.45, (3.0, 0.8, 0.6, 0.8)))),
    "building": Style(symbol=Symbol(Line("#5e1914", 0.15), Fill("#b5544b", 0.7))),
    "area": Style(symbol=Symbol(Line("#d7191c", 0.35), Fill("#d7191c", 0.15))),
    "point": Style(symbol=Symbol(marker=Marker())),
    "control": Style(symbol=Symbol(marker=Marker("triangle", 2.4, "#ffe119", "#000000", 0.25))),
    "track": Style(symbol=Symbol(Line("#f58231", 0.5), None, Marker("circle", 0.9, "#f58231", "#ffffff", 0.1))),
    "stream": Style(symbol=Symbol(_patterned("#1f78b4", 0.4, "arrowhead", 2.0, 25.0))),
    "narrow-gauge": Style(symbol=Symbol(_patterned("#000000", 0.35, "bar", 2.0, 3.0))),
    "power-line": Style(symbol=Symbol(_patterned("#4d4d4d", 0.25, "bead", 1.0, 8.0))),
    "fence": Style(symbol=Symbol(_patterned("#4d4d4d", 0.25, "saltire", 1.4, 4.0))),
    "embankment": Style(symbol=Symbol(_patterned("#6b4423", 0.25, "half-bar", 2.8, 2.0))),
    "cliff": Style(symbol=Symbol(_patterned("#6b4423", 0.35, "tooth", 1.8, 1.8))),
} | {
    name: Style(symbol=Symbol(marker=Marker(name, PICTOGRAM_SIZE, _COLORS.get(group, "#000000"), "#ffffff", 0.25)))
    for group, names in GROUPS.items() if group != "along lines" for name in names
}  # fmt: skip


def plain(kind: str, color_: str) -> Style:
    """Style of a layer that has none: by the kind of its geometries (point, line, polygon).

    Parameters
    ----------
    kind : str
    color_ : str, #rrggbb
    """
    if kind == "point":
        return Style(symbol=Symbol(marker=Marker(color=color_)))
    if kind == "line":
        return Style(symbol=Symbol(line=Line(color_, 0.4, casing="#ffffff", casing_width=0.7)))
    return Style(symbol=Symbol(line=Line(color_, 0.35), fill=Fill(color_, 0.15)))


def built_in(name: str, where: str | None = None) -> Style:
    """Style by name.

    Parameters
    ----------
    name : str
    where : str, optional, named in errors

    Raises
    ------
    InputError
    """
    if name not in BUILT_IN:
        hint = did_you_mean(name, BUILT_IN)
        raise InputError(
            f"there is no style '{name}'",
            where=where,
            hint=hint or f"one of {', '.join(BUILT_IN)}, or the path of a .toml, .qml or .sld file",
        )
    return BUILT_IN[name]


@dataclass(frozen=True)
class StyleChange:
    """Changes of a style by a layout: colour of lines, fills and markers, width of lines in mm, column of the names."""

    color: str | None = None
    width: float | None = None
    label: str = ""


def changed(style: Style, change: StyleChange, where: str | None = None) -> Style:
    """Style with the changes of a layout; a casing stays as wide beside its line.

    Parameters
    ----------
    style : Style
    change : StyleChange
    where : str, optional, named in errors

    Raises
    ------
    InputError
        The style has rules, whose colours and widths are their own.
    """
    if (change.color or change.width) and (style.rules or style.ramp):
        raise InputError(
            "the style has categories or classes with colours and widths of their own",
            where=where,
            hint="leave color and width of the layer out, or change the style",
        )
    line, fill, marker = style.symbol.line, style.symbol.fill, style.symbol.marker
    if line is not None:
        width = change.width or line.width
        casing = None if line.casing_width is None else line.casing_width + width - line.width
        line = replace(line, color=change.color or line.color, width=width, casing_width=casing)
    if change.color:
        fill = None if fill is None else replace(fill, color=change.color)
        marker = None if marker is None else replace(marker, color=change.color)
    label = style.label
    if change.label:
        label = Label(change.label) if label is None else replace(label, column=change.label)
    return replace(style, symbol=Symbol(line, fill, marker), label=label)


def parse_style(values: Mapping[str, Any], where: str) -> Style:
    """Style of the tables of a style file.

    Parameters
    ----------
    values : mapping, tables of the file
    where : str, named in errors

    Raises
    ------
    InputError
        Unknown keys, wrong values, rules without a column, or nothing to draw.
    """
    file = build(_File, _with_sizes(_numbers_as_text(values)), where)
    rules = (*file.category, *file.class_)
    if rules and not file.column:
        raise InputError("rules need a column", where=where, hint='write column = "..." at the top of the file')
    for rule in file.category:
        if rule.value is None:
            raise InputError("a category has no value", where=where, hint='write value = "..."')
    for rule in file.class_:
        if rule.least is None and rule.below is None:
            raise InputError("a class has no limits", where=where, hint="write least = ..., below = ... or both")
    if rules and file.graduated is not None:
        raise InputError(
            "the style has rules and [graduated]",
            where=where,
            hint="leave out [graduated], or the categories and classes",
        )
    for line in (file.line, *(rule.line for rule in rules)):
        if line is not None and any(not part > 0 for part in line.dash):
            raise InputError(
                f"dash {list(line.dash)} has a part that is not above 0", where=where,
                hint="write lengths of stroke and gap in mm, such as [1.4, 0.7], or leave dash out",
            )  # fmt: skip
    symbol = Symbol(file.line, file.fill, file.marker)
    if symbol == Symbol() and not rules and file.label is None and file.graduated is None:
        raise InputError(
            "the style draws nothing", where=where, hint="write [line], [fill], [marker], [graduated] or [label]"
        )
    # What a rule leaves open is as the base has it.
    rules = tuple(
        replace(rule, line=rule.line or symbol.line, fill=rule.fill or symbol.fill, marker=rule.marker or symbol.marker)
        for rule in rules
    )
    return Style(file.title, symbol, file.column, rules, file.graduated, file.label)


def _numbers_as_text(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of categories may be written as numbers; they are compared as text."""
    out = dict(values)
    if isinstance(out.get("category"), list):
        out["category"] = [
            {**rule, "value": value_text(rule["value"])} if isinstance(rule, dict) and "value" in rule else rule
            for rule in out["category"]
        ]
    return out


def _with_sizes(values: dict[str, Any]) -> dict[str, Any]:
    """Pictorial markers without a size get theirs: the usual one is that of a dot."""
    out = dict(values)
    marker = out.get("marker")
    if isinstance(marker, dict) and "size" not in marker and marker.get("shape", "circle") not in MARKERS:
        out["marker"] = {**marker, "size": PICTOGRAM_SIZE}
    for key in ("category", "class"):
        if isinstance(out.get(key), list):
            out[key] = [_with_sizes(rule) if isinstance(rule, dict) else rule for rule in out[key]]
    return out


def located(style: Style, folder: Path, where: str) -> Style:
    """Style whose SVG files are found from a folder; each is read once, so that errors come before the drawing.

    Parameters
    ----------
    style : Style
    folder : Path
    where : str, named in errors

    Raises
    ------
    InputError
        A file is missing, or no symbol.
    """

    def found(shape: str | None) -> str | None:
        if shape is None or not is_file(shape):
            return shape
        try:
            pictogram(str(folder / shape))
        except InputError as error:
            raise InputError(error.what, where=f"{where}: {error.where}", hint=error.hint) from None
        return str(folder / shape)

    def line(one: Line | None) -> Line | None:
        return None if one is None else replace(one, pattern=found(one.pattern))

    def marker(one: Marker | None) -> Marker | None:
        return None if one is None else replace(one, shape=found(one.shape) or one.shape)

    symbol = Symbol(line(style.symbol.line), style.symbol.fill, marker(style.symbol.marker))
    rules = tuple(replace(rule, line=line(rule.line), marker=marker(rule.marker)) for rule in style.rules)
    return replace(style, symbol=symbol, rules=rules)


def value_text(value: Any) -> str:
    """A cell as text: 2.0 as '2', and 'true' or 'false'.

    Parameters
    ----------
    value : object
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        if value == int(value):
            return str(int(value))
        return f"{value:g}" if abs(value) < 1e6 else f"{value:.1f}"
    return str(value)


# Luminance from which a colour does not show on white paper: yellow (0.75) and amber (0.64) are above it, the light
# blue of water (0.58) and orange (0.36) below.
_LIGHT = 0.6


def _luminance(color: str) -> float:
    """Relative luminance of #rrggbb, 0 to 1 (ITU-R BT.709 weights of linear sRGB)."""
    parts = (int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    red, green, blue = (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def halo_of(color: str) -> str:
    """White around dark colours, black around light ones.

    Parameters
    ----------
    color : str, #rrggbb
    """
    return "#000000" if _luminance(color) > _LIGHT else "#ffffff"


def on_paper(color: str) -> str:
    """Colour in which a text of a colour can be read on white paper: black for light ones.

    Parameters
    ----------
    color : str, #rrggbb
    """
    return "#000000" if _luminance(color) > _LIGHT else color


def legend_line(color: str, width: float) -> Line:
    """Return a line as the legend shows it: light ones on a dark casing.

    Parameters
    ----------
    color : str, #rrggbb
    width : float, mm
    """
    if _luminance(color) > _LIGHT:
        return Line(color, width, casing="#4d4d4d", casing_width=width + 0.5)
    return Line(color, width)


class Remarks:
    """Remarks on what of a style is not drawn as it is written, each once."""

    def __init__(self) -> None:
        self.texts: dict[str, None] = {}

    def add(self, text: str) -> None:
        """Add a remark unless it is there."""
        self.texts[text] = None


def dashes(parts: Iterable[float], remarks: Remarks) -> tuple[float, ...]:
    """Lengths of stroke and gap; none of what is no such thing.

    Parameters
    ----------
    parts : iterable of float, mm
    remarks : Remarks
    """
    found = tuple(parts)
    if not any(found):  # a line without gaps
        return ()
    if all(part > 0 for part in found):
        return found
    remarks.add(f"dashes {', '.join(f'{part:g}' for part in found)}, drawn whole")
    return ()


def blend(start: str, end: str, share: float) -> str:
    """Colour between two, #rrggbb.

    Parameters
    ----------
    start, end : str, #rrggbb
    share : float, 0 to 1
    """
    pairs = ((int(start[k : k + 2], 16), int(end[k : k + 2], 16)) for k in (1, 3, 5))
    return "#" + "".join(f"{round(a + share * (b - a)):02x}" for a, b in pairs)


def cased(first: Line, second: Line) -> Line:
    """Line of two strokes: the wider one is the casing of the other.

    Parameters
    ----------
    first, second : Line
    """
    lower, upper = (first, second) if first.width >= second.width else (second, first)
    return replace(upper, casing=lower.color, casing_width=lower.width)
