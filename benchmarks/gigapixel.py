"""Mosaic of many gigapixels as a grid of JPEG COGs: memory over time, stopped twice and gone on with.

python -m benchmarks.gigapixel FOLDER [GIGAPIXELS [MEMORY_MB [TILE_PX]]]      prints JSON, removes the mosaic

The twelve photos of the sample, six times as fine and with noise, drawn finer still. The first run is killed (SIGKILL)
when a quarter of the tiles are written, the second one is interrupted (SIGINT) at six tenths; the third one goes on to
the end. Then every tile is opened and its checksum compared with its STAC item's.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.machine import effective_cores
from benchmarks.process import ROOT, Cost, Programs, helper
from benchmarks.result import Result
from benchmarks.rounds import Times, tell
from benchmarks.setting import Setting

SAMPLE = ROOT / "data" / "sample"
# Of the block's 1,994 m x 1,562 m, in square metres.
AREA = 3.116e6
STOPS = ((0.25, signal.SIGKILL), (0.6, signal.SIGINT))
FINER, NOISE = 6, 3.0


def finer_photos(folder: Path) -> tuple[str, ...]:
    """Photos of the sample enlarged, with noise that JPEG has to keep, and the flags of their block."""
    import cv2
    import numpy as np
    import rasterio

    for name, old, new in (
        ("camera.toml", "[1200, 900]", f"[{1200 * FINER}, {900 * FINER}]"), ("exterior.csv", ".jpg,", ".tif,"),
    ):  # fmt: skip
        (folder / name).write_text((SAMPLE / name).read_text().replace(old, new))
    chance, made = np.random.default_rng(3), list[str]()
    form = {
        "driver": "GTiff", "width": 1200 * FINER, "height": 900 * FINER, "count": 3, "dtype": "uint8", "tiled": True,
        "compress": "jpeg", "photometric": "ycbcr",
    }  # fmt: skip
    for photo in sorted((SAMPLE / "photos").glob("*.jpg")):
        with rasterio.open(photo) as small:
            bands = [cv2.resize(band, None, fx=FINER, fy=FINER, interpolation=cv2.INTER_CUBIC) for band in small.read()]
        noise = chance.normal(0.0, NOISE, bands[0].shape).astype(np.float32)
        made.append(str(folder / f"{photo.stem}.tif"))
        with rasterio.open(made[-1], "w", **form) as large:
            large.write(np.clip(np.stack(bands) + noise, 0.0, 255.0).astype(np.uint8))
    tables = ("--camera", str(folder / "camera.toml"), "--exterior", str(folder / "exterior.csv"))
    ground = ("--crs", "EPSG:32633", "--heights", "egm96", "--dem", str(SAMPLE / "dem.tif"))
    return (*made, "--sensor", "frame", *tables, *ground)


def measured(folder: Path, gigapixels: float = 20.0, memory: int = 1500, tile: int = 16384) -> dict[str, Any]:
    """Each run's seconds and memory, and the mosaic that came out."""
    output, pixel = folder / "gigapixel.vrt", f"{(AREA / gigapixels / 1e9) ** 0.5:.5f}"
    command = [
        *Programs.found(None).geomosaic, "mosaic", *finer_photos(folder), "--res", pixel, "-o", str(output),
        "--tiling", f"{tile}px", "--co", "COMPRESS=JPEG", "--mem-limit", f"{memory}M",
        "--max-output", f"{int(10 * gigapixels) + 10}G", "--json",
    ]  # fmt: skip
    tiles = int(gigapixels * 1e9 / tile**2) + 1
    runs = [watched(command, folder, int(share * tiles), how) for share, how in STOPS]
    runs.append(watched(command, folder))
    return {"runs": runs, **checked(output), "limit_MB": memory}


