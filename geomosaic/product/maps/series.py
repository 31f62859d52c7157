"""All sheets of a series over a raster: in parallel, resumable, with an atlas index."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pyproj import CRS

import geomosaic
from geomosaic.carto.draw.save import FileOptions
from geomosaic.carto.layout import Layout
from geomosaic.carto.picture import raster_grid
from geomosaic.carto.series.neatline import SheetPlace, sheet_place, sheets_on
from geomosaic.carto.series.scheme import Scheme
from geomosaic.carto.style import Label, Line, Style, Symbol
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import parse_crs
from geomosaic.geo.grid import Bounds
from geomosaic.product.maps.sheet import VectorInput, make_sheet
from geomosaic.raster.checksum import sha256
from geomosaic.raster.source import Source
from geomosaic.raster.vector import Layer, write_layers

RECORD = ".sheets.json"
"""In the folder of the sheets: by file the key of what it was made from, and its checksum."""
INDEX = "index"
MOST_SHEETS = 5000
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class SeriesInputs:
    """What all sheets are made of; see `make_sheet`."""

    raster: Path
    layout: Layout
    layers: tuple[VectorInput, ...] = ()
    dem: Path | None = None
    dem_heights: str | None = None
    shade: Path | None = None
    report: Mapping[str, Any] | None = None
    files: FileOptions = field(default_factory=FileOptions)


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
    inputs: SeriesInputs,
    scheme: Scheme,
    folder: Path,
    *,
    suffix: str = ".pdf",
    overlap: float = 0.0,
    only: Sequence[str] = (),
    workers: int = 1,
    progress: Progress | None = None,
) -> SeriesResult:
    """Make the sheets of a scheme that show something of a raster.

    Parameters
    ----------
    inputs : SeriesInputs
    scheme : Scheme
    folder : Path
        Made where it does not exist. A sheet that is there and was made of the same is kept; one that was made of
        something else, by this function, is replaced; any other file in the way is an error.
    suffix : str
        '.pdf', '.png' or '.tif'.
    overlap : float
        Map units by which the sheets reach beyond their edges.
    only : sequence of str
        These sheets instead of all.
    workers : int
        Processes; results do not depend on them.
    progress : callable, optional

    Raises
    ------
    InputError, OutputExistsError, OutputError
    """
    with Source(inputs.raster) as source:
        grid = raster_grid(source, str(inputs.raster))
    names = [scheme.proper(name) for name in only] or _all(scheme, grid.crs, grid.bounds)
    places = [sheet_place(scheme, name, grid.crs, overlap) for name in names]
    for place in places:
        if not _meet(place.bounds, grid.bounds):
            raise InputError(
                f"sheet {place.name} shows nothing of the raster",
                where=str(inputs.raster),
                mend="leave it out of --only; without --only all sheets that show something are made",
            )
    folder.mkdir(parents=True, exist_ok=True)
    _tell_crs(scheme, names[0], grid.crs)
    record = _read_record(folder)
    base = _ingredients(inputs, record)
    tasks, kept, order = [], [], []
    for name, place in zip(names, places, strict=True):
        path = folder / (file_name(name) + suffix)
        key = _digest({**base, "name": name, "overlap": overlap, "ring": place.ring.tolist(), "suffix": suffix})
        order.append((place, path))
        known = record["sheets"].get(path.name)
        if path.is_file() and known and known["key"] == key and known["sha256"] == sha256(path):
            kept.append(path)
            continue
        ours = bool(known and path.is_file() and known["sha256"] == sha256(path))
        tasks.append((Task(inputs, place, path, ours), key))
    made = []
    for done, (task, key, told) in enumerate(_run(tasks, workers), 1):
        record["sheets"][task.path.name] = {"key": key, "sha256": sha256(task.path)}
        _write_record(folder, record)
        made.append(task.path)
        for text in told:
            warnings.warn(f"{task.place.name}: {text}", GeomosaicWarning, stacklevel=2)
        if progress is not None:
            progress(done, len(tasks), "sheets")
    index = _index(inputs, order, folder, grid.crs)
    return SeriesResult(tuple(made), tuple(kept), tuple(names), index)


@dataclass(frozen=True)
class Task:
    """One sheet to draw."""

    inputs: SeriesInputs
    place: SheetPlace
    path: Path
    overwrite: bool


def _meet(a: Bounds, b: Bounds) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _all(scheme: Scheme, crs: CRS, bounds: Any) -> list[str]:
    names = []
    for name in sheets_on(scheme, crs, bounds):
        names.append(name)
        if len(names) > MOST_SHEETS:
            raise InputError(
                f"the raster lies on more than {MOST_SHEETS} sheets", where=scheme.title, mend="choose larger sheets"
            )
    if not names:
        raise InputError("no sheet shows anything of the raster", where=scheme.title, mend="use another scheme")
    return names


def _tell_crs(scheme: Scheme, name: str, crs: CRS) -> None:
    wanted = scheme.map_crs(name)
    if wanted is not None and parse_crs(wanted) != crs:
        warnings.warn(
            f"the sheets are drawn in the raster's CRS ({crs.name}); {scheme.title} has {wanted}: reproject the raster "
            "first to have that",
            GeomosaicWarning,
            stacklevel=3,
        )


def file_name(name: str) -> str:
    """Name of a sheet as that of a file."""
    return re.sub(r"[^\w.-]+", "_", name).strip("_.") or "sheet"


def _run(tasks: Sequence[tuple[Task, str]], workers: int) -> Iterator[tuple[Task, str, list[str]]]:
    """Draw the sheets, each in the order of the list."""
    if workers == 1 or len(tasks) < 2:
        for task, key in tasks:
            yield task, key, _draw(task)
        return
    # Matplotlib is not made for threads; new processes start clean on every system.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(workers, len(tasks)), mp_context=context) as pool:
        try:
            results = pool.map(_draw, [task for task, _ in tasks])
            for (task, key), told in zip(tasks, results, strict=True):
                yield task, key, told
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _draw(task: Task) -> list[str]:
    """Draw one sheet; returns what is to be told."""
    given = task.inputs
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        make_sheet(
            given.raster, task.path, given.layout, given.layers, dem=given.dem, dem_heights=given.dem_heights,
            shade=given.shade,
            report=given.report, series=task.place, files=given.files, overwrite=task.overwrite,
        )  # fmt: skip
    return [str(w.message) for w in caught if issubclass(w.category, GeomosaicWarning)]


def _ingredients(inputs: SeriesInputs, record: dict[str, Any]) -> dict[str, Any]:
    """Everything that all sheets depend on; digests of files are kept with their size and time."""
    files = [inputs.raster, *(layer.path for layer in inputs.layers), *filter(None, (inputs.dem, inputs.shade))]
    lent = [Path(name) for name in (inputs.layout.sheet.logo, *inputs.layout.sheet.fonts) if name]
    files += [path for path in lent if path.is_file()]  # what is missing is told where it is read
    digests = {}
    for path in files:
        stat = path.stat()
        known = record["files"].get(str(path.resolve()))
        if known is None or known[:2] != [stat.st_size, stat.st_mtime_ns]:
            known = [stat.st_size, stat.st_mtime_ns, sha256(path)]
            record["files"][str(path.resolve())] = known
        digests[path.name] = known[2]
    return {
        "version": geomosaic.__version__, "files": digests, "layout": repr(inputs.layout),
        "layers": [repr(replace(layer, path=Path(layer.path.name))) for layer in inputs.layers],
        "dem": inputs.dem_heights, "report": inputs.report, "options": repr(inputs.files),
    }  # fmt: skip


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


def _read_record(folder: Path) -> dict[str, Any]:
    try:
        found = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        found = {}
    usable = isinstance(found, dict) and isinstance(found.get("sheets"), dict) and isinstance(found.get("files"), dict)
    return found if usable else {"sheets": {}, "files": {}}


def _write_record(folder: Path, record: Mapping[str, Any]) -> None:
    unfinished = folder / f"{RECORD}.partial"
    unfinished.write_text(json.dumps(record, indent=1, sort_keys=True), encoding="utf-8")
    unfinished.replace(folder / RECORD)


def _index(inputs: SeriesInputs, order: Sequence[tuple[SheetPlace, Path]], folder: Path, crs: CRS) -> tuple[Path, ...]:
    """Write the atlas index: a GeoPackage of neatlines, and a page that shows them over the raster."""
    from shapely import Polygon

    places = [place for place, _ in order]
    columns: dict[str, list[Any]] = {
        "name": [place.name for place in places],
        "file": [path.name for _, path in order],
        "scale": [float(place.scale or inputs.layout.map.scale or 0.0) for place in places],
    }
    columns |= {
        way.lower(): [place.neighbours.get(way, "") for place in places]
        for way in ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
    }
    layer = Layer(crs, "Polygon", [Polygon(place.ring) for place in places], columns)
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
        inputs.raster,
        folder / f"{INDEX}.pdf",
        layout,
        [VectorInput(package, "sheets", style, "Sheets")],
        overwrite=True,
    )
    return package, page.path
