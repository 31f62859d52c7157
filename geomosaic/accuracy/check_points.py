"""Accuracy at control and check points: of a finished raster, and of oriented images, with verdicts on limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.block import OrientedBlock
from geomosaic.control.coordinate_diagnostics import Diagnostic, has_valid_positions, leave_out
from geomosaic.control.diagnostics import diagnose
from geomosaic.errors import InputError, QualityError, counted, listed
from geomosaic.geo.crs import horizontal, parse_map
from geomosaic.geo.grid import Grid
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import short_unit
from geomosaic.options.inputs import QualityLimits
from geomosaic.raster.info import SourceInfo, inspect
from geomosaic.sensor.corrected import left_out
from geomosaic.types import FloatArray

if TYPE_CHECKING:
    from geomosaic.control.points import ControlPoints
    from geomosaic.options.control import CheckOptions
    from geomosaic.orientation.single.check_points import CheckStatistics
    from geomosaic.planning.product_quality import Requirement


def check_diagnostics(
    names: Sequence[str], pixels: FloatArray, moved: FloatArray, unit: str, expected: float = 0.0
) -> list[Diagnostic]:
    """Findings on check points that contradict the others, or the fit where too few are left to contradict each other.

    Parameters
    ----------
    names : sequence of str
    pixels : array (N, 2)
        Errors in the image or raster, pixels.
    moved : array (N, 2)
        The same on the map, found minus true, in `unit`.
    unit : str
    expected : float
        RMS length of errors that the fit leads one to expect, pixels; 0 where there is none.

    Returns
    -------
    list of Diagnostic
        One finding that names all outliers, largest error first; empty where there are none, or an error is not finite.
    """
    if not np.isfinite(pixels).all() or not len(pixels):
        return []
    from geomosaic.orientation.single.check_points import check_point_outliers

    expected = expected if np.isfinite(expected) else 0.0
    found = check_point_outliers(pixels, expected)
    chosen = np.flatnonzero(found.outliers)
    if not len(chosen):
        return []
    chosen = chosen[np.argsort(-np.hypot(*pixels[chosen].T), kind="stable")]
    order = chosen.tolist()
    wrong = tuple(names[i] for i in order)
    shown = listed(
        (
            f"{names[i]} by {np.hypot(*pixels[i]):.1f} px ({np.hypot(*moved[i]):.3g} {unit}: "
            f"x {moved[i, 0]:+.3g}, y {moved[i, 1]:+.3g})"
            for i in order
        ),
        between="; ",
    )
    who = f"{len(wrong)} of {len(names)} check points" if len(names) > 1 else "the check point"
    what = f"{who} {'is' if len(wrong) == 1 else 'are'} off: {shown}"
    rest = moved[~found.outliers]
    if len(rest) >= 2:
        x, y = rest.mean(axis=0)
        what += f", where the others agree: RMS {found.rms:.2f} px without, mean shift x {x:+.3g}, y {y:+.3g} {unit}"
    else:
        what += f", where the control leads one to expect {expected:.2f} px (leave-one-out)"
    hint = (
        "look whether their coordinates and their places in the image are right; if not, correct them or leave them "
        f"out: {leave_out(wrong[:6])}"
    )
    return [Diagnostic("check-point", "warning", what, wrong, hint)]


# Pixels of RMS error from which on the points are probably not measured in this raster.
FAR = 20.0
# Findings that concern check points; those on how control lies in the image do not.
EXAMINED = ("degrees-in-metres", "metres-in-degrees", "wrong-unit", "wrong-zone", "outside-crs-area", "outside-image")


LIMIT = "limit"
"""Source of a requirement that is a limit given by itself, not one of a plan."""


@dataclass(frozen=True)
class Verdict:
    """Verdict on one requirement: the value that the map has, and whether that meets it.

    Attributes
    ----------
    requirement : Requirement
    value : float
        In the requirement's unit.
    passed : bool
    """

    requirement: Requirement
    value: float
    passed: bool

    @property
    def text(self) -> str:
        """Verdict in one line of text."""
        r = self.requirement
        if r.source == LIMIT:
            return f"{r.text} {self.value:.4g} {r.unit}, limit {r.most:g} {r.unit}"
        least = None if r.least is None else f">= {r.least:g}"
        limits = " and ".join(part for part in (least, None if r.most is None else f"<= {r.most:g}") if part)
        return f"{r.text}: {self.value:.4g} {r.unit}, target {limits} {r.unit}: {'met' if self.passed else 'MISSED'}"


@dataclass(frozen=True, eq=False)
class MapCheck:
    """Errors of a raster at its check points.

    Attributes
    ----------
    raster, points : Path
    grid : Grid
        Of the raster.
    ids : tuple of str
    measured : array (N, 2)
        col, row in the raster, pixels.
    true : array (N, 2)
        x, y in the CRS of the raster.
    pixel_errors : array (N, 2)
        Measured minus true place, col and row, pixels.
    statistics : CheckStatistics
        Of the errors in x and y, map units, measured minus true.
    pixel_rms : tuple of float
        RMS in col and row, pixels.
    pixel_rms_total : float
        RMS length, pixels.
    notes : tuple of str
    diagnostics : tuple of Diagnostic
    verdicts : tuple of Verdict
        On the limits that were given, and on those of a plan.
    """

    raster: Path
    points: Path
    grid: Grid
    ids: tuple[str, ...]
    measured: FloatArray
    true: FloatArray
    pixel_errors: FloatArray
    statistics: CheckStatistics
    pixel_rms: tuple[float, float]
    pixel_rms_total: float
    notes: tuple[str, ...]
    diagnostics: tuple[Diagnostic, ...]
    verdicts: tuple[Verdict, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the map keeps all of them."""
        return all(verdict.passed for verdict in self.verdicts)


