"""Colour balance of a block: overlap samples, colour model, and a correction field of each image over the output."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geomosaic.block.block import OrientedImage
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.balance import comparison_grid, master_index, overlap_samples
from geomosaic.mosaicking.colour.histogram import match_histograms, reference_samples
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.radiometry import bases
from geomosaic.radiometry.colour_model import ColourModel, Trial, select_terms, solve_colour_model
from geomosaic.radiometry.corrections import CorrectionField
from geomosaic.radiometry.gain_offset import Balance, rms_difference, solve_gain_offset
from geomosaic.radiometry.normal_equations import ColourSetting
from geomosaic.radiometry.overlaps import (
    MAX_SAMPLES,
    Overlap,
    PairedSamples,
    SamplePositions,
    connected_groups,
    paired_samples,
)
from geomosaic.render.areas import read_areas
from geomosaic.render.photos import Photos
from geomosaic.resample.warp import value_range
from geomosaic.types import AnyArray, FloatArray, IntArray

# Intervals of the net of gains across a footprint: between nodes, vignetting by half is interpolated to 1e-4.
NODES = 48
# Relative difference of the sizes of images of one camera: orthos of one camera are not of equal size.
SIZE_TOLERANCE = 0.05


def _cameras(photos: Photos) -> IntArray:
    """Number of the camera (images,) of each photo: photos of one sensor and of about one size share a camera."""
    known: list[tuple[str, float, float]] = []
    numbers = []
    for scene in photos.block.scenes:
        width, height = scene.model.size
        for number, (sensor, w, h) in enumerate(known):
            if sensor == scene.sensor and abs(width / w - 1) < SIZE_TOLERANCE and abs(height / h - 1) < SIZE_TOLERANCE:
                numbers.append(number)
                break
        else:
            numbers.append(len(known))
            known.append((scene.sensor, width, height))
    return np.array(numbers, dtype=np.int64)


def _view_radius(photos: Photos) -> float:
    """Half the diagonal of a footprint in map units, the median of all."""
    radii = [np.hypot(*(outline.ring - np.array(outline.centre)).T).max() for outline in photos.outlines]
    return float(np.median(radii))


def _sample_positions(photos: Photos, grid: Grid) -> SamplePositions:
    """Positions of cells of a coarse grid, see `radiometry.bases`; 0 for a reference, numbered after the photos."""
    radius = _view_radius(photos)

    def find(index: int, cells: AnyArray) -> tuple[FloatArray, FloatArray]:
        if index >= len(photos):
            return np.zeros((len(cells), 2)), np.zeros((len(cells), 2))
        return _positions(photos, index, grid.xy(np.asarray(cells, dtype=np.float64) + 0.5), radius)

    return find


def _positions(photos: Photos, index: int, xy: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """Positions in the image (N, 2), corners at distance 1, and about the nadir (N, 2), in units of `radius`."""
    surface, size = photos.block.surface, np.array(photos.block.scenes[index].model.size, dtype=np.float64)
    with photos.using(index) as photo:
        mapper = photo.mapper
    own = mapper.surface_xy(xy)
    z = np.zeros(len(xy)) if surface is None or not mapper.uses_heights else surface.height(own)
    # Held at the edges: nodes of a net reach beyond the image, where powers of the radius would run away.
    colrow = np.clip(mapper.image(own, z), 0.0, size)
    image = (colrow - size / 2) / (np.hypot(*size) / 2)
    view = (xy - np.array(photos.outlines[index].centre)) / radius
    return image, np.clip(view, -1.2, 1.2)


def _correction_field(photos: Photos, index: int, fields: ColourModel) -> CorrectionField:
    """Correction field of one photo, laid out over its footprint in the output."""
    # Nodes beyond the image have the gain of its edge, those that the model cannot see the mean gain of the others.
    window = photos.grid.window_of(photos.outlines[index].bounds)
    longer = max(window.width, window.height, 1)
    spacing = longer / NODES
    cols = window.col + spacing * np.arange(max(2, int(np.ceil(window.width / spacing)) + 1))
    rows = window.row + spacing * np.arange(max(2, int(np.ceil(window.height / spacing)) + 1))
    c, r = np.meshgrid(cols, rows)
    xy = photos.grid.xy(np.column_stack([c.ravel(), r.ravel()]))
    image, view = _positions(photos, index, xy, _view_radius(photos))
    log = np.full((len(xy), fields.gain.shape[1]), np.nan)
    seen = np.isfinite(image).all(axis=1)
    if seen.any():
        log[seen] = fields.log_field(index, image[seen], view[seen])
        # Without a height, or where the model cannot see: pixels beside such a node are interpolated with it.
        log[~seen] = log[seen].mean(axis=0)
    else:
        log[:] = 0.0
    # Rounded: sums in another order differ in the last bits, and equal runs must give equal pixels.
    net = np.round(np.exp(log + fields.gain[index]), 9).reshape(len(rows), len(cols), -1)
    shade = CorrectionField.of(
        net, (float(cols[0]), float(rows[0])), (spacing, spacing), fields.dark[index], fields.gamma[index],
        fields.setting.reach, fields.setting.pivot,
    )  # fmt: skip
    if fields.haze is None:
        return shade
    return replace(shade, path=bases.excess_air_path(view).reshape(len(rows), len(cols)), haze=fields.haze[index])


# Samples for the selection of terms, which solves many times.
SELECTION_SAMPLES = 6_000
# Samples for a hotspot, whose splines have many parameters.
HOTSPOT_SAMPLES = 16_000


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
        else solve_gain_offset(len(photos), photos.info.bands, [])
    )


def _solve_colours(photos: Photos, options: MosaicOptions, reference: OrientedImage | None = None) -> Balance:
    """Colour balance of all photos: gain and offset, and further terms that are asked for or selected."""
    # Without reference or master the mean level of the photos is kept; with a master, everything is brought to its
    # values; with a reference, to that raster's.
    grid = comparison_grid(photos)
    hidden = () if options.colours.mask is None else read_areas(options.colours.mask, photos.grid)
    (pairs, level), count = overlap_samples(photos, options.render, grid, hidden), len(photos)
    notes: list[str] = []
    anchor = master_index(photos, options.colours.master)
    if reference is not None:
        more, note = reference_samples(photos, options.render, grid, reference, hidden)
        pairs, anchor, count = [*pairs, *more], count, count + 1
        notes.append(note)
    notes += _notes_of_isolated(photos, pairs)
    # Photos are expected to be as bright as photos, not as the reference.
    level = np.concatenate([level, np.full((count - len(photos), level.shape[1]), np.nan)])
    samples = _Samples(pairs, level, anchor, tuple(notes))
    start = solve_gain_offset(count, photos.info.bands, pairs)
    if options.colours.colour == ("gain",) or not start.overlaps:
        return _images_only(_anchored(start, samples), len(photos), samples)
    return _solve_fields(photos, options, grid, samples, start)


@dataclass(frozen=True)
class _Samples:
    """Overlap samples of photos and reference, levels (images, bands), and the image that keeps its values."""

    pairs: list[Overlap]
    level: FloatArray
    anchor: int | None
    notes: tuple[str, ...]


def _notes_of_isolated(photos: Photos, pairs: list[Overlap]) -> list[str]:
    """Note of the images that share too little with others to be compared."""
    met = {i for pair in pairs for i in (pair.first, pair.second)}
    alone = [scene.name for i, scene in enumerate(photos.block.scenes) if i not in met]
    if not alone or len(photos) == 1:
        return []
    if not met:
        return ["no image shows enough of what another shows to be compared with it: no colour is changed"]
    names = ", ".join(alone[:5]) + (f" and {len(alone) - 5} more" if len(alone) > 5 else "")
    return [f"shows too little of what others show to have its colour compared with theirs: {names}"]


def _solve_fields(photos: Photos, options: MosaicOptions, grid: Grid, samples: _Samples, start: Balance) -> Balance:
    """Balance with the terms that the options name, or that cross-validation selects, beyond gain and offset."""
    find, pairs = _sample_positions(photos, grid), samples.pairs
    kinds = _cameras(photos)
    # A reference was taken by no camera of the block: terms of light and lens do not apply to it.
    camera = np.concatenate([kinds, np.full(len(start.gain) - len(kinds), -1)])
    setting = ColourSetting(
        len(camera), int(kinds.max()) + 1, camera, frozenset(), _value_range(photos, pairs), samples.level,
        middle=_median_sample(pairs),
    )  # fmt: skip
    linear = () if samples.anchor is None else (samples.anchor,)
    terms, trials = frozenset(options.colours.colour) - {"gain"}, list[Trial]()
    if options.colours.colour == ("auto",):
        few = paired_samples(pairs, find, SELECTION_SAMPLES)
        terms = frozenset()
        if few is not None:
            terms, trials = select_terms(few, setting, start.gain, start.offset, linear)
    views = paired_samples(pairs, find, HOTSPOT_SAMPLES if "hotspot" in terms else MAX_SAMPLES) if terms else None
    if views is None:
        return _images_only(replace(_anchored(start, samples), trials=tuple(trials)), len(photos), samples)
    fields = solve_colour_model(views, replace(setting, terms=terms), start.gain, start.offset, linear)
    # Into each field, so that the mosaic is still made in one pass.
    gain, offset = _to_anchor(fields, samples.anchor)
    shades = tuple(_correction_field(photos, i, fields).then(gain, offset) for i in range(len(photos)))
    lines = [shade.line() for shade in shades]
    before, after = _differences(views, fields, gain, len(photos))
    return Balance(
        np.array([line[0] for line in lines]), np.array([line[1] for line in lines]), before, after,
        sum(1 for pair in pairs if pair.second < len(photos)), shades, fields, tuple(trials), samples.notes,
    )  # fmt: skip


def _value_range(photos: Photos, pairs: list[Overlap]) -> float:
    """Range of values: of the sample type, or of the samples where that has none."""
    _, high, whole = value_range(photos.info.dtype)
    return high if whole else max(float(np.abs(pair.a).max()) for pair in pairs) or 1.0


def _median_sample(pairs: list[Overlap]) -> float:
    """Median of the samples, of the first views of all overlaps; at least 0."""
    return max(float(np.median(np.concatenate([pair.a.ravel() for pair in pairs if len(pair.a)]))), 0.0)


def _to_anchor(fields: ColourModel, anchor: int | None) -> tuple[FloatArray, FloatArray]:
    """Gain and offset (bands,) that restore the anchor's own values."""
    bands = fields.gain.shape[1]
    if anchor is None:
        return np.ones(bands), np.zeros(bands)
    return np.exp(-fields.gain[anchor]), -fields.dark[anchor]


def _anchored(solved: Balance, samples: _Samples) -> Balance:
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


def _images_only(solved: Balance, images: int, samples: _Samples) -> Balance:
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
