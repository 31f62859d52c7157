"""Make a DTM from contours, spot heights, breaklines and lakes.

Help group: Maps
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.options import file_options, options_of
from geomosaic.cli.output import answer, notes
from geomosaic.errors import counted, listed
from geomosaic.options.terrain import DtmOptions

if TYPE_CHECKING:
    from geomosaic.relief.dtm import DtmResult


@grouped_command()
@options_of(DtmOptions)
@file_options("GeoTIFF to write.")
def command(output: Path, overwrite: bool, as_json: bool, options: dict[str, Any]) -> None:
    """Make a DTM from contours, spot heights, breaklines and lakes.

    The ground is the surface of least bending through the data: hilltops and valley floors within the last contour are
    no flats. Spot heights are kept exactly, and each is left out once to tell the error.

    \b
    Examples:
      geomosaic dtm --contours contours.gpkg --points heights.csv --map-scale 1:10000 -o dtm.tif
      geomosaic dtm --contours contours.gpkg --breaklines ridges.gpkg --water lakes.gpkg --res 5 -o dtm.tif
    """
    from geomosaic.relief.dtm import dtm

    with notes():
        made = dtm(output, overwrite=overwrite, **options)
    answer(made.facts, _text(made), as_json)


def _text(made: DtmResult) -> str:
    from geomosaic.cli.results import size_text

    facts = made.facts
    low, high = made.range
    lines = [
        f"{made.path}: {size_text(made.grid)}, heights from {low:.1f} to {high:.1f} m ({made.heights}), "
        f"{made.nodes} nodes within the outline of the data"
    ]
    if facts["lines"]["rms_m"] is not None:
        lines.append(f"contours and breaklines: met within {made.line_rms:.3f} m RMS, largest {made.line_worst:.3f} m")
    if facts["spot_heights"]["worst_m"] is not None:
        lines.append(f"{counted(len(made.names), 'spot height')}: met within {1000 * made.spot_worst:.2f} mm")
    left = facts["left_out"]
    if left["count"]:
        worst = listed((f"{each['id']} ({each['m']:+.2f} m)" for each in left["worst"]), 5)
        lines.append(
            f"spot heights left out in turn: missed by {left['rms_m']:.2f} m RMS, median {left['median_m']:.2f} m; "
            f"most: {worst}"
        )
    else:
        lines.append("error of the heights: not known, no spot height can be left out")
    if made.lakes:
        lines.append(f"{counted(made.lakes, 'lake')}, level")
    if made.advised is not None:
        lines.append(f"K-2.8 advises nodes every {made.advised[0]:g} to {made.advised[1]:g} m for this map and terrain")
    return "\n".join(lines)
