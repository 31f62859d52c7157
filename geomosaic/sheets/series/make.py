"""All sheets of a series over a raster: in parallel, resumable by a record in the folder, with an atlas index."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely
from pyproj import CRS

import geomosaic
from geomosaic.digests import digest_of, sha256
from geomosaic.errors import InputError, OutputExistsError, collected_warnings, warn
from geomosaic.execution.units import map_units
from geomosaic.geo.crs import parse_crs
from geomosaic.geo.grid import Bounds
from geomosaic.options.render import RunningOptions
from geomosaic.options.sheet import SeriesOptions, scale_text
from geomosaic.raster.files import Hashes, write_text
from geomosaic.raster.pictures import raster_grid
from geomosaic.raster.source import Source
from geomosaic.raster.vector import Layer, write_layers
from geomosaic.sheets.layout import Layout, MapPart, SheetPart
from geomosaic.sheets.make import SheetInputs, make_sheet, series_layout, warn_of_small_map
from geomosaic.sheets.page import lay_out
from geomosaic.sheets.series.regular import Scheme, SheetPlace, sheet_place, sheets_on
from geomosaic.sheets.style import Label, Line, Style, Symbol
from geomosaic.sheets.vector_layers import VectorInput
from geomosaic.types import Progress

# By file the key of what it is made from, its checksum (None while it is made; `was` is that of the file it replaces)
# and its sheet; checksums of the files that all are made of; those of the index.
_RECORD = ".sheets.json"
INDEX, _INDEX_ENDS = "index", (".gpkg", ".pdf")


def _file_name(name: str) -> str:
    """Name of a sheet as that of a file."""
    return re.sub(r"[^\w.-]+", "_", name).strip("_.") or "sheet"


State = Literal["absent", "finished", "older", "foreign"]


def _state_of(path: Path, known: Mapping[str, Any] | None, key: str) -> State:
    """State of a sheet's file: absent, made from what `key` stands for, made from something else, or foreign."""
    if not path.is_file():
        return "absent"
    if known is None:
        return "foreign"
    # Files get their names when they are whole: one whose making was noted and that is not the one to be replaced is
    # finished, though the run was stopped before it could write its checksum.
    found = sha256(path)
    was = known.get("was")
    if found == known["sha256"] or (known["sha256"] is None and found != was):
        return "finished" if known["key"] == key else "older"
    return "older" if found == was else "foreign"