def check_map(raster: Path, points: Path, wanted: CheckOptions, *, insist: bool = False) -> MapCheck:
    """Accuracy of a georeferenced raster at points whose places are known, without verdicts.

    Parameters
    ----------
    raster, points : Path
    wanted : CheckOptions
    insist : bool
        Go on where coordinates look wrong.

    Raises
    ------
    InputError
        The raster is not georeferenced, a file is wrong, or coordinates do not fit their CRS.
    """
    # Every step of a project needs the verdicts of this file, and few the points: 30 ms of imports.
    from geomosaic.control.read import read_control_file
    from geomosaic.control.table import has_positions, read_positions
    from geomosaic.orientation.single.check_points import check_errors

    given = wanted.points
    info = inspect(raster)
    grid = _grid(info, wanted.raster_crs)
    if has_positions(points):
        found = read_positions(points, crs=given.crs)
        measured = grid.colrow(found.colrow)
        notes: tuple[str, ...] = ("measured on the map: measured_x, measured_y",)
    else:
        reading = read_control_file(
            points, image=raster.name, crs=given.crs, size=info.size, sign=given.rows, count=given.pixels
        )
        found, notes = reading.control, reading.notes
        judges = [role == "check" for role in found.roles]
        if any(judges) and not all(judges):
            notes = (*notes, f"{counted(len(judges) - sum(judges), 'control point')} left out")
            found = found.select(judges)
        measured = found.colrow
    found = found.without(given.without, str(points))
    found, measured = found.select(found.enabled), measured[found.enabled]
    diagnostics = _examined(found, measured, info.size)
    wrong = next((finding for finding in diagnostics if finding.severity == "error"), None)
    if wrong is not None and not (insist and has_valid_positions(found)):
        hint = f"{wrong.hint}; or `insist`" if has_valid_positions(found) else wrong.hint
        raise InputError(f"{wrong.what} ({wrong.code})", where=str(points), hint=hint)
    true = found.to_crs(grid.crs).xy
    pixel = measured - grid.colrow(true)
    statistics = check_errors(found.names, grid.xy(measured) - true, short_unit(grid.crs), wanted.survey_rms)
    per_axis = np.sqrt((pixel**2).mean(axis=0))
    if np.hypot(*per_axis) > FAR:
        what = f"the points lie {np.hypot(*per_axis):.0f} pixels (RMS) from where they should"
        hint = "are col and row measured in this raster, and not in the image it was made from?"
        diagnostics = (*diagnostics, Diagnostic("far", "warning", what, (), hint))
    diagnostics = (*diagnostics, *check_diagnostics(found.names, pixel, statistics.errors, statistics.unit))
    return MapCheck(
        raster,
        points,
        grid,
        found.names,
        measured,
        true,
        pixel,
        statistics,
        (float(per_axis[0]), float(per_axis[1])),
        float(np.hypot(*per_axis)),
        notes,
        diagnostics,
    )


def _grid(info: SourceInfo, given: str | None) -> Grid:
    if info.transform is None:
        raise InputError(
            "the raster is not georeferenced",
            where=info.path,
            hint="check a product; `geomosaic georeference` places an image and checks it by points of role 'check'",
        )
    if info.crs is not None:
        crs = horizontal(info.crs)
        if given is not None and not crs.equals(parse_map(given, "`raster_crs`"), ignore_axis_order=True):
            raise InputError(
                f"the raster is in '{crs.name}', and '{given}' is given", where=info.path, hint="leave it out"
            )
    elif given is not None:
        crs = parse_map(given, "`raster_crs`")
    else:
        raise InputError("the raster names no CRS", where=info.path, hint="give it with `raster_crs`")
    return Grid(crs, info.transform, info.width, info.height)


def _examined(found: ControlPoints, measured: FloatArray, size: tuple[int, int]) -> tuple[Diagnostic, ...]:
    diagnostics = diagnose(replace(found, colrow=measured), kind="conformal", size=size)
    return tuple(finding for finding in diagnostics if finding.code in EXAMINED or finding.code.startswith("swapped"))


@dataclass(frozen=True)
class ControlResidual:
    """Residual of one image measurement, measured minus computed, in pixels.

    Attributes
    ----------
    id : str
        Of the ground point.
    image : str
    role : str
        'control', 'check', or 'rejected' of control that contradicts the rest and took no part in the image's model.
    col, row : float
        NaN where the image cannot see the point.
    """

    id: str
    image: str
    role: str
    col: float
    row: float


