"""Stages of matching a block: features, pairs, pairs on the ground, places at full size; what each makes is kept."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from geomosaic.block import OrientedImage
from geomosaic.block_adjustment.start import StartBlock
from geomosaic.digests import digest_of, sha256, source_digest
from geomosaic.geo.grid import Window
from geomosaic.matching.features import BYTES_PER_PIXEL, Features, detect_by_tiles, largest_tile
from geomosaic.matching.fixed_features import fixed_features
from geomosaic.matching.least_squares import HALF
from geomosaic.matching.predicted import match_predicted
from geomosaic.matching.ray_consistency import consistent_rays
from geomosaic.matching.tracks import PairMatches, Tracks
from geomosaic.matching.two_view import match_pair
from geomosaic.options.tie_points import TiePointOptions
from geomosaic.raster.info import companions
from geomosaic.stores.path import to_path
from geomosaic.tie_points.cache import Arrays, Cache
from geomosaic.tie_points.footprints import predicted_places
from geomosaic.tie_points.grey_images import GreyImages
from geomosaic.tie_points.rectified import (
    Places,
    RectifiedMatches,
    dissimilar_pairs,
    ground_frames,
    match_rectified,
    seen_ground,
)
from geomosaic.tie_points.refinement import Approximations, RefinedTracks, refine
from geomosaic.tie_points.screening import area_test, ground_matches
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray, Progress

# Pixels of the reduced image from the epipolar line beyond which no match is right: lenses that are not known yet bend
# the lines by a few.
TOLERANCE = 2.0
# Pixels of the reduced image within which the place of a feature is found again.
NEAR_PIXELS = 2.0
# Pixels of the reduced image from an edge of what is valid, within which features are those of the edge; at full size
# patches about them must not reach beyond it either.
BORDER = 8
# Bytes that all images together may take whose features are looked for at the same time.
MEMORY = 1_400_000_000


@dataclass(frozen=True, eq=False)
class Stages:
    """Stages of matching the images of a block.

    Attributes
    ----------
    start : StartBlock
    options : TiePointOptions
    progress : callable
        Called with (done, total, stage).
    """

    start: StartBlock
    options: TiePointOptions
    progress: Progress

    @cached_property
    def cache(self) -> Cache:
        """What is kept of other runs."""
        return Cache(self.options.cache)

    @cached_property
    def keys(self) -> list[tuple[Any, ...]]:
        """What the features of each image depend on."""
        import cv2

        options, made_by = self.options, (source_digest(__name__), cv2.__version__)
        return [
            (_content(scene) if options.cache else "", scene.nodata, scene.bands, scene.usable,
             None if scene.clouds is None else (scene.clouds, sha256(scene.clouds.path)), options.match_size,
             options.features, made_by)
            for scene in self.start.scenes
        ]  # fmt: skip

    @cached_property
    def shrink(self) -> IntArray:
        """Pixels of each file along the side of one of the image in which features are found (M,)."""
        return np.array([shrinkage(scene.model.size, self.options.match_size) for scene in self.start.scenes])

    @cached_property
    def left_out(self) -> Callable[[int, FloatArray], BoolArray] | None:
        """Test of pixels of an image, by its number, for areas without tie points."""
        return None if self.options.leave_out is None else area_test(self.start, self.options.leave_out)

    def features(self) -> list[Features]:
        """Features of each image, in pixels of its file."""
        sizes = [scene.model.size for scene in self.start.scenes]
        needed = max(
            BYTES_PER_PIXEL * largest_tile((-(-width // by), -(-height // by)))
            for (width, height), by in zip(sizes, self.shrink.tolist(), strict=True)
        )
        return in_parallel(
            self.progress, len(sizes), "features", (partial(self._features, k) for k in range(len(sizes))),
            max(1, int(MEMORY / needed)),
        )  # fmt: skip

    def _features(self, number: int) -> Features:
        scene, shrink = self.start.scenes[number], int(self.shrink[number])

        def made() -> dict[str, AnyArray]:
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

        return Features(**self.cache.get(("features", *self.keys[number]), made))

    def pairs(self, found: Sequence[Features], wanted: IntArray) -> list[PairMatches]:
        """Matches of pairs of images that share ground, without those of data strips, clocks and areas left out.

        Parameters
        ----------
        found : sequence of Features
        wanted : int array (P, 2)
            Numbers of the images that are compared.
        """
        matched = in_parallel(
            self.progress, len(wanted), "pairs", (partial(self._pair, i, j, found) for i, j in wanted.tolist())
        )
        sizes = np.array([scene.model.size for scene in self.start.scenes])
        reach: FloatArray = NEAR_PIXELS * self.shrink.astype(np.float64)
        unwanted = fixed_features(found, sizes, reach)
        if self.left_out is not None:
            unwanted = [fixed | self.left_out(k, found[k].colrow) for k, fixed in enumerate(unwanted)]
        return ground_matches(matched, found, unwanted, reach, self._rematch)

    def _rematch(self, i: int, j: int, features: Sequence[Features]) -> PairMatches | None:
        """Matches of two images by some of their features."""
        return self._pair(i, j, features, tuple(digest_of(features[k].colrow) for k in (i, j) if self.options.cache))

    def _pair(self, i: int, j: int, found: Sequence[Features], which: tuple[str, ...] = ()) -> PairMatches | None:
        """Matches of two images; None where they show nothing in common."""
        predicted = predicted_places(self.start, i, j, found[i].colrow)
        tolerance = TOLERANCE * self.shrink[[i, j]].max()

        def made() -> dict[str, AnyArray]:
            matches = None if predicted is None else match_predicted(found[i], found[j], predicted, tolerance)
            if matches is None:
                pair = match_pair(found[i], found[j], tolerance)
                if pair is None:
                    return {"places": np.zeros((0, 2), dtype=np.int64), "cost": np.zeros(0)}
                matches = pair.matches
            one, other = matches.T
            apart = found[i].descriptors[one].astype(np.float64) - found[j].descriptors[other]
            places = np.stack([found[i].place[one], found[j].place[other]], axis=1)
            return {"places": places, "cost": np.linalg.norm(apart, axis=1)}

        said = () if predicted is None else (predicted.colrow, predicted.along)
        arrays = self.cache.get(("pair", self.keys[i], self.keys[j], which, *said), made)
        return PairMatches(i, j, arrays["places"], arrays["cost"]) if len(arrays["places"]) else None

    def with_ground_pairs(
        self, found: Sequence[Features], wanted: IntArray, matched: Sequence[PairMatches]
    ) -> tuple[list[Places], list[PairMatches]]:
        """Places of each image, and matches of pairs: on the ground where views differ too much for features.

        Parameters
        ----------
        found : sequence of Features
        wanted : int array (P, 2)
        matched : sequence of PairMatches
            Of features.
        """
        places = [
            _places_of(features, NEAR_PIXELS * by) for features, by in zip(found, self.shrink.tolist(), strict=True)
        ]
        known = {(each.first, each.second): each for each in matched}
        dissimilar = dissimilar_pairs(self.start, wanted, known)
        on_ground = in_parallel(
            self.progress, len(dissimilar), "pairs on the ground",
            (partial(self._rectified, i, j) for i, j in dissimilar),
        )  # fmt: skip
        for (i, j), more in zip(dissimilar, on_ground, strict=True):
            if more is not None and (len(more.one) > len(known[i, j].places) if (i, j) in known else True):
                reach = NEAR_PIXELS * more.reach
                places[i], one = places[i].including(more.one, float(reach[0]))
                places[j], other = places[j].including(more.other, float(reach[1]))
                known[i, j] = PairMatches(i, j, np.stack([one, other], axis=1), more.cost)
        return places, list(known.values())

    def _rectified(self, i: int, j: int) -> RectifiedMatches | None:
        """Matches of two images on the ground; None where they show nothing in common."""

        def made() -> dict[str, AnyArray]:
            found = match_rectified(self.start, i, j, self.options.match_size, self.options.features, TOLERANCE)
            if found is None:
                return {"one": np.zeros((0, 2)), "other": np.zeros((0, 2)), "cost": np.zeros(0), "reach": np.zeros(2)}
            return {"one": found.one, "other": found.other, "cost": found.cost, "reach": found.reach}

        said = (sample for image in (i, j) for sample in seen_ground(self.start, image))
        arrays = self.cache.get(("on the ground", self.keys[i], self.keys[j], *said), made)
        return RectifiedMatches(**arrays) if len(arrays["one"]) else None

    def refined(self, found: Sequence[Features], places: Sequence[Places], tracks: Tracks) -> RefinedTracks:
        """Tracks measured at full size, without rays that neighbours contradict or that lie in areas left out.

        Parameters
        ----------
        found : sequence of Features
        places : sequence of Places
        tracks : Tracks
        """

        def remember(key: tuple[Any, ...], make: Callable[[], Arrays]) -> Arrays:
            (first, second), *known = key
            return self.cache.get(("patches", self.keys[first], self.keys[second], *known), make)

        approximate = self._approximations(found, places, tracks)
        sizes = np.array([scene.model.size for scene in self.start.scenes])
        with GreyImages(self.start.scenes) as pictures:
            refined = refine(tracks, approximate, sizes, pictures, self.progress, remember)
        refined = refined.select(consistent_rays(refined.tracks, refined.colrow))
        if self.left_out is None:
            return refined
        inside = np.zeros(len(refined.tracks), dtype=bool)
        for image, rows in enumerate(_rows_of_images(refined.tracks.image, len(found))):
            inside[rows] = self.left_out(image, refined.colrow[rows])
        return refined.select(~inside)

    def _approximations(self, found: Sequence[Features], places: Sequence[Places], tracks: Tracks) -> Approximations:
        """First places of rays, with scale and direction of what is about them."""
        colrow, frames, reach = np.zeros((len(tracks), 2)), np.zeros((len(tracks), 2, 2)), np.zeros(len(tracks))
        # Frames of one kind for all rays of a point: those of features, or of the models where it was found on the
        # ground.
        further = np.array([each.features for each in places])[tracks.image] <= tracks.place
        by_models = np.bincount(tracks.point, further, minlength=1)[tracks.point] > 0
        for image, rows in enumerate(_rows_of_images(tracks.image, len(found))):
            features, own = found[image], places[image]
            colrow[rows], reach[rows] = own.colrow[tracks.place[rows]], own.reach[tracks.place[rows]]
            plain, modelled = rows[~by_models[rows]], rows[by_models[rows]]
            frames[plain] = features.frames(features.first_of_places[tracks.place[plain]])
            if len(modelled):
                frames[modelled] = ground_frames(self.start, image, colrow[modelled])
        frames[~np.isfinite(frames).all(axis=(1, 2))] = np.eye(2)
        return Approximations(colrow, frames, reach)


def in_parallel(
    progress: Progress, total: int, stage: str, jobs: Iterable[Callable[[], Any]], most: int | None = None
) -> list[Any]:
    """Results of jobs in their order, a processor for each that there is.

    Parameters
    ----------
    progress : callable
        Called with (done, total, stage).
    total : int
        Number of jobs.
    stage : str
    jobs : iterable of callable
    most : int, optional
        Jobs that may run at the same time.
    """
    done = []
    with ThreadPoolExecutor(min(os.cpu_count() or 1, most or total or 1)) as pool:
        for number, result in enumerate(pool.map(lambda job: job(), jobs)):
            done.append(result)
            progress(number + 1, total, stage)
    return done


def shrinkage(size: tuple[int, int], longest: int) -> int:
    """Whole reduction of an image to about so many pixels along its longer side.

    Parameters
    ----------
    size : tuple of int
    longest : int
    """
    return max(1, round(max(size) / longest))


def _content(scene: OrientedImage) -> str:
    """Digest of an image, of the files beside it that count (masks, sources of a VRT), and of what they say of it."""
    path = to_path(scene.path)
    beside = companions(path, scene.bands)
    return digest_of(*map(sha256, (path, *beside.files)), asdict(beside.metadata))


def _places_of(features: Features, reach: float) -> Places:
    """Places of the features of an image."""
    first = features.first_of_places
    return Places(features.colrow[first], np.full(len(first), reach), len(first))


def _rows_of_images(image: IntArray, count: int) -> list[IntArray]:
    """Rays of each of so many images, after the number of the image of each (N,)."""
    order = np.argsort(image, kind="stable")
    return np.split(order, np.searchsorted(image[order], np.arange(1, count)))
