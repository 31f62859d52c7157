"""Acceptance of a colour balance: registered overlaps, better held-out parts of them, whole photos not less alike.

A solution always fits the overlaps better that it was fitted to. Two questions show whether it is one:

1. **Cross-validation.** Each overlap is cut into eight bands. Gains and offsets solved from every second band must
   bring the means of the others closer together. Means of bands, not single samples: noise, leaning houses and moved
   cars differ from sample to sample and no gain can help that, while a wrong exposure shifts them all.
2. **Levels of whole photos.** Exposures that differ make photos of different level, and gains that correct them make
   levels more alike. Gains that make them less alike can be right, as automatic exposure evens out what the ground is
   not; or they stand for light that falls across each photo, whose bright side meets the dark side of the next, and
   make a ramp over the block. Where the ground decides, gains stay as they are once terms for such light are solved
   with them; where light does, they go back (omitted-variable bias).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.errors import listed
from geomosaic.estimation.statistics import MAD_TO_SIGMA
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.corrections import colour_setting, corrected, corrections, sample_positions
from geomosaic.mosaicking.colour.exposure import exposure_balance
from geomosaic.radiometry.colour_model import ColourModel, solve_colour_model
from geomosaic.radiometry.gain_offset import Balance, solve_gain_offset
from geomosaic.radiometry.overlaps import Overlap, Thumbnail, paired_samples
from geomosaic.radiometry.radiometric_change import RadiometricChange, radiometric_change
from geomosaic.render.photos import Photos
from geomosaic.resample.warp import value_range
from geomosaic.sensor.plugin import HasSensorPositions
from geomosaic.types import AnyArray, FloatArray

# Bands of an overlap, every second of which is held out.
PARTS = 8
# Part of the differences that may be left: less of a change than a tenth is not worth changing values for.
CLEARLY_BETTER = 0.9
# Robust standard deviations at which differences are capped: a cloud in one photo must not decide.
OUTLIER_LIMIT = 3.0
# Standard deviation that gains add to the logarithms of the levels beyond which they are doubted. Ground differs from
# photo to photo: right gains of four sample photos add 0.06, a ramp over four aerial photos (NGI) 0.17.
MIN_SPREAD = 0.1


def registered_overlaps(overlaps: Sequence[Overlap]) -> tuple[list[Overlap], list[Overlap]]:
    """Overlaps that can tell gains, and those that cannot, as their views show different ground.

    Overlaps without texture to judge by are trusted, unless at least half of those that can be judged are
    misregistered: then the orientation is no good anywhere.

    Parameters
    ----------
    overlaps : sequence of Overlap

    Returns
    -------
    registered, misregistered : list of Overlap
    """
    failed = sum(1 for pair in overlaps if pair.registration.failed)
    decided = sum(1 for pair in overlaps if pair.registration.decided)
    distrusted = failed > 0 and 2 * failed >= decided
    bad = [pair.registration.failed or (distrusted and not pair.registration.decided) for pair in overlaps]
    return (
        [pair for pair, out in zip(overlaps, bad, strict=True) if not out],
        [pair for pair, out in zip(overlaps, bad, strict=True) if out],
    )


def held_out_ratio(images: int, bands: int, overlaps: Sequence[Overlap]) -> float:
    """Differences of held-out means with gains and offsets over those without.

    Parameters
    ----------
    images, bands : int
    overlaps : sequence of Overlap

    Returns
    -------
    float
        Ratio of the RMS, relative to the level of each band; 1 where there is nothing to tell or to correct.
    """
    used = [pair for pair in overlaps if len(pair.a) >= PARTS]
    parts = [np.arange(len(pair.a)) * PARTS // len(pair.a) for pair in used]
    before: list[FloatArray] = []
    after: list[FloatArray] = []
    for odd in (0, 1):
        learnt = [_only(pair, part % 2 != odd) for pair, part in zip(used, parts, strict=True)]
        solved = solve_gain_offset(images, bands, learnt)
        for pair, part in zip(used, parts, strict=True):
            i, j = pair.first, pair.second
            level = np.maximum(np.abs(pair.a + pair.b).mean(axis=0, dtype=np.float64) / 2, 1e-12)
            for k in range(odd, PARTS, 2):
                a, b = (view[part == k].mean(axis=0, dtype=np.float64) for view in (pair.a, pair.b))
                before.append((a - b) / level)
                after.append((solved.gain[i] * a + solved.offset[i] - solved.gain[j] * b - solved.offset[j]) / level)
    if not before:
        return 1.0
    plain, left = np.abs(np.array(before)), np.abs(np.array(after))
    limit = OUTLIER_LIMIT * MAD_TO_SIGMA * np.median(plain, axis=0)
    least = float((np.minimum(plain, limit) ** 2).mean())
    return 1.0 if least <= 0 else float(np.sqrt((np.minimum(left, limit) ** 2).mean() / least))


def _only(pair: Overlap, chosen: AnyArray) -> Overlap:
    return replace(pair, a=pair.a[chosen], b=pair.b[chosen], cells=None if pair.cells is None else pair.cells[chosen])


def added_spread(level: FloatArray, shown: FloatArray) -> float:
    """Standard deviation that corrections add to the logarithms of the levels of whole photos.

    Parameters
    ----------
    level, shown : array (images, bands)
        Median of each photo before and after; NaN where unknown.

    Returns
    -------
    float
        Root of the variance after less that before, of the band where it is largest; 0 where levels get more alike.
    """
    known = np.isfinite(level).all(axis=1) & (level > 0).all(axis=1) & (shown > 0).all(axis=1)
    if np.count_nonzero(known) < 2:
        return 0.0
    added = np.log(shown[known]).var(axis=0) - np.log(level[known]).var(axis=0)
    return float(np.sqrt(max(added.max(initial=0.0), 0.0)))


# Samples for the question whether light across photos explains gains.
LIGHT_SAMPLES = 6_000
# Pixels that radiometric change is measured on, up to twice as many: a share of 1e-4 is seen.
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


def balance_change(pixels: Mapping[int, Thumbnail], solved: Balance, grid: Grid, photos: Photos) -> RadiometricChange:
    """Radiometric change by a balance, from single pixels of photos.

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
    RadiometricChange
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
    return radiometric_change(where, plain, shown, solved.gain, (low, high) if whole else None)