def control_residuals(block: OrientedBlock) -> list[ControlResidual]:
    """Residuals of all image measurements of control and check points.

    Parameters
    ----------
    block : OrientedBlock
        Ground points are in `block.crs`; without one there are no residuals.

    Returns
    -------
    list of ControlResidual
        In the order of `block.control`.
    """
    if block.crs is None:
        return []
    found = []
    out = {(scene.name, blunder.id) for scene in block.scenes for blunder in left_out(scene.model)}
    for point in block.control:
        model = block.scene(point.image).model
        xyz = Transform(block.crs, model.crs)(np.array([point.xyz]))
        dcol, drow = np.array(point.colrow) - model.ground_to_image(xyz)[0]
        role = "rejected" if point.role == "control" and (point.image, point.id) in out else point.role
        found.append(ControlResidual(point.id, point.image, role, float(dcol), float(drow)))
    return found


def rms(residuals: list[ControlResidual], role: str) -> float:
    """Root mean square length of the residuals of one role.

    Parameters
    ----------
    residuals : list of ControlResidual
    role : str
        'control' or 'check'.

    Returns
    -------
    float
        Pixels; NaN without any finite residual.
    """
    lengths = [r.col**2 + r.row**2 for r in residuals if r.role == role and np.isfinite(r.col)]
    return float(np.sqrt(np.mean(lengths))) if lengths else float("nan")


def orientation_verdicts(facts: Mapping[str, Any], limits: QualityLimits, accept: str = "") -> list[dict[str, Any]]:
    """Verdicts on how well images are placed, before or after a mosaic is made of them.

    Parameters
    ----------
    facts : mapping
        `rms_control_px`, `rms_check_px`, `accuracy` of `ExpectedErrors.facts`, `control_discrepancies`: what is known.
    limits : QualityLimits
    accept : str
        How large expected errors are accepted; by the limit of a project unless given.

    Returns
    -------
    list of dict
        `name`, `what`, `value`, `limit`, `unit`, `passed`; `text` explains one that failed.
    """
    accuracy, verdicts = facts.get("accuracy"), []
    found = [
        (f"max_{role}_rms_px", f"{role} points, RMS", facts.get(f"rms_{role}_px")) for role in ("control", "check")
    ]
    if accuracy:
        what = "largest expected error at the corners and in the middle (one standard deviation)"
        found.append(("max_corner_sigma_px", what, accuracy["largest_sigma_px"]))
    for name, what, value in found:
        limit = getattr(limits, name)
        if limit is not None:
            verdicts.append(verdict_on(name, what, value, limit, "px"))
    if accuracy:
        accepted = accept or "what you accept is `max_corner_sigma_px`"
        verdicts[-1]["text"] = (
            f"the points hardly hold {accuracy['largest_in']}: measure more control or tie points there, or choose a "
            f"model of fewer parameters; {accepted}"
        )
    for points in facts.get("control_discrepancies", ()):
        if getattr(limits, f"max_{points['role']}_rms_px") is None:  # a limit of the user's own is the one that counts
            what = f"{points['role']} points, median distance"
            verdict = verdict_on(f"{points['role']}_median_px", what, points["median"], points["limit"], "px")
            verdicts.append({**verdict, "text": points["text"]})
    return verdicts


def expectation_verdicts(accuracy: Mapping[str, Any] | None) -> list[dict[str, Any]]:
    """Verdict on the target of an accuracy raster; none without one.

    Parameters
    ----------
    accuracy : mapping or None
        Facts of the raster.
    """
    if not accuracy or accuracy["target_m"] is None:
        return []
    what = "expected error of position in plan, RMS"
    return [verdict_on("accuracy_target", what, accuracy["rms_plan_m"], accuracy["target_m"], "m")]


def verdict_on(name: str, what: str, value: float | None, limit: float, unit: str) -> dict[str, Any]:
    """Verdict on one limit as JSON values.

    Parameters
    ----------
    name, what : str
        Key under [quality], and its words.
    value : float or None
        None where it could not be measured.
    limit : float
    unit : str
    """
    # A limit on what could not be measured fails, or a missing measurement would pass as a good one.
    passed = value is not None and value <= limit
    return {"name": name, "what": what, "value": value, "limit": limit, "unit": unit, "passed": passed}


def quality_failure(verdicts: Sequence[Mapping[str, Any]], where: str | None, hint: str) -> QualityError | None:
    """Error that names the limits that failed; None where none did.

    Parameters
    ----------
    verdicts : sequence of mapping
    where : str or None
    hint : str
        Followed by the explanation of the first of them that has one.
    """
    failed = [verdict for verdict in verdicts if not verdict["passed"]]
    if not failed:
        return None
    words = [
        f"{v['what']}: {'not measured' if v['value'] is None else format(v['value'], '.3g')}, "
        f"limit {v['limit']:g} {v['unit']}"
        for v in failed
    ]
    why = "".join(f"; {verdict['text']}" for verdict in [v for v in failed if "text" in v][:1])
    return QualityError("; ".join(words), where=where, hint=f"{hint}{why}")
