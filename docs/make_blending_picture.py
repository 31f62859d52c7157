"""The pictures of docs/blending.md: one seam, unblended, feathered, in bands of frequency; profiles of feathering."""

from __future__ import annotations

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import rasterio
from affine import Affine
from PIL import Image, ImageDraw

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.inputs.declarations import Block
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import BlendOptions, MosaicOptions, Width
from geomosaic.options.render import RenderOptions
from geomosaic.products.mosaics import make_mosaic
from geomosaic.testing.synthetic import AnalyticGround

SIZE, SHIFT, PIXEL = (360, 520), 240, 1.0


def views(folder: Path) -> list[Path]:
    """Two orthos of one ground: the second brighter and redder, each with a lorry where the other has none."""
    ground = AnalyticGround(with_heights(parse_crs("EPSG:32633"), "ellipsoidal"), (400000.0, 5500000.0))
    random = np.random.default_rng(3)
    files = []
    for number, left in enumerate((0, SHIFT)):
        cols, rows = np.meshgrid(np.arange(SIZE[1]) + left + 0.5, np.arange(SIZE[0]) + 0.5)
        xy = np.column_stack([400000 + cols.ravel() * PIXEL, 5500000 - rows.ravel() * PIXEL])
        values = 255 * ground.texture(xy).reshape(*SIZE, 3).astype(np.float64)
        if number:
            values = values * (1.18, 1.05, 0.95) + 12
        across = 372 if number == 0 else 384
        top = 120 if number == 0 else 230
        values[top : top + 44, across - left - 9 : across - left + 9] = (235, 228, 60)
        values += random.normal(0, 2, values.shape)
        files.append(folder / f"{number}.tif")
        place = Affine(PIXEL, 0, 400000 + left * PIXEL, 0, -PIXEL, 5500000)
        shape = {"width": SIZE[1], "height": SIZE[0], "count": 3, "dtype": "uint8"}
        with rasterio.open(files[-1], "w", driver="GTiff", crs="EPSG:32633", transform=place, **shape) as file:
            file.write(np.moveaxis(values.clip(1, 255).astype(np.uint8), 2, 0))
    return files


# Images of 600 columns that share 400 of them; the distance is the example of Jensen's chapter.
COLUMNS, LEFT, WIDE = 600, 200, Width(200, "px")
PROFILES = {
    "edge": ("--seams order --blend edge --feather 200px", {"seams": "order", "blend": "edge"}),
    "cutline": ("--blend cutline --feather 200px", {"blend": "cutline"}),
    "overlap": ("--blend overlap --feather 200px", {"blend": "overlap"}),
    "feather": ("--blend feather --feather 200px", {"blend": "feather"}),
    "order": ("--seams order --blend feather --feather 200px", {"seams": "order", "blend": "feather"}),
}


def profiles(folder: Path) -> dict[str, np.ndarray]:
    """Share of the left of two images, by column of their mosaic, of each way of feathering."""
    files = []
    for number, value in enumerate((1.0, 2.0)):
        files.append(folder / f"flat{number}.tif")
        place = Affine(PIXEL, 0, 400000 + number * LEFT * PIXEL, 0, -PIXEL, 5500000)
        shape = {"width": COLUMNS, "height": 900, "count": 1, "dtype": "float32"}
        with rasterio.open(files[-1], "w", driver="GTiff", crs="EPSG:32633", transform=place, **shape) as file:
            file.write(np.full((1, 900, COLUMNS), value, np.float32))
    made = {}
    for name, (_, given) in PROFILES.items():
        options = MosaicOptions.of(
            render=RenderOptions(overwrite=True), balance=False, stac=False, feather=WIDE, limit=False, **given
        )
        make_mosaic(Block(tuple(files), "planar"), Area(), folder / "out.tif", options)
        with rasterio.open(folder / "out.tif") as file:
            made[name] = 2.0 - file.read(1)[450].astype(np.float64)
    return made


def draw_profiles(made: dict[str, np.ndarray], path: Path) -> None:
    """Write the profiles as curves."""
    figure, axes = plt.subplots(figsize=(8.0, 3.6), dpi=120)
    for (name, share), line in zip(made.items(), ("-", "-", "--", ":", "-."), strict=True):
        axes.plot(np.arange(len(share)) + 0.5, 100 * share, line, linewidth=2, label=PROFILES[name][0])
    for at, text in ((LEFT, "edge of the right image"), (COLUMNS, "edge of the left image")):
        axes.axvline(at, color="0.6", linewidth=1)
        axes.text(at - 4, 50, text, rotation=90, ha="right", va="center", color="0.4", fontsize=8)
    axes.set(xlim=(150, 650), xlabel="column of the mosaic", ylabel="share of the left image, %")
    axes.grid(color="0.92")
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, 1.32), ncols=2, frameon=False)
    figure.tight_layout()
    figure.savefig(path, metadata={"Software": None}, bbox_inches="tight")


def main() -> None:
    """Write docs/images/blending.jpg and feathering.png."""
    width = Width(64, "px")
    kinds = {
        "none": BlendOptions("none"),
        "feather, 64 px, without limit": BlendOptions("feather", width, limit=False),
        "feather": BlendOptions("feather", width),
        "multiband": BlendOptions("multiband", Width(32, "px")),
    }
    panels = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        draw_profiles(profiles(folder), Path(__file__).parent / "images" / "feathering.png")
        files = views(folder)
        for text, blending in kinds.items():
            options = MosaicOptions.of(
                render=RenderOptions(overwrite=True), balance=False, stac=False, blending=blending
            )
            make_mosaic(Block(tuple(files), "planar"), Area(), folder / "out.tif", options)
            with rasterio.open(folder / "out.tif") as file:
                picture = Image.fromarray(np.moveaxis(file.read(), 0, 2)[60:300, 260:500])
            picture = picture.resize((picture.width * 2, picture.height * 2), Image.Resampling.NEAREST)
            ImageDraw.Draw(picture).text((8, 8), text, fill="white", stroke_width=2, stroke_fill="black", font_size=20)
            panels.append(picture)
    wide, tall, gap = panels[0].width, panels[0].height, 8
    sheet = Image.new("RGB", (2 * wide + gap, 2 * tall + gap), "white")
    for number, picture in enumerate(panels):
        sheet.paste(picture, ((number % 2) * (wide + gap), (number // 2) * (tall + gap)))
    sheet.save(Path(__file__).parent / "images" / "blending.jpg", quality=88)


if __name__ == "__main__":
    main()
