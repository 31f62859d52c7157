"""Tilt of photos beyond the model of a block, distinguished from blunders.

A conformal or affine adjustment lays the tilt of a photo to its points, and the search for wrong points would blame
those. So each photo may have what the model lacks as unknowns of its own, in its image and to the first order:

    affine       (x² , x·y), (x·y, y²)                    perspective
    conformal    (x, −y), (y, x) besides                  two scales and a shear

and of two explanations of the same contradictions, the likelier one is taken.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.estimation.blunders.findings import BlunderReport, MeasurementKey, MeasurementLabel, report_of
from geomosaic.estimation.blunders.mean_shift import MeanShifts
from geomosaic.estimation.blunders.mean_shift_search import ALPHA, ShiftSearch
from geomosaic.types import FloatArray

MISSING = {"conformal": 4, "affine": 2, "projective": 0}
"""Unknowns of a photo that a projective transformation has and this one has not."""
TRIED = 3
"""Photos tried one by one, those with the most contradictions."""
TINY = 1e-12
"""Sum of squares that is as good as none."""
WORST_CONDITION = 1e6
"""Condition number from which on the points do not hold a photo's further unknowns."""


@dataclass(frozen=True, eq=False)
class TiltTrial:
    """Search for blunders with some photos taken as tilted.

    Attributes
    ----------
    sizes : dict of str to float
        Photos that are taken as tilted, and by how much that shifts their points at most, pixels.
    shifts : MeanShifts
    labels : list of MeasurementLabel
        Of the shifts.
    keys : list
        What each shift is of.
    found : ShiftSearch
    """

    sizes: dict[str, float]
    shifts: MeanShifts
    labels: list[MeasurementLabel]
    keys: list[MeasurementKey]
    found: ShiftSearch

    @property
    def tilted(self) -> frozenset[str]:
        """Photos that are taken as tilted."""
        return frozenset(self.sizes)

    def report(self) -> BlunderReport:
        """Report of the blunders and of the tilted photos."""
        tilted = sorted(self.sizes.items(), key=lambda each: -each[1])
        return replace(report_of(self.shifts, self.found, self.labels), tilted=tuple(tilted))

    def gain(self, other: TiltTrial, kind: str, photos: int) -> float:
        """Twice the logarithm of how much likelier this explanation is than another; above 0 it is the better one.

        The sums of squares are compared as the search compares them (the scale is not known), and each shift and each
        tilt is charged what chance would gain by picking the best of as many, times a hundred.
        """
        each = {"shift": 2.0 * np.log(len(self.shifts) / ALPHA), "tilt": 2.0 * np.log(photos / ALPHA) + MISSING[kind]}
        charge = each["shift"] * (len(self.found.included) - len(other.found.included))
        charge += each["tilt"] * (len(self.sizes) - len(other.sizes))
        mine, theirs = self.found.state, other.found.state
        freedom = min(mine.redundancy, theirs.redundancy)
        return float(freedom * np.log(max(theirs.squares, TINY) / max(mine.squares, TINY)) - charge)


def likeliest_tilts(
    search: Callable[[frozenset[str]], TiltTrial | None], kind: str, tilted: frozenset[str], photos: frozenset[str]
) -> TiltTrial:
    """Search with those photos taken as tilted for which that is likelier than so many blunders.

    Parameters
    ----------
    search : function of the photos that are taken as tilted
        None where the points do not hold their unknowns.
    kind : str
        Of the adjustment.
    tilted : frozenset of str
        To begin with; must be possible.
    photos : frozenset of str
        That may be.
    """
    best = search(tilted)
    if best is None:
        raise RuntimeError("photos whose unknowns are not held")
    while MISSING[kind] and best.tilted != photos:
        blamed = Counter(image for shift in best.found.included for image in best.labels[shift].images)
        # One photo, all that are blamed, or all of them: not every choice, whose number doubles with each photo.
        suspects = [image for image, _ in blamed.most_common() if image in photos - best.tilted]
        ways = [*(frozenset({image}) for image in suspects[:TRIED]), frozenset(suspects), photos]
        chosen = dict.fromkeys(best.tilted | way for way in ways if way)
        trials = [trial for trial in map(search, chosen) if trial is not None]
        gains = [trial.gain(best, kind, len(photos)) for trial in trials]
        if not gains or not max(gains) > 0.0:
            break
        best = trials[int(np.argmax(gains))]
    return best


def missing_terms(kind: str, xy: FloatArray) -> FloatArray:
    """Shifts (N, 2, K) of (x, y) in the image by what a kind lacks, at photo coordinates (N, 2).

    Parameters
    ----------
    kind : str
        'conformal', 'affine' or 'projective'.
    xy : array (N, 2)
        Normalised photo coordinates: from the middle, to the right and upwards.
    """
    x, y = xy.T
    perspective = np.array([[x * x, x * y], [x * y, y * y]])
    scales = np.array([[x, y], [-y, x]])
    terms = {"projective": [np.zeros((2, 0, len(x)))], "affine": [perspective], "conformal": [perspective, scales]}[
        kind
    ]
    moved: FloatArray = np.moveaxis(np.concatenate(terms, axis=1), -1, 0)
    return moved
