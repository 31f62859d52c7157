"""How photos were placed by plane transformations, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from geomosaic.errors import counted


def placement_words(facts: Mapping[str, Any]) -> list[str]:
    """Say how the photos were placed and how well, in a line or two."""
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
            f"gaps at ties {facts['gaps_px']:.2f} px RMS"
        )
    else:
        weight = f", {facts['sigma0']:.2f} times their sigmas" if facts["sigma0"] is not None else ""
        lines.append(
            f"{kind}, {model}: {counted(count, 'photo')} adjusted together, {facts['equations']} equations, redundancy "
            f"{facts['redundancy']}, residuals {facts['rms_px']:.2f} px RMS{weight}"
        )
    return [*lines, *wrong_words(facts["wrong_points"])]


def wrong_words(found: Mapping[str, Any]) -> list[str]:
    """Whether points are wrong, and what the redundancy allows to say of it."""
    if not found["measurements"]:
        return ["wrong points cannot be looked for: the points do not hold all photos together"]
    wrong, unchecked = found["found"], found["unchecked"]
    done = "left out" if found["left_out"] else "taking part"
    named = f"{counted(len(wrong), 'wrong one')}, {done}" if wrong else "none wrong"
    size = found["detectable_px"]
    seen = "too little to find one" if size is None else f"errors of {size:.1f} px would be found"
    named = named if wrong or size is not None else "not checked"
    line = f"measurements: {found['measurements']}, {named} (redundancy {found['redundancy']}: {seen})"
    if unchecked:
        more = f" and {len(unchecked) - 3} more" if len(unchecked) > 3 else ""
        line += f"; nothing checks {', '.join(unchecked[:3])}{more}"
    return [line, *_tilted_words(found["tilted"])]


def _tilted_words(tilted: Sequence[Mapping[str, Any]]) -> list[str]:
    """Photos that the model does not follow."""
    if not tilted:
        return []
    named = ", ".join(f"{one['photo']} ({one['px']:.1f} px)" for one in tilted[:3])
    more = f" and {len(tilted) - 3} more" if len(tilted) > 3 else ""
    return [f"tilted, or on sloping ground, as this model does not follow: {named}{more}; controlled mosaics follow it"]
