"""Summary of a block adjustment in some twenty lines."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from geomosaic.errors import counted, listed
from geomosaic.report.block import offered_text

# Blunders, weak images and parameters that are listed one by one.
MOST_LISTED = 5


def summary_lines(facts: Mapping[str, Any]) -> list[str]:
    """Result of a block adjustment in words.

    Parameters
    ----------
    facts : mapping
        `AdjustedBlock.facts`.
    """
    images, points = facts["observations"][0], facts["points"]
    lines = [
        f"{facts['described']}, {counted(points['adjusted'], 'point')}, "
        f"{counted(images['used'] + images['rejected'], 'image position')}; {facts['crs']}",
        _sigma0(facts),
        *(_group(each) for each in facts["observations"] if each["used"] or each["rejected"]),
    ]
    groups = [*facts["wrong_groups"], *([facts["tie_scatter"]] if facts["tie_scatter"] else [])]
    lines += [each["text"][:1].upper() + each["text"][1:] for each in groups]
    sigmas = [value for value in points["median_sigmas"] if value is not None]
    if len(sigmas) == 3:
        lines.append(
            "points, median standard deviation: "
            + ", ".join(f"{n} {v:.3g}" for n, v in zip("xyz", sigmas, strict=True))
            + f" {facts['length_unit']}"
        )
    for name, words in (("control", "control points"), ("checks", "check points")):
        table = facts[name]
        if table["count"]:
            lines.append(f"{words}: {table['count']}, RMS {_rms(table)}")
    lines += _reliability(images, facts["length_unit"])
    lines += _blunders(facts["blunders"])
    lines += _further(facts["further"])
    for camera in facts["cameras"]:
        moved = [
            f"{p['name']} {p['before']:.6g} -> {p['after']:.6g} ± {p['sigma']:.2g} {p['unit']}"
            for p in camera["parameters"]
        ]
        lines.append(f"camera of {counted(len(camera['images']), 'image')}: {listed(moved, 12)}")
    if facts["correlated"]:
        pairs = [f"{c['one']} and {c['other']} {c['correlation']:+.3f}" for c in facts["correlated"]]
        lines.append(f"correlated above 0.95, so that they cannot be told apart: {listed(pairs, MOST_LISTED)}")
    if facts["insignificant"]:
        names = [p["parameter"] for p in facts["insignificant"]]
        lines.append(f"moved by less than two standard deviations, better held: {listed(names, MOST_LISTED)}")
    lines += [offered_text(each) for each in facts["offered"]]
    if facts["reservation"]:
        lines.append(facts["reservation"])
    weak = [f"{each['name']} {each['pixels']:.2g} px" for each in facts["weakest"][:3]]
    if weak:
        lines.append(f"weakest direction (one standard deviation): {listed(weak, 3)}")
    return lines


def _sigma0(facts: Mapping[str, Any]) -> str:
    low, high = facts["sigma0_bounds"]
    if not facts["redundancy"]:
        return "sigma0: nothing checks the measurements, there are no more than the unknowns need"
    said = f"sigma0 {facts['sigma0']:.3f}, redundancy {facts['redundancy']}: "
    if facts["sigma0_as_expected"]:
        return said + f"as the standard deviations say (99 % lie between {low:.3f} and {high:.3f})"
    larger = facts["sigma0"] > high
    return said + (
        f"above {high:.3f}: the measurements are worse than their standard deviations say, or a model is too simple"
        if larger
        else f"below {low:.3f}: the measurements are better than their standard deviations say"
    )


def _group(each: Mapping[str, Any]) -> str:
    out = f", {each['rejected']} left out" if each["rejected"] else ""
    factor = each["variance_factor"]
    fits = f", {math.sqrt(factor):.2f} of their standard deviations" if factor is not None else ""
    return f"  {each['name']}: {each['used']}{out}, RMS {_number(each['rms'])} {each['unit']}{fits}"


def _reliability(images: Mapping[str, Any], unit: str) -> list[str]:
    """What an error of an image position may do unseen."""
    size, shift = images["detectable"]["median"], images["shift"]["median"]
    if size is None or not math.isfinite(size):
        return []
    moved = "" if shift is None or not math.isfinite(shift) else f", and move its point by {shift:.2g} {unit}"
    out = f"; {images['unchecked']} are not checked in every direction" if images["unchecked"] else ""
    return [f"an image position may be wrong by {size:.2g} px unnoticed (median){moved}{out}"]


def _further(found: list[Mapping[str, Any]]) -> list[str]:
    """Strips, lakes, planes, lines and rigs, the first of them one by one."""
    lines = [_further_text(each) for each in found if each["observations"]]
    more = [f"and {len(lines) - MOST_LISTED} more strips, lakes, planes, lines or rigs, in adjustment.json"]
    return lines if len(lines) <= MOST_LISTED else lines[:MOST_LISTED] + more


def _further_text(each: Mapping[str, Any]) -> str:
    """What several observations share (one of `further` of the facts), in words: a height, a slope, a rig's base."""
    parameters = each["parameters"]
    if "normal" in each or "direction" in each:
        x, y, z = each.get("normal") or each["direction"]
        azimuth, flat = math.degrees(math.atan2(x, y)) % 360.0, math.degrees(math.atan2(math.hypot(x, y), z))
        sigma = max(p["sigma"] for p in parameters[:2])
        said = f"slope {flat if 'normal' in each else 90.0 - flat:.2f}, azimuth {azimuth:.1f} ± {sigma:.2g} deg"
    elif angles := each.get("omega, phi, kappa"):
        sigma = max((p["sigma"] for p in parameters), default=0.0)
        said = "omega {:.{d}f}, phi {:.{d}f}, kappa {:.{d}f}".format(*angles, d=_digits(sigma)) + f" ± {sigma:.2g} deg"
    else:
        said = listed((f"{p['name']} {p['value']:.{_digits(p['sigma'])}f} ± {p['sigma']:.2g} {p['unit']}" for p in
                       parameters), 6)  # fmt: skip
    return f"{each['name']}: {said or 'held'}, of {counted(each['observations'], 'observation')}"


def _digits(sigma: float) -> int:
    """Decimals of a value: two digits of its standard deviation."""
    return min(max(1 - math.floor(math.log10(sigma)), 0), 6) if sigma > 0.0 else 3


def _number(value: float | None) -> str:
    return "?" if value is None else f"{value:.3g}"


def _rms(table: Mapping[str, Any]) -> str:
    parts = [
        f"{table[key]:.3g} m in {where}"
        for key, where in (("rms_plan", "plan"), ("rms_height", "height"))
        if table[key] is not None
    ]
    return ", ".join(parts) or "unknown"


def _blunders(found: list[Mapping[str, Any]]) -> list[str]:
    if not found:
        return []
    lines = [f"{counted(len(found), 'measurement')} left out:"]
    lines += [f"  {each['text']}" for each in found[:MOST_LISTED]]
    if len(found) > MOST_LISTED:
        lines.append(f"  and {len(found) - MOST_LISTED} more, in adjustment.json")
    return lines
