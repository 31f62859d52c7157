"""Blunders of a block by name: size, place, what may be wrong in their stead, and what is done about them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.estimation.blunders.mean_shift import Shifts
from geomosaic.estimation.blunders.mean_shift_search import Search, detectable
from geomosaic.estimation.linear_network import Network

GROSS, GROSS_PIXELS = 6.0, 5.0
"""A blunder is gross from so many standard deviations of the others on, and so many pixels: it would be seen."""
MISFIT = 1.5
"""Standard deviation of unit weight from which on small contradictions may be the model's: only gross ones count."""
NAMED = 6
"""Points named in one message."""
POLICIES = ("stop", "leave", "keep")
"""What is done with blunders: stop where one is gross, leave all of them out, or go on with them."""


@dataclass(frozen=True)
class Label:
    """What one shift of a network belongs to.

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
class Wrong:
    """A measurement that contradicts the others.

    Attributes
    ----------
    label : Label
    shift : int
        Its number in the network.
    size : float
        By how much, pixels.
    gross : bool
    redundancy : float
        How much of it others check, 0 to 1.
    alike : tuple of str
        Names of others that may be wrong in its place: the redundancy does not tell which.
    """

    label: Label
    shift: int
    size: float
    gross: bool
    redundancy: float
    alike: tuple[str, ...]

    def __str__(self) -> str:
        own = "; ".join(dict.fromkeys(self.label.where))
        alike = f", or in its place {' or '.join(self.alike[:3])}" if self.alike else ""
        return f"{self.label.name} ({self.size:.1f} px{'; ' if own else ''}{own}){alike}"


@dataclass(frozen=True)
class Findings:
    """What the search says of a block.

    Attributes
    ----------
    wrong : tuple of Wrong
        The worst first.
    measurements : int
        That were looked at.
    unchecked : tuple of str
        Names of those that no others check: an error in them cannot be seen.
    redundancy : int
    agree : float
        Pixels: standard deviation of one coordinate of the others; NaN without redundancy.
    detectable : float
        Pixels: an error of a measurement that would be found in half of all cases, median over those that are checked.
    tilted : tuple of (str, float)
        Photos that do not follow the model, and by how many pixels at most; their points are not wrong for it.
    done : str
        Which of `POLICIES` was followed.
    """

    wrong: tuple[Wrong, ...] = ()
    measurements: int = 0
    unchecked: tuple[str, ...] = ()
    redundancy: int = 0
    agree: float = float("nan")
    detectable: float = float("nan")
    tilted: tuple[tuple[str, float], ...] = ()
    done: str = field(default="stop")

    def settle(self, where: str, policy: str) -> None:
        """Stop, or tell.

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
        if not self.wrong:
            return
        named = "; ".join(map(str, self.wrong[:NAMED]))
        more = f"; and {len(self.wrong) - NAMED} more" if len(self.wrong) > NAMED else ""
        one = len(self.wrong) == 1
        what = (
            f"{len(self.wrong)} of {self.measurements} measurements contradict{'s' if one else ''} the others, which "
            f"agree within {self.agree:.2g} px (redundancy {self.redundancy}): {named}{more}"
        )
        again = "measure it again" if one else "measure them again"
        if policy == "stop" and any(each.gross for each in self.wrong):
            hint = f"{again}, or go on without {'it' if one else 'them'}: --robust; or with {'it' if one else 'them'}: "
            raise InputError(what, where=where, hint=f"{hint}--insist (in a project: robust or insist under [planar])")
        tail = ": left out" if policy == "leave" else f"; {again}, or leave {'it' if one else 'them'} out: --robust"
        warnings.warn(f"{where}: {what}{tail}", GeomosaicWarning, stacklevel=3)


def findings(shifts: Shifts, found: Search, labels: Sequence[Label], *, bent: bool = False) -> Findings:
    """Name what a search found.

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
    spread = float(np.median(shifts.network.sigma))
    agree = found.scale * spread
    wrong = []
    for index, alike in zip(found.taken, found.alike, strict=True):
        size = float(np.hypot(*found.state.shifts[index])) / labels[index].pixel
        gross = size > max(GROSS * agree, GROSS_PIXELS)
        fits = found.scale < MISFIT
        # A photo that is bent leaves its corners, where the control is, and not its neighbours at a seam.
        if (fits and not alike) if bent and labels[index].control else (gross or fits):
            names = tuple(labels[k].name for k in alike)
            wrong.append(Wrong(labels[index], index, size, gross, float(share[index]), names))
    unknown = np.isnan(found.state.statistic)
    return Findings(
        tuple(sorted(wrong, key=lambda each: -each.size)),
        len(shifts),
        tuple(label.name for label, nothing in zip(labels, unknown, strict=True) if nothing),
        found.state.redundancy,
        agree,
        detectable(shifts, found),
    )


def together(parts: Sequence[Findings]) -> Findings:
    """Findings of blocks that were looked at one by one."""
    agree = [part.agree for part in parts if np.isfinite(part.agree)]
    return Findings(
        tuple(sorted((each for part in parts for each in part.wrong), key=lambda each: -each.size)),
        sum(part.measurements for part in parts),
        tuple(name for part in parts for name in part.unchecked),
        sum(part.redundancy for part in parts),
        float(np.median(agree)) if agree else float("nan"),
        max((part.detectable for part in parts if part.measurements), default=float("nan")),
        tuple(each for part in parts for each in part.tilted),
    )


Doubt = tuple[str, str | None]
"""A point in a photo; None in place of the photo: its coordinates on the ground."""


def named(
    network: Network, ids: Sequence[str], images: Sequence[str], lines: Sequence[str], unknown: str
) -> tuple[Shifts, list[Label], list[Doubt]]:
    """Shifts of a network: each measurement, and given coordinates that several photos see.

    Of a point in two photos whose place nobody gave, one measurement stands for both: nothing tells which is wrong.
    Coordinates that one photo sees are not told from its measurement.

    Parameters
    ----------
    network : Network
    ids : sequence of str (S,)
        Of the points.
    images, lines : sequence of str (N,)
        Photo of each measurement; file and line, or empty.
    unknown : str
        What points without given coordinates are called.
    """
    by_point: dict[int, list[int]] = {}
    for view, point in enumerate(network.point.tolist()):
        by_point.setdefault(point, []).append(view)
    labels, doubts, chosen = list[Label](), list[Doubt](), list[int]()
    given = [p for p, seen in by_point.items() if np.isfinite(network.given_sigma[p]) and len(seen) > 1]
    for point, seen in by_point.items():
        is_control = bool(np.isfinite(network.given_sigma[point]))
        alone = len(seen) == 2 and not is_control
        for view in seen[:1] if alone else seen:
            shown = seen if alone else [view]
            where = tuple(images[v] for v in shown)
            name = f"{'control point' if is_control else unknown} '{ids[point]}' in {' and '.join(where)}"
            own = tuple(lines[v] for v in shown if lines[v])
            labels.append(Label(name, ids[point], where, own, 1.0, is_control))
            doubts.append((ids[point], images[view]))
            chosen.append(view)
    for point in given:
        first = by_point[point][0]
        pixel = float(np.abs(np.linalg.det(network.by_point[first])) ** -0.5)
        own = (lines[first],) if lines[first] else ()
        labels.append(Label(f"coordinates of control point '{ids[point]}'", ids[point], (), own, pixel, True))
        doubts.append((ids[point], None))
    return Shifts(network, np.array(chosen, dtype=np.int64), np.array(given, dtype=np.int64)), labels, doubts
