"""Picture of docs/true-ortho.md: a city of boxes, plain and true, and which image each place comes from.

Run from the root of the repository: python docs/make_true_ortho_picture.py
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import rasterio

sys.path.insert(0, "tests/rigs")
from city_rig import CORNER, FOCAL, GROUND_CLASS, PIXEL, SIDE, WALL_CLASS, City, photograph

from geomosaic.inputs.declarations import Block
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.render import RenderOptions
from geomosaic.products.mosaics import make_mosaic

PART = np.s_[230:470, 250:490]
BOUNDS = (CORNER[0], CORNER[1], CORNER[0] + SIDE, CORNER[1] + SIDE)


def coloured(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Roofs in warm tones, walls dark, ground green, nothing magenta."""
    share = (values.astype(float) - 40) / 160
    out = np.stack([200 + 40 * share, 110 + 90 * share, 80 + 60 * share], axis=-1)
    out[values == GROUND_CLASS] = 150, 180, 140
    out[values == WALL_CLASS] = 60, 60, 75
    out[~valid] = 200, 0, 160
    return out.clip(0, 255).astype(np.uint8)


def main() -> None:
    """Make photos, both mosaics and the picture."""
    import matplotlib.pyplot as plt

    warnings.simplefilter("ignore")
    folder = Path(tempfile.mkdtemp())
    city = City.of()
    city.write_dsm(folder / "dsm.tif")
    rows = ["image,x,y,z,omega,phi,kappa"]
    centres = [(x, y, 420.0) for y in (90.0, 230.0) for x in (60.0, 160.0, 260.0)]
    for number, centre in enumerate(centres):
        photograph(city, np.array(centre), folder / f"p{number}.tif")
        rows.append(f"p{number},{CORNER[0] + centre[0]},{CORNER[1] + centre[1]},{centre[2]},0,0,0")
    (folder / "exterior.csv").write_text("\n".join(rows))
    inputs = Block(
        tuple(folder / f"p{i}.tif" for i in range(6)), "frame", crs="EPSG:32633", heights="ellipsoidal",
        options={"camera": {"focal_length_px": FOCAL}, "treatment": "planar"}, exterior=folder / "exterior.csv",
        dem=folder / "dsm.tif", dem_heights="ellipsoidal",
    )  # fmt: skip
    figure, axes = plt.subplots(1, 3, figsize=(12, 4.2))
    for axis, true_ortho in zip(axes, (False, True), strict=False):
        out = folder / f"mosaic{true_ortho}.tif"
        options = MosaicOptions(RenderOptions(resampling="nearest", true_ortho=true_ortho), balance=False)
        make_mosaic(inputs, Area(None, PIXEL, BOUNDS), out, options)
        with rasterio.open(out) as dataset:
            axis.imshow(coloured(dataset.read(1), dataset.dataset_mask() > 0)[PART])
        axis.set_title("true ortho" if true_ortho else "plain")
    with rasterio.open(folder / "mosaicTrue-labels.tif") as dataset:
        axes[2].imshow(dataset.read(1)[PART], cmap="tab10", vmin=0, vmax=9, interpolation="nearest")
    axes[2].set_title("labels")
    for axis in axes:
        axis.set_axis_off()
    figure.tight_layout()
    figure.savefig("docs/images/true-ortho.png", dpi=90)


if __name__ == "__main__":
    main()
