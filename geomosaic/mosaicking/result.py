"""Result of a mosaic: paths, pixel counts, accuracy and timings."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.seams.seamlines import SeamPlace, SeamQuality, Segment
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.raster.sink import RasterProduct

if TYPE_CHECKING:
    from geomosaic.mosaicking.colour.stretch import Stretch


@dataclass(frozen=True, kw_only=True, repr=False)
class MosaicResult(RasterProduct):
    """Mosaic as it was made: files, corrections, seams and figures.

    Attributes
    ----------
    path : Path
    labels, vectors, item : Path or None
        Label raster, GeoPackage of footprints and seamlines, STAC item.
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
    recalled : tuple of str
        Results of an earlier run that were used, besides pixels.
    notes : tuple of str
        Where heights are missing.
    placement : mapping, optional
        How photos of flat ground were placed: residuals, corrections, wrong points.
    placement_file : Path, optional
        The same as JSON.
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
    recalled: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    placement: Mapping[str, Any] | None = None
    placement_file: Path | None = None


class Timer:
    """Wall-clock seconds of a stage, entered into a mapping by its name."""

    def __init__(self, seconds: dict[str, float], name: str) -> None:
        self.seconds, self.name = seconds, name

    def __enter__(self) -> None:
        self.started = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self.seconds[self.name] = time.perf_counter() - self.started
