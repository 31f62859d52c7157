"""Edits of a control table as text: one row set, added or taken out, all else left as its writer has it."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

from geomosaic.control.parsing import split
from geomosaic.control.points import Origin
from geomosaic.control.table import WORDS
from geomosaic.errors import InputError
from geomosaic.whole_files import delimiter_of

# Header of a table that is begun.
BEGUN = "id,x,y,z,image,col,row,sigma_px,role,enabled"
# Columns of QGIS's georeferencer by what they mean here; its rows count upwards.
QGIS = {
    "mapx": "x",
    "mapy": "y",
    "sourcex": "col",
    "sourcey": "row",
    "pixelx": "col",
    "pixely": "row",
    "enable": "enabled",
}
_WORDS = {other: word for word, others in WORDS.items() for other in (word, *others)}


@dataclass(frozen=True)
class TableRow:
    """Row of a control table.

    Attributes
    ----------
    line : int
        Counted from 1.
    values : mapping of str to str
        Fields by the words of `control.table.WORDS`, as text; rows of the image count downwards.
    """

    line: int
    values: Mapping[str, str]


@dataclass(frozen=True)
class ControlText:
    """Text of a control table: geomosaic's own or a QGIS `.points` file.

    Attributes
    ----------
    lines : tuple of str
        Without their ends.
    ending : str
        Of a line.
    header : int
        Index of the line that names the columns.
    """

    lines: tuple[str, ...]
    ending: str
    header: int

    @classmethod
    def of(cls, text: str | None) -> Self:
        """Table of a text; a new one where there is none.

        Raises
        ------
        InputError
            There is text, and no header in it.
        """
        if not text or not text.strip():
            return cls((BEGUN,), "\n", 0)
        lines = tuple(text.splitlines())
        at = next((i for i, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), None)
        if at is None:
            return cls((*lines, BEGUN), "\n", len(lines))
        found = cls(lines, "\r\n" if "\r\n" in text else "\n", at)
        if not {"x", "y", "col", "row"} <= set(found.columns):
            raise InputError(
                f"line {at + 1} names no columns x, y, col, row: {lines[at][:80]}", hint=f"begin the table with {BEGUN}"
            )
        return found

    @property
    def text(self) -> str:
        """The whole text."""
        return self.ending.join(self.lines) + self.ending

    def origins(self, path: str) -> list[tuple[Origin, str]]:
        """Lines with their places in a file, as readers take them."""
        return [(Origin(path, number), line) for number, line in enumerate(self.lines, start=1)]

    @property
    def qgis(self) -> bool:
        """Whether it is a `.points` file."""
        return "mapx" in (field.casefold() for field in self._fields(self.header))

    @property
    def columns(self) -> tuple[str, ...]:
        """Words of the columns; names that mean nothing here stay as they are."""
        names = [field.casefold() for field in self._fields(self.header)]
        known = QGIS if self.qgis else _WORDS
        return tuple(known.get(name, name) for name in names)

    @property
    def rows(self) -> tuple[TableRow, ...]:
        """Rows in their order."""
        found: list[TableRow] = []
        columns, qgis = self.columns, self.qgis
        for index, line in enumerate(self.lines):
            if index <= self.header or not line.strip() or line.lstrip().startswith("#"):
                continue
            fields = self._fields(index)
            values = dict(zip(columns, (*fields, *[""] * len(columns)), strict=False))
            if qgis:
                values["id"] = str(len(found))
                values["row"] = _negative(values["row"])
            found.append(TableRow(index + 1, values))
        return tuple(found)

    def with_row(self, line: int | None, values: Mapping[str, str]) -> ControlText:
        """Table with values set in a row, or with one more row.

        Parameters
        ----------
        line : int or None
            Counted from 1; None adds a row at the end.
        values : mapping of str to str
            By word; others of the row stay.

        Raises
        ------
        InputError
            The table has no column for one of them.
        """
        columns = self.columns
        given = {name: value for name, value in values.items() if not (self.qgis and name in ("id", "image"))}
        missing = [name for name, value in given.items() if name not in columns and value != _DEFAULT.get(name, "")]
        if missing:
            return self._widened(missing).with_row(line, values)
        if self.qgis and "row" in given:
            given["row"] = _negative(given["row"])
        fields = (
            [""] * len(columns) if line is None else [*self._fields(line - 1), *[""] * len(columns)][: len(columns)]
        )
        if line is None and self.qgis:
            fields = ["1" if name == "enabled" else "0" for name in columns]
        for index, name in enumerate(columns):
            fields[index] = given.get(name, fields[index])
        written = _joined(fields, self._delimiter)
        if line is None:
            return replace(self, lines=(*self.lines, written))
        return replace(self, lines=(*self.lines[: line - 1], written, *self.lines[line:]))

    def without_row(self, line: int) -> ControlText:
        """Table without a row; `line` counts from 1."""
        return replace(self, lines=(*self.lines[: line - 1], *self.lines[line:]))

    def _widened(self, names: Sequence[str]) -> ControlText:
        if self.qgis:
            what = f"a .points file of QGIS has no column for {', '.join(names)}"
            raise InputError(what, hint=f"keep the points in a table with the header {BEGUN}")
        header = _joined([*self._fields(self.header), *names], self._delimiter)
        return replace(self, lines=(*self.lines[: self.header], header, *self.lines[self.header + 1 :]))

    @property
    def _delimiter(self) -> str:
        return delimiter_of(self.lines[self.header])

    def _fields(self, index: int) -> tuple[str, ...]:
        return split(self.lines[index], delimiter_of(self.lines[self.header]))


# Values that need no column.
_DEFAULT = {"enabled": "1", "role": "control"}


def _negative(text: str) -> str:
    """Number as text with the other sign."""
    return text[1:] if text.startswith("-") else text if not text or not float(text) else f"-{text}"


def _joined(fields: Sequence[str], delimiter: str) -> str:
    line = io.StringIO()
    csv.writer(line, delimiter=delimiter, lineterminator="").writerow(fields)
    return line.getvalue()
