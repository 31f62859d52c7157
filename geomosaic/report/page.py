"""Report pages: Jinja environment, and numbers with the decimals that their unit asks for."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geomosaic import __version__

if TYPE_CHECKING:
    from jinja2 import Environment
    from jinja2.bccache import Bucket


def decimals(scale: float | None, least: int = 0) -> int:
    """Number of decimals that show three figures of a value.

    Pixels of 0.5 m take 3, of 0.00001 degrees 7; grey values of bytes keep the least, reflectances of 0.02 take 4.

    Parameters
    ----------
    scale : float or None
        Typical size of the values.
    least : int
        Smallest number of decimals; also where the size is not known.
    """
    if scale is None or not math.isfinite(scale) or scale <= 0:
        return least
    return max(least, 2 - math.floor(math.log10(scale)))


def number(value: float | None, digits: int = 3) -> str:
    """Number as text with a true minus sign, or a dash where there is none.

    Parameters
    ----------
    value : float or None
    digits : int
        Decimals.

    Returns
    -------
    str
        '–' for None, NaN and infinity.
    """
    if value is None or not math.isfinite(value):
        return "–"
    # Adding 0.0 turns −0.0 into 0.0: no minus before a zero.
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "−")


def length_text(length: float | None, unit: str) -> str:
    """Length with three figures, metres in the largest unit in which it is at least 1.

    Parameters
    ----------
    length : float or None
    unit : str
        'm', or another that stays.

    Returns
    -------
    str
        '–' for None, NaN and infinity.
    """
    if length is None or not math.isfinite(length):
        return "–"
    units = {"km": 1e-3, "m": 1.0, "cm": 100.0, "mm": 1000.0} if unit == "m" else {unit: 1.0}
    name = next((name for name, by in units.items() if length * by >= 1.0), [*units][-1])
    return f"{length * units[name]:.3g} {name}"


def _rounded(value: float | None) -> str:
    """Positive number with two significant figures; '∞' for infinity, and a dash where there is none."""
    if value is None or math.isnan(value):
        return "–"
    return "∞" if math.isinf(value) else f"{float(f'{value:.2g}'):g}"


def _fields(values: Mapping[str, Any]) -> str:
    """Table of inputs as one line of text, nested tables in brackets."""
    parts = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            shown = f"({_fields(value)})"
        elif isinstance(value, list):
            shown = " × ".join(map(str, value)) if key.endswith("size") else ", ".join(map(str, value))
        else:
            shown = str(value)
        parts.append(f"{key.replace('_', ' ')} {shown}")
    return "; ".join(parts) if any(isinstance(value, Mapping | list) for value in values.values()) else ", ".join(parts)


def _byte_size(size: float) -> str:
    """Size of a file as text, in the largest decimal unit in which it is at least 1."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000 or unit == "GB":
            return f"{size:.0f} {unit}" if unit == "bytes" else f"{size:.1f} {unit}"
        size /= 1000
    raise AssertionError  # unreachable


def rms(values: Sequence[float | None]) -> float | None:
    """Root mean square over bands.

    Parameters
    ----------
    values : sequence of float or None

    Returns
    -------
    float or None
        None where a value is missing, or all are.
    """
    known = [value for value in values if value is not None]
    return math.sqrt(sum(v * v for v in known) / len(known)) if known and len(known) == len(values) else None


def share(part: float, whole: float) -> str:
    """Part of a whole as text, in per cent.

    Parameters
    ----------
    part, whole : float
        `whole` is not 0.
    """
    return f"{100 * part / whole:.1f} %"


_FOLDER = Path(__file__).parent
_COMPILED = _FOLDER / "__pycache__"


def rendered(template: str, **values: Any) -> str:
    """Page of a template in this folder, which can name the version of geomosaic.

    Parameters
    ----------
    template : str
        Its name without endings.
    **values
        What the template shows.
    """
    return _environment().get_template(f"{template}.html.j2").render(**{"geomosaic": __version__, **values})


@cache
def _environment() -> Environment:
    """Jinja environment of the templates in this folder; text is escaped, and an undefined name is an error."""
    # Compiled templates are cached beside Python's own bytecode where that is possible: compiling takes a fifth of a
    # second.
    import jinja2

    class Kept(jinja2.FileSystemBytecodeCache):
        def dump_bytecode(self, bucket: Bucket) -> None:
            with suppress(OSError):  # of a folder that cannot be written, or a full disk: no report fails by this
                super().dump_bytecode(bucket)

    keep = not sys.dont_write_bytecode and _COMPILED.is_dir()
    # Raise the number when an option below changes: kept templates know nothing of options.
    name = f"__jinja2_{jinja2.__version__}_1_%s.cache"
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_FOLDER),
        bytecode_cache=Kept(str(_COMPILED), name) if keep else None,
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters.update(number=number, rounded=_rounded, bytes=_byte_size, share=share, fields=_fields)
    return made


def card(title: str, value: str, unit: str, text: str, *, passed: bool | None = None) -> dict[str, Any]:
    """Figure at the head of a page.

    Parameters
    ----------
    title, value, unit, text : str
    passed : bool, optional
        Whether it keeps its limit; None without one.
    """
    return {"title": title, "value": value, "unit": unit, "text": text, "passed": passed}
