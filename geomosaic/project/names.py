"""Matching what tables call an image with the image files, and suggesting what was meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from pathlib import PurePath
from typing import TypeVar

from geomosaic.errors import InputError

Value = TypeVar("Value")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """'did you mean ...?' with the closest known name; empty where none is close."""
    names = list(known)
    close = difflib.get_close_matches(name, names, 1, 0.6)
    if not close:
        folded = {known_name.casefold(): known_name for known_name in names}
        close = [folded[match] for match in difflib.get_close_matches(name.casefold(), folded, 1, 0.6)]
    return f"did you mean '{close[0]}'?" if close else ""


def stem(name: str) -> str:
    """Name of an image without folders and extension, whichever way the slashes lean.

    Only what looks like an extension is cut: 'IMG_0.5' keeps its '.5'.
    """
    last = PurePath(name.replace("\\", "/")).name
    base, dot, extension = last.rpartition(".")
    return base if dot and base and extension.isalnum() and not extension.isdigit() else last


def find_by_name(rows: Mapping[str, Value], image: str) -> Value | None:
    """Entry of a table for an image: by its full file name, else with either side's extension left off."""
    last = PurePath(image.replace("\\", "/")).name
    for key, value in rows.items():
        if PurePath(key.replace("\\", "/")).name == last:
            return value
    bare = stem(last)
    for key, value in rows.items():
        if key == bare or stem(key) == bare:
            return value
    return None


def missing_row(path: str, image: str, known: Iterable[str]) -> InputError:
    """Say that a table has no row for an image."""
    hint = did_you_mean(stem(image), known)
    return InputError(
        f"the table has no row for {PurePath(image).name}",
        where=path,
        mend=f"{hint} Add the row, or leave the image out" if hint else "add the row, or leave the image out",
    )
