"""Options of everything that is rendered: resampling, accuracy of the geometry, the file, threads and memory."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from geomosaic.errors import InputError
from geomosaic.options.check import CheckedOptions, check_idle
from geomosaic.options.declaration import named_only, option
from geomosaic.stores.path import given_path

if TYPE_CHECKING:
    from geomosaic.types import Progress

RESAMPLING = ("nearest", "bilinear", "cubic", "lanczos", "average", "rms")
# Pixels of the blocks that outputs are computed in, and of the cells in which parts of a block are asked for.
BLOCK_WIDTH, BLOCK_HEIGHT, CELL = 1024, 512, 64
SAMPLE_TYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")
MEGABYTE, GIGABYTE = 1 << 20, 1 << 30
# Bytes of the program with all that a mosaic needs loaded, and of one thread with the blocks it works on and those that
# wait for their turn; as measured.
PROGRAM, PER_THREAD = 320 * MEGABYTE, 80 * MEGABYTE
SIZES = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}


def parse_size(text: str) -> int:
    """Bytes of a size such as 512M or 2G.

    Parameters
    ----------
    text : str
        A number with K, M, G or T, powers of 1024, or without; B and iB after it count for nothing.

    Raises
    ------
    InputError
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?\s*", str(text), re.IGNORECASE)
    if not found:
        raise InputError(f"'{text}' is not a size", hint="write 512M or 2G")
    return int(float(found[1]) * SIZES[found[2].upper()])


def _parse_workers(value: Any) -> int | str:
    """Number of local processes, or address of a Dask scheduler."""
    text = str(value).strip()
    if text.isdecimal():
        if int(text) < 1:
            raise InputError("0 workers do nothing", hint="give 1 or more, or leave it out for threads")
        return int(text)
    found = re.fullmatch(r"(tls|tcp)://(\[[0-9a-fA-F:]+\]|[\w.-]+):(\d{1,5})", text)
    if not found or int(found[3]) >= 1 << 16:
        raise InputError(
            f"'{text}' is neither a number of processes nor the address of a Dask scheduler",
            hint="write a number, or an address such as tls://scheduler:8786",
        )
    # Both ends of such a connection run what the other sends.
    if found[1] == "tcp" and not re.fullmatch(r"localhost|127(\.\d{1,3}){3}|\[::1\]", found[2]):
        raise InputError(
            f"'{text}' would let anyone on the network run code here and on the workers",
            hint=f"set up certificates and write tls://{found[2]}:{found[3]}; tcp:// is for this machine alone",
        )
    return text


@dataclass(frozen=True, kw_only=True)
class WorkerOptions(CheckedOptions, group="running", stage="running"):
    """Option of what units of work run on; results do not depend on it.

    Attributes
    ----------
    workers : int, str, concurrent.futures.Executor or distributed.Client, optional
        What works in place of threads: processes of this machine, a Dask cluster by its address or client, or any
        executor.
    """

    workers: int | str | Any | None = option(
        None, "Workers in place of threads: a number of processes, or a Dask scheduler such as tls://host:8786.",
        least=1, metavar="N|ADDRESS", parse=_parse_workers, shown="none",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.workers is None or isinstance(self.workers, int | str) or hasattr(self.workers, "submit")):
            raise InputError(
                f"workers cannot be of type {type(self.workers).__name__}",
                where="`workers`",
                hint="give a number, the address of a Dask scheduler, its client, or an executor",
            )


@dataclass(frozen=True, kw_only=True)
class RunningOptions(WorkerOptions, group="running", stage="running"):
    """Options of what runs in units of work; results do not depend on them.

    Attributes
    ----------
    threads : int
        Worker threads.
    memory_limit : int
        Bytes the run may hold; with `workers` each of them.
    workers
        See `WorkerOptions`.
    """

    threads: int = option(
        default_factory=lambda: os.cpu_count() or 1, help="Worker threads.", least=1, shown="all processors",
    )  # fmt: skip
    memory_limit: int = option(
        2 * GIGABYTE, "Memory the run may hold, such as 512M or 2G.", least=1, metavar="SIZE", shown="2G",
        parse=parse_size, flag="--mem-limit",
    )  # fmt: skip


