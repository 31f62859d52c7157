"""Tie points of a block from its images alone: features, pairs, tracks, least squares matching."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, overload

import numpy as np

from geomosaic.block import OrientedImage
from geomosaic.block_adjustment.start import StartBlock, places_of, start_block
from geomosaic.digests import digest_of, sha256, source_digest
from geomosaic.errors import GeomosaicWarning, InputError, counted, listed
from geomosaic.geo.grid import Window
from geomosaic.inputs.declarations import Block, block_of, on_ground
from geomosaic.inputs.tie_points import TiePoints
from geomosaic.matching.features import Features, detect_by_tiles
from geomosaic.matching.fixed_features import fixed_features
from geomosaic.matching.least_squares import HALF
from geomosaic.matching.overlaps import ALL_PAIRS, all_pairs, pairs_alike, pairs_of_neighbours
from geomosaic.matching.predicted import match_predicted
from geomosaic.matching.tracks import PairMatches, Tracks, consistent_rays, even_selection, join
from geomosaic.matching.two_view import match_pair
from geomosaic.options.declaration import compose
from geomosaic.options.tie_points import TiePointOptions
from geomosaic.raster.info import companions
from geomosaic.report.tie_points import render_ties
from geomosaic.report.tied_images import TiedImages, tied_images
from geomosaic.sensor.plugin import HasPose
from geomosaic.tie_points.cache import Arrays, Cache
from geomosaic.tie_points.diagnostics import diagnostics
from geomosaic.tie_points.footprints import pairs_by_footprints, predicted_places
from geomosaic.tie_points.grey_images import GreyImages
from geomosaic.tie_points.rectified import (
    Places,
    RectifiedMatches,
    dissimilar_pairs,
    ground_frames,
    match_rectified,
    seen_ground,
)
from geomosaic.tie_points.refinement import Approximations, RefinedTracks, Remember, refine
from geomosaic.tie_points.screening import area_test, ground_matches
from geomosaic.types import AnyArray, BoolArray, IntArray, PathLike, Progress

if TYPE_CHECKING:
    from geomosaic.surface.dem import Dem
    from geomosaic.tie_points.control import ReferenceControl

T = TypeVar("T")

# Pixels of the reduced image from the epipolar line beyond which no match is right: lenses that are not known yet bend
# the lines by a few.
TOLERANCE = 2.0
# Cells along the longer side of an image in which tie points are asked for.
CELLS = 16
# Pixels of the reduced image within which the place of a feature is found again.
NEAR_PIXELS = 2.0
# Pixels of the reduced image from an edge of what is valid, within which features are those of the edge; at full size
# patches about them must not reach beyond it either.
BORDER = 8


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


@overload
def match(
    images: Block | Sequence[Block], progress: Progress | None = None, *, reference: None = None, **options: Any
) -> MatchedBlock: ...
@overload
def match(
    images: Block | Sequence[Block],
    progress: Progress | None = None,
    *,
    reference: PathLike,
    dem: PathLike | Dem | float | None = None,
    dem_heights: str | None = None,
    **options: Any,
) -> ReferenceControl: ...
def match(
    images: Block | Sequence[Block],
    progress: Progress | None = None,
    *,
    reference: PathLike | None = None,
    dem: PathLike | Dem | float | None = None,
    dem_heights: str | None = None,
    **options: Any,
) -> MatchedBlock | ReferenceControl:
    """Tie points of images, measured in the images; or control points, found in a georeferenced reference.

    Parameters
    ----------
    images : Block, or sequence of Block
        Images of any sensors. Camera positions, where there are any, say which of them are neighbours.
    progress : callable, optional
        Called with (done, total, stage).
    reference : path, optional
        Ortho, mosaic or map of the land, in which control points are found. The images need an approximate orientation,
        right to `search` metres and some degrees.
    dem : path, Dem or float, optional
        Ground of the control points: a DEM, or one height in metres; instead of the images' own.
    dem_heights : str, optional
        Vertical datum of `dem`, where the file does not say it.
    **options
        Of `TiePointOptions`: `features`, `cache`, ...

    Returns
    -------
    MatchedBlock or ReferenceControl
        `MatchedBlock.ties`, and with `reference` `ReferenceControl.control`, are what `adjust` and `Block` take.

    Raises
    ------
    InputError
        An input is missing or wrong; names file and option.
    SolveError
        No image was found in the reference.

    Examples
    --------
    >>> matched = gm.match(block)  # doctest: +SKIP
    >>> print(gm.adjust(block, ties=matched.ties).summary)  # doctest: +SKIP
    >>> found = gm.match(block, reference="ortho.tif", dem="dem.tif")  # doctest: +SKIP
    """
    parts = [block_of(each, "images") for each in ([images] if isinstance(images, Block) else images)]
    wanted = compose(TiePointOptions, options if reference is None else {"reference": reference, **options})
    if wanted.reference is not None:
        from geomosaic.tie_points.control import reference_control

        return reference_control(
            start_block([on_ground(part, dem, dem_heights) for part in parts]), wanted, progress or _silent
        )
    if dem is not None or dem_heights is not None:
        raise InputError("tie points need no ground", where="`dem`", hint="leave it out, or give a `reference`")
    if sum(len(part.images) for part in parts) < 2:
        raise InputError("tie points join two images or more", where="`images`", hint="give all images of the block")
    return match_start(start_block(parts), wanted, progress or _silent)


def _silent(done: int, total: int, stage: str) -> None:
    """Progress that nobody asked for."""


def match_start(start: StartBlock, options: TiePointOptions, progress: Progress = _silent) -> MatchedBlock:
    """Tie points of the images of a block; see `match`.

    Parameters
    ----------
    start : StartBlock
    options : TiePointOptions
    progress : callable

    Returns
    -------
    MatchedBlock
    """
    import cv2

    scenes, cache = start.scenes, Cache(options.cache)
    made_by = source_digest(__name__), cv2.__version__
    digests = [_content(scene) if options.cache else "" for scene in scenes]
    keys = [
        (digest, scene.nodata, scene.bands, scene.usable, options.match_size, options.features, made_by)
        for digest, scene in zip(digests, scenes, strict=True)
    ]
    total = len(scenes)
    shrink = np.array([shrinkage(scene.model.size, options.match_size) for scene in scenes])
    found = _all(
        progress, total, "features",
        (lambda k=k: _features(scenes[k], keys[k], options, cache) for k in range(total)),
    )  # fmt: skip
    wanted = candidate_pairs(start, found, options.neighbours)

    def pair(i: int, j: int, features: Sequence[Features] = found, said: tuple[Any, ...] = ()) -> PairMatches | None:
        return _pair(start, (i, j), features, TOLERANCE * shrink[[i, j]].max(), (keys[i], keys[j], said), cache)

    def again(i: int, j: int, features: Sequence[Features]) -> PairMatches | None:
        return pair(i, j, features, tuple(digest_of(features[k].colrow) for k in (i, j) if options.cache))

    matched = _all(progress, len(wanted), "pairs", (partial(pair, i, j) for i, j in wanted.tolist()))
    sizes = np.array([scene.model.size for scene in scenes])
    unwanted = fixed_features(found, sizes, NEAR_PIXELS * shrink)
    left_out = None if options.leave_out is None else area_test(start, options.leave_out)
    if left_out is not None:
        unwanted = [fixed | left_out(k, found[k].colrow) for k, fixed in enumerate(unwanted)]
    matched = ground_matches(matched, found, unwanted, NEAR_PIXELS * shrink, again)
    places = [_places_of(features, NEAR_PIXELS * by) for features, by in zip(found, shrink.tolist(), strict=True)]
    known = {(each.first, each.second): each for each in matched}
    dissimilar = dissimilar_pairs(start, wanted, known)
    on_ground = _all(
        progress, len(dissimilar), "pairs on the ground",
        (partial(_rectified, start, (i, j), options, (keys[i], keys[j]), cache) for i, j in dissimilar),
    )  # fmt: skip
    for (i, j), more in zip(dissimilar, on_ground, strict=True):
        if more is not None and (len(more.one) > len(known[i, j].places) if (i, j) in known else True):
            reach = NEAR_PIXELS * more.reach
            places[i], one = places[i].including(more.one, float(reach[0]))
            places[j], other = places[j].including(more.other, float(reach[1]))
            known[i, j] = PairMatches(i, j, np.stack([one, other], axis=1), more.cost)
    tracks = join(list(known.values()), [len(each.colrow) for each in places])

    def remember(key: tuple[Any, ...], make: Callable[[], Arrays]) -> Arrays:
        (first, second), *known = key
        return cache.get(("patches", keys[first], keys[second], *known), make)

    refined = _refined(start, found, places, tracks, progress, remember)
    cache.trim()
    refined = refined.select(consistent_rays(refined.tracks, refined.colrow))
    if left_out is not None:
        image = refined.tracks.image
        inside = np.zeros(len(image), dtype=bool)
        for k, rows in enumerate(_rows_of_images(image, total)):
            inside[rows] = left_out(k, refined.colrow[rows])
        refined = refined.select(~inside)
    longest = np.array([max(scene.model.size) for scene in scenes])
    cells = refined.colrow / (longest[refined.tracks.image] / CELLS)[:, None]
    chosen = even_selection(refined.tracks, cells, 1.0, options.per_cell)
    result = _result(start, found, refined, chosen)
    # Of images of which no two are tied, who needs ties makes an error (`nothing_in_common`).
    for finding in diagnostics(result.tied, result.features) if len(result.ties) else ():
        warnings.warn(str(finding), GeomosaicWarning, stacklevel=3)
    return result


def _content(scene: OrientedImage) -> str:
    """Digest of an image, of the files beside it that count (masks, sources of a VRT), and of what they say of it."""
    path = Path(scene.path)
    beside = companions(path, scene.bands)
    return digest_of(*map(sha256, (path, *beside.files)), asdict(beside.metadata))


def candidate_pairs(start: StartBlock, found: Sequence[Features], neighbours: int) -> IntArray:
    """Pairs (P, 2) of images that are compared: by footprints or positions, else all of a few, else those alike.

    Parameters
    ----------
    start : StartBlock
    found : sequence of Features
    neighbours : int
    """
    overlapping = pairs_by_footprints(start, neighbours)
    near = None
    if start.placed.all() and len(found) > 2:
        near = pairs_of_neighbours(places_of(start)[:, :2], neighbours)
    if overlapping is not None and len(overlapping):
        # Angles of gimbals may be wrong where positions are right.
        photos = near is not None and any(isinstance(model, HasPose) for model in start.models)
        return np.unique(np.concatenate([overlapping, near]), axis=0) if photos else overlapping
    if near is not None:
        return near
    return all_pairs(len(found)) if len(found) <= ALL_PAIRS else pairs_alike(found, neighbours)


def _all(progress: Progress, total: int, stage: str, jobs: Iterable[Any]) -> list[Any]:
    """Results of jobs in their order, a processor for each that there is."""
    done = []
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
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


def _features(scene: OrientedImage, key: tuple[Any, ...], options: TiePointOptions, cache: Cache) -> Features:
    """Features of an image, in pixels of its file."""

    def made() -> dict[str, AnyArray]:
        import cv2

        shrink = shrinkage(scene.model.size, options.match_size)
        border = max(BORDER, -(-(HALF + 2) // shrink))
        kernel = np.ones((2 * border + 1, 2 * border + 1), dtype=np.uint8)
        with GreyImages([scene]) as pictures:

            def read(window: Window) -> tuple[AnyArray, BoolArray | None]:
                grey = pictures.window(0, shrink, window)
                wanted = None if grey.valid is None else cv2.erode(grey.valid.astype(np.uint8), kernel) != 0
                return grey.values, wanted

            found = detect_by_tiles(read, pictures.size(0, shrink), options.features).scaled(shrink)
        return {"colrow": found.colrow, "scale": found.scale, "angle": found.angle, "descriptors": found.descriptors}

    return Features(**cache.get(("features", *key), made))


def _pair(
    start: StartBlock,
    images: tuple[int, int],
    found: Sequence[Features],
    tolerance: float,
    keys: tuple[tuple[Any, ...], ...],
    cache: Cache,
) -> PairMatches | None:
    """Matches of two images; None where they show nothing in common."""
    i, j = images
    predicted = predicted_places(start, i, j, found[i].colrow)

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
    arrays = cache.get(("pair", *keys, *said), made)
    return PairMatches(i, j, arrays["places"], arrays["cost"]) if len(arrays["places"]) else None


def _places_of(features: Features, reach: float) -> Places:
    """Places of the features of an image."""
    first = features.first_of_places
    return Places(features.colrow[first], np.full(len(first), reach), len(first))


def _rectified(
    start: StartBlock,
    images: tuple[int, int],
    options: TiePointOptions,
    keys: tuple[tuple[Any, ...], ...],
    cache: Cache,
) -> RectifiedMatches | None:
    """Matches of two images on the ground; None where they show nothing in common."""

    def made() -> dict[str, AnyArray]:
        found = match_rectified(start, *images, options.match_size, options.features, TOLERANCE)
        if found is None:
            return {"one": np.zeros((0, 2)), "other": np.zeros((0, 2)), "cost": np.zeros(0), "reach": np.zeros(2)}
        return {"one": found.one, "other": found.other, "cost": found.cost, "reach": found.reach}

    said = (sample for image in images for sample in seen_ground(start, image))
    arrays = cache.get(("on the ground", *keys, *said), made)
    return RectifiedMatches(**arrays) if len(arrays["one"]) else None


def _rows_of_images(image: IntArray, count: int) -> list[IntArray]:
    """Rays of each of so many images, after the number of the image of each (N,)."""
    order = np.argsort(image, kind="stable")
    return np.split(order, np.searchsorted(image[order], np.arange(1, count)))


def _refined(
    start: StartBlock,
    found: Sequence[Features],
    places: Sequence[Places],
    tracks: Tracks,
    progress: Progress,
    remember: Remember,
) -> RefinedTracks:
    """Tracks measured at full size."""
    colrow, frames, reach = np.zeros((len(tracks), 2)), np.zeros((len(tracks), 2, 2)), np.zeros(len(tracks))
    # Frames of one kind for all rays of a point: those of features, or of the models where it was found on the ground.
    further = np.array([each.features for each in places])[tracks.image] <= tracks.place
    by_models = np.bincount(tracks.point, further, minlength=1)[tracks.point] > 0
    for image, rows in enumerate(_rows_of_images(tracks.image, len(found))):
        features, own = found[image], places[image]
        colrow[rows], reach[rows] = own.colrow[tracks.place[rows]], own.reach[tracks.place[rows]]
        plain, modelled = rows[~by_models[rows]], rows[by_models[rows]]
        frames[plain] = features.frames[features.first_of_places[tracks.place[plain]]]
        if len(modelled):
            frames[modelled] = ground_frames(start, image, colrow[modelled])
    bad = ~np.isfinite(frames).all(axis=(1, 2))
    frames[bad] = np.eye(2)
    sizes = np.array([scene.model.size for scene in start.scenes])
    approximate = Approximations(colrow, frames, reach)
    with GreyImages(start.scenes) as pictures:
        return refine(tracks, approximate, sizes, pictures, progress, remember)


def _result(start: StartBlock, found: Sequence[Features], refined: RefinedTracks, chosen: BoolArray) -> MatchedBlock:
    """Chosen points as tie points, with the pairs that they join."""
    rows = chosen[refined.tracks.point] if len(refined.tracks) else np.zeros(0, dtype=bool)
    tracks = refined.tracks.select(rows)
    names = start.names
    ties = TiePoints(
        [f"tie{point + 1}" for point in tracks.point.tolist()], [names[image] for image in tracks.image.tolist()],
        refined.colrow[rows], covariance=refined.covariance[rows],
    )  # fmt: skip
    return MatchedBlock(names, ties, tracks.pairs(len(names)), np.array([len(each) for each in found]), start)
