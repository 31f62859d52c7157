"""Correction grids in files: a table, or a raster of two bands.

A table has the columns col, row, d_col, d_row and one line for every node of a regular grid, in any order; comments
`# method = bicubic` and `# beyond = held` (the defaults) declare interpolation and extrapolation. A GeoTIFF has the
bands d_col and d_row, whose descriptions hold the same declarations; its pixel centres are the nodes, and its
geotransform, with both pixel sizes positive, gives their image coordinates.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from geomosaic.errors import InputError
from geomosaic.inputs.tables import read_table
from geomosaic.sensor.corrected import BEYOND, METHODS, CorrectionGrid
from geomosaic.stores.path import to_path
from geomosaic.types import FloatArray, PathLike
from geomosaic.whole_files import read_text, write_atomic

_COLUMNS = ("col", "row", "d_col", "d_row")
_RASTERS = (".tif", ".tiff")


def read_corrections(path: PathLike) -> CorrectionGrid:
    """Correction grid of a file; see `geomosaic.sensor.corrected` for what is added to what.

    Parameters
    ----------
    path : path-like
        GeoTIFF of two bands, or a table; distinguished by the ending.

    Returns
    -------
    CorrectionGrid
        Corrections of (col, row) in pixels.

    Raises
    ------
    InputError
        Names the file, and the line where one is wrong.
    """
    try:
        file = to_path(path)
        return _raster(file) if file.suffix.lower() in _RASTERS else _table(file)
    except InputError as error:
        error.where = error.where or str(path)
        raise


def write_corrections(path: PathLike, grid: CorrectionGrid, *, overwrite: bool = False) -> None:
    """Write a correction grid: a GeoTIFF (float64) where the name ends so, a table with 6 decimals otherwise.

    Parameters
    ----------
    path : path-like
    grid : CorrectionGrid
        Corrections of (col, row) in pixels.
    overwrite : bool
        Replace an existing file.

    Raises
    ------
    OutputExistsError
        The file exists and `overwrite` is false.
    OutputError
        It cannot be written.
    """
    from geomosaic.raster.files import check_output

    file = to_path(path)
    check_output(file, overwrite=overwrite)
    if file.suffix.lower() in _RASTERS:
        _write_raster(file, grid)
        return
    rows, columns, _ = grid.nodes.shape
    lines = [
        "# geomosaic correction grid: real minus ideal image position, at the ideal one, in pixels",
        f"# method = {grid.method}",
        f"# beyond = {grid.beyond}",
        ",".join(_COLUMNS),
    ]
    for r in range(rows):
        for c in range(columns):
            col, row = (grid.origin + grid.spacing * (c, r)).tolist()
            lines.append(f"{col!r},{row!r},{grid.nodes[r, c, 0]:.6f},{grid.nodes[r, c, 1]:.6f}")
    write_atomic(file, "\n".join(lines) + "\n")


def _table(path: Path) -> CorrectionGrid:
    table = read_table(path, "correction grid", ",".join(_COLUMNS))
    table.require(*_COLUMNS, what="correction grids")
    numbers = np.array([[row.number(name) for name in _COLUMNS] for row in table])
    (cols, at_col), (rows, at_row) = (np.unique(numbers[:, k], return_inverse=True) for k in (0, 1))
    count = np.zeros((len(rows), len(cols)), dtype=int)
    np.add.at(count, (at_row, at_col), 1)
    if not (count == 1).all():
        r, c = np.argwhere(count != 1)[0]
        raise InputError(
            f"the table has the node at col {cols[c]:g}, row {rows[r]:g} {count[r, c]} times",
            where=str(path),
            hint="give every node of a regular grid once",
        )
    nodes = np.empty((len(rows), len(cols), 2))
    nodes[at_row, at_col] = numbers[:, 2:]
    comments = "\n".join(line for line in read_text(path, "correction grid").splitlines() if line.lstrip()[:1] == "#")
    spacing = np.array([_spacing(cols, "columns", path), _spacing(rows, "rows", path)])
    return CorrectionGrid(np.array([cols[0], rows[0]]), spacing, nodes, *_declared_methods(comments))


def _spacing(places: FloatArray, what: str, path: Path) -> float:
    """Distance between nodes; arbitrary for a single one."""
    if len(places) == 1:
        return 1.0
    steps = np.diff(places)
    mean = float((places[-1] - places[0]) / len(steps))
    # Coordinates of nodes may be rounded: a millionth of the spacing.
    if np.abs(steps - mean).max() > 1e-6 * mean:
        raise InputError(
            f"the {what} of the correction grid are {steps.min():g} to {steps.max():g} pixels apart",
            where=str(path),
            hint="give a regular grid",
        )
    return mean


def _declared_methods(text: str) -> tuple[str, str]:
    """Declared interpolation and extrapolation; `CorrectionGrid` checks them."""
    found = (re.search(rf"\b{name}\s*=\s*(\w+)", text) for name in ("method", "beyond"))
    method, beyond = (
        match[1] if match else default for match, default in zip(found, (METHODS[0], BEYOND[1]), strict=True)
    )
    return method, beyond


def _raster(path: Path) -> CorrectionGrid:
    from geomosaic.geo.grid import Window
    from geomosaic.raster.source import Source

    with Source(path) as source:
        info = source.info
        values, valid = source.read(Window(0, 0, info.width, info.height))
    t = info.transform
    if info.bands != 2 or t is None or t.b or t.d or t.a <= 0.0 or t.e <= 0.0:
        raise InputError(
            "this raster is no correction grid",
            where=str(path),
            hint="give two bands, d_col and d_row, and a geotransform to image pixels with positive pixel sizes",
        )
    if valid is not None and not valid.all():
        raise InputError("the correction grid has nodes without a value", where=str(path), hint="fill them, with 0 too")
    origin = np.array([t.c + 0.5 * t.a, t.f + 0.5 * t.e])
    declared = _declared_methods(" ".join(text for text in info.descriptions if text))
    return CorrectionGrid(origin, np.array([t.a, t.e]), values.astype(np.float64), *declared)


def _write_raster(path: Path, grid: CorrectionGrid) -> None:
    from affine import Affine

    from geomosaic.geo.crs import image_crs
    from geomosaic.geo.grid import Grid
    from geomosaic.raster.cog.codec import RasterMetadata, Samples
    from geomosaic.raster.sink import RasterSink

    (width, height), (left, top) = grid.spacing.tolist(), (grid.origin - 0.5 * grid.spacing).tolist()
    rows, columns, _ = grid.nodes.shape
    place = Grid(image_crs(), Affine(width, 0.0, left, 0.0, height, top), columns, rows)
    words = f"method = {grid.method}, beyond = {grid.beyond}"
    names = [f"{name} (pixels); {words}" for name in _COLUMNS[2:]]
    metadata = RasterMetadata(names)
    samples = Samples(2, "float64", mask=False)
    with RasterSink(path, place, samples, driver="GTiff", overwrite=True, metadata=metadata) as sink:
        for window in place.window.split(512, 512):
            part = grid.nodes[window.row : window.stop_row, window.col : window.stop_col]
            sink.write(window, np.ascontiguousarray(part))
        sink.finish()
