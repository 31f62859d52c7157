"""What the jobs have in common: where they run, and the commands of ours and of the peers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.process import ROOT, Command, Programs, run
from benchmarks.result import Result
from benchmarks.rounds import Tool
from benchmarks.scene import CRS, RESOLUTION, Scene, scenes

ALL_CORES = ("-multi", "-wo", "NUM_THREADS=ALL_CPUS", "-wm", "256", "--config", "GDAL_CACHEMAX", "256")
"""gdalwarp told to use all cores, and more memory than its default."""
RAW = ("--driver", "GTiff", "--co", "COMPRESS=NONE")
BLOCKS = ("TILED=YES", "BLOCKXSIZE=512", "BLOCKYSIZE=512", "INTERLEAVE=PIXEL")


@dataclass(frozen=True)
class Setting:
    """Where and how a run takes place."""

    data: Path
    work: Path
    small: bool
    rounds: int
    programs: Programs
    python: str

    def scene(self, name: str) -> Scene:
        """Scene of a name."""
        return scenes(self.small)[name]

    def photos(self, name: str) -> list[str]:
        """Its photo files."""
        return [str(self.data / name / shot.name) for shot in self.scene(name).shots]

    def ours(self, command: str, name: str, output: Path, *more: str, res: float = RESOLUTION) -> Command:
        """Our command on a scene."""
        home = self.data / name
        place = self.data / ("single" if name == "coordinates" else name)
        photos = [str(home / Path(photo).name) for photo in self.photos(place.name)]
        return (
            *self.programs.geomosaic, command, *photos, "--sensor", "frame", "--camera", str(home / "camera.toml"),
            "--exterior", str(home / "exterior.csv"), "--exterior-crs", CRS, "--heights", "ellipsoidal",
            "--dem", str(self.data / "dem.tif"), "--dem-heights", "ellipsoidal", "--res", repr(res), "--json",
            "-o", str(output), *more,
        )  # fmt: skip

    def oty(self, name: str, folder: Path, interp: str, dem: Path | None = None) -> Command | None:
        """Orthority on a scene: the same photos, tables, DEM and pixel size, uncompressed, no overviews."""
        if self.programs.oty is None:
            return None
        home = self.data / name
        photos = sorted(str(path) for path in home.glob("photo*.tif"))
        options = [word for block in BLOCKS for word in ("-co", block)]
        return (
            self.programs.oty, "frame", *photos, "--dem", str(dem or self.data / "dem.tif"),
            "-ip", str(home / "oty_int.yaml"), "-ep", str(home / "oty_ext.csv"), "-c", CRS, "-r", repr(RESOLUTION),
            "-i", interp, "-di", "bilinear", "-nbo", *options, "-od", str(folder), "-o",
        )  # fmt: skip

    def gdalwarp(self, grid: Mapping[str, Any], sources: list[str], target: Path, *more: str) -> Command | None:
        """gdalwarp onto the grid of ours, uncompressed; otherwise as typed."""
        program = self.programs.peer("gdalwarp")
        if program is None:
            return None
        options = [word for block in BLOCKS for word in ("-co", block)]
        place = ("-te", *map(repr, grid["bounds"]), "-ts", str(grid["width"]), str(grid["height"]))
        return (program, "-q", "-overwrite", *place, *more, *options, *sources, str(target))

    def absent(self, *names: str) -> list[str]:
        """Programs that are not installed: their rows are left out."""
        return [name for name in names if self.programs.peer(name) is None]

    def floors(self, reference: Path, inputs: list[str]) -> list[Tool]:
        """Read and write the same raster; read all inputs once and write the output once."""
        script, target = str(ROOT / "benchmarks" / "floor.py"), self.work / "floor.tif"
        copy: Command = (self.python, script, "copy", str(reference), str(target))
        if self.programs.gdal_translate:
            options = [word for block in BLOCKS for word in ("-co", block)]
            inside = ("--config", "GDAL_TIFF_INTERNAL_MASK", "YES")  # before GDAL 3.9 masks became files of their own
            copy = (self.programs.gdal_translate, "-q", *inside, *options, str(reference), str(target))
        passed = (self.python, script, "pass", str(reference), str(target), *inputs)
        return [Tool("floor", (copy,), (target,)), Tool("floor: inputs + output", (passed,), (target,))]

    def folder(self, name: str) -> Path:
        """Empty folder for outputs."""
        path = self.work / name
        path.mkdir(parents=True, exist_ok=True)
        return path


def grid_of(text: str) -> dict[str, Any]:
    """Grid that our --json reports."""
    grid: dict[str, Any] = json.loads(text)["grid"]
    return grid


def once(commands: tuple[Command, ...], work: Path) -> str:
    """Run something untimed, so that caches are warm and references there."""
    return run(commands, work / "run.log")[1]


def warm(tools: list[Tool], work: Path) -> list[Tool]:
    """Run each once, so that modules are compiled."""
    for tool in tools:
        tool.clear()
        once(tool.commands, work)
    return tools


def shape(scene: Scene) -> str:
    """Size in words."""
    return f"{scene.camera.size[0]} x {scene.camera.size[1]}"


def peak(result: Result, tool: str) -> float:
    """Largest memory of a tool, MB."""
    return float(result.times.table()[tool]["peak_mb"])
