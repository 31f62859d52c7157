"""Facts of a block adjustment as plain values: what programs read, and what the report shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

from geomosaic.orientation.block.adjustment import BlockAdjustment
from geomosaic.orientation.block.blunder_causes import BlockBlunder, blunders, group_blunder_text
from geomosaic.orientation.block.connectivity import connectivity
from geomosaic.orientation.block.group_blunders import GroupBlunder
from geomosaic.orientation.block.observations import UNITS, in_units
from geomosaic.orientation.block.residual_pattern import residual_pattern
from geomosaic.orientation.block.self_calibration import offers
from geomosaic.orientation.block.solution import SIGMA0_ALPHA, BlockSolution, KnownPoints, group_name
from geomosaic.orientation.single.check_points import check_errors, height_statements
from geomosaic.types import BoolArray, FloatArray, IntArray

# Measurements that are listed as the least reliable.
LEAST_RELIABLE = 10


def block_facts(
    solution: BlockSolution, found: Sequence[BlockBlunder] | None = None, camera: IntArray | None = None
) -> dict[str, Any]:
    """Facts of a block adjustment.

    Parameters
    ----------
    solution : BlockSolution
    found : sequence of BlockBlunder, optional
        Its blunders, where they are known already.
    camera : int array (M,), optional
        Camera of each image; with it the facts say what of a camera should not be held.

    Returns
    -------
    dict
        Errors and sigmas along the axes of the ground's CRS, in `length_unit`: metres, where anything gives a scale;
        NaN where there is no number.
    """
    adjustment = solution.adjustment
    problem, state = adjustment.problem, adjustment.state
    low, high = solution.sigma0_bounds
    condition, movements = solution.weakest()
    views, used = problem.views, state.weights[0] > 0.0
    joined = connectivity(views.image[used], views.points[used], views.colrow[used], len(solution.images))
    wrong = blunders(solution) if found is None else found
    return {
        "crs": problem.frame.ground.name,
        "length_unit": solution.length_unit,
        "sigma0": adjustment.sigma0,
        "sigma0_bounds": [low, high],
        "sigma0_as_expected": bool(low <= adjustment.sigma0 <= high),
        "unknowns": adjustment.network.unknowns,
        "redundancy": adjustment.redundancy,
        "rounds": adjustment.rounds,
        "points": _points(solution),
        "observations": [_observations(solution, index) for index in range(len(problem.groups))],
        "least_reliable": _least_reliable(solution),
        "control": _known(solution.control),
        "checks": _known(solution.checks) | _statements(solution.checks),
        "tie_scatter": _tie_scatter(adjustment),
        "wrong_groups": [_wrong_group(solution, each) for each in adjustment.wrong_groups],
        "blunders": [_blunder(each) for each in wrong],
        "further": _further(solution),
        "cameras": _cameras(solution),
        "correlated": [{"one": a, "other": b, "correlation": value} for a, b, value in solution.correlated()],
        "focal_heights": [{"camera": name, "correlation": value} for name, value in solution.focal_heights()],
        "insignificant": [{"parameter": n, "change": c, "sigma": s} for n, c, s in solution.insignificant()],
        "offered": [] if camera is None else [each.facts(solution.images) for each in offers(solution, camera)],
        "patterns": _patterns(solution),
        "images": _images(solution, joined.part),
        "parts": [[solution.images[image] for image in part] for part in joined.parts],
        "reservation": solution.reservation,
        "condition": condition,
        "weakest": [{"name": name, "pixels": moved} for name, moved in movements],
    }


def _points(solution: BlockSolution) -> dict[str, Any]:
    """Numbers of points and of their rays, and their median standard deviations."""
    moving = solution.adjustment.state.moving
    sigmas = solution.point_sigmas
    known = sigmas[np.isfinite(sigmas).all(axis=1) & (solution.rays >= 2)]
    return {
        "adjusted": int(moving.sum()),
        "measured": len(solution.ids),
        "median_sigmas": np.median(known, axis=0).tolist() if len(known) else [math.nan] * 3,
        "rays": {str(n): int(count) for n, count in enumerate(np.bincount(solution.rays[moving])) if count},
    }


def _observations(solution: BlockSolution, index: int) -> dict[str, Any]:
    """Number, RMS and variance component of one kind of observations."""
    adjustment = solution.adjustment
    group, whitened = adjustment.problem.groups[index], adjustment.statistics[index].residuals
    used, out = adjustment.state.weights[index] > 0.0, adjustment.rejected[index]
    left = solution.residuals if index == 0 else in_units(group, whitened)
    factor, redundancy = adjustment.variance_components[group.name]
    # An approximation: as if the group's share of the redundancy were free observations of its own.
    most = chi2.ppf(1.0 - SIGMA0_ALPHA / 2.0, redundancy) / redundancy if redundancy > 0.5 else math.inf
    own = solution.reliability[index]
    checked = np.isfinite(own.detectable)
    return {
        "name": group.name,
        "used": int(used.sum()),
        "rejected": int(out.sum()),
        "rms": float(np.sqrt((left[used] ** 2).sum(axis=1).mean())) if used.any() else math.nan,
        "unit": UNITS.get(group.name, "m"),
        "variance_factor": factor,
        "redundancy": redundancy,
        "too_large": bool(factor > most),
        "detectable": _middle_and_worst(own.detectable[checked]),
        "shift": _middle_and_worst(own.shift[checked]),
        "shift_unit": "m" if group.of_points else UNITS.get(group.name, "m"),
        "unchecked": int(np.isinf(own.detectable).sum()),
    }


def _middle_and_worst(values: FloatArray) -> dict[str, float]:
    known = values[np.isfinite(values)]
    pair = (float(np.median(known)), float(known.max())) if len(known) else (math.nan, math.nan)
    return dict(zip(("median", "worst"), pair, strict=True))


def _least_reliable(solution: BlockSolution) -> list[dict[str, Any]]:
    """Measurements of points whose unseen error would move their point most."""
    views, found = solution.adjustment.problem.views, list[dict[str, Any]]()
    for index, (group, own) in enumerate(zip(solution.adjustment.problem.groups, solution.reliability, strict=True)):
        if not group.of_points:
            continue
        shift: FloatArray = np.where(np.isfinite(own.shift), own.shift, -1.0)
        for row in np.argsort(shift, kind="stable")[::-1][:LEAST_RELIABLE].tolist():
            if shift[row] > 0.0:
                found.append(
                    {
                        "kind": group.name,
                        "point": solution.ids[int(group.points[row])],
                        "image": solution.images[int(views.image[row])] if index == 0 else "",
                        "detectable": float(own.detectable[row]),
                        "unit": UNITS.get(group.name, "m"),
                        "shift": float(shift[row]),
                    }
                )
    return sorted(found, key=lambda each: -each["shift"])[:LEAST_RELIABLE]


def _known(known: KnownPoints) -> dict[str, Any]:
    """Points with given coordinates: RMS in plan, in height, and each point."""
    squares = known.errors[~known.rejected] ** 2

    def rms(columns: slice) -> float:
        # Axes that were not given have no error.
        own = squares[:, columns]
        own = own[np.isfinite(own).all(axis=1)]
        return float(np.sqrt(own.sum(axis=1).mean())) if len(own) else math.nan

    columns = (
        known.errors, known.sigmas, known.sigmas_given, known.rays, known.rejected, known.detectable, known.shift,
    )  # fmt: skip
    names = ("id", "errors", "sigmas", "sigmas_given", "rays", "rejected", "detectable", "shift")
    return {
        # A point whose rays do not meet has no place, and no error.
        "count": int((~known.rejected & np.isfinite(known.errors).any(axis=1)).sum()),
        "rms_plan": rms(slice(0, 2)),
        "rms_height": rms(slice(2, 3)),
        "points": [
            dict(zip(names, point, strict=True))
            for point in zip(known.ids, *(column.tolist() for column in columns), strict=True)
        ],
    }


def _statements(checks: KnownPoints) -> dict[str, Any]:
    """What check points that are known in plan and height allow to say; nothing without any."""
    placed: BoolArray = np.asarray(np.isfinite(checks.errors).all(axis=1))
    if not placed.any():
        return {"statements": []}
    ids = [name for name, there in zip(checks.ids, list(placed), strict=True) if there]
    plan = check_errors(ids, -checks.errors[placed, :2], "m")
    heights = height_statements(-checks.errors[placed, 2])
    return {"statements": [plan.nssda_statement, plan.asprs_statement, *heights]}


def _tie_scatter(adjustment: BlockAdjustment) -> dict[str, Any] | None:
    """Scatter of tie points that are better than declared; None where they are not."""
    used = adjustment.image_factors[adjustment.state.weights[0] > 0.0]
    factor = float(used.min(initial=1.0))
    if factor == 1.0:
        return None
    return {
        "factor": factor,
        "count": int((used < 1.0).sum()),
        "text": f"image positions of tie points scatter {factor:.2g} times what was declared, and took part with "
        "standard deviations that are so much smaller; control and everything else keep theirs",
    }


def _wrong_group(solution: BlockSolution, wrong: GroupBlunder) -> dict[str, Any]:
    groups = solution.adjustment.problem.groups
    name = groups[wrong.index].name
    return {
        "kind": name,
        "left_out": wrong.offset is not None,
        "offset": None if wrong.offset is None else wrong.offset.tolist(),
        "unit": UNITS.get(name, "m"),
        "scatter": wrong.scatter,
        "others": [groups[other].name for other in wrong.others],
        "sigma0_with": wrong.sigma0_with,
        "text": group_blunder_text(solution, wrong),
    }


def _blunder(found: BlockBlunder) -> dict[str, Any]:
    return {
        "kind": found.kind,
        "image": found.image,
        "point": found.point,
        "size": list(found.size),
        "unit": found.unit,
        "log_probability": found.log_probability,
        "sigma0_with": found.sigma0_with,
        "cause": found.cause,
        "text": str(found),
    }


def _further(solution: BlockSolution) -> list[dict[str, Any]]:
    """What several observations share: strips, boresight, lakes, planes, lines, rigs, with what checks each."""
    adjustment = solution.adjustment
    problem, state, found = adjustment.problem, adjustment.state, []
    pairs = [group.row_further for group in problem.groups]
    meanings = [group.meaning(state, problem.frame) for group in problem.groups]
    for number, unknowns in enumerate(problem.unknowns.further):
        sigmas, count, redundancy = np.sqrt(np.diagonal(solution.further_covariance(number))), 0, 0.0
        meaning, units = dict[str, list[float]](), ("",) * len(sigmas)
        for index, (group, statistics) in enumerate(zip(problem.groups, adjustment.statistics, strict=True)):
            (row, further), weight = pairs[index], state.weights[index]
            mine = row[(further == number) & (weight[row] > 0.0)]
            if len(mine):
                count += len(mine)
                redundancy += float(np.trace(statistics.share[mine], axis1=1, axis2=2).sum())
                meaning |= meanings[index].get(number, {})
                units = group.further_units
        names = [name.rsplit(": ", 1)[-1] for name in unknowns.names]
        rows = zip(names, units, state.further[number].tolist(), sigmas.tolist(), strict=True)
        found.append(
            {
                "name": group_name(unknowns),
                "observations": count,
                "redundancy": redundancy,
                "parameters": [
                    {"name": name, "unit": unit, "value": value, "sigma": sigma}
                    for (name, unit, value, sigma), free in zip(rows, list(unknowns.free), strict=True)
                    if free
                ],
                **meaning,
            }
        )
    return found


def _cameras(solution: BlockSolution) -> list[dict[str, Any]]:
    """Interior orientations that were estimated: values before and after, standard deviations."""
    unknowns, found = solution.adjustment.problem.unknowns, []
    for camera, shared in enumerate(unknowns.interiors):
        after, images = solution.interior(camera), np.flatnonzero(unknowns.camera == camera)
        sigmas = np.sqrt(np.diagonal(solution.camera_covariance(camera)))
        rows = zip(after.names, after.units, shared.start.tolist(), after.values.tolist(), sigmas.tolist(), strict=True)
        found.append(
            {
                "name": group_name(shared),
                "images": [solution.images[image] for image in images],
                "parameters": [
                    {"name": name, "unit": unit, "before": a, "after": b, "sigma": s}
                    for (name, unit, a, b, s), free in zip(rows, list(shared.free), strict=True)
                    if free
                ],
            }
        )
    return found


def formats(solution: BlockSolution) -> list[tuple[str, IntArray]]:
    """Cameras by their names and images: those of one interior orientation, or else of one kind and size.

    Parameters
    ----------
    solution : BlockSolution
    """
    unknowns, found = solution.adjustment.problem.unknowns, dict[str, list[int]]()
    for image, (camera, model) in enumerate(zip(unknowns.camera.tolist(), solution.models, strict=True)):
        width, height = model.size
        kind = type(model).__name__.removesuffix("Model").lower()
        name = f"camera {camera + 1}" if camera >= 0 else f"{kind}, {width} × {height} pixels"
        found.setdefault(name, []).append(image)
    return [(name, np.array(images)) for name, images in found.items()]


def _patterns(solution: BlockSolution) -> list[dict[str, Any]]:
    views, used, found = solution.adjustment.problem.views, solution.adjustment.state.weights[0] > 0.0, []
    for name, images in formats(solution):
        mine = used & np.isin(views.image, images)
        pattern = residual_pattern(views.colrow[mine], solution.residuals[mine], solution.models[images[0]].size)
        found.append(
            {
                "camera": name,
                "images": len(images),
                "image_positions": int(mine.sum()),
                "rms_px": pattern.rms,
                "mean_rms_px": pattern.mean_rms,
                "probability": pattern.probability,
                "systematic": pattern.systematic,
            }
        )
    return found


def _images(solution: BlockSolution, part: IntArray) -> list[dict[str, Any]]:
    adjustment, views = solution.adjustment, solution.adjustment.problem.views
    used, count = adjustment.state.weights[0] > 0.0, len(solution.images)
    # Of two components: 1 is a measurement that others check wholly.
    share = np.trace(adjustment.statistics[0].share, axis1=1, axis2=2) / 2.0
    points = np.bincount(views.image[used], minlength=count)
    checked = np.bincount(views.image[used], share[used], count) / np.where(points > 0, points, np.nan)
    rejected = np.bincount(views.image[adjustment.rejected[0]], minlength=count)
    rms, found = solution.image_rms(), []
    for image, (name, model) in enumerate(zip(solution.images, solution.models, strict=True)):
        own = model.parameters
        covariance = solution.covariance(image)
        sigmas = np.full(len(own), np.nan) if covariance is None else np.sqrt(np.diagonal(covariance))[: len(own)]
        found.append(
            {
                "name": name,
                "part": int(part[image]) + 1,
                "points": int(points[image]),
                "rejected": int(rejected[image]),
                "rms_px": float(rms[image]),
                "redundancy": float(checked[image]),
                "parameters": dict(zip(own.names, own.values.tolist(), strict=True)),
                "sigmas": dict(zip(own.names, sigmas.tolist(), strict=True)),
                "units": dict(zip(own.names, own.units, strict=True)),
            }
        )
    return found
