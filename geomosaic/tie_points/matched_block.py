"""Tie points of a block, and how its images hang together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from geomosaic.block_adjustment.start import StartBlock, places_of
from geomosaic.errors import counted, listed
from geomosaic.inputs.tie_points import TiePoints
from geomosaic.report.tie_points import render_ties
from geomosaic.report.tied_images import TiedImages, tied_images
from geomosaic.types import IntArray


@dataclass(frozen=True, eq=False)
class MatchedBlock:
    """Tie points of a block, and how its images hang together.

    Attributes
    ----------
    images : tuple of str (M,)
    ties : TiePoints
        With covariances.
    pairs : int array (P, 3)
        Numbers of two images, and of the tie points that both show.
    features : int array (M,)
        Features found in each.
    start : StartBlock
        The images as they were declared.
    """

    images: tuple[str, ...]
    ties: TiePoints
    pairs: IntArray
    features: IntArray
    start: StartBlock

    @cached_property
    def rays(self) -> IntArray:
        """Number of images that show each point."""
        _, count = np.unique(np.asarray(self.ties.points), return_counts=True)
        return count

    @cached_property
    def per_image(self) -> Mapping[str, int]:
        """Tie points of each image."""
        names, count = np.unique(np.asarray(self.ties.images, dtype=str), return_counts=True)
        known = dict(zip(names.tolist(), count.tolist(), strict=True))
        return {name: known.get(name, 0) for name in self.images}

    @property
    def alone(self) -> tuple[str, ...]:
        """Images without a tie point."""
        return tuple(name for name, count in self.per_image.items() if not count)

    @property
    def facts(self) -> dict[str, Any]:
        """Result as JSON values: features and tie points of each image, tie points of each pair."""
        return {
            "images": [
                {"name": name, "features": int(features), "tie_points": self.per_image[name]}
                for name, features in zip(self.images, self.features.tolist(), strict=True)
            ],
            "pairs": [
                {"one": self.images[one], "other": self.images[other], "tie_points": count}
                for one, other, count in self.pairs.tolist()
            ],
            "alone": list(self.alone),
            "summary": self.summary.splitlines(),
        }

    @property
    def summary(self) -> str:
        """Result in words."""
        if not len(self.ties):
            return f"{counted(len(self.images), 'image')}, no tie point"
        rays = self.rays
        lines = [
            f"{counted(len(self.images), 'image')}, {counted(len(rays), 'tie point')} in "
            f"{counted(len(self.pairs), 'pair')} of images, {counted(len(self.ties), 'image position')}, "
            f"{rays.mean():.2f} for each point",
            f"tie points of an image: {min(self.per_image.values())} to {max(self.per_image.values())}",
            f"standard deviation of a position, median: {np.median(np.asarray(self.ties.sigma)):.2f} px",
        ]
        if self.alone:
            lines.append(f"tied to no other: {listed(self.alone, 6)}")
        return "\n".join(lines)

    @cached_property
    def tied(self) -> TiedImages:
        """Images and tie points as reports show them."""
        numbers = {name: index for index, name in enumerate(self.images)}
        _, point = np.unique(np.asarray(self.ties.points, dtype=str), return_inverse=True)
        image = np.array([numbers[name] for name in self.ties.images], dtype=np.int64)
        places = np.full((len(self.images), 2), np.nan)
        places[self.start.placed] = places_of(self.start)[:, :2]
        return tied_images(self.start.scenes, point.ravel(), image, self.ties.colrow, places)

    def page(self, name: str, notes: Sequence[str] = ()) -> str:
        """Report as an HTML page: who sees whom, what is weakly held, matches drawn on any pair.

        Parameters
        ----------
        name : str
            Of the block, as its title.
        notes : sequence of str
            What the user was warned of.
        """
        return render_ties(self.tied, name, self.summary.splitlines(), notes)
