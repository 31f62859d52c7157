"""Picture and table of docs/edge-matching.md, from the photos of the tests: run this from the project's folder."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent / "tests"), str(HERE.parent / "tests" / "rigs")]

from edge_render import joined, photographs, roads, shifts  # noqa: E402
from edge_rig import Rig, along_the_seam, rig  # noqa: E402
from test_60_edges import matched, no_matching  # noqa: E402

NAMES = ("no edge matching", "adjusted", "exact join")


def stages(r: Rig) -> list:
    """Models of the three stages."""
    m = matched(r)
    return [no_matching(r), m.adjusted, m.models]


def table() -> None:
    """Misfits at the common points and along the seams."""
    for photos in (2, 4):
        for kind in ("affine", "projective"):
            r = rig(photos, kind)
            m = matched(r)
            at_points = [f"{x.rms:.2f} / {x.largest:.2f}" for x in (m.before, m.after)] + [f"{m.joined.largest:.0e}"]
            lengths = [np.concatenate([along_the_seam(r, x, i) for i in range(photos - 1)]) for x in stages(r)]
            between = [f"{np.sqrt((d**2).mean()):.2f} / {d.max():.2f}" for d in lengths]
            print(photos, kind, *at_points, *between, f"sigma0 {m.sigma0:.2f}", sep=" | ")


def picture(road: int = 8, scale: int = 5) -> Image.Image:
    """Cut the same piece out of the mosaics of the three stages, the seam marked at its edges."""
    r, lines = rig(2, "affine", common_sigma=0.05, wobble=0.0), roads(8)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        paths = photographs(r, lines, folder)
        panels = []
        for name, models in zip(NAMES, stages(r), strict=True):
            values, labels, transform = joined(r, models, paths, folder / "mosaic.tif")
            jump = np.abs(shifts(values, labels, transform, lines))
            print(name, f"rms {np.sqrt((jump**2).mean()):.2f}, largest {jump.max():.2f} px")
            row = round(transform.f - lines[road])
            edge = int(np.argmax(labels[row] == 2))
            part = values[row - 22 : row + 23, edge - 60 : edge + 60].astype(np.uint8)
            panel = Image.fromarray(part).resize((120 * scale, 45 * scale), Image.Resampling.NEAREST).convert("RGB")
            draw = ImageDraw.Draw(panel)
            for top in (0, panel.height - 20):
                draw.line((60 * scale, top, 60 * scale, top + 20), fill=(255, 70, 40), width=3)
            draw.text((10, 8), name, fill="white", font_size=22)
            panels.append(panel)
    sheet = Image.new("RGB", (panels[0].width, 3 * panels[0].height + 16), "white")
    for k, panel in enumerate(panels):
        sheet.paste(panel, (0, k * (panel.height + 8)))
    return sheet


if __name__ == "__main__":
    table()
    picture().save(HERE / "images" / "edge-matching.png", optimize=True)
