"""Pictures, heights and vectors of the gallery: made of the sample's photos and of the formulas of its ground."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
import shapely
from affine import Affine

from geomosaic.cli.main import run
from geomosaic.geo.crs import parse_crs
from geomosaic.raster.vector import Layer, write_layers
from geomosaic.testing.synthetic.ground import Land
from geomosaic.testing.synthetic.relief import HILLS, heights, relief, river

ROOT = Path(__file__).resolve().parent.parent.parent
SAMPLE = ROOT / "data" / "sample"
SAMPLE_ORIGIN = (400_000.0, 5_500_000.0)
HILL_NAMES = ("Long Hill", "Fox Hill", "Windmill Hill", "Bare Hill", "Goose Hill", "Little Hill")
AREAS = (("Upper Fields", -60.0, 330.0), ("Brook Meadows", 480.0, -330.0), ("Far Fields", -740.0, 20.0))


@dataclass(frozen=True)
class Ground:
    """The formulas of the sample's ground drawn larger, somewhere on a map.

    Attributes
    ----------
    crs : str
        Projected, metres.
    centre : tuple of float
        Where the middle of the land lies, in `crs`.
    size : tuple of float
        Width and height, metres.
    pixel : float
        Metres.
    larger : float
        Factor on the land's lengths.
    rise : float
        Factor on its heights.
    seed : int
        Which fields and woods.
    """

    crs: str
    centre: tuple[float, float]
    size: tuple[float, float]
    pixel: float
    larger: float
    rise: float = 2.0
    seed: int = 7

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """EGM96 heights (N,) at places of the map."""
        return 450.0 + self.rise * heights((x - self.centre[0]) / self.larger, (y - self.centre[1]) / self.larger)

    def colour(self, x: np.ndarray, y: np.ndarray, bands: tuple[int, ...]) -> np.ndarray:
        """Colours (N, bands) from 0 to 1, of bands counted from red, green, blue, near infrared."""
        u, v = (
            ((at - middle) / self.larger).astype(np.float32) for at, middle in zip((x, y), self.centre, strict=True)
        )
        _, zu, zv = relief(u, v)
        slope = np.float32(self.rise / self.larger)
        land = Land(max(2.5, 2.0 * self.pixel / self.larger), self.seed, 4)
        return land(u, v, slope * zu, slope * zv)[:, [band - 1 for band in bands]]

    def write(self, folder: Path, name: str, bands: tuple[int, ...] = ()) -> None:
        """Write `NAME-dem.tif` of nodes at 4 pixels, and `NAME.tif` where bands are named."""
        for step, suffix in ((4 * self.pixel, "-dem"), (self.pixel, ""))[: 2 if bands else 1]:
            cols, rows = (round(length / step) for length in self.size)
            left, top = self.centre[0] - cols * step / 2, self.centre[1] + rows * step / 2
            x, y = left + step * (np.arange(cols) + 0.5), top - step * (np.arange(rows) + 0.5)
            places = [part.ravel() for part in np.meshgrid(x, y)]
            if suffix:
                values = self.height(*places).reshape(1, rows, cols)
                crs, kind = f"{self.crs}+5773", "float32"
            else:
                values = (255.0 * self.colour(*places, bands).T + 0.5).reshape(len(bands), rows, cols)
                crs, kind = self.crs, "uint8"
            with rasterio.open(
                folder / f"{name}{suffix}.tif", "w", driver="GTiff", width=cols, height=rows, count=len(values),
                dtype=kind, crs=crs, transform=Affine(step, 0.0, left, 0.0, -step, top), tiled=True, compress="deflate",
            ) as out:  # fmt: skip
                out.write(values.astype(kind))

    def vectors(self, path: Path) -> None:
        """Write the layers `water`, `roads`, `hills` and `areas`."""
        write_vectors(path, self.crs, self.centre, self.larger)


def write_vectors(path: Path, crs: str, centre: tuple[float, float], larger: float = 1.0) -> None:
    """Brook and roads as the formulas have them, hills where they are highest, names of areas."""
    sys.path.insert(0, str(ROOT / "docs" / "sheet"))
    from make_map import ROADS

    middle, along = np.array(centre), np.linspace(-1000.0, 1000.0, 401)
    lines = []
    for amplitude, length, phase, offset, northward, _, _ in ROADS:
        aside = offset + amplitude * np.sin(along / length + phase)
        lines.append(np.column_stack((aside, along) if northward else (along, aside)))
    brook = np.column_stack([along, river(along)[0]])
    frame = parse_crs(crs)
    course = shapely.LineString(middle + larger * brook)
    summits = [shapely.Point(middle + larger * hill[1:3]) for hill in HILLS]
    rings = [shapely.Point(middle + larger * np.array(place)).buffer(150.0 * larger) for _, *place in AREAS]
    write_layers(
        path,
        {
            "water": Layer(frame, "LineString", [course], {"name": ["Sample Brook"]}),
            "roads": Layer(
                frame, "LineString", [shapely.LineString(middle + larger * line) for line in lines],
                {"class": [road[5] for road in ROADS], "name": [road[6] for road in ROADS]},
            ),
            "hills": Layer(frame, "Point", summits, {"name": list(HILL_NAMES)}),
            "areas": Layer(frame, "Polygon", rings, {"name": [name for name, _, _ in AREAS]}),
        },
        overwrite=True,
    )  # fmt: skip


def command(*words: object) -> None:
    """Run a command of geomosaic.

    Raises
    ------
    SystemExit
        It failed.
    """
    if run([str(word) for word in words]) != 0:
        raise SystemExit(f"failed: geomosaic {' '.join(map(str, words))}")


def sensor() -> list[str]:
    """Options that say how the sample's photos were taken."""
    return [
        "--sensor", "frame", "--camera", str(SAMPLE / "camera.toml"), "--exterior", str(SAMPLE / "exterior.csv"),
        "--crs", "EPSG:32633", "--heights", "egm96", "--dem", str(SAMPLE / "dem.tif"), "--threads", "1",
    ]  # fmt: skip


