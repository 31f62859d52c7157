"""Networks in AICON's lists (.ior, .eor, .phc, .obc, .scale), as the example of a close-range bundle has them.

X' = (Rx(ω)·Ry(φ)·Rz(κ))ᵀ·(X − X0), x = c·X'/Z', y = c·Y'/Z' with c negative, in millimetres, x right, y up; the
measured coordinates are x0 + x + Δx, y0 + y + Δy with r² = x² + y² (deduced from the lists: residuals of 0.4 µm)

    Δx = x·(A1·(r² − r0²) + A2·(r⁴ − r0⁴) + A3·(r⁶ − r0⁶)) + B1·(r² + 2x²) + 2·B2·x·y + C1·x + C2·y
    Δy = y·(...) + B2·(r² + 2y²) + 2·B1·x·y
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.geo.local_frames import r1, r2, r3
from geomosaic.interchange.reconstruction import ImagePoints, ImagePose, ObjectPoints, Reconstruction
from geomosaic.types import BoolArray, FloatArray

# Millimetres: standard deviation of an image coordinate before the adjustment, as the protocol says.
SIGMA = 0.0005
LENS = ("A1", "A2", "A3", "B1", "B2", "C1", "C2")


@dataclass(frozen=True, eq=False)
class AiconNetwork:
    """Lists of one network.

    Attributes
    ----------
    interior : dict
        c, x0, y0, r0 in mm, and `LENS`.
    format : tuple of float
        Width and height in mm, and in pixels.
    block : Reconstruction
        World in mm; `observations` those that take part in the adjustment, with sigma in pixels.
    xy, residuals : array (N, 2)
        Measured coordinates, mm, and computed minus measured ones as the list has them, of `observations`.
    point_sigmas : array (S, 3)
        mm.
    distance : tuple
        Ids of both ends of the scale bar, its length and sigma, mm.
    """

    interior: dict[str, float]
    format: tuple[float, float, int, int]
    block: Reconstruction
    xy: FloatArray
    residuals: FloatArray
    point_sigmas: FloatArray
    distance: tuple[str, str, float, float]

    def project(self, image: int, xyz: FloatArray) -> FloatArray:
        """Image coordinates (N, 2) in mm of points (N, 3), by AICON's own formulas."""
        rotation, centre = self.block.images[image].pose
        seen = (xyz - centre) @ (np.diag([1.0, -1.0, -1.0]) @ rotation).T
        v = self.interior
        x, y = (v["c"] * seen[:, :2] / seen[:, 2:]).T
        s = x * x + y * y
        g = sum(v[f"A{i}"] * (s**i - v["r0"] ** (2 * i)) for i in (1, 2, 3))
        dx = x * g + v["B1"] * (s + 2 * x * x) + 2 * v["B2"] * x * y + v["C1"] * x + v["C2"] * y
        dy = y * g + v["B2"] * (s + 2 * y * y) + 2 * v["B1"] * x * y
        return np.column_stack([v["x0"] + x + dx, v["y0"] + y + dy])


def read_aicon(folder: Path, name: str = "example") -> AiconNetwork:
    """Network of the lists NAME.ior, .eor, .phc, .obc and .scale."""
    ior = [list(map(float, line.split())) for line in (folder / f"{name}.ior").read_text().splitlines()]
    _, _, c, x0, y0, a1, a2, r0 = ior[0]
    values = (a1, a2, *ior[1], *ior[2], *ior[3])
    interior = {"c": c, "x0": x0, "y0": y0, "r0": r0, **dict(zip(LENS, values, strict=True))}
    width, height, columns, rows = ior[4]
    image_format = (width, height, int(columns), int(rows))
    images = []
    exterior = np.loadtxt(folder / f"{name}.eor")
    for row in exterior:
        # r1, r2, r3 turn the axes, AICON's matrices the points: transposed, and in the opposite sequence.
        to_camera = r3(row[7]) @ r2(row[6]) @ r1(row[5])
        images.append(ImagePose(str(int(row[0])), "1", np.diag([1.0, -1.0, -1.0]) @ to_camera, row[2:5]))
    places = np.loadtxt(folder / f"{name}.obc")
    ids = tuple(str(int(row[0])) for row in places)
    rows_of = np.loadtxt(folder / f"{name}.phc")
    image = {int(row[0]): at for at, row in enumerate(exterior)}
    point = {int(row[0]): at for at, row in enumerate(places)}
    used: BoolArray = (rows_of[:, 8:] == 1).all(axis=1) & np.isin(rows_of[:, 1], places[:, 0])
    took_part = rows_of[used]
    pixel = np.array([width / columns, height / rows])
    colrow = took_part[:, 2:4] * [1.0, -1.0] / pixel + np.array([columns, rows]) / 2
    observations = ImagePoints(
        np.array([image[int(row[0])] for row in took_part]),
        np.array([point[int(row[1])] for row in took_part]),
        colrow,
        np.full(len(took_part), SIGMA / pixel.mean()),
    )
    _, _, start, end, length, sigma, _ = (folder / f"{name}.scale").read_text().split()
    block = Reconstruction(
        {"1": camera_table(interior, image_format)},
        tuple(images),
        ObjectPoints(ids, places[:, 1:4]),
        observations,
    )
    return AiconNetwork(
        interior,
        image_format,
        block,
        took_part[:, 2:4],
        took_part[:, 6:8],
        places[:, 4:7],
        (start, end, float(length), float(sigma)),
    )


def camera_table(interior: dict[str, float], image_format: tuple[float, float, int, int]) -> dict[str, Any]:
    """Camera table of AICON's parameters; affinity is applied after the distortion here, before it there: 0.1 µm."""
    width, height, columns, rows = image_format
    v = interior
    c = -v["c"]
    scale = 1.0 - sum(v[f"A{i}"] * v["r0"] ** (2 * i) for i in (1, 2, 3))
    return {
        "size": [columns, rows],
        "focal_length_px": [c * (scale + v["C1"]) * columns / width, c * scale * rows / height],
        "principal_point_px": [columns / 2 + v["x0"] * columns / width, rows / 2 - v["y0"] * rows / height],
        "distortion": {
            "model": "brown",
            **{f"k{i}": v[f"A{i}"] * c ** (2 * i) / scale for i in (1, 2, 3)},
            "p1": -v["B2"] * c / scale,
            "p2": v["B1"] * c / scale,
            "shear": -v["C2"] / scale,
        },
    }
