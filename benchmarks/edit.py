"""One seam of a large mosaic moved, and the project run again.

python -m benchmarks.edit FOLDER REACH      moves a seam of the project there by so many metres
python -m benchmarks.edit FOLDER            prints how many tiles of two mosaics differ, and of how many
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from benchmarks.process import Command, helper, run
from benchmarks.result import Result
from benchmarks.rounds import Times, tell
from benchmarks.scene import CENTRE, CRS, RESOLUTION
from benchmarks.setting import Setting

SIDE = 10_000
MOVED = 40.0
"""Metres."""
FIRST, AGAIN = "first run", "run after a seam was moved"


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
seams = "alike"
"""


def edit(s: Setting) -> Result:
    """A mosaic of 10,000 x 10,000 pixels, made, one seam moved, made again."""
    folder, times = s.work / "edit", Times()
    side = 2000 if s.small else SIDE
    for number in range(s.rounds):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        file = folder / "project.toml"
        file.write_text(project(s.photos("strips"), s.data / "strips", s.data / "dem.tif", side))
        command: Command = (*s.programs.geomosaic, "run", str(file), "--json")
        for name in (FIRST, AGAIN):
            cost, _ = run((command,), s.work / "run.log")
            times.costs.setdefault(name, []).append(cost)
            if name == FIRST:
                helper("edit", str(folder), repr(MOVED))
        times.cores.append(2.0)
        part = times.costs[AGAIN][-1].cpu / times.costs[FIRST][-1].cpu
        tell(f"  round {number + 1}: {', '.join(f'{n} {c[-1].cpu:.2f}' for n, c in times.costs.items())}; {part:.3f}")
    differ, tiles = map(int, helper("edit", str(folder)).split())
    result = Result("edit", f"one seam moved by {MOVED:g} m in a mosaic of {side} x {side} pixels, all records", times)
    result.facts["tiles"] = f"{tiles - differ} of {tiles} tiles of the COG are the same bytes, overviews included"
    result.at_most("again: processor time / first run", times.ratio(AGAIN, FIRST, "cpu"), 0.1)
    result.at_most("again: wall / first run", times.ratio(AGAIN, FIRST), 0.1)
    result.at_most("tiles that differ / all", differ / tiles, 0.05)
    return result


def move(folder: Path, reach: float) -> None:
    """Give a place in the middle of the longest seam to the other photo, as one would in QGIS; keep the mosaic."""
    from geomosaic.raster.vector import read_layer

    made = folder / "output" / "edited.gpkg"
    shares, lines = read_layer(made, "seams"), read_layer(made, "seamlines")
    seen = read_layer(made, "footprints").set_index("image").geometry
    line = lines.iloc[int(lines.geometry.length.argmax())]
    place = line.geometry.interpolate(0.5, normalized=True).buffer(reach)
    place = place.intersection(seen[line["first"]])
    own = [
        shape.union(place) if image == line["first"] else shape.difference(place)
        for image, shape in zip(shares["image"], shares.geometry, strict=True)
    ]
    shares.set_geometry(own).to_file(folder / "mine.gpkg", layer="seams")
    shutil.copy(folder / "output" / "edited.tif", folder / "before.tif")
    file = folder / "project.toml"
    file.write_text(file.read_text().replace("[mosaic]\n", '[mosaic]\ncutlines = "mine.gpkg"\n'))


def compared(folder: Path) -> tuple[int, int]:
    """Tiles that differ between the two mosaics, byte by byte, and all."""
    from geomosaic.raster.tiles.earlier import EarlierTiles
    from geomosaic.raster.tiles.tiff import TILE_OFFSETS

    with EarlierTiles(folder / "before.tif") as one, EarlierTiles(folder / "output" / "edited.tif") as two:
        sizes = [len(level[TILE_OFFSETS].integers) for level in one.levels]
        places = [(level, index) for level, count in enumerate(sizes) for index in range(count)]
        return sum(one.tile(*place) != two.tile(*place) for place in places), len(places)


if __name__ == "__main__":
    if len(sys.argv) > 2:
        move(Path(sys.argv[1]), float(sys.argv[2]))
    else:
        print(*compared(Path(sys.argv[1])))
