"""What geomosaic draws, as digests of decoded pixels: to show that a change of the code changed none of them.

python -m benchmarks.pixels OUT.json [--work DIR] [--root TREE]                      records
python -m benchmarks.pixels OUT.json --against OLD.json [--old-work DIR] ...         records, and compares

All is drawn by the command line in processes of their own, so that the same script serves any version: nothing of
geomosaic is imported here. The code that runs is that of --root, which goes to the head of PYTHONPATH; without it, of
the folder this file lies in. Inputs are the sample in `data/sample` and what is derived of it below, by NumPy alone.

Of each file that a command leaves in its folder there is one record:

- rasters: SHA-256 of the pixels of all bands and of the mask, with type, shape, transform, CRS, nodata, number of
  overviews. How the file is packed does not count.
- vectors: SHA-256 of the rows of each layer, sorted: geometry as WKB, and the attributes.
- sheets: SHA-256 of each page of a PDF, rendered at 100 dpi, or of the pixels of a PNG; of the tiles of MBTiles and
  the members of KMZ.
- reports and models in JSON: SHA-256 without times, versions and what follows from the packing of files; tables,
  project files and reports in HTML, these without their line of times: SHA-256 of the text.

There are jobs of few blocks and of many: `FINE` and `ROOM` make a job large.

Left out: what the commands say, text of PDF beside its looks, hidden files. One tree on one machine gives the same
records again, whatever the folder; libraries of other versions may not.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pyogrio
import pypdfium2
import rasterio
import shapely
from affine import Affine
from PIL import Image
from rasterio.errors import NotGeoreferencedWarning
from scipy.ndimage import map_coordinates

Record = dict[str, Any]
CRS = "EPSG:32633"
EPOCH = "1750000000"
"""Second of all times that geomosaic takes from the environment."""
DPI = 100.0
OURS = ".pixels"
"""File that tells a folder of this script, which may be emptied."""

# --- Digests --------------------------------------------------------------------------------------------------------

PASSING = ("seconds", "versions", "sha256", "checksum", "file:size", "bytes")
"""Parts of names of what is not the same in each run, or belongs to the packing of a file."""


def sha(*parts: bytes) -> str:
    """SHA-256 of parts, each with its length."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(str(len(part)).encode() + b":")
        digest.update(part)
    return digest.hexdigest()


def pixels_of(values: np.ndarray) -> str:
    """SHA-256 of an array, whatever its order in memory."""
    return sha(np.ascontiguousarray(values).tobytes())


def raster(path: Path) -> Record:
    """Pixels, mask, and where they lie."""
    with rasterio.open(path) as file:
        return {
            "shape": [file.count, file.height, file.width],
            "dtype": list(file.dtypes),
            "pixels": pixels_of(file.read()),
            "mask": pixels_of(file.read_masks()),
            "transform": list(file.transform)[:6],
            "crs": file.crs.to_wkt() if file.crs else None,
            "nodata": None if file.nodata is None else repr(file.nodata),
            "colours": [colour.name for colour in file.colorinterp],
            "descriptions": list(file.descriptions),
            "overviews": len(file.overviews(1)),
        }


def rows_of(frame: Any) -> list[bytes]:
    """Rows of a layer, sorted: geometry as WKB, then names and values of the attributes."""
    where = frame.geometry.name if isinstance(frame, geopandas.GeoDataFrame) else None
    names = sorted(str(name) for name in frame.columns if name != where)
    shapes = shapely.to_wkb(frame.geometry.to_numpy()) if where else [None] * len(frame)
    columns = [frame[name].tolist() for name in names]
    return sorted(
        (shape or b"") + repr([(name, str(column[k])) for name, column in zip(names, columns, strict=True)]).encode()
        for k, shape in enumerate(shapes)
    )


def layers_of(path: Path) -> dict[str, Any]:
    """Layers of a vector file, by name."""
    return {str(name): pyogrio.read_dataframe(path, layer=name) for name, _ in pyogrio.list_layers(path)}


def vector(path: Path) -> Record:
    """Layers and their rows."""
    found: Record = {}
    for name, frame in layers_of(path).items():
        crs = getattr(frame, "crs", None)
        found[f"rows of {name}"] = [len(frame), sha(*rows_of(frame))]
        found[f"crs of {name}"] = crs.to_wkt() if crs else None
    return found


def picture(path: Path) -> np.ndarray:
    """Pixels of an image file without a place."""
    with Image.open(path) as image:
        return np.asarray(image)


def pages(path: Path) -> list[np.ndarray]:
    """Pages of a PDF, rendered."""
    document = pypdfium2.PdfDocument(path)
    try:
        return [page.render(scale=DPI / 72.0).to_numpy().copy() for page in document]
    finally:
        document.close()


def drawn(path: Path) -> Record:
    """Page by page, how it looks."""
    looks = pages(path) if path.suffix == ".pdf" else [picture(path)]
    return {f"page {k}": [*look.shape, pixels_of(look)] for k, look in enumerate(looks, 1)}


def lasting(value: Any) -> Any:
    """JSON without what passes."""
    if isinstance(value, dict):
        return {k: lasting(v) for k, v in value.items() if not any(part in k.lower() for part in PASSING)}
    if isinstance(value, list):
        return [lasting(v) for v in value]
    return value


def facts_of(path: Path) -> Any:
    """What lasts of a JSON file."""
    return lasting(json.loads(path.read_text(encoding="utf-8")))


def facts(path: Path) -> Record:
    """Digest of what lasts of a JSON file."""
    return {"facts": sha(json.dumps(facts_of(path), sort_keys=True).encode())}


def text(path: Path) -> Record:
    """Text of a table or a project file; of a report without how long it took, and digests of files."""
    lines = [line for line in path.read_bytes().splitlines() if b"<dt>Time</dt>" not in line]
    return {"text": sha(re.sub(rb"\b[0-9a-f]{64}\b", b"", b"\n".join(lines)))}


def tiles(path: Path) -> Record:
    """Tiles of MBTiles."""
    with sqlite3.connect(path) as base:
        rows = base.execute("SELECT zoom_level, tile_column, tile_row, tile_data FROM tiles").fetchall()
    base.close()
    return {"tiles": [len(rows), sha(*(repr(row[:3]).encode() + row[3] for row in sorted(rows)))]}


