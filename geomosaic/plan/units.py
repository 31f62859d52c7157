"""Units that values of a plan may be given in, and what they are in the unit that is calculated with."""

from __future__ import annotations

import math
import re

from geomosaic.errors import InputError

LENGTHS = {
    "m": 1.0, "km": 1000.0, "cm": 1e-2, "mm": 1e-3, "µm": 1e-6, "um": 1e-6, "ft": 0.3048, "in": 0.0254, "mi": 1609.344,
}  # fmt: skip
"""In metres; foot, inch and mile are the international ones."""
ANGLES = {"°": math.pi / 180, "deg": math.pi / 180, "gon": math.pi / 200, "rad": 1.0, "mrad": 1e-3}
"""In radians."""
RESOLUTIONS = {"dpi": 1.0, "px/mm": 25.4, "px/cm": 2.54}
"""In dots per inch."""
SHARES = {"%": 1.0}
KINDS = (LENGTHS, ANGLES, RESOLUTIONS, SHARES)
_NUMBER = re.compile(r"\s*([-+]?(?:\d[\d\u202f ]*(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\W\d_][\w/]*|[%°])?\s*")


def in_unit(text: str, unit: str) -> float:
    """Number of a quantity: '20000 ft' in metres is 6096; a plain number counts in `unit` itself.

    Raises
    ------
    InputError
        It is no number, or its unit measures something else.
    """
    found = _NUMBER.fullmatch(text.replace("\N{GREEK SMALL LETTER MU}", "µ"))
    if found is None:
        raise InputError(f"'{text}' is no number", mend=f"write it as 150 or with its unit, {_known(unit)}")
    number = float(re.sub(r"[ \u202f]", "", found[1]))
    given = found[2]
    if given is None or given == unit:
        return number
    kind = next((kind for kind in KINDS if unit in kind), {})
    if given not in kind:
        what = f"counts in {unit}" if unit else "has no unit"
        raise InputError(f"'{text}' has a unit that does not fit: the value {what}", mend=f"write it in {_known(unit)}")
    return number * kind[given] / kind[unit]


def _known(unit: str) -> str:
    kind = next((kind for kind in KINDS if unit in kind), None)
    return "plain digits" if kind is None else ", ".join(kind)
