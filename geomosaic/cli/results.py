"""Results in words for people, and as plain values for JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from geomosaic.errors import counted
from geomosaic.whole_files import finite

if TYPE_CHECKING:
    from geomosaic.errors import QualityError
    from geomosaic.geo.grid import Grid
    from geomosaic.jobs.project import Outcome
    from geomosaic.jobs.step import State
    from geomosaic.mosaicking.records import MosaicResult
    from geomosaic.options.inputs import QualityLimits
    from geomosaic.render.accuracy import AccuracyRaster
    from geomosaic.render.ortho import OrthoResult


def grid_facts(grid: Grid) -> dict[str, Any]:
    """Grid as plain values.

    Parameters
    ----------
    grid : Grid

    Returns
    -------
    dict
        JSON values.
    """
    from geomosaic.geo.crs import authority_code

    return {
        "crs": authority_code(grid.crs) or grid.crs.to_wkt(),
        "width": grid.width,
        "height": grid.height,
        "resolution": list(grid.resolution),
        "bounds": list(grid.bounds),
    }


def ortho_facts(result: OrthoResult) -> dict[str, Any]:
    """Ortho as plain values.

    Parameters
    ----------
    result : OrthoResult

    Returns
    -------
    dict
        JSON values.
    """
    return {**_rendered_facts(result), "seconds": round(result.seconds, 3)}


def _rendered_facts(result: OrthoResult | MosaicResult) -> dict[str, Any]:
    """What orthos and mosaics have in common, as JSON values."""
    return {
        "output": str(result.path),
        "grid": grid_facts(result.grid),
        "valid_pixels": result.valid_pixels,
        "hidden_pixels": result.hidden_pixels,
        "lattice_error_px": result.lattice_error,
        "tolerance_px": result.tolerance,
        "image_pixels_per_output_pixel": finite(result.scale),
        "notes": list(result.notes),
        **({} if result.placement is None else {"placement": dict(result.placement)}),
        **({} if result.accuracy is None else {"accuracy": result.accuracy.facts}),
        **({} if result.run is None else {"run": result.run.facts}),
    }


def ortho_text(result: OrthoResult) -> str:
    """Ortho in words: notes on the orientation, size, and accuracy of the geometry.

    Parameters
    ----------
    result : OrthoResult
    """
    return "\n".join(
        [
            *_placement_lines(result.placement or {}),
            *result.notes,
            f"{result.path}: {size_text(result.grid)}, {_share(result.valid_pixels, result.grid)} seen"
            + _hidden_text(result.hidden_pixels, result.grid),
            _geometry_text(result, result.seconds),
            *_expected_lines(result),
            *([] if result.run is None else [str(result.run)]),
            *_placement_files(result),
        ]
    )


def _geometry_text(result: OrthoResult | MosaicResult, seconds: float) -> str:
    within = f"geometry within {result.lattice_error:.4f} px of the exact model"
    return f"{within} (tolerance {result.tolerance:g} px), {seconds:.1f} s"


def _placement_lines(facts: Mapping[str, Any]) -> list[str]:
    """Placement by tie and control points in words: how, how well, and what the points show of it."""
    own = facts.get("adjusted") or facts.get("planar") or facts
    lines, accuracy = list(own.get("summary", ())), facts.get("accuracy")
    measured = facts["control"] if isinstance(facts.get("control"), list) else None
    for role in ("control", "check"):
        value = facts.get(f"rms_{role}_px")
        if value is None:
            continue
        count = sum(p["role"] == role for p in measured or ())
        adjusted = (facts.get("adjusted") or {}).get("images", ()) if role == "control" else ()
        if adjusted and sum(image["points"] for image in adjusted) == count:
            continue  # the summary's residuals are theirs
        number = f" over {counted(count, 'measurement')}" if measured is not None else ""
        lines.append(
            f"{role} points: {value:.2f} px RMS{number}{_fitted(value, accuracy) if role == 'control' else ''}"
        )
    return lines


def _fitted(value: float, accuracy: Mapping[str, Any] | None) -> str:
    """What control points that took part in a solution do not show of it."""
    from geomosaic.estimation.expected_errors import LITTLE, shown_by_residuals

    largest = accuracy["largest_sigma_px"] if accuracy else 0.0
    # Few points in a large block fit however redundant its tie points are, and show no error between them.
    if not accuracy or (largest is not None and largest <= 10.0 * value and shown_by_residuals(accuracy) > LITTLE):
        return ""
    expected = "" if largest is None else f" (up to {largest:.2g} px expected)"
    return f"; they were fitted, which is not the accuracy{expected}"


def placement_failure(
    facts: Mapping[str, Any] | None, made: str | None, limits: QualityLimits, accept: str = ""
) -> QualityError | None:
    """Error of a product whose points show that it is placed badly, or do not hold it; None for all others.

    Parameters
    ----------
    facts : mapping or None
        Of its placement.
    made : str or None
        What was written all the same.
    limits : QualityLimits
    accept : str
        How large expected errors are accepted; by the limit unless given.
    """
    if not facts:
        return None
    from geomosaic.accuracy.check_points import orientation_verdicts, quality_failure

    verdicts = orientation_verdicts(facts, limits, accept)
    return quality_failure(verdicts, made, "it is written all the same")


def accuracy_failure(accuracy: AccuracyRaster | None) -> QualityError | None:
    """Error of a product whose expected errors are larger than its target; None for all others.

    Parameters
    ----------
    accuracy : AccuracyRaster or None
    """
    if accuracy is None:
        return None
    from geomosaic.accuracy.check_points import expectation_verdicts, quality_failure

    return quality_failure(expectation_verdicts(accuracy.facts), str(accuracy.path), "it is written all the same")


def _expected_lines(result: OrthoResult | MosaicResult) -> list[str]:
    """Lines on the accuracy raster; none without one."""
    if result.accuracy is None:
        return []
    from geomosaic.render.accuracy import raster_lines

    return raster_lines(result.accuracy.facts)


def _placement_files(result: OrthoResult | MosaicResult) -> list[str]:
    """Line on the files that say how an output is placed; none without placement."""
    if result.placement_file is None:
        return []
    exterior = (result.placement or {}).get("exterior_file")
    return [f"placement: {result.placement_file}{f', orientation: {exterior}' if exterior else ''}"]


def quality_facts(failure: QualityError | None) -> dict[str, Any]:
    """Failed limits for JSON; nothing where none failed.

    Parameters
    ----------
    failure : QualityError or None
    """
    return {} if failure is None else {"quality": failure.what}


def _hidden_text(pixels: int | None, grid: Grid) -> str:
    """Share of pixels that the surface hides, in words."""
    return "" if pixels is None else f", {_share(pixels, grid)} hidden by the surface"


def mosaic_facts(result: MosaicResult) -> dict[str, Any]:
    """Mosaic as plain values.

    Parameters
    ----------
    result : MosaicResult

    Returns
    -------
    dict
        JSON values.
    """
    from geomosaic.mosaicking.colour.corrections import colour_facts

    companions = {"labels": result.labels, "vectors": result.vectors, "stac": result.item}
    return {
        **_rendered_facts(result),
        **{name: str(path) if path else None for name, path in companions.items()},
        **({"tiles": [str(path) for path in result.tiles], "tiles_kept": result.reused} if result.tiles else {}),
        "pixels_per_image": list(result.pixels),
        "gains": result.balance.gain.tolist(),
        "offsets": result.balance.offset.tolist(),
        "overlaps": result.balance.overlaps,
        "overlap_difference_before": [finite(v) for v in result.balance.before],
        "overlap_difference_after": [finite(v) for v in result.balance.after],
        "colour": colour_facts(result.balance, None),
        "stretch": None if result.stretch is None else vars(result.stretch),
        "feather": result.feather,
        "seconds": {name: round(value, 3) for name, value in result.seconds.items()},
    }


def mosaic_text(result: MosaicResult) -> str:
    """Mosaic in words, in a few lines.

    Parameters
    ----------
    result : MosaicResult
    """
    from geomosaic.mosaicking.colour.corrections import term_notes

    lines = [
        *_placement_lines(result.placement or {}),
        *result.notes,
        f"{result.path}: {size_text(result.grid)}, {_share(result.valid_pixels, result.grid)} seen"
        f"{_hidden_text(result.hidden_pixels, result.grid)}, "
        f"{sum(1 for n in result.pixels if n)} of {len(result.pixels)} images used",
    ]
    if result.balance.overlaps:
        before, after = (_rms(values.tolist()) for values in (result.balance.before, result.balance.after))
        lines.append(_colour_text(result.balance.overlaps, before, after))
    lines += term_notes(result.balance)
    if result.stretch is not None:
        lines.append(f"stretched to 8 bits: {result.stretch.low:g} to {result.stretch.high:g} ({result.stretch.how})")
    lines.append(_geometry_text(result, sum(result.seconds.values())))
    if result.tiles:
        lines.append(f"{counted(len(result.tiles), 'tile')} in {result.tiles[0].parent}{_kept_text(result)}")
    beside = [str(path) for path in (result.labels, result.vectors, result.item) if path]
    lines += [f"beside it: {', '.join(beside)}"] if beside else []
    lines += [*_expected_lines(result), *([] if result.run is None else [str(result.run)])]
    return "\n".join([*lines, *_placement_files(result)])


def _kept_text(result: MosaicResult) -> str:
    """Tiles of an earlier run that were kept, in words."""
    if not result.reused:
        return ""
    return f"; {result.reused} of {result.units} places were kept from an earlier run of the same inputs and options"


def _colour_text(overlaps: int, before: float, after: float) -> str:
    """Effect of the colour balance in words, with the decimals that the values ask for."""
    from geomosaic.report.page import decimals

    digits = decimals(before, 2)
    return f"colour difference in {counted(overlaps, 'overlap')}: {before:.{digits}f} before, {after:.{digits}f} after"


def size_text(grid: Grid) -> str:
    """Size, resolution and CRS of a grid in words.

    Parameters
    ----------
    grid : Grid
    """
    from geomosaic.geo.crs import crs_name

    x, y = grid.resolution
    pixel = f"{x:g}" if math.isclose(x, y) else f"{x:g} x {y:g}"
    unit = grid.crs.axis_info[0].unit_name if grid.crs.axis_info else "units"
    return f"{grid.width} x {grid.height} pixels of {pixel} {unit}, {crs_name(grid.crs)}"


def _share(pixels: int, grid: Grid) -> str:
    """Share of a grid in per cent, as text."""
    return f"{100 * pixels / (grid.width * grid.height):.1f} %"


def _rms(values: list[float]) -> float:
    """Root mean square."""
    return math.sqrt(sum(v * v for v in values) / max(1, len(values)))


def status_text(states: Sequence[State]) -> str:
    """States of steps as a table, one line each.

    Parameters
    ----------
    states : sequence of State
    """
    width = max(len(state.name) for state in states)
    lines = []
    for state in states:
        said = state.reason if state.fresh or state.reason == "never run" else f"stale: {state.reason}"
        last = f"  ({state.seconds:.1f} s, {state.finished})" if state.seconds is not None else ""
        lines.append(f"{state.name:<{width}}  {said}{last}")
    return "\n".join(lines)


def outcome_text(done: Outcome) -> str:
    """Outcome of a project run in words: steps, reuse, accuracy and outputs.

    Parameters
    ----------
    done : Outcome
    """
    width = max(len(state.name) for state in done.states)
    lines = [f"{s.name:<{width}}  {'fresh' if s.fresh else f'{s.seconds:.1f} s ({s.reason})'}" for s in done.states]
    facts = done.facts
    ran = any(state.name == "mosaic" and not state.fresh for state in done.states)
    return "\n".join(
        [
            *lines,
            *(_reuse_lines(facts["mosaic"]) if ran else ()),
            *accuracy_lines(facts),
            *([] if done.run is None else [str(done.run)]),
            *(f"note: {note}" for note in done.project.settings.project.notes),
            *(f"{k.replace('_', ' ')}: {v}" for k, v in facts["outputs"].items()),
        ]
    )


def adjusted_text(done: Outcome) -> str:
    """Outcome of a block adjustment in words, and its files.

    Parameters
    ----------
    done : Outcome
    """
    facts = done.facts
    fresh = ["nothing has changed since the last run"] if done.states[0].fresh else []
    names = {"points": "points", "adjustment": "facts", "exterior": "exterior", "adjustment_report": "report"}
    files = [f"{names[k]}: {path}" for k, path in facts["outputs"].items() if k in names]
    files += [f"{format}: {folder}" for format, folder in facts["orient"]["adjusted"].get("exports", {}).items()]
    return "\n".join([*fresh, *facts["orient"]["adjusted"]["summary"], *files])


def _reuse_lines(made: Mapping[str, Any]) -> list[str]:
    """Lines on what a mosaic took from the run before."""
    lines = []
    if made.get("reused"):
        lines.append(f"mosaic: {made['units'] - made['reused']} of {made['units']} units computed, the rest kept")
    if made.get("recalled"):
        lines.append(f"as before: {', '.join(made['recalled'])}")
    return lines


def accuracy_lines(facts: Mapping[str, Any]) -> list[str]:
    """Lines on the accuracy of a project, as far as it was measured.

    Parameters
    ----------
    facts : mapping
        Of the steps by name, see `Outcome.facts`.
    """
    lines = []
    matched, orient, made, check = (facts.get(name) for name in ("match", "orient", "mosaic", "check"))
    if matched:
        lines += matched["summary"]
    if orient:
        lines += _placement_lines(orient)
    if made:
        lines.append(
            f"geometry: interpolated within {made['lattice_error_px']:.4f} px (tolerance {made['tolerance_px']:g} px)"
        )
        if made["overlaps"] and made["balanced"]:
            before, after = _rms(made["before"]), _rms(made["after"])
            lines.append(_colour_text(made["overlaps"], before, after))
        if made.get("accuracy"):
            from geomosaic.render.accuracy import raster_lines

            lines += raster_lines(made["accuracy"])
    if check and check["reference"]:
        found = check["reference"]
        lines.append(
            f"registration on {check['reference_path']}: {found['registration_rms_px']:.3f} px RMS "
            f"({found['matched']} of {found['tiles']} places matched)"
        )
    return lines


def verdict(failure: QualityError | None, as_json: bool) -> int:
    """Exit code of a project run.

    Parameters
    ----------
    failure : QualityError or None
    as_json : bool
        The answer holds the failed limits already.

    Returns
    -------
    int
        0 where no limit failed.

    Raises
    ------
    QualityError
        `failure`, where it is not told yet.
    """
    if failure is None:
        return 0
    if not as_json:
        raise failure
    return failure.exit_code
