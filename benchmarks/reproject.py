"""The job `reproject`: a map in Lambert-93 to UTM, beside GDAL's warper, both held against PROJ at every pixel."""

from __future__ import annotations

import json
import os
from pathlib import Path

from benchmarks.process import ROOT, Command, helper
from benchmarks.result import Result
from benchmarks.rounds import Tool, take, tell
from benchmarks.setting import RAW, Setting, grid_of, once, peak

UTM = "EPSG:32631"
STEP = "0.3"
TOOLS = ("geomosaic", "GDAL")


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

    def command(name: str, source: str) -> tuple[Command, Path]:
        if name == "geomosaic":
            return ours(source, out), out
        return (s.python, script, source, str(reference), str(other), "bilinear", threads), other

    grid = grid_of(once((ours(raster, reference, "--json"),), s.work))
    tools = s.floors(reference, [raster])
    for name in TOOLS:
        words, target = command(name, raster)
        tools.append(Tool(name, (words,), (target,)))
    times = take(tools, s.rounds, s.work, tell)
    result = Result("reproject", "Lambert-93 to UTM, RGB uint8, bilinear, uncompressed", times)
    result.megapixels = grid["width"] * grid["height"] / 1e6
    result.facts["output"] = f"{grid['width']} x {grid['height']}"
    for name in TOOLS:
        result.accuracy[name] = {}
        for source, what in ((places, "places"), (raster, "errors")):
            words, target = command(name, source)
            once((words,), s.work)
            result.accuracy[name] |= json.loads(helper("lambert", what, str(target), source))
            target.unlink()
    mine, gdal = result.accuracy["geomosaic"], result.accuracy["GDAL"]
    result.at_least("times as fast as GDAL", times.ratio("GDAL", "geomosaic"), 2.5)
    result.at_least("times as fast as GDAL, processor seconds", times.ratio("GDAL", "geomosaic", "cpu"), 2.5)
    for floor in ("floor", "floor: inputs + output"):
        result.at_most(f"wall / {floor}", times.ratio("geomosaic", floor), 2.5)
    result.at_most("largest error of a place, px", mine["max_px"], 0.02)
    result.at_most("largest error of a place / GDAL's", mine["max_px"] / gdal["max_px"], 1.0)
    result.at_most("largest error of a value, grey levels", mine["max_grey"], 1)
    result.at_most("peak memory, MB", peak(result, "geomosaic"), 350)
    return result
