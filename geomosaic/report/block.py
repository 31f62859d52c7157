"""Report of a block adjustment as one HTML file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from geomosaic.errors import counted, listed
from geomosaic.options.naming import flag, renamed_values
from geomosaic.report.block_figures import BlockFigures
from geomosaic.report.page import card, decimals, length_text, number, rendered

# Rows of a table; the JSON twin has them all.
MOST_ROWS = 300
COLOURS = {"control": "#12303f", "check": "#8a4fbf", "rejected": "#d3261b", "camera": "#1f6f8b"}
SIGNS = {"control": "▲", "check": "●", "rejected": "✕"}
WORDS = {"control": "control point", "check": "check point", "rejected": "left out as a blunder"}
# Movement along the weakest direction, pixels, from which on it is a warning.
WEAK = 3.0
# Errors of check points over their standard deviations (RMS) from which on something systematic is left, and the points
# that tell: those of a block err together, so that 1.5 is no rarity.
OFF, TELLING = 2.0, 3
# Standard deviations of its change below which a parameter of the interior orientation is better held.
SIGNIFICANT = 2.0


def render_block(
    facts: Mapping[str, Any],
    figures: BlockFigures,
    name: str,
    notes: Sequence[str] = (),
    ties: str = "",
) -> str:
    """HTML page of a block adjustment.

    Parameters
    ----------
    facts : mapping
        `geomosaic.orientation.block.facts.block_facts`, and `described`: what went in, in words.
    figures : BlockFigures
    name : str
        Of the block.
    notes : sequence of str
        What the user was warned of.
    ties : str
        HTML of the section on tie points, from `render_tie_section`.

    Returns
    -------
    str
        HTML; text from files is escaped, and nothing is loaded from elsewhere.
    """
    moved = {each["name"]: each["pixels"] for each in facts["weakest"]}
    metres = [v for v in facts["points"]["median_sigmas"] if _known(v)]
    return rendered(
        "block",
        **renamed_values({"described": counted(len(facts["images"]), "image"), **facts}, flag),
        name=name,
        notes=[*warnings(facts), *notes],
        cards=_cards(facts),
        figures=figures,
        story=_sigma0_text(facts),
        tables=_image_tables(facts, moved),
        digits=min(decimals(min(metres, default=0.01), 3), 5),
        colours=COLOURS,
        signs=SIGNS,
        words_of=WORDS,
        states=[state for state in WORDS if any(mark.state == state for mark in figures.map.marks)],
        causes=_causes(facts),
        most=MOST_ROWS,
        significant=SIGNIFICANT,
        tie_section=ties,
    )


def _cards(facts: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Key figures of a block report."""
    low, high = facts["sigma0_bounds"]
    sigma0, points = facts["sigma0"], facts["points"]
    text = f"99 % lie between {number(low)} and {number(high)} where all standard deviations given are right."
    passed = (
        None if not facts["redundancy"] else True if facts["sigma0_as_expected"] else False if sigma0 > high else None
    )
    found = [card("Sigma0", number(sigma0), "", text, passed=passed)]
    images = facts["observations"][0]
    text = f"Length of the residuals of {images['used']} image positions."
    found.append(card("Image residuals, RMS", number(images["rms"], 2), "px", text))
    (x, y, z), unit = points["median_sigmas"], facts["length_unit"]
    plan = math.hypot(x, y) if _known(x) and _known(y) else None
    text = f"Median over {points['adjusted']} points; in height {length_text(z, unit)}."
    found.append(card("Points, 1 sigma in plan", *length_text(plan, unit).partition(" ")[::2], text))
    checks = facts["checks"]
    if checks["count"]:
        height = length_text(checks["rms_height"], unit)
        text = f"Of {counted(checks['count'], 'point')} that took no part; in height {height}."
        found.append(
            card("Check points, RMS in plan", *length_text(checks["rms_plan"], unit).partition(" ")[::2], text)
        )
    count = len(facts["blunders"])
    share = count / max(sum(each["used"] + each["rejected"] for each in facts["observations"]), 1)
    text = (
        f"{100 * share:.2g} % of all measurements, left out; each is named below." if count else "Nothing was left out."
    )
    found.append(card("Blunders", str(count), "", text))
    text = "Measurements more than the unknowns need."
    found.append(card("Redundancy", str(facts["redundancy"]), "", text, passed=facts["redundancy"] > 0))
    return found


