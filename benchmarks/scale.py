"""Cost of the engine that runs units of work: threads, processes of this machine, a Dask cluster.

python -m benchmarks.scale PART [--small]      prints JSON; PART is units, million, weak or mosaic

- units: cost of a unit that does nothing, and of one that gives a megabyte back
- million: a million units that do nothing, by a Dask cluster, and the memory of its scheduler
- weak: a mosaic by one worker of one thread, and one of twice the photos by two; scheduler and client run on the same
  processors, of which there is one for each worker, and for comparison all for the one worker
- mosaic: the sample drawn to two gigapixels by two threads, two processes, and two workers of one thread

A cluster is a scheduler and workers with nannies, each a process of its own. Processor seconds are those of all of
them and of the client; what a cluster takes while nothing is done, as long as the work lasts, is told by itself.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.machine import effective_cores
from benchmarks.process import ROOT, Cost, helper
from benchmarks.result import Result
from benchmarks.rounds import Times, tell
from benchmarks.setting import Setting

RIGS = ROOT / "tests" / "rigs"
SAMPLE = ROOT / "data" / "sample"
MEGABYTE = 1 << 20


class Usage:
    """Processor seconds of processes with all that they started, and the memory of one."""

    def __init__(self, pids: list[int]) -> None:
        import psutil

        self._processes = [psutil.Process(pid) for pid in {os.getpid(), *pids}]

    @property
    def seconds(self) -> float:
        """Processor seconds so far."""
        own = {one.pid: one for process in self._processes for one in (process, *process.children(recursive=True))}
        times = [one.cpu_times() for one in own.values()]
        # Children that have ended count with their parent.
        ended = sum(one.children_user + one.children_system for one in times)
        return float(sum(one.user + one.system for one in times) + ended)


def spent(usage: Usage, work: Callable[[], Any]) -> tuple[float, float, Any]:
    """Wall and processor seconds of work, and its result."""
    before, started = usage.seconds, time.perf_counter()
    made = work()
    return time.perf_counter() - started, usage.seconds - before, made


@contextmanager
def dask(workers: int) -> Iterator[tuple[Any, Usage, int]]:
    """Client of a cluster, usage of it all, and the scheduler's process."""
    from worker_rig import cluster

    with tempfile.TemporaryDirectory() as folder, cluster(Path(folder), workers) as (client, started):
        yield client, Usage([one.pid for one in started]), started[0].pid


def nothing(item: int) -> None:
    """No work."""


def megabyte(item: int) -> bytes:
    """A megabyte, without work."""
    return bytes(MEGABYTE)


def run(function: Callable[[int], Any], count: int, options: Any) -> None:
    """Work of so many units."""
    from geomosaic.execution.units import map_units

    for _ in map_units(function, range(count), options):
        pass


def units(small: bool) -> dict[str, Any]:
    """Cost of a unit, microseconds of wall and processor."""
    import benchmarks.scale as this  # the functions as other processes find them
    from geomosaic.execution.units import workers_for
    from geomosaic.options.render import RenderOptions

    found: dict[str, Any] = {}

    def measured(name: str, options: Any, usage: Usage) -> None:
        with workers_for(options):
            run(this.nothing, 500, options)  # workers are there, and know the function
            idle = spent(usage, partial(time.sleep, 4.0))
            rate = idle[1] / idle[0]
            for what, function, count in (
                ("nothing", this.nothing, 5_000 if small else 50_000),
                ("megabyte", this.megabyte, 100 if small else 500),
            ):
                wall, cpu, _ = spent(usage, partial(run, function, count, options))
                found[f"{name}, {what}"] = {
                    "wall_us": 1e6 * wall / count, "cpu_us": 1e6 * (cpu - rate * wall) / count, "idle_share": rate,
                }  # fmt: skip

    measured("threads", RenderOptions(threads=2), Usage([]))
    measured("processes", RenderOptions(workers=2), Usage([]))
    with dask(2) as (client, usage, _):
        measured("dask", RenderOptions(workers=client), usage)
    return found