def _read_record(folder: Path) -> dict[str, Any]:
    """Read the record of a folder; an empty one where there is none."""
    try:
        found = json.loads((folder / _RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        found = {}
    usable = isinstance(found, dict) and isinstance(found.get("sheets"), dict) and isinstance(found.get("files"), dict)
    found = found if usable else {"sheets": {}, "files": {}}
    return {"index": {}, **found}


def _write_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Write it, whole or not at all."""
    write_text(folder / _RECORD, json.dumps(record, indent=1, sort_keys=True), overwrite=True)


def _refuse_one_file_for_two(names: Sequence[str], suffix: str) -> None:
    """Refuse names that make one file, also where the file system takes capitals and small letters for the same."""
    taken = {f"{INDEX}{end}": "the index of the series" for end in _INDEX_ENDS}
    for name in names:
        file = (_file_name(name) + suffix).casefold()
        if file in taken:
            raise InputError(
                f"sheet '{name}' and {taken[file]} would both be the file {file}", hint="give the sheet another name"
            )
        taken[file] = f"sheet '{name}'"


def _refuse_index_of_others(folder: Path, record: Mapping[str, Any]) -> None:
    """Refuse to replace an index that is not of our making; an empty checksum is that of one we were about to write."""
    for end in _INDEX_ENDS:
        path = folder / f"{INDEX}{end}"
        known = record["index"].get(path.name)
        if path.exists() and known != "" and (known is None or known != sha256(path)):
            raise OutputExistsError(
                "the file is in the way of the index of the series", where=str(path), hint="rename or remove it"
            )


def _earlier_sheets(
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


def _write_index(
    raster: Path, layout: Layout, order: Sequence[tuple[SheetPlace, Path]], folder: Path, crs: CRS,
    record: dict[str, Any],
) -> tuple[Path, ...]:  # fmt: skip
    """Write the atlas index: a GeoPackage of neatlines, and a page that shows them over the raster."""
    places = [place for place, _ in order]
    columns: dict[str, list[Any]] = {
        "name": [place.name for place in places],
        "file": [path.name for _, path in order],
        "scale": [lay_out(series_layout(layout, place), crs, place.bounds).scale for place in places],
    }
    columns |= {
        way.lower(): [place.neighbours.get(way, "") for place in places]
        for way in ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
    }
    layer = Layer(crs, "Polygon", [shapely.Polygon(place.ring) for place in places], columns)
    record["index"] = dict.fromkeys((f"{INDEX}{end}" for end in _INDEX_ENDS), "")
    _write_record(folder, record)
    package = write_layers(folder / f"{INDEX}.gpkg", {"sheets": layer}, overwrite=True)
    boxes = [place.bounds for place in places]
    bounds = (min(b[0] for b in boxes), min(b[1] for b in boxes), max(b[2] for b in boxes), max(b[3] for b in boxes))
    style = Style("Sheets", Symbol(line=Line("#c00000", 0.35)), label=Label("name", 7.0, "#7a0000"))
    page_layout = Layout(
        SheetPart(title="Index of sheets", subtitle=places[0].series, paper="A4", dpi=200), MapPart(bounds=bounds)
    )
    inputs = SheetInputs(raster, page_layout, (VectorInput(package, "sheets", style, "Sheets"),))
    page = make_sheet(inputs, folder / f"{INDEX}.pdf", overwrite=True)
    record["index"] = {path.name: sha256(path) for path in (package, page.path)}
    _write_record(folder, record)
    return package, page.path


# A sheet needs the memory that its paper and resolution ask for; a cluster has a limit of its own.
UNLIMITED = {"memory_limit": 1 << 60}
# At some seconds each more would take a day: the scale is a slip rather than a wish.
_MOST_SHEETS = 5000


@dataclass(frozen=True)
class SeriesResult:
    """What was made.

    Attributes
    ----------
    made, kept : tuple of Path
        Sheets that were drawn, and those that were there already.
    names : tuple of str
        All sheets, in their order.
    index : tuple of Path
        GeoPackage and page of the atlas.
    """

    made: tuple[Path, ...]
    kept: tuple[Path, ...]
    names: tuple[str, ...]
    index: tuple[Path, ...]


def make_series(
    inputs: SheetInputs,
    scheme: Scheme,
    folder: Path,
    wanted: SeriesOptions,
    progress: Progress | None = None,
) -> SeriesResult:
    """Sheets of a scheme that show something of a raster, drawn and written.

    Parameters
    ----------
    inputs : SheetInputs
    scheme : Scheme
    folder : Path
        Made where it does not exist. A sheet that is there and was made of the same is kept; one that was made of
        something else, by this function, is replaced; any other file in the way is an error.
    wanted : SeriesOptions, results do not depend on its `workers`
    progress : callable, optional

    Raises
    ------
    InputError, OutputExistsError, OutputError
    """
    # Each sheet is noted in the record before it is drawn, with the checksum of what it replaces: a run that is stopped
    # at any moment knows afterwards which files are its own.
    with Source(inputs.raster) as source:
        grid = raster_grid(source, str(inputs.raster))
    suffix, overlap = f".{wanted.format}", wanted.overlap
    names = list(dict.fromkeys(scheme.proper(name) for name in wanted.only)) or _all(scheme, grid.crs, grid.bounds)
    places = [sheet_place(scheme, name, grid.crs, overlap) for name in names]
    for place in places:
        if not _meet(place, grid.bounds):
            raise InputError(
                f"sheet {place.name} shows nothing of the raster",
                where=str(inputs.raster),
                hint="leave it out of `only`; without `only` all sheets that show something are made",
            )
    # What does not fit the paper is told before the first sheet is drawn: one in the middle may be the largest.
    layouts = [series_layout(inputs.layout, place) for place in places]
    pages = [
        lay_out(layout, grid.crs, grid.bounds, f"sheet {place.name}")
        for layout, place in zip(layouts, places, strict=True)
    ]
    # The widest one is asked: others may be cut at the edge of a zone.
    widest = int(np.argmax([page.neatline[2] - page.neatline[0] for page in pages]))
    warn_of_small_map(pages[widest], layouts[widest], grid)
    _refuse_one_file_for_two(names, suffix)
    if folder.exists() and not folder.is_dir():
        raise InputError("the output is a file", where=str(folder), hint="name a folder, which is made where it is not")
    folder.mkdir(parents=True, exist_ok=True)
    _tell_differences(scheme, names[0], grid.crs, inputs.layout.map.scale)
    record = _read_record(folder)
    _refuse_index_of_others(folder, record)
    base = _dependency_digests(inputs, record)
    tasks, kept, order = [], [], []
    for name, place in zip(names, places, strict=True):
        path, ring = folder / (_file_name(name) + suffix), place.ring.tolist()
        key = digest_of({**base, "name": name, "overlap": overlap, "ring": ring, "suffix": suffix})
        order.append((place, path))
        state = _state_of(path, record["sheets"].get(path.name), key)
        if state == "foreign":
            raise OutputExistsError(
                "a file stands where a sheet of the series belongs, and was not made with it",
                where=str(path),
                hint="move it away, or give another folder",
            )
        entry = {
            "key": key,
            "name": name,
            "ring": digest_of(ring),
            "sha256": sha256(path) if state == "finished" else None,
        }
        if state == "older":
            entry["was"] = sha256(path)
        record["sheets"][path.name] = entry
        if state == "finished":
            kept.append(path)
        else:
            tasks.append(_Task(_anywhere(inputs), place, path.absolute()))
    _write_record(folder, record)
    made = []
    # Matplotlib is not made for threads: one sheet after the other, here or on workers. One process would be as fast as
    # this one.
    workers = None if wanted.workers == 1 else wanted.workers
    running = RunningOptions(threads=1, workers=workers, **UNLIMITED if isinstance(workers, int) else {})
    for done, (task, _) in enumerate(map_units(_draw, tasks, running) if tasks else (), 1):
        entry = record["sheets"][task.path.name]
        entry["sha256"] = sha256(task.path)
        entry.pop("was", None)
        _write_record(folder, record)
        made.append(folder / task.path.name)
        if progress is not None:
            progress(done, len(tasks), "sheets")
    order += _earlier_sheets(record, scheme, grid.crs, overlap, folder, suffix, names)
    index = _write_index(inputs.raster, inputs.layout, order, folder, grid.crs, record)
    return SeriesResult(tuple(made), tuple(kept), tuple(names), index)


@dataclass(frozen=True)
class _Task:
    """One sheet to draw."""

    inputs: SheetInputs
    place: SheetPlace
    path: Path


def _meet(place: SheetPlace, bounds: Bounds) -> bool:
    return bool(shapely.Polygon(place.ring).intersection(shapely.box(*bounds)).area > 0)


def _all(scheme: Scheme, crs: CRS, bounds: Bounds) -> list[str]:
    names = []
    for name in sheets_on(scheme, crs, bounds):
        names.append(name)
        if len(names) > _MOST_SHEETS:
            raise InputError(
                f"the raster lies on more than {_MOST_SHEETS} sheets", where=scheme.title, hint="choose larger sheets"
            )
    if not names:
        raise InputError(f"{scheme.title} has no sheet where the raster lies", hint=scheme.area)
    return names


def _tell_differences(scheme: Scheme, name: str, crs: CRS, scale: float | None) -> None:
    """Warnings that the sheets have another CRS or scale than the scheme, as the raster or the layout asks for."""
    if scale and scheme.scale and scale != scheme.scale:
        warn(
            f"the sheets are drawn at {scale_text(scale)}, as [map] scale of the layout has it, not at "
            f"{scale_text(scheme.scale)}"
        )
    wanted = scheme.map_crs(name)
    if wanted is not None and parse_crs(wanted) != crs:
        warn(
            f"the sheets are drawn in the raster's CRS ({crs.name}); {scheme.title} has {wanted}: reproject the raster "
            "first to have that"
        )


def _anywhere(inputs: SheetInputs) -> SheetInputs:
    """Inputs with whole paths: a worker may run in another folder."""
    layers = tuple(replace(layer, path=layer.path.absolute()) for layer in inputs.layers)
    dem, shade = (None if path is None else path.absolute() for path in (inputs.dem, inputs.shade))
    return replace(inputs, raster=inputs.raster.absolute(), layers=layers, dem=dem, shade=shade)


def _draw(task: _Task) -> None:
    """Draw one sheet; its warnings get its name."""
    with collected_warnings() as texts:
        # What stood there was looked at before, and a worker that is lost may have drawn the sheet already.
        make_sheet(task.inputs, task.path, series=task.place, overwrite=True)
    for text in texts:
        warn(f"{task.place.name}: {text}")


def _dependency_digests(inputs: SheetInputs, record: dict[str, Any]) -> dict[str, Any]:
    """Everything that all sheets depend on; digests of files are kept with their size and time."""
    files = [inputs.raster, *(layer.path for layer in inputs.layers), *filter(None, (inputs.dem, inputs.shade))]
    extra = [Path(name) for name in (inputs.layout.sheet.logo, *inputs.layout.sheet.fonts) if name]
    files += [path for path in extra if path.is_file()]  # what is missing is an error where it is read
    hashes = Hashes(record["files"])
    digests = {path.name: hashes.of(path.resolve()) for path in files}
    return {
        "version": geomosaic.__version__, "files": digests, "layout": repr(inputs.layout),
        "layers": [repr(replace(layer, path=Path(layer.path.name))) for layer in inputs.layers],
        "dem": inputs.dem_heights, "report": inputs.report, "options": repr(inputs.files),
    }  # fmt: skip
