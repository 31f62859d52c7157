"""The colour of a mosaic: gather what overlaps show, choose what is warranted, solve, and lay it out."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.block.block import OrientedImage
from geomosaic.errors import InputError, did_you_mean
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.balance import comparison_grid, meet
from geomosaic.mosaicking.colour.sample_positions import cameras, places_of, shade_of
from geomosaic.radiometry.gain_offset import Balance, solve
from geomosaic.radiometry.overlap_samples import Overlap
from geomosaic.render.photos import Photos
from geomosaic.resample.warp import value_range
from geomosaic.types import FloatArray

if TYPE_CHECKING:
    from geomosaic.options.mosaic import MosaicOptions
    from geomosaic.radiometry.fields import Fields
    from geomosaic.radiometry.overlap_samples import Views


MOST_TRIED = 6_000
"""Samples from which terms are chosen."""
MOST_SPLINES = 16_000
"""Samples for a hotspot, which has many parameters."""


def colours(photos: Photos, options: MosaicOptions, reference: OrientedImage | None = None) -> Balance:
    """Solve the colour of all photos: gain and offset, and more where it is asked for or warranted.

    Without reference or master the mean level of the photos is kept. With a master, everything is brought to its
    values; with a reference, to that raster's.
    """
    grid = comparison_grid(photos)
    hidden: list[Any] = []
    if options.colours.mask is not None:
        from geomosaic.render.areas import read_areas

        hidden = read_areas(options.colours.mask, photos.grid)
    (pairs, level), count = meet(photos, options.render, grid, hidden), len(photos)
    notes: list[str] = []
    anchor = named(photos, options.colours.master)
    if reference is not None:
        from geomosaic.mosaicking.colour.reference import meet_reference

        more, note = meet_reference(photos, options.render, grid, reference, hidden)
        pairs, anchor, count = [*pairs, *more], count, count + 1
        notes.append(note)
    notes += _alone(photos, pairs)
    start = solve(count, photos.info.bands, pairs)
    anchored = _anchored(start, anchor, pairs)
    if options.colours.colour == ("gain",) or not start.overlaps:
        return _without(anchored, len(photos), pairs, notes)
    level = np.concatenate([level, np.full((count - len(photos), level.shape[1]), np.nan)])
    return _with_fields(photos, options, grid, pairs, level, start, anchored, anchor, notes)


def _alone(photos: Photos, pairs: list[Overlap]) -> list[str]:
    """Say which images show too little of what others show to be compared."""
    met = {i for pair in pairs for i in (pair.first, pair.second)}
    alone = [scene.name for i, scene in enumerate(photos.block.scenes) if i not in met]
    if not alone or len(photos) == 1:
        return []
    if not met:
        return ["no image shows enough of what another shows to be compared with it: no colour is changed"]
    names = ", ".join(alone[:5]) + (f" and {len(alone) - 5} more" if len(alone) > 5 else "")
    return [f"shows too little of what others show to have its colour compared with theirs: {names}"]


def named(photos: Photos, master: str | None) -> int | None:
    """Number of an image by its name, with or without suffix."""
    names = [scene.name for scene in photos.block.scenes]
    if master is None:
        return None
    stems = [name.rpartition(".")[0] or name for name in names]
    if master not in names and stems.count(master) == 1:
        return stems.index(master)
    if master not in names:
        hint = did_you_mean(master, names)
        raise InputError(
            f"no image is named '{master}'",
            where="`master`",
            hint=f"{hint} name one of the images; a raster besides them is a reference (`reference`)".strip(),
        )
    return names.index(master)


def _with_fields(
    photos: Photos,
    options: MosaicOptions,
    grid: Grid,
    pairs: list[Overlap],
    level: FloatArray,
    start: Balance,
    anchored: Balance,
    anchor: int | None,
    notes: list[str],
) -> Balance:
    from geomosaic.radiometry.model_selection import choose, solve_terms
    from geomosaic.radiometry.normal_equations import Setting
    from geomosaic.radiometry.overlap_samples import MOST_SAMPLES, gather

    find = places_of(photos, grid)
    kinds = cameras(photos)
    camera = np.concatenate([kinds, np.full(len(start.gain) - len(kinds), -1)])
    setting = Setting(
        len(camera), int(kinds.max()) + 1, camera, frozenset(), _reach(photos, pairs), level, middle=_middle(pairs)
    )
    linear = () if anchor is None else (anchor,)
    asked = None if options.colours.colour == ("auto",) else frozenset(options.colours.colour) - {"gain"}
    few = gather(pairs, find, MOST_TRIED) if asked is None else None
    trials: list[Any] = []
    if asked is None:
        asked, trials = (frozenset(), []) if few is None else choose(few, setting, start.gain, start.offset, linear)
    if not asked:
        return _without(replace(anchored, trials=tuple(trials)), len(photos), pairs, notes)
    views = gather(pairs, find, MOST_SPLINES if "hotspot" in asked else MOST_SAMPLES)
    if views is None:
        return _without(anchored, len(photos), pairs, notes)
    fields = solve_terms(views, replace(setting, terms=asked), start.gain, start.offset, linear)
    gain, offset = _to_anchor(fields, anchor)
    shades = tuple(shade_of(photos, i, fields).then(gain, offset) for i in range(len(photos)))
    lines = [shade.line() for shade in shades]
    before, after = _differences(views, fields, gain, len(photos))
    return Balance(
        np.array([line[0] for line in lines]), np.array([line[1] for line in lines]), before, after,
        sum(1 for pair in pairs if pair.second < len(photos)), shades, fields, tuple(trials), tuple(notes),
    )  # fmt: skip


def _reach(photos: Photos, pairs: list[Overlap]) -> float:
    """The range of values: of the sample type, or of the samples where that has none."""
    _, high, whole = value_range(photos.info.dtype)
    return high if whole else max(float(np.abs(pair.a).max()) for pair in pairs) or 1.0


def _middle(pairs: list[Overlap]) -> float:
    """Median of the samples, of the first views of all overlaps; 0 where it is no light."""
    return max(float(np.median(np.concatenate([pair.a.ravel() for pair in pairs if len(pair.a)]))), 0.0)


def _to_anchor(fields: Fields, anchor: int | None) -> tuple[FloatArray, FloatArray]:
    """Gain and offset (bands,) that give the anchor its own values back."""
    bands = fields.gain.shape[1]
    if anchor is None:
        return np.ones(bands), np.zeros(bands)
    return np.exp(-fields.gain[anchor]), -fields.dark[anchor]


def _anchored(solved: Balance, anchor: int | None, pairs: list[Overlap]) -> Balance:
    """Bring a linear solution to the values of one image; groups of images it is not joined to stay as they are."""
    if anchor is None or not solved.overlaps:
        return solved
    from geomosaic.radiometry.drift import groups

    first, second = np.array([(pair.first, pair.second) for pair in pairs if len(pair.a)], dtype=np.int64).T
    group = groups(len(solved.gain), first, second)
    own = (group == group[anchor])[:, None]
    gain = np.where(own, solved.gain / solved.gain[anchor], solved.gain)
    offset = np.where(own, (solved.offset - solved.offset[anchor]) / solved.gain[anchor], solved.offset)
    return replace(solved, gain=gain, offset=offset)


def _without(solved: Balance, images: int, pairs: list[Overlap], notes: list[str]) -> Balance:
    """A linear solution of the images alone, with the differences between them."""
    gain, offset = solved.gain[:images], solved.offset[:images]
    own = [pair for pair in pairs if pair.second < images and len(pair.a)]
    if len(gain) == len(solved.gain) and not notes:
        return replace(solved, after=_after(own, gain, offset)) if own else solved
    before = _after(own, np.ones_like(gain), np.zeros_like(offset))
    return replace(
        solved, gain=gain, offset=offset, before=before, after=_after(own, gain, offset), overlaps=len(own),
        notes=tuple(notes),
    )  # fmt: skip


def _after(pairs: list[Overlap], gain: FloatArray, offset: FloatArray) -> FloatArray:
    """Root mean square difference (bands,) over overlaps."""
    total, count = np.zeros(gain.shape[1]), 0
    for pair in pairs:
        i, j = pair.first, pair.second
        a, b = pair.a.astype(np.float64), pair.b.astype(np.float64)
        total += ((gain[i] * a + offset[i] - gain[j] * b - offset[j]) ** 2).sum(axis=0)
        count += len(a)
    return np.sqrt(total / count) if count else np.full(len(total), np.nan)


def _differences(views: Views, fields: Fields, gain: FloatArray, images: int) -> tuple[FloatArray, FloatArray]:
    """Root mean square differences (bands,) between images before and after."""
    known = views.known & (views.second < images)[:, None]
    one, other = (values[known] for values in fields.corrected(views))
    before = views.a[known] - views.b[known]
    after = gain * (one - other)
    return np.sqrt((before**2).mean(axis=0)), np.sqrt((after**2).mean(axis=0))
