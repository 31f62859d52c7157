"""Independent check of blunders that does not rest on the model asked for or chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.control.distribution import needed
from geomosaic.control.findings import listed
from geomosaic.control.points import ControlPoints
from geomosaic.estimation.blunders.hypotheses import FEWEST, MOST, Hypotheses, weigh_hypotheses
from geomosaic.estimation.blunders.neighbour_tests import NeighbourSearch, explained_by_distortion, search_neighbours
from geomosaic.orientation.single.fit import ControlBlunders
from geomosaic.orientation.single.model_selection import ModelChoice

GROSS, GROSS_PIXELS = 6.0, 5.0
"""A blunder is gross from so many times the RMS of the others on, and so many pixels: it would be seen."""
SEEN = 1.5
"""Pixels below which no blunder is named: a hand misses by as much."""
COMPARABLE = 2.0
"""Times the least leave-one-out error, up to which a kind of fit is a witness."""
BENT = ("poly3", "poly4", "poly5", "tps")
"""Kinds that are chosen only where the image is bent."""
ROOM = 3
"""Times the points a polynomial needs, from which on its own residuals show blunders."""


@dataclass(frozen=True, eq=False)
class Opinion:
    """What was found.

    Attributes
    ----------
    blunders : tuple of str
    suspicious : tuple of str
        Points of which some may be wrong, where points are too few to be sure.
    fault : float
        Probability that any is wrong.
    lengths : mapping of str to float
        Errors of all points against what the good ones say, pixels.
    rms : float
        Of the good ones.
    basis : str
        What the points were held against.
    said : str
        In a sentence.
    """

    blunders: tuple[str, ...]
    suspicious: tuple[str, ...]
    fault: float
    lengths: Mapping[str, float]
    rms: float
    basis: str
    said: str

    def gross(self, name: str) -> bool:
        """Whether the error of a point would be seen."""
        return self.lengths[name] > max(GROSS * self.rms, GROSS_PIXELS)


def second_opinion(points: ControlPoints, model: str) -> Opinion | None:
    """Hold few points against every kind of fit, more against their neighbours.

    None where that says nothing more than the residuals of the model do, or where points are too few for any.
    """
    count = len(points)
    if count < FEWEST:
        return None
    if count <= MOST:
        return _of_few(weigh_hypotheses(points.names, points.xy, points.colrow, points.sigma))
    if model in ("auto", "tps") or (model.startswith("poly") and count < ROOM * needed(model)):
        return _of_many(search_neighbours(points.names, points.xy, points.colrow))
    return None


def _of_few(found: Hypotheses) -> Opinion:
    lengths = dict(zip(found.ids, np.hypot(*found.errors.T).tolist(), strict=True))
    names = tuple(name for name in found.blunders if lengths[name] > SEEN)
    said = "every kind of fit tried with every choice of good points: "
    if names:
        verb = "is" if len(names) == 1 else "are"
        said += f"most probably {', '.join(names)} {verb} wrong, under the {found.kind} fit"
    elif found.suspicious:
        said += f"with a probability of {found.fault:.0%} some are wrong, of {', '.join(found.suspicious)}"
    else:
        said += "no blunder"
    basis = f"under the {found.kind} fit of the others"
    return Opinion(names, found.suspicious, found.fault, lengths, found.rms, basis, said)


def _of_many(found: NeighbourSearch) -> Opinion:
    lengths = dict(zip(found.ids, np.hypot(*found.errors.T).tolist(), strict=True))
    # An image that bends sharply somewhere has smaller ones that are none.
    limit = max(GROSS * found.rms, GROSS_PIXELS)
    names = tuple(name for name in found.blunders if lengths[name] > limit)
    said = NeighbourSearch(found.ids, names, found.errors, found.rms).said
    return Opinion(names, (), float(bool(names)), lengths, found.rms, "against their neighbours", said)


def confirmed(
    opinion: Opinion, points: ControlPoints, choice: ModelChoice | None, everyone: ModelChoice | None
) -> Opinion:
    """Keep those blunders that no good kind of fit to the other points predicts.

    A corner, which neighbours only extrapolate, may be where a polynomial has it.

    Parameters
    ----------
    opinion : Opinion
    points : ControlPoints
        All of them.
    choice : Choice, optional
        Made without the blunders.
    everyone : Choice, optional
        Made with all: each kind says of a point what the others do, the other blunders among them.
    """
    if not opinion.blunders:
        return opinion
    accused = np.array([name in opinion.blunders for name in points.names])
    held = points.select(accused)
    xyz = np.column_stack([held.xy, np.zeros(len(held))])
    wrong = np.ones(len(held), dtype=np.bool_)
    rows = [] if choice is None else [row for row in choice.table if np.isfinite(row.leave_one_out)]
    least = min((row.leave_one_out for row in rows), default=0.0)
    for row in rows:
        if row.fit is not None and row.leave_one_out <= COMPARABLE * least:
            errors = np.hypot(*(held.colrow - row.fit.model.ground_to_image(xyz)).T)
            wrong &= ~(errors <= max(GROSS * row.leave_one_out, GROSS_PIXELS))
    for row in () if everyone is None else everyone.table:
        if row.fit is not None and row.redundancy > 0:
            errors = np.hypot(*row.fit.leave_one_out[accused].T)
            wrong &= ~(errors <= max(GROSS * opinion.rms, GROSS_PIXELS))
    if choice is not None and choice.name in BENT:
        wrong &= ~explained_by_distortion(points.xy, points.colrow, accused)[accused]
    names = tuple(name for name, bad in zip(held.names, wrong, strict=True) if bad)
    if names == opinion.blunders:
        return opinion
    pardoned = ", ".join(name for name in opinion.blunders if name not in names)
    said = f"{opinion.said}; but another kind of fit, or a smooth bend, predicts {pardoned}"
    return replace(opinion, blunders=names, said=said)


def pardoned(search: ControlBlunders, points: ControlPoints, model: str) -> ControlBlunders:
    """Take those out of what was found under a kind of fit that a smooth bend of the image explains.

    Parameters
    ----------
    search : ControlBlunders
    points : ControlPoints
        All of them.
    model : str
        That suits the points best: of an image that is not bent none is pardoned.
    """
    accused = np.array([name in search.suspected for name in points.names])
    if model not in BENT or not accused.any():
        return search
    agree = explained_by_distortion(points.xy, points.colrow, accused)
    bent = tuple(name for name, good in zip(points.names, agree, strict=True) if good)
    if not bent:
        return search
    left = tuple(name for name in search.blunders if name not in bent)
    return replace(search, blunders=left, distorted=bent, said=f"{search.said}; a smooth bend explains {listed(bent)}")


def unbent(choice: ModelChoice, points: ControlPoints) -> ModelChoice:
    """Take those out of what no kind of fit predicts that a smooth bend of the image explains.

    Parameters
    ----------
    choice : Choice
    points : ControlPoints
        It was made with.
    """
    odd = np.array([name in choice.outliers for name in points.names])
    if choice.name not in BENT or not odd.any():
        return choice
    odd &= ~explained_by_distortion(points.xy, points.colrow, odd)
    return replace(choice, outliers=tuple(name for name, out in zip(points.names, odd, strict=True) if out))
