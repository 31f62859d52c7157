"""Decision whether a balance is applied: what it does to the photos' own pixels, and why it may be left.

The tests themselves are functions of arrays in `radiometry.acceptance`, `radiometry.registration` and
`radiometry.harm`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.corrections import corrected, corrections
from geomosaic.mosaicking.colour.fields import colour_setting, sample_positions
from geomosaic.radiometry.acceptance import CLEARLY_BETTER, MIN_SPREAD, added_spread, held_out_ratio
from geomosaic.radiometry.colour_model import ColourModel, solve_colour_model
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.radiometry.harm import Harm, harm_of
from geomosaic.radiometry.overlaps import Overlap, Thumbnail, paired_samples
from geomosaic.render.photos import Photos
from geomosaic.resample.warp import value_range
from geomosaic.types import FloatArray

# Samples for the question whether light across photos explains gains.
LIGHT_SAMPLES = 6_000
# Pixels that harm is measured on, up to twice as many: a share of 1e-4 is seen.
MAX_PIXELS = 20_000
# Percent of pixels that a balance may clip.
MAX_CLIPPED = 3.0
# Part of the differences that may be left without a look at held-out parts: so much no overlap is overfitted.
SURELY_BETTER = 0.7
# Part of the differences below which gains and offsets explain them: light across photos would leave more of them.
EXPLAINED = 0.1


@dataclass(frozen=True)
class OverlapSamples:
    """Overlap samples that a colour balance is solved from.

    Attributes
    ----------
    pairs : list of Overlap
        Of photos, and of photos with a reference.
    level : array (images, bands)
        Median of each photo; NaN for a reference, and where a photo shows nothing.
    anchor : int or None
        Image that keeps its values.
    notes : tuple of str
        Assumptions and exceptions, in words.
    """

    pairs: list[Overlap]
    level: FloatArray
    anchor: int | None
    notes: tuple[str, ...]


def pixel_harm(pixels: Mapping[int, Thumbnail], solved: Balance, grid: Grid, photos: Photos) -> Harm:
    """Harm of a balance to single pixels of photos.

    Parameters
    ----------
    pixels : mapping of int to Thumbnail
        By the number of the photo.
    solved : Balance
    grid : Grid
        Coarse grid of the thumbnails.
    photos : Photos

    Returns
    -------
    Harm
    """
    places, before, after, applied = [], [], [], corrections(solved)
    step = max(1, sum(np.count_nonzero(piece.valid) for piece in pixels.values()) // MAX_PIXELS)
    for index, piece in pixels.items():
        rows, cols = (at[::step] for at in np.nonzero(piece.valid))
        places.append(np.column_stack([cols + piece.window.col, rows + piece.window.row]))
        before.append(piece.values[rows, cols])
        after.append(corrected(applied[index], piece.values, piece.window, grid, photos.grid)[rows, cols])
    low, high, whole = value_range(photos.info.dtype)
    where, plain, shown = (np.concatenate(parts) for parts in (places, before, after))
    return harm_of(where, plain, shown, solved.gain, (low, high) if whole else None)


def accepted(photos: Photos, grid: Grid, solved: Balance, start: Balance, samples: OverlapSamples) -> Balance:
    """Balance as it was solved, or the identity with a note that says why.

    Parameters
    ----------
    photos : Photos
    grid : Grid
        Coarse grid of the overlaps.
    solved : Balance
        With its harm.
    start : Balance
        Gains and offsets alone.
    samples : OverlapSamples

    Returns
    -------
    Balance
    """
    why = _objection(photos, grid, solved, start, samples)
    if why is None:
        return solved
    return replace(
        solved,
        gain=np.ones_like(solved.gain),
        offset=np.zeros_like(solved.offset),
        after=solved.before,
        curves=None,
        fields=None,
        notes=(*solved.notes, f"colours are left as they are: {why}"),
        harm=Harm(),
    )


def _objection(photos: Photos, grid: Grid, solved: Balance, start: Balance, samples: OverlapSamples) -> str | None:
    """Reason not to apply a balance, in words; None where there is none."""
    before, after = (float(np.sqrt((values**2).mean())) for values in (solved.before, solved.after))
    left = after / before if before > 0 else 0.0
    if left > SURELY_BETTER:
        held_out = held_out_ratio(len(start.gain), start.gain.shape[1], samples.pairs)
        # Light across photos may be all there is to correct: gains alone do not help then.
        if held_out > CLEARLY_BETTER and (solved.fields is None or left > CLEARLY_BETTER):
            return (
                f"gains and offsets leave {100 * held_out:.0f} % of the differences in held-out parts of the overlaps"
            )
    if solved.harm is not None and solved.harm.clipped_percent > MAX_CLIPPED:
        return f"{solved.harm.clipped_percent:.1f} % of the pixels would be clipped"
    level = samples.level
    shown = solved.gain * level + solved.offset if solved.fields is None else _corrected_levels(solved.fields, level)
    added = added_spread(level, shown)
    if left > EXPLAINED and added > MIN_SPREAD and _explained_by_light(photos, grid, solved, start, samples, added):
        return (
            f"gains would make whole photos differ by {100 * added:.0f} % more than they do: light that falls across "
            "each of them looks like exposure where they overlap; `colour` auto solves for such light"
        )
    return None


def _explained_by_light(
    photos: Photos, grid: Grid, solved: Balance, start: Balance, samples: OverlapSamples, added: float
) -> bool:
    """Whether gains add half as much to the spread of levels, or less, once light across photos is solved with them."""
    if solved.fields is not None and "trend" in solved.fields.setting.terms:
        return False
    views = paired_samples(samples.pairs, sample_positions(photos, grid), LIGHT_SAMPLES)
    if views is None:
        return False
    setting = replace(colour_setting(photos, samples.pairs, samples.level), terms=frozenset({"vignetting", "trend"}))
    light = solve_colour_model(views, setting, start.gain, start.offset)
    return added_spread(samples.level, _corrected_levels(light, samples.level)) < added / 2


def _corrected_levels(fields: ColourModel, level: FloatArray) -> FloatArray:
    """Levels (images, bands) after correction but for light across photos, which changes none on the whole."""
    return np.array([fields.tone(index, own) for index, own in enumerate(level)])


def misregistration_notes(photos: Photos, pairs: list[Overlap], overlaps: int, cell: float) -> list[str]:
    """Note of the overlaps that were not used because their views show different ground.

    Parameters
    ----------
    photos : Photos
    pairs : list of Overlap
        The misregistered ones.
    overlaps : int
        Number of all.
    cell : float
        Size of the cells that shifts are counted in, map units.

    Returns
    -------
    list of str
        Empty where all are registered.
    """
    if not pairs:
        return []

    def named(pair: Overlap) -> str:
        names = " and ".join(photos.block.scenes[i].name for i in (pair.first, pair.second))
        apart = cell * float(np.hypot(*pair.registration.shift))
        return f"{names} ({apart:.3g} map units)" if apart else names

    some = "; ".join(named(pair) for pair in pairs[:5]) + (f"; and {len(pairs) - 5} more" if len(pairs) > 5 else "")
    less = "colours are left as they are" if len(pairs) == overlaps else "they say nothing of colours"
    return [
        f"misregistered, {len(pairs)} of {overlaps} overlaps: what two images show at one place does not correlate, so "
        f"{less}; a better orientation would let them: {some}"
    ]
