"""Make the sample block: photos of a ground that is known exactly, with everything a real job comes with.

    python data/make_sample.py [OUT]        default: data/sample next to this file

Deterministic: the same libraries give the same bytes. Orientation, relief and colour come from
`geomosaic.testing.synthetic`, whose camera is written independently of the sensor plugins. Nothing here is measured
with the code that is tested on it.
"""

from __future__ import annotations

import csv
import hashlib
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from PIL import Image, TiffImagePlugin
from pyproj import Transformer
from rasterio.transform import from_origin

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.testing.synthetic import (
    CAMERA,
    AnalyticGround,
    Exposure,
    FlightPlan,
    SyntheticPhoto,
    Vignetting,
    intersect,
    render,
    synthetic_block,
)

SEED = 20
GSD, NOISE, QUALITY = 0.7, 1.2 / 255, 92
VIGNETTING = Vignetting(0.20, 0.10)
TRUTH_BOUNDS, TRUTH_RES = (399_300.0, 5_499_460.0, 400_700.0, 5_500_540.0), 1.0
DEM_SPACING, DEM_MARGIN = 5.0, 170.0
SIGMA_XY, SIGMA_Z, SIGMA_PX = 0.03, 0.05, 0.2
# Offsets in metres from the ground's origin, marked by targets on the ground.
CONTROL = ((-470, 490), (20, 520), (470, 500), (10, -20), (-480, -500), (-20, -540), (470, -510))
CHECK = (
    (-330, 215), (330, 205), (-320, -215), (330, -200), (-60, 230), (100, -230), (-600, 10), (600, 20),
    (180, 420), (-190, -430), (-700, 480), (720, -480),
)  # fmt: skip


def ground() -> AnalyticGround:
    """Return the ground of the sample: west Bohemia, UTM 33N with EGM96 heights, grid north 1° west of true north."""
    crs = with_heights(parse_crs("EPSG:32633"), "egm96")
    x, y = 400_000.0, 5_500_000.0
    targets = tuple((x + u, y + v) for u, v in CONTROL + CHECK)
    return AnalyticGround(crs, origin=(x, y), wavelength=1.6, targets=targets)


