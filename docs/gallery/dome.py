"""A painted dome, photographed from the floor below, and developed about its top."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from scenes import command

SIZE, FOCAL, RADIUS = 560, 255.0, 6.0
SPRING = 4.0
"""Height of the dome's centre above the floor, metres."""


def paint(points: np.ndarray) -> np.ndarray:
    """Colours (N, 3), 0 to 1, at places (N, 3) relative to the centre: coffers, a ring of ribs, a sky with stars."""
    polar = np.arccos(np.clip(points[:, 2] / RADIUS, -1, 1))
    turn = np.arctan2(points[:, 1], points[:, 0])
    ring = np.floor(np.degrees(polar) / 12.0)
    across, up = np.mod(turn / (2 * np.pi) * 24, 1.0), np.mod(np.degrees(polar) / 12.0, 1.0)
    inset = np.maximum(np.abs(across - 0.5), np.abs(up - 0.5))
    colour = np.full((len(points), 3), (0.86, 0.79, 0.64))
    colour[inset < 0.38] = (0.55, 0.30, 0.22)
    colour[inset < 0.30] = (0.22, 0.30, 0.46)
    rosette = np.hypot((across - 0.5) * np.sin(polar) * 2.2, up - 0.5) < 0.13
    colour[rosette] = (0.88, 0.70, 0.26)
    eye = ring < 1
    colour[eye] = (0.16, 0.22, 0.42)
    star = np.abs(np.mod(turn * 8 / (2 * np.pi), 1.0) - 0.5) < 0.06 / np.maximum(polar, 0.02)
    colour[eye & star & (np.abs(np.degrees(polar) - 8) < 1)] = (0.95, 0.88, 0.55)
    colour[np.abs(np.degrees(polar) - 12.0) < 0.9] = (0.92, 0.80, 0.42)
    colour[np.degrees(polar) > 82] = (0.45, 0.42, 0.38)
    light = 0.78 + 0.22 * np.cos(turn - 0.7) * np.sin(polar)
    return colour * light[:, None]


def photo(centre: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Picture (rows, cols, 3), and rotation ground to image (3, 3), of a photo that looks up into the dome."""
    back = (centre - target) / np.linalg.norm(centre - target)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(back, right), back])
    rows, cols = np.mgrid[0 : 2 * SIZE, 0 : 2 * SIZE] / 2 + 0.25
    rays = np.column_stack([cols.ravel() - SIZE / 2, SIZE / 2 - rows.ravel(), np.full(rows.size, -FOCAL)]) @ rotation
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    along = rays @ centre
    reach = -along + np.sqrt(along**2 - centre @ centre + RADIUS**2)
    hit = centre + reach[:, None] * rays
    colour = np.where(hit[:, 2:] > 0, paint(hit), 0.3)
    fine = colour.reshape(SIZE, 2, SIZE, 2, 3).mean(axis=(1, 3))
    return (np.clip(fine, 0, 1) * 255 + 0.5).astype(np.uint8), rotation


def dome(folder: Path) -> None:
    """Write `dome.tif`: four photos from the floor, developed so that lengths from the top are true."""
    lines = ["image,x,y,z," + ",".join(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))]
    names = []
    for k in range(4):
        a = np.pi / 4 + k * np.pi / 2
        centre = np.array([2.6 * np.cos(a), 2.6 * np.sin(a), 1.6 - SPRING])
        target = np.array([-0.8 * np.cos(a), -0.8 * np.sin(a), RADIUS])
        picture, rotation = photo(centre, target)
        names.append(folder / f"dome{k + 1}.png")
        Image.fromarray(picture).save(names[-1])
        lines.append(",".join([names[-1].name, *(f"{v:.9f}" for v in (*centre, *rotation.ravel()))]))
    (folder / "dome.csv").write_text("\n".join(lines) + "\n")
    (folder / "dome-camera.toml").write_text(
        f"focal_length_px = {FOCAL}\nprincipal_point_px = [{SIZE / 2}, {SIZE / 2}]\nsize = [{SIZE}, {SIZE}]\n"
    )
    (folder / "dome-surface.toml").write_text(
        f'kind = "sphere"\ncentre = [0, 0, 0]\nradius = {RADIUS}\nprojection = "dome-equidistant"\nside = "inside"\n'
        "bottom = 1.0\n"
    )
    command("develop", *names, "--sensor", "frame", "--camera", folder / "dome-camera.toml",
            "--exterior", folder / "dome.csv", "--angles", "matrix", "--matrix", "ground_to_image",
            "--surface", folder / "dome-surface.toml", "--res", 0.02, "--threads", 1, "--no-labels", "--no-balance",
            "-o", folder / "dome.tif")  # fmt: skip