def members(path: Path) -> Record:
    """Members of an archive."""
    with zipfile.ZipFile(path) as archive:
        names = sorted(archive.namelist())
        return {"members": [len(names), sha(*(name.encode() + archive.read(name) for name in names))]}


KINDS: dict[str, Callable[[Path], Record]] = {
    ".tif": raster, ".gpkg": vector, ".geojson": vector, ".pdf": drawn, ".png": drawn, ".json": facts, ".csv": text,
    ".toml": text, ".txt": text, ".html": text, ".mbtiles": tiles, ".kmz": members,
}  # fmt: skip

# --- Running --------------------------------------------------------------------------------------------------------


@dataclass
class Bench:
    """A folder in which commands run, and what they left there.

    Attributes
    ----------
    root : Path
        The tree under test.
    work : Path
        Where commands start; each writes to a folder of its own, and names all files from here.
    outputs : dict
        Record of each file, by its path.
    commands : dict
        Exit code and seconds of each command, and what it said where it failed.
    """

    root: Path
    work: Path
    outputs: dict[str, Record] = field(default_factory=dict)
    commands: dict[str, Record] = field(default_factory=dict)

    def environment(self) -> dict[str, str]:
        """That of this process, with the tree under test first."""
        trees = [str(self.root), str(self.root / "plugins"), *filter(None, [os.environ.get("PYTHONPATH")])]
        fixed = {"SOURCE_DATE_EPOCH": EPOCH, "NO_COLOR": "1", "COLUMNS": "200", "PROJ_NETWORK": "OFF"}
        return {**os.environ, "PYTHONPATH": os.pathsep.join(trees), **fixed}

    def run(self, name: str, *words: object, told: bool = False) -> None:
        """Run a command of geomosaic and take the digests of its folder; `told`: of what it prints as JSON, too."""
        command = ["-m", "geomosaic.cli", *map(str, words), *(["--json"] if told else [])]
        printed = self.process(name, *command)
        if told:
            (self.work / name / "told.json").write_text(printed, encoding="utf-8")
        self.keep(name)

    def draw(self, name: str, command: str, *words: object, to: str = "out.tif", told: bool = False) -> None:
        """Run a command that writes one file and what goes beside it."""
        (self.work / name).mkdir(parents=True, exist_ok=True)
        self.run(name, command, *words, "-o", f"{name}/{to}", told=told)

    def process(self, name: str, *words: object) -> str:
        """Run Python in the work folder; returns what it prints."""
        (self.work / name).mkdir(parents=True, exist_ok=True)
        started = time.perf_counter()
        done = subprocess.run(
            [sys.executable, *map(str, words)], cwd=self.work, env=self.environment(), check=False,
            capture_output=True, text=True, encoding="utf-8",
        )  # fmt: skip
        spent = time.perf_counter() - started
        self.commands[name] = {"code": done.returncode, "seconds": round(spent, 2)}
        if done.returncode:
            self.commands[name]["said"] = done.stderr.strip()[-500:]
        tell(f"{spent:6.1f} s  {name}{f': exit code {done.returncode}' if done.returncode else ''}")
        return done.stdout

    def keep(self, folder: str) -> None:
        """Take the digests of what a folder holds."""
        for path in self.files(folder):
            name = path.relative_to(self.work).as_posix()
            try:
                self.outputs[name] = KINDS[path.suffix.lower()](path)
            except Exception as error:
                self.outputs[name] = {"unreadable": f"{type(error).__name__}: {error}"}

    def files(self, folder: str) -> Iterator[Path]:
        """Files of the kinds that have digests."""
        for path in sorted((self.work / folder).rglob("*")):
            hidden = any(part.startswith(".") for part in path.relative_to(self.work).parts)
            if path.is_file() and path.suffix.lower() in KINDS and not hidden:
                yield path


def tell(line: str) -> None:
    """Print now."""
    print(line, flush=True)


# --- Inputs ---------------------------------------------------------------------------------------------------------

PHOTO = "sample/photos/strip2_02.jpg"
FOUR = [f"sample/photos/strip{strip}_0{number}.jpg" for strip in (1, 2) for number in (2, 3)]
ALL = [f"sample/photos/strip{strip}_0{number}.jpg" for strip in (1, 2, 3) for number in (1, 2, 3, 4)]
PLACED = (
    "--sensor", "frame", "--camera", "sample/camera.toml", "--exterior", "sample/exterior.csv", "--crs", CRS,
    "--heights", "egm96",
)  # fmt: skip
DEM = ("--dem", "sample/dem.tif")
TRUTH = "sample/truth/reflectance.tif"
BOX = (399_850, 5_499_850, 400_250, 5_500_150)
PLACE = ("--res", 1, "--bounds", *BOX)
FINE = ("--resampling", "cubic", "--res", 0.4, "--bounds", *BOX)
ROOM = (398_850, 5_499_055, 401_150, 5_500_950)
"""So wide that most of it stays empty, and costs little."""
WIDE = ("--res", 0.9, "--bounds", *ROOM)
COARSE = ("--res", 6, "--bounds", 399_100, 5_499_420, 400_800, 5_500_620)

METRES, FLAT_SIZE = 1.5, (320, 256)
"""Pixel and size of photos of flat ground."""


def write(path: Path, values: np.ndarray, **more: Any) -> None:
    """Write bands (bands, rows, cols) as GeoTIFF."""
    path.parent.mkdir(parents=True, exist_ok=True)
    bands, rows, cols = values.shape
    shape = {"driver": "GTiff", "count": bands, "height": rows, "width": cols, "dtype": values.dtype.name}
    with rasterio.open(path, "w", **shape, **more) as file:
        file.write(values)


