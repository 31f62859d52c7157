"""Facts of planar placement as JSON values and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.accuracy.check_points import ControlResidual, rms
from geomosaic.errors import counted, listed
from geomosaic.estimation.expected_errors import ExpectedErrors, expected_text, residual_text
from geomosaic.orientation.planar.solution import joins
from geomosaic.whole_files import finite

if TYPE_CHECKING:
    from geomosaic.estimation.blunders.findings import BlunderReport
    from geomosaic.orientation.planar.measurements import PlanarBlock
    from geomosaic.orientation.planar.sequential import Growth
    from geomosaic.orientation.planar.solution import Join, PlanarSolution
    from geomosaic.orientation.planar.transformations import PlanarTransform
    from geomosaic.orientation.planar.uncontrolled import Accumulated, Chain


def joint_facts(solution: PlanarSolution, kind: str) -> dict[str, Any]:
    """Facts of photos adjusted together.

    Parameters
    ----------
    solution : PlanarSolution
    kind : str
        Kind of mosaic.
    """
    return {
        "kind": kind,
        "rectified": "together",
        **_adjusted(solution),
        "accuracy": _accuracy([solution]),
        "photos": [_photo(solution, name) for name in solution.transforms],
        "measurements": _measurements(solution),
        **_joined(solution.block, solution.transforms),
    }


def single_facts(block: PlanarBlock, solutions: Mapping[str, PlanarSolution], model: str) -> dict[str, Any]:
    """Facts of photos rectified singly, each by its own control.

    Parameters
    ----------
    block : PlanarBlock
    solutions : mapping of str to PlanarSolution
        Solutions by photo.
    model : str
        Kind of transformation.
    """
    transforms = {name: solution.transforms[name] for name, solution in solutions.items()}
    return {
        "kind": "controlled",
        "rectified": "singly",
        "model": model,
        "rms_px": finite(float(np.sqrt(np.mean([solution.rms**2 for solution in solutions.values()])))),
        "accuracy": _accuracy(list(solutions.values())),
        "photos": [{**_photo(solution, name), **_adjusted(solution)} for name, solution in solutions.items()],
        "measurements": [row for solution in solutions.values() for row in _measurements(solution)],
        **_joined(block, transforms),
    }


def chain_facts(block: PlanarBlock, made: Chain, model: str, error: Accumulated) -> dict[str, Any]:
    """Facts of an uncontrolled mosaic.

    Parameters
    ----------
    block : PlanarBlock
    made : Chain
    model : str
        Kind of transformation.
    error : Accumulated
        Errors against the simultaneous adjustment.
    """
    return {
        "kind": "uncontrolled",
        "model": model,
        "start": made.start,
        "photos": [
            {**_numbers(asdict(one)), "steps": made.steps[one.photo], **_place(made.transforms[one.photo])}
            for one in made.attachments
        ],
        "accumulated": {
            "against": error.against,
            "model": error.model,
            "by_photo_px": error.by_photo,
            "by_step_px": {str(step): value for step, value in error.by_step.items()},
            "best_fit_px": error.best,
            "gaps_px": error.gaps,
            "gaps_adjusted_px": error.gaps_adjusted,
        },
        **_joined(block, made.transforms),
    }


def growth_facts(grown: Growth, model: str, together: PlanarSolution | None) -> dict[str, Any]:
    """Facts of a sequential mosaic, placed photo by photo.

    Parameters
    ----------
    grown : Growth
    model : str
        Kind of transformation.
    together : PlanarSolution or None
        Simultaneous adjustment, whose expected errors those of growing are not below; None where it is not determined.
    """
    return {
        "kind": "grown",
        "model": model,
        "photos": [
            {**_numbers(asdict(one)), **_photo(grown.solutions[one.photo], one.photo)} for one in grown.attachments
        ],
        "joins": [asdict(one) for one in grown.joins],
        "failed_joins": [asdict(one) for one in grown.failed],
        **({} if together is None else {"accuracy": _accuracy([together])}),
        "gaps_px": _gap_rms(grown.joins),
    }


def _measurements(solution: PlanarSolution) -> list[dict[str, Any]]:
    """Residuals of all measurements in photos: measured minus computed."""
    views = solution.views
    return [
        {
            "id": views.ids[int(views.point[i])],
            "image": solution.block.photos[int(views.photo[i])].name,
            "col": finite(solution.residuals[i, 0]),
            "row": finite(solution.residuals[i, 1]),
            "standardised": [finite(value) for value in solution.standardised[i]],
        }
        for i in np.flatnonzero(~views.is_ground)
    ]


def control_facts(residuals: Sequence[ControlResidual]) -> dict[str, Any]:
    """RMS of control and check points against the placed photos.

    Parameters
    ----------
    residuals : sequence of ControlResidual

    Returns
    -------
    dict
        `rms_control_px` and `rms_check_px`, None without points of the role; `checks`, one entry per check point.
    """
    return {f"rms_{role}_px": finite(rms(list(residuals), role)) for role in ("control", "check")} | {
        "checks": [asdict(one) for one in residuals if one.role == "check"]
    }


def gross_error_facts(found: BlunderReport) -> dict[str, Any]:
    """Facts of the search for wrong points.

    Parameters
    ----------
    found : BlunderReport

    Returns
    -------
    dict
        JSON values under `wrong_points`.
    """
    return {
        "wrong_points": {
            "measurements": found.measurements,
            "redundancy": found.redundancy,
            "agree_px": finite(found.precision),
            "detectable_px": finite(found.minimal_detectable),
            "unchecked": list(found.unchecked),
            "left_out": found.policy == "leave",
            "tilted": [{"photo": photo, "px": size} for photo, size in found.tilted],
            "found": [
                {
                    "point": each.label.id,
                    "images": list(each.label.images),
                    "what": each.label.name,
                    "where": list(each.label.where),
                    "px": each.size,
                    "gross": each.gross,
                    "redundancy": each.redundancy,
                    "or": list(each.alternatives),
                }
                for each in found.blunders
            ],
        }
    }


def _gap_rms(found: Sequence[Join]) -> float:
    """Root mean square gap over all points of all joins, pixels; 0 without joins."""
    count = sum(one.points for one in found)
    return float(np.sqrt(sum(one.points * one.rms**2 for one in found) / max(1, count)))


def _adjusted(solution: PlanarSolution) -> dict[str, Any]:
    return {
        "model": solution.kind,
        "equations": solution.equations,
        "redundancy": solution.redundancy,
        "sigma0": finite(solution.sigma0),
        "rms_px": finite(solution.rms),
        "condition": solution.condition,
        "rounds": solution.rounds,
    }


def _photo(solution: PlanarSolution, name: str) -> dict[str, Any]:
    """A photo's parameters, and how well its corners lie."""
    transform = solution.transforms[name]
    return {
        **_place(transform),
        "corner_sigmas": [float(value) for value in solution.position_sigmas(name, transform.corners())],
    }


