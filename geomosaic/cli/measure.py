"""Numbers with units as values of options."""

from __future__ import annotations

from typing import Any

import click


class Measure(click.types.FloatParamType):
    """A number in `unit`, or with a unit of its own: 6000, 6km, 20000ft.

    Parameters
    ----------
    unit : str
        As in `geomosaic.plan.units`.
    """

    def __init__(self, unit: str) -> None:
        self.unit = unit

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Read it."""
        if isinstance(value, int | float):
            return float(value)
        from geomosaic.errors import InputError
        from geomosaic.plan.units import in_unit

        try:
            return in_unit(str(value), self.unit)
        except InputError as error:
            self.fail(f"{error.what}; {error.mend}", param, ctx)
