"""Options of enhancement for print."""

from __future__ import annotations

from dataclasses import dataclass

from geomosaic.options.toml_tables import a_choice, a_number


@dataclass(frozen=True)
class EnhancePart:
    """`[enhance]`: the picture for print; nothing is changed unless something is asked for."""

    bands: tuple[int, ...] = ()  # of red, green, blue, or one; from 1
    stretch: str = a_choice("none", "none", "percentile", "linear", "equalise")
    low: float = a_number(2.0, least=0.0, most=100.0)  # percentiles
    high: float = a_number(98.0, least=0.0, most=100.0)
    limits: tuple[float, float] | None = None  # of 'linear', values
    gamma: float = a_number(1.0, above=0.0, most=10.0)
    clahe: float = a_number(0.0, least=0.0, most=100.0)  # clip limit; 0 for none
    sharpen: float = a_number(0.0, least=0.0, most=10.0)  # amount; 0 for none
    radius: float = a_number(0.15, above=0.0, most=5.0)  # of sharpening, mm on paper
    hillshade: float = a_number(0.0, least=0.0, most=1.0)  # strength; 0 for none
    dem: str = ""  # of the hillshade; that of the contours where empty
    azimuth: float = a_number(315.0, least=0.0, most=360.0)
    altitude: float = a_number(45.0, above=0.0, most=90.0)
