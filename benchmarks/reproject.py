"""The jobs `reproject` and `bands`: a map in Lambert-93 to UTM, beside GDAL's warper, all held against PROJ.

GDAL is told to use all cores and has more memory than its default; `gdalwarp`, where it is installed, is often an older
GDAL than the one in rasterio, and slower. It runs as told, as one would type it, and without approximation.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

from benchmarks.process import ROOT, Command, helper
from benchmarks.result import Result
from benchmarks.rounds import Tool, take, tell
from benchmarks.setting import ALL_CORES, RAW, Setting, grid_of, once, peak

UTM = "EPSG:32631"
STEP = "0.3"
OURS, WARPER = "geomosaic", "GDAL"
TOLD, EXACT, TYPED = "gdalwarp, all cores", "gdalwarp, all cores, exact", "gdalwarp, as typed"


@dataclass(frozen=True)
class Kind:
    """What is reprojected, and beside what: `gdalwarp` is left out where it is not installed."""

    name: str
    title: str
    file: str
    methods: tuple[str, ...]
    peers: tuple[str, ...]


def reproject(s: Setting) -> Result:
    """RGB of 8 bits, bilinear, uncompressed, pixels of the same size."""
    title = "Lambert-93 to UTM, RGB uint8, bilinear, uncompressed"
    result = _job(s, Kind("reproject", title, "map.tif", ("bilinear",), (WARPER, TOLD, EXACT, TYPED)))
    times, mine, gdal = result.times, result.accuracy[OURS], result.accuracy[WARPER]
    for name in (WARPER, TOLD, EXACT, TYPED):
        result.at_least(f"times as fast as {name}", times.ratio(name, OURS), 2.5)
        result.at_least(f"times as fast as {name}, processor seconds", times.ratio(name, OURS, "cpu"), 2.5)
    for floor in ("floor", "floor: inputs + output"):
        result.at_most(f"wall / {floor}", times.ratio(OURS, floor), 2.5)
    result.at_most("largest error of a place, px", mine["max_px"], 0.02)
    result.at_most("largest error of a place / GDAL's", mine["max_px"] / gdal["max_px"], 1.0)
    result.at_most("largest error of a value, grey levels", mine["max_grey"], 1)
    result.at_most("peak memory, MB", peak(result, OURS), 350)
    return result


def bands(s: Setting) -> Result:
    """Four bands of 16 bits, as of a satellite scene, bilinear and cubic."""
    methods = ("bilinear", "cubic")
    title = "Lambert-93 to UTM, 4 bands uint16, uncompressed"
    result = _job(s, Kind("bands", title, "bands.tif", methods, (WARPER, TOLD)))
    for method in methods:
        ours, told = _named(OURS, method), _named(TOLD, method)
        result.at_most(f"{method}: wall / {TOLD}", result.times.ratio(ours, told), 0.22)
        result.at_most(f"{method}: peak memory, MB", peak(result, ours), 400)
    result.at_most("largest error of a place, px", result.accuracy[OURS]["max_px"], 0.02)
    result.at_most("largest error of a value, grey levels", result.accuracy[OURS]["max_grey"], 1)
    return result


def _named(tool: str, method: str) -> str:
    return tool if method == "bilinear" else f"{tool}, {method}"


def _job(s: Setting, kind: Kind) -> Result:
    """Times of all, and of the bilinear ones places and values held against PROJ at every pixel."""
    home = s.data / "lambert"
    helper("lambert", "make", str(home), *(["--small"] if s.small else []))
    raster, places = str(home / kind.file), str(home / "col-row.tif")
    reference, out, other = s.work / "reference.tif", s.work / "ours.tif", s.work / "warped.tif"
    script, threads = str(ROOT / "benchmarks" / "reprojected.py"), str(os.cpu_count() or 1)

    def ours(source: str, target: Path, *more: str) -> Command:
        where = ("--dst-crs", UTM, "--res", STEP, *RAW)
        return (*s.programs.geomosaic, "reproject", source, *where, "-o", str(target), "--overwrite", *more)

    grid = grid_of(once((ours(raster, reference, "--json"),), s.work))

    def command(name: str, source: str, method: str = "bilinear") -> tuple[Command | None, Path]:
        if name == OURS:
            return ours(source, out, "--resampling", method), out
        if name == WARPER:
            return (s.python, script, source, str(reference), str(other), method, threads), other
        more = {TOLD: ALL_CORES, EXACT: (*ALL_CORES, "-et", "0"), TYPED: ()}[name]
        return s.gdalwarp(grid, [source], other, "-t_srs", UTM, "-r", method, *more), other

    tools = s.floors(reference, [raster])
    for method in kind.methods:
        for name in (OURS, *kind.peers):
            words, target = command(name, raster, method)
            if words:
                tools.append(Tool(_named(name, method), (words,), (target,)))
            if name == OURS and method == "bilinear":
                tools.append(tools[-1].on_one_core)
    times = take(tools, s.rounds, s.work, tell)
    result = Result(kind.name, kind.title, times)
    result.megapixels = grid["width"] * grid["height"] / 1e6
    result.facts = {"output": f"{grid['width']} x {grid['height']}", "absent": s.absent("gdalwarp")}
    for name in (OURS, *kind.peers):
        if name in times.costs and name != TYPED:
            result.accuracy[name] = {}
            for source, what in ((places, "places"), (raster, "errors")):
                words, target = command(name, source)
                assert words  # it ran above
                once((words,), s.work)
                result.accuracy[name] |= json.loads(helper("lambert", what, str(target), source))
                target.unlink()
    reference.unlink()
    return result
