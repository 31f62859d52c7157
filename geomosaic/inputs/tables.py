"""Text tables: a header, one delimiter, errors with file and line; measured fiducial marks."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from typing import Any

import numpy as np

from geomosaic import whole_files
from geomosaic.control.points import GROUND_NAMES
from geomosaic.errors import InputError, counted
from geomosaic.image_names import find_by_name, missing_row
from geomosaic.types import FloatArray, IntArray, PathLike
from geomosaic.whole_files import LARGEST_TEXT, LARGEST_TIES, delimiter_of, read_lines

_OTHER_NAMES = {
    "image": ("filename", "file", "photo", "label", "imagename", "image_name"),
    **GROUND_NAMES,
    "col": ("column",),
    "row": ("line",),
}
# Other names of a column that can mean nothing else.
_ALIASES: Mapping[str, str] = {other: name for name, others in _OTHER_NAMES.items() for other in others}


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """One line of a table.

    Attributes
    ----------
    path : str
    line : int
        Line number, from 1.
    values : mapping of str to str
        Texts by column.
    """

    path: str
    line: int
    values: Mapping[str, str]

    @property
    def where(self) -> str:
        """File and line, for errors."""
        return f"{self.path}, line {self.line}"

    def text(self, column: str) -> str:
        """Text of a column, which must not be empty."""
        value = self.values[column].strip()
        if not value:
            raise InputError(f"column '{column}' is empty", where=self.where, hint="fill it in, or leave the line out")
        return value

    def number(self, column: str, default: float | None = None) -> float:
        """Finite number with a decimal point; an empty or missing one is the default, where there is one."""
        value = self.values.get(column, "").strip()
        if not value and default is not None:
            return default
        try:
            number = float(value)
        except ValueError:
            hint = "write decimal points instead of commas" if _is_decimal_comma(value) else "write a number"
            raise InputError(f"column '{column}' has '{value}'", where=self.where, hint=hint) from None
        if not math.isfinite(number):
            raise InputError(f"column '{column}' has '{value}'", where=self.where, hint="write a finite number")
        return number


@dataclass(frozen=True, eq=False)
class Table:
    """Table of a text file: a header and its rows.

    Attributes
    ----------
    path : str
        File, for messages.
    columns : tuple of str
        Names in the header.
    rows : tuple of Row
    """

    path: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def require(self, *columns: str, what: str) -> None:
        """Check that columns are there; the error names those that are."""
        missing = [column for column in columns if column not in self.columns]
        if missing:
            raise InputError(
                f"{what} need the column{'s' * (len(missing) > 1)} {', '.join(missing)}; "
                f"the header has {', '.join(self.columns)}",
                where=f"{self.path}, line 1",
                hint=f"the header should read: {','.join(columns)}",
            )


def read_table(path: PathLike, what: str, example: str, columns_without_header: Sequence[str] = ()) -> Table:
    """Table of a text file.

    The first line that is neither blank nor a comment (#) is the header; a header may itself start with #. The
    delimiter is the most frequent of tab, semicolon and comma in the header, else blanks. Values may be quoted.

    Parameters
    ----------
    path : path-like
    what : str
        Kind of table for errors, such as 'orientation table'.
    example : str
        Header for errors.
    columns_without_header : sequence of str
        Columns of a format that has no header.

    Raises
    ------
    InputError
        No header, a doubled column, or a line with more or fewer values than the header.
    """
    lines, columns, delimiter = _headed(path, what, example, columns_without_header)
    rows = [_row(str(path), number, line, delimiter, columns) for number, line in lines]
    return Table(str(path), tuple(columns), tuple(rows))


def _headed(
    path: PathLike, what: str, example: str, columns_without_header: Sequence[str] = (), ties: bool = False
) -> tuple[list[tuple[int, str]], list[str], str]:
    """Lines of a table below its header with their numbers, names of the columns and delimiter."""
    limits = (LARGEST_TIES, whole_files.MOST_TIES) if ties else (LARGEST_TEXT, None)
    lines = read_lines(path, what, *limits)
    header_at = next((i for i, (_, line) in enumerate(lines) if not line.lstrip().startswith("#")), None)
    if lines and _names(lines[0][1].lstrip().lstrip("#"), f"{path}, line {lines[0][0]}")[:1] == ["image"]:
        header_at = 0
    if header_at is None:
        raise InputError(f"the {what} is empty", where=str(path), hint=f"its first line should read: {example}")
    number, text = lines[header_at]
    text = text.lstrip().lstrip("#")
    columns = _names(text, f"{path}, line {number}")
    if len(columns_without_header) == len(columns) and any(map(_is_number, columns)):
        columns, header_at = list(columns_without_header), header_at - 1
    if any(_is_number(column) for column in columns):
        raise InputError(
            f"the {what} has no header: its first line holds numbers",
            where=f"{path}, line {number}",
            hint=f"add a first line that names the columns, such as: {example}",
        )
    doubled = sorted(column for column, count in Counter(columns).items() if count > 1)
    if doubled:
        raise InputError(
            f"the header names column '{doubled[0]}' twice", where=f"{path}, line {number}", hint="rename one of them"
        )
    below = [(number, line) for number, line in lines[header_at + 1 :] if not line.lstrip().startswith("#")]
    if not below:
        raise InputError(f"the {what} has a header but no rows", where=str(path), hint="add a line for each row")
    return below, columns, delimiter_of(text)


@dataclass(frozen=True, eq=False)
class Origins(Sequence[str]):
    """File and line of each row of a table, for messages: words only when they are asked for."""

    path: str
    lines: IntArray

    def __len__(self) -> int:
        return len(self.lines)

    def __getitem__(self, row: Any) -> Any:
        return f"{self.path}, line {self.lines[row]}"


def read_columns(
    path: PathLike, what: str, example: str, texts: Sequence[str], numbers: Sequence[str], blank: Sequence[str]
) -> tuple[list[list[str]], FloatArray, Origins] | None:
    """Columns of a long table without quotes, read at once.

    Parameters
    ----------
    path, what, example
        As for `read_table`; the table may be longer.
    texts, numbers : sequence of str
        Columns, none of them empty.
    blank : sequence of str
        Columns of numbers that may be missing or empty; they follow the others.

    Returns
    -------
    texts : list of list of str
    numbers : array (N, columns)
        NaN where empty.
    origins : Origins
    None
        The table has quotes, blanks as delimiters, or a mistake that `read_table` will name.
    """
    import pandas

    lines, columns, delimiter = _headed(path, what, example, ties=True)
    wanted, shown = [*texts, *numbers], [name for name in blank if name in columns]
    body = "\n".join(line for _, line in lines)
    if delimiter == " " or not set(wanted) <= set(columns) or {"'", '"'} & set(body):
        return None
    if body.count(delimiter) != (len(columns) - 1) * len(lines):
        return None
    try:
        found = pandas.read_csv(
            StringIO(body), sep=delimiter, header=None, names=columns, usecols=[*wanted, *shown], dtype=str,
            keep_default_na=False, skip_blank_lines=False, quoting=csv.QUOTE_NONE,
        )  # fmt: skip
        fields = {name: [value.strip() for value in found[name].tolist()] for name in (*wanted, *shown)}
        values = np.array([fields[name] for name in numbers], dtype=np.float64)
        known = np.array([[value or "0" for value in fields[name]] for name in shown], dtype=np.float64)
    except ValueError:
        return None
    if not (np.isfinite(values).all() and np.isfinite(known).all()):
        return None
    last = np.full((len(blank), len(lines)), np.nan)
    for name, given in zip(shown, known, strict=True):
        last[blank.index(name)] = np.where([value == "" for value in fields[name]], np.nan, given)
    names = [fields[name] for name in texts]
    if not all(map(all, names)):
        return None
    return names, np.column_stack([*values, *last]), Origins(str(path), np.array([number for number, _ in lines]))


def _row(path: str, number: int, line: str, delimiter: str, columns: list[str]) -> Row:
    where = f"{path}, line {number}"
    values = _split(line, delimiter, where)
    # Spreadsheets end lines with empty fields.
    while len(values) > len(columns) and not values[-1].strip():
        values.pop()
    if len(values) != len(columns):
        comma = delimiter == "," and len(values) > len(columns)
        raise InputError(
            f"{counted(len(values), 'value')} for {counted(len(columns), 'column')}",
            where=where,
            hint="if these are decimal commas, write decimal points"
            if comma
            else "every line needs one value per column",
        )
    return Row(path, number, dict(zip(columns, values, strict=True)))


def _names(header: str, where: str) -> list[str]:
    names = [name.strip().lower() for name in _split(header, delimiter_of(header), where)]
    while names and not names[-1]:
        names.pop()
    return [_ALIASES.get(name, name) for name in names]


def _split(line: str, delimiter: str, where: str) -> list[str]:
    if delimiter == " " and not {"'", '"'} & set(line):
        return line.split()
    if delimiter == " ":
        import shlex

        lexer = shlex.shlex(line, posix=True)
        # No escape character: backslashes part the folders of Windows paths.
        lexer.whitespace_split, lexer.commenters, lexer.escape = True, "", ""
        try:
            return list(lexer)
        except ValueError:
            raise InputError("a quote is opened and not closed", where=where, hint="close it") from None
    fields = fields_of(line, delimiter, where)
    return [_unquoted(field.strip()) for field in fields]


def fields_of(line: str, delimiter: str, where: str) -> list[str]:
    """Fields of a line of comma-separated values; quotes hold a field together.

    Parameters
    ----------
    line : str
    delimiter : str
    where : str

    Raises
    ------
    InputError
        A field is longer than any value.
    """
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error as error:
        raise InputError(
            f"the line cannot be split into columns ({error})",
            where=where,
            hint="is it the right file? close quotes that are open",
        ) from None


def _unquoted(field: str) -> str:
    return field[1:-1] if len(field) > 1 and field[0] == field[-1] == "'" else field


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_decimal_comma(text: str) -> bool:
    return text.count(",") == 1 and _is_number(text.replace(",", "."))


COLUMNS = ("image", "id", "col", "row")


def read_fiducials(path: PathLike, images: Sequence[str]) -> dict[str, dict[str, list[float]]]:
    """Fiducial marks of each image.

    Parameters
    ----------
    path : path-like
        Text with the columns image (not needed for one image), id, col, row. Image coordinates in pixels,
        corner-based: (0.5, 0.5) is the centre of the upper-left pixel.
    images : sequence of str
        Names of the images; each needs its marks, and the marks of others are left out.

    Returns
    -------
    dict
        [col, row] by mark, by image.

    Raises
    ------
    InputError
        Names file and line.
    """
    table = read_table(path, "table of fiducials", ",".join(COLUMNS))
    alone = "image" not in table.columns and len(images) == 1
    table.require(*(COLUMNS[1:] if alone else COLUMNS), what="fiducials")
    rows: dict[str, dict[str, list[float]]] = {}
    for row in table:
        marks = rows.setdefault(images[0] if alone else row.text("image"), {})
        mark = row.text("id")
        if mark in marks:
            raise InputError(f"fiducial '{mark}' is measured twice", where=row.where, hint="leave one of them out")
        marks[mark] = [row.number("col"), row.number("row")]
    found = {}
    for image in images:
        measured = find_by_name(rows, image)
        if measured is None:
            raise missing_row(str(path), image, rows)
        found[image] = measured
    return found
