"""One land under three sensors: photos of a frame camera, a scene of a line scanner in orbit, and an old raster map.

They differ in bands and their order, pixel size, date and exposure. What each pixel shows follows from the formulas of
the ground alone: its colours, or its coordinates, which say where a pixel lies.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.testing.synthetic import CAMERA, AnalyticGround, FlightPlan, PlainCamera, intersect, synthetic_block

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs" / "gallery"))
from satellite import DAY, Satellite

CRS = "EPSG:32633"
GROUND = AnalyticGround(
    with_heights(parse_crs(CRS), "egm96"), origin=(400_000.0, 5_500_000.0), wavelength=10.0, bands=4
)
PHOTO_GSD, SCENE_GSD, OLD_GSD = 2.0, 4.7, 2.5
# Bands of the files in their order: the photos name them, the scene tells wavelengths, the raster nothing.
PHOTO_BANDS, SCENE_NANOMETRES = ("red", "green", "blue", "nir"), (835.0, 645.0, 545.0)
SCENE_BANDS = ("nir", "red", "green")

# Values (N, 4) of red, green, blue and infrared at places (N, 2).
Look = Callable[[np.ndarray], np.ndarray]


def colours(xy: np.ndarray) -> np.ndarray:
    """Colours of the land, grey values of 8 bits."""
    return np.asarray(255.0 * GROUND.texture(xy))


def coordinates(xy: np.ndarray) -> np.ndarray:
    """East, north and height from the ground's origin, metres, in place of red, green and infrared."""
    x, y = (xy - np.array(GROUND.origin)).T
    return np.column_stack([x, y, np.zeros(len(x)), GROUND.height(xy) - GROUND.base])


@dataclass(frozen=True)
class Sensors:
    """Files of the sensors, and what each shows on the ground.

    `shows` gives for places (N, 2) whether an image shows them, by file name.
    """

    folder: Path
    photos: tuple[Path, ...]
    scene: Path
    old: Path
    shows: dict[str, Callable[[np.ndarray], np.ndarray]]

    @property
    def tables(self) -> str:
        """Sections of a project that declare the images but for the bands."""
        return f"""[sensor]
name = "frame"
camera = "camera.toml"
[exterior]
file = "exterior.csv"
crs = "{CRS}"
heights = "egm96"
[dem]
file = "dem.tif"
heights = "egm96"
"""


def write_sensors(
    folder: Path, look: Look, *, size: tuple[int, int] = (240, 180), dtype: str = "uint8", later: Look | None = None,
    old_bands: tuple[str, ...] = (), scene_size: tuple[int, int] = (200, 200),
) -> Sensors:  # fmt: skip
    """Write all files. `later` is what the scene shows; without `old_bands` the old raster is panchromatic."""
    folder.mkdir(parents=True, exist_ok=True)
    camera = {**CAMERA, "size": list(size)}
    plan = FlightPlan(1, 2, forward_overlap=0.4, gsd=PHOTO_GSD, tilt=1.0, shake=5.0)
    shots, shows, rows, photos = synthetic_block(GROUND, camera, plan, seed=4), {}, [], []
    for shot in shots:
        model, path = shot.camera(camera, GROUND), folder / f"{shot.name}.tif"
        col, row = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
        met = intersect(model, GROUND, np.column_stack([col.ravel(), row.ravel()]))
        seen = look(met[:, :2]).reshape(size[1], size[0], 4)
        photos.append(write(path, seen, PHOTO_BANDS, dtype, tags={"TIFFTAG_DATETIME": "2024:07:10 10:00:00"}))
        shows[path.name] = _shown_by_photo(model)
        rows.append(",".join([path.name, *(f"{value:.6f}" for value in (*shot.position, *shot.angles))]))
    (folder / "exterior.csv").write_text("\n".join(["image,x,y,z,omega,phi,kappa", *rows]) + "\n")
    (folder / "camera.toml").write_text(_toml(camera))
    scene = _write_scene(folder / "scene", later or look, dtype, shows, scene_size)
    step, cols, lines = OLD_GSD, 320, 360
    left, top = GROUND.origin[0] - 200.0, GROUND.origin[1] + 480.0
    col, row = np.meshgrid(np.arange(cols) + 0.5, np.arange(lines) + 0.5)
    seen = look(np.column_stack([left + step * col.ravel(), top - step * row.ravel()])).reshape(lines, cols, 4)
    bands = [PHOTO_BANDS.index(name) for name in old_bands]
    values = seen[..., bands] if bands else seen[..., :2].mean(axis=2, keepdims=True)
    place = Affine(step, 0.0, left, 0.0, -step, top)
    old = write(folder / "old.tif", values, old_bands, dtype, crs=CRS, transform=place)
    shows["old.tif"] = lambda xy: _inside((xy - [left, top]) / [step, -step], (cols, lines))
    _write_dem(folder / "dem.tif")
    return Sensors(folder, tuple(photos), scene, old, shows)


