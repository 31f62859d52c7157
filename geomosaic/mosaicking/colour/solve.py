"""Colour balance of a block: overlap samples, colour model, and a correction field of each image over the output."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from geomosaic.block import OrientedImage
from geomosaic.errors import listed
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.acceptance import (
    OverlapSamples,
    accepted,
    balance_change,
    misregistration_notes,
    registered_overlaps,
)
from geomosaic.mosaicking.colour.balance import block_samples, comparison_grid, master_index
from geomosaic.mosaicking.colour.corrections import colour_setting, correction_field, sample_positions, view_radius
from geomosaic.mosaicking.colour.histogram import match_histograms, reference_samples
from geomosaic.mosaicking.colour.sensors import compared_overlaps, with_grey_matched
from geomosaic.mosaicking.precedence import filling_images
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.radiometry.colour_model import ColourModel, Trial, select_terms, solve_colour_model
from geomosaic.radiometry.gain_offset import Balance, rms_difference, solve_gain_offset
from geomosaic.radiometry.overlaps import MAX_SAMPLES, Overlap, PairedSamples, connected_groups, paired_samples
from geomosaic.radiometry.radiometric_change import RadiometricChange
from geomosaic.render.areas import read_areas
from geomosaic.render.calibrated import calibration_of
from geomosaic.render.photos import Photos
from geomosaic.render.regions import map_images
from geomosaic.types import FloatArray

# Samples for the selection of terms, which solves many times.
SELECTION_SAMPLES = 6_000
# Samples for a hotspot, whose splines have many parameters.
HOTSPOT_SAMPLES = 16_000


def keeping_calibration(options: MosaicOptions, scenes: Sequence[OrientedImage]) -> MosaicOptions:
    """Options under which images that hold a physical quantity keep it, unless their colours are asked to change.

    Parameters
    ----------
    options : MosaicOptions
    scenes : sequence of OrientedImage
    """
    colours = options.colours
    if colours.balance is not None or colours.histogram is not None or not any(map(calibration_of, scenes)):
        return options
    return replace(options, colours=replace(colours, balance=False))


def colour_balance(photos: Photos, options: MosaicOptions, reference: OrientedImage | None = None) -> Balance:
    """Corrections of all images that the options ask for: histogram matching, a colour balance, or none.

    Parameters
    ----------
    photos : Photos
    options : MosaicOptions
    reference : OrientedImage, optional
        Georeferenced raster that colours are matched to.

    Returns
    -------
    Balance
        Gain 1 and offset 0 where colours are not to be changed.
    """
    if options.colours.histogram is not None:
        return match_histograms(photos, options, reference)
    return (
        _solve_colours(photos, options, reference)
        if options.balanced
        else replace(solve_gain_offset(len(photos), photos.info.bands, []), change=RadiometricChange())
    )


def _solve_colours(photos: Photos, options: MosaicOptions, reference: OrientedImage | None = None) -> Balance:
    """Colour balance of all photos: gain and offset, and further terms that are asked for or selected."""
    # Without reference or master the mean level of the photos is kept; with a master, everything is brought to its
    # values; with a reference, to that raster's.
    grid = comparison_grid(photos)
    hidden = () if options.colours.mask is None else read_areas(options.colours.mask, photos.grid)
    block, count = block_samples(photos, options.render, grid, hidden), len(photos)
    filling = filling_images(photos.scenes, options.merge)
    # What images change that show next to nothing says nothing of the mosaic.
    pixels = {index: piece for index, piece in block.pixels.items() if index not in filling} or block.pixels
    compared = compared_overlaps(photos, block.overlaps)
    pairs, misregistered = registered_overlaps(compared.pairs)
    notes = list(compared.notes)
    anchor, more = master_index(photos, options.colours.master), list[Overlap]()
    if reference is not None:
        more, note = reference_samples(photos, options.render, grid, reference, hidden)
        pairs, anchor, count = [*pairs, *more], count, count + 1
        notes.append(note)
    notes += _notes_of_isolated(photos, [*block.overlaps, *more])
    notes += misregistration_notes(photos, misregistered, len(compared.pairs), grid.resolution[0])
    # Photos are expected to be as bright as photos, not as the reference.
    level = np.concatenate([block.level, np.full((count - len(photos), block.level.shape[1]), np.nan)])
    samples = OverlapSamples(pairs, level, anchor, tuple(notes))
    start = solve_gain_offset(count, photos.info.bands, pairs)
    if options.colours.colour == ("gain",) or not start.overlaps:
        solved = _images_only(_anchored(start, samples), len(photos), samples)
    else:
        solved = _solve_fields(photos, options, grid, samples, start)
    solved = replace(solved, change=balance_change(pixels, solved, grid, photos))
    # What a user asks to be matched to is matched to, even where that clips or makes a trend.
    if anchor is None:
        solved = accepted(photos, grid, solved, start, samples, options.colours.colour == ("auto",), pixels)
    if not compared.grey:
        return solved
    solved = with_grey_matched(photos, solved, compared.grey)
    return replace(solved, change=balance_change(pixels, solved, grid, photos))


def _notes_of_isolated(photos: Photos, pairs: list[Overlap]) -> list[str]:
    """Note of the images that share too little with others to be compared."""
    met = {i for pair in pairs for i in (pair.first, pair.second)}
    alone = [scene.name for i, scene in enumerate(photos.scenes) if i not in met]
    if not alone or len(photos) == 1:
        return []
    if not met:
        return ["no image shows enough of what another shows to be compared with it: no colour is changed"]
    return [f"shows too little of what others show to have its colour compared with theirs: {listed(alone, 5)}"]


def _solve_fields(
    photos: Photos, options: MosaicOptions, grid: Grid, samples: OverlapSamples, start: Balance
) -> Balance:
    """Balance with the terms that the options name, or that cross-validation selects, beyond gain and offset."""
    find, pairs = sample_positions(photos, grid), samples.pairs
    setting = colour_setting(photos, pairs, samples.level)
    linear = () if samples.anchor is None else (samples.anchor,)
    terms, trials = frozenset(options.colours.colour) - {"gain"}, list[Trial]()
    if options.colours.colour == ("auto",):
        subset = paired_samples(pairs, find, SELECTION_SAMPLES)
        terms = frozenset()
        if subset is not None:
            terms, trials = select_terms(subset, setting, start.gain, start.offset, linear)
    views = paired_samples(pairs, find, HOTSPOT_SAMPLES if "hotspot" in terms else MAX_SAMPLES) if terms else None
    if views is None:
        return _images_only(replace(_anchored(start, samples), trials=tuple(trials)), len(photos), samples)
    fields = solve_colour_model(views, replace(setting, terms=terms), start.gain, start.offset, linear)
    # Into each field, so that the mosaic is still made in one pass.
    gain, offset = _to_anchor(fields, samples.anchor)
    radius = view_radius(photos)
    made = map_images(lambda some: partial(correction_field, some, fields, radius), photos, options.render)
    shades = tuple(shade.then(gain, offset) for _, shade in made)
    lines = [shade.line() for shade in shades]
    before, after = _differences(views, fields, gain, len(photos))
    return Balance(
        np.array([line[0] for line in lines]), np.array([line[1] for line in lines]), before, after,
        sum(1 for pair in pairs if pair.second < len(photos)), shades, fields, tuple(trials), samples.notes,
    )  # fmt: skip


def _to_anchor(fields: ColourModel, anchor: int | None) -> tuple[FloatArray, FloatArray]:
    """Gain and offset (bands,) that restore the anchor's own values."""
    bands = fields.gain.shape[1]
    if anchor is None:
        return np.ones(bands), np.zeros(bands)
    return np.exp(-fields.gain[anchor]), -fields.dark[anchor]


