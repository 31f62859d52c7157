"""Stages of matching a block: features, pairs, pairs on the ground, places at full size; what each makes is kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from geomosaic.block_adjustment.start import StartBlock
from geomosaic.digests import digest_of, sha256, source_digest
from geomosaic.execution.units import map_units
from geomosaic.matching.features import BYTES_PER_PIXEL, Features, largest_tile
from geomosaic.matching.fixed_features import fixed_features
from geomosaic.matching.ray_consistency import consistent_rays
from geomosaic.matching.tracks import PairMatches, Tracks
from geomosaic.options.tie_points import TiePointOptions
from geomosaic.raster.info import companions
from geomosaic.stores.path import to_path
from geomosaic.tie_points.cache import Arrays, Cache
from geomosaic.tie_points.grey_images import GreyImages
from geomosaic.tie_points.rectified import (
    Places,
    RectifiedMatches,
    dissimilar_pairs,
    ground_frames,
)
from geomosaic.tie_points.refinement import Approximations, RefinedTracks, refine
from geomosaic.tie_points.screening import area_test, ground_matches
from geomosaic.tie_points.units import Made, Matcher, PairOfFeatures
from geomosaic.types import BoolArray, FloatArray, IntArray, Progress
from geomosaic.whole_files import absolute

# Pixels of the reduced image within which the place of a feature is found again.
NEAR_PIXELS = 2.0
# Parts of the memory limit for images whose features are looked for at the same time, and for those at full size.
OF_FEATURES, OF_PICTURES = 0.65, 0.5
# What is made of an image or a pair, by `Matcher`.
_Unit = Callable[[Matcher, Any], Made]


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
        contents = map_units(_content, [(absolute(one.path), one.bands) for one in self.start.scenes], options)
        return [
            (content, scene.nodata, scene.bands, scene.usable,
             None if scene.clouds is None else (scene.clouds, sha256(scene.clouds.path)), options.match_size,
             options.features, made_by)
            for scene, (_, content) in zip(self.start.scenes, contents, strict=True)
        ]  # fmt: skip

    @cached_property
    def shrink(self) -> IntArray:
        """Pixels of each file along the side of one of the image in which features are found (M,)."""
        return np.array([_shrinkage(scene.model.size, self.options.match_size) for scene in self.start.scenes])

    @cached_property
    def left_out(self) -> Callable[[int, FloatArray], BoolArray] | None:
        """Test of pixels of an image, by its number, for areas without tie points."""
        return None if self.options.leave_out is None else area_test(self.start, self.options.leave_out)

    @cached_property
    def matcher(self) -> Matcher:
        """Matching of single images and pairs, on threads or workers."""
        options, kept = self.options, self.cache.names
        pictures = GreyImages(self.start.scenes, int(OF_PICTURES * options.memory_limit))
        return Matcher(self.start, options, self.shrink, pictures, () if kept is None else tuple(self.keys), kept)

    def features(self) -> list[Features]:
        """Features of each image, in pixels of its file."""
        sizes = [scene.model.size for scene in self.start.scenes]
        needed = max(
            BYTES_PER_PIXEL * largest_tile((-(-width // by), -(-height // by)))
            for (width, height), by in zip(sizes, self.shrink.tolist(), strict=True)
        )
        most = max(1, int(OF_FEATURES * self.options.memory_limit / needed))
        return [Features(**arrays) for arrays in self._made(Matcher.features, range(len(sizes)), "features", most)]

    def _made(self, unit: _Unit, items: Sequence[Any], stage: str, most: int | None = None) -> Iterator[Arrays]:
        """Arrays of items in their order, kept of earlier runs or for later ones; at most so many at the same time."""
        threads = self.options.threads if most is None else min(self.options.threads, most)
        limited = replace(self.options, threads=threads)
        with closing(map_units(partial(unit, self.matcher), items, limited)) as results:
            for done, (item, made) in enumerate(results, start=1):
                yield self._kept(unit, item, made)
                self.progress(done, len(items), stage)

    def _kept(self, unit: _Unit, item: Any, made: Made) -> Arrays:
        """Arrays of an item, which are kept; those of an earlier run that are damaged are made again."""

        def arrays() -> Arrays:
            return made.arrays if made.arrays is not None else unit(replace(self.matcher, kept=None), item).arrays or {}

        return self.cache.named(made.name, arrays)

    def pairs(self, found: Sequence[Features], wanted: IntArray) -> list[PairMatches]:
        """Matches of pairs of images that share ground, without those of data strips, clocks and areas left out.

        Parameters
        ----------
        found : sequence of Features
        wanted : int array (P, 2)
            Numbers of the images that are compared.
        """
        pairs = [PairOfFeatures(i, j, found[i], found[j]) for i, j in wanted.tolist()]
        matched = list(map(_pair_matches, pairs, self._made(Matcher.pair, pairs, "pairs")))
        sizes = np.array([scene.model.size for scene in self.start.scenes])
        reach: FloatArray = NEAR_PIXELS * self.shrink.astype(np.float64)
        unwanted = fixed_features(found, sizes, reach)
        if self.left_out is not None:
            unwanted = [fixed | self.left_out(k, found[k].colrow) for k, fixed in enumerate(unwanted)]
        return ground_matches(matched, found, unwanted, reach, self._rematch)

    def _rematch(self, i: int, j: int, features: Sequence[Features]) -> PairMatches | None:
        """Matches of two images by some of their features."""
        which = tuple(digest_of(features[k].colrow) for k in (i, j) if self.options.cache)
        pair = PairOfFeatures(i, j, features[i], features[j], which)
        return _pair_matches(pair, self._kept(Matcher.pair, pair, self.matcher.pair(pair)))

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
        on_ground = self._made(Matcher.rectified, dissimilar, "pairs on the ground")
        for (i, j), arrays in zip(dissimilar, on_ground, strict=True):
            more = RectifiedMatches(**arrays)
            if len(more.one) and (len(more.one) > len(known[i, j].places) if (i, j) in known else True):
                reach = NEAR_PIXELS * more.reach
                places[i], one = places[i].including(more.one, float(reach[0]))
                places[j], other = places[j].including(more.other, float(reach[1]))
                known[i, j] = PairMatches(i, j, np.stack([one, other], axis=1), more.cost)
        return places, list(known.values())

    def refined(self, found: Sequence[Features], places: Sequence[Places], tracks: Tracks) -> RefinedTracks:
        """Tracks measured at full size, without rays that neighbours contradict or that lie in areas left out.

        Parameters
        ----------
        found : sequence of Features
        places : sequence of Places
        tracks : Tracks
        """
        approximate = self._approximations(found, places, tracks)
        sizes = np.array([scene.model.size for scene in self.start.scenes])
        with self.matcher.pictures:
            # One after the other where threads do: each is on all processors.
            points = partial(self._made, Matcher.patches, stage="least squares matching", most=1)
            refined = refine(tracks, approximate, sizes, points)
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


def _pair_matches(pair: PairOfFeatures, arrays: Arrays) -> PairMatches | None:
    """Matches of a pair; None where its images show nothing in common."""
    return PairMatches(pair.first, pair.second, arrays["places"], arrays["cost"]) if len(arrays["places"]) else None


def _shrinkage(size: tuple[int, int], longest: int) -> int:
    """Whole reduction of an image to about so many pixels along its longer side."""
    return max(1, round(max(size) / longest))


def _content(image: tuple[str, tuple[int, ...] | None]) -> str:
    """Digest of an image, of the files beside it that count (masks, sources of a VRT), and of what they say of it."""
    path, bands = to_path(image[0]), image[1]
    beside = companions(path, bands)
    return digest_of(*map(sha256, (path, *beside.files)), asdict(beside.metadata))


def _places_of(features: Features, reach: float) -> Places:
    """Places of the features of an image."""
    first = features.first_of_places
    return Places(features.colrow[first], np.full(len(first), reach), len(first))


def _rows_of_images(image: IntArray, count: int) -> list[IntArray]:
    """Rays of each of so many images, after the number of the image of each (N,)."""
    order = np.argsort(image, kind="stable")
    return np.split(order, np.searchsorted(image[order], np.arange(1, count)))