def camera(reduce: int = 1) -> dict[str, Any]:
    """Return the camera, its image `reduce` times smaller in pixels."""
    return {**CAMERA, "size": [CAMERA["size"][0] // reduce, CAMERA["size"][1] // reduce]}


def photos(land: AnalyticGround) -> list[SyntheticPhoto]:
    """Three strips of four photos, about 60 % and 35 % overlap."""
    return synthetic_block(land, CAMERA, FlightPlan(3, 4, 0.6, 0.35, gsd=GSD, tilt=2.0, drift=4.0), seed=SEED)


def exposures(count: int) -> list[Exposure]:
    """Gain, haze and a slight colour cast of each photo."""
    random = np.random.default_rng([SEED, 1])
    out = []
    for _ in range(count):
        gain = 1.12 * np.exp(random.normal(0, 0.11)) * np.exp(random.normal(0, 0.025, 3))
        haze = random.uniform(0.005, 0.04) * np.array([0.8, 1.0, 1.25])
        out.append(Exposure(tuple(np.round(gain, 4).tolist()), tuple(np.round(haze, 4).tolist())))
    return out


def write_photo(path: Path, pixels: np.ndarray, photo: SyntheticPhoto, land: AnalyticGround, minute: int) -> None:
    """Write a JPEG with the EXIF a camera would give it: no georeference, only a rough place and the focal length."""
    to_place = Transformer.from_crs(land.crs, "EPSG:4979", always_xy=True, allow_ballpark=False)
    longitude, latitude, height = to_place.transform(*photo.position)
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0131] = "geomosaic", "Analytic 45", "make_sample.py"
    detail = exif.get_ifd(0x8769)
    detail[0x920A] = TiffImagePlugin.IFDRational(round(CAMERA["focal_length"] * 100), 100)
    detail[0x9003] = f"2024:06:21 10:{minute // 4:02d}:{minute % 4 * 15:02d}"
    gps = exif.get_ifd(0x8825)
    gps[1], gps[2] = "N", _sexagesimal(latitude)
    gps[3], gps[4] = "E", _sexagesimal(longitude)
    gps[5], gps[6] = b"\x00", TiffImagePlugin.IFDRational(round(height * 10), 10)
    Image.fromarray(pixels).save(path, "JPEG", quality=QUALITY, subsampling=0, optimize=True, exif=exif)


def _sexagesimal(degrees: float) -> tuple[TiffImagePlugin.IFDRational, ...]:
    seconds = round(degrees * 3600 * 100)
    parts = (seconds // 360_000, 1), (seconds // 6000 % 60, 1), (seconds % 6000, 100)
    return tuple(TiffImagePlugin.IFDRational(a, b) for a, b in parts)


def write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV table with a header."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def gcps(land: AnalyticGround, block: Sequence[SyntheticPhoto]) -> list[list[object]]:
    """Survey the control and check points, and measure them in every photo that shows them, with small errors."""
    random = np.random.default_rng([SEED, 2])
    rows: list[list[object]] = []
    for role, places in (("control", CONTROL), ("check", CHECK)):
        for number, place in enumerate(places, 1):
            xy = np.array([place], dtype=np.float64) + land.origin
            point = np.column_stack([xy, land.height(xy)])
            surveyed = point[0] + random.normal(size=3) * [SIGMA_XY, SIGMA_XY, SIGMA_Z]
            for photo in block:
                seen = photo.camera(CAMERA, land)
                measured = seen.project(point)[0] + random.normal(size=2) * SIGMA_PX
                if (measured > 12).all() and (measured < np.array(seen.size) - 12).all():
                    texts = [f"{value:.3f}" for value in surveyed] + [photo_name(photo)]
                    texts += [f"{value:.2f}" for value in measured]
                    rows.append([f"{role}{number:02d}", *texts, SIGMA_XY, SIGMA_Z, SIGMA_PX, role])
    return rows


def photo_name(photo: SyntheticPhoto) -> str:
    """File name of a photo."""
    return f"{photo.name}.jpg"


def write_camera(path: Path) -> None:
    """Write the calibration."""
    lines = [
        "# Calibration of the sample's camera. Lengths in mm; principal point right and up from the image centre.",
        *(f"{key} = {CAMERA[key]}" for key in ("size", "focal_length", "sensor_size", "principal_point")),
        "",
        "[distortion]",
        *(f"{key} = {json.dumps(value)}" for key, value in CAMERA["distortion"].items()),
    ]
    path.write_text("\n".join(lines) + "\n")


def write_dem(path: Path, land: AnalyticGround, block: Sequence[SyntheticPhoto]) -> None:
    """Write the relief at nodes 5 m apart, in cm, with its vertical datum declared."""
    rim = []
    for photo in block:
        seen = photo.camera(CAMERA, land)
        width, height = seen.size
        rim.append(intersect(seen, land, np.array([[0, 0], [width, 0], [0, height], [width, height]], float)))
    corners = np.vstack(rim)
    s = DEM_SPACING
    left, bottom = np.floor((corners[:, :2].min(axis=0) - DEM_MARGIN) / s) * s
    right, top = np.ceil((corners[:, :2].max(axis=0) + DEM_MARGIN) / s) * s
    x, y = np.arange(left + s / 2, right, s), np.arange(top - s / 2, bottom, -s)
    heights = land.height(np.column_stack([np.tile(x, len(y)), np.repeat(y, len(x))])).reshape(1, len(y), len(x))
    transform = from_origin(left, top, s, s)
    write_tiff(path, np.round(heights, 2).astype(np.float32), transform, "EPSG:32633+5773", predictor=3, nodata=-9999.0)


def write_truth(path: Path, land: AnalyticGround) -> None:
    """Write the colour of the ground at the centres of 1 m pixels, as no camera changed it."""
    left, bottom, right, top = TRUTH_BOUNDS
    r = TRUTH_RES
    x, y = np.arange(left + r / 2, right, r), np.arange(top - r / 2, bottom, -r)
    values = land.texture(np.column_stack([np.tile(x, len(y)), np.repeat(y, len(x))]))
    pixels = np.rint(values * 255).astype(np.uint8).reshape(len(y), len(x), -1).transpose(2, 0, 1)
    write_tiff(path, pixels, from_origin(left, top, r, r), "EPSG:32633", predictor=2, interleave="pixel")


def write_tiff(path: Path, bands: np.ndarray, transform: Any, crs: str, **options: object) -> None:
    """Write bands (B, rows, cols) as a tiled GeoTIFF."""
    count, height, width = bands.shape
    with rasterio.open(
        path, "w", driver="GTiff", width=width, height=height, count=count, dtype=bands.dtype, crs=crs,
        transform=transform, tiled=True, blockxsize=256, blockysize=256, compress="deflate", zlevel=9, **options,
    ) as file:  # fmt: skip
        file.write(bands)


def truth(land: AnalyticGround, block: Sequence[SyntheticPhoto], effects: Sequence[Exposure]) -> dict[str, Any]:
    """Say how the sample was made."""
    return {
        "ground": {
            "crs": "EPSG:32633+5773",
            "origin": land.origin,
            "base": land.base,
            "exaggeration": land.exaggeration,
            "wavelength": land.wavelength,
            "seed": land.seed,
            "targets": land.targets,
        },
        "reflectance": "truth/reflectance.tif = 255 * radiance; photo = 255 * (vignetting * radiance * gain + offset)",
        "vignetting": {"a": VIGNETTING.a, "b": VIGNETTING.b, "model": "1 - a*rho^2 - b*rho^4, rho = 1 in the corners"},
        "noise": {"sigma_grey_values": round(NOISE * 255, 6), "jpeg_quality": QUALITY},
        "orientation": "exterior.csv and camera.toml are exact: the photos were rendered with these very digits",
        "gcps": {"sigma_xy": SIGMA_XY, "sigma_z": SIGMA_Z, "sigma_px": SIGMA_PX, "errors": "normal, as the sigmas say"},
        "dem": {"spacing": DEM_SPACING, "rounded_to": 0.01},
        "photos": {
            photo_name(photo): {"gain": effect.gain, "offset": effect.offset}
            for photo, effect in zip(block, effects, strict=True)
        },
    }


def make_photo(out: Path, index: int, reduce: int = 1) -> Path:
    """Render one photo into a folder, `reduce` times smaller in each direction."""
    land = ground()
    block = photos(land)
    photo = block[index]
    path = out / photo_name(photo)
    pixels = render(
        photo.camera(camera(reduce), land),
        land,
        vignetting=VIGNETTING,
        exposure=exposures(len(block))[index],
        noise=NOISE,
        seed=SEED + index,
    )
    write_photo(path, pixels, photo, land, index)
    return path


def make(out: Path) -> None:
    """Make the whole block in a folder."""
    land = ground()
    block = photos(land)
    for folder in (out / "photos", out / "truth"):
        folder.mkdir(parents=True, exist_ok=True)
    write_camera(out / "camera.toml")
    header = ("image", "x", "y", "z", "omega", "phi", "kappa")
    table = [[photo_name(p), *(f"{v:.3f}" for v in p.position), *(f"{v:.5f}" for v in p.angles)] for p in block]
    write_table(out / "exterior.csv", header, table)
    header = ("id", "x", "y", "z", "image", "col", "row", "sigma_xy", "sigma_z", "sigma_px", "role")
    write_table(out / "gcps.csv", header, gcps(land, block))
    write_dem(out / "dem.tif", land, block)
    write_truth(out / "truth" / "reflectance.tif", land)
    (out / "truth" / "truth.json").write_text(json.dumps(truth(land, block, exposures(len(block))), indent=1) + "\n")
    made = [make_photo(out / "photos", index) for index in range(len(block))]
    names = ("camera.toml", "exterior.csv", "gcps.csv", "dem.tif", "truth/reflectance.tif", "truth/truth.json")
    files = sorted([*made, *(out / name for name in names)])
    sums = [f"{hashlib.sha256(f.read_bytes()).hexdigest()}  {f.relative_to(out).as_posix()}\n" for f in files]
    (out / "SHA256SUMS").write_text("".join(sums))


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "sample")
