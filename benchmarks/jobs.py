"""The jobs: which tools make the same thing from the same data, and what we want of ours."""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from benchmarks.process import ENTRY, ROOT, Command, helper
from benchmarks.radar import sar
from benchmarks.reproject import STEP, UTM, bands, reproject
from benchmarks.result import Result
from benchmarks.rounds import Tool, take, tell
from benchmarks.satellite import multispectral, rpc
from benchmarks.scene import CRS, RESOLUTION, tiny_bounds
from benchmarks.setting import BLOCKS, RAW, Setting, grid_of, once, peak, shape, warm

LIMIT_MB = 640
REPROJECTED = "EPSG:2154"


def ortho(s: Setting) -> Result:
    """Frame ortho of RGB uint8 with a DEM."""
    reference, out, other = s.work / "reference.tif", s.work / "ours.tif", s.folder("oty")
    methods = ("bilinear", "cubic")
    again = ("--overwrite",)
    once((s.ours("ortho", "single", reference, *RAW, "--resampling", "cubic", *again),), s.work)
    grid = grid_of(once((s.ours("ortho", "single", reference, *RAW, *again),), s.work))
    tools = s.floors(reference, [*s.photos("single"), str(s.data / "dem.tif")])
    for method in methods:
        command = s.ours("ortho", "single", out, *RAW, "--resampling", method)
        tools.append(Tool(f"geomosaic {method}", (command,), (out,)))
        tools.append(tools[-1].on_one_core)
    # What it takes to start: an output of one block.
    block = s.ours("ortho", "single", out, *RAW, "--bounds", *map(repr, tiny_bounds()))
    tools.append(Tool("geomosaic, one block", (block,), (out,)))
    for method in methods:
        peer = s.oty("single", other, method)
        if peer:
            tools.append(Tool(f"orthority {method}", (peer,), (other,)))
    times = take(tools, s.rounds, s.work, tell)
    reference.unlink()
    result = Result("ortho", f"frame ortho, {shape(s.scene('single'))} photo, RGB uint8, uncompressed", times)
    result.megapixels = grid["width"] * grid["height"] / 1e6
    result.facts["output"] = f"{grid['width']} x {grid['height']}"
    result.accuracy = geometry(s, methods)
    for method, most in (("bilinear", 2.0), ("cubic", 3.0)):
        for floor in ("floor", "floor: inputs + output"):
            result.at_most(f"{method}: wall / {floor}", times.ratio(f"geomosaic {method}", floor), most)
        result.at_most(f"{method}: peak memory, MB", peak(result, f"geomosaic {method}"), 400)
        result.at_least(
            f"{method}: times as fast as orthority", times.ratio(f"orthority {method}", f"geomosaic {method}"), 5.0
        )
        result.at_most(
            f"{method}: largest geometric error, px",
            (result.accuracy.get(f"geomosaic {method}") or {}).get("max_px"),
            0.05,
        )
        result.at_most(
            f"{method}: RMS geometric error, px", (result.accuracy.get(f"geomosaic {method}") or {}).get("rms_px"), 0.01
        )
        efficiency = times.efficiency(f"geomosaic {method}", "geomosaic, one block")
        result.at_least(f"{method}: T1 / (2 T2) after start-up", efficiency, 0.90)
    return result


