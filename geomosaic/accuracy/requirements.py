"""Verdicts on a finished map: accuracy and pixel size against the target that its flight was planned for."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geomosaic.accuracy.check_points import MapCheck
from geomosaic.errors import InputError, did_you_mean
from geomosaic.planning.product_quality import Requirement
from geomosaic.planning.relations import QUANTITIES

SEEN = ("position_error", "ortho_pixel", "control_error")
"""What a finished map and its check points show; the rest of a plan concerns photos, scans and heights."""
EVEN = 1e-9
"""Relative excess that rounding may cause: a pixel of 0.5 m holds a target of 0.5 m."""


@dataclass(frozen=True)
class Verdict:
    """Verdict on one requirement: the value that the map has, and whether that meets it.

    Attributes
    ----------
    requirement : Requirement
    value : float
        In the requirement's unit.
    passed : bool
    """

    requirement: Requirement
    value: float
    passed: bool

    @property
    def words(self) -> str:
        """Verdict in one line of text."""
        r = self.requirement
        least = None if r.least is None else f">= {r.least:g}"
        limits = " and ".join(part for part in (least, None if r.most is None else f"<= {r.most:g}") if part)
        return f"{r.text}: {self.value:.4g} {r.unit}, target {limits} {r.unit}: {'met' if self.passed else 'MISSED'}"


def read_target(path: Path) -> tuple[Requirement, ...]:
    """Requirements from the JSON of `geomosaic plan product --json`, or a TOML file of largest values by name.

    Parameters
    ----------
    path : Path
        Suffix .json for a plan; any other is read as TOML, values in metres.

    Returns
    -------
    tuple of Requirement
        All that the file holds, also those that a finished map does not show.

    Raises
    ------
    InputError
        The file is no plan, or holds nothing that a finished map shows.
    """
    try:
        text = path.read_text(encoding="utf-8")
        found = _plan(json.loads(text)) if path.suffix.lower() == ".json" else _table(tomllib.loads(text))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"the target cannot be read ({error})", where=str(path), hint=_MEND) from error
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise InputError(
            "this is no plan of a product, or a limit is no number", where=str(path), hint=_MEND
        ) from error
    if not any(requirement.name in SEEN for requirement in found):
        raise InputError(
            "the target holds nothing that a finished map shows", where=str(path), hint=f"give {', '.join(SEEN)}"
        )
    return found


_MEND = (
    "write it by `geomosaic plan product ... --json > plan.json`, or as TOML with position_error, ortho_pixel and "
    "control_error in metres"
)


def _plan(data: Any) -> tuple[Requirement, ...]:
    made = (
        Requirement(
            str(r["name"]),
            _text(str(r["name"])),
            _limit(r["least"]),
            _limit(r["most"]),
            str(r["unit"]),
            str(r["source"]),
        )
        for r in data["requirements"]
    )
    return tuple(made)


def _limit(value: Any) -> float | None:
    """A limit of a requirement; None where it is open."""
    if value is None:
        return None
    if isinstance(value, bool) or not 0 <= float(value) < math.inf:
        raise ValueError(value)
    return float(value)


def _table(data: Mapping[str, Any]) -> tuple[Requirement, ...]:
    for name in data:
        if name not in SEEN:
            raise InputError(f"a target has no '{name}'", hint=did_you_mean(name, SEEN) or f"it has {', '.join(SEEN)}")
    return tuple(Requirement(name, _text(name), None, _limit(value), "m", "target") for name, value in data.items())


def _text(name: str) -> str:
    own = {"position_error": "error of position at check points", "control_error": "error of the check points' survey"}
    return own.get(name) or (QUANTITIES[name].text if name in QUANTITIES else name.replace("_", " "))


def judge(found: MapCheck, target: tuple[Requirement, ...]) -> tuple[Verdict, ...]:
    """Verdicts on all requirements of a target that a finished map shows.

    Parameters
    ----------
    found : MapCheck
        `statistics.survey_rms` is judged where it was given.
    target : tuple of Requirement

    Returns
    -------
    tuple of Verdict
        In the order of the target.

    Raises
    ------
    InputError
        The map is in degrees.
    """
    from geomosaic.geo.units import linear_unit

    crs = found.grid.crs
    if not crs.is_projected:
        raise InputError("a map in degrees has no pixel in metres", where="`target`", hint="reproject the raster first")
    # Targets are in metres; errors and pixels of the map may be in feet.
    metres = linear_unit(crs)
    values = {
        "position_error": found.statistics.rms_total * metres,
        "ortho_pixel": max(found.grid.resolution) * metres,
        "control_error": found.statistics.survey_rms * metres,
    }
    out = []
    for requirement in target:
        # A survey error of 0 stands for one that was not given: it is not judged.
        known = requirement.name in SEEN and (requirement.name != "control_error" or found.statistics.survey_rms > 0)
        if known:
            value = values[requirement.name]
            enough = requirement.least is None or value >= requirement.least * (1 - EVEN)
            passed = enough and (requirement.most is None or value <= requirement.most * (1 + EVEN))
            out.append(Verdict(requirement, value, passed))
    return tuple(out)
