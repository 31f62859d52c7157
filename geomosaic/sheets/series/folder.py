"""The folder of a series of sheets: its record, its files, and its atlas index."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from pyproj import CRS

from geomosaic.digests import digest_of, sha256
from geomosaic.errors import InputError, OutputExistsError
from geomosaic.raster.output_files import write_text
from geomosaic.raster.vector import Layer, write_layers
from geomosaic.sheets.layout import Layout
from geomosaic.sheets.make import VectorInput, make_sheet
from geomosaic.sheets.series.regular import Scheme, SheetPlace, sheet_place
from geomosaic.sheets.styles.style import Label, Line, Style, Symbol

RECORD = ".sheets.json"
"""By file the key of what it is made from, its checksum (None while it is made; `was` is that of the file it replaces)
and its sheet; checksums of the files that all are made of; those of the index."""
INDEX, INDEX_ENDS = "index", (".gpkg", ".pdf")


def file_name(name: str) -> str:
    """Name of a sheet as that of a file."""
    return re.sub(r"[^\w.-]+", "_", name).strip("_.") or "sheet"


State = Literal["absent", "finished", "older", "foreign"]


def state_of(path: Path, known: Mapping[str, Any] | None, key: str) -> State:
    """What a sheet's file is: none, made of what `key` says, made of something else, or none of ours.

    Files get their names when they are whole: one whose making was noted and that is not the one to be replaced is
    finished, though the run was stopped before it could say so.
    """
    if not path.is_file():
        return "absent"
    if known is None:
        return "foreign"
    found = sha256(path)
    was = known.get("was")
    if found == known["sha256"] or (known["sha256"] is None and found != was):
        return "finished" if known["key"] == key else "older"
    return "older" if found == was else "foreign"


def read_record(folder: Path) -> dict[str, Any]:
    """Read the record of a folder; an empty one where there is none."""
    try:
        found = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        found = {}
    usable = isinstance(found, dict) and isinstance(found.get("sheets"), dict) and isinstance(found.get("files"), dict)
    found = found if usable else {"sheets": {}, "files": {}}
    return {"index": {}, **found}


def write_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Write it, whole or not at all."""
    write_text(folder / RECORD, json.dumps(record, indent=1, sort_keys=True), overwrite=True)


def refuse_one_file_for_two(names: Sequence[str], suffix: str) -> None:
    """Refuse names that make one file, also where the file system takes capitals and small letters for the same."""
    taken = {f"{INDEX}{end}": "the index of the series" for end in INDEX_ENDS}
    for name in names:
        file = (file_name(name) + suffix).casefold()
        if file in taken:
            raise InputError(
                f"sheet '{name}' and {taken[file]} would both be the file {file}", hint="give the sheet another name"
            )
        taken[file] = f"sheet '{name}'"


def refuse_index_of_others(folder: Path, record: Mapping[str, Any]) -> None:
    """Refuse to replace an index that is not of our making; an empty checksum is that of one we were about to write."""
    for end in INDEX_ENDS:
        path = folder / f"{INDEX}{end}"
        known = record["index"].get(path.name)
        if path.exists() and known != "" and (known is None or known != sha256(path)):
            raise OutputExistsError(
                "the file is in the way of the index of the series", where=str(path), hint="rename or remove it"
            )


def earlier_sheets(
    record: Mapping[str, Any], scheme: Scheme, crs: CRS, overlap: float, folder: Path, suffix: str,
    names: Sequence[str],
) -> list[tuple[SheetPlace, Path]]:  # fmt: skip
    """Sheets of the scheme that earlier runs made, for the index."""
    found = []
    for file, known in sorted(record["sheets"].items()):
        path, name = folder / file, known.get("name")
        if name is None or name in names or path.suffix != suffix or not path.is_file():
            continue
        try:
            place = sheet_place(scheme, name, crs, overlap)
        except InputError:  # of another scheme
            continue
        if digest_of(place.ring.tolist()) == known.get("ring"):
            found.append((place, path))
    return found


def write_index(
    raster: Path, scale: float | None, order: Sequence[tuple[SheetPlace, Path]], folder: Path, crs: CRS,
    record: dict[str, Any],
) -> tuple[Path, ...]:  # fmt: skip
    """Write the atlas index: a GeoPackage of neatlines, and a page that shows them over the raster."""
    from shapely import Polygon

    places = [place for place, _ in order]
    columns: dict[str, list[Any]] = {
        "name": [place.name for place in places],
        "file": [path.name for _, path in order],
        "scale": [float(place.scale or scale or 0.0) for place in places],
    }
    columns |= {
        way.lower(): [place.neighbours.get(way, "") for place in places]
        for way in ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
    }
    layer = Layer(crs, "Polygon", [Polygon(place.ring) for place in places], columns)
    record["index"] = dict.fromkeys((f"{INDEX}{end}" for end in INDEX_ENDS), "")
    write_record(folder, record)
    package = write_layers(folder / f"{INDEX}.gpkg", {"sheets": layer}, overwrite=True)
    boxes = [place.bounds for place in places]
    bounds = (min(b[0] for b in boxes), min(b[1] for b in boxes), max(b[2] for b in boxes), max(b[3] for b in boxes))
    style = Style("Sheets", Symbol(line=Line("#c00000", 0.35)), label=Label("name", 7.0, "#7a0000"))
    layout = Layout()
    layout = replace(
        layout,
        sheet=replace(layout.sheet, title="Index of sheets", subtitle=places[0].series, paper="A4", dpi=200),
        map=replace(layout.map, bounds=bounds),
    )
    page = make_sheet(
        raster,
        folder / f"{INDEX}.pdf",
        layout,
        [VectorInput(package, "sheets", style, "Sheets")],
        overwrite=True,
    )
    record["index"] = {path.name: sha256(path) for path in (package, page.path)}
    write_record(folder, record)
    return package, page.path