def geometry(s: Setting, methods: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """Errors of each tool's geometry against the camera as that tool treats it, on a steep corner of the photo."""
    bounds = [repr(side) for side in json.loads((s.data / "coordinates" / "bounds.json").read_text())]
    crop, out, other = s.data / "coordinates" / "dem.tif", s.work / "coordinates.tif", s.folder("oty")
    size = ("--small",) if s.small else ()
    found = {}
    for method in methods:
        once((s.ours("ortho", "coordinates", out, *RAW, "--resampling", method, "--bounds", *bounds),), s.work)
        found[f"geomosaic {method}"] = helper("accuracy", str(out), str(s.data / "dem.tif"), "rigorous", *size)
        out.unlink()
        peer = s.oty("coordinates", other, method, crop)
        if peer:
            once((peer,), s.work)
            path = next(other.glob("*.tif"))
            found[f"orthority {method}"] = helper("accuracy", str(path), str(crop), "planar", *size)
            path.unlink()
    return {name: json.loads(text) for name, text in found.items()}


def mosaic(s: Setting) -> Result:
    """Twelve photos to one balanced, feathered mosaic; the peers only merge."""
    reference, out, other, merged = (
        s.work / "reference.tif",
        s.work / "ours.tif",
        s.folder("oty"),
        s.work / "merged.tif",
    )
    grid = grid_of(once((s.ours("mosaic", "strips", reference, *RAW, "--overwrite"),), s.work))
    tools = s.floors(reference, [*s.photos("strips"), str(s.data / "dem.tif")])
    beside = tuple(s.work / f"ours{end}" for end in (".tif", "-labels.tif", ".gpkg", ".stac.json"))
    # Peers balance nothing; a gain and an offset per photo are what is compared, not the search for falloff as well.
    command = s.ours("mosaic", "strips", out, *RAW, "--colour", "gain")
    tools.append(Tool("geomosaic mosaic", (command,), beside))
    tools.append(tools[-1].on_one_core)
    # What the peers make is the mosaic, and nothing that says how it was made.
    tools.append(Tool("geomosaic mosaic, pixels only", ((*command, "--no-labels", "--no-records"),), (out,)))
    peer = s.oty("strips", other, "bilinear")
    if peer and s.programs.rio:
        orthos = [str(other / f"{Path(photo).stem}_ORTHO.tif") for photo in s.photos("strips")]
        options = [word for block in BLOCKS for word in ("--co", block)]
        merge = (s.programs.rio, "merge", *orthos, "-o", str(merged), *options)
        tools.append(Tool("orthority + rio merge", (peer, merge), (other, merged)))
    times = take(tools, s.rounds, s.work, tell)
    for path in s.work.glob("reference*"):
        path.unlink()
    number = len(s.photos("strips"))
    result = Result("mosaic", f"mosaic of {number} photos of {shape(s.scene('strips'))}, balanced, feathered", times)
    result.megapixels = grid["width"] * grid["height"] / 1e6
    result.facts["output"] = f"{grid['width']} x {grid['height']}, with labels, footprints and seams"
    for ours in ("geomosaic mosaic, pixels only", "geomosaic mosaic"):
        fast = times.ratio("orthority + rio merge", ours)
        result.at_least(f"{ours}: times as fast as orthority + rio merge", fast, 6.0)
    return result


def merge(s: Setting) -> Result:
    """Six orthos on one grid: matched and feathered, and blended in bands, beside rasterio's plain merge."""
    kinds = {
        "as it comes": 1.0,
        "feather": 1.0,
        "multiband": 2.0,
        "feather, pixels only": 1.0,
        "multiband, pixels only": 2.0,
    }
    title = "six orthos of 28 Mpx RGB on one grid: histograms matched and blended; plain merge"
    result = _merged(s, "merge", title, s.data / "orthos", kinds)
    for kind, most in kinds.items():
        ours, times = f"geomosaic {kind}", result.times
        result.at_most(f"{kind}: wall / rasterio.merge", times.ratio(ours, "rasterio.merge"), most)
        result.at_most(f"{kind}: CPU / rasterio.merge", times.ratio(ours, "rasterio.merge", "cpu"), most)
        result.at_most(f"{kind}: peak memory, MB", peak(result, ours), 700)
    return result


def scenes(s: Setting) -> Result:
    """Four satellite scenes of four bands of 16 bits on one grid, turned in their nodata."""
    title = "four scenes of 28 Mpx, 4 bands uint16, turned by 12 degrees in nodata: balanced and feathered; plain merge"
    kinds = ("as it comes", "feather, pixels only")
    result = _merged(s, "scenes", title, s.data / "scenes", kinds)
    for kind in kinds:
        result.at_most(f"{kind}: peak memory, MB", peak(result, f"geomosaic {kind}"), 700)
    return result


def _merged(s: Setting, name: str, title: str, home: Path, kinds: Iterable[str]) -> Result:
    """Orthos on one grid, to a mosaic of each kind; rasterio only merges."""
    out, other = s.work / "ours.tif", s.work / "merged.tif"
    inputs, colour = orthos_in(s, home)
    command: Command = (*s.programs.geomosaic, "mosaic", *inputs, *RAW, "--json", "-o", str(out))
    beside = tuple(s.work / f"ours{end}" for end in (".tif", "-labels.tif", ".gpkg", ".stac.json"))
    tools = []
    for kind in kinds:  # the peers make the raster, and nothing that says how it was made
        blend, _, alone = kind.partition(", ")
        words = (*colour, "--no-labels", "--blend", blend, *(("--no-records",) if alone else ()))
        made = command if kind == "as it comes" else (*command, *words)
        tools.append(Tool(f"geomosaic {kind}", (made,), beside))
    tools.insert(1, tools[0].on_one_core)
    plain: Command = (s.python, str(ROOT / "benchmarks" / "merged.py"), str(other), *inputs)
    tools.append(Tool("rasterio.merge", (plain,), (other,)))
    times = take(warm(tools, s.work), s.rounds, s.work, tell)
    return Result(name, title, times)


def orthos_in(s: Setting, home: Path) -> tuple[list[str], tuple[str, ...]]:
    """Orthos of a folder, made where they are not there yet, and how they are balanced."""
    colour = home.name == "orthos"
    helper("orthos", str(home), "colour" if colour else "satellite", *(["--small"] if s.small else []))
    balance = ("--histogram", "overlap") if colour else ("--colour", "gain")
    return sorted(str(path) for path in home.glob("*.tif")), balance


def georeference(s: Setting) -> Result:
    """A large scan onto 200 control points: the same fit and kernel in GDAL's warper; reading and writing alone."""
    out, other, reference = s.work / "ours.tif", s.work / "warped.tif", s.work / "reference.tif"
    photo, table, script = s.photos("single")[0], str(s.data / "control.csv"), str(ROOT / "benchmarks" / "warped.py")
    names = {"poly3": "polynomial of order 3", "tps": "thin plate spline"}
    placed: Command = (
        *s.programs.geomosaic, "georeference", photo, "--gcps", table, "--crs", CRS, "--res", repr(RESOLUTION), *RAW,
        "--no-report",
    )  # fmt: skip
    once(((*placed, "--model", "poly3", "--overwrite", "-o", str(reference)),), s.work)
    tools = s.floors(reference, [photo])
    for model, words in names.items():
        tools.append(Tool(f"geomosaic {words}", ((*placed, "--model", model, "-o", str(out)),), (out,)))
        tools.append(tools[-1].on_one_core)
        warp = (s.python, script, photo, table, CRS, str(other), model, repr(RESOLUTION), str(os.cpu_count() or 1))
        tools.append(Tool(f"GDAL {words}", (warp,), (other, s.work / "warped.tif.vrt")))
    times = take(tools, s.rounds, s.work, tell)
    reference.unlink()
    result = Result("georeference", f"{shape(s.scene('single'))} RGB scan, 200 control points, bilinear", times)
    for words in names.values():
        result.at_least(f"{words}: times as fast as GDAL", times.ratio(f"GDAL {words}", f"geomosaic {words}"), 1.0)
        result.at_most(f"{words}: wall / floor", times.ratio(f"geomosaic {words}", "floor"), 2.2)
    return result


def small(s: Setting) -> Result:
    """Jobs so small that starting is most of them."""
    out, other = s.work / "ours.tif", s.work / "warped.tif"
    bounds = [repr(side) for side in tiny_bounds()]
    raster = str(s.data / "map512.tif")
    frame = s.ours("ortho", "tiny", out, *RAW, "--bounds", *bounds)
    where = ("--dst-crs", REPROJECTED, "--res", repr(RESOLUTION))
    plain: Command = (*s.programs.geomosaic, "ortho", raster, *where, *RAW, "--json", "-o", str(out))
    tools = [Tool("geomosaic ortho", (frame,), (out,)), Tool("geomosaic reproject", (plain,), (out,))]
    if s.programs.rio:
        warp = (s.programs.rio, "warp", raster, str(other), *where, "--resampling", "bilinear")
        tools.append(Tool("rio warp", (warp,), (other,)))
    times = take(warm(tools, s.work), 5 * s.rounds, s.work, tell)
    result = Result("small", "512 x 512 pixels: ortho of a photo with a DEM; reprojection of a map", times)
    for name in ("ortho", "reproject"):
        result.at_most(f"{name}: wall / rio warp", times.ratio(f"geomosaic {name}", "rio warp"), 1.0)
    return result


def first(s: Setting) -> Result:
    """The first run after installing beside a second one: the package is installed anew, without what runs leave."""
    pristine, fresh = s.work / "pristine", s.work / "fresh"
    shutil.rmtree(pristine, ignore_errors=True)
    install = (s.python, "-m", "pip", "install", "-q", "--no-deps", "--target", str(pristine), str(ROOT))
    once((install,), s.work)

    def renew() -> None:
        shutil.rmtree(fresh, ignore_errors=True)
        shutil.copytree(pristine, fresh)

    helper("lambert", "make", str(s.data / "lambert"), *(["--small"] if s.small else []))
    orthos, colour = orthos_in(s, s.data / "orthos")
    jobs = {
        "reproject": ("reproject", str(s.data / "lambert" / "map.tif"), "--dst-crs", UTM, "--res", STEP),
        "mosaic": ("mosaic", *orthos, *colour, "--no-labels", "--no-records"),
    }
    tools, out = [], s.work / "ours.tif"
    for name, words in jobs.items():
        command = ("env", f"PYTHONPATH={fresh}", s.python, "-c", ENTRY, *words, *RAW, "-o", str(out))
        tools.append(Tool(f"{name}, first run", (command,), (out,), prepare=renew))
        tools.append(Tool(f"{name}, next run", (command,), (out,)))
    times = take(tools, s.rounds, s.work, tell)
    result = Result("first", "the first run of the package as it is installed, and the next", times)
    for name in jobs:
        more = times.beyond(f"{name}, first run", f"{name}, next run")
        result.at_most(f"{name}: first run beyond the next, s", more, 1.0)
    return result


def start(s: Setting) -> Result:
    """What the mere call costs."""
    asked: dict[str, Command | None] = {
        "python -c pass": (s.python, "-c", "pass"),
        "geomosaic --help": (*s.programs.geomosaic, "--help"),
        "rio --help": (s.programs.rio, "--help") if s.programs.rio else None,
        "orthority --help": (s.programs.oty, "--help") if s.programs.oty else None,
    }
    tools = [Tool(name, (command,), ()) for name, command in asked.items() if command]
    times = take(warm(tools, s.work), 5 * s.rounds, s.work, tell)
    result = Result("start", "help", times)
    result.at_most("--help, s", times.table()["geomosaic --help"]["wall_s"], 0.4)
    result.at_most("--help: wall / rio --help", times.ratio("geomosaic --help", "rio --help"), 0.5)
    return result


def memory(s: Setting) -> Result:
    """The same photos at the same limit, to an output ten times larger, in the default format (COG)."""
    out = s.work / "ours.tif"
    beside = tuple(s.work / f"ours{end}" for end in (".tif", "-labels.tif", ".gpkg", ".stac.json"))
    limit = ("--mem-limit", f"{LIMIT_MB}M")
    tools = []
    for command, name in (("ortho", "single"), ("mosaic", "strips")):
        for times_larger in (1, 10):
            res = RESOLUTION / math.sqrt(times_larger)
            words = s.ours(command, name, out, *limit, res=res)
            tools.append(Tool(f"{command}, {times_larger} x", (words,), beside))
    times = take(tools, 1, s.work, tell)
    result = Result("memory", f"peak memory under --mem-limit {LIMIT_MB}M, output 1 and 10 times as large", times)
    for command in ("ortho", "mosaic"):
        result.at_most(f"{command}, 10 x: peak memory, MB", peak(result, f"{command}, 10 x"), LIMIT_MB)
    return result


JOBS: dict[str, Callable[[Setting], Result]] = {
    "start": start,
    "first": first,
    "small": small,
    "ortho": ortho,
    "mosaic": mosaic,
    "merge": merge,
    "scenes": scenes,
    "georeference": georeference,
    "reproject": reproject,
    "bands": bands,
    "rpc": rpc,
    "sar": sar,
    "multispectral": multispectral,
    "memory": memory,
}
