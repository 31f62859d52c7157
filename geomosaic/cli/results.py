"""Results in words for people, and as plain values for JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geomosaic.errors import QualityError
    from geomosaic.geo.grid import Grid
    from geomosaic.jobs.project import Outcome
    from geomosaic.jobs.step import State
    from geomosaic.mosaicking.result import MosaicResult
    from geomosaic.render.ortho import OrthoResult


def grid_facts(grid: Grid) -> dict[str, Any]:
    """Say a grid in plain values."""
    code = grid.crs.to_authority(min_confidence=100)
    return {
        "crs": f"{code[0]}:{code[1]}" if code else grid.crs.to_wkt(),
        "width": grid.width,
        "height": grid.height,
        "resolution": list(grid.resolution),
        "bounds": list(grid.bounds),
    }


def ortho_facts(result: OrthoResult) -> dict[str, Any]:
    """Plain values of an ortho."""
    return {
        "output": str(result.path),
        "grid": grid_facts(result.grid),
        "valid_pixels": result.valid_pixels,
        "hidden_pixels": result.hidden_pixels,
        "lattice_error_px": result.lattice_error,
        "tolerance_px": result.tolerance,
        "image_pixels_per_output_pixel": finite(result.scale),
        "notes": list(result.notes),
        "seconds": round(result.seconds, 3),
    }


def ortho_words(result: OrthoResult) -> str:
    """Say how the image was oriented, and what was made."""
    return "\n".join(
        [
            *result.notes,
            f"{result.path}: {size_words(result.grid)}, {share(result.valid_pixels, result.grid)} seen"
            + hidden_words(result.hidden_pixels, result.grid),
            f"geometry within {result.lattice_error:.4f} px of the exact model (tolerance {result.tolerance:g} px), "
            f"{result.seconds:.1f} s",
        ]
    )


def hidden_words(pixels: int | None, grid: Grid) -> str:
    """Say how much the surface hides, where that was asked."""
    return "" if pixels is None else f", {share(pixels, grid)} hidden by the surface"


def mosaic_facts(result: MosaicResult) -> dict[str, Any]:
    """Plain values of a mosaic."""
    from geomosaic.mosaicking.colour.facts import colour_facts

    companions = {"labels": result.labels, "vectors": result.vectors, "stac": result.item}
    return {
        "output": str(result.path),
        **{name: str(path) if path else None for name, path in companions.items()},
        "grid": grid_facts(result.grid),
        "valid_pixels": result.valid_pixels,
        "hidden_pixels": result.hidden_pixels,
        "pixels_per_image": list(result.pixels),
        "gains": result.balance.gain.tolist(),
        "offsets": result.balance.offset.tolist(),
        "overlaps": result.balance.overlaps,
        "overlap_difference_before": [finite(v) for v in result.balance.before],
        "overlap_difference_after": [finite(v) for v in result.balance.after],
        "colour": colour_facts(result.balance, None),
        "stretch": None if result.stretch is None else vars(result.stretch),
        "feather": result.feather,
        "lattice_error_px": result.lattice_error,
        "tolerance_px": result.tolerance,
        "image_pixels_per_output_pixel": finite(result.scale),
        "notes": list(result.notes),
        "seconds": {name: round(value, 3) for name, value in result.seconds.items()},
    }


def mosaic_words(result: MosaicResult) -> str:
    """Say what was made, in a few lines."""
    from geomosaic.mosaicking.colour.facts import term_notes

    lines = [
        *result.notes,
        f"{result.path}: {size_words(result.grid)}, {share(result.valid_pixels, result.grid)} seen"
        f"{hidden_words(result.hidden_pixels, result.grid)}, "
        f"{sum(1 for n in result.pixels if n)} of {len(result.pixels)} images used",
    ]
    if result.balance.overlaps:
        before, after = (rms(values.tolist()) for values in (result.balance.before, result.balance.after))
        lines.append(colour_words(result.balance.overlaps, before, after))
    lines += term_notes(result.balance)
    if result.stretch is not None:
        lines.append(f"stretched to 8 bits: {result.stretch.low:g} to {result.stretch.high:g} ({result.stretch.how})")
    lines.append(
        f"geometry within {result.lattice_error:.4f} px of the exact model (tolerance {result.tolerance:g} px), "
        f"{sum(result.seconds.values()):.1f} s"
    )
    beside = [str(path) for path in (result.labels, result.vectors, result.item) if path]
    return "\n".join(lines + ([f"beside it: {', '.join(beside)}"] if beside else []))


def colour_words(overlaps: int, before: float, after: float) -> str:
    """Say what balancing did, with the decimals that the values ask for."""
    from geomosaic.report.page import decimals

    digits = decimals(before, 2)
    return f"colour difference in {overlaps} overlaps: {before:.{digits}f} before, {after:.{digits}f} after"


def size_words(grid: Grid) -> str:
    """Say a grid in a few words."""
    from geomosaic.inputs.frames import crs_name

    x, y = grid.resolution
    pixel = f"{x:g}" if math.isclose(x, y) else f"{x:g} x {y:g}"
    unit = grid.crs.axis_info[0].unit_name if grid.crs.axis_info else "units"
    return f"{grid.width} x {grid.height} pixels of {pixel} {unit}, {crs_name(grid.crs)}"


def share(pixels: int, grid: Grid) -> str:
    """Part of a grid in per cent."""
    return f"{100 * pixels / (grid.width * grid.height):.1f} %"


def rms(values: list[float]) -> float:
    """Root mean square."""
    return math.sqrt(sum(v * v for v in values) / max(1, len(values)))


def finite(value: float) -> float | None:
    """JSON knows no NaN."""
    number = float(value)
    return number if math.isfinite(number) else None


def status_words(states: Sequence[State]) -> str:
    """Table of steps: what `status` shows."""
    width = max(len(state.name) for state in states)
    lines = []
    for state in states:
        said = state.reason if state.fresh or state.reason == "never run" else f"stale: {state.reason}"
        last = f"  ({state.seconds:.1f} s, {state.finished})" if state.seconds is not None else ""
        lines.append(f"{state.name:<{width}}  {said}{last}")
    return "\n".join(lines)


def outcome_words(done: Outcome) -> str:
    """Say what ran and what came out."""
    width = max(len(state.name) for state in done.states)
    lines = [f"{s.name:<{width}}  {'fresh' if s.fresh else f'{s.seconds:.1f} s ({s.reason})'}" for s in done.states]
    facts = done.facts
    ran = any(state.name == "mosaic" and not state.fresh for state in done.states)
    return "\n".join(
        [
            *lines,
            *(reuse_words(facts["mosaic"]) if ran else ()),
            *accuracy_words(facts),
            *(f"{k}: {v}" for k, v in facts["outputs"].items()),
        ]
    )


def reuse_words(made: Mapping[str, Any]) -> list[str]:
    """Say what a run of the mosaic took from the run before."""
    lines = []
    if made.get("reused"):
        lines.append(f"mosaic: {made['units'] - made['reused']} of {made['units']} units computed, the rest kept")
    if made.get("recalled"):
        lines.append(f"as before: {', '.join(made['recalled'])}")
    return lines


def accuracy_words(facts: Mapping[str, Any]) -> list[str]:
    """Say how good it is, as far as that was measured."""
    lines = []
    orient, made, check = (facts.get(name) for name in ("orient", "mosaic", "check"))
    if orient:
        lines += (orient.get("planar") or {}).get("summary", [])
        for role in ("control", "check"):
            value = orient[f"rms_{role}_px"]
            if value is not None:
                number = sum(1 for point in orient["control"] if point["role"] == role)
                lines.append(f"{role} points: {value:.2f} px RMS over {number} measurements")
    if made:
        lines.append(
            f"geometry: interpolated within {made['lattice_error_px']:.4f} px (tolerance {made['tolerance_px']:g} px)"
        )
        if made["overlaps"] and made["balanced"]:
            before, after = rms(made["before"]), rms(made["after"])
            lines.append(colour_words(made["overlaps"], before, after))
    if check and check["reference"]:
        found = check["reference"]
        lines.append(
            f"registration on {check['reference_path']}: {found['registration_rms_px']:.3f} px RMS "
            f"({found['matched']} of {found['tiles']} places matched)"
        )
    return lines


def verdict(failure: QualityError | None, as_json: bool) -> int:
    """Exit code; the failed thresholds are told unless JSON has said them already."""
    if failure is None:
        return 0
    if not as_json:
        raise failure
    return failure.exit_code
