"""How products are computed and written."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from geomosaic.errors import InputError
from geomosaic.resample.warp import RESAMPLING
from geomosaic.sensor.lattice import BLOCK_WIDTH

Progress = Callable[[int, int, str], None]
GIGABYTE = 1 << 30


@dataclass(frozen=True)
class RenderOptions:
    """What every raster product shares.

    Attributes
    ----------
    resampling : str
        'nearest', 'bilinear', 'cubic', 'lanczos' or 'average'. All but 'nearest' average over the pixel's footprint
        where the output is coarser than the image.
    tolerance : float
        Largest admissible geometric error of the lattice, in image pixels, or output pixels where those are larger.
    threads : int
        Worker threads; the result does not depend on it.
    memory_limit : int
        Bytes the run may hold.
    tile : int
        Width of a work unit in pixels, a multiple of the block width; the result does not depend on it.
    nodata : float, optional
        Value of unseen pixels; a mask of its own is written unless given.
    driver : str
        'COG' or 'GTiff'.
    creation : mapping
        GDAL creation options.
    overwrite : bool
    progress : callable, optional
        Called with (done, total, stage).
    true_ortho : bool
        Whether images show only what the surface does not hide from them.
    """

    resampling: str = "bilinear"
    tolerance: float = 0.02
    threads: int = field(default_factory=lambda: os.cpu_count() or 1)
    memory_limit: int = 2 * GIGABYTE
    tile: int = 2 * BLOCK_WIDTH
    nodata: float | None = None
    driver: str = "COG"
    creation: Mapping[str, str] = field(default_factory=dict)
    overwrite: bool = False
    progress: Progress | None = None
    true_ortho: bool = False

    def __post_init__(self) -> None:
        if self.resampling not in RESAMPLING:
            raise InputError(f"no resampling named '{self.resampling}'", hint=f"use one of {', '.join(RESAMPLING)}")
        if self.tile < BLOCK_WIDTH or self.tile % BLOCK_WIDTH:
            raise InputError(f"tile width {self.tile} is not a multiple of {BLOCK_WIDTH}")
        if not self.tolerance >= 0:
            raise InputError(f"tolerance {self.tolerance} is not a number of pixels from 0")
        if self.threads < 1:
            raise InputError("at least one thread is needed")

    def report(self, done: int, total: int, stage: str) -> None:
        """Tell the progress callback, if there is one."""
        if self.progress is not None:
            self.progress(done, total, stage)
