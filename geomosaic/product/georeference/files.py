"""The control report as files: JSON for programs, HTML for people, GeoPackage for a GIS."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pyproj import CRS

from geomosaic.errors import OutputError
from geomosaic.product.georeference.vectors import write_residuals
from geomosaic.product.report.control import render_control
from geomosaic.raster.output import check_output, partial, remove, sync


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


def write_text(path: Path, text: str, *, overwrite: bool) -> None:
    """Write a text file, whole under its name or not at all.

    Raises
    ------
    OutputExistsError, OutputError
        The name is taken; writing failed.
    """
    check_output(path, overwrite=overwrite)
    try:
        unfinished = partial(path)
        try:
            unfinished.write_text(text, encoding="utf-8")
            sync(unfinished)
            unfinished.replace(path)
        finally:
            remove(unfinished)
    except OSError as error:
        raise OutputError(
            f"writing failed ({error.strerror})",
            where=str(path),
            mend="check the space on the disk and the rights of the folder",
        ) from error
