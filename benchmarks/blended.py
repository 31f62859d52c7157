"""How good a mosaic of the orthos is, from its pixels alone and the truth: the same for every tool.

python -m benchmarks.blended FOLDER MOSAIC [--small]      prints JSON; MOSAIC `truth` judges a mosaic without any seam

- The level is free: one gain and one offset per band, fitted to the truth, are taken off first.
- colour_rms: of the ground (no house in any ortho) from the truth, grey values. The photos' own noise is in it.
- colour_broad_rms: the same of means over 32 x 32 pixels: what is left of gains and offsets.
- seam_step: difference between means of neighbouring 8 x 8 pixels of (mosaic - truth), RMS over bands; 99.9th
  percentile. Noise alone makes the value of `truth`.
- houses_cut: houses that no single ortho shows as the mosaic does, of those that one ortho shows whole. Over all that
  the house covers in any ortho the mosaic must be one ortho's to 25 grey values in 97 % of the pixels.
- missing: share of the canvas without a value.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import rasterio
from rasterio.windows import Window

from benchmarks.town import NOISE, PIXEL, Floats, leaning, place, plan, radiance, town

CELL, BROAD, UNLIKE, SHARE = 8, 32, 25.0, 0.03
Mask = npt.NDArray[np.bool_]


def opened(path: str, folder: Path, small: bool) -> tuple[npt.NDArray[np.float32], Mask]:
    """Mosaic on the canvas (rows, cols, 3) and where it has values."""
    p = plan(small)
    width, height = p.canvas
    with rasterio.open(folder / "truth.tif") as file:
        truth = file.read().transpose(1, 2, 0)
    if path == "truth":
        noise = np.random.default_rng(1).normal(0, NOISE, truth.shape)
        return np.rint(truth + noise).astype(np.float32), np.ones(truth.shape[:2], dtype=bool)
    with rasterio.open(path) as file:
        here = Window(0, 0, width, height)
        if file.crs:
            # All tools keep the orthos' pixel grid; what they add or leave out at the edges is found by the corner.
            col, row = ~file.transform @ (place(p).c, place(p).f)
            if abs(col - round(col)) > 0.01 or abs(row - round(row)) > 0.01 or abs(file.transform.a - PIXEL) > 1e-9:
                raise SystemExit(f"{path} is not on the orthos' grid")
            here = Window(round(col), round(row), width, height)
        values = file.read([1, 2, 3], window=here, boundless=True, fill_value=0).astype(np.float32)
        seen = file.read_masks([1, 2, 3], window=here, boundless=True).all(axis=0)
    seen &= (values > 0).any(axis=0)
    return values.transpose(1, 2, 0), seen


def judge(path: str, folder: Path, small: bool) -> dict[str, Any]:
    """All measures of one mosaic."""
    p = plan(small)
    values, seen = opened(path, folder, small)
    with rasterio.open(folder / "truth.tif") as file:
        truth = file.read().transpose(1, 2, 0)
    houses = town(p)
    bare = seen.copy()
    for house in houses:
        for corner in p.corners():
            left, upper, right, lower = leaning(house, p.above(corner))
            bare[max(int(upper) - 3, 0) : int(lower) + 4, max(int(left) - 3, 0) : int(right) + 4] = False
    for band in range(3):
        slope, level = np.polyfit(values[..., band][bare].astype(np.float64), truth[..., band][bare], 1)
        values[..., band] = slope * values[..., band] + level
    away = values - truth
    broad = cells(away, bare, BROAD)
    return {
        "colour_rms": float(np.sqrt(np.mean(away[bare] ** 2))),
        "colour_broad_rms": float(np.sqrt(np.nanmean(broad**2))),
        "seam_step": step(away, bare),
        **cut(values, truth, houses, folder, small, path == "truth"),
        "missing": float(1 - seen.mean()),
    }


def cells(away: npt.NDArray[np.float32], bare: Mask, side: int) -> Floats:
    """Means over square cells of bare ground (rows, cols, 3); NaN where less than a quarter of a cell is bare."""
    rows, cols = (n // side * side for n in bare.shape)

    def total(values: Any) -> Any:
        return values[:rows, :cols].reshape(rows // side, side, cols // side, side, -1).sum(axis=(1, 3))

    count = total(bare.astype(np.float64))
    out: Floats = np.full((*count.shape[:2], 3), np.nan)
    well = count[..., 0] >= side * side / 4
    out[well] = total(np.where(bare[..., None], away, 0).astype(np.float64))[well] / count[well]
    return out


def step(away: npt.NDArray[np.float32], bare: Mask) -> float:
    """Step between neighbouring cells, at four places of their grid, so that no seam falls into all the cells."""
    steps = []
    for shift in (0, CELL // 4, CELL // 2, 3 * CELL // 4):
        mean = cells(away[shift:, shift:], bare[shift:, shift:], CELL)
        steps += [np.sqrt(np.mean(np.diff(mean, axis=axis) ** 2, axis=2)).ravel() for axis in (0, 1)]
    every = np.concatenate(steps)
    return float(np.percentile(every[np.isfinite(every)], 99.9))


def cut(
    values: npt.NDArray[np.float32],
    truth: npt.NDArray[np.float32],
    houses: Floats,
    folder: Path,
    small: bool,
    seamless: bool,
) -> dict[str, int]:
    """Houses that the mosaic shows in pieces, or half."""
    p = plan(small)
    orthos = {corner: radiance(p, truth, houses, corner) for corner in p.corners()}
    several = wrong = 0
    for house in houses:
        boxes = {corner: leaning(house, p.above(corner)) for corner in orthos}
        whole = [corner for corner, box in boxes.items() if inside(box, corner, p.size)]
        if len(whole) < 2 or seamless:
            continue
        some = np.array([boxes[corner] for corner in boxes if touches(boxes[corner], corner, p.size)])
        left, upper = np.floor(some[:, :2].min(axis=0)).astype(int)
        right, lower = np.ceil(some[:, 2:].max(axis=0)).astype(int)
        several += 1
        best = min(unlike(values, orthos[c], c, (left, upper, right, lower)) for c in whole)
        wrong += best > SHARE
    return {"houses": several, "houses_cut": wrong}


def inside(box: Floats, corner: tuple[int, int], size: tuple[int, int]) -> bool:
    """Whether an ortho shows all of a house."""
    at = np.array(corner)
    return bool((box[:2] >= at).all() and (box[2:] <= at + size).all())


def touches(box: Floats, corner: tuple[int, int], size: tuple[int, int]) -> bool:
    """Whether an ortho shows some of a house."""
    at = np.array(corner)
    return bool((box[2:] > at).all() and (box[:2] < at + size).all())


def unlike(values: Any, ortho: Any, corner: tuple[int, int], box: tuple[int, int, int, int]) -> float:
    """Share of the pixels of a box, so far as an ortho shows it, in which the mosaic is not the ortho."""
    left, top = corner
    rows, cols, _ = ortho.shape
    c0, c1 = max(box[0], left), min(box[2], left + cols)
    r0, r1 = max(box[1], top), min(box[3], top + rows)
    other = values[r0:r1, c0:c1] - ortho[r0 - top : r1 - top, c0 - left : c1 - left]
    return float((np.sqrt(np.mean(other**2, axis=2)) > UNLIKE).mean())


if __name__ == "__main__":
    print(json.dumps(judge(sys.argv[2], Path(sys.argv[1]), "--small" in sys.argv)))
