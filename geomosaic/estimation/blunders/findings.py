"""Named blunders of a block: size, place, what may be wrong in their stead, and what is done about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from geomosaic.errors import InputError, listed, warn
from geomosaic.estimation.blunders.mean_shift import MeanShifts, ShiftSearch, minimal_detectable
from geomosaic.estimation.network import Network
from geomosaic.types import FloatArray

# A blunder is gross from so many standard deviations of the others on, and so many pixels: it would be seen.
GROSS, GROSS_PIXELS = 6.0, 5.0
# Standard deviation of unit weight from which on small contradictions may be the model's: only gross ones count.
MISFIT = 1.5
# Points named in one message.
MOST_NAMED = 6


@dataclass(frozen=True)
class MeasurementLabel:
    """Label of a measurement that may be a blunder.

    Attributes
    ----------
    name : str
        In words, as "tie point '12' in III and IV".
    id : str
    images : tuple of str
        Where the error may be; empty where it is the given coordinates.
    where : tuple of str
        File and line of each measurement, where known.
    pixel : float
        Units of its shift per pixel: 1, or map units per pixel for given coordinates.
    control : bool
        Whether the point has given coordinates.
    """

    name: str
    id: str
    images: tuple[str, ...]
    where: tuple[str, ...]
    pixel: float = 1.0
    control: bool = False


@dataclass(frozen=True)
class Blunder:
    """Measurement that contradicts the others.

    Attributes
    ----------
    label : MeasurementLabel
    shift : int
        Its number in the network.
    size : float
        By how much, pixels.
    gross : bool
    redundancy : float
        How much of it others check, 0 to 1.
    alternatives : tuple of str
        Names of others that may be the blunder in its place: the redundancy does not tell which.
    """

    label: MeasurementLabel
    shift: int
    size: float
    gross: bool
    redundancy: float
    alternatives: tuple[str, ...]

    def __str__(self) -> str:
        own = "; ".join(dict.fromkeys(self.label.where))
        alike = f", or in its place {' or '.join(self.alternatives[:3])}" if self.alternatives else ""
        return f"{self.label.name} ({self.size:.1f} px{'; ' if own else ''}{own}){alike}"


@dataclass(frozen=True)
class BlunderReport:
    """Report of a search for blunders in a block.

    Attributes
    ----------
    blunders : tuple of Blunder
        The largest first.
    measurements : int
        Number of measurements tested.
    unchecked : tuple of str
        Names of those that no others check: an error in them cannot be seen.
    redundancy : int
    precision : float
        Pixels: standard deviation of one coordinate of the others; NaN without redundancy.
    minimal_detectable : float
        Pixels: an error of a measurement that would be found in half of all cases, median over those that are checked.
    tilted : tuple of (str, float)
        Photos that do not follow the model, and by how many pixels at most; their points are not wrong for it.
    policy : str
        Which of `POLICIES` was followed.
    """

    blunders: tuple[Blunder, ...] = ()
    measurements: int = 0
    unchecked: tuple[str, ...] = ()
    redundancy: int = 0
    precision: float = float("nan")
    minimal_detectable: float = float("nan")
    tilted: tuple[tuple[str, float], ...] = ()
    policy: str = field(default="stop")

    def enforce(self, where: str, policy: str) -> None:
        """Error or warning that names the blunders.

        Parameters
        ----------
        where : str
            The tables, where the points' lines are not known.
        policy : str
            One of `POLICIES`.

        Raises
        ------
        InputError
            A blunder is gross and the policy is 'stop'.
        """
        if not self.blunders:
            return
        one = len(self.blunders) == 1
        what = (
            f"{len(self.blunders)} of {self.measurements} measurements contradict{'s' if one else ''} the others, "
            f"which agree within {self.precision:.2g} px (redundancy {self.redundancy}): "
            + listed(self.blunders, MOST_NAMED, "; ")
        )
        again = "measure it again" if one else "measure them again"
        if policy == "stop" and any(each.gross for each in self.blunders):
            hint = f"{again}, or go on without {'it' if one else 'them'}: `robust`; or with {'it' if one else 'them'}: "
            raise InputError(what, where=where, hint=f"{hint}`insist`")
        tail = ": left out" if policy == "leave" else f"; {again}, or leave {'it' if one else 'them'} out: `robust`"
        warn(f"{where}: {what}{tail}")


def report_of(
    shifts: MeanShifts, found: ShiftSearch, labels: Sequence[MeasurementLabel], *, bent: bool = False
) -> BlunderReport:
    """Report of what a search found, by name.

    Parameters
    ----------
    shifts : Shifts
    found : Search
    labels : sequence of Label
        Of the shifts.
    bent : bool
        Photos may be bent as no model says: control is then named only where the model fits all the rest, and where
        no other point would do in its place.
    """
    share = shifts.share
    spread = float(np.median(shifts.sigma))
    agree = found.scale * spread
    wrong = []
    for index, others in zip(found.included, found.alternatives, strict=True):
        size = float(np.hypot(*found.state.shifts[index])) / labels[index].pixel
        gross = size > max(GROSS * agree, GROSS_PIXELS)
        fits = found.scale < MISFIT
        # A photo that is bent leaves its corners, where the control is, and not its neighbours at a seam.
        if (fits and not others) if bent and labels[index].control else (gross or fits):
            names = tuple(labels[k].name for k in others)
            wrong.append(Blunder(labels[index], index, size, gross, float(share[index]), names))
    unknown = np.isnan(found.state.statistic)
    return BlunderReport(
        tuple(sorted(wrong, key=lambda each: -each.size)),
        len(shifts),
        tuple(label.name for label, nothing in zip(labels, unknown, strict=True) if nothing),
        found.state.redundancy,
        agree,
        minimal_detectable(shifts, found),
    )


def combined(parts: Sequence[BlunderReport]) -> BlunderReport:
    """Blunder report of a block from the reports of parts that were searched one by one.

    Parameters
    ----------
    parts : sequence of BlunderReport
        Reports of parts without common measurements, such as photos rectified singly.

    Returns
    -------
    BlunderReport
        Blunders of all parts, the largest first; sums of measurements and redundancy; the median of the precisions that
        are known; the largest of the minimal detectable blunders, since the weakest part limits what can be found.
    """
    agree = [part.precision for part in parts if np.isfinite(part.precision)]
    return BlunderReport(
        tuple(sorted((each for part in parts for each in part.blunders), key=lambda each: -each.size)),
        sum(part.measurements for part in parts),
        tuple(name for part in parts for name in part.unchecked),
        sum(part.redundancy for part in parts),
        float(np.median(agree)) if agree else float("nan"),
        max((part.minimal_detectable for part in parts if part.measurements), default=float("nan")),
        tuple(each for part in parts for each in part.tilted),
    )


# A point in a photo; None in place of the photo: its coordinates on the ground.
MeasurementKey = tuple[str, str | None]


def candidate_shifts(
    network: Network,
    sigmas: tuple[FloatArray, FloatArray],
    ids: Sequence[str],
    images: Sequence[str],
    lines: Sequence[str],
    unknown: str,
) -> tuple[MeanShifts, list[MeasurementLabel], list[MeasurementKey]]:
    """Shifts of a network: each measurement, and given coordinates that several photos see.

    Parameters
    ----------
    network : Network
        Of image positions and given coordinates, see `MeanShifts`.
    sigmas : tuple of array (N,) and array (S, 2)
        Standard deviations of image positions, pixels, and of given coordinates.
    ids : sequence of str (S,)
        Of the points.
    images, lines : sequence of str (N,)
        Photo of each measurement; file and line, or empty.
    unknown : str
        What points without given coordinates are called.
    """
    # Of a point in two photos whose place nobody gave, one measurement stands for both: nothing tells which is wrong.
    # Coordinates that one photo sees are not separable from its measurement.
    views, (sigma, given_sigma) = network.groups[0], sigmas
    by_point: dict[int, list[int]] = {}
    for view, point in enumerate(views.point.tolist()):
        by_point.setdefault(point, []).append(view)
    labels, keys, chosen = list[MeasurementLabel](), list[MeasurementKey](), list[int]()
    given = [p for p, seen in by_point.items() if np.isfinite(given_sigma[p]).all() and len(seen) > 1]
    for point, seen in by_point.items():
        is_control = bool(np.isfinite(given_sigma[point]).all())
        alone = len(seen) == 2 and not is_control
        for view in seen[:1] if alone else seen:
            shown = seen if alone else [view]
            where = tuple(images[v] for v in shown)
            name = f"{'control point' if is_control else unknown} '{ids[point]}' in {' and '.join(where)}"
            own = tuple(lines[v] for v in shown if lines[v])
            labels.append(MeasurementLabel(name, ids[point], where, own, 1.0, is_control))
            keys.append((ids[point], images[view]))
            chosen.append(view)
    for point in given:
        first = by_point[point][0]
        pixel = float(np.abs(np.linalg.det(views.by_point[first] * sigma[first])) ** -0.5)
        own = (lines[first],) if lines[first] else ()
        labels.append(
            MeasurementLabel(f"coordinates of control point '{ids[point]}'", ids[point], (), own, pixel, True)
        )
        keys.append((ids[point], None))
    shifts = MeanShifts(network, sigma, given_sigma, np.array(chosen, np.int64), np.array(given, np.int64))
    return shifts, labels, keys
