"""Picture of docs/several-sensors.md: one land under three sensors, put together by three rules.

Run this from the project's folder: `python docs/make_sensor_picture.py`.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
import rasterio
from PIL import Image, ImageDraw

from geomosaic.cli.main import run

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "tests" / "rigs")]

import sensors_rig as rig  # noqa: E402

BOUNDS = (399_440.0, 5_499_640.0, 400_640.0, 5_500_440.0)
RULES = (
    ("Newest first", 'order = "date"'),
    ("Nearest to 1 February", 'order = "season"\nday = "02-01"'),
    ("Newest first, cloud mask", 'order = "date"'),
)


def winter(xy: np.ndarray) -> np.ndarray:
    """Colours of the land without leaves and under thin snow: what is bright in summer's infrared is dull."""
    red, green, blue, infrared = rig.colours(xy).T
    snow = 150.0 + 0.5 * (green - infrared)
    return np.column_stack([snow + 0.2 * red, snow + 0.25 * blue, snow + 0.35 * blue, 0.85 * snow])


def with_cloud(photo: Path) -> None:
    """Paint a cloud over a photo, and write its mask beside it."""
    with rasterio.open(photo, "r+") as file:
        col, row = np.meshgrid(np.arange(file.width), np.arange(file.height))
        away = np.hypot((col - 0.6 * file.width) / 70.0, (row - 0.45 * file.height) / 45.0)
        away += 0.12 * np.sin(col / 9.0) * np.cos(row / 7.0)
        thick = np.clip(1.6 - 1.2 * away, 0.0, 1.0)
        file.write((file.read() * (1.0 - thick) + 245.0 * thick).astype(np.uint8))
    write_mask(photo, thick > 0.0)


def write_mask(photo: Path, cloud: np.ndarray) -> None:
    """Write a cloud mask beside a photo."""
    path = photo.with_name(f"{photo.stem}-clouds.png")
    Image.fromarray(cloud.astype(np.uint8)).save(path)


def panel(sensors: rig.Sensors, title: str, rule: str, masked: bool) -> Image.Image:
    """The mosaic by a rule, with its title."""
    file = sensors.folder / "several.toml"
    clouds = 'clouds = "{image}-clouds.png"\n' if masked else ""
    file.write_text(
        f"""format = 1
[project]
name = "several"
images = ["strip1_*.tif"]
band_names = ["nir", "red", "green"]
{clouds}{sensors.tables}
[[images]]
path = "scene/IMAGERY.tif"
sensor = "pushbroom"
[[images]]
path = "old.tif"
sensor = "planar"
acquired = "1985-07-12"
[output]
crs = "{rig.CRS}"
resolution = 2.0
bounds = {list(BOUNDS)}
[mosaic]
{rule}
"""
    )
    if run(["run", str(file)]) != 0:
        raise SystemExit(f"failed: {title}")
    with rasterio.open(sensors.folder / "output" / "several.tif") as made:
        picture = Image.fromarray(np.moveaxis(made.read(), 0, 2).copy())
    draw = ImageDraw.Draw(picture)
    draw.rectangle((0, 0, 18 + 11 * len(title), 34), fill=(18, 48, 63))
    draw.text((10, 5), title, fill="white", font_size=22)
    return picture


if __name__ == "__main__":
    panels = []
    with tempfile.TemporaryDirectory() as scratch:
        made = rig.write_sensors(Path(scratch), rig.colours, later=winter, size=(400, 300))
        for photo in made.photos:
            write_mask(photo, np.zeros((300, 400), dtype=bool))
        with_cloud(made.photos[0])
        panels = [panel(made, title, rule, "mask" in title) for title, rule in RULES]
    sheet = Image.new("RGB", (panels[0].width, 3 * panels[0].height + 24), "white")
    for number, one in enumerate(panels):
        sheet.paste(one, (0, number * (one.height + 12)))
    sheet.save(HERE / "images" / "several-sensors.jpg", quality=85)
