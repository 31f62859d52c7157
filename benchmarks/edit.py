"""One seam of a large mosaic moved, and the project run again.

python -m benchmarks.edit FOLDER REACH      moves a seam of the project there by so many metres
python -m benchmarks.edit FOLDER            prints how many tiles of two mosaics differ, and of how many
"""

from __future__ import annotations

import shutil
import sys
import time
from pathlib import Path

from benchmarks.process import Command, Cost, helper, run
from benchmarks.result import Result
from benchmarks.rounds import Times, tell
from benchmarks.scene import CENTRE, CRS, RESOLUTION
from benchmarks.setting import Setting
from benchmarks.watching import Watching

SIDE = 10_000
MOVED = 40.0
"""Metres."""
FIRST, WATCHED, AGAIN = "first run", "again, by a run that watches", "again, by a new process"


def project(photos: list[str], home: Path, dem: Path, side: int) -> str:
    """The project file: all checks and the report, seams where neighbours look alike."""
    half = side * RESOLUTION / 2
    bounds = [CENTRE[0] - half, CENTRE[1] - half, CENTRE[0] + half, CENTRE[1] + half]
    return f"""format = 1
[project]
name = "edited"
images = {photos}
[sensor]
name = "frame"
camera = "{home / "camera.toml"}"
[exterior]
file = "{home / "exterior.csv"}"
crs = "{CRS}"
heights = "ellipsoidal"
[dem]
file = "{dem}"
heights = "ellipsoidal"
[output]
resolution = {RESOLUTION}
bounds = {bounds}
[mosaic]
seams = "graph-cut"
"""


def edit(s: Setting) -> Result:
    """A mosaic of 10,000 x 10,000 pixels, made, one seam moved, made again: by a new process, by one that watches."""
    folder, times = s.work / "edit", Times()
    side = 2000 if s.small else SIDE
    file = folder / "project.toml"
    command: Command = (*s.programs.geomosaic, "run", str(file), "--json")
    for number in range(s.rounds):
        costs: dict[str, Cost] = {}
        for watched in (True, False):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            file.write_text(project(s.photos("strips"), s.data / "strips", s.data / "dem.tif", side))
            if watched:
                with Watching((*command, "--watch"), folder) as watching:
                    watching.answer(time.perf_counter(), 0.0)
                    helper("edit", str(folder), repr(MOVED))
                    time.sleep(1.0)  # what was told to the terminal is told, and the files are looked at again
                    spent, saved = watching.spent(), time.perf_counter()
                    (folder / "edited.toml").replace(file)
                    costs[WATCHED] = watching.answer(saved, spent)
                continue
            costs[FIRST], _ = run((command,), s.work / "run.log")
            helper("edit", str(folder), repr(MOVED))
            (folder / "edited.toml").replace(file)
            costs[AGAIN], _ = run((command,), s.work / "run.log")
        for name in (FIRST, WATCHED, AGAIN):
            times.costs.setdefault(name, []).append(costs[name])
        times.cores.append(2.0)
        tell(f"  round {number + 1}: {', '.join(f'{n} {c.wall:.2f} ({c.cpu:.2f})' for n, c in costs.items())}")
    differ, tiles = map(int, helper("edit", str(folder)).split())
    result = Result("edit", f"one seam moved by {MOVED:g} m in a mosaic of {side} x {side} pixels, all records", times)
    result.facts["tiles"] = f"{tiles - differ} of {tiles} tiles of the COG are the same bytes, overviews included"
    for name in (WATCHED, AGAIN):
        result.at_most(f"{name}: processor time / first run", times.ratio(name, FIRST, "cpu"), 0.1)
        result.at_most(f"{name}: wall / first run", times.ratio(name, FIRST), 0.1)
    result.at_most("tiles that differ / all", differ / tiles, 0.05)
    return result


def move(folder: Path, reach: float) -> None:
    """Give a place in the middle of the longest seam to the other photo, as one would in QGIS; keep the mosaic.

    The project with that edit is written beside the project: put in its place it is the edit.
    """
    from geomosaic.raster.vector import read_layer

    made = folder / "output" / "edited.gpkg"
    shares, lines = read_layer(made, "seams"), read_layer(made, "seamlines")
    seen = read_layer(made, "footprints").set_index("image").geometry
    # Whole seams: their records are pieces of one length, of which rounding would choose another in each version.
    whole = lines.dissolve(["first", "second"]).geometry.line_merge().explode()
    longest = int(whole.length.argmax())
    first = whole.index[longest][0]
    place = whole.iloc[longest].interpolate(0.5, normalized=True).buffer(reach).intersection(seen[first])
    own = [
        shape.union(place) if image == first else shape.difference(place)
        for image, shape in zip(shares["image"], shares.geometry, strict=True)
    ]
    shares.set_geometry(own).to_file(folder / "mine.gpkg", layer="seams")
    shutil.copy(folder / "output" / "edited.tif", folder / "before.tif")
    text = (folder / "project.toml").read_text()
    (folder / "edited.toml").write_text(text.replace("[mosaic]\n", '[mosaic]\ncutlines = "mine.gpkg"\n'))


def compared(folder: Path) -> tuple[int, int]:
    """Tiles that differ between the two mosaics, byte by byte, and all."""
    from geomosaic.raster.cog.tiff import TILE_OFFSETS
    from geomosaic.raster.cog.tiles import EarlierTiles

    with EarlierTiles(folder / "before.tif") as one, EarlierTiles(folder / "output" / "edited.tif") as two:
        sizes = [len(level[TILE_OFFSETS].integers) for level in one.levels]
        places = [(level, index) for level, count in enumerate(sizes) for index in range(count)]
        return sum(one.tile(*place) != two.tile(*place) for place in places), len(places)


if __name__ == "__main__":
    if len(sys.argv) > 2:
        move(Path(sys.argv[1]), float(sys.argv[2]))
    else:
        print(*compared(Path(sys.argv[1])))