def _accuracy(solutions: Sequence[PlanarSolution]) -> dict[str, Any]:
    """Expected errors at the corners and in the middle of the mosaic of all photos of independent solutions."""
    named = [(name, *solution.expected_errors(name)) for solution in solutions for name in solution.transforms]
    names, places, sigmas = zip(*named, strict=True)
    fits = [(solution.redundancy, solution.observations) for solution in solutions]
    return ExpectedErrors.of(names, np.array(places), np.array(sigmas), fits).facts


def _place(transform: PlanarTransform) -> dict[str, Any]:
    return {"photo": transform.photo.name, "kind": transform.kind, "parameters": transform.textbook()}


def _joined(block: PlanarBlock, transforms: Mapping[str, PlanarTransform]) -> dict[str, Any]:
    found = joins(block, transforms)
    return {"joins": [asdict(one) for one in found], "gaps_px": _gap_rms(found)}


def _numbers(values: Mapping[str, Any]) -> dict[str, Any]:
    plain = {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}
    return {key: finite(value) if isinstance(value, float) else value for key, value in plain.items()}


def placement_lines(facts: Mapping[str, Any]) -> list[str]:
    """Placement of the photos in words: how, and how well.

    Parameters
    ----------
    facts : mapping
        Facts of `joint_facts`, `single_facts`, `chain_facts` or `growth_facts`, with those of `gross_error_facts`.

    Returns
    -------
    list of str
        Lines.
    """
    kind, model, count = facts["kind"], facts["model"], len(facts["photos"])
    lines = []
    if kind == "uncontrolled":
        found = facts["accumulated"]
        farthest = max(found["by_step_px"], key=int)
        lines.append(
            f"uncontrolled, {model}: {counted(count, 'photo')} joined outwards from {facts['start']}, "
            f"gaps {facts['gaps_px']:.2f} px RMS"
        )
        what = "control" if found["against"] == "control" else "ties alone"
        lines.append(
            f"accumulated error against all photos adjusted together on {what}: "
            f"{found['by_step_px'][farthest]:.2f} px RMS {counted(int(farthest), 'join')} out, "
            f"{found['best_fit_px']:.2f} px after the best fit"
        )
    elif kind == "grown":
        lines.append(
            f"grown, {model}: {counted(count, 'photo')} from {facts['photos'][0]['photo']}, "
            f"{counted(len(facts['joins']), 'join')} checked, "
            f"{len(facts['failed_joins'])} failed, gaps {facts['gaps_px']:.2f} px RMS"
        )
    elif facts["rectified"] == "singly":
        lines.append(
            f"controlled, {model}: {counted(count, 'photo')} rectified singly, "
            f"{residual_text(facts['rms_px'], facts['accuracy'])}, gaps at ties {facts['gaps_px']:.2f} px RMS"
        )
    else:
        weight = f", {facts['sigma0']:.2f} times their sigmas" if facts["sigma0"] is not None else ""
        lines.append(
            f"{kind}, {model}: {counted(count, 'photo')} adjusted together, {facts['equations']} equations, redundancy "
            f"{facts['redundancy']}, {residual_text(facts['rms_px'], facts['accuracy'])}{weight}"
        )
    expected = [expected_text(facts["accuracy"])] if "accuracy" in facts else []
    if kind == "grown":  # the sigmas of a photo that is joined to others say nothing of those of the others
        expected = [f"of all photos adjusted together, which growing does not surpass: {line}" for line in expected]
    return [*lines, *expected, *gross_error_lines(facts["wrong_points"])]


