"""Many photos: time and memory as the block grows and the overlap does.

python -m benchmarks.growth FOLDER OVERLAP STRIPS EACH      makes a block
"""

from __future__ import annotations

import random
import sys
from pathlib import Path

from benchmarks.jobs import RAW, Setting, grid_of
from benchmarks.process import Command, helper, run
from benchmarks.result import Result
from benchmarks.rounds import Times, tell
from benchmarks.scene import BASE, CENTRE, CRS, RESOLUTION, Camera, Scene, Shot

SIZE = (900, 600)
LENS = {"k1": -0.05, "k2": 0.02, "k3": 0.0, "p1": 0.0, "p2": 0.0}
LIMIT_MB = 1024
SIDE = {60: 0.35, 80: 0.6}
"""Overlap of strips that goes with an overlap along the strip."""
BLOCKS = {25: (5, 5), 50: (5, 10), 100: (10, 10)}
WAYS = {"": (), ", graph-cut, multiband": ("--seams", "graph-cut", "--blend", "multiband")}


def block(overlap: int, strips: int, each: int) -> Scene:
    """Strips there and back; the first photos of a strip and the first strips of a block are those of a smaller one."""
    width, height = SIZE
    camera = Camera(SIZE, 4.0 * width, (width / 2 + 3.2, height / 2 - 5.4), LENS)
    shots = []
    for row in range(strips):
        for col in range(each):
            chance = random.Random(1000 * row + col)
            x = CENTRE[0] + (col - 4.5) * (1 - overlap / 100) * width * RESOLUTION + chance.uniform(-3, 3)
            y = CENTRE[1] - (row - 4.5) * (1 - SIDE[overlap]) * height * RESOLUTION + chance.uniform(-3, 3)
            z = BASE + camera.focal * RESOLUTION + chance.uniform(-5, 5)
            angles = (chance.gauss(0, 0.5), chance.gauss(0, 0.5), chance.gauss(0, 2.0) + 180.0 * (row % 2))
            look = chance.gauss(1.0, 0.08), chance.gauss(0.0, 5.0)
            shots.append(Shot(f"photo{row:02d}{col:02d}.tif", (x, y, z), angles, *look))
    return Scene(f"growth{overlap}", camera, tuple(shots))


def make(folder: Path, overlap: int, strips: int, each: int) -> None:
    """Photos and tables of a block, as far as they are not there."""
    from benchmarks.data import write_dem, write_photo, write_tables

    folder.mkdir(parents=True, exist_ok=True)
    if not (folder.parent / "dem.tif").exists():
        write_dem(folder.parent / "dem.tif")
    scene = block(overlap, strips, each)
    write_tables(folder, scene)
    for number, shot in enumerate(scene.shots):
        if not (folder / shot.name).exists():
            write_photo(folder / shot.name, scene.camera, shot, number)


def command(s: Setting, home: Path, scene: Scene, out: Path, *more: str) -> Command:
    """Our mosaic of a block."""
    return (
        *s.programs.geomosaic, "mosaic", *(str(home / shot.name) for shot in scene.shots), "--sensor", "frame",
        "--camera", str(home / "camera.toml"), "--exterior", str(home / "exterior.csv"), "--exterior-crs", CRS,
        "--heights", "ellipsoidal", "--dem", str(home.parent / "dem.tif"), "--dem-heights", "ellipsoidal",
        "--res", repr(RESOLUTION), "--mem-limit", f"{LIMIT_MB}M", *RAW, *more, "--json", "--overwrite", "-o", str(out),
    )  # fmt: skip


def growth(s: Setting) -> Result:
    """25, 50 and 100 photos at two overlaps; the fewest and the most also with all that makes seams good."""
    times, areas = Times(), {}
    blocks = {4: (2, 2), 16: (4, 4)} if s.small else BLOCKS
    few, many = min(blocks), max(blocks)
    for way, more in WAYS.items():
        for overlap in SIDE:
            home = s.data / f"growth{overlap}"
            helper("growth", str(home), str(overlap), *map(str, blocks[many]))
            for number in (few, many) if way else blocks:
                name, scene = f"{number} photos, {overlap} %{way}", block(overlap, *blocks[number])
                cost, text = run((command(s, home, scene, s.work / "ours.tif", *more),), s.work / "run.log")
                times.costs[name] = [cost]
                grid = grid_of(text)
                areas[name] = grid["width"] * grid["height"] / 1e6
                tell(f"  {name}: {areas[name]:.1f} Mpx, {cost.cpu:.1f} s CPU, {cost.memory:.0f} MB")
    times.cores.append(2.0)
    result = Result("growth", f"photos of {SIZE[0]} x {SIZE[1]}, frame, DEM, --mem-limit {LIMIT_MB}M", times)
    result.quality = {
        name: {
            "mosaic_Mpx": round(area, 1),
            "CPU_s": round(times.costs[name][0].cpu, 1),
            "CPU_s_per_Mpx": round(times.costs[name][0].cpu / area, 2),
            "peak_MB": round(times.costs[name][0].memory),
        }
        for name, area in areas.items()
    }
    for overlap in SIDE:
        for way in WAYS:
            one, other = (result.quality[f"{n} photos, {overlap} %{way}"]["CPU_s_per_Mpx"] for n in (many, few))
            result.at_most(f"{overlap} %{way}: processor time per area, {many} / {few} photos", one / other, 1.25)
    result.at_most("peak memory, MB", max(found["peak_MB"] for found in result.quality.values()), 1.2 * LIMIT_MB)
    return result


if __name__ == "__main__":
    make(Path(sys.argv[1]), *map(int, sys.argv[2:5]))
