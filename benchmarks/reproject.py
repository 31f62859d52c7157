"""The job `reproject`: a map in Lambert-93 to UTM, beside GDAL's warper, all held against PROJ at every pixel.

GDAL is told to use all cores and has more memory than its default; `gdalwarp`, where it is installed, is often an older
GDAL than the one in rasterio, and slower. It runs as told, as one would type it, and without approximation.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

from benchmarks.process import ROOT, Command, helper
from benchmarks.result import Result
from benchmarks.rounds import Tool, take, tell
from benchmarks.setting import BLOCKS, RAW, Setting, grid_of, once, peak

UTM = "EPSG:32631"
STEP = "0.3"
OURS, WARPER = "geomosaic", "GDAL"
TOLD, EXACT, TYPED = "gdalwarp, all cores", "gdalwarp, all cores, exact", "gdalwarp, as typed"


def reproject(s: Setting) -> Result:
    """RGB of 8 bits, bilinear, uncompressed, pixels of the same size."""
    home = s.data / "lambert"
    helper("lambert", "make", str(home), *(["--small"] if s.small else []))
    raster, places = str(home / "map.tif"), str(home / "col-row.tif")
    reference, out, other = s.work / "reference.tif", s.work / "ours.tif", s.work / "warped.tif"
    script, threads = str(ROOT / "benchmarks" / "reprojected.py"), str(os.cpu_count() or 1)

    def ours(source: str, target: Path, *more: str) -> Command:
        where = ("--dst-crs", UTM, "--res", STEP, *RAW)
        return (*s.programs.geomosaic, "reproject", source, *where, "-o", str(target), "--overwrite", *more)

    grid = grid_of(once((ours(raster, reference, "--json"),), s.work))
    width, height = grid["width"], grid["height"]
    typed = (
        s.programs.peer("gdalwarp") or "", "-q", "-overwrite", "-t_srs", UTM, "-te", *map(repr, grid["bounds"]),
        "-ts", str(width), str(height), "-r", "bilinear", *(word for block in BLOCKS for word in ("-co", block)),
    )  # fmt: skip
    told = ("-multi", "-wo", "NUM_THREADS=ALL_CPUS", "-wm", "256", "--config", "GDAL_CACHEMAX", "256")

    def command(name: str, source: str) -> tuple[Command, Path]:
        if name == OURS:
            return ours(source, out), out
        if name == WARPER:
            return (s.python, script, source, str(reference), str(other), "bilinear", threads), other
        more = {TOLD: told, EXACT: (*told, "-et", "0"), TYPED: ()}[name]
        return (*typed, *more, source, str(other)), other

    names = (OURS, WARPER, TOLD, EXACT, TYPED) if typed[0] else (OURS, WARPER)
    tools = s.floors(reference, [raster])
    for name in names:
        words, target = command(name, raster)
        tools.append(Tool(name, (words,), (target,)))
    times = take(tools, s.rounds, s.work, tell)
    result = Result("reproject", "Lambert-93 to UTM, RGB uint8, bilinear, uncompressed", times)
    result.megapixels = width * height / 1e6
    result.facts["output"] = f"{width} x {height}"
    for name in names[:4]:
        result.accuracy[name] = {}
        for source, what in ((places, "places"), (raster, "errors")):
            words, target = command(name, source)
            once((words,), s.work)
            result.accuracy[name] |= json.loads(helper("lambert", what, str(target), source))
            target.unlink()
    mine, gdal = result.accuracy[OURS], result.accuracy[WARPER]
    for name in names[1:]:
        result.at_least(f"times as fast as {name}", times.ratio(name, OURS), 2.5)
        result.at_least(f"times as fast as {name}, processor seconds", times.ratio(name, OURS, "cpu"), 2.5)
    for floor in ("floor", "floor: inputs + output"):
        result.at_most(f"wall / {floor}", times.ratio(OURS, floor), 2.5)
    result.at_most("largest error of a place, px", mine["max_px"], 0.02)
    result.at_most("largest error of a place / GDAL's", mine["max_px"] / gdal["max_px"], 1.0)
    result.at_most("largest error of a value, grey levels", mine["max_grey"], 1)
    result.at_most("peak memory, MB", peak(result, OURS), 350)
    return result
