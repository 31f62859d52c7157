"""Blunder check of control points that does not rest on the model asked for or chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.control.diagnostics import points_needed
from geomosaic.control.points import ControlPoints
from geomosaic.errors import listed
from geomosaic.estimation.blunders.hypotheses import FEWEST, MOST, Hypotheses, weigh_hypotheses
from geomosaic.estimation.blunders.neighbour_tests import NeighbourSearch, explained_by_distortion, search_neighbours
from geomosaic.orientation.single.fit import ControlBlunders
from geomosaic.orientation.single.model_selection import DISTORTED_MODELS, ModelChoice

# Multiple of the others' RMS, and pixels, both of which the error of a gross blunder exceeds.
# Six times the RMS is beyond any normal error; below five pixels nobody would see it in the output.
GROSS, GROSS_PIXELS = 6.0, 5.0
# Error in pixels below which no point is named: pointing by hand is off by as much.
SMALLEST_BLUNDER = 1.5
# Multiple of the least leave-one-out error up to which a model may acquit a point.
COMPARABLE = 2.0
# Multiple of the points that a polynomial needs, from which on its own residuals show blunders.
REDUNDANT = 3


@dataclass(frozen=True, eq=False)
class BlunderCheck:
    """Blunders found without the model asked for or chosen.

    Attributes
    ----------
    blunders : tuple of str
        Names of the points.
    suspicious : tuple of str
        Points of which some may be blunders, where there are too few points to be sure.
    fault : float
        Probability that there is any blunder, 0 to 1.
    lengths : mapping of str to float
        Length of the error of each point against the good ones, pixels.
    rms : float
        RMS of these lengths over the good points, pixels.
    basis : str
        What the points were compared with, as a phrase for messages.
    summary : str
        Result in a sentence.
    """

    blunders: tuple[str, ...]
    suspicious: tuple[str, ...]
    fault: float
    lengths: Mapping[str, float]
    rms: float
    basis: str
    summary: str

    def gross(self, name: str) -> bool:
        """Whether the error of a point would be visible in the output."""
        return self.lengths[name] > max(GROSS * self.rms, GROSS_PIXELS)


def check_blunders(points: ControlPoints, model: str) -> BlunderCheck | None:
    """Blunders among the points: few points are compared with every model, more with their neighbours.

    Parameters
    ----------
    points : ControlPoints
        Enabled control points, x and y in the CRS of the fit.
    model : str
        Model asked for, one of `request.MODELS` or 'auto'.

    Returns
    -------
    BlunderCheck or None
        None where it would tell no more than the residuals of the model, or where points are too few.
    """
    count = len(points)
    if count < FEWEST:
        return None
    if count <= MOST:
        return _check_by_hypotheses(weigh_hypotheses(points.names, points.xy, points.colrow, points.sigma))
    if model in ("auto", "tps") or (model.startswith("poly") and count < REDUNDANT * points_needed(model)):
        return _check_by_neighbours(search_neighbours(points.names, points.xy, points.colrow))
    return None


def _check_by_hypotheses(found: Hypotheses) -> BlunderCheck:
    lengths = dict(zip(found.ids, np.hypot(*found.errors.T).tolist(), strict=True))
    visible = {name for name, length in lengths.items() if length > SMALLEST_BLUNDER}
    names = tuple(name for name in found.blunders if name in visible)
    suspicious = tuple(name for name in found.suspicious if name in visible)
    summary = "every kind of fit tried with every choice of good points: "
    if names:
        verb = "is" if len(names) == 1 else "are"
        summary += f"most probably {', '.join(names)} {verb} wrong, under the {found.kind} fit"
    elif suspicious:
        summary += f"with a probability of {found.fault:.0%} some are wrong, of {', '.join(suspicious)}"
    else:
        summary += "no blunder"
    basis = f"under the {found.kind} fit of the others"
    return BlunderCheck(names, suspicious, found.fault, lengths, found.rms, basis, summary)


def _check_by_neighbours(found: NeighbourSearch) -> BlunderCheck:
    lengths = dict(zip(found.ids, np.hypot(*found.errors.T).tolist(), strict=True))
    # Where an image is sharply distorted, good points contradict their neighbours too, though by less than this.
    limit = max(GROSS * found.rms, GROSS_PIXELS)
    names = tuple(name for name in found.blunders if lengths[name] > limit)
    summary = NeighbourSearch(found.ids, names, found.errors, found.rms).summary
    return BlunderCheck(names, (), float(bool(names)), lengths, found.rms, "against their neighbours", summary)


def confirm_blunders(
    check: BlunderCheck, points: ControlPoints, choice: ModelChoice | None, everyone: ModelChoice | None
) -> BlunderCheck:
    """Blunder check without the points that a good model of the other points predicts.

    Neighbours only extrapolate to a point in a corner, while a polynomial may predict it well.

    Parameters
    ----------
    check : BlunderCheck
    points : ControlPoints
        All of them.
    choice : ModelChoice, optional
        Comparison of models without the blunders.
    everyone : ModelChoice, optional
        Comparison with all points: its leave-one-out errors let the other accused points support one another.
    """
    if not check.blunders:
        return check
    accused = np.array([name in check.blunders for name in points.names])
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
            wrong &= ~(errors <= max(GROSS * check.rms, GROSS_PIXELS))
    if choice is not None and choice.name in DISTORTED_MODELS:
        wrong &= ~explained_by_distortion(points.xy, points.colrow, accused)[accused]
    names = tuple(name for name, bad in zip(held.names, wrong, strict=True) if bad)
    if names == check.blunders:
        return check
    acquitted = ", ".join(name for name in check.blunders if name not in names)
    summary = f"{check.summary}; but another kind of fit, or a smooth bend, predicts {acquitted}"
    return replace(check, blunders=names, summary=summary)


def exclude_distortion(search: ControlBlunders, points: ControlPoints, model: str) -> ControlBlunders:
    """Blunder search without the points that a smooth distortion of the image explains.

    Parameters
    ----------
    search : ControlBlunders
    points : ControlPoints
        All of them.
    model : str
        Best model of the points; unless it is one of `DISTORTED_MODELS`, the search stays as it is.
    """
    accused = np.array([name in search.suspected for name in points.names])
    if model not in DISTORTED_MODELS or not accused.any():
        return search
    agree = explained_by_distortion(points.xy, points.colrow, accused)
    distorted = tuple(name for name, good in zip(points.names, agree, strict=True) if good)
    if not distorted:
        return search
    rest = tuple(name for name in search.blunders if name not in distorted)
    return replace(
        search,
        blunders=rest,
        distorted=distorted,
        summary=f"{search.summary}; a smooth bend explains {listed(distorted)}",
    )


def exclude_distorted_outliers(choice: ModelChoice, points: ControlPoints) -> ModelChoice:
    """Model choice whose outliers are none that a smooth distortion of the image explains.

    Parameters
    ----------
    choice : ModelChoice
    points : ControlPoints
        The points that it was made with.
    """
    odd = np.array([name in choice.outliers for name in points.names])
    if choice.name not in DISTORTED_MODELS or not odd.any():
        return choice
    odd &= ~explained_by_distortion(points.xy, points.colrow, odd)
    return replace(choice, outliers=tuple(name for name, out in zip(points.names, odd, strict=True) if out))
