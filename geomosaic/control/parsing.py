"""Parsing of control point files: lines, fields, numbers, and the result of every reader."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic import whole_files
from geomosaic.control.points import ControlPoints, Origin
from geomosaic.errors import InputError, did_you_mean
from geomosaic.geo.crs import parse_crs
from geomosaic.image_names import file_name, stem
from geomosaic.types import PathLike


@dataclass(frozen=True)
class Reading:
    """Control points read from a file, with its format and notes.

    Attributes
    ----------
    control : ControlPoints
    format : str
        'csv', 'qgis', 'odm', 'raster' or 'world'.
    notes : tuple of str
        Decisions made while reading, for the report.
    """

    control: ControlPoints
    format: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Measured:
    """Point as read from a file; z is NaN where the file has none."""

    name: str
    colrow: tuple[float, float]
    xyz: tuple[float, float, float]
    origin: Origin
    sigma: float = 1.0
    role: str = "control"
    enabled: bool = True


def control_of(points: Sequence[Measured], crs: CRS, path: str) -> ControlPoints:
    """Control points from the points of a file; heights are dropped where no point has one.

    Parameters
    ----------
    points : sequence of Measured
    crs : CRS
    path : str
        Named by errors.

    Raises
    ------
    InputError
        There are no points, or one of them is wrong.
    """
    if not points:
        raise InputError("there are no points in the file", where=path, hint="is it the right file?")
    check_count(len(points), path)
    ground = np.array([point.xyz for point in points])
    if np.isnan(ground[:, 2]).all():
        ground = ground[:, :2]
    return ControlPoints(
        tuple(point.name for point in points),
        np.array([point.colrow for point in points]),
        ground,
        crs,
        np.array([point.sigma for point in points]),
        tuple(point.role for point in points),
        np.array([point.enabled for point in points]),
        tuple(point.origin for point in points),
    )


def check_count(count: int, path: str) -> None:
    """Check of the number of points of one image.

    Parameters
    ----------
    count : int
    path : str
        File, for the message.

    Raises
    ------
    InputError
        More than `MOST`.
    """
    if count > MOST:
        raise InputError(
            f"the file has {count:,} points of the image, and {MOST:,} are taken",
            where=path,
            hint="is it the right file? control of an image is tens of points; of tie points, take a sample",
        )


def ground_crs(declared: str | CRS | None, given: str | CRS | None, where: str) -> CRS:
    """CRS of the ground coordinates, from the file or the user.

    Parameters
    ----------
    declared : str, CRS or None
        By the file.
    given : str, CRS or None
        By the user.
    where : str
        Named by errors.

    Raises
    ------
    InputError
        Neither names it, or they differ.
    """
    of_file = parse_crs(declared, where) if declared else None
    supplied = parse_crs(given, "`crs`") if given else None
    found = of_file or supplied
    if found is None:
        raise InputError(
            "the file does not say which CRS its ground coordinates are in",
            where=where,
            hint="give it with `crs`, such as EPSG:32633",
        )
    if of_file is not None and supplied is not None and not of_file.equals(supplied, ignore_axis_order=True):
        raise InputError(
            f"the file says its ground coordinates are in '{of_file.name}', and '{supplied.name}' is given",
            where=where,
            hint="give none, or correct the file; control is transformed to the CRS of the output by itself",
        )
    return found


def choose_image(names: Sequence[str], image: str | None, path: str) -> set[str]:
    """Names in the file that mean `image`; that of the only image where none is given.

    Names match with their whole file name, else without extension; folders do not count.

    Parameters
    ----------
    names : sequence of str
        Of images, as the file has them.
    image : str or None
        Name or path.
    path : str
        Named by errors.

    Raises
    ------
    InputError
        Several images and none chosen, or one chosen that the file does not have.
    """
    known = sorted(set(names))
    shown = ", ".join(known[:8]) + (" ..." if len(known) > 8 else "")
    if image is None:
        if (images := len({_last(name) for name in known})) > 1:
            raise InputError(f"the file has points of {images} images: {shown}", where=path, hint="name the image")
        return set(known)
    found = {name for name in known if _last(name) == _last(image)}
    found = found or {name for name in known if stem(_last(name)) == stem(_last(image))}
    if not found:
        hint = did_you_mean(_last(image), [_last(name) for name in known])
        raise InputError(
            f"no point is measured in '{_last(image)}'", where=path, hint=f"{hint} the file has {shown}".strip()
        )
    if len({_last(name) for name in found}) > 1:
        raise InputError(f"'{image}' may mean {' or '.join(sorted(found))}", where=path, hint="give the extension too")
    return found


def _last(name: str) -> str:
    return file_name(name).casefold()


# Points of one image; nobody measures that many, and every finding on them is looked for in seconds.
MOST = 100_000

_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)
_COMMA = re.compile(r"[+-]?(\d+,\d*|,\d+)(e[+-]?\d+)?", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Line:
    """Line of a text file; `fields` are its values without quotes and surrounding blanks."""

    origin: Origin
    fields: tuple[str, ...]


def read_lines(path: PathLike) -> list[tuple[Origin, str]]:
    """Lines of a UTF-8 text that are not blank.

    Parameters
    ----------
    path : path

    Raises
    ------
    InputError
        The file is missing, too large, no text, or has a line that is too long or too many lines.
    """
    lines = whole_files.read_lines(path, "list of control points")
    return [(Origin(str(path), number), line) for number, line in lines]


def split(line: str, delimiter: str) -> tuple[str, ...]:
    """Fields of a line; quotes hold a field together, and empty fields at the end are dropped.

    Parameters
    ----------
    line : str
    delimiter : str
    """
    if delimiter == " ":
        fields = line.split()
    else:
        fields = [field.strip() for field in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]
    while fields and not fields[-1]:
        fields.pop()
    return tuple(fields)


def has_decimal_commas(fields: Iterable[tuple[Origin, str]]) -> bool:
    """Whether numbers are written with decimal commas.

    Parameters
    ----------
    fields : iterable of (Origin, str)
        Texts of numbers.

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
            "one of them may separate thousands",
            where=str(comma[0]),
            hint="write all numbers with decimal points and nothing between thousands",
        )
    return comma is not None


def number(text: str, column: str, origin: Origin, *, commas: bool = False) -> float:
    """Finite number from text.

    Parameters
    ----------
    text : str
    column : str
        Named by errors.
    origin : Origin
        Named by errors.
    commas : bool
        Decimal commas are written.

    Raises
    ------
    InputError
        Names the file, the line and the column, and what kind of slip it looks like.
    """
    written = text.replace(",", ".", 1) if commas else text
    if _POINT.fullmatch(written) and math.isfinite(value := float(written)):
        return value
    if re.search("[°'\"′″]|[NSEW]$", text):
        hint = "write degrees with decimals, west and south negative"
    elif _COMMA.fullmatch(text):
        hint = "write a decimal point"
    elif re.search(r"\d[ ,.'\u00a0]\d{3}\b", text):
        hint = "leave out the separators of thousands"
    else:
        hint = "write a finite number"
    what = f"column '{column}' has '{text}'" if text else f"column '{column}' is empty"
    raise InputError(what, where=str(origin), hint=hint)