@named_only
@dataclass(frozen=True, kw_only=True)
class RenderOptions(RunningOptions, stage="geometry", section="output"):
    """Options of a rendered raster.

    Attributes
    ----------
    resampling : str
        'nearest', 'bilinear', 'cubic', 'lanczos', 'average' or 'rms'. All but 'nearest' average over the pixel's
        footprint where the output is coarser than the image; 'rms' the squares of the values, whose root it takes: of
        the amplitudes of radar that is their mean in power.
    tolerance : float
        Largest admissible geometric error of the lattice, in image pixels, or output pixels where those are larger;
        at 0 the lattice has a node at every pixel.
    true_ortho : bool
        Whether images show only what the surface does not hide from them.
    nodata : float, optional
        Value of unseen pixels; a mask of its own is written unless given.
    driver : str
        'COG' or 'GTiff'.
    creation : mapping
        GDAL creation options.
    overwrite : bool
        Whether outputs that exist are replaced.
    max_output : int, optional
        Bytes of the largest output that is made, with the rasters that go with it, uncompressed; see
        `geomosaic.raster.files.check_output_size`.
    threads, memory_limit, workers
        See `RunningOptions`.
    tile : int
        Width of a work unit in pixels, a multiple of the block width; the result does not depend on it.
    progress : callable, optional
        Called with (done, total, stage).
    """

    resampling: str = option(
        "bilinear", "Resampling method; rms, the root of mean squares, averages amplitudes of radar in power.",
        choices=RESAMPLING, group="geometry",
    )  # fmt: skip
    tolerance: float = option(
        0.02, "Largest geometric error of the lattice, in image pixels; at 0 it has a node at every pixel.", least=0.0,
        metavar="PIXELS", group="geometry",
    )  # fmt: skip
    true_ortho: bool = option(
        False, "Leave out what the surface model hides from an image; other images fill it.", group="geometry",
        section="mosaic", idle_with=("rule",),
    )  # fmt: skip
    nodata: float | None = option(None, "Value of unseen pixels.", shown="a mask")
    driver: str = option("COG", "File format.", choices=("COG", "GTiff"), flag="-f --driver")
    creation: Mapping[str, str] = option(
        default_factory=dict, help="Creation option of the format, as GDAL names it.", metavar="NAME=VALUE", flag="--co"
    )
    overwrite: bool = option(False, "Replace the output if it exists.", stage="running", section=None)
    max_output: int | None = option(
        None, "Largest output that is made, with its companions, uncompressed, such as 500G.", least=1, metavar="SIZE",
        shown="64G, or what is free on the disk", parse=parse_size, stage="running",
    )  # fmt: skip
    tile: int = option(2 * BLOCK_WIDTH, least=BLOCK_WIDTH, group="running", stage="running", flag=None, section=None)
    progress: Progress | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tile % BLOCK_WIDTH:
            raise InputError(
                f"{self.tile} is not a multiple of {BLOCK_WIDTH}",
                where="`tile`",
                hint=f"give {BLOCK_WIDTH} or a multiple of it",
            )

    @property
    def dem_memory(self) -> int:
        """Bytes of `memory_limit` that a DEM may hold between reads."""
        return min(256 * MEGABYTE, self._spare_memory // 4)

    @property
    def spare_memory(self) -> int:
        """Bytes that the program, its threads and the DEM leave of `memory_limit` for images and blocks."""
        return self._spare_memory - self.dem_memory

    @property
    def _spare_memory(self) -> int:
        # Never nothing: what does not fit into it is decoded to a scratch file, or done one after the other.
        return max(16 * MEGABYTE, self.memory_limit - PROGRAM - self.threads * PER_THREAD)

    def with_progress(self, progress: Progress | None) -> Self:
        """The same options with a progress callback.

        Parameters
        ----------
        progress : callable or None
        """
        return replace(self, progress=progress)

    def report(self, done: int, total: int, stage: str) -> None:
        """Call the progress callback, if there is one.

        Parameters
        ----------
        done, total : int
        stage : str
        """
        if self.progress is not None:
            self.progress(done, total, stage)


def _parse_sigmas(value: Any) -> Mapping[str, float]:
    """Standard deviations by name."""
    if not isinstance(value, Mapping):
        raise InputError(f"'{value}' is no table of names and values", hint="give names with values")
    found = {}
    for name, sigma in value.items():
        try:  # a command line gives .1, which is no number of JSON, as a text
            found[name] = math.nan if isinstance(sigma, bool) else float(sigma)
        except (TypeError, ValueError, OverflowError):
            found[name] = math.nan
        if not 0.0 <= found[name] < math.inf:
            raise InputError(f"'{name}={sigma}' is no standard deviation", hint="write a number of 0 or more")
    return found


def _parse_height_sigma(value: Any) -> float | Path:
    """Standard deviation of heights, metres, or the path of a raster of it."""
    if isinstance(value, Path):
        return value
    try:
        metres = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        metres = math.nan
        if isinstance(value, str) and value.strip():
            return given_path(value)
    if not 0.0 <= metres < math.inf:
        raise InputError(
            f"'{value}' is no standard deviation of heights", hint="give metres, 0 or more, or the path of a raster"
        )
    return metres


@dataclass(frozen=True, kw_only=True)
class OrientationSigmas(CheckedOptions):
    """Standard deviations of the orientation, as far as neither control nor tables nor the sensor tell them."""

    sigmas: Mapping[str, float] = option(
        default_factory=dict, help="Standard deviation of a parameter of the sensor, in its unit.",
        metavar="NAME=VALUE", flag="--sigma", parse=_parse_sigmas, group="input", stage="records", section="output",
        needs=("accuracy",),
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class InputSigmas(OrientationSigmas, group="input", stage="records", section="output"):
    """Standard deviations of all that places on the ground depend on."""

    sigma_px: float | None = option(
        None, "Standard deviation of places in the image.", least=0.0, metavar="PIXELS", needs=("accuracy",)
    )
    sigma_dem: Path | float | None = option(
        None, "Standard deviation of the heights: metres, or a raster of such.", metavar="METRES|FILE",
        parse=_parse_height_sigma, needs=("accuracy",),
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class UncertaintyOptions(InputSigmas, stage="records", section="output"):
    """Options of the accuracy raster."""

    accuracy: bool = option(
        False, "Write the raster of standard deviations of position.", flag="--accuracy/--no-accuracy",
        needs=("labels",), idle_with=("rule",),
    )  # fmt: skip
    accuracy_step: int = option(
        8, "Output pixels along a cell of the accuracy raster.", least=1, most=64, metavar="PIXELS", shown="8",
        needs=("accuracy",),
    )  # fmt: skip
    accuracy_target: Path | None = option(
        None, "Target that expected errors are compared with: JSON of `plan product`, or TOML.", metavar="FILE",
        needs=("accuracy",),
    )  # fmt: skip

    def refuse(self, products: str) -> None:
        """Check that no accuracy raster is asked for of products that have none.

        Raises
        ------
        InputError
        """
        if self.accuracy:
            raise InputError(f"{products} have no accuracy raster", where="`accuracy`", hint="leave it out")


@dataclass(frozen=True, kw_only=True)
class RasterOptions:
    """Options of a raster that is resampled: those of its rendering, flat or whole as `render`."""

    render: RenderOptions = field(default_factory=RenderOptions)


@dataclass(frozen=True, kw_only=True)
class OrthoOptions(RasterOptions):
    """Options of an ortho: those of its rendering and of its accuracy raster, flat or whole.

    Raises
    ------
    InputError
        A value is wrong, or an option would do nothing beside the others.
    """

    uncertainty: UncertaintyOptions = field(default_factory=UncertaintyOptions)

    def __post_init__(self) -> None:
        check_idle(self)


@dataclass(frozen=True, kw_only=True)
class SampleOptions(CheckedOptions, stage="geometry"):
    """Options of the samples of the output.

    Attributes
    ----------
    dtype : str, optional
        NumPy name of the sample type; that of the images, which must all have the same, unless given.
    convert : str
        'keep' the numbers, which the type must be able to hold; 'range' brings the whole range of an unsigned type to
        that of the other: 255 of 8 bits becomes 65535 of 16 bits.
    stretch : str, optional
        Stretch of the finished mosaic to eight bits: between percentiles ('2,98') or values ('v100,v3000').
    """

    dtype: str | None = option(
        None, "Sample type of the output, such as uint16.", choices=SAMPLE_TYPES, metavar="TYPE",
        shown="the images' own",
    )  # fmt: skip
    convert: str = option(
        "keep", "Keep the numbers, or bring the whole range of each type to that of --dtype.",
        choices=("keep", "range"), needs=("dtype",),
    )  # fmt: skip
    stretch: str | None = option(
        None, "Stretch the mosaic to 8 bits between these percentiles (2,98), or values (v100,v3000).",
        metavar="LOW,HIGH", group="colour", stage="edits", section="mosaic", idle_with=("rule",),
    )  # fmt: skip