def million(small: bool) -> dict[str, Any]:
    """Units that do nothing by a Dask cluster, and the memory of its scheduler."""
    import psutil

    import benchmarks.scale as this
    from geomosaic.execution.units import map_units
    from geomosaic.options.render import RenderOptions

    count, most = 20_000 if small else 1_000_000, 0
    with dask(2) as (client, usage, scheduler):
        process = psutil.Process(scheduler)
        before = process.memory_info().rss

        def work() -> None:
            nonlocal most
            for done, _ in map_units(this.nothing, range(count), RenderOptions(workers=client)):
                if done % 5000 == 0:
                    most = max(most, process.memory_info().rss)

        wall, cpu, _ = spent(usage, work)
    return {
        "units": count, "wall_us": 1e6 * wall / count, "cpu_us": 1e6 * cpu / count,
        "scheduler_MB": most / MEGABYTE, "scheduler_at_rest_MB": before / MEGABYTE,
    }  # fmt: skip


def weak(small: bool) -> dict[str, Any]:
    """Mosaic by one worker, and one of twice the photos by two: time of the units' stage."""
    from worker_rig import small_block

    found: dict[str, Any] = {}
    strips, each = (1, 3) if small else (6, 10)
    place = {"resolution": 0.1 if small else 0.03, "vectors": False, "balance": False, "creation": {"COMPRESS": "JPEG"}}
    import geomosaic as gm

    processors = sorted(os.sched_getaffinity(0))[:2]
    with tempfile.TemporaryDirectory() as folder:
        for name, workers, held in (("1", 1, 1), ("1, both processors", 1, 2), ("2", 2, 2)):
            block = small_block(Path(folder) / name, strips * workers, each)
            os.sched_setaffinity(0, processors[:held])
            with dask(workers) as (client, usage, _):
                warm = {**place, "resolution": 10 * place["resolution"]}
                gm.mosaic(block, Path(folder) / "warm.tif", workers=client, overwrite=True, **warm)
                output = Path(folder) / "m.tif"
                wall, cpu, made = spent(
                    usage, partial(gm.mosaic, block, output, workers=client, overwrite=True, **place)
                )
                grid, run_of = made.grid, made.run
                found[name] = {
                    "wall": wall, "cpu": cpu, "mosaic": made.seconds["mosaic"], "units": run_of.units,
                    "megapixels": grid.width * grid.height / 1e6, "core_seconds": run_of.core_hours * 3600.0,
                    "worker_cpu": sum(one.processor_seconds for one in run_of.workers.values()),
                }  # fmt: skip
    one, free, two = found["1"], found["1, both processors"], found["2"]
    per_pixel = [each["mosaic"] / each["megapixels"] for each in (one, free, two)]
    found["efficiency"] = per_pixel[0] / (2.0 * per_pixel[2])
    found["efficiency_beside_both_processors"] = per_pixel[1] / (2.0 * per_pixel[2])
    found["efficiency_of_processor_time"] = (
        one["worker_cpu"] / one["megapixels"] / (two["worker_cpu"] / two["megapixels"])
    )
    return found


