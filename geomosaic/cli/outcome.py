"""What a run of a project came to, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from geomosaic.cli.words import colour_words, rms

if TYPE_CHECKING:
    from geomosaic.errors import QualityError
    from geomosaic.jobs.project import Outcome
    from geomosaic.jobs.step import State


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
