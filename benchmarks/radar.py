"""The job `sar`: ortho of a radar scene by range and Doppler, beside the same pixels by RPCs fitted to it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from benchmarks.process import Command, helper
from benchmarks.result import Result
from benchmarks.rounds import Tool, take, tell
from benchmarks.scene import BASE, CRS, PLACE
from benchmarks.setting import RAW, Setting, grid_of, once, peak

PIXEL = 0.5
RANGE, LOOK = 850_000.0, np.radians(33.0)
"""Slant range of the middle, metres, and the angle from the vertical at which the ground sees the satellite."""


def table(size: int) -> dict[str, object]:
    """Scene of a circular orbit over `PLACE`, pixels of about `PIXEL` on the ground, as the sensor's JSON table."""
    lon, lat = np.radians(PLACE)
    radius = 6378137.0 / np.sqrt(1.0 - 0.00669437999 * np.sin(lat) ** 2)
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    ground = (radius + BASE) * up - [0.0, 0.0, 0.00669437999 * radius * np.sin(lat)]
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    position = ground + RANGE * (np.cos(LOOK) * up - np.sin(LOOK) * east)  # from the west: it flies north, looks right
    along = np.cross(position, east)
    along -= position * (along @ position) / (position @ position)
    along -= (ground - position) * (along @ (ground - position)) / RANGE**2
    distance = np.linalg.norm(position)
    rate = np.sqrt(3.986004418e14 / distance**3)
    first, second = position / distance, along - position * (along @ position) / distance**2
    second /= np.linalg.norm(second)
    second *= np.sign(second[2])
    times = np.arange(-50.0, 51.0, 10.0)
    turn = rate * times[:, None]
    interval = PIXEL / (rate * np.linalg.norm(ground))
    return {
        "size": [size, size],
        "looking": "right",
        "first_row_time": -0.5 * size * interval,
        "row_interval": interval,
        "slant_range": {
            "near": RANGE - 0.5 * size * PIXEL * np.sin(LOOK),
            "spacing": PIXEL * np.sin(LOOK),
        },
        "calibration": {"quantity": "beta0", "factor": [1e-5, 2e-5], "columns": [0, size]},
        "orbit": {
            "times": times.tolist(),
            "positions": (distance * (np.cos(turn) * first + np.sin(turn) * second)).tolist(),
            "velocities": (rate * distance * (np.cos(turn) * second - np.sin(turn) * first)).tolist(),
        },
    }


def sar(s: Setting) -> Result:
    """Ortho of one band of 16 bits over a DEM."""
    size, home, dem = ("--small",) if s.small else (), s.data / "sar", str(s.data / "dem.tif")
    helper("scanned", "sar", str(home), *size)
    scene = str(home / "scene.tif")
    (home / "scene.radar.json").write_text(json.dumps(table(3000 if s.small else 12_000)))
    ground = ("--dem", dem, "--dem-heights", "ellipsoidal")
    once(((*s.programs.geomosaic, "rpc", scene, "--sensor", "sar", *ground, "--text", "--overwrite"),), s.work)
    outs = {name: s.work / f"{name}.tif" for name in ("sar", "rpc", "sigma0")}

    def ours(name: str, target: Path, *more: str) -> Command:
        place = (*ground, "--dst-crs", CRS, "--res", repr(PIXEL))
        calibrated = ("--option", "calibration=sigma0") if name == "sigma0" else ()
        options = ("--option", "refine=none", *calibrated, *RAW, "-o", str(target), "--overwrite", *more)
        return (*s.programs.geomosaic, "ortho", scene, "--sensor", "rpc" if name == "rpc" else "sar", *place, *options)

    grid = grid_of(once((ours("sar", outs["sar"], "--json"),), s.work))
    place = ("--bounds", *map(repr, grid["bounds"]))
    times = take([Tool(name, (ours(name, out, *place),), (out,)) for name, out in outs.items()], s.rounds, s.work, tell)
    size_words = f"{grid['width']} x {grid['height']}"
    result = Result("sar", f"ortho of {size_words} pixels, one band uint16 of radar with a DEM, bilinear", times)
    result.megapixels = grid["width"] * grid["height"] / 1e6
    result.facts = {"output": size_words}
    result.at_most("wall / RPC ortho of the same size", times.ratio("sar", "rpc"), 2.0)
    result.at_most("calibrated: wall / RPC ortho of the same size", times.ratio("sigma0", "rpc"), 2.0)
    result.at_most("peak memory, MB", peak(result, "sar"), 400)
    result.at_most("calibrated: peak memory, MB", peak(result, "sigma0"), 500)
    return result
