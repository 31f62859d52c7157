"""Picture of the page on layover: classes and local incidence of hills under a radar of the tests' analytic orbit.

python docs/make_layover_picture.py
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
import rasterio

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / "rigs")]

CLASSES = {
    0: ("#e8e4da", "seen"),
    4: ("#8fc1d4", "foreshortening"),
    1: ("#d1495b", "layover"),
    2: ("#30343f", "shadow"),
}


def main() -> None:
    """Write `docs/images/layover.png`."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Patch
    from radar_hills_rig import Land
    from sar_rig import Scene

    import geomosaic as gm

    scene = Scene()
    land = Land.of(scene)
    x, y = land.middle
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        width, height = scene.size
        with rasterio.open(
            folder / "scene.tif", "w", driver="GTiff", width=width, height=height, count=1, dtype="uint8"
        ) as file:
            file.write(np.ones((1, height, width), dtype=np.uint8))
        scene.write(folder, "scene")
        given = gm.Scene(folder / "scene.tif", "sar", dem=land.write_dem(folder), dem_heights="ellipsoidal")
        bounds = (x - 3600.0, y - 2600.0, x + 3600.0, y + 2200.0)
        place = {"dst_crs": f"EPSG:{land.zone}", "resolution": 8.0, "bounds": bounds}
        made = gm.layover_mask(given, folder / "mask.tif", **place)
        classes = made.read().filled(255)[0]
        with rasterio.open(folder / "mask-incidence.tif") as file:
            angles = file.read(1)
    picture = np.zeros((*classes.shape, 3))
    for value, (colour, _) in CLASSES.items():
        picture[classes == value] = to_rgb(colour)
    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.0), layout="constrained")
    left.imshow(picture, interpolation="nearest")
    left.legend(
        handles=[Patch(color=colour, label=text) for colour, text in CLASSES.values()], loc="lower left", fontsize=8
    )
    left.set_title("classes", fontsize=10)
    shown = right.imshow(angles, cmap="cividis", vmin=0.0, vmax=90.0)
    right.set_title("local incidence angle", fontsize=10)
    figure.colorbar(shown, ax=right, label="degrees", shrink=0.9)
    for axes in (left, right):
        axes.set_xticks([])
        axes.set_yticks([])
    figure.savefig(ROOT / "docs" / "images" / "layover.png", dpi=110)


if __name__ == "__main__":
    main()