def gross_error_lines(found: Mapping[str, Any]) -> list[str]:
    """Search for wrong points in words: those found, and the errors that the redundancy would reveal.

    Parameters
    ----------
    found : mapping
        `wrong_points` of `gross_error_facts`.

    Returns
    -------
    list of str
        Lines.
    """
    if not found["measurements"]:
        return ["no search for wrong points: the points do not connect all photos"]
    wrong, unchecked = found["found"], found["unchecked"]
    done = "left out" if found["left_out"] else "taking part"
    named = f"{counted(len(wrong), 'wrong one')}, {done}" if wrong else "none wrong"
    size = found["detectable_px"]
    seen = "too little to find one" if size is None else f"errors of {size:.1f} px would be found"
    named = named if wrong or size is not None else "not checked"
    line = f"measurements: {found['measurements']}, {named} (redundancy {found['redundancy']}: {seen})"
    if unchecked:
        line += f"; nothing checks {listed(unchecked, 3)}"
    return [line, *_tilted_lines(found["tilted"])]


def _tilted_lines(tilted: Sequence[Mapping[str, Any]]) -> list[str]:
    """Photos that the model does not fit."""
    if not tilted:
        return []
    named = listed((f"{one['photo']} ({one['px']:.1f} px)" for one in tilted), 3)
    return [f"tilted, or on sloping ground, which this model does not fit: {named}; controlled mosaics do"]
