"""Findings on a fit to control points: blunders, distortion, large errors, better models, folds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomosaic.control.coordinate_diagnostics import Diagnostic, leave_out
from geomosaic.errors import InputError, listed
from geomosaic.geo.grid import Grid
from geomosaic.geo.transform import Transform
from geomosaic.georeferencing.blunder_check import GROSS, GROSS_PIXELS, BlunderCheck
from geomosaic.orientation.single.fit import ControlBlunders, ControlFit
from geomosaic.orientation.single.model_selection import Deletion, ModelChoice
from geomosaic.orientation.single.problem import image_by_map
from geomosaic.sensor.plugin import SensorModel
from geomosaic.types import FloatArray

# Share of the image's diagonal that the RMS error of an acceptable fit stays below.
LARGE_ERROR = 0.01
# Share of the leave-one-out error of the model asked for, below which a better model is recommended.
# Less of a gain may be chance with the usual 6 to 30 points.
BETTER = 0.67
SYNONYMS = {"poly1": "affine"}
# Codes of errors with which nothing can be drawn, even with `insist`.
FATAL = ("few-points", "collinear", "nowhere")
# Share of points with large residuals above which the model is at fault rather than the points.
# A robust estimate withstands less than half; above this share it may have taken the blunders for the good points.
MISFIT_SHARE = 0.4
# Probability of a blunder above which the work stops.
PROBABLE = 0.5
# Number of sample positions along each side of the output at which folds are tested.
STEPS = 33


class BadControlError(InputError):
    """Control points that would place the image wrongly; `diagnostics` has all findings."""

    def __init__(self, diagnostics: Sequence[Diagnostic], where: str, *, final: bool = False) -> None:
        errors = [found for found in diagnostics if found.severity == "error"]
        what = listed((f"{found.what} ({found.code})" for found in errors), 3, "; ")
        hints = "; ".join(dict.fromkeys(found.hint for found in errors[:3]))
        if not final:
            hints += "; or `insist`, to draw it all the same"
        super().__init__(what, where=where, hint=hints)
        self.diagnostics = tuple(diagnostics)


def stop_on_errors(diagnostics: Sequence[Diagnostic], where: str, *, insist: bool, possible: bool = True) -> None:
    """Error for findings of severity 'error'; with `insist` only for those with which nothing can be drawn.

    Parameters
    ----------
    diagnostics : sequence of Diagnostic
    where : str
        File of the control, for the message.
    insist : bool
        Tolerate errors.
    possible : bool
        Whether all coordinates are valid positions on the Earth.

    Raises
    ------
    BadControlError
        There are such findings.
    """
    errors = [found for found in diagnostics if found.severity == "error"]
    final = not possible or any(found.code in FATAL for found in errors)
    if errors and (final or not insist):
        raise BadControlError(diagnostics, where, final=final)


def blunder_diagnostics(search: ControlBlunders, searched: Sequence[str], fit: ControlFit) -> list[Diagnostic]:
    """Findings on blunders of the search that take part in the fit ('blunder', 'suspect', or 'misfit').

    Parameters
    ----------
    search : ControlBlunders
    searched : sequence of str
        Names of the points that were searched.
    fit : ControlFit
        The fit to be drawn.
    """
    names = tuple(name for name in fit.ids if name in set(search.blunders))
    alone = tuple(n for n in fit.ids if n in set(search.suspected) - {*search.blunders, *search.distorted})
    typical = search.estimate.fit.rms_total
    if len(names) + len(alone) > MISFIT_SHARE * len(fit.ids):
        what = f"{len(names) + len(alone)} of {len(fit.ids)} points stand out against the rest, which agrees within "
        hint = "choose a fit of more parameters, or look for wrong points among them: see the control report"
        return [Diagnostic("misfit", "warning", f"{what}{typical:.2f} px: the fit does not suit them all", (), hint)]
    found = []
    if names:
        lengths = dict(zip(searched, np.hypot(*search.estimate.residuals.T).tolist(), strict=True))
        gross = any(lengths[name] > max(GROSS * typical, GROSS_PIXELS) for name in names)
        worst = listed(f"{name} ({lengths[name]:.1f} px)" for name in names)
        what = (
            f"{len(names)} of {len(fit.ids)} points contradict{'s' * (len(names) == 1)} the others, which agree within "
            f"{typical:.2f} px: {worst}"
        )
        found.append(Diagnostic("blunder", "error" if gross else "warning", what, names, _remedy(names)))
    if alone:
        what = f"only one of two tests finds these points wrong: {listed(alone)}"
        found.append(Diagnostic("suspect", "warning", what, alone, "look at these points again"))
    return found


def distortion_diagnostics(search: ControlBlunders, fit: ControlFit, model: str) -> list[Diagnostic]:
    """Finding 'bent': points with large residuals that a smooth distortion of the image explains.

    Parameters
    ----------
    search : ControlBlunders
    fit : ControlFit
    model : str
        Name of the fit.
    """
    bent = [name for name in search.distorted if name in fit.ids]
    if not bent:
        return []
    lengths = dict(zip(fit.ids, np.hypot(*fit.residuals.T).tolist(), strict=True))
    worst = listed(f"{name} ({lengths[name]:.1f} px)" for name in sorted(bent, key=lambda name: -lengths[name]))
    what = f"{model} misses {len(bent)} of {len(fit.ids)} points more than the others, but a smooth bend of the image "
    what += f"explains {'them' if len(bent) > 1 else 'it'}: {worst}"
    hint = "more points around them, which tell a bend from a blunder; `model=tps` follows a bend"
    return [Diagnostic("bent", "warning", what, tuple(bent), hint)]


def checked_blunder_diagnostics(check: BlunderCheck, fit: ControlFit, named: Sequence[str]) -> list[Diagnostic]:
    """Findings on blunders of the check without a model: points of the fit that are wrong, or probably are.

    Parameters
    ----------
    check : BlunderCheck
    fit : ControlFit
    named : sequence of str
        Points that other findings name.
    """
    unnamed = set(fit.ids) - set(named)
    names = tuple(name for name in check.blunders if name in unnamed)
    if names:
        worst = listed(f"{name} ({check.lengths[name]:.1f} px)" for name in names)
        what = (
            f"{len(names)} of {len(fit.ids)} points contradict{'s' * (len(names) == 1)} the others, which agree within "
            f"{check.rms:.2f} px: {worst}, {check.basis}"
        )
        severity = "error" if any(check.gross(name) for name in names) else "warning"
        return [Diagnostic("blunder", severity, what, names, _remedy(names))]
    names = tuple(name for name in check.suspicious if name in unnamed)
    if not names:
        return []
    who = f"{listed(names)} {'is' if len(names) == 1 else 'are'}"
    what = f"with a probability of {check.fault:.0%} {who} wrong, else the image is bent: {len(fit.ids)} points are "
    what += "too few to be sure"
    gross = check.fault > PROBABLE and any(check.gross(name) for name in names)
    hint = f"measure again, and more points; or leave out what is known to be wrong: `without={names[0]}`"
    return [Diagnostic("contradiction", "error" if gross else "warning", what, names, hint)]


def _remedy(names: Sequence[str]) -> str:
    """Hint on what to do about blunders."""
    return f"measure again, or leave out: {leave_out(names[:6])}, or `robust` for all of them"


def deletion_diagnostics(deletion: Deletion | None) -> list[Diagnostic]:
    """Finding that point deletion did not reach its threshold.

    Parameters
    ----------
    deletion : Deletion or None
    """
    if deletion is None or deletion.reached:
        return []
    hint = "a larger threshold, or a fit of more parameters; look at the leave-one-out error, which deletion may worsen"
    return [Diagnostic("threshold-not-reached", "warning", deletion.summary, (), hint)]


def outlier_diagnostics(choice: ModelChoice | None, fit: ControlFit, named: Sequence[str]) -> list[Diagnostic]:
    """Finding on points of the fit, not named already, that no model predicts.

    Parameters
    ----------
    choice : ModelChoice or None
    fit : ControlFit
    named : sequence of str
        Points that other findings name.
    """
    outliers = (
        () if choice is None else tuple(name for name in choice.outliers if name in fit.ids and name not in named)
    )
    if not outliers:
        return []
    what = f"{len(outliers)} of {len(fit.ids)} points fit{'s' * (len(outliers) == 1)} no kind of transformation"
    errors = np.hypot(*fit.leave_one_out.T)
    gross = any(errors[fit.ids.index(name)] > GROSS_PIXELS for name in outliers)
    return [
        Diagnostic(
            "blunder", "error" if gross else "warning", f"{what}: {listed(outliers)}", outliers, _remedy(outliers)
        )
    ]


def large_error_diagnostics(fit: ControlFit, size: tuple[int, int]) -> list[Diagnostic]:
    """Finding that errors are large for an image of that size (width, height in pixels).

    Parameters
    ----------
    fit : ControlFit
    size : tuple of int
        Width and height of the image, pixels.
    """
    left_out = np.hypot(*fit.leave_one_out.T)
    # Residuals of few points are smaller than the errors of the fit: sigma 0 allows for the redundancy. A spline has
    # no residuals, and corners have large leave-one-out errors under it: 1.2 times the median length is the RMS length
    # of normal errors without them.
    if fit.redundancy:
        own = max(fit.rms_total, fit.sigma0 * float(np.sqrt(2.0) * np.median(fit.sigma)))
    else:
        own = 1.2 * float(np.nanmedian(left_out)) if np.isfinite(left_out).any() else np.nan
    error = max((e for e in (own, fit.leave_one_out_rms) if np.isfinite(e)), default=0.0)
    limit = LARGE_ERROR * float(np.hypot(*size))
    if error <= limit:
        return []
    severity = "warning" if own <= limit else "error"
    what = f"points are missed by {error:.1f} px (RMS) in an image of {size[0]} x {size[1]} pixels"
    lengths = np.hypot(*(fit.leave_one_out if np.isfinite(fit.leave_one_out).any() else fit.residuals).T)
    worst = tuple(fit.ids[i] for i in np.argsort(-np.nan_to_num(lengths), kind="stable")[:3])
    what += f", most of all {', '.join(worst)}"
    hint = "look for wrong or exchanged points, give more of them, or choose a fit of more parameters"
    hint += "; `model=projective` for an oblique photo"
    return [Diagnostic("large-errors", severity, what, (), hint)]


def comparison_diagnostics(choice: ModelChoice | None, model: str) -> list[Diagnostic]:
    """Finding that another model has a much smaller leave-one-out error than the one asked for.

    Parameters
    ----------
    choice : ModelChoice or None
    model : str
        Name of the fit.
    """
    rows = {} if choice is None else {row.name: row.leave_one_out for row in choice.table}
    if (
        choice is None
        or choice.name == model
        or not rows[choice.name] < BETTER * rows.get(SYNONYMS.get(model, model), 0.0)
    ):
        return []
    own = rows[SYNONYMS.get(model, model)]
    what = (
        f"{choice.name} predicts points left out of the fit within {rows[choice.name]:.2f} px, {model} within {own:.2f}"
    )
    free = {row.name: row.parameters for row in choice.table}
    if free[choice.name] < free[SYNONYMS.get(model, model)]:
        hint = f"`model={choice.name}`: {model} follows the errors of the points, and deviates between them"
    else:
        hint = f"`model={choice.name}`, if the image is bent so; or look for points that {model} does not suit"
    return [Diagnostic("poor-fit", "warning", what, (), hint)]


def fold_diagnostics(model: SensorModel, points: FloatArray, grid: Grid) -> list[Diagnostic]:
    """Finding that the model folds: parts of the image would be drawn twice or mirrored.

    Parameters
    ----------
    model : SensorModel
    points : array (N, 3)
        Control points, x, y, z in `model.crs`: there the sign is taken to be right.
    grid : Grid
        Grid of the output.
    """
    # A fold shows as a change of sign of the Jacobian determinant of the map-to-image transformation.
    c, r = np.meshgrid(np.linspace(0, grid.width, STEPS), np.linspace(0, grid.height, STEPS))
    xy = Transform(grid.crs, model.crs)(grid.xy(np.column_stack([c.ravel(), r.ravel()])))
    places = np.column_stack([xy, np.zeros(len(xy))])
    colrow = model.ground_to_image(places)
    inside = np.isfinite(colrow).all(axis=1) & (colrow >= 0).all(axis=1) & (colrow <= model.size).all(axis=1)
    if not inside.any():
        return []
    here = np.linalg.det(image_by_map(model, places[inside]))
    side = float(np.nanmedian(np.sign(np.linalg.det(image_by_map(model, points)))))
    share = float(np.mean(here * side <= 0.0))
    if share == 0.0:
        return []
    much = f"{share:.0%}" if share >= 0.01 else "less than 1%"
    what = f"the fit folds the image over: in {much} of the output it runs backwards"
    hint = "measure points there, or choose a fit of fewer parameters"
    return [Diagnostic("folded", "error", what, (), hint)]
