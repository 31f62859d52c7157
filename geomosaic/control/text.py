"""Lines, fields and numbers of the texts that control comes in."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from geomosaic.control.points import Origin
from geomosaic.errors import InputError
from geomosaic.types import PathLike

LARGEST = 64 << 20
"""Bytes; no list of control points is that long."""

LONGEST = 100_000
"""Characters of a line; Python's csv takes 131072 in a field."""

_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)
_COMMA = re.compile(r"[+-]?(\d+,\d*|,\d+)(e[+-]?\d+)?", re.IGNORECASE)


@dataclass(frozen=True)
class Line:
    """One line with its place; `fields` are its values without quotes and blanks around them."""

    origin: Origin
    fields: tuple[str, ...]


def read_lines(path: PathLike) -> list[tuple[Origin, str]]:
    """Read the lines of a UTF-8 text that are not blank.

    Raises
    ------
    InputError
        The file is missing, too large, no text, or has a line that is too long.
    """
    file = Path(path)
    try:
        if file.stat().st_size > LARGEST:
            raise InputError(
                f"a list of control points larger than {LARGEST >> 20} MB",
                where=str(path),
                mend="is it the right file?",
            )
        text = file.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError("the file does not exist", where=str(path), mend="check the path") from None
    except IsADirectoryError:
        raise InputError("this is a folder", where=str(path), mend="give a file") from None
    except UnicodeDecodeError as error:
        raise InputError(
            f"not UTF-8 text (byte {error.start})", where=str(path), mend="save the table as UTF-8 text"
        ) from None
    except OSError as error:
        raise InputError(f"the file cannot be read: {error.strerror}", where=str(path)) from error
    lines = [(Origin(str(path), i), line) for i, line in enumerate(text.splitlines(), start=1) if line.strip()]
    long = next((origin for origin, line in lines if len(line) > LONGEST), None)
    if long is not None:
        raise InputError(f"a line of more than {LONGEST} characters", where=str(long), mend="is it the right file?")
    return lines


def delimiter_of(header: str) -> str:
    """Return the one among tab, semicolon and comma that the header has most of, else a blank."""
    counts = [(header.count(mark), mark) for mark in ("\t", ";", ",")]
    most = max(counts, key=lambda pair: pair[0])
    return most[1] if most[0] else " "


def split(line: str, delimiter: str) -> tuple[str, ...]:
    """Split a line into fields; quotes hold a field together, and empty fields at the end are left off."""
    if delimiter == " ":
        fields = line.split()
    else:
        fields = [field.strip() for field in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]
    while fields and not fields[-1]:
        fields.pop()
    return tuple(fields)


def has_decimal_commas(fields: Iterable[tuple[Origin, str]]) -> bool:
    """Say whether numbers are written with decimal commas.

    Raises
    ------
    InputError
        Some have a comma and others a point, so that a comma might part thousands.
    """
    comma = point = None
    for origin, text in fields:
        if comma is None and _COMMA.fullmatch(text):
            comma = origin, text
        elif point is None and "." in text and _POINT.fullmatch(text):
            point = origin, text
    if comma and point:
        raise InputError(
            f"'{comma[1]}' has a comma and '{point[1]}' ({point[0].unit} {point[0].number}) a point: "
            "one of them may part thousands",
            where=str(comma[0]),
            mend="write all numbers with decimal points and nothing between thousands",
        )
    return comma is not None


def number(text: str, column: str, origin: Origin, *, commas: bool = False) -> float:
    """Read a finite number.

    Raises
    ------
    InputError
        Names the file, the line and the column, and what kind of slip it looks like.
    """
    written = text.replace(",", ".", 1) if commas else text
    if _POINT.fullmatch(written) and math.isfinite(value := float(written)):
        return value
    if re.search("[°'\"′″]|[NSEW]$", text):
        mend = "write degrees with decimals, west and south negative"
    elif _COMMA.fullmatch(text):
        mend = "write a decimal point"
    elif re.search(r"\d[ ,.'\u00a0]\d{3}\b", text):
        mend = "leave out what parts the thousands"
    else:
        mend = "write a finite number"
    what = f"column '{column}' has '{text}'" if text else f"column '{column}' is empty"
    raise InputError(what, where=str(origin), mend=mend)
