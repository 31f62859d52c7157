"""Options of enhancement for print."""

from __future__ import annotations

from dataclasses import dataclass

from geomosaic.options.declaration import option


@dataclass(frozen=True)
class EnhancePart:
    """`[enhance]`: enhancement of the raster for print; the defaults change nothing."""

    bands: tuple[int, ...] = ()  # of red, green, blue, or one; from 1
    stretch: str = option(
        "none",
        choices=(
            "none",
            "percentile",
            "linear",
            "equalise",
        ),
    )
    low: float = option(2.0, least=0.0, most=100.0)  # percentiles
    high: float = option(98.0, least=0.0, most=100.0)
    limits: tuple[float, float] | None = None  # of 'linear', values
    gamma: float = option(1.0, above=0.0, most=10.0)
    clahe: float = option(0.0, least=0.0, most=100.0)  # clip limit; 0 for none
    sharpen: float = option(0.0, least=0.0, most=10.0)  # amount; 0 for none
    radius: float = option(0.15, above=0.0, most=5.0, needs=("sharpen",))  # of sharpening, mm on paper
    hillshade: float = option(0.0, least=0.0, most=1.0)  # strength; 0 for none
    dem: str = ""  # of the hillshade; that of the contours where empty
    azimuth: float = option(315.0, least=0.0, most=360.0)
    altitude: float = option(45.0, above=0.0, most=90.0)