def table(path: Path, head: str, rows: list[list[object]]) -> None:
    """Write a table."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [",".join(repr(float(v)) if isinstance(v, float) else str(v) for v in row) for row in rows]
    path.write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class FlatPhoto:
    """A photo of flat ground: turned, tilted and bent by less than a pixel, each by other numbers."""

    strip: int
    number: int

    @property
    def name(self) -> str:
        """File without suffix."""
        return f"flat{self.strip}{self.number}"

    @property
    def shape(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Centre on the map, rotation, and tilt per pixel."""
        k = 3 * self.strip + self.number
        turn = np.radians(2.5 * np.sin(1.7 * k) + (180.0 if self.strip else 0.0))
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        centre = np.array([399_570.0 + 290.0 * self.number, 5_500_320.0 - 250.0 * self.strip])
        return centre, rotation, 8e-5 * np.array([np.sin(2.0 * k + 1.0), np.cos(3.0 * k)])

    def bend(self, flat: np.ndarray) -> np.ndarray:
        """What the film does, pixels."""
        return 0.6 * np.column_stack([np.sin(flat[:, 1] / 60.0 + self.number), np.cos(flat[:, 0] / 70.0)])

    def seen(self, xy: np.ndarray) -> np.ndarray:
        """Map to pixels."""
        centre, rotation, tilt = self.shape
        u = (xy - centre) / [METRES, -METRES] @ rotation.T
        flat = u / (1.0 + u @ tilt)[:, None]
        return flat + self.bend(flat) + np.array(FLAT_SIZE) / 2

    def ground(self, colrow: np.ndarray) -> np.ndarray:
        """Pixels to map."""
        centre, rotation, tilt = self.shape
        bent = colrow - np.array(FLAT_SIZE) / 2
        flat = bent
        for _ in range(30):
            flat = bent - self.bend(flat)
        return centre + (flat / (1.0 - flat @ tilt)[:, None]) @ rotation * [METRES, -METRES]


FLAT = [FlatPhoto(strip, number) for strip in (0, 1) for number in (0, 1, 2)]
FLAT_FILES = [f"inputs/flat/{photo.name}.tif" for photo in FLAT]


def flat_photos(work: Path) -> None:
    """Six photos of flat ground, their tie and control points, and the control of one of them alone."""
    folder = work / "inputs" / "flat"
    with rasterio.open(work / TRUTH) as file:
        ground, transform = file.read(), file.transform
    cols, rows = FLAT_SIZE
    places = np.column_stack([part.ravel() for part in np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)])
    for photo in FLAT:
        at = np.array(~transform @ tuple(photo.ground(places).T)) - 0.5
        bands = [map_coordinates(band.astype(float), at[::-1], order=1).reshape(rows, cols) for band in ground]
        values = np.stack(bands) * (1.0 - 0.06 * photo.number) + 5.0 * photo.strip
        write(folder / f"{photo.name}.tif", np.clip(np.rint(values), 1, 255).astype(np.uint8))
    random = np.random.default_rng(3)
    x, y = np.meshgrid(np.arange(399_310.0, 400_440.0, 55.0), np.arange(5_499_850.0, 5_500_540.0, 55.0))
    known = np.column_stack([x.ravel(), y.ravel()]) + random.uniform(-12.0, 12.0, (x.size, 2))
    ties: list[list[object]] = []
    control: list[list[object]] = []
    for photo in FLAT:
        seen = photo.seen(known) + random.normal(0.0, 0.15, known.shape)
        inside = ((seen > 4) & (seen < np.array(FLAT_SIZE) - 4)).all(axis=1)
        for k in np.flatnonzero(inside):
            if k % 3:
                ties.append([f"t{k}", photo.name, *seen[k], 0.5])
            else:
                role = "check" if k % 2 else "control"
                control.append([f"c{k}", *known[k], 0.0, photo.name, *seen[k], 0.5, role])
    table(folder / "ties.csv", "id,image,col,row,sigma_px", ties)
    table(folder / "gcps.csv", "id,x,y,z,image,col,row,sigma_px,role", control)

    scan = FLAT[1]
    measured = np.column_stack([part.ravel() for part in np.meshgrid(*(np.linspace(12, n - 12, 6) for n in FLAT_SIZE))])
    true = scan.ground(measured)
    off = measured + random.normal(0.0, 0.15, measured.shape)
    rows_ = [[f"P{k}", *true[k], *off[k], "check" if k % 7 == 3 else "control"] for k in range(len(true))]
    table(folder / "scan.csv", "id,x,y,col,row,role", rows_)
    shown = true + random.normal(0.0, 0.4, true.shape)
    rows_ = [[f"P{k}", *true[k], *shown[k]] for k in range(len(true))]
    table(folder / "places.csv", "id,x,y,measured_x,measured_y", rows_)


