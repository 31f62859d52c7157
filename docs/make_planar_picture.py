"""The picture of docs/planar-mosaics.md: photos of flat ground, joined by ties alone, and adjusted on control."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import rasterio
from PIL import Image, ImageDraw, ImageOps

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.inputs.declarations import Block
from geomosaic.options.inputs import Area, PlanarInputs
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.render import RenderOptions
from geomosaic.products.mosaics import make_planar_mosaic
from geomosaic.testing.synthetic import AnalyticGround, FlightPlan, render, synthetic_block

CRS = "EPSG:32633"
LENS = {"size": [400, 320], "focal_length": 45.0, "sensor_size": [36.0, 28.8]}
NOISE = 0.5


def fly(folder: Path) -> list[Path]:
    """Twelve photos tilted about 2° with points measured to half a pixel; one point in forty is known."""
    ground = AnalyticGround(with_heights(parse_crs(CRS), "ellipsoidal"), (400000.0, 5500000.0), exaggeration=0.0)
    plan = synthetic_block(ground, LENS, FlightPlan(3, 4, 0.4, 0.3, gsd=1.2), seed=4)
    cameras = {photo.name: photo.camera(LENS, ground) for photo in plan}
    random = np.random.default_rng(2)
    seen = np.array([camera.position[:2] for camera in cameras.values()])
    low, high = seen.min(axis=0) - 200, seen.max(axis=0) + 200
    places = low + (high - low) * random.uniform(size=(420, 2))
    ties, control, files = ["id,image,col,row,sigma_px"], ["id,x,y,image,col,row,sigma_px"], []
    for name, camera in cameras.items():
        files.append(folder / f"{name}.tif")
        pixels = render(camera, ground)
        shape = {"width": pixels.shape[1], "height": pixels.shape[0], "count": 3, "dtype": "uint8"}
        with rasterio.open(files[-1], "w", driver="GTiff", **shape) as file:
            file.write(np.moveaxis(pixels, 2, 0))
        for number, (x, y) in enumerate(places):
            colrow = camera.project(np.array([[x, y, ground.base]]))[0]
            if ((colrow > 2) & (colrow < np.array(camera.size) - 2)).all():
                col, row = colrow + NOISE * random.normal(size=2)
                if number % 40 == 0:
                    control.append(f"c{number},{x:.3f},{y:.3f},{name},{col:.3f},{row:.3f},{NOISE}")
                else:
                    ties.append(f"t{number},{name},{col:.3f},{row:.3f},{NOISE}")
    (folder / "ties.csv").write_text("\n".join(ties) + "\n")
    (folder / "gcps.csv").write_text("\n".join(control) + "\n")
    return files


def mosaic(folder: Path, files: list[Path], kind: str, **more: str) -> tuple[Image.Image, list[str]]:
    """A mosaic as a picture, with what was said of it."""
    wanted = PlanarInputs(kind, ties=folder / "ties.csv", scale=1.2, **more)
    inputs = Block(tuple(files), "planar", crs=CRS, control=folder / "gcps.csv", planar=wanted)
    options = MosaicOptions(RenderOptions(overwrite=True), feather=0.0)
    facts = make_planar_mosaic(inputs, wanted, Area(resolution=1.2), folder / f"{kind}.tif", options).placement
    with rasterio.open(folder / f"{kind}.tif") as file:
        rgb, mask = np.moveaxis(file.read([1, 2, 3]), 0, 2), file.dataset_mask()
    return Image.fromarray(np.where(mask[..., None] > 0, rgb, 255).astype(np.uint8)), facts["summary"]


def main() -> None:
    """Draw photos, the uncontrolled and the controlled mosaic side by side."""
    with tempfile.TemporaryDirectory() as scratch:
        files = fly(Path(scratch))
        made = [
            mosaic(Path(scratch), files, "uncontrolled"),
            mosaic(Path(scratch), files, "semicontrolled", model="affine"),
            mosaic(Path(scratch), files, "controlled", rectify="together"),
        ]
        for _, said in made:
            print("\n".join(said))
        width, line = 800, 24
        thumbs = [ImageOps.contain(Image.open(name), (width // 4 - 6, 1000)) for name in files]
        contact = Image.new("RGB", (width, 3 * (thumbs[0].height + 6)), "white")
        for k, thumb in enumerate(thumbs):
            contact.paste(thumb, ((k % 4) * (thumb.width + 6), (k // 4) * (thumb.height + 6)))
        titles = ("uncontrolled, conformal", "semicontrolled, affine", "controlled, projective, all together")
        cells = [("twelve photos", contact), *((t, m[0]) for t, m in zip(titles, made, strict=True))]
        fitted = [(title, ImageOps.contain(picture, (width, 10000))) for title, picture in cells]
        height = max(picture.height for _, picture in fitted) + line
        sheet = Image.new("RGB", (2 * width + 20, 2 * height + 10), "white")
        draw = ImageDraw.Draw(sheet)
        for k, (title, picture) in enumerate(fitted):
            x, y = (k % 2) * (width + 20), (k // 2) * (height + 10)
            draw.text((x + 2, y + 4), title, fill="black", font_size=16)
            sheet.paste(picture, (x, y + line))
        sheet.save(Path(__file__).parent / "images" / "planar-mosaics.jpg", quality=86)


if __name__ == "__main__":
    main()
