"""The seven sheets of the gallery: PDF and PNG, from what is in the repository alone.

python docs/gallery/make_gallery.py OUT            PDF of all sheets
python docs/gallery/make_gallery.py --pictures     and their pictures for the page, in this folder
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import numpy as np  # noqa: E402
from dome import dome  # noqa: E402
from satellite import Satellite  # noqa: E402
from scenes import Ground, command, old_photo, sample_mosaic, write_vectors  # noqa: E402
from symbols import write as write_symbols  # noqa: E402

from geomosaic.geo.crs import parse_crs  # noqa: E402
from geomosaic.geo.transform import Transform  # noqa: E402

SPOT = Ground("EPSG:32633", (400_000.0, 5_500_000.0), (9_000.0, 7_400.0), 5.0, 4.0)
SPOT_MAP = (396_550.0, 5_497_350.0, 403_450.0, 5_502_650.0)
PUWG = Ground("EPSG:2180", (555_930.0, 239_580.0), (4_800.0, 4_900.0), 4.0, 3.0, rise=1.2, seed=11)
ZONES = Ground("EPSG:32633", (718_600.0, 5_480_000.0), (6_900.0, 5_300.0), 5.0, 4.5, rise=3.0, seed=23)
SYMBOLS = Ground("EPSG:32633", (400_000.0, 5_500_000.0), (2_500.0, 2_200.0), 2.0, 2.5, seed=5)
PUWG_SHEET = "M-34-64-D-c-3"


def _sheet(folder: Path, raster: str, *words: object) -> Path:
    out = folder / f"{raster}.pdf"
    command("sheet", folder / f"{raster}.tif", "--layout", folder / f"{raster}.toml", *words, "-o", out)
    return out


def photomap(folder: Path) -> Path:
    """Photomap 1 : 5 000 on A3: a mosaic of the sample, with what its STAC item says of it."""
    from scenes import SAMPLE, SAMPLE_ORIGIN

    sample_mosaic(folder)
    write_vectors(folder / "photomap.gpkg", "EPSG:32633", SAMPLE_ORIGIN)
    shutil.copy(SAMPLE / "dem.tif", folder / "photomap-dem.tif")
    return _sheet(folder, "photomap")


def spot(folder: Path) -> Path:
    """SPOT-like scene in false colour, 1 : 25 000, with contours and roads: taken line by line, and rectified."""
    SPOT.write(folder, "spot")
    SPOT.vectors(folder / "spot.gpkg")
    target = Transform(parse_crs(f"{SPOT.crs}+5773"), parse_crs("EPSG:4978"))(np.array([[*SPOT.centre, 450.0]]))[0]
    satellite = Satellite.above(target, (1760, 1540))
    scene = satellite.write(folder / "scene", SPOT.crs, lambda x, y: SPOT.colour(x, y, (4, 1, 2)), SPOT.height)
    command("ortho", scene, "--sensor", "pushbroom", "--dem", folder / "spot-dem.tif", "--dst-crs", SPOT.crs,
            "--res", SPOT.pixel, "--bounds", *SPOT_MAP, "--threads", 1, "-o", folder / "spot.tif")  # fmt: skip
    return _sheet(folder, "spot")


def puwg(folder: Path) -> Path:
    """A sheet of the Polish series in PUWG 1992, 1 : 10 000, whose neatline follows parallels and meridians."""
    PUWG.write(folder, "puwg", (1, 2, 3))
    PUWG.vectors(folder / "puwg.gpkg")
    command("sheets", "make", folder / "puwg.tif", "--layout", folder / "puwg.toml", "--scheme", "puwg1992",
            "--scale", "1:10000", "--only", PUWG_SHEET, "-o", folder / "puwg")  # fmt: skip
    return shutil.copy(folder / "puwg" / f"{PUWG_SHEET}.pdf", folder / "puwg.pdf")


def zones(folder: Path) -> Path:
    """A sheet in UTM zone 33 that reaches into zone 34, with the grids of both."""
    import geopandas
    import shapely

    ZONES.write(folder, "zones", (1, 2, 3))
    ZONES.vectors(folder / "zones.gpkg")
    edge = shapely.LineString([(18.0, 49.0), (18.0, 50.0)])
    frame = geopandas.GeoDataFrame({"name": ["18° E, edge of zones 33 and 34"]}, geometry=[edge], crs="EPSG:4326")
    frame.to_file(folder / "edge.geojson")
    return _sheet(folder, "zones")


def old(folder: Path) -> Path:
    """A photo map in black and white with names, of one photo."""
    from scenes import SAMPLE_ORIGIN

    old_photo(folder)
    write_vectors(folder / "old.gpkg", "EPSG:32633", SAMPLE_ORIGIN)
    return _sheet(folder, "old")


def cupola(folder: Path) -> Path:
    """A painted dome, developed to a plane, with a grid of metres."""
    dome(folder)
    return _sheet(folder, "dome")


def symbols(folder: Path) -> Path:
    """All pictorial symbols and line patterns, with names in several scripts."""
    SYMBOLS.write(folder, "symbols", (1, 2, 3))
    write_symbols(folder / "symbols.gpkg", SYMBOLS.crs)
    return _sheet(folder, "symbols")


SHEETS: dict[str, Callable[[Path], Path]] = {
    "photomap": photomap, "spot": spot, "puwg": puwg, "zones": zones, "old": old, "dome": cupola, "symbols": symbols,
}  # fmt: skip


def prepare(folder: Path) -> None:
    """Put layouts and styles into a folder."""
    for file in HERE.glob("*.toml"):
        shutil.copy(file, folder)


def picture(pdf: Path, out: Path, dpi: float = 100.0) -> None:
    """Render the page of a PDF."""
    import pypdfium2

    page = pypdfium2.PdfDocument(pdf)[0].render(scale=dpi / 72.0).to_pil().convert("RGB")
    page.save(out, quality=84)


def main(words: list[str]) -> None:
    """Make all sheets."""
    names = [word for word in words if word in SHEETS] or list(SHEETS)
    folders = [Path(word) for word in words if word not in SHEETS and not word.startswith("--")]
    with tempfile.TemporaryDirectory() as scratch:
        folder = folders[0] if folders else Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        prepare(folder)
        for name in names:
            pdf = SHEETS[name](folder)
            if "--pictures" in words:
                picture(pdf, HERE / f"{name}.jpg")


if __name__ == "__main__":
    main(sys.argv[1:])
