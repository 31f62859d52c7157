"""The control report as files: JSON for programs, HTML for people, GeoPackage for a GIS."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pyproj import CRS

from geomosaic.product.georeference.vectors import write_residuals
from geomosaic.product.report.control import render_control
from geomosaic.raster.unfinished import write_text


def write_files(
    facts: Mapping[str, Any], image: Path, source: CRS, crs: CRS, files: Mapping[str, Path], *, overwrite: bool
) -> None:
    """Write the three files of `files`, by ending.

    Parameters
    ----------
    facts : mapping
        See `report.report_facts`.
    image : Path
        For the picture.
    source, crs : CRS
        Of the points in the facts, and of the vectors.
    files : mapping of str to Path
        '.json', '.html' and '.gpkg'.
    overwrite : bool

    Raises
    ------
    OutputError, OutputExistsError
    """
    text = json.dumps(facts, indent=1, ensure_ascii=False, allow_nan=False)
    write_text(files[".json"], text + "\n", overwrite=overwrite)
    write_text(files[".html"], render_control(facts, image), overwrite=overwrite)
    write_residuals(files[".gpkg"], facts["points"], source, crs, overwrite=overwrite)
