"""What is to be said of photos that plane transformations placed, as JSON values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.adjust.planar.joins import joins
from geomosaic.product.checks.check import ControlResidual, rms

if TYPE_CHECKING:
    from geomosaic.adjust.network.findings import Findings
    from geomosaic.adjust.planar.compare import Accumulated
    from geomosaic.adjust.planar.grow import Growth
    from geomosaic.adjust.planar.joins import Join
    from geomosaic.adjust.planar.solution import PlanarSolution
    from geomosaic.adjust.planar.transform import PlanarTransform
    from geomosaic.adjust.planar.uncontrolled import Chain
    from geomosaic.adjust.planar.values import PlanarBlock


def joint_facts(solution: PlanarSolution, kind: str) -> dict[str, Any]:
    """Of all photos adjusted together."""
    return {
        "kind": kind,
        "rectified": "together",
        **_adjusted(solution),
        "photos": [_photo(solution, name) for name in solution.transforms],
        "measurements": measurements(solution),
        **_joined(solution.block, solution.transforms),
    }


def single_facts(block: PlanarBlock, solutions: Mapping[str, PlanarSolution], model: str) -> dict[str, Any]:
    """Of photos rectified each by its own control."""
    transforms = {name: solution.transforms[name] for name, solution in solutions.items()}
    return {
        "kind": "controlled",
        "rectified": "singly",
        "model": model,
        "photos": [{**_photo(solution, name), **_adjusted(solution)} for name, solution in solutions.items()],
        "measurements": [row for solution in solutions.values() for row in measurements(solution)],
        **_joined(block, transforms),
    }


def chain_facts(block: PlanarBlock, made: Chain, model: str, error: Accumulated) -> dict[str, Any]:
    """Of an uncontrolled mosaic."""
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


def growth_facts(grown: Growth, model: str) -> dict[str, Any]:
    """Of a mosaic grown photo by photo."""
    return {
        "kind": "grown",
        "model": model,
        "photos": [
            {**_numbers(asdict(one)), **_photo(grown.solutions[one.photo], one.photo)} for one in grown.attachments
        ],
        "joins": [asdict(one) for one in grown.joins],
        "failed_joins": [asdict(one) for one in grown.failed],
        "gaps_px": gap_rms(grown.joins),
    }


def measurements(solution: PlanarSolution) -> list[dict[str, Any]]:
    """Residuals of all measurements: measured minus computed, pixels."""
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
    """RMS of control and check points against the placed photos, pixels; None without any."""
    return {f"rms_{role}_px": finite(rms(list(residuals), role)) for role in ("control", "check")} | {
        "checks": [asdict(one) for one in residuals if one.role == "check"]
    }


def wrong_facts(found: Findings) -> dict[str, Any]:
    """Of the search for wrong points."""
    return {
        "wrong_points": {
            "measurements": found.measurements,
            "redundancy": found.redundancy,
            "agree_px": finite(found.agree),
            "detectable_px": finite(found.detectable),
            "unchecked": list(found.unchecked),
            "left_out": found.done == "leave",
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
                    "or": list(each.alike),
                }
                for each in found.wrong
            ],
        }
    }


def gap_rms(found: Sequence[Join]) -> float:
    """Root mean square gap over all points of all joins, pixels."""
    count = sum(one.points for one in found)
    return float(np.sqrt(sum(one.points * one.rms**2 for one in found) / max(1, count)))


def finite(value: float) -> float | None:
    """JSON knows no NaN."""
    number = float(value)
    return number if np.isfinite(number) else None


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


def _place(transform: PlanarTransform) -> dict[str, Any]:
    return {"photo": transform.photo.name, "kind": transform.kind, "parameters": transform.textbook()}


def _joined(block: PlanarBlock, transforms: Mapping[str, PlanarTransform]) -> dict[str, Any]:
    found = joins(block, transforms)
    return {"joins": [asdict(one) for one in found], "gaps_px": gap_rms(found)}


def _numbers(values: Mapping[str, Any]) -> dict[str, Any]:
    plain = {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}
    return {key: finite(value) if isinstance(value, float) else value for key, value in plain.items()}
