"""Picture of the page on radar: gamma nought of the ellipsoid, and terrain-flattened, over hills of one backscatter.

python docs/make_flattening_picture.py
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / "rigs")]

from radar_hills_rig import Land  # noqa: E402
from sar_rig import Scene  # noqa: E402

SIZE = (560, 420)
FACTOR = 2e-5
FIELDS = 0.12, 0.3


@dataclass(frozen=True)
class Range(Land):
    """Hills of some hundred metres, and a steep one with layover and shadow."""

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Metres above the ellipsoid."""
        u, v = x - self.middle[0], y - self.middle[1]
        out = 200.0 + 600.0 * np.exp(-(((u - 650.0) / 340.0) ** 2) - ((v + 500.0) / 460.0) ** 2)
        random = np.random.default_rng(12)
        for _ in range(9):
            length, angle, phase = random.uniform(500.0, 1500.0), *random.uniform(0.0, 2 * np.pi, 2)
            out = out + 0.02 * length * np.sin(2 * np.pi * (u * np.cos(angle) + v * np.sin(angle)) / length + phase)
        return out

    def amplitudes(self) -> np.ndarray:
        """Speckled amplitudes of four looks over ground of two backscatters, in fields of 600 m."""
        facets = self.facets((4.6 * SIZE[0] + 900.0, 5.2 * SIZE[1] + 700.0), 4.0)
        x, y, _ = self.map(facets.earth)
        gamma = np.where((np.floor(x / 600.0) + np.floor(y / 600.0)) % 2 > 0, *FIELDS)
        bright = facets.image(gamma * facets.size * np.maximum(facets.cosine, 0.0), SIZE)
        bright /= self.scene.spacing * 10.2
        return np.sqrt(bright / FACTOR * np.random.default_rng(4).gamma(4.0, 0.25, bright.shape))


def main() -> None:
    """Write `docs/images/flattening.png`."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    import geomosaic as gm

    scene = Scene(size=SIZE)
    land = Range.of(scene)
    x, y = land.middle
    shown = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with rasterio.open(
            folder / "scene.tif", "w", driver="GTiff", width=SIZE[0], height=SIZE[1], count=1, dtype="float32"
        ) as file:
            file.write(land.amplitudes().astype(np.float32), 1)
        table = scene.table() | {"calibration": {"quantity": "beta0", "factor": FACTOR}, "ground_height": 200.0}
        (folder / "scene.radar.json").write_text(json.dumps(table))
        dem = land.write_dem(folder, 5000.0)
        for kind in ("gamma0", "gamma0-flattened"):
            given = gm.Scene(
                folder / "scene.tif", "sar", dem=dem, dem_heights="ellipsoidal", options={"calibration": kind}
            )
            bounds = (x - 1750.0, y - 1500.0, x + 1750.0, y + 1500.0)
            made = gm.ortho(
                given, folder / f"{kind}.tif", dst_crs=f"EPSG:{land.zone}", resolution=15.0, bounds=bounds,
                resampling="average",
            )  # fmt: skip
            shown[kind] = 10.0 * np.log10(np.maximum(made.read()[0].filled(np.nan), 1e-9))
    figure, panels = plt.subplots(1, 2, figsize=(11.0, 4.4), layout="constrained")
    colours = plt.get_cmap("gray").with_extremes(bad="#d1495b")
    titles = "gamma0: the ellipsoid's angle alone", "gamma0-flattened: the area that is lit"
    for axes, values, title in zip(panels, shown.values(), titles, strict=True):
        drawn = axes.imshow(values, cmap=colours, vmin=-15.0, vmax=2.0)
        axes.set_title(title, fontsize=10)
        axes.set_xticks([])
        axes.set_yticks([])
    figure.colorbar(drawn, ax=panels, label="dB (red: shadow)", shrink=0.85)
    figure.savefig(ROOT / "docs" / "images" / "flattening.png", dpi=90)


if __name__ == "__main__":
    main()
