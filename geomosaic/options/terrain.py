"""Options of a terrain model made of what a map shows of the ground."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from geomosaic.options.check import SelfContainedOptions
from geomosaic.options.declaration import option
from geomosaic.options.inputs import parse_bounds


@dataclass(frozen=True, kw_only=True)
class DtmOptions(SelfContainedOptions, group="input"):
    """Data of a terrain model, and its grid."""

    contours: Path | None = option(None, "Contours: lines with their heights.", metavar="FILE")
    points: Path | None = option(None, "Spot heights, kept exactly: points, or a table id,x,y,z.", metavar="FILE")
    breaklines: Path | None = option(
        None, "Ridges, valleys, edges of banks, where the slope breaks: lines, with heights or without.", metavar="FILE"
    )
    water: Path | None = option(None, "Lakes: areas with their levels.", metavar="FILE")
    height_field: str | None = option(
        None, "Column that has the heights.", metavar="COLUMN", shown="height, elev, ... or z of the vertices"
    )
    crs: str | None = option(None, "CRS of the files, where they name none.", metavar="CRS")
    heights: str | None = option(
        None, "Vertical datum of the heights, written into the DTM: egm96, an EPSG code, ellipsoidal.", metavar="DATUM"
    )
    resolution: float | None = option(
        None, "Distance of the nodes in map units.", above=0.0, metavar="UNITS", flag="--res",
        shown="what K-2.8 advises for --map-scale", group="geometry",
    )  # fmt: skip
    map_scale: float | None = option(
        None, "Scale of the photo map that the DTM is for: K-2.8 has its grid interval.", unit="1:", metavar="1:N",
        group="geometry",
    )  # fmt: skip
    terrain: str = option(
        "difficult", "Terrain of the table of K-2.8.", choices=("easy", "difficult"), group="geometry",
        needs=("map_scale",),
    )  # fmt: skip
    bounds: tuple[float, float, float, float] | None = option(
        None, "Area in map units.", metavar="LEFT BOTTOM RIGHT TOP", shown="all data", parse=parse_bounds,
        group="geometry",
    )  # fmt: skip
