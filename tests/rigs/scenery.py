"""Many large photos of one ground, made fast: texture that repeats nowhere, water, light that changes; true errors.

Matching is judged on these. `AnalyticGround` colours each pixel with fields, crowns and roofs, in a minute for 12
megapixels, and its noise repeats after 64 cells: a kilometre of it holds places that look alike. Here the relief is the
same, the texture is a sum of octaves of B-spline noise

    t(u, v) = Σₖ Σᵢⱼ h(k, i, j)·β(u/sₖ − i)·β(v/sₖ − j),     sₖ = 2ᵏ·s₀

with numbers h hashed from the seed and the node: no table, so no period. A B-spline on one lattice is one on the next
finer lattice too, exactly (subdivision), so all octaves become one lattice of numbers before any pixel is looked at.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.special import ndtri

from geomosaic.testing.synthetic.block import FlightPlan, PlainCamera, SyntheticPhoto, synthetic_block
from geomosaic.testing.synthetic.ground import AnalyticGround
from geomosaic.testing.synthetic.photo import intersect
from geomosaic.types import AnyArray, BoolArray, ByteArray, Float32Array, FloatArray, IntArray

# Pixels between lines of sight that are traced, cubics between them: the shortest wave of the relief is 190 m.
STEP = 16
# Pixels along the side of a part of a photo, which has its own piece of the lattice.
PART = 800
# Pixels of a photo that the finest noise in it is wide: shorter waves would be aliased.
FINEST = 1.5
# Metres that the widest octave is spaced: fields and woods; and the noise that divides land and water.
WIDEST, LAKES = 200.0, 300.0
# Standard deviation of one octave of noise about its mean.
OCTAVE = 0.14
MEADOW = np.array([0.95, 1.05, 0.75], dtype=np.float32)
SOIL = np.array([1.15, 0.98, 0.85], dtype=np.float32)
DEEP = np.array([0.75, 1.0, 1.05], dtype=np.float32)


@dataclass(frozen=True)
class Scenery:
    """Texture of the ground.

    Attributes
    ----------
    seed : int
    finest : float
        Spacing of the finest noise, metres.
    water : float
        Share of the ground that is water, 0..1: waves there are others in every photo.
    """

    seed: int = 0
    finest: float = 0.1
    water: float = 0.0


@dataclass(frozen=True)
class PhotoRadiometry:
    """What a photo makes of the light.

    Attributes
    ----------
    gain, offset : float
        value = gain · texture + offset, of 1.
    noise : float
        Standard deviation, of 1.
    seed : int
        Of noise and waves.
    """

    gain: float = 1.0
    offset: float = 0.0
    noise: float = 0.01
    seed: int = 0


def photograph(camera: PlainCamera, ground: AnalyticGround, scenery: Scenery, look: PhotoRadiometry) -> ByteArray:
    """Photo (rows, cols, 3) of a ground, uint8.

    Parameters
    ----------
    camera : PlainCamera
        All of it must see the ground.
    ground : AnalyticGround
    scenery : Scenery
    look : PhotoRadiometry
    """
    width, height = camera.size
    nodes = [np.arange(-STEP, size + 3 * STEP, STEP, dtype=np.float64) for size in (width, height)]
    col, row = np.meshgrid(*nodes)
    seen = intersect(camera, ground, np.column_stack([col.ravel(), row.ravel()]))
    if not np.isfinite(seen).all():
        raise ValueError("part of the photo sees no ground")
    place = (seen[:, :2] - ground.origin).reshape(*col.shape, 2)
    pixel = np.linalg.norm(np.diff(place, axis=0), axis=2) / STEP
    level = max(0, int(np.rint(np.log2(FINEST * np.percentile(pixel, 75.0) / scenery.finest))))
    across, down = _cubic(nodes[0], width), _cubic(nodes[1], height)
    picture = np.empty((height, width, 3), dtype=np.uint8)

    def part(corner: tuple[int, int]) -> None:
        rows, cols = slice(corner[0], corner[0] + PART), slice(corner[1], corner[1] + PART)
        u, v = (down[rows] @ (across[cols] @ place[..., k].T).T for k in (0, 1))
        grey, tint, wet = _ground(u, v, scenery, level, look.seed)
        colour = np.where(wet[..., None], DEEP, MEADOW + np.clip(tint, 0.0, 1.0)[..., None] * (SOIL - MEADOW))
        values = look.gain * grey[..., None] * colour + look.offset
        values += np.random.default_rng([look.seed, *corner]).normal(0.0, look.noise, values.shape)
        picture[rows, cols] = np.clip(np.rint(255.0 * values), 0.0, 255.0)

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        list(pool.map(part, [(r, c) for r in range(0, height, PART) for c in range(0, width, PART)]))
    return picture


def _cubic(nodes: FloatArray, count: int) -> sparse.csr_array:
    """Weights (count, nodes) of values at equally spaced nodes at the middles of pixels: cubics through four."""
    at = (np.arange(count) + 0.5 - nodes[0]) / STEP
    first = np.floor(at).astype(np.int64) - 1
    t = at - first
    weights = np.stack(
        [
            -(t - 1) * (t - 2) * (t - 3) / 6,
            t * (t - 2) * (t - 3) / 2,
            -t * (t - 1) * (t - 3) / 2,
            t * (t - 1) * (t - 2) / 6,
        ]
    )
    columns = first + np.arange(4)[:, None]
    rows = np.broadcast_to(np.arange(count), columns.shape)
    return sparse.csr_array((weights.ravel(), (rows.ravel(), columns.ravel())), shape=(count, len(nodes)))


def _ground(
    u: FloatArray, v: FloatArray, scenery: Scenery, level: int, waves: int
) -> tuple[Float32Array, Float32Array, BoolArray]:
    """Grey value, share of soil and whether there is water, at places (R, C) in metres from the origin."""
    wide = int(np.ceil(np.log2(WIDEST / scenery.finest)))
    contrast = 0.16 / (OCTAVE * np.sqrt(wide - level))
    grey = 0.45 + contrast * _noise(u, v, scenery.finest, range(level, wide), (scenery.seed, 0))
    tint = 0.5 + 3.0 * _noise(u, v, WIDEST / 8.0, range(3), (scenery.seed, 1))
    wet = water(scenery, np.stack([u, v], axis=-1))
    if wet.any():
        ripples = 0.28 + 0.25 * contrast * _noise(u, v, scenery.finest, range(level, wide), (scenery.seed, 2, waves))
        grey = np.where(wet, ripples, grey)
    return grey, tint, wet


def water(scenery: Scenery, places: FloatArray) -> BoolArray:
    """Whether there is water at places (..., 2), metres from the ground's origin.

    Parameters
    ----------
    scenery : Scenery
    places : array (..., 2)
        East and north of the ground's origin, metres.

    Returns
    -------
    bool array (...)
    """
    if not scenery.water or not places.size:
        return np.zeros(places.shape[:-1], dtype=bool)
    # Values of noise are close to normal: below their quantile lies the share that is asked for.
    below: BoolArray = _noise(places[..., 0], places[..., 1], LAKES, range(1), (scenery.seed, 3)) < OCTAVE * ndtri(
        scenery.water
    )
    return below


def _noise(u: FloatArray, v: FloatArray, finest: float, octaves: range, key: tuple[int, ...]) -> Float32Array:
    """Sum of some octaves of noise, of which the first of all is `finest` metres wide, at places of any shape."""
    import cv2

    spacing = finest * 2.0 ** octaves[0]
    low = [int(np.floor(each.min() / spacing)) - 3 for each in (v, u)]
    high = [int(np.ceil(each.max() / spacing)) + 3 for each in (v, u)]
    ranges = [(low, high)]
    for _ in octaves[1:]:
        low, high = [k // 2 - 1 for k in low], [-(-k // 2) + 1 for k in high]
        ranges.append((low, high))
    total = np.zeros(0, dtype=np.float32)
    above = [0, 0]
    for octave, ((row, col), (row1, col1)) in zip(octaves[::-1], ranges[::-1], strict=True):
        fresh = _hashed(np.arange(row, row1 + 1), np.arange(col, col1 + 1), (*key, octave))
        if total.size:
            finer = _subdivided(_subdivided(total).T).T
            fresh += finer[row - 2 * above[0] :, col - 2 * above[1] :][: fresh.shape[0], : fresh.shape[1]]
        total, above = fresh, [row, col]
    # Values at nodes and between them, from which cubics reach every place.
    values = _subdivided(_subdivided(total).T).T
    for _ in range(2):
        values = np.pad((values[:-2] + 4.0 * values[1:-1] + values[2:]) / 6.0, ((1, 1), (0, 0)), mode="edge").T
    row, col = ranges[0][0]
    # OpenCV takes no picture wider than 32767 pixels: places in rows of a thousand.
    square = -(-u.size // 1000), 1000
    across, down = (
        np.resize((each * (2.0 / spacing) - 2 * start).astype(np.float32), square)
        for each, start in ((u, col), (v, row))
    )
    sampled = np.asarray(
        cv2.remap(np.ascontiguousarray(values, dtype=np.float32), across, down, cv2.INTER_CUBIC), dtype=np.float32
    )
    return sampled.ravel()[: u.size].reshape(u.shape)


def _subdivided(values: Float32Array) -> Float32Array:
    """Coefficients (2·R − 1, C) of the same cubic B-spline on a lattice twice as fine along rows; its ends are dull."""
    finer = np.empty((2 * len(values) - 1, values.shape[1]), dtype=np.float32)
    finer[1::2] = 0.5 * (values[:-1] + values[1:])
    finer[::2] = 0.75 * values
    finer[2:-1:2] += 0.125 * (values[:-2] + values[2:])
    return finer


def _hashed(rows: IntArray, cols: IntArray, key: tuple[int, ...]) -> Float32Array:
    """Numbers −0.5 to 0.5 of nodes (R, C)."""
    salt = np.random.default_rng(key).integers(0, 2**32, 2, dtype=np.uint32)
    mixed = _mixed(_mixed(rows.astype(np.uint32) ^ salt[0])[:, None] ^ _mixed(cols.astype(np.uint32) ^ salt[1]))
    return mixed.astype(np.float32) / np.float32(2**32) - np.float32(0.5)


def _mixed(bits: AnyArray) -> AnyArray:
    """Whole numbers whose every bit depends on every bit of those given (finaliser of MurmurHash3)."""
    bits = (bits ^ (bits >> np.uint32(16))) * np.uint32(0x85EBCA6B)
    bits = (bits ^ (bits >> np.uint32(13))) * np.uint32(0xC2B2AE35)
    mixed: AnyArray = bits ^ (bits >> np.uint32(16))
    return mixed


def mixed_block(
    ground: AnalyticGround,
    camera: Mapping[str, Any],
    layers: Sequence[tuple[int, int]] = ((6, 6), (4, 4), (2, 4)),
    *,
    gsd: float = 0.3,
    tilt: float = 30.0,
    seed: int = 0,
) -> list[SyntheticPhoto]:
    """Flight plan that asks much of matching: strips there and back, strips across them, photos from thrice as high.

    Parameters
    ----------
    ground : AnalyticGround
    camera : mapping
        As `PlainCamera` has it.
    layers : sequence of (int, int)
        Strips and photos of each, in that order.
    gsd : float
        Pixel size on the ground of the low ones, metres.
    tilt : float
        Largest angle from the vertical, degrees.
    seed : int
    """
    photos, width = [], camera["size"][0]
    for number, (strips, each) in enumerate(layers):
        pixel = gsd * (3.0 if number == 2 else 1.0)
        plan = synthetic_block(
            ground,
            camera,
            FlightPlan(strips, each, 0.75, 0.5, gsd=pixel, tilt=tilt / 2.0, shake=0.01 * width * pixel),
            seed=seed + number,
        )
        for photo in plan:
            (x, y, z), (omega, phi, kappa) = photo.position, photo.angles
            share = min(1.0, tilt / max(float(np.hypot(omega, phi)), 1e-9))
            if number == 1:
                x0, y0 = ground.origin
                x, y, kappa = x0 - (y - y0), y0 + (x - x0), (kappa + 270.0) % 360.0 - 180.0
            name = f"layer{number + 1}_{photo.name}"
            photos.append(SyntheticPhoto(name, (x, y, z), (share * omega, share * phi, kappa)))
    return photos


def tie_errors(
    cameras: Sequence[PlainCamera], ground: AnalyticGround, image: IntArray, point: IntArray, colrow: FloatArray
) -> FloatArray:
    """True errors of tie points: how far each ray is from where its point lies.

    The point is where the ray that is in the middle of its rays meets the ground. Each ray is held against that one in
    both directions, from either image to the other, and the smaller distance counts: between images of different scale
    that in pixels of the coarser one.

    Parameters
    ----------
    cameras : sequence of PlainCamera
    ground : AnalyticGround
    image, point : int array (N,)
        Of each ray; points count from 0.
    colrow : array (N, 2)

    Returns
    -------
    array (N,)
        Pixels; NaN of the rays in the middle, infinity of those that meet no ground.
    """
    met = np.full((len(colrow), 3), np.nan)
    for k, camera in enumerate(cameras):
        rows = np.flatnonzero(image == k)
        if len(rows):
            met[rows] = intersect(camera, ground, colrow[rows])
    middle = _middle_rays(met, point)
    base = middle[point]
    there, here = _projected(cameras, image, met[base]), _projected(cameras, image[base], met)
    with np.errstate(invalid="ignore"):
        off = np.fmin(np.linalg.norm(there - colrow, axis=1), np.linalg.norm(here - colrow[base], axis=1))
    off[~np.isfinite(off)] = np.inf
    off[base == np.arange(len(base))] = np.nan
    errors: FloatArray = off
    return errors


def _middle_rays(met: FloatArray, point: IntArray) -> IntArray:
    """Ray (S,) of each point that is nearest to the medians of its rays' places."""
    order = np.argsort(point, kind="stable")
    starts = np.flatnonzero(np.diff(point[order], prepend=-1))
    parts = np.split(order, starts[1:])
    return np.array([rows[_nearest_to_median(met[rows])] for rows in parts])


def _nearest_to_median(places: FloatArray) -> int:
    """Row of the place that is nearest to the medians."""
    away = np.linalg.norm(places - np.nanmedian(places, axis=0), axis=1)
    return int(np.argmin(np.where(np.isfinite(away), away, np.inf)))


def _projected(cameras: Sequence[PlainCamera], image: IntArray, xyz: FloatArray) -> FloatArray:
    """Places (N, 2) of points (N, 3) in the image of each."""
    colrow = np.full((len(xyz), 2), np.nan)
    for k in np.unique(image).tolist():
        colrow[image == k] = cameras[k].project(xyz[image == k])
    return colrow