def sample_mosaic(folder: Path) -> None:
    """Write `photomap.tif`, a mosaic of eight photos, with the STAC item that `geomosaic mosaic` puts beside it."""
    photos = [SAMPLE / "photos" / f"strip{strip}_0{number}.jpg" for strip in (1, 2, 3) for number in (1, 2, 3, 4)]
    area = ("--bounds", 399_100, 5_499_420, 400_800, 5_500_620)
    command("mosaic", *photos, *sensor(), "--res", 1, *area, "--colour", "gain,vignetting", "--no-labels",
            "-o", folder / "photomap.tif")  # fmt: skip


def old_photo(folder: Path) -> None:
    """Write `old.tif`: one photo as old film would have it, grey and grainy, rectified over the relief."""
    from PIL import Image

    rng = np.random.default_rng(1938)
    with Image.open(SAMPLE / "photos" / "strip2_02.jpg") as image:
        grey = np.asarray(image.convert("L"), dtype=float)
    rows, cols = np.mgrid[-1 : 1 : 1j * grey.shape[0], -1 : 1 : 1j * grey.shape[1]]
    grey = 128 + 1.25 * (grey - grey.mean()) - 16 * (rows**2 + cols**2) + rng.normal(0, 7, grey.shape)
    for _ in range(9):  # scratches
        at, lean = rng.uniform(0, grey.shape[1]), rng.normal(0, 0.02)
        first, last = np.sort(rng.integers(0, grey.shape[0], 2))
        line = np.arange(first, last)
        grey[line, np.clip(at + lean * line, 0, grey.shape[1] - 1).astype(int)] += 45
    name = "strip2_02.png"  # as the orientation table calls it
    Image.fromarray(np.clip(grey, 0, 255).astype(np.uint8)).save(folder / name)
    command("ortho", folder / name, *sensor(), "--res", 0.7, "-o", folder / "old.tif")