def _anchored(solved: Balance, samples: OverlapSamples) -> Balance:
    """Linear solution in the values of one image; groups of images that overlaps do not join to it stay unchanged."""
    anchor = samples.anchor
    if anchor is None or not solved.overlaps:
        return solved
    first, second = np.array([(pair.first, pair.second) for pair in samples.pairs if len(pair.a)], dtype=np.int64).T
    group = connected_groups(len(solved.gain), first, second)
    # The anchor says nothing about images that no chain of overlaps joins to it.
    own = (group == group[anchor])[:, None]
    gain = np.where(own, solved.gain / solved.gain[anchor], solved.gain)
    offset = np.where(own, (solved.offset - solved.offset[anchor]) / solved.gain[anchor], solved.offset)
    return replace(solved, gain=gain, offset=offset)


def _images_only(solved: Balance, images: int, samples: OverlapSamples) -> Balance:
    """Linear solution of the images without the reference, with the differences between them."""
    gain, offset = solved.gain[:images], solved.offset[:images]
    own = [pair for pair in samples.pairs if pair.second < images and len(pair.a)]
    if len(gain) == len(solved.gain) and not samples.notes:
        return replace(solved, after=rms_difference(own, gain, offset)) if own else solved
    before = rms_difference(own, np.ones_like(gain), np.zeros_like(offset))
    return replace(
        solved, gain=gain, offset=offset, before=before, after=rms_difference(own, gain, offset), overlaps=len(own),
        notes=samples.notes,
    )  # fmt: skip


def _differences(
    views: PairedSamples, fields: ColourModel, gain: FloatArray, images: int
) -> tuple[FloatArray, FloatArray]:
    """RMS differences (bands,) between images before and after."""
    known = views.known & (views.second < images)[:, None]
    one, other = (values[known] for values in fields.corrected(views))
    before = views.a[known] - views.b[known]
    after = gain * (one - other)
    return np.sqrt((before**2).mean(axis=0)), np.sqrt((after**2).mean(axis=0))