def mosaic(small: bool) -> dict[str, Any]:
    """The sample, drawn much finer than it is, by threads, processes and a cluster; and whether the bytes are equal."""
    import geomosaic as gm
    from geomosaic.digests import sha256

    photos, table = sorted((SAMPLE / "photos").glob("*.jpg")), SAMPLE / "exterior.csv"
    inputs: dict[str, Any] = {"camera": SAMPLE / "camera.toml", "exterior": table, "dem": SAMPLE / "dem.tif"}
    block = gm.Block(photos, "frame", crs="EPSG:32633", heights="egm96", **inputs)
    resolution = 0.5 if small else 0.0394
    place = {"resolution": resolution, "vectors": False, "creation": {"COMPRESS": "JPEG"}, "max_output": 1 << 40}
    found: dict[str, Any] = {}
    digests = set()
    with tempfile.TemporaryDirectory() as folder, dask(2) as (client, cluster_usage, _):
        gm.mosaic(block, Path(folder) / "m.tif", workers=client, **{**place, "resolution": 2.0})
        idle = spent(cluster_usage, partial(time.sleep, 4.0))
        for name, how, usage in (
            ("threads", {"threads": 2}, Usage([])),
            ("processes", {"workers": 2}, Usage([])),
            ("dask", {"workers": client}, cluster_usage),
        ):
            output = Path(folder) / "m.tif"
            wall, cpu, made = spent(usage, partial(gm.mosaic, block, output, overwrite=True, **place, **how))
            digests.add(sha256(output))
            grid = made.grid
            found[name] = {
                "wall": wall, "cpu": cpu, "idle": idle[1] / idle[0] * wall if name == "dask" else 0.0,
                "units": -(-grid.width // 2048) * -(-grid.height // 512), "gigapixels": grid.width * grid.height / 1e9,
            }  # fmt: skip
    threads = found["threads"]
    for name in ("processes", "dask"):
        its = found[name]
        its["cpu_over_threads"] = its["cpu"] / threads["cpu"]
        its["wall_over_threads"] = its["wall"] / threads["wall"]
        its["overhead_ms"] = 1e3 * (its["cpu"] - its["idle"] - threads["cpu"]) / its["units"]
    found["same_bytes"] = len(digests) == 1
    return found


PARTS = {"units": units, "million": million, "weak": weak, "mosaic": mosaic}


def rows(told: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Measures of the parts, a flat row for each thing that was measured and one for what is said of a whole part."""
    found: dict[str, dict[str, Any]] = {}
    for part, its in told.items():
        found |= {f"{part}: {name}": values for name, values in its.items() if isinstance(values, dict)}
        whole = {name: value for name, value in its.items() if not isinstance(value, dict)}
        found |= {part: whole} if whole else {}
    return found


def scale(s: Setting) -> Result:
    """All parts, each in a process of its own."""
    times, told, cores = Times(), dict[str, Any](), [effective_cores()]
    for part in PARTS:
        started = time.perf_counter()
        told[part] = json.loads(helper("scale", part, *(["--small"] if s.small else [])))
        times.costs[part] = [Cost(time.perf_counter() - started, 0.0, 0.0)]
        cores.append(effective_cores())
        tell(f"  {part}: {told[part]}")
    times.cores.append(min(cores))
    result = Result("scale", "units of work on threads, processes and a Dask cluster", times)
    result.quality = rows(told)
    result.at_most("Dask, unit that does nothing, us of processor", told["units"]["dask, nothing"]["cpu_us"], 200.0)
    result.at_most("Dask, unit of a megabyte, ms of processor", told["units"]["dask, megabyte"]["cpu_us"] / 1e3, 5.0)
    result.at_most("many units, us of processor each", told["million"]["cpu_us"], 200.0)
    result.at_most("many units, memory of the scheduler, MB", told["million"]["scheduler_MB"], 1024.0)
    result.at_least("weak scaling, 1 to 2 workers, a processor for each", told["weak"]["efficiency"], 0.85)
    result.at_most("mosaic by Dask, ms of processor a unit", told["mosaic"]["dask"]["overhead_ms"], 5.0)
    result.at_most("mosaic by Dask / threads, wall", told["mosaic"]["dask"]["wall_over_threads"], 1.1)
    return result


if __name__ == "__main__":
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("part", choices=PARTS)
    words.add_argument("--small", action="store_true")
    wanted = words.parse_args()
    sys.path[:0] = [str(RIGS), str(ROOT)]
    print(json.dumps(PARTS[wanted.part](wanted.small)))
