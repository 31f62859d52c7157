"""Values of flags: read, checked, with an example where they are wrong.

Callbacks of click take (context, parameter, text or texts), give the value or None, and raise `click.BadParameter`.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from geomosaic.errors import InputError
from geomosaic.limits import Limits
from geomosaic.options.check import NAMES, check_limits
from geomosaic.options.declaration import Option

if TYPE_CHECKING:
    _Choice = click.Choice[str]
else:  # not generic before click 8.3
    _Choice = click.Choice

ANY = Limits()


class FilePath(click.Path):
    """Path whose name can be written down: GDAL, PROJ and every file that names it take UTF-8."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Path of a text; names with bytes that are no text, which Python carries as lone surrogates, are refused."""
        try:
            str(value).encode()
        except UnicodeEncodeError:
            shown = str(value).encode(errors="backslashreplace").decode()
            self.fail(f"the name '{shown}' has bytes that are not UTF-8; rename the file or folder", param, ctx)
        given = str(value)
        if "://" in given or given.startswith("/vsi"):
            from geomosaic.stores.path import given_path

            return given_path(given)
        return super().convert(value, param, ctx)


def pairs(ctx: click.Context, param: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """Callback of click for NAME=VALUE, given any number of times."""
    out = {}
    for value in values:
        name, mark, text = value.partition("=")
        if not mark or not name.strip():
            raise click.BadParameter(f"'{value}' is not NAME=VALUE")
        out[name.strip()] = text.strip()
    return out


def json_pairs(ctx: click.Context, param: click.Parameter, values: tuple[str, ...]) -> dict[str, Any]:
    """Callback of click for NAME=VALUE; a value is a JSON number, list or table where it can be, else a text.

    Numbers with commas between them are a list too.
    """
    return {name: _json_value(text) for name, text in pairs(ctx, param, values).items()}


def _json_value(text: str) -> Any:
    for written in (text, f"[{text}]") if "," in text else (text,):
        try:
            return json.loads(written)
        except ValueError:
            continue
    return text


def band_numbers(ctx: click.Context, param: click.Parameter, values: tuple[str, ...]) -> tuple[int, ...] | None:
    """Callback of click for band numbers, separated by commas or given any number of times."""
    words = [word.strip() for text in values for word in text.split(",")]
    if not all(word.isascii() and word.isdigit() and int(word) > 0 for word in words):
        raise click.BadParameter(f"'{','.join(values)}' are not band numbers; write 1,2,3, counted from 1")
    return tuple(map(int, words)) or None


def map_crs(ctx: click.Context, param: click.Parameter, value: str | None) -> str | None:
    """Callback of click that checks that a map can be drawn in a CRS; it stays text."""
    if value is None:
        return None
    from geomosaic.geo.crs import parse_map

    try:
        parse_map(value)
    except InputError as error:
        what = error.what.partition(" (Invalid projection")[0]
        raise click.BadParameter(
            f"{what}; write an EPSG code such as EPSG:32633, a PROJ string, WKT or the path of a .prj file"
        ) from None
    return value


class Number(click.types.FloatParamType):
    """Type of click for a number within limits, refused in the words of the library.

    Parameters
    ----------
    kind : type
        float or int.
    limits : Limits
    """

    name = "number"

    def __init__(self, kind: type[float | int] = float, limits: Limits = ANY) -> None:
        self.kind, self.limits = kind, limits

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Number of a text."""
        try:
            found = self.kind(value)
        except (ValueError, OverflowError):
            name = NAMES[self.kind]
            self.fail(f"'{value}' is not {name}; give {name} {self.limits}".rstrip(), param, ctx)
        try:
            self.limits.check(found)
        except InputError as error:
            self.fail(f"{error.what}; {error.hint}", param, ctx)
        return found


class Choice(_Choice):
    """Type of click for one of several words, refused in the words of the library."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Word of a text."""
        try:
            check_limits(value, Option(choices=tuple(self.choices)), "")
        except InputError as error:
            self.fail(f"{error.what}; {error.hint}", param, ctx)
        return str(value)


class Scale(click.types.FloatParamType):
    """Type of click for scales: the denominator of '1:5000', or the plain number."""

    name = "1:N"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Denominator of a text."""
        from geomosaic.options.sheet import parse_scale

        try:
            return float(value) if isinstance(value, int | float) else parse_scale(value)
        except InputError as error:
            self.fail(f"{error.what}; {error.hint}", param, ctx)


class Measure(click.types.FloatParamType):
    """Type of click for a number in `unit`, or with a unit of its own: 6000, 6km, 20000ft.

    Parameters
    ----------
    unit : str
        As in `geomosaic.planning.relations`.
    """

    def __init__(self, unit: str) -> None:
        self.unit = unit

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Number of a text, in `unit`."""
        if isinstance(value, int | float):
            return float(value)
        from geomosaic.planning.relations import in_unit

        try:
            return in_unit(str(value), self.unit)
        except InputError as error:
            self.fail(f"{error.what}; {error.hint}", param, ctx)