def write(
    path: Path, values: np.ndarray, names: tuple[str, ...], dtype: str, *, tags: dict[str, str] | None = None,
    nanometres: tuple[float, ...] = (), **more: Any,
) -> Path:  # fmt: skip
    """Write an image (rows, cols, bands) that says of its bands what is given."""
    rows, cols, bands = values.shape
    kept = values if dtype.startswith("float") else np.clip(np.rint(values), 1, 255)
    with rasterio.open(
        path, "w", driver="GTiff", width=cols, height=rows, count=bands, dtype=dtype, photometric="MINISBLACK", **more
    ) as out:
        out.write(np.moveaxis(kept, 2, 0).astype(dtype))
        for band, name in enumerate(names, start=1):
            out.set_band_description(band, name)
        for band, value in enumerate(nanometres, start=1):
            out.update_tags(band, ns="IMAGERY", CENTRAL_WAVELENGTH_UM=f"{value / 1000:g}")
        if tags:
            out.update_tags(**tags)
    return path


def _write_scene(folder: Path, look: Look, dtype: str, shows: dict[str, Any], size: tuple[int, int]) -> Path:
    folder.mkdir(exist_ok=True)
    xy = np.array([[GROUND.origin[0] - 340.0, GROUND.origin[1] - 180.0]])
    to_earth = Transform(GROUND.crs, parse_crs("EPSG:4978"))
    satellite = Satellite.above(to_earth(np.column_stack([xy, GROUND.height(xy)]))[0], size)
    x, y = satellite.places(CRS, lambda x, y: GROUND.height(np.column_stack([x, y])))
    seen = look(np.column_stack([x.ravel(), y.ravel()])).reshape(*x.shape, 4)
    bands = [PHOTO_BANDS.index(name) for name in SCENE_BANDS]
    path = write(folder / "IMAGERY.tif", seen[..., bands], (), dtype, nanometres=SCENE_NANOMETRES)
    (folder / "METADATA.DIM").write_text(satellite.dimap().replace(DAY, "2019-02-03"))
    import shapely

    ring = np.concatenate([
        np.column_stack([x[0], y[0]]), np.column_stack([x[:, -1], y[:, -1]]),
        np.column_stack([x[-1], y[-1]])[::-1], np.column_stack([x[:, 0], y[:, 0]])[::-1],
    ])  # fmt: skip
    outline = shapely.Polygon(ring)
    shows[path.name] = lambda xy: shapely.contains_xy(outline, *np.asarray(xy).T)
    return path


def _shown_by_photo(model: PlainCamera) -> Callable[[np.ndarray], np.ndarray]:
    def shows(xy: np.ndarray) -> np.ndarray:
        xyz = np.column_stack([xy, GROUND.height(xy)])
        return _inside(model.ground_to_image(Transform(GROUND.crs, model.crs)(xyz)), model.size)

    return shows


def _inside(colrow: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return np.asarray(((colrow > 0) & (colrow < np.array(size))).all(axis=1))


def _toml(camera: dict[str, Any]) -> str:
    plain = [f"{name} = {value}" for name, value in camera.items() if not isinstance(value, dict | str)]
    tables = [
        "\n".join([f"[{name}]", *(f"{key} = {value!r}".replace("'", '"') for key, value in table.items())])
        for name, table in camera.items() if isinstance(table, dict)
    ]  # fmt: skip
    return "\n".join([*plain, *tables]) + "\n"


def _write_dem(path: Path) -> None:
    step, reach = 5.0, 1000.0
    at = np.arange(-reach, reach, step) + step / 2
    x, y = np.meshgrid(GROUND.origin[0] + at, GROUND.origin[1] - at)
    z = GROUND.height(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
    place = Affine(step, 0.0, GROUND.origin[0] - reach, 0.0, -step, GROUND.origin[1] + reach)
    with rasterio.open(
        path, "w", driver="GTiff", width=len(at), height=len(at), count=1, dtype="float32", crs=CRS, transform=place
    ) as out:
        out.write(z.astype(np.float32), 1)
