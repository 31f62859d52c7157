"""Images and their tie points: which see each other, and how firmly each is tied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from geomosaic.block import OrientedImage
from geomosaic.errors import counted
from geomosaic.matching.tracks import Tracks
from geomosaic.types import BoolArray, FloatArray, IntArray

# Points below which an image hangs loosely: the parameters of a camera take some dozens that are spread.
FEW_POINTS = 30
# Cells along each side of an image that should show a point, and the share of them below which its edges swing.
CELLS, LEAST_COVERED = 5, 0.3
# Share of an image's points that a third image shows, too, below which its heights and scale are passed on unchecked.
LEAST_MULTIPLE = 0.1


@dataclass(frozen=True, eq=False)
class TiedImages:
    """Images and their tie points, N image positions in all.

    Attributes
    ----------
    names, paths : tuple of str (M,)
    sizes : int array (M, 2)
        Width and height in pixels.
    point, image : int array (N,)
        Numbers of the points and of the images.
    colrow : array (N, 2)
        Pixels, corner-based.
    left_out : bool array (N,)
        Measurements that an adjustment left out as blunders.
    places : array (M, 2)
        Of the cameras, or of what the images show, in metres; NaN where not known.
    """

    names: tuple[str, ...]
    paths: tuple[str, ...]
    sizes: IntArray
    point: IntArray
    image: IntArray
    colrow: FloatArray
    left_out: BoolArray
    places: FloatArray

    @cached_property
    def rays(self) -> IntArray:
        """Good rays of each point."""
        return np.bincount(self.point[~self.left_out], minlength=int(self.point.max(initial=-1)) + 1)

    @cached_property
    def pairs(self) -> IntArray:
        """Pairs of images (P, 3) that were matched: two numbers of images, ascending, and the number of good points."""
        count = len(self.names)
        good, every = (
            Tracks(self.point[rows], self.image[rows], self.image[rows]).pairs(count)
            for rows in (np.flatnonzero(~self.left_out), np.arange(len(self.point)))
        )
        left = np.zeros(len(every), dtype=np.int64)
        left[np.searchsorted(every[:, 0] * count + every[:, 1], good[:, 0] * count + good[:, 1])] = good[:, 2]
        return np.column_stack([every[:, :2], left])

    @cached_property
    def good(self) -> IntArray:
        """Rows of rays of points that two images or more show."""
        return np.flatnonzero(~self.left_out & (self.rays[self.point] > 1))


def tied_images(
    scenes: Sequence[OrientedImage],
    point: IntArray,
    image: IntArray,
    colrow: FloatArray,
    places: FloatArray,
    left_out: BoolArray | None = None,
) -> TiedImages:
    """Images of a block with their tie points; see `TiedImages`.

    Parameters
    ----------
    scenes : sequence of OrientedImage (M,)
    point, image : int array (N,)
    colrow : array (N, 2)
    places : array (M, 2)
    left_out : bool array (N,), optional
    """
    return TiedImages(
        tuple(scene.name for scene in scenes), tuple(scene.path for scene in scenes),
        np.array([scene.model.size for scene in scenes]), point, image, colrow,
        np.zeros(len(point), dtype=bool) if left_out is None else left_out, places,
    )  # fmt: skip


def tie_facts(tied: TiedImages) -> dict[str, Any]:
    """Facts of tie points as plain values.

    Parameters
    ----------
    tied : TiedImages

    Returns
    -------
    dict
        `images` with what is weak of each in words, `rays` (points by their number of rays), and `pairs`.
    """
    count, own, good = len(tied.names), [], tied.good
    points = np.bincount(tied.image[good], minlength=count)
    out = np.bincount(tied.image[tied.left_out], minlength=count)
    joined = tied.pairs[tied.pairs[:, 2] > 0]
    partners = np.bincount(joined[:, :2].ravel(), minlength=count)
    rays = np.bincount(tied.image[good], tied.rays[tied.point[good]], count) / np.maximum(points, 1)
    multiple = np.bincount(tied.image[good], tied.rays[tied.point[good]] > 2, count) / np.maximum(points, 1)
    cells = np.floor(CELLS * tied.colrow[good] / tied.sizes[tied.image[good]]).clip(0, CELLS - 1).astype(np.int64)
    seen = np.unique((tied.image[good] * CELLS + cells[:, 1]) * CELLS + cells[:, 0]) // CELLS**2
    covered = np.bincount(seen, minlength=count) / CELLS**2
    for index, name in enumerate(tied.names):
        facts = {
            "name": name,
            "points": int(points[index]),
            "left_out": int(out[index]),
            "partners": int(partners[index]),
            "mean_rays": float(rays[index]),
            "covered": float(covered[index]),
        }
        own.append({**facts, "weak": _weak(facts, float(multiple[index]), count)})
    number = np.bincount(tied.rays[tied.rays > 1])
    return {
        "images": own,
        "rays": {str(n): int(k) for n, k in enumerate(number) if k},
        "pairs": [
            {"one": tied.names[one], "other": tied.names[other], "tie_points": shared}
            for one, other, shared in joined.tolist()
        ],
    }


def _weak(image: Mapping[str, Any], multiple: float, images: int) -> str:
    """What is weak about the ties of an image, in words; empty where nothing is."""
    if not image["points"]:
        return "no tie point"
    found = []
    if image["points"] < FEW_POINTS:
        found.append(f"{counted(image['points'], 'point')} only")
    if image["covered"] < LEAST_COVERED:
        found.append(f"points in {100 * image['covered']:.0f} % of its area")
    if images > 2:
        if image["partners"] == 1:
            found.append("tied to one image only")
        elif multiple < LEAST_MULTIPLE:
            found.append("hardly a point that a third image shows")
    return ", ".join(found)
