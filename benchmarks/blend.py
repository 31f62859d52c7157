"""Orthos of a town with known truth to one mosaic, by everyone's means: seams, colours, houses, time, memory."""

from __future__ import annotations

import json

from benchmarks.jobs import RAW, Setting
from benchmarks.process import ROOT, Command, helper
from benchmarks.result import Result
from benchmarks.rounds import Tool, take, tell

OURS = {
    "geomosaic": (),
    "geomosaic graph-cut, multiband": ("--seams", "graph-cut", "--blend", "multiband"),
}
WIDTH = "6.4"
"""Metres: 32 pixels, our own default."""


def blend(s: Setting) -> Result:
    """Six orthos: balanced, cut and blended, by each tool as its authors would have it."""
    home, size = s.data / "town", ("--small",) if s.small else ()
    helper("town", str(home), *size)
    orthos = [str(path) for path in sorted(home.glob("ortho*.tif"))]
    canvases = [str(path) for path in sorted(home.glob("canvas*.tif"))]
    script = str(ROOT / "benchmarks")
    out = {name: s.work / f"{name.split(',')[0].replace(' ', '-').lower()}.tif" for name in (*OURS, *_PEERS)}
    commands: dict[str, Command | None] = {
        name: (*s.programs.geomosaic, "mosaic", *orthos, *more, *RAW, "-o", str(out[name]))
        for name, more in OURS.items()
    }
    rio, warp, otb, enblend = s.programs.rio, *(s.programs.peer(n) for n in ("gdalwarp", "otbcli_Mosaic", "enblend"))
    vision = s.programs.python_with("cv2", "rasterio")
    match = s.programs.python_with("spectralmatch")
    commands |= {
        "rio merge": (rio, "merge", *orthos, "-o", str(out["rio merge"])) if rio else None,
        "gdalwarp": (warp, "-q", *orthos, str(out["gdalwarp"])) if warp else None,
        "OTB Mosaic": (
            otb, "-il", *orthos, "-out", str(out["OTB Mosaic"]), "uint8", "-comp.feather", "slim",
            "-comp.feather.slim.length", WIDTH, "-harmo.method", "band", "-nodata", "0",
        ) if otb else None,
        "enblend, colours right beforehand": (
            enblend, "-o", str(out["enblend, colours right beforehand"]), *canvases,
        ) if enblend else None,
        "OpenCV stitching": (
            vision, f"{script}/stitched.py", str(out["OpenCV stitching"]), *orthos,
        ) if vision else None,
        "spectralmatch": (
            match, f"{script}/matched.py", str(out["spectralmatch"]), str(s.folder("matched")), *orthos,
        ) if match else None,
    }  # fmt: skip
    tools = []
    for name, command in commands.items():
        if command:
            beside = [out[name].with_name(out[name].stem + end) for end in ("-labels.tif", ".gpkg", ".stac.json")]
            tools.append(Tool(name, (command,), (out[name], *beside), keep=True))
    times = take(tools, s.rounds, s.work, tell)
    town = json.loads((home / "town.json").read_text())
    (width, height), size_of_one = town["canvas"], " x ".join(map(str, town["size"]))
    title = f"{len(orthos)} orthos of {size_of_one} with leaning houses, gains and offsets"
    result = Result("blend", title, times)
    result.megapixels = width * height / 1e6
    result.facts = {"output": f"{width} x {height}", "absent": [name for name in _PEERS if not commands[name]]}
    result.quality = {"no seam at all": json.loads(helper("blended", str(home), "truth", *size))}
    result.quality |= {t.name: json.loads(helper("blended", str(home), str(out[t.name]), *size)) for t in tools}
    for tool in tools:
        tool.clear()
    wants(result)
    return result


_PEERS = (
    "rio merge",
    "gdalwarp",
    "OTB Mosaic",
    "enblend, colours right beforehand",
    "OpenCV stitching",
    "spectralmatch",
)


def wants(result: Result) -> None:
    """No worse than the best of the others, in each measure; no slower than those that balance and blend."""
    ours = result.quality["geomosaic graph-cut, multiband"]
    others = [found for name, found in result.quality.items() if name in _PEERS]
    for what in ("colour_rms", "seam_step", "houses_cut") if others else ():
        result.at_most(f"{what.replace('_', ' ')}, of the best other tool", ours[what], min(o[what] for o in others))
    for name, most in (("OTB Mosaic", 1.0), ("OpenCV stitching", 2.0), ("spectralmatch", 1.0)):
        for own in OURS:
            result.at_most(f"{own}: processor time / {name}", result.times.ratio(own, name, "cpu"), most)
