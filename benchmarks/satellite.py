"""The jobs `rpc` and `multispectral`: what satellites send, uncompressed, beside gdalwarp on all cores."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmarks.process import Command, helper
from benchmarks.result import Result
from benchmarks.rounds import Tool, take, tell
from benchmarks.scene import CRS, SATELLITE_PIXEL
from benchmarks.setting import ALL_CORES, RAW, Setting, grid_of, once, peak

OURS, WARP, EXACT = "geomosaic", "gdalwarp -et 0.125", "gdalwarp -et 0"
LAEA = "EPSG:3035"
PIXEL = 10.0


def rpc(s: Setting) -> Result:
    """Ortho of one band of 16 bits by its RPCs over a DEM."""
    size, home, dem = ("--small",) if s.small else (), s.data / "rpc", str(s.data / "dem.tif")
    helper("scanned", "rpc", str(home), *size)
    scene, places = str(home / "scene.tif"), str(home / "coordinates.tif")
    reference, out, other = s.work / "reference.tif", s.work / "ours.tif", s.work / "warped.tif"

    def ours(image: str, target: Path, *more: str) -> Command:
        place = ("--dem", dem, "--dem-heights", "ellipsoidal", "--dst-crs", CRS, "--res", repr(SATELLITE_PIXEL))
        return (
            *s.programs.geomosaic, "ortho", image, "--sensor", "rpc", *place, *RAW, "-o", str(target), "--overwrite",
            *more,
        )  # fmt: skip

    grid = grid_of(once((ours(scene, reference, "--json"),), s.work))

    def warp(image: str, where: dict[str, Any], error: str, method: str = "bilinear") -> Command | None:
        geometry = ("-rpc", "-to", f"RPC_DEM={dem}", "-et", error, "-t_srs", CRS)
        return s.gdalwarp(where, [image], other, *geometry, "-r", method, *ALL_CORES)

    # One block in the middle: what it takes to start.
    left, bottom, right, top = grid["bounds"]
    x, y = (left + right) / 2, (bottom + top) / 2
    block = [repr(round(side)) for side in (x - 128, y - 128, x + 128, y + 128)]
    tools = [*s.floors(reference, [scene, dem]), Tool(OURS, (ours(scene, out),), (out,))]
    tools += [
        tools[-1].on_one_core,
        Tool(f"{OURS}, one block", (ours(scene, out, "--bounds", *block),), (out,)),
        Tool(f"{OURS}, cubic", (ours(scene, out, "--resampling", "cubic"),), (out,)),
    ]
    for name, method in ((WARP, "bilinear"), (f"{WARP}, cubic", "cubic")):
        words = warp(scene, grid, "0.125", method)
        tools += [Tool(name, (words,), (other,))] if words else []
    times = take(tools, s.rounds, s.work, tell)
    reference.unlink()
    title = f"ortho of {scene_size(grid)} pixels, one band uint16 with RPCs and a DEM, bilinear and cubic, uncompressed"
    result = Result("rpc", title, times)
    result.megapixels = grid["width"] * grid["height"] / 1e6
    result.facts = {"output": scene_size(grid), "absent": s.absent("gdalwarp")}
    # Off the middle, a 64th of the output: enough to be judged at every pixel.
    side = min(grid["width"], grid["height"]) * SATELLITE_PIXEL / 8
    corner = [repr(round(edge)) for edge in (x + 1.5 * side, y - 2.5 * side, x + 2.5 * side, y - 1.5 * side)]
    part = grid_of(once((ours(places, out, "--bounds", *corner, "--json"),), s.work))
    for name, command, target in (
        (OURS, None, out),
        (WARP, warp(places, part, "0.125"), other),
        (EXACT, warp(places, part, "0"), other),
    ):
        if command:
            once((command,), s.work)
        if target.exists():
            result.accuracy[name] = json.loads(helper("accuracy", str(target), dem, "rational", *size))
            target.unlink()
    for name in (OURS, f"{OURS}, cubic"):
        result.at_most(f"{name}: wall / {name.replace(OURS, WARP)}", times.ratio(name, name.replace(OURS, WARP)), 0.20)
        result.at_most(f"{name}: peak memory, MB", peak(result, name), 400)
    for floor in ("floor", "floor: inputs + output"):
        result.at_most(f"wall / {floor}", times.ratio(OURS, floor), 2.2)
    result.at_most("largest geometric error, px", result.accuracy[OURS]["max_px"], 0.005)
    result.at_least("T1 / (2 T2) after start-up", times.efficiency(OURS, f"{OURS}, one block"), 0.90)
    return result


def multispectral(s: Setting) -> Result:
    """Thirteen bands of 10, 20 and 60 m to one grid in another CRS."""
    home = s.data / "tile"
    helper("scanned", "tile", str(home), *(["--small"] if s.small else []))
    bands = sorted(str(path) for path in home.glob("B*.tif"))
    reference, out, stack, other = (s.work / f"{name}.tif" for name in ("reference", "ours", "stack", "warped"))

    def ours(target: Path, *more: str) -> Command:
        where = ("--dst-crs", LAEA, "--res", repr(PIXEL), *RAW)
        return (*s.programs.geomosaic, "reproject", *bands, *where, "-o", str(target), "--overwrite", *more)

    grid = grid_of(once((ours(reference, "--json"),), s.work))
    tools = [*s.floors(reference, bands), Tool(OURS, (ours(out),), (out,))]
    tools.append(tools[-1].on_one_core)
    build, virtual = s.programs.peer("gdalbuildvrt"), stack.with_suffix(".vrt")
    where = ("-t_srs", LAEA, "-r", "bilinear", *ALL_CORES)
    warp = s.gdalwarp(grid, [str(virtual)], other, *where)
    if build and warp:
        one = (build, "-q", "-overwrite", "-separate", "-resolution", "highest", "-r", "bilinear", str(virtual), *bands)
        tools.append(Tool("gdalbuildvrt + gdalwarp", (one, warp), (virtual, other)))
    times = take(tools, s.rounds, s.work, tell)
    reference.unlink()
    result = Result("multispectral", "13 bands uint16 of 10, 20 and 60 m, UTM to LAEA, 10 m, bilinear", times)
    result.megapixels = grid["width"] * grid["height"] / 1e6
    result.facts = {"output": f"{scene_size(grid)} x 13 bands", "absent": s.absent("gdalbuildvrt", "gdalwarp")}
    result.at_most("wall / gdalbuildvrt + gdalwarp", times.ratio(OURS, "gdalbuildvrt + gdalwarp"), 0.3)
    result.at_most("peak memory, MB", peak(result, OURS), 500)
    return result


def scene_size(grid: dict[str, int]) -> str:
    """Size in words."""
    return f"{grid['width']} x {grid['height']}"