def watched(command: list[str], folder: Path, stop_at: int | None = None, how: signal.Signals | None = None) -> Any:
    """One run, stopped with a signal when so many tiles are written; memory is looked at every two seconds."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background of a shell, and so by children
    tell(f"  until {'the end' if how is None else f'{stop_at} tiles, then {how.name}'}")
    records, sizes = folder / "gigapixel-tiles" / ".geomosaic", list[float]()
    before, started, used = len(list(records.glob("*-r*.json"))), time.perf_counter(), _children()
    with (folder / "out.json").open("w") as out, (folder / "err.txt").open("w") as err:
        child = subprocess.Popen(command, stdout=out, stderr=err, stdin=subprocess.DEVNULL)
        while child.poll() is None:
            sizes.append(_resident(child.pid))
            if how is not None and len(list(records.glob("*-r*.json"))) >= (stop_at or 0):
                child.send_signal(how)
                child.wait()
            time.sleep(2.0)
    if how is None and child.returncode:
        raise SystemExit("".join((folder / name).read_text()[-4000:] for name in ("out.json", "err.txt")))
    # The second half against the first: flat memory does not grow with what is done.
    halves = [max(part, default=0.0) for part in (sizes[: len(sizes) // 2], sizes[len(sizes) // 2 :])]
    kept = json.loads((folder / "out.json").read_text())["tiles_kept"] if how is None else before
    after = len(list(records.glob("*-r*.json")))
    return {
        "exit": child.returncode, "tiles_before": before, "tiles_after": after, "rendered": after - kept,
        "wall": time.perf_counter() - started, "cpu": _children() - used, "peak_MB": max(sizes, default=0.0),
        "peak_of_first_half_MB": halves[0], "peak_of_second_half_MB": halves[1],
    }  # fmt: skip


def checked(output: Path) -> dict[str, Any]:
    """Bytes on the disk, and tiles that do not open or are not those of their STAC items."""
    import rasterio

    folder, wrong, shown = output.parent / f"{output.stem}-tiles", list[str](), 0
    for item in sorted(folder.glob("*.stac.json")):
        path = item.with_name(f"{item.name.removesuffix('.stac.json')}.tif")
        asset = json.loads(item.read_text())["assets"]["mosaic"]
        with path.open("rb") as file:
            same = asset["file:checksum"] == "1220" + hashlib.file_digest(file, "sha256").hexdigest()
        with rasterio.open(path) as tile:
            shown += tile.width * tile.height
            same = same and tile.compression.name == "jpeg" and bool(tile.overviews(1))
        wrong += [] if same else [path.name]
    with rasterio.open(output) as whole:
        small, size = whole.read(out_shape=(whole.count, 512, 512)), (whole.width, whole.height)
    disk = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return {
        "width": size[0], "height": size[1], "wrong_tiles": wrong, "tile_pixels": shown, "mean": float(small.mean()),
        "GB": disk / 1e9,
    }  # fmt: skip


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _resident(pid: int) -> float:
    """Resident memory of a process, MB; 0 where the system does not tell."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
    except (OSError, ValueError, IndexError):
        return 0.0


def gigapixel(s: Setting) -> Result:
    """Twenty gigapixels, or a twentieth of one."""
    folder, times = s.work / "gigapixel", Times()
    before = effective_cores()
    told = json.loads(helper("gigapixel", str(folder), *(["0.05", "1500", "2048"] if s.small else [])))
    runs = told["runs"]
    for name, run in zip(("until SIGKILL", "until SIGINT", "to the end"), runs, strict=True):
        times.costs[name] = [Cost(run["wall"], run["cpu"], run["peak_MB"])]
    times.cores.append(min(before, effective_cores()))
    result = Result("gigapixel", f"{told['width']} x {told['height']} pixels as a grid of JPEG COGs", times)
    whole = {name: value for name, value in told.items() if name not in ("runs", "wrong_tiles")}
    result.quality = {**dict(zip(times.costs, runs, strict=True)), "mosaic": whole}
    result.at_most("peak memory, share of the limit", max(run["peak_MB"] for run in runs) / told["limit_MB"], 1.2)
    rendered = sum(run["rendered"] for run in runs)
    result.at_most("tiles rendered twice", rendered - runs[-1]["tiles_after"], 0)
    result.at_most("tiles that are not those of their items", len(told["wrong_tiles"]), 0)
    return result


if __name__ == "__main__":
    place = Path(sys.argv[1])
    place.mkdir(parents=True)
    try:
        print(json.dumps(measured(place, *[float(text) for text in sys.argv[2:3]], *map(int, sys.argv[3:]))))
    finally:
        shutil.rmtree(place)
