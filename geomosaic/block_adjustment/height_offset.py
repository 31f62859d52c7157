"""Heights of adjusted points against the ground that was declared: an offset that no measurement explains.

Camera positions whose heights count from another datum, or from the place of take-off, lift the whole block; the tie
points fit each other as well as before. The declared ground tells: its median distance from the points, beside their
standard deviation and its own scatter about that median.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block import OrientedImage
from geomosaic.block_adjustment.start import StartBlock
from geomosaic.errors import GeomosaicError
from geomosaic.estimation.statistics import MAD_TO_SIGMA
from geomosaic.geo.crs import horizontal, is_local
from geomosaic.geo.transform import Transform
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.sensor.solve import image_to_height
from geomosaic.surface.model import undulation

# Standard deviations of the points, and of single distances, beyond which an offset is none of the measurements and
# none of the relief; pixels that it must move an ortho by.
CERTAIN, BEYOND_SCATTER, VISIBLE = 4.0, 2.0, 3.0
# Points that tell.
LEAST = 10
# Metres within which an offset is that of two datums.
SAME = 3.0
# Edges and corners of an image.
BORDER = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 0.0], [0.5, 1.0], [0.0, 0.5], [1.0, 0.5]])


@dataclass(frozen=True)
class HeightOffset:
    """Adjusted points over the declared ground.

    Attributes
    ----------
    offset : float
        Median height of the points above the ground, metres.
    scatter : float
        Robust standard deviation of single ones about it, metres.
    sigma : float
        Median standard deviation of a point's height, metres; 0 where it is not known.
    points : int
    pixels : float
        By how much it moves an ortho at the edges of the images, median, pixels.
    undulation : float
        Of the geoid above the ellipsoid there, metres; NaN where it is not known.
    """

    offset: float
    scatter: float
    sigma: float
    points: int
    pixels: float
    undulation: float

    @property
    def significant(self) -> bool:
        """Whether neither measurements nor relief explain it, and an ortho shows it."""
        size = abs(self.offset)
        return size > max(CERTAIN * self.sigma, BEYOND_SCATTER * self.scatter) and self.pixels > VISIBLE

    @property
    def facts(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "offset_m": self.offset,
            "scatter_m": self.scatter,
            "sigma_m": self.sigma,
            "points": self.points,
            "edge_px": self.pixels,
            "significant": self.significant,
        }

    @property
    def text(self) -> str:
        """What is wrong, and what to do."""
        side = "above" if self.offset > 0.0 else "below"
        text = (
            f"the adjusted points lie {abs(self.offset):.3g} m {side} the declared ground (median of {self.points}; "
            f"single ones scatter by {self.scatter:.2g} m, standard deviation {self.sigma:.2g} m): what is drawn over "
            f"it is displaced by some {self.pixels:.0f} px at the edges of the images"
        )
        if np.isfinite(self.undulation) and abs(abs(self.offset) - abs(self.undulation)) < SAME < abs(self.undulation):
            return (
                f"{text}; geoid and ellipsoid are {abs(self.undulation):.1f} m apart there: `heights` of the positions "
                "or `dem_heights` of the ground likely name the wrong one"
            )
        return (
            f"{text}; check what the heights of the positions count from (`heights`, or the place of take-off), those "
            "of the ground (`dem_heights`), and the focal length; under trees and roofs a ground without them is too "
            "low. Control points or `dem_sigma` settle the height, `dem_from_tie_points` takes the points' own ground"
        )


def height_offset(solution: BlockSolution, scenes: Sequence[OrientedImage], start: StartBlock) -> HeightOffset | None:
    """Offset of the adjusted points from the declared ground.

    Parameters
    ----------
    solution : BlockSolution
    scenes : sequence of OrientedImage
        With adjusted models.
    start : StartBlock

    Returns
    -------
    HeightOffset or None
        None where no ground was declared, or too few points lie over it.
    """
    if start.surface is None or start.from_tie_points or is_local(start.ground):
        return None
    known = np.isfinite(solution.ground).all(axis=1) & (solution.rays > 1)
    points, sigmas = solution.ground[known], solution.point_sigmas[known, 2]
    try:
        there = Transform(start.ground, start.surface.crs)(points)
    except GeomosaicError:  # nothing joins both datums: what is drawn over the ground says so
        return None
    above = there[:, 2] - start.surface.height(there[:, :2])
    over = np.isfinite(above)
    if over.sum() < LEAST:
        return None
    offset = float(np.median(above[over]))
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(above[over] - offset)))
    sigma = float(np.nanmedian(sigmas)) if np.isfinite(sigmas).any() else 0.0
    x, y, level = np.median(points[over], axis=0).tolist()
    moved = np.array([_moved(scene, level, offset, start.ground) for scene in scenes])
    pixels = float(np.nanmedian(moved)) if np.isfinite(moved).any() else 0.0
    return HeightOffset(offset, scatter, sigma, int(over.sum()), pixels, undulation(horizontal(start.ground), x, y))


def _moved(scene: OrientedImage, level: float, offset: float, ground: CRS) -> float:
    """Pixels by which a ground that is wrong by an offset moves an ortho at the edges of an image, median."""
    colrow = BORDER * scene.model.size
    # Where the line of sight meets the ground, and where it would meet the wrong one, seen from above.
    right, wrong, beside = (
        image_to_height(scene.model, colrow + step, height, ground)[:, :2]
        for step, height in ((0.0, level), (0.0, level - offset), (1.0, level))
    )
    pixel = np.linalg.norm(beside - right, axis=1) / np.sqrt(2.0)
    share = np.linalg.norm(wrong - right, axis=1) / pixel
    return float(np.median(share[np.isfinite(share)])) if np.isfinite(share).any() else float("nan")
