"""Scale: the number, and a bar of two rows whose length is exact."""

from __future__ import annotations

from geomosaic.carto.draw.canvas import Canvas
from geomosaic.carto.draw.fonts import CAP
from geomosaic.carto.draw.letters import POINT, text_size
from geomosaic.carto.layout import Layout
from geomosaic.carto.nice import grouped
from geomosaic.carto.page import Page
from geomosaic.errors import InputError

FOOT_M = 0.3048
STEPS = (1.0, 2.0, 3.0, 4.0, 5.0, 10.0)
"""Times a power of ten: lengths of bars."""
ROW = 1.1
"""Height in mm of one row of the bar."""


def bar_divisions(length: float) -> int:
    """Number of parts of a bar: 5 for 5 and 10, 4 for 2 and 4, 3 otherwise; each part is then a round length."""
    lead = length
    while lead >= 10.0 - 1e-9:
        lead /= 10.0
    while lead < 1.0 - 1e-9:
        lead *= 10.0
    return {1: 5, 2: 4, 4: 4, 5: 5}.get(round(lead), 3)


def bar_length(longest: float) -> float:
    """Largest of 1 to 5 times a power of ten that is not longer."""
    power = 1.0
    while power > longest:
        power /= 10.0
    while power * 10.0 <= longest * (1 + 1e-9):
        power *= 10.0
    return max(power * step for step in STEPS if power * step <= longest * (1 + 1e-9))


SHORTEST = 10.0
"""Length of a bar in mm that its figures need."""


def scale_text(scale: float) -> str:
    """Write the scale as a fraction: '1 : 25 000'."""
    return f"1 : {grouped(scale, 0 if abs(scale - round(scale)) < 1e-6 else 1)}"


def draw_scale(canvas: Canvas, page: Page, layout: Layout, middle: float, top: float, room: float) -> float:
    """Number and bars, centred; returns the lower end.

    Parameters
    ----------
    canvas : Canvas
    page : Page
    layout : Layout
    middle, top : float
        Place in mm.
    room : float
        Width in mm that there is.

    Raises
    ------
    InputError
        A bar of the length that the layout wants does not fit.
    """
    canvas.centred(middle, top - 1.8, scale_text(page.scale), 10.0, bold=True)
    y = top - 6.8
    if not layout.scalebar.show:
        return top - 4.0
    per_metre = 1000.0 / page.scale
    longest = min(room - 12.0, 110.0)
    wanted = layout.scalebar.length
    if wanted is not None and wanted * per_metre > room - 8.0:
        raise InputError(
            f"a scale bar of {wanted:g} m measures {wanted * per_metre:.0f} mm, there is room for {room - 8.0:.0f} mm",
            where="[scalebar] length",
            mend="give a shorter one",
        )
    if wanted is not None and wanted * per_metre < SHORTEST:
        raise InputError(
            f"a scale bar of {wanted:g} m measures {wanted * per_metre:.2g} mm, too little for its figures",
            where="[scalebar] length",
            mend=f"give at least {bar_length(2.0 * SHORTEST / per_metre):g} m",
        )
    length = wanted or bar_length(longest / per_metre)
    kilometres = length >= 2000.0
    _bar(canvas, middle - length * per_metre / 2, y, length * per_metre, length / (1000.0 if kilometres else 1.0),
         "km" if kilometres else "m", above=True)  # fmt: skip
    if not layout.scalebar.feet:
        return y - 2 * ROW
    feet = bar_length(max(length, SHORTEST / per_metre) / FOOT_M)
    y -= 2 * ROW + 0.7
    _bar(canvas, middle - length * per_metre / 2, y, feet * FOOT_M * per_metre, feet, "ft", above=False)
    return y - 2 * ROW - 3.0


def _bar(canvas: Canvas, left: float, top: float, length: float, value: float, unit: str, *, above: bool) -> None:
    """Two rows of boxes, black where the other is white; figures above or below."""
    size = 6.0
    widest = text_size(_figure(value), size)[0] + 1.0
    parts = next((n for n in (bar_divisions(value), 2) if length / n >= widest), 1)
    step = length / parts
    canvas.rectangle((left, top - 2 * ROW, left + length, top), fill="#ffffff")
    for k in range(parts):
        y = top - ROW if k % 2 == 0 else top - 2 * ROW
        canvas.rectangle((left + k * step, y, left + (k + 1) * step, y + ROW), fill="#000000")
    canvas.rectangle((left, top - 2 * ROW, left + length, top), edge="#000000", width=0.15)
    y = top + 0.8 if above else top - 2 * ROW - 0.8 - size * CAP * POINT
    for k in range(parts + 1):
        text = _figure(value * k / parts)
        canvas.text(left + k * step, y, text, size, align="center")
    last = text_size(_figure(value), size)[0] / 2
    canvas.text(left + length + last + 0.8, y, unit, size)


def _figure(value: float) -> str:
    return grouped(value) if value >= 1000 and value == int(value) else f"{value:g}"