def warnings(facts: Mapping[str, Any]) -> list[str]:
    """What a reader should not miss.

    Parameters
    ----------
    facts : mapping
    """
    found = [facts["reservation"][:1].upper() + facts["reservation"][1:] + "."] if facts["reservation"] else []
    if len(facts["parts"]) > 1:
        listing = [f"{counted(len(part), 'image')} ({listed(part, 3)})" for part in facts["parts"]]
        found.append(
            f"The images form {len(listing)} parts without enough common points: {listed(listing, 6, '; ')}. "
            "Each lies where its own control puts it."
        )
    for each in facts["patterns"]:
        if each["systematic"]:
            found.append(
                f"Residuals of {each['camera']} depend on the place in the image ({each['mean_rms_px']:.2f} px RMS of "
                "their means): its interior orientation has errors, or parameters are missing."
            )
    found += [_sentence(each["text"]) for each in facts["wrong_groups"]]
    found += [_sentence(facts["tie_scatter"]["text"])] if facts["tie_scatter"] else []
    whole = {each["kind"] for each in facts["wrong_groups"]}
    for group in facts["observations"]:
        if group["too_large"] and group["name"] not in whole:
            factor = math.sqrt(group["variance_factor"])
            found.append(
                f"{group['name'].capitalize()} are {factor:.2g} times worse than their standard deviations say."
            )
    for axis, where in (((0, 1), "in plan"), ((2,), "in height")):
        off = _over_sigmas(facts["checks"]["points"], axis)
        if off is not None and off > OFF:
            found.append(
                f"Check points are off {where} by {off:.2g} times what the standard deviations say: an error that the "
                "residuals do not show, of a lens, of the control or of a datum."
            )
    if facts["correlated"]:
        listing = [f"{c['one']} and {c['other']} ({c['correlation']:+.3f})" for c in facts["correlated"]]
        found.append(
            f"Parameters whose correlation is above 0.95 cannot be told apart: {listed(listing, 4, '; ')}. Hold one of "
            "them, or give the block what tells them apart: crossing strips, oblique images, other flying heights."
        )
    if facts["insignificant"]:
        listing = [each["parameter"] for each in facts["insignificant"]]
        found.append(
            f"Parameters that did not change by two standard deviations are better held: {listed(listing, 6)}."
        )
    found += [f"{offered_text(each)}." for each in facts["offered"]]
    weak = [each for each in facts["weakest"] if each["pixels"] > WEAK]
    if weak:
        listing = [f"{each['name']} by {each['pixels']:.2g} px" for each in weak]
        found.append(f"In the direction that is determined worst, one standard deviation moves {listed(listing, 4)}.")
    return found


def offered_text(offered: Mapping[str, Any]) -> str:
    """Offer to free parameters of an interior orientation that is held, in words.

    Parameters
    ----------
    offered : mapping
        One of the facts `offered` of a block adjustment.
    """
    own = offered["parameters"]
    moved = []
    for each in own:
        change = f"{each['change']:+.3g} {each['unit']}".strip()
        moved.append(f"{each['name']} by {change} ({abs(each['change']) / each['sigma']:.0f} standard deviations)")
    fit = f"sigma0 from {offered['sigma0_before']:.3g} to {offered['sigma0']:.3g}"
    if offered["restored"]:
        fit += ", with the control or positions that were left out"
    names, one = ", ".join(f'"{each["name"]}"' for each in own), len(own) == 1
    return (
        f"{counted(len(offered['images']), 'image')} of one camera: interior = [{names}] would change "
        f"{listed(moved, 12)}, and {fit}; this block determines {'it' if one else 'them'}"
    )


def _over_sigmas(points: Sequence[Mapping[str, Any]], axes: Sequence[int]) -> float | None:
    """RMS of errors over their standard deviations, of adjusted and given places; None of too few points."""
    found = []
    for point in points:
        for axis in axes:
            error, own, given = (point[key][axis] for key in ("errors", "sigmas", "sigmas_given"))
            # The block may well be better than what checks it.
            if _known(error) and _known(own) and _known(given) and own > 0.0:
                found.append((error / math.hypot(own, given)) ** 2)
    return math.sqrt(sum(found) / len(found)) if len(found) >= TELLING * len(axes) else None


def _sigma0_text(facts: Mapping[str, Any]) -> str:
    """Test of sigma0 in a sentence."""
    low, high = facts["sigma0_bounds"]
    if not facts["redundancy"]:
        return "nothing checks the measurements: there are no more than the unknowns need"
    said = f"{number(facts['sigma0'])}, with a redundancy of {facts['redundancy']}"
    if facts["sigma0_as_expected"]:
        return f"{said}: within the 99 % bounds of {number(low)} and {number(high)}, as the standard deviations say"
    if facts["sigma0"] > high:
        return (
            f"{said}: above the 99 % bound of {number(high)}; the measurements are worse than declared, or a model is "
            "too simple"
        )
    return f"{said}: below the 99 % bound of {number(low)}; the measurements are better than declared"


def _image_tables(facts: Mapping[str, Any], moved: Mapping[str, float]) -> list[dict[str, Any]]:
    """Tables of images, one for each set of parameters, the largest residuals first."""
    kinds: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for image in facts["images"]:
        kinds.setdefault(tuple(image["sigmas"]), []).append({**image, "moved": moved.get(image["name"])})
    found = []
    for names, images in kinds.items():
        images.sort(key=lambda each: -each["rms_px"] if _known(each["rms_px"]) else -math.inf)
        units = images[0]["units"]
        columns = []
        for name in names[:8]:
            sigmas = sorted(s for each in images if _known(s := each["sigmas"][name]) and s > 0.0)
            if sigmas:
                columns.append((name, units[name], decimals(sigmas[len(sigmas) // 2])))
        found.append({"images": images, "columns": columns, "omitted": len(names) - 8})
    return found


def _causes(facts: Mapping[str, Any]) -> list[tuple[str, int]]:
    """Kinds of causes of blunders with their numbers, most frequent first."""
    kinds = {
        "exchanged with": "points exchanged", "wrong id": "wrong id", "wrong image": "wrong image",
        "height is wrong": "wrong height", "moved by": "moved, or measured on something else",
        "x and y": "x and y exchanged", "no two": "no two rays of the point agree",
        "its two rays": "two rays that do not meet",
        "three rays": "one of three rays",
        "no other shows it": "control that one image alone shows",
        "agrees with its coordinates": "position in one image, or its control point",
    }  # fmt: skip
    count: dict[str, int] = {}
    for each in facts["blunders"]:
        known = next((words for key, words in kinds.items() if key in each["cause"]), "")
        words = known or each["cause"] or "no cause found"
        count[words] = count.get(words, 0) + 1
    return sorted(count.items(), key=lambda each: -each[1])


def _sentence(text: str) -> str:
    ending = "" if text.endswith("?") else "."
    return f"{text[:1].upper()}{text[1:]}{ending}"


def _known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)
