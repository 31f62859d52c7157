"""How photos were placed by plane transformations, in words."""

from __future__ import annotations

from collections.abc import Mapping
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
            f"uncontrolled, {model}: {count} photos joined outwards from {facts['start']}, "
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
            f"grown, {model}: {count} photos from {facts['photos'][0]['photo']}, "
            f"{counted(len(facts['joins']), 'join')} checked, {len(facts['failed_joins'])} failed, "
            f"gaps {facts['gaps_px']:.2f} px RMS"
        )
    elif facts["rectified"] == "singly":
        lines.append(
            f"controlled, {model}: {count} photos rectified singly, gaps at ties {facts['gaps_px']:.2f} px RMS"
        )
    else:
        weight = f", {facts['sigma0']:.2f} times their sigmas" if facts["sigma0"] is not None else ""
        lines.append(
            f"{kind}, {model}: {count} photos adjusted together, {facts['equations']} equations, redundancy "
            f"{facts['redundancy']}, residuals {facts['rms_px']:.2f} px RMS{weight}"
        )
    return lines
