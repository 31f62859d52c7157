"""Units of matching: features of an image, matches of a pair, places of its points at full size; for any process."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomosaic.block_adjustment.start import StartBlock
from geomosaic.digests import digest_of
from geomosaic.geo.grid import Window
from geomosaic.matching.features import Features, detect_by_tiles
from geomosaic.matching.least_squares import HALF
from geomosaic.matching.predicted import match_predicted
from geomosaic.matching.two_view import match_pair
from geomosaic.options.tie_points import TiePointOptions
from geomosaic.tie_points.cache import Arrays
from geomosaic.tie_points.footprints import predicted_places
from geomosaic.tie_points.grey_images import GreyImages
from geomosaic.tie_points.rectified import match_rectified, seen_ground
from geomosaic.tie_points.refinement import PointsOfPair
from geomosaic.types import AnyArray, BoolArray, IntArray

# Pixels of the reduced image from the epipolar line beyond which no match is right: lenses that are not known yet bend
# the lines by a few.
TOLERANCE = 2.0
# Pixels of the reduced image from an edge of what is valid, within which features are those of the edge; at full size
# patches about them must not reach beyond it either.
BORDER = 8


@dataclass(frozen=True, eq=False)
class Made:
    """Arrays that a unit made.

    Attributes
    ----------
    name : str
        Digest of all that they depend on; empty where nothing is kept.
    arrays : mapping of str to array, or None
        None where they are kept of an earlier run.
    """

    name: str
    arrays: Arrays | None


@dataclass(frozen=True, eq=False)
class PairOfFeatures:
    """Features of two images that are to be matched.

    Attributes
    ----------
    first, second : int
        Numbers of the images.
    one, other : Features
    which : tuple of str
        Digests of both, where they are not all that an image has.
    """

    first: int
    second: int
    one: Features
    other: Features
    which: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Matcher:
    """Matching of single images and pairs of a block.

    Attributes
    ----------
    start : StartBlock
    options : TiePointOptions
    shrink : int array (M,)
        Pixels of each file along the side of one of the image in which features are found.
    keys : tuple
        What the features of each image depend on; empty where nothing is kept.
    pictures : GreyImages
        The images, for places at full size.
    kept : collection of str, optional
        Names of what earlier runs made and is kept; None where nothing is.
    """

    start: StartBlock
    options: TiePointOptions
    shrink: IntArray
    pictures: GreyImages
    keys: tuple[Any, ...] = ()
    kept: Collection[str] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """All but parts of the block that its adjustment alone asks for, and workers, which use no others."""
        return {**vars(self), "start": self.start.for_matching(), "options": replace(self.options, workers=None)}

    def features(self, number: int) -> Made:
        """Features of an image: `colrow`, `scale`, `angle` and `descriptors`."""
        scene, shrink = self.start.scenes[number], int(self.shrink[number])

        def made() -> Arrays:
            import cv2

            border = max(BORDER, -(-(HALF + 2) // shrink))
            kernel = np.ones((2 * border + 1, 2 * border + 1), dtype=np.uint8)
            with GreyImages([scene]) as pictures:

                def read(window: Window) -> tuple[AnyArray, BoolArray | None]:
                    grey = pictures.window(0, shrink, window)
                    wanted = None if grey.valid is None else cv2.erode(grey.valid.astype(np.uint8), kernel) != 0
                    return grey.values, wanted

                found = detect_by_tiles(read, pictures.size(0, shrink), self.options.features).scaled(shrink)
            return {
                "colrow": found.colrow, "scale": found.scale, "angle": found.angle, "descriptors": found.descriptors
            }  # fmt: skip

        return self._made(lambda: ("features", *self.keys[number]), made)

    def pair(self, pair: PairOfFeatures) -> Made:
        """Matches of the features of two images: numbers of `places` and their `cost`, none of what is not alike."""
        i, j, one, other = pair.first, pair.second, pair.one, pair.other
        predicted = predicted_places(self.start, i, j, one.colrow)
        tolerance = TOLERANCE * self.shrink[[i, j]].max()

        def made() -> Arrays:
            matches = None if predicted is None else match_predicted(one, other, predicted, tolerance)
            if matches is None:
                found = match_pair(one, other, tolerance)
                if found is None:
                    return {"places": np.zeros((0, 2), dtype=np.int64), "cost": np.zeros(0)}
                matches = found.matches
            a, b = matches.T
            apart = one.descriptors[a].astype(np.float64) - other.descriptors[b]
            places = np.stack([one.place[a], other.place[b]], axis=1)
            return {"places": places, "cost": np.linalg.norm(apart, axis=1)}

        said = () if predicted is None else (predicted.colrow, predicted.along)
        return self._made(lambda: ("pair", self.keys[i], self.keys[j], pair.which, *said), made)

    def rectified(self, pair: tuple[int, int]) -> Made:
        """Matches of two images on the ground, as `RectifiedMatches` has them; none of what is not alike."""
        i, j = pair

        def made() -> Arrays:
            found = match_rectified(self.start, i, j, self.options.match_size, self.options.features, TOLERANCE)
            if found is None:
                return {"one": np.zeros((0, 2)), "other": np.zeros((0, 2)), "cost": np.zeros(0), "reach": np.zeros(2)}
            return {"one": found.one, "other": found.other, "cost": found.cost, "reach": found.reach}

        def key() -> tuple[Any, ...]:
            said = (sample for image in pair for sample in seen_ground(self.start, image))
            return ("on the ground", self.keys[i], self.keys[j], *said)

        return self._made(key, made)

    def patches(self, points: PointsOfPair) -> Made:
        """Points of two images measured at full size in the second: `colrow` and `covariance`."""
        images = points.first, points.second
        return self._made(
            lambda: ("patches", *(self.keys[k] for k in images), *points.known), lambda: points.measured(self.pictures)
        )

    def _made(self, key: Callable[[], tuple[Any, ...]], make: Callable[[], Arrays]) -> Made:
        if self.kept is None:
            return Made("", make())
        name = digest_of(*key())
        return Made(name, None if name in self.kept else dict(make()))
