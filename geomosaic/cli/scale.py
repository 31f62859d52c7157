"""Scales as values of options."""

from __future__ import annotations

from typing import Any

import click


class Scale(click.types.FloatParamType):
    """Denominator of '1:5000', or the plain number."""

    name = "1:N"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Read it."""
        if isinstance(value, float):
            return value
        head, mark, tail = str(value).rpartition(":")
        try:
            found = float(tail.replace(" ", "").replace("\u202f", ""))
        except ValueError:
            found = 0.0
        if (mark and head.strip() != "1") or not 0 < found < float("inf"):
            self.fail(f"'{value}' is no scale; write 1:5000", param, ctx)
        return found
