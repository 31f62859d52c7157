"""Digital elevation model in a raster file: bilinear between nodes, unknown where a node that counts is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from pyproj import CRS

from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import (
    crs_code,
    has_heights,
    height_name,
    horizontal,
    parse_crs,
    with_heights,
    with_local_heights,
)
from geomosaic.geo.grid import Bounds, Grid, Window
from geomosaic.interpolation import bilinear
from geomosaic.raster.source import Source
from geomosaic.stores.path import given_path
from geomosaic.surface.dem_nodes import BLOCK, ArraySource, Nodes
from geomosaic.surface.model import HeightPatch, Surface, undeclared_heights
from geomosaic.types import Float32Array, FloatArray, PathLike

_UNITS = {
    "m": 1.0,
    "metre": 1.0,
    "metres": 1.0,
    "meter": 1.0,
    "meters": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "centimetre": 0.01,
    "centimeter": 0.01,
    "mm": 0.001,
    "ft": 0.3048,
    "foot": 0.3048,
    "feet": 0.3048,
    "us survey foot": 1200 / 3937,
    "us_survey_foot": 1200 / 3937,
    "ftus": 1200 / 3937,
    "ft-us": 1200 / 3937,
    "us-ft": 1200 / 3937,
}


class Dem:
    """Digital elevation model; a `Surface`. Thread-safe. Made by `Dem.open` or `Dem.from_array`.

    Heights are bilinear between nodes, which are the pixel centres, and unknown where a node that counts is unknown.

    Attributes
    ----------
    crs : CRS
        3-D: horizontal CRS of the file, and the vertical datum that was declared or that the file has.
    grid : Grid
        Place and size of the file.
    spacing : float
        Smaller distance between nodes, in units of the CRS.
    declared : str or None
        Vertical datum as the user declared it; None where the file's own holds.
    overridden : str or None
        Name of the file's own vertical datum, where a declaration replaced it.
    notes : tuple of str
        What was done to the heights: units, scale and offset.
    sigma : Surface or None
        Standard deviations of the heights, metres, where they are known.
    """

    def __init__(
        self,
        nodes: Nodes,
        path: str,
        crs: CRS,
        grid: Grid,
        *,
        declared: str | None = None,
        overridden: str | None = None,
        notes: tuple[str, ...] = (),
        sigma: Surface | None = None,
    ) -> None:
        self.crs, self.grid = crs, grid
        self.declared, self.overridden, self.notes = declared, overridden, notes
        self.sigma = sigma
        self.spacing = min(grid.resolution)
        self.path = path
        self._nodes = nodes

    def __repr__(self) -> str:
        size = f"{self.grid.width} x {self.grid.height} nodes every {self.spacing:g}"
        return f"Dem({repr(str(self.path)) if self.path else 'values'}, {size}, {crs_code(self.crs)})"

    @classmethod
    def open(
        cls,
        path: PathLike,
        *,
        heights: str | None = None,
        band: int = 1,
        memory_limit: int = 256 << 20,
        crs: CRS | str | None = None,
        where: str | None = None,
        sigma: Surface | None = None,
    ) -> Dem:
        """Open a DEM.

        Parameters
        ----------
        path : path
            Any raster; its nodes are the pixel centres.
        heights : str, optional
            What the heights count from: 'ellipsoidal', 'egm96', an EPSG code, or the path of a geoid grid. Replaces
            what the file says.
        band : int
            From 1.
        memory_limit : int
            Bytes that may be held between reads.
        crs : CRS or str, optional
            For a file that has none.
        where : str, optional
            Named in errors; the path by default.
        sigma : Surface, optional
            Standard deviations of the heights.

        Raises
        ------
        HeightDatumError
            Neither the user nor the file says what the heights count from.
        InputError
            No CRS, no geo-reference, or heights in units that are not known.
        """
        path = given_path(path)
        place = where or str(path)
        source = Source(path, bands=[band], memory_limit=memory_limit)
        info = source.info
        file_crs = parse_crs(crs, place) if crs is not None else info.crs
        file_crs = file_crs and with_local_heights(file_crs)
        if file_crs is None or info.transform is None:
            raise InputError(
                f"the DEM has no {'CRS' if info.transform is not None else 'geo-reference'}",
                where=place,
                hint="assign it with gdal_edit -ro -a_srs (or a .prj file), or -a_ullr",
            )
        grid = Grid(horizontal(file_crs), info.transform, info.width, info.height)
        own = has_heights(file_crs)
        if heights is None and not own:
            x, y = grid.xy(np.array([[grid.width / 2, grid.height / 2]]))[0]
            source.close()
            raise undeclared_heights(grid.crs, float(x), float(y), place)
        full = file_crs if heights is None else with_heights(grid.crs, heights, place)
        scale, offset, notes = _metres(source, band, full, place)
        return cls(
            Nodes(source, scale, offset, memory_limit // 4),
            source.info.path,
            full,
            grid,
            declared=heights,
            overridden=height_name(file_crs) if heights is not None and own else None,
            notes=notes,
            sigma=sigma,
        )

    @classmethod
    def from_array(
        cls, heights: FloatArray | Float32Array, grid: Grid, datum: str | None = None, sigma: Surface | None = None
    ) -> Dem:
        """DEM of heights in memory.

        Parameters
        ----------
        heights : array (rows, cols)
            Metres, at the pixel centres of `grid`; NaN where unknown.
        grid : Grid
        datum : str, optional
            What the heights count from: 'ellipsoidal', 'egm96', an EPSG code, or the path of a geoid grid; not needed
            where the grid's CRS has heights.
        sigma : Surface, optional
            Standard deviations of the heights.

        Raises
        ------
        HeightDatumError
            Nothing says what the heights count from.
        InputError
            The array has another shape than the grid.

        Examples
        --------
        >>> grid = Grid.from_bounds(CRS("EPSG:32633"), (500000.0, 5400000.0, 500030.0, 5400020.0), 10.0)
        >>> dem = Dem.from_array(np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), grid, "egm96")
        >>> dem.height(np.array([[500015.0, 5400010.0]])).tolist()
        [3.5]
        """
        values = np.array(heights, dtype=np.float32)
        if values.shape != grid.shape:
            raise InputError(
                f"the heights are {values.shape} and the grid has {grid.shape} rows and columns",
                where="`heights`",
                hint="give one height for each cell of the grid, rows first",
            )
        full = with_local_heights(grid.crs)
        own = has_heights(full)
        flat = replace(grid, crs=horizontal(grid.crs))
        if datum is None and not own:
            x, y = flat.xy(np.array([[flat.width / 2, flat.height / 2]]))[0]
            raise undeclared_heights(flat.crs, float(x), float(y), "`heights`")
        crs = full if datum is None else with_heights(flat.crs, datum, "`datum`")
        values.flags.writeable = False
        return cls(Nodes(ArraySource(values), 1.0, 0.0, values.nbytes), "", crs, flat, declared=datum, sigma=sigma)

    def close(self) -> None:
        """Close the file and free the memory."""
        self._nodes.close()

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest height in metres, from every node of the file, read once.

        Raises
        ------
        InputError
            No node has a height.
        """
        return self._nodes.range

    @property
    def gaps(self) -> bool:
        """Whether any node of the file has no height."""
        return self._nodes.gaps

    def patch(self, bounds: Bounds, spacing: float = 0.0) -> HeightPatch:
        """Heights that cover bounds (left, bottom, right, top) in `crs`, with two nodes around for interpolation.

        Where nodes are closer than `spacing`, means of blocks of them: what an output pixel shows is the ground it
        covers, not a node within. Outside the file there is a single unknown node.

        Parameters
        ----------
        bounds : Bounds
            Left, bottom, right, top in `crs`.
        spacing : float
            Map units.
        """
        # 1e-6 keeps a spacing of exactly n nodes from being cut to n - 1 by rounding.
        factor = max(1, int(spacing / max(self.grid.resolution) + 1e-6))
        grid = self.grid.coarser(factor)
        corners = np.array([[bounds[i], bounds[j]] for i in (0, 2) for j in (1, 3)])
        # Bounds may be infinite, where a map has no end; windows are whole numbers.
        colrow = np.clip(grid.colrow(corners), -1e9, 1e9)
        (col, row), (stop_col, stop_row) = np.floor(colrow.min(axis=0)), np.ceil(colrow.max(axis=0))
        first_col, first_row = int(col) - 2, int(row) - 2
        window = Window(first_col, first_row, int(stop_col) + 2 - first_col, int(stop_row) + 2 - first_row)
        inside = window.intersection(grid.window)
        if inside.empty:
            return HeightPatch(np.full((1, 1), np.nan, dtype=np.float32), ~grid.crop(window).transform)
        heights = np.ascontiguousarray(self._nodes.reduced(inside, factor))
        return HeightPatch(heights, ~grid.crop(inside).transform)

    def height(self, xy: FloatArray) -> FloatArray:
        """Heights (N,) in metres at (N, 2) in `crs`, bilinear; NaN where a node that counts is unknown.

        Parameters
        ----------
        xy : array (N, 2)
            In `crs`.
        """
        # Within half a pixel of the file's edge, beyond the last node centres, the edge's heights hold.
        points = np.asarray(xy, dtype=np.float64)[:, :2]
        width, height = self.grid.width, self.grid.height
        heights = np.full(len(points), np.nan)
        colrow = self.grid.colrow(points)
        inside = np.flatnonzero(((colrow >= 0.0) & (colrow <= (width, height))).all(axis=1))
        if not len(inside):
            return heights
        node = np.clip(colrow[inside] - 0.5, 0.0, (width - 1.0, height - 1.0))
        first = np.floor(node).astype(np.int64)
        weight = node - first
        whole = self._nodes.whole
        if whole is not None:
            heights[inside] = bilinear(whole, first, weight)
            return heights
        across = -(-width // BLOCK)
        number = (first[:, 1] // BLOCK) * across + first[:, 0] // BLOCK
        # Points are taken block by block, so that each block of the file is fetched once a call.
        order = np.argsort(number, kind="stable")
        cuts = np.flatnonzero(np.diff(number[order])) + 1
        for part in np.split(order, cuts):
            block_row, block_col = divmod(int(number[part[0]]), across)
            nodes = self._nodes.block(block_col, block_row)
            local = first[part] - np.array([block_col, block_row]) * BLOCK
            heights[inside[part]] = bilinear(nodes, local, weight[part])
        return heights


def _metres(source: Source, band: int, crs: CRS, where: str) -> tuple[float, float, tuple[str, ...]]:
    """Scale, offset and notes that bring stored values to metres."""
    info = source.info
    index = min(band, info.bands) - 1
    scale, offset = info.scales[index], info.offsets[index]
    notes = []
    if (scale, offset) != (1.0, 0.0):
        notes.append(f"stored values × {scale:g} + {offset:g}")
    axis = crs.axis_info[2]
    # Heights of a `Surface` are metres everywhere, and a geoid grid gives metres.
    if abs(axis.unit_conversion_factor - 1.0) > 1e-9:
        raise InputError(
            f"the vertical CRS counts in {axis.unit_name}, only metres are supported",
            where=where,
            hint="convert the DEM to metres, or declare a datum in metres with `dem_heights`",
        )
    unit = (info.units[index] or "m").strip()
    factor = _UNITS.get(unit.lower())
    if factor is None:
        raise InputError(
            f"the heights are in '{unit}', which is not known",
            where=where,
            hint="convert the DEM to metres",
        )
    if factor != 1.0:
        notes.append(f"heights in {unit} × {factor:.9g} = metres")
    return scale * factor, offset * factor, tuple(notes)


def height_sigmas(given: float | Path) -> float | Surface:
    """Standard deviation of heights: a number, or the raster of a file.

    Parameters
    ----------
    given : float or Path
        Metres, or a raster of such.

    Raises
    ------
    InputError
        The raster has no place, or is damaged.
    """
    if not isinstance(given, Path):
        return float(given)
    where = f"`sigma_dem`, {given}"
    try:
        return Dem.open(given, where=where)
    except HeightDatumError:
        # What heights count from plays no part in their standard deviation.
        return Dem.open(given, heights="ellipsoidal", where=where)
