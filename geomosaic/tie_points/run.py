"""Tie points of a block from its images alone, or control points from a reference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from geomosaic.block_adjustment.start import StartBlock, places_of, start_block
from geomosaic.errors import InputError, warn
from geomosaic.execution.units import workers_for
from geomosaic.inputs.declarations import Block, block_of, on_ground
from geomosaic.inputs.tie_points import TiePoints
from geomosaic.kernels.library import library
from geomosaic.matching.features import Features
from geomosaic.matching.overlaps import ALL_PAIRS, all_pairs, pairs_of_neighbours, similar_pairs
from geomosaic.matching.tracks import even_selection, join
from geomosaic.options.declaration import compose
from geomosaic.options.tie_points import TiePointOptions
from geomosaic.sensor.plugin import HasPose
from geomosaic.tie_points.diagnostics import diagnostics
from geomosaic.tie_points.footprints import pairs_by_footprints
from geomosaic.tie_points.matched_block import MatchedBlock
from geomosaic.tie_points.refinement import RefinedTracks
from geomosaic.tie_points.stages import Stages
from geomosaic.types import BoolArray, IntArray, PathLike, Progress, no_progress

if TYPE_CHECKING:
    from geomosaic.surface.dem import Dem
    from geomosaic.tie_points.control import ReferenceControl

# Cells along the longer side of an image in which tie points are asked for.
CELLS = 16


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
        Ortho, mosaic or map of the land, in which control points are found. Images with an approximate orientation,
        right to `search` metres and some degrees, are looked for there, photos without any in all of it.
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
            start_block([on_ground(part, dem, dem_heights) for part in parts]), wanted, progress or no_progress
        )
    if dem is not None or dem_heights is not None:
        raise InputError("tie points need no ground", where="`dem`", hint="leave it out, or give a `reference`")
    if sum(len(part.images) for part in parts) < 2:
        raise InputError("tie points join two images or more", where="`images`", hint="give all images of the block")
    return match_start(start_block(parts), wanted, progress or no_progress)


def match_start(start: StartBlock, options: TiePointOptions, progress: Progress = no_progress) -> MatchedBlock:
    """Tie points of the images of a block; see `match`.

    Parameters
    ----------
    start : StartBlock
    options : TiePointOptions
    progress : callable

    Returns
    -------
    MatchedBlock

    Raises
    ------
    InstallationError
        The compiled kernels are not there.
    """
    library()  # asked for here: finding features takes minutes
    with workers_for(options):
        return _matched(start, options, progress)


def _matched(start: StartBlock, options: TiePointOptions, progress: Progress) -> MatchedBlock:
    stages = Stages(start, options, progress)
    found = stages.features()
    wanted = candidate_pairs(start, found, options.neighbours)
    matched = stages.pairs(found, wanted)
    # Most of what features take; nothing after this compares them.
    found = [each.without_descriptors() for each in found]
    places, matched = stages.with_ground_pairs(found, wanted, matched)
    tracks = join(matched, [len(each.colrow) for each in places])
    del matched  # of thousands of pairs
    refined = stages.refined(found, places, tracks)
    stages.cache.trim()
    longest = np.array([max(scene.model.size) for scene in start.scenes])
    cells = refined.colrow / (longest[refined.tracks.image] / CELLS)[:, None]
    chosen = even_selection(refined.tracks, cells, options.per_cell)
    result = _result(start, found, refined, chosen)
    # Of images of which no two are tied, who needs ties makes an error (`nothing_in_common`).
    for finding in diagnostics(result.tied, result.features) if len(result.ties) else ():
        warn(str(finding))
    return result


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
    return all_pairs(len(found)) if len(found) <= ALL_PAIRS else similar_pairs(found, neighbours)


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
