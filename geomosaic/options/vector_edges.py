"""Options of vector edge matching between neighbouring sheets."""

from __future__ import annotations

from dataclasses import dataclass

from geomosaic.errors import InputError
from geomosaic.options.check import CheckedOptions
from geomosaic.options.declaration import option


@dataclass(frozen=True, kw_only=True)
class VectorEdgeOptions(CheckedOptions, group="input"):
    """What meets at the edges of sheets, and how sheets are bent there."""

    tolerance: float = option(help="Distance of ends that meet at most, map units.", above=0.0, metavar="UNITS")
    same: tuple[str, ...] = option(
        (), "Column that must agree where lines meet; any number of times.", metavar="COLUMN"
    )
    sigma: tuple[float, ...] = option(
        (), "Standard deviation of a sheet, once for each in their order; 0 holds it.", metavar="UNITS",
        shown="all alike",
    )  # fmt: skip
    reach: float | None = option(
        None, "Distance at which the correction of a sheet ends, map units.", above=0.0, metavar="UNITS",
        shown="20 times the tolerance", group="geometry",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(not value >= 0.0 for value in self.sigma):
            raise InputError("a standard deviation is 0 or more", where="`sigma`", hint="0 holds the sheet")
