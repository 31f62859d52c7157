"""Processing of a block planned: time, memory, bytes and cost on given machines, from measured rates.

Rates are processor seconds of single stages, solved from runs on one machine (`python -m benchmarks.rates`). A stage
takes the longest of what its processors, its reading and its writing take: they overlap.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError
from geomosaic.options.planning import ProcessingOptions
from geomosaic.whole_files import read_text

# Rates that come with the package.
_OWN = Path(__file__).with_name("rates.json")
# Passes over the images: matching; seams; colours and rendering.
_MATCHED, _COMPARED, _DRAWN = 1, 1, 2
_MEGABYTE = 1e6
# Bytes per pixel of a photo as JPEG, where its file size is not given.
_JPEG = 0.4


@dataclass(frozen=True)
class ProcessingStage:
    """Stage of a run.

    Attributes
    ----------
    name : str
        'match', 'adjust', 'seams' or 'mosaic'.
    processor_seconds : float
    seconds : float
        By the clock.
    limited_by : str
        'processors', 'reading' or 'writing'.
    cores : int
        That work at it: those of one machine, or of all workers.
    read_bytes, written_bytes : float
    memory : float
        Bytes that each machine holds at most; in 'match' and 'adjust' the client.
    """

    name: str
    processor_seconds: float
    seconds: float
    limited_by: str
    cores: int
    read_bytes: float
    written_bytes: float
    memory: float


@dataclass(frozen=True)
class ProcessingPlan:
    """Time, memory, bytes and cost of a run.

    Attributes
    ----------
    photos : int
    pairs : int
        Of overlapping photos.
    positions : int
        Image positions of tie points.
    area : float
        Ground, m².
    pixels : float
        Of the mosaic.
    stages : tuple of ProcessingStage
    core_hours : float
        Cores that are held, whether they work or not, times hours.
    cost : float, optional
        Core hours by their price; None without one.
    misfits : tuple of str
        What does not fit into the memory or onto the disk given.
    rates : mapping
        Rates reckoned with, with the date and the machine they were measured on.
    """

    photos: int
    pairs: int
    positions: int
    area: float
    pixels: float
    stages: tuple[ProcessingStage, ...]
    core_hours: float
    cost: float | None
    misfits: tuple[str, ...]
    rates: Mapping[str, Any]

    @property
    def seconds(self) -> float:
        """Seconds by the clock, one stage after the other."""
        return sum(stage.seconds for stage in self.stages)

    @property
    def processor_seconds(self) -> float:
        """Processor seconds of all stages."""
        return sum(stage.processor_seconds for stage in self.stages)


def processing_plan(wanted: ProcessingOptions) -> ProcessingPlan:
    """Time, memory, bytes and cost of a block from photos to mosaic.

    Parameters
    ----------
    wanted : ProcessingOptions

    Raises
    ------
    InputError
        A value makes no sense, or the file of rates is none.
    """
    rates = _rates(wanted.rates)
    width, height = wanted.photo_size
    megapixels = width * height / 1e6
    along, across = wanted.overlap / 100.0, wanted.sidelap / 100.0
    area = wanted.photos * (1.0 - along) * (1.0 - across) * width * height * wanted.ground_pixel**2
    pixels = area / (wanted.ortho_pixel or wanted.ground_pixel) ** 2
    pairs = round(wanted.photos * ((2 * _neighbours(along) + 1) * (2 * _neighbours(across) + 1) - 1) / 2)
    pairs = min(pairs, wanted.photos * (wanted.photos - 1) // 2)
    positions = 0 if wanted.oriented else round(wanted.photos * rates["positions_per_photo"])
    size = wanted.photos * (wanted.photo_bytes or _JPEG * width * height)
    stages = []
    if not wanted.oriented:
        cpu = wanted.photos * megapixels * rates["features_s_per_megapixel"] + pairs * rates["match_s_per_pair"]
        memory = (rates["match_mb"] + wanted.photos * rates["match_mb_per_photo"]) * _MEGABYTE
        stages.append(_stage("match", cpu, wanted.workers, wanted, _MATCHED * size, 0.0, memory))
        memory = (rates["adjust_mb"] + positions * rates["adjust_mb_per_position"]) * _MEGABYTE
        stages.append(_stage("adjust", positions * rates["adjust_s_per_position"], 1, wanted, 0.0, 0.0, memory))
    memory = rates["mosaic_mb"] * _MEGABYTE
    if wanted.seams == "graph-cut":
        cpu = wanted.photos * rates["seams_s_per_photo"]
        stages.append(_stage("seams", cpu, wanted.workers, wanted, _COMPARED * size, 0.0, memory))
    cpu = wanted.photos * megapixels * rates["input_s_per_megapixel"] + pixels / 1e6 * rates["output_s_per_megapixel"]
    written = pixels * rates["output_bytes_per_pixel"]
    stages.append(_stage("mosaic", cpu, wanted.workers, wanted, _DRAWN * size, written, memory))
    hours = sum(stage.seconds for stage in stages) / 3600.0 * wanted.workers * wanted.cores
    misfits = [
        f"{stage.name} takes {stage.memory / 1e9:.3g} GB of memory, and there are {wanted.memory / 1e9:.3g}"
        for stage in stages
        if stage.memory > wanted.memory
    ]
    if wanted.disk is not None and written > wanted.disk:
        misfits.append(f"the mosaic takes {written / 1e9:.3g} GB of disk, and there are {wanted.disk / 1e9:.3g}")
    cost = None if wanted.core_hour is None else hours * wanted.core_hour
    return ProcessingPlan(
        wanted.photos,
        0 if wanted.oriented else pairs,
        positions,
        area,
        pixels,
        tuple(stages),
        hours,
        cost,
        tuple(misfits),
        rates,
    )


def _stage(
    name: str, cpu: float, machines: int, wanted: ProcessingOptions, read: float, written: float, memory: float
) -> ProcessingStage:
    """Stage on so many machines; one of them, the client, writes."""
    cores = machines * wanted.cores
    times = {"processors": cpu / cores}
    if wanted.bandwidth is not None:
        times["reading"] = read / (machines * wanted.bandwidth * _MEGABYTE)
        times["writing"] = written / (wanted.bandwidth * _MEGABYTE)
    longest = max(times, key=lambda kind: times[kind])
    return ProcessingStage(name, cpu, times[longest], longest, cores, read, written, memory)


def _neighbours(overlap: float) -> int:
    """Photos that overlap one on either side of it: k with k · (1 - overlap) < 1."""
    return math.ceil(1.0 / (1.0 - overlap)) - 1


def _rates(path: Path | None) -> dict[str, Any]:
    file = path or _OWN
    try:
        found = json.loads(read_text(file, "rates"))
        names = json.loads(_OWN.read_text()).keys()
        missing = sorted(names - found.keys())
    except (ValueError, AttributeError) as error:
        raise InputError("not a file of rates", where=str(file), hint="made by `python -m benchmarks.rates`") from error
    if missing:
        raise InputError(
            f"the rates lack {missing[0]}", where=str(file), hint="make them by `python -m benchmarks.rates`"
        )
    return dict(found)