def accepted(
    photos: Photos,
    grid: Grid,
    solved: Balance,
    start: Balance,
    samples: OverlapSamples,
    auto: bool,
    pixels: Mapping[int, Thumbnail],
) -> Balance:
    """Balance as it was solved, else gains by recorded exposures, else the identity; with a note that says why.

    Parameters
    ----------
    photos : Photos
    grid : Grid
        Coarse grid of the overlaps.
    solved : Balance
        With its radiometric change.
    start : Balance
        Gains and offsets alone.
    samples : OverlapSamples
    auto : bool
        Whether the terms were selected, rather than named.
    pixels : mapping of int to Thumbnail
        Single pixels of photos by their numbers.

    Returns
    -------
    Balance
    """
    why = _rejection_reason(photos, grid, solved, start, samples, auto)
    if why is None:
        return solved
    exposed = exposure_balance([scene.path for scene in photos.scenes], photos.info.bands, samples.pairs)
    change = None if exposed is None else balance_change(pixels, exposed, grid, photos)
    if exposed is not None and change is not None and change.clipped_percent <= MAX_CLIPPED:
        notes = (*solved.notes, f"a gain and an offset of each photo are not taken: {why}", *exposed.notes)
        return replace(exposed, trials=solved.trials, notes=notes, change=change)
    return replace(
        solved,
        gain=np.ones_like(solved.gain),
        offset=np.zeros_like(solved.offset),
        after=solved.before,
        curves=None,
        fields=None,
        notes=(*solved.notes, f"colours are left as they are: {why}"),
        change=RadiometricChange(),
    )


def _rejection_reason(
    photos: Photos, grid: Grid, solved: Balance, start: Balance, samples: OverlapSamples, auto: bool
) -> str | None:
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
    if solved.change is not None and solved.change.clipped_percent > MAX_CLIPPED:
        return f"{solved.change.clipped_percent:.1f} % of the pixels would be clipped"
    level = samples.level
    shown = solved.gain * level + solved.offset if solved.fields is None else _corrected_levels(solved.fields, level)
    added = added_spread(level, shown)
    if left > EXPLAINED and added > MIN_SPREAD and _explained_by_light(photos, grid, solved, start, samples, added):
        return (
            f"gains would make whole photos differ by {100 * added:.0f} % more than they do: light that falls across "
            "each of them looks like exposure where they overlap"
            # With `auto` there were too few samples to select terms for it.
            + ("" if auto else "; `colour=auto` solves for such light")
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
        names = " and ".join(photos.scenes[i].name for i in (pair.first, pair.second))
        apart = cell * float(np.hypot(*pair.registration.shift))
        return f"{names} ({apart:.3g} map units)" if apart else names

    some = listed(map(named, pairs), 5, "; ")
    less = "colours are left as they are" if len(pairs) == overlaps else "they say nothing of colours"
    models = [photos.scenes[i].model for pair in pairs for i in (pair.first, pair.second)]
    radar = " (radar from two sides never does)" if any(isinstance(one, HasSensorPositions) for one in models) else ""
    return [
        f"misregistered, {len(pairs)} of {overlaps} overlaps: what two images show at one place does not correlate"
        f"{radar}, so {less}; a better orientation would let them: {some}"
    ]