def photos_of_other_kinds(work: Path) -> None:
    """The sample's photo in 16 bits and in floating point with holes; a surface with houses; vectors to draw."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(work / PHOTO) as file:
            values = file.read()
    write(work / "inputs/16/strip2_02.tif", (values.astype(np.uint16) + 3) * 150)
    floats = values[:1].astype(np.float32) / 255
    floats[:, 300:340, 500:560] = np.nan
    write(work / "inputs/float/strip2_02.tif", floats, nodata=float("nan"))

    with rasterio.open(work / "sample/dem.tif") as file:
        heights, profile = file.read(), {"crs": file.crs, "transform": file.transform, "nodata": file.nodata}
        at = ~file.transform @ (399_880.0, 5_500_120.0)
    col, row = int(at[0]), int(at[1])
    for down in (0, 20, 40):
        for across in (0, 20, 40, 60):
            heights[:, row + down : row + down + 6, col + across : col + across + 6] += 40.0 + across
    write(work / "inputs/town.tif", heights, **profile)

    along = np.linspace(399_300.0, 400_700.0, 60)
    roads = [
        shapely.LineString(np.column_stack([along, 5_500_000.0 + 60.0 * np.sin(along / 130.0)])),
        shapely.LineString([(400_050.0, 5_499_500.0), (400_080.0, 5_500_020.0), (400_010.0, 5_500_500.0)]),
    ]
    frame = geopandas.GeoDataFrame({"name": ["Long Road", "Cross Street"], "lanes": [2, 1]}, geometry=roads, crs=CRS)
    frame.to_file(work / "inputs/roads.gpkg", layer="roads")
    area = geopandas.GeoDataFrame(
        {"name": ["lake", "pond"]}, crs=CRS,
        geometry=[shapely.Point(400_020, 5_500_010).buffer(60.0), shapely.box(399_900, 5_499_900, 399_940, 5_499_930)],
    )  # fmt: skip
    area.to_file(work / "inputs/areas.gpkg", layer="areas")
    share = geopandas.GeoDataFrame(
        {"image": ["strip2_03.jpg"]}, geometry=[shapely.box(399_900, 5_499_950, 400_080, 5_500_100)], crs=CRS
    )
    share.to_file(work / "inputs/share.gpkg", layer="seams")
    outline = shapely.Polygon([(300.5, 200.5), (800.25, 240.75), (760.0, 600.0), (350.0, 560.5)])
    geopandas.GeoDataFrame({"name": ["field"]}, geometry=[outline]).to_file(work / "inputs/drawn.gpkg", layer="drawn")
    table(work / "inputs/pixels.csv", "id,col,row", [["a", 100.5, 200.5], ["b", 640.0, 480.0], ["c", 1100.25, 850.0]])


def pictures(work: Path) -> None:
    """Bands and a sharp band; rasters side by side; a strip, a film, a lake among hills; photos to develop."""
    with rasterio.open(work / TRUTH) as file:
        values, transform = file.read()[:, 200:840, 300:1100], file.transform @ Affine.translation(300, 200)
    sharp = (values.astype(float) * 40.0 + 200.0).astype(np.uint16)
    pan = np.rint(np.tensordot([0.3, 0.5, 0.2], sharp.astype(float), 1))[None].astype(np.uint16)
    coarse = np.rint(sharp.reshape(3, 160, 4, 200, 4).mean(axis=(2, 4))).astype(np.uint16)
    coarse[:, :12, :30] = 0
    write(work / "inputs/pan.tif", pan, crs=CRS, transform=transform)
    write(work / "inputs/bands.tif", coarse, crs=CRS, transform=transform @ Affine.scale(4.0), nodata=0)
    for k, name in enumerate("abc"):
        part = sharp[:, 100 * k : 100 * k + 400, 250 * k : 250 * k + 300] + np.uint16(150 * k)
        part[:, :60, :40] = 0
        place = transform @ Affine.translation(250 * k, 100 * k)
        write(work / f"inputs/parts/{name}.tif", part, crs=CRS, transform=place, nodata=0)
    write(work / "inputs/strip.tif", values[:, :400, :500])

    film = np.full((1, 1160, 1160), 40.0)
    film[0, 60:1100, 60:1100] = np.tile(values[1].astype(float), (2, 2))[:1040, :1040]
    row, col = np.mgrid[0:1160, 0:1160] + 0.5
    for x, y in ((-106.0, -106.0), (106.0, 106.0), (-106.0, 106.0), (106.0, -106.0)):  # millimetres of the marks
        near = np.hypot(col - (581.2 + 5.0 * x + 0.02 * y), row - (578.6 - 5.0 * y + 0.02 * x))
        film[0] = np.where(near < 16, 40.0, film[0])
        film[0] += 190.0 * np.clip(6.5 - near, 0.0, 1.0)
    write(work / "inputs/film/scan.tif", np.clip(film, 0, 255).astype(np.uint8))
    (work / "inputs/film/certificate.toml").write_text(
        "focal_length = 152.818\nprincipal_point_autocollimation = [0.006, -0.004]\n[fiducials]\n"
        "1 = [-106.003, -105.996]\n2 = [106.004, 105.998]\n3 = [-105.998, 106.007]\n4 = [106.001, -106.002]\n"
        '[distortion]\nmodel = "radial"\nradius = [0, 40, 80, 120, 160]\ndistortion = [0.0, -2.6, -1.9, 4.8, -6.3]\n',
        encoding="utf-8",
    )
    rows: list[list[object]] = [["scan.tif", 400_000.0, 5_500_000.0, 1500.0, 1.0, -1.5, 33.0]]
    table(work / "inputs/film/exterior.csv", "image,x,y,z,omega,phi,kappa", rows)

    y, x = np.mgrid[0:400, 0:400] + 0.5
    hills = 125 + 18 * np.sin(x / 60) * np.cos(y / 75) + 7 * np.sin((x + y) / 90)
    water, random = hills < 112.0, np.random.default_rng(7)
    scene = values[:, :400, :400].astype(float)
    scene[:, water] = np.array([45.0, 60.0, 55.0])[:, None]
    scene += random.normal(0.0, 1.5, scene.shape)
    place = Affine(1, 0, 400_000, 0, -1, 5_500_000)
    write(work / "inputs/lake.tif", np.clip(scene, 1, 255).astype(np.uint8), crs=CRS, transform=place)
    nodes = np.where(water, 112.0, hills).reshape(200, 2, 200, 2).mean(axis=(1, 3))[None].astype(np.float32)
    write(work / "inputs/lake-dem.tif", nodes, crs="EPSG:32633+5773", transform=place @ Affine.scale(2.0))

    rows = []
    for name, turn in (("strip1_01.jpg", -0.3), ("strip1_02.jpg", 0.35)):
        centre = np.array([14.0 * np.cos(turn), 14.0 * np.sin(turn), 5.0])
        back = (centre - [0.0, 0.0, 6.0]) / np.linalg.norm(centre - [0.0, 0.0, 6.0])
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        rows.append([name, *centre, *right, *np.cross(back, right), *back])
    head = "image,x,y,z," + ",".join(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
    table(work / "inputs/developed.csv", head, rows)
    for name, said in SURFACES.items():
        (work / f"inputs/{name}.toml").write_text(said, encoding="utf-8")


SURFACES = {
    "plane": 'kind = "plane"\npoint = [4.0, 0.0, 3.0]\nnormal = [1.0, 0.1, 0.05]\nbottom = -2.5\ntop = 7.0\n',
    "cylinder": (
        'kind = "cylinder"\npoint = [0.0, 0.0, 0.0]\naxis = [0.03, -0.02, 1.0]\nzero = [1.0, 0.0, 0.0]\n'
        "radius = 4.0\nbottom = 1.0\ntop = 12.0\n"
    ),
    "cone": 'kind = "cone"\napex = [0.0, 0.0, 18.0]\naxis = [0, 0, 1]\nhalf_angle = 15.0\nbottom = -16.0\ntop = -7.0\n',
}


def inputs(bench: Bench) -> None:
    """Everything that commands read."""
    sample, made = bench.root / "data" / "sample", shutil.ignore_patterns(".*", "output")
    shutil.copytree(sample, bench.work / "sample", ignore=made)
    (bench.work / "inputs").mkdir()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        flat_photos(bench.work)
        photos_of_other_kinds(bench.work)
        pictures(bench.work)


# --- Commands -------------------------------------------------------------------------------------------------------


def whole(bench: Bench) -> None:
    """The demo, and the gallery, whose script belongs to the tree under test."""
    bench.run("demo", "demo", "demo")
    for name in [name for name in bench.outputs if name.startswith("demo/") and not name.startswith("demo/output/")]:
        del bench.outputs[name]  # copies of the sample
    script = bench.root / "docs" / "gallery" / "make_gallery.py"
    bench.process("gallery", script, "gallery")
    bench.keep("gallery")


def orthos(bench: Bench) -> None:
    """One photo: kernels, surfaces, map projections, kinds of pixels; film, RPC and scanners."""
    other = {"16": "inputs/16/strip2_02.tif", "float": "inputs/float/strip2_02.tif"}
    for kernel in ("bilinear", "cubic", "lanczos", "nearest"):
        bench.draw(f"ortho-{kernel}", "ortho", PHOTO, *PLACED, *DEM, *PLACE, "--resampling", kernel)
        bench.draw(f"ortho-{kernel}-wide", "ortho", PHOTO, *PLACED, *DEM, *WIDE, "--resampling", kernel)
        of_16_bits = ("ortho", other["16"], *PLACED, *DEM, "--resampling", kernel)
        bench.draw(f"ortho-{kernel}-16", *of_16_bits, *(WIDE if kernel != "lanczos" else PLACE))
    for name, area in (("average", ()), ("average-wide", ("--bounds", *ROOM))):
        bench.draw(f"ortho-{name}", "ortho", PHOTO, *PLACED, *DEM, "--res", 3, "--resampling", "average", *area)
    for name, area in (("true", PLACE), ("true-wide", WIDE)):
        bench.draw(f"ortho-{name}", "ortho", PHOTO, *PLACED, "--dem", "inputs/town.tif", *area, "--true-ortho")
    bench.draw("ortho-height", "ortho", PHOTO, *PLACED, "--height", 480, *PLACE)
    bench.draw("ortho-puwg", "ortho", PHOTO, *PLACED, *DEM, "--dst-crs", "EPSG:2180", "--res", 2.5)
    bench.draw("ortho-degrees", "ortho", PHOTO, *PLACED, *DEM, "--dst-crs", "EPSG:4326", "--res", 0.00003)
    corner = ("--res", 0.7, "--bounds", 399_900, 5_499_800, 400_258.4, 5_500_158.4)
    bench.draw("ortho-512", "ortho", PHOTO, *PLACED, *DEM, *corner)
    exact = ("--tolerance", 0, "--nodata", 0, "-f", "GTiff", "-b", "3,1", "--margin", 40)
    bench.draw("ortho-exact", "ortho", PHOTO, *PLACED, *DEM, "--res", 4, *exact)
    bench.draw("ortho-float", "ortho", other["float"], *PLACED, *DEM, *PLACE)
    bench.draw("ortho-float-fine", "ortho", other["float"], *PLACED, *DEM, *FINE)

    film = ("--camera", "inputs/film/certificate.toml")
    template = ("--template", "inputs/film/scan.tif", "--at", 52, 1108, "--side", 6, "--pixel-size", 200)
    bench.draw("fiducials", "fiducials", "inputs/film/scan.tif", *film, *template, to="marks.csv")
    bench.draw(
        "ortho-film", "ortho", "inputs/film/scan.tif", "--sensor", "frame", *film, "--fiducials", "fiducials/marks.csv",
        "--exterior", "inputs/film/exterior.csv", "--crs", CRS, "--heights", "egm96", "--height", 450,
        "--option", "refraction=true", "--res", 4,
    )  # fmt: skip

    (bench.work / "rpc").mkdir()
    shutil.copy(bench.work / PHOTO, bench.work / "rpc" / "strip2_02.jpg")
    scene = "rpc/strip2_02.jpg"
    bench.run("rpc", "rpc", scene, *PLACED, *DEM, "--text", "--grid", told=True)
    rpc = ("--sensor", "rpc", "--option", "refine=none", "--dst-crs", CRS)
    bench.draw("ortho-rpc", "ortho", scene, *rpc, *DEM, *PLACE)
    grid = ("--corrections", "rpc/{image}_RPC_grid.csv")
    bench.draw("ortho-rpc-grid", "ortho", scene, *rpc, *grid, *DEM, *PLACE)
    (bench.work / "rpc-refined").mkdir()
    control = ("--gcps", "sample/gcps.csv", "--crs", CRS, "--heights", "egm96")
    bench.run(
        "rpc-refined", "rpc", scene, "--refine", "shift", *control, "--text", "--folder", "rpc-refined", told=True
    )

    strip = ("--option", "kind=scanner", "--option", "field_of_view=60")
    flown = (*strip, "--option", "height_above_ground=1000", "--option", "v_over_h=0.002")
    bench.draw("deskew", "deskew", "inputs/strip.tif", *flown, "--res", 2.5, "--resampling", "cubic")
    words = ("position=[400000,5500000,1500]", "heading=30", "pitch=1.5", "advance=2.0", "ground_height=480")
    options = [word for option in words for word in ("--option", option)]
    bench.draw(
        "ortho-scanner", "ortho", "inputs/strip.tif", "--sensor", "panoramic", "--crs", CRS, "--heights", "egm96", *DEM,
        *strip, *options, "--res", 2.5,
    )  # fmt: skip


def projects(bench: Bench) -> None:
    """A project from nothing to orthos and report; and again after an edit, with what is still fresh."""
    (bench.work / "project").mkdir()
    bench.run("project-new", "new", "project/project.toml", *FOUR, *PLACED, *DEM, "--gcps", "sample/gcps.csv")
    file = bench.work / "project" / "project.toml"
    said = file.read_text(encoding="utf-8") if file.exists() else ""
    left, bottom, right, top = BOX
    said = said.replace("# orthos = true", "orthos = true").replace("# resolution = 0.5", "resolution = 1.0")
    said = said.replace("# bounds = [left, bottom, right, top]", f"bounds = [{left}, {bottom}, {right}, {top}]")
    said = said.replace("[mosaic]\n", "[mosaic]\nviews = true\ndisplacement = 450.0\n")
    file.write_text(said, encoding="utf-8")
    bench.run("project", "run", "project/project.toml")
    edited = bench.work / "project-edited"
    shutil.copytree(bench.work / "project", edited)
    said = said.replace('# cutlines = "mine.gpkg"', 'cutlines = "../inputs/share.gpkg"')
    said += '\n[mosaic.retouch."strip1_02.jpg"]\ngain = 1.05\noffset = 2.0\n'
    (edited / "project.toml").write_text(said, encoding="utf-8")
    bench.run("project-edited", "run", "project-edited/project.toml")


MOSAICS: dict[str, tuple[object, ...]] = {
    "defaults": PLACE,
    "wide": WIDE,
    "views": (*PLACE, "--views", "--displacement", 450, "--seam-quality"),
    "unbalanced": (*PLACE, "--no-balance", "--no-limit", "--ramp", "smooth"),
    "histogram-overlap": (*FINE, "--histogram", "overlap"),
    "histogram-whole": (*PLACE, "--histogram", "whole", "--region", "inputs/areas.gpkg"),
    "histogram-sequence": (*PLACE, "--histogram", "sequence", "--feather", "5m"),
    "reference": (*PLACE, "--reference", TRUTH, "--mask", "inputs/areas.gpkg"),
    "halve": (*PLACE, "--seams", "halve", "--exclude", "strip1_03.jpg"),
    "order": (*PLACE, "--seams", "order", "--order", "name", "--base", "strip2_03.jpg"),
    "alike": (*FINE, "--seams", "graph-cut", "--follow", "inputs/roads.gpkg", "--avoid", "inputs/areas.gpkg"),
    "cutlines": (*PLACE, "--cutlines", "inputs/share.gpkg"),
    "multiband": (*PLACE, "--blend", "multiband"),
    "multiband-fine": (*FINE, "--blend", "multiband"),
    "overlap": (*PLACE, "--blend", "overlap"),
    "overlap-fine": (*FINE, "--blend", "overlap", "--no-limit"),
    "none": (*PLACE, "--blend", "none", "--resampling", "nearest", "-f", "GTiff", "--nodata", 0),
    "stretch": (*FINE, "--stretch", "2,98", "--margin", 50),
    "water": (*PLACE, "--water", "inputs/areas.gpkg"),
    "water-tone": (*FINE, "--water", "inputs/areas.gpkg", "--water-fill", "tone"),
    "mean": (*PLACE, "--rule", "mean", "--balance"),
}
"""Words for mosaics of four photos over the same place."""
TERMS = {"lens": "gain,vignetting,trend", "sun": "gain,hotspot,haze,gamma,dodging"}
RULES = ("mean", "median", "max", "first", "sum", "count")


def mosaics(bench: Bench) -> None:
    """Colours, seams, blends, rules; from photos and from orthos."""
    for name, words in MOSAICS.items():
        bench.draw(f"mosaic-{name}", "mosaic", *FOUR, *PLACED, *DEM, *words)
    for name, area in (("true", PLACE), ("true-fine", FINE)):
        town = ("--dem", "inputs/town.tif", "--true-ortho", "--seams", "graph-cut")
        bench.draw(f"mosaic-{name}", "mosaic", *FOUR, *PLACED, *town, *area)
    for name, terms in TERMS.items():
        bench.draw(f"colour-{name}", "mosaic", *ALL, *PLACED, *DEM, *COARSE, "--colour", terms)
    degrees = ("--dst-crs", "EPSG:4326", "--res", 0.00004, "--resampling", "average", "--colour", "gain")
    bench.draw("mosaic-degrees", "mosaic", *FOUR, *PLACED, *DEM, *degrees)
    made = [f"project/output/orthos/{Path(photo).stem}.tif" for photo in FOUR]
    for rule in RULES:
        bench.draw(f"rule-{rule}", "mosaic", *made, "--rule", rule, *(FINE if rule in ("max", "median") else ()))
    range_ = ("--rule", "first", "--dtype", "uint16", "--convert", "range", "--bands", "blue,red")
    bench.draw("rule-range", "mosaic", *made, *range_, "--like", "ortho-average/out.tif")
    parts = [f"inputs/parts/{name}.tif" for name in "abc"]
    bench.draw("rasters", "mosaic", *parts, "--seams", "halve", "--blend", "multiband", "--res", 2)
    bench.draw("rasters-stretch", "mosaic", *parts, "--histogram", "overlap", "--res", 2.5, "--stretch", "v300,v9000")


def flat_ground(bench: Bench) -> None:
    """Photos placed by points: one by each kind of fit, many by each kind of mosaic, and joined at edges."""
    scan, control = FLAT_FILES[1], ("--gcps", "inputs/flat/scan.csv", "--crs", CRS, "--insist")
    for model in ("conformal", "affine", "projective", "poly2", "poly3", "tps", "auto"):
        bench.draw(f"georeference-{model}", "georeference", scan, *control, "--model", model, "--res", 1.5)
    places = ("--points", "inputs/flat/places.csv", "--crs", CRS)
    bench.run("check", "check", "georeference-poly3/out.tif", *places, told=True)
    tables = ("--ties", "inputs/flat/ties.csv", "--insist")
    known = ("--gcps", "inputs/flat/gcps.csv", "--crs", CRS)
    alone = ("--scale", 1.5, "--resampling", "cubic", "--res", 0.9)
    bench.draw("planar-uncontrolled", "mosaic", *FLAT_FILES, "--kind", "uncontrolled", *tables, *alone)
    for kind in ("semicontrolled", "controlled", "grown"):
        bench.draw(f"planar-{kind}", "mosaic", *FLAT_FILES, "--kind", kind, *tables, *known, "--res", 1.5)
    common = ("--common", "inputs/flat/ties.csv", "--insist")
    for model in ("affine", "projective"):
        bench.draw(
            f"edges-{model}", "edges", *FLAT_FILES[:3], *known, *common, "--model", model, "--res", 1.5, told=True
        )


def maps(bench: Bench) -> None:
    """What is made of rasters that are there, and places from one photo."""
    bench.draw("reproject-fine", "reproject", TRUTH, "--dst-crs", "EPSG:32632", "--res", 0.5)
    bench.draw("reproject-puwg", "reproject", TRUTH, "--dst-crs", "EPSG:2180", "--res", 2, "--resampling", "lanczos")
    bench.draw("reproject-degrees", "reproject", TRUTH, "--dst-crs", "EPSG:4326", "--resampling", "average")
    bench.draw("reproject-16", "reproject", "inputs/bands.tif", "--dst-crs", "EPSG:25832", "--resampling", "cubic")
    bench.draw("reproject-heights", "reproject", "sample/dem.tif", "--dst-crs", "EPSG:3857", "--res", 8)
    bench.draw("reproject-vectors", "reproject", "inputs/roads.gpkg", "--dst-crs", "EPSG:2180", to="out.gpkg")
    bench.draw("contours", "contours", "sample/dem.tif", "--interval", 10, to="out.gpkg")
    close = ("--interval", 5, "--tolerance", 0.02)
    bench.draw("contours-close", "contours", "sample/dem.tif", *close, to="out.gpkg")
    bench.draw("water", "water", "inputs/lake.tif", "--dem", "inputs/lake-dem.tif", to="out.gpkg")

    looks = ("--stretch", "percentile", "--gamma", 1.2, "--clahe", 2, "--sharpen", 0.5)
    bench.draw("enhance", "enhance", TRUTH, *looks, "--hillshade", "sample/dem.tif")
    bench.draw("enhance-equalise", "enhance", "inputs/bands.tif", "-b", "3,2,1", "--stretch", "equalise")
    for method in ("regression", "weighted", "brovey"):
        bench.draw(f"pan-{method}", "enhance", "inputs/bands.tif", "--pan", "inputs/pan.tif", "--method", method)

    photo = (PHOTO, *PLACED, *DEM)
    sigmas = ("--sigma-px", 0.5, "--sigma-dem", 2)
    bench.run("locate", "locate", PHOTO, "inputs/pixels.csv", *photo[1:], *sigmas, told=True)
    words = ("--rows", "down", "--step", 20)
    bench.draw("locate-drawn", "locate", PHOTO, "inputs/drawn.gpkg", *words, *photo[1:], to="out.geojson")
    words = ("--inverse", "--rows", "negative", "--mark-hidden")
    bench.draw("locate-inverse", "locate", PHOTO, "inputs/roads.gpkg", *words, *photo[1:], to="out.gpkg")

    for name in SURFACES:
        images = ALL[1:2] if name == "plane" else ALL[:2]
        finer = ("--res", 0.015, "--resampling", "cubic") if name == "cylinder" else ("--res", 0.03)
        bench.draw(
            f"develop-{name}", "develop", *images, "--sensor", "frame", "--camera", "sample/camera.toml", "--exterior",
            "inputs/developed.csv", "--angles", "matrix", "--matrix", "ground_to_image", "--surface",
            f"inputs/{name}.toml", *finer,
        )  # fmt: skip


def sheets(bench: Bench) -> None:
    """Sheets in every format, and a series."""
    named = ("--vector", "inputs/roads.gpkg:road", "--contours", "sample/dem.tif", "--interval", 10, "--title", "Map")
    bench.draw("sheet", "sheet", TRUTH, "--scale", "1:10000", "--paper", "A4", *named, to="out.pdf")
    coarse = ("--dpi", 100, "--gamma", 1.3, "--hillshade", "sample/dem.tif")
    bench.draw("sheet-picture", "sheet", TRUTH, "--scale", "1:10000", "--paper", "A4", *coarse, to="out.png")
    bench.draw("sheet-map", "sheet", TRUTH, "--scale", "1:10000", "--paper", "A4", "--dpi", 127, *named[:4])
    bench.draw("sheet-tiles", "sheet", TRUTH, "--scale", "1:10000", "--paper", "A4", "--dpi", 100, to="out.mbtiles")
    bench.draw("sheet-earth", "sheet", TRUTH, "--scale", "1:10000", "--paper", "A4", "--dpi", 100, to="out.kmz")
    grid = ("--scheme", "grid", "--size", 700, 700, "--crs", CRS, "--scale", "1:10000")
    bench.run("sheets", "sheets", "make", TRUTH, *grid, "--format", "png", "--dpi", 100, *named[:2], "-o", "sheets")
    square = ("--scheme", "mgrs", "--size", 1000, 1000, "--scale", "1:10000", "--only", "33UVR0000")
    bench.run("sheets-mgrs", "sheets", "make", TRUTH, *square, *named[2:6], "-o", "sheets-mgrs")


def record(root: Path, work: Path) -> Record:
    """Draw everything.

    Parameters
    ----------
    root : Path
        The tree whose code and sample are used.
    work : Path
        Empty folder; what is drawn stays there.

    Returns
    -------
    dict
        `outputs` by path, and `commands`.
    """
    bench = Bench(root, work)
    inputs(bench)
    for part in (whole, orthos, projects, mosaics, flat_ground, maps, sheets):
        part(bench)
    return {"format": 1, "commands": bench.commands, "outputs": bench.outputs}


# --- Comparing ------------------------------------------------------------------------------------------------------


def apart(old: np.ndarray, new: np.ndarray) -> tuple[np.ndarray, float]:
    """Where two arrays differ, and by how much at most; unknown is like unknown."""
    if old.dtype.kind == "f":
        same = (old == new) | (np.isnan(old) & np.isnan(new))
    else:
        same = old == new
    if same.all():
        return ~same, 0.0
    return ~same, float(np.nanmax(np.abs(old[~same].astype(float) - new[~same].astype(float)), initial=0.0))


def rasters_apart(old: Path, new: Path) -> str:
    """How many pixels of two rasters differ, and by how much."""
    with rasterio.open(old) as a, rasterio.open(new) as b:
        if (a.count, a.shape) != (b.count, b.shape):
            return f"{a.count} x {a.shape} and {b.count} x {b.shape} pixels"
        values, largest = apart(a.read(), b.read())
        masks, _ = apart(a.read_masks(), b.read_masks())
    some = values.any(axis=0)
    return (
        f"{int(some.sum())} of {some.size} pixels differ ({some.mean():.2%}), by {largest:g} at most; "
        f"{int(masks.any(axis=0).sum())} in the mask"
    )


def looks_apart(old: Path, new: Path) -> str:
    """The same of pages and pictures."""
    before, after = ([picture(path)] if path.suffix == ".png" else pages(path) for path in (old, new))
    said = []
    for k, (a, b) in enumerate(zip(before, after, strict=False), 1):
        if a.shape != b.shape:
            said.append(f"page {k}: {a.shape} and {b.shape} pixels")
            continue
        differ, largest = apart(a, b)
        some = differ.any(axis=-1) if differ.ndim == 3 else differ
        said.append(f"page {k}: {int(some.sum())} of {some.size} pixels differ ({some.mean():.2%}), by {largest:g}")
    return "; ".join([*said, *([f"{len(before)} and {len(after)} pages"] if len(before) != len(after) else [])])


def vectors_apart(old: Path, new: Path) -> str:
    """How many rows of layers differ, and how far the geometries are from each other where they are as many."""
    before, after, said = layers_of(old), layers_of(new), []
    for name in sorted({*before, *after}):
        if name not in before or name not in after:
            said.append(f"layer {name} {'gone' if name in before else 'new'}")
            continue
        a, b = rows_of(before[name]), rows_of(after[name])
        if a == b:
            continue
        line = f"layer {name}: {len(set(a) - set(b))} of {len(a)} rows are not among the {len(b)} new ones"
        if len(a) == len(b) and hasattr(before[name], "geometry") and hasattr(after[name], "geometry"):
            pair = shapely.hausdorff_distance(before[name].geometry.to_numpy(), after[name].geometry.to_numpy())
            line += f", geometries up to {np.nanmax(pair, initial=0.0):g} apart"
        said.append(line)
    return "; ".join(said)


def leaves(value: Any, at: str = "") -> dict[str, Any]:
    """Numbers and texts of JSON by their places."""
    if isinstance(value, dict):
        parts = [(f"{at}.{key}" if at else key, part) for key, part in value.items()]
    elif isinstance(value, list):
        parts = [(f"{at}[{k}]", part) for k, part in enumerate(value)]
    else:
        return {at: value}
    return {place: leaf for name, part in parts for place, leaf in leaves(part, name).items()}


def facts_apart(old: Path, new: Path) -> str:
    """Which places of two JSON files differ; three of them in words."""
    before, after = leaves(facts_of(old)), leaves(facts_of(new))
    differ = [place for place in {**before, **after} if before.get(place, ...) != after.get(place, ...)]
    some = [f"{place}: {before.get(place, 'nothing')} and {after.get(place, 'nothing')}" for place in differ[:3]]
    return f"{len(differ)} of {len(before)} values; {'; '.join(some)}"


def lines_apart(old: Path, new: Path) -> str:
    """How many lines of two texts differ, and the first of them."""
    before, after = (path.read_text(encoding="utf-8").splitlines() for path in (old, new))
    differ = [f"{a[:80]!r} and {b[:80]!r}" for a, b in zip(before, after, strict=False) if a != b]
    counts = f"{len(before)} and {len(after)} lines, " if len(before) != len(after) else ""
    return f"{counts}{len(differ)} lines differ{f': {differ[0]}' if differ else ''}"


DETAILS: dict[str, Callable[[Path, Path], str]] = {
    ".tif": rasters_apart, ".gpkg": vectors_apart, ".geojson": vectors_apart, ".pdf": looks_apart, ".png": looks_apart,
    ".json": facts_apart, ".html": lines_apart, ".csv": lines_apart, ".toml": lines_apart, ".txt": lines_apart,
}  # fmt: skip


def differences(old: Record, new: Record, old_work: Path | None, work: Path | None) -> list[str]:
    """What differs between two recordings, a line each.

    Parameters
    ----------
    old, new : dict
        Of `record`.
    old_work, work : Path, optional
        What was drawn; with both, the differences are measured.
    """
    said = []
    for name in sorted({*old["commands"], *new["commands"]}):
        codes = [side["commands"].get(name, {}).get("code") for side in (old, new)]
        if codes[0] != codes[1]:
            said.append(f"command {name}: exit code {codes[0]} before, {codes[1]} now")
    before, after = old["outputs"], new["outputs"]
    for name in sorted({*before, *after}):
        if name not in before or name not in after:
            said.append(f"{name}: {'gone' if name in before else 'new'}")
        elif before[name] != after[name]:
            keys = [key for key in {**before[name], **after[name]} if before[name].get(key) != after[name].get(key)]
            line = f"{name}: {', '.join(keys)}"
            measure = DETAILS.get(Path(name).suffix.lower())
            if measure and old_work and work and (old_work / name).exists() and (work / name).exists():
                try:
                    line += f"; {measure(old_work / name, work / name)}"
                except Exception as error:
                    line += f"; not measured: {error}"
            said.append(line)
    return said


def main(arguments: list[str] | None = None) -> int:
    """Record, and compare where that is asked for."""
    words = argparse.ArgumentParser(prog="python -m benchmarks.pixels", description=(__doc__ or "").partition("\n")[0])
    words.add_argument("out", type=Path, metavar="OUT.json", help="file to write")
    words.add_argument("--root", type=Path, default=Path(__file__).resolve().parent.parent, help="tree under test")
    words.add_argument("--work", type=Path, help="folder for what is drawn, emptied first (default: none stays)")
    words.add_argument("--against", type=Path, metavar="OLD.json", help="compare with this; exit code 1 if any differs")
    words.add_argument("--old-work", type=Path, help="what was drawn then: tells how many pixels differ, and how much")
    given = words.parse_args(arguments)
    warnings.simplefilter("ignore", NotGeoreferencedWarning)
    with tempfile.TemporaryDirectory() as scratch:
        work = (given.work or Path(scratch) / "work").resolve()
        if work.exists() and any(work.iterdir()):
            if not (work / OURS).is_file():
                words.error(f"{work} holds something else")
            shutil.rmtree(work)
        work.mkdir(parents=True, exist_ok=True)
        (work / OURS).touch()
        started = time.perf_counter()
        new = record(given.root.resolve(), work)
        given.out.write_text(json.dumps(new, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        failed = [name for name, done in new["commands"].items() if done["code"]]
        tell(f"{len(new['outputs'])} outputs of {len(new['commands'])} commands, {time.perf_counter() - started:.0f} s")
        for name in failed:
            tell(f"failed: {name}: {new['commands'][name]['said']}")
        if given.against is None:
            return int(bool(failed))
        old = json.loads(given.against.read_text(encoding="utf-8"))
        said = differences(old, new, given.old_work, work)
    for line in said:
        tell(line)
    tell(f"{len(said)} differences from {given.against}" if said else f"all as in {given.against}")
    return int(bool(said))


if __name__ == "__main__":
    raise SystemExit(main())
