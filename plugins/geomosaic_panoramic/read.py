"""Inputs that have a default."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from geomosaic.sensor import options as read

TEXT = "see `geomosaic sensors panoramic`"


def word(options: Mapping[str, Any], name: str, words: Sequence[str], where: str, default: str | None = None) -> str:
    """One of some words."""
    return read.choice(read.need({name: default, **options}, name, where, " or ".join(words)), words, name, where)


def number(options: Mapping[str, Any], name: str, where: str, default: float | None = None) -> float:
    """A finite number."""
    return read.number(read.need({name: default, **options}, name, where, TEXT), name, where)


def numbers(
    options: Mapping[str, Any], name: str, count: int, where: str, default: Sequence[float] | None = None
) -> tuple[float, ...]:
    """So many finite numbers."""
    return read.numbers(read.need({name: default, **options}, name, where, TEXT), count, name, where)
