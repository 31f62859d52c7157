"""Matching what tables call an image with the image files, and suggesting what was meant."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePath
from typing import TypeVar

from geomosaic.errors import InputError, did_you_mean

Value = TypeVar("Value")


def stem(name: str) -> str:
    """Name of an image without folders and extension, whichever way the slashes lean.

    Only what looks like an extension is cut: 'IMG_0.5' keeps its '.5'.
    """
    last = PurePath(name.replace("\\", "/")).name
    base, dot, extension = last.rpartition(".")
    return base if dot and base and extension.isalnum() and not extension.isdigit() else last


def file_name(name: str) -> str:
    """Name without folders, to compare by: file systems of Macs part letters from their accents, tables do not."""
    return unicodedata.normalize("NFC", PurePath(name.replace("\\", "/")).name)


def corrections_file(pattern: str, image: str) -> Path:
    """Correction grid of an image: '{image}' in a pattern takes its name, without folder and extension."""
    return Path(pattern.replace("{image}", stem(image)))


def find_by_name(rows: Mapping[str, Value], image: str) -> Value | None:
    """Entry of a table for an image: by its full file name, else with either side's extension left off."""
    last = file_name(image)
    for key, value in rows.items():
        if file_name(key) == last:
            return value
    bare = stem(last)
    for key, value in rows.items():
        if bare in (file_name(key), stem(file_name(key))):
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
