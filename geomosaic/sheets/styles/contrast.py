"""Colours against white paper and against their own halo."""

from __future__ import annotations

from geomosaic.sheets.styles.style import Line

LIGHT = 0.6
"""Luminance from which a colour does not show on white paper."""


def luminance(color: str) -> float:
    """Relative luminance of #rrggbb, 0 to 1 (ITU-R BT.709 weights of linear sRGB)."""
    parts = (int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    red, green, blue = (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def halo_of(color: str) -> str:
    """White around dark colours, black around light ones."""
    return "#000000" if luminance(color) > LIGHT else "#ffffff"


def on_paper(color: str) -> str:
    """Colour in which a text of a colour can be read on white paper: black for light ones."""
    return "#000000" if luminance(color) > LIGHT else color


def legend_line(color: str, width: float) -> Line:
    """Return a line as the legend shows it: light ones on a dark casing."""
    if luminance(color) > LIGHT:
        return Line(color, width, casing="#4d4d4d", casing_width=width + 0.5)
    return Line(color, width)
