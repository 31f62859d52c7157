"""The picture of docs/surfaces.md: a synthetic tower, photographed from four sides, and its wall developed.

Run it with an empty folder; photos, tables and the developed wall stay there.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from geomosaic.cli.main import run

IMAGES = Path(__file__).parent / "images"
SIZE, FOCAL, RADIUS, TALL, COUNT = (900, 1200), 1000.0, 4.0, 15.0, 6
FOOT = np.array([10.0, 20.0, 0.0])


def wall(theta: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Colours (N, 3), 0 to 1: courses of stone, windows, a painted ring and a painted line that climbs."""
    u = RADIUS * theta
    course = np.floor(z / 0.5)
    stone = np.floor((u + 0.45 * (course % 2)) / 0.9)
    tone = 0.62 + 0.16 * np.modf(np.abs(np.sin(stone * 12.9898 + course * 78.233)) * 43758.5453)[0]
    grain = 0.03 * np.sin(u * 23.0 + 3.0 * np.sin(z * 17.0)) * np.sin(z * 29.0)
    joint = (np.mod(z, 0.5) < 0.05) | (np.mod(u + 0.45 * (course % 2), 0.9) < 0.05)
    colour = (tone + grain)[:, None] * [1.0, 0.9, 0.76]
    colour[joint] = [0.46, 0.43, 0.40]
    turn = np.mod(theta + np.pi / 6, np.pi / 3) - np.pi / 6
    for height, tall in ((3.5, 1.6), (8.0, 1.8), (12.0, 1.2)):
        off, across = z - height, np.abs(turn) * RADIUS
        arch = across**2 + np.maximum(off - tall / 2, 0.0) ** 2
        frame = (arch < 0.62**2) & (off > -tall / 2 - 0.15)
        opening = (arch < 0.45**2) & (off > -tall / 2)
        colour[frame] = [0.86, 0.82, 0.74]
        colour[opening] = [0.12, 0.13, 0.17]
    colour[np.abs(z - 10.3) < 0.12] = [0.70, 0.16, 0.12]
    climbing = np.abs(np.mod(z - 5.0 - (theta + np.pi) / (2 * np.pi) * 2.0 + 6.0, 12.0) - 6.0) < 0.1
    colour[climbing] = [0.10, 0.30, 0.60]
    return colour


def photo(turn: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Picture (rows, cols, 3), projection centre (3,) and rotation (3, 3) of one photo."""
    centre = FOOT + np.array([17.0 * np.cos(turn), 17.0 * np.sin(turn), 1.7])
    back = centre - (FOOT + np.array([0.0, 0.0, 7.2]))
    back = back / np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right = right / np.linalg.norm(right)
    rotation = np.array([right, np.cross(back, right), back])
    total = np.zeros((SIZE[1] * SIZE[0], 3))
    rows, cols = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    for dc, dr in ((0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)):
        x, y = cols.ravel() + dc - SIZE[0] / 2, SIZE[1] / 2 - rows.ravel() - dr
        d = np.column_stack([x, y, np.full(x.size, -FOCAL)]) @ rotation
        colour = np.where(
            d[:, 2:] > 0, [0.55, 0.68, 0.84] + 0.2 * (1 - d[:, 2:] / FOCAL), [0.46, 0.52, 0.34] + 0.0 * d[:, 2:]
        )
        o = centre - FOOT
        a, b = (d[:, :2] ** 2).sum(axis=1), (o[:2] * d[:, :2]).sum(axis=1)
        c = (o[:2] ** 2).sum() - RADIUS**2
        with np.errstate(invalid="ignore"):
            t = (-b - np.sqrt(b * b - a * c)) / a
        p = o + t[:, None] * d
        hit = (t > 0) & (p[:, 2] > 0.0) & (p[:, 2] < TALL)
        theta = np.arctan2(p[hit, 1], p[hit, 0])
        light = 0.72 + 0.28 * np.clip(np.cos(theta - 0.6), -0.4, 1.0)
        colour[hit] = wall(theta, p[hit, 2]) * light[:, None]
        total += colour / 4
    return (np.clip(total, 0, 1) * 255 + 0.5).astype(np.uint8).reshape(SIZE[1], SIZE[0], 3), centre, rotation


def main(folder: Path) -> None:
    """Make photos and tables, run the command, put the picture together."""
    rng, lines = np.random.default_rng(1), ["id,x,y,z,image,col,row,sigma_px"]
    names = []
    for i in range(COUNT):
        turn = 2 * np.pi * (i + 0.5) / COUNT
        picture, centre, rotation = photo(turn)
        names.append(f"tower{i + 1}.png")
        Image.fromarray(picture).save(folder / names[-1])
        for k in range(10):
            theta, z = turn + rng.uniform(-1.0, 1.0), rng.uniform(0.5, 14.5)
            xyz = FOOT + np.array([RADIUS * np.cos(theta), RADIUS * np.sin(theta), z])
            x, y, w = rotation @ (xyz - centre)
            col, row = np.array([SIZE[0] / 2 - FOCAL * x / w, SIZE[1] / 2 + FOCAL * y / w]) + rng.normal(0, 0.3, 2)
            place = ",".join(f"{value:.4f}" for value in xyz)
            lines.append(f"{i + 1}-{k},{place},{names[-1]},{col:.2f},{row:.2f},0.3")
    (folder / "points.csv").write_text("\n".join(lines) + "\n")
    theta, z = rng.uniform(-np.pi, np.pi, 30), rng.uniform(0.2, 14.8, 30)
    spots = FOOT + np.column_stack([RADIUS * np.cos(theta), RADIUS * np.sin(theta), z]) + rng.normal(0, 0.003, (30, 3))
    rows = [f"{k}," + ",".join(f"{value:.4f}" for value in spot) for k, spot in enumerate(spots)]
    (folder / "wall.csv").write_text("\n".join(["id,x,y,z", *rows]) + "\n")
    (folder / "tower.toml").write_text('kind = "cylinder"\npoints = "wall.csv"\nbottom = 0\ntop = 15\n')
    (folder / "camera.toml").write_text(
        f"focal_length_px = {FOCAL}\nprincipal_point_px = [{SIZE[0] / 2}, {SIZE[1] / 2}]\nsize = {list(SIZE)}\n"
    )
    words = ["develop", *(str(folder / name) for name in names), "--sensor", "frame"]
    words += ["--camera", str(folder / "camera.toml"), "--gcps", str(folder / "points.csv")]
    words += ["--surface", str(folder / "tower.toml"), "--res", "0.02", "-o", str(folder / "tower.tif"), "--overwrite"]
    if run(words):
        raise SystemExit(1)
    import rasterio

    with rasterio.open(folder / "tower.tif") as source:
        developed = Image.fromarray(np.moveaxis(source.read([1, 2, 3]), 0, -1))
    height = 520
    parts = [Image.open(folder / names[0]), developed]
    parts = [
        part.resize((round(part.width * height / part.height), height), Image.Resampling.LANCZOS) for part in parts
    ]
    sheet = Image.new("RGB", (sum(part.width for part in parts) + 20, height), "white")
    sheet.paste(parts[0], (0, 0))
    sheet.paste(parts[1], (parts[0].width + 20, 0))
    sheet.save(IMAGES / "developed-tower.jpg", quality=88)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
