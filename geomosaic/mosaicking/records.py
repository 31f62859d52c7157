"""Result of a mosaic, and its vector records: footprints, seam polygons, seamlines."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pyproj import CRS

from geomosaic.block import Footprint
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.seams.seamlines import SeamPlace, SeamQuality, Segment, seam_segments
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.raster.sink import RasterProduct
from geomosaic.raster.vector import Layer, write_layers

if TYPE_CHECKING:
    from geomosaic.execution.run_report import RunReport
    from geomosaic.mosaicking.colour.stretch import Stretch
    from geomosaic.render.accuracy import AccuracyRaster


@dataclass(frozen=True, kw_only=True, repr=False)
class MosaicResult(RasterProduct):
    """Mosaic as it was made: files, corrections, seams and figures.

    Attributes
    ----------
    path : Path
    labels, vectors, item : Path or None
        Label raster, GeoPackage of footprints and seamlines, STAC item.
    tiles : tuple of Path
        Files of a mosaic that is a grid of them, of which `path` is the virtual raster.
    grid : Grid
    valid_pixels : int
    pixels : list of int
        Pixels whose main source each image is.
    balance : Balance
    feather : float
        Width of the transition, in map units.
    lattice_error, tolerance : float
        Largest measured and admissible error of the geometry, in image pixels, or output pixels where those are larger.
    scale : float
        Image pixels per output pixel.
    seconds : dict
        Per stage.
    reused, units : int
        Units of work whose pixels came from an earlier run, and all of them.
    stretch : Stretch, optional
        Stretch to eight bits.
    parts : list of Segment
        Seam segments.
    quality : list of SeamQuality
        Of each segment, where it was asked for.
    places : list of SeamPlace
        The worst of them.
    hidden_pixels : int, optional
        Pixels that images cover and the surface hides from them all; None unless a true ortho was asked for.
    from_cache : tuple of str
        Results of an earlier run that were used, besides pixels.
    notes : tuple of str
        Where heights are missing.
    placement : mapping, optional
        How photos of flat ground were placed: residuals, corrections, wrong points.
    placement_file : Path, optional
        The same as JSON.
    accuracy : AccuracyRaster, optional
        Standard deviations of position, where they were asked for.
    run : RunReport, optional
        What each worker did; None where threads of the process did everything.
    """

    path: Path
    labels: Path | None
    vectors: Path | None
    item: Path | None
    grid: Grid
    valid_pixels: int
    pixels: list[int]
    balance: Balance
    feather: float
    lattice_error: float
    tolerance: float
    scale: float
    seconds: dict[str, float]
    reused: int = 0
    units: int = 0
    stretch: Stretch | None = None
    parts: list[Segment] = field(default_factory=list)
    quality: list[SeamQuality] = field(default_factory=list)
    places: list[SeamPlace] = field(default_factory=list)
    hidden_pixels: int | None = None
    from_cache: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    placement: Mapping[str, Any] | None = None
    placement_file: Path | None = None
    accuracy: AccuracyRaster | None = None
    tiles: tuple[Path, ...] = ()

    @property
    def tile_files(self) -> tuple[Path, ...]:
        """Files of the tiles and of their labels."""
        labels = () if self.labels is None else tuple(path.with_name(f"{path.stem}-labels.tif") for path in self.tiles)
        return (*self.tiles, *labels)

    run: RunReport | None = None


class Timer:
    """Wall-clock seconds of a stage, entered into a mapping by its name."""

    def __init__(self, seconds: dict[str, float], name: str) -> None:
        self.seconds, self.name = seconds, name

    def __enter__(self) -> None:
        self.started = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self.seconds[self.name] = time.perf_counter() - self.started


@dataclass(frozen=True)
class SourceImages:
    """Source images of a mosaic: geometry, corrections and further facts.

    Attributes
    ----------
    outlines : list of Footprint
        In the map of the mosaic.
    shares : list of Polygon or MultiPolygon
        Seam polygons; empty where an image shows nothing.
    pixels : list of int
        Pixels that each image shows.
    balance : Balance
        Gains and offsets.
    facts : mapping of str to sequence
        Columns of further facts, see `provenance.source_facts`.
    """

    outlines: list[Footprint]
    shares: list[Any]
    pixels: list[int]
    balance: Balance
    facts: Mapping[str, Sequence[Any]] = field(default_factory=dict)


def write_vectors(
    path: Path,
    grid: Grid,
    sources: SourceImages,
    parts: Sequence[Segment] | None = None,
    quality: Sequence[SeamQuality] = (),
    *,
    overwrite: bool,
) -> None:
    """GeoPackage with the layers `footprints`, `seams` (seam polygons) and `seamlines`.

    An image keeps its `label`, a seam segment its `id`, as long as the images of the block stay the same.

    Parameters
    ----------
    path : Path
        Ends in .gpkg.
    grid : Grid
        Of the mosaic; geometries are in its CRS.
    sources : SourceImages
    parts : sequence of Segment, optional
        Seam segments; whole seams unless given.
    quality : sequence of SeamQuality
        Of each segment, where measured.
    overwrite : bool

    Raises
    ------
    OutputExistsError, OutputError
        The name is taken; writing failed.
    """
    parts = seam_segments(sources.shares, grid.resolution[0], math.inf) if parts is None else parts
    layers = {
        "footprints": _footprints(grid.crs, sources),
        "seams": _seam_polygons(grid.crs, sources),
        "seamlines": _seamlines(grid, sources.outlines, parts, quality),
    }
    write_layers(path, layers, overwrite=overwrite)


def _footprints(crs: CRS, sources: SourceImages) -> Layer:
    outlines = sources.outlines
    columns: dict[str, list[Any]] = {
        "label": list(range(1, len(outlines) + 1)),
        "image": [outline.name for outline in outlines],
        "centre_x": [outline.centre[0] for outline in outlines],
        "centre_y": [outline.centre[1] for outline in outlines],
        "sampling": [outline.sampling for outline in outlines],
        "complete": [outline.complete for outline in outlines],
        "pixels": sources.pixels,
    }
    columns.update(gains(sources.balance))
    columns.update({name: list(values) for name, values in sources.facts.items()})
    shapes = [outline.polygon for outline in outlines]
    kind = "Polygon" if all(shape.geom_type == "Polygon" for shape in shapes) else "MultiPolygon"
    return Layer(crs, kind, shapes, columns)


def gains(balance: Balance) -> dict[str, list[float]]:
    """Columns of gains and offsets by image, one of each per band.

    Parameters
    ----------
    balance : Balance

    Returns
    -------
    dict of str to list of float
        `gain_1`, `offset_1`, `gain_2` ...; one value per image.
    """
    columns = {}
    for band in range(balance.gain.shape[1]):
        columns[f"gain_{band + 1}"] = [float(value) for value in balance.gain[:, band]]
        columns[f"offset_{band + 1}"] = [float(value) for value in balance.offset[:, band]]
    return columns


def _seam_polygons(crs: CRS, sources: SourceImages) -> Layer:
    outlines, shares = sources.outlines, sources.shares
    kept = [i for i, share in enumerate(shares) if not share.is_empty]
    columns: dict[str, list[Any]] = {"label": [i + 1 for i in kept], "image": [outlines[i].name for i in kept]}
    return Layer(crs, "MultiPolygon", [shares[i] for i in kept], columns)


def _seamlines(
    grid: Grid, outlines: list[Footprint], parts: Sequence[Segment], quality: Sequence[SeamQuality]
) -> Layer:
    names = [outline.name for outline in outlines]
    first, second = [names[part.first] for part in parts], [names[part.second] for part in parts]
    columns: dict[str, list[Any]] = {
        "id": [f"{a}|{b}|{part.number}" for a, b, part in zip(first, second, parts, strict=True)],
        "first": first,
        "second": second,
        "length": [float(part.line.length) for part in parts],
    }
    if quality:
        for name in ("step_before", "step_after", "difference", "mismatch", "shift_col", "shift_row", "correlation"):
            columns[name] = [float(getattr(one, name)) for one in quality]
    return Layer(grid.crs, "MultiLineString", [part.line for part in parts], columns)
