"""Measure a map at check points.

Help group: Orientation and accuracy
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.options import FILE, debug_option, json_option, options_of, stack
from geomosaic.cli.output import answer, notes, say
from geomosaic.cli.values import Scale
from geomosaic.options.control import ControlOptions, FitOptions

if TYPE_CHECKING:
    from geomosaic.accuracy.check_points import MapCheck

check_options = stack(
    click.option(
        "--points",
        "--gcps",
        "points",
        type=FILE,
        required=True,
        help="Check points: any file of control, or a table with measured_x, measured_y.",
    ),
    options_of(ControlOptions, "reading", made=False, without=("gcps", "near")),
    options_of(FitOptions, "policy", made=False, only=("insist",)),
    click.option("--raster-crs", metavar="CRS", help="CRS of the raster, where it names none."),
    click.option(
        "--survey-rms",
        type=click.FloatRange(0),
        default=0.0,
        metavar="UNITS",
        help="RMS error of the true places themselves, in map units.",
    ),
    click.option(
        "--max-rms",
        type=click.FloatRange(0, min_open=True),
        metavar="PIXELS",
        help="Exit with 3 where the total RMS is larger, in pixels of the raster.",
    ),
    click.option(
        "--map-scale",
        type=Scale(),
        help="Exit with 3 where the total RMS is larger than 0.3 mm at this scale; see `geomosaic plan product`.",
    ),
    click.option(
        "--max-rms-map",
        type=click.FloatRange(0, min_open=True),
        metavar="UNITS",
        help="The same in map units.",
    ),
    click.option(
        "--target",
        type=FILE,
        metavar="PLAN",
        help="Exit with 3 where the map misses a plan of `geomosaic plan product --json`: position, pixel, survey.",
    ),
    json_option,
    debug_option,
)


def accuracy_of_scale(found: MapCheck, scale: float | None) -> list[tuple[str, float, float]]:
    """Accuracy that a scale of a map asks for: 0.3 mm on paper.

    Parameters
    ----------
    found : MapCheck
    scale : float or None
        Denominator.

    Returns
    -------
    list of tuple
        Unit, total RMS of the map, and limit; empty without a scale.
    """
    if scale is None:
        return []
    from geomosaic.errors import InputError
    from geomosaic.geo.units import linear_unit
    from geomosaic.planning.k28 import position_error

    crs = found.grid.crs
    if not crs.is_projected:
        raise InputError(
            "a map in degrees has no scale", where="--map-scale", hint="reproject the raster first, or use --max-rms"
        )
    return [("m", found.statistics.rms_total * linear_unit(crs), position_error(scale))]


@click.command()
@click.argument("raster", type=FILE)
@check_options
def command(
    raster: Path, points: Path, as_json: bool, reading: dict[str, Any], policy: dict[str, Any], **flags: Any
) -> int:
    """Measure the accuracy of a georeferenced raster at points whose places are known.

    The points have true x, y and where they are seen: col, row in the raster, or measured_x, measured_y in its CRS.
    Points of role 'check' judge; where none has that role, all do.

    \b
    Example:
      geomosaic check map.tif --points check.csv --crs EPSG:32633 --max-rms 1.0
      geomosaic plan product --ortho-scale 1:5000 --camera-constant 150 --json > plan.json
      geomosaic check map.tif --points check.csv --target plan.json
    """
    from geomosaic.accuracy.check_points import check
    from geomosaic.accuracy.product_check import judge, read_target
    from geomosaic.cli.measured_results import check_facts, check_words
    from geomosaic.errors import QualityError

    target = read_target(flags["target"]) if flags["target"] is not None else ()
    with notes():
        found = check(
            raster,
            points,
            raster_crs=flags["raster_crs"],
            survey_rms=flags["survey_rms"],
            **reading,
            **policy,
        )
    for finding in found.diagnostics:
        say(str(finding))
    limits = (
        ("px", found.pixel_rms_total, flags["max_rms"]),
        (found.statistics.unit, found.statistics.rms_total, flags["max_rms_map"]),
        *accuracy_of_scale(found, flags["map_scale"]),
    )
    failed = [(value, limit, unit) for unit, value, limit in limits if limit is not None and not value <= limit]
    verdicts = judge(found, target) if target else ()
    missed = [verdict.words for verdict in verdicts if not verdict.passed]
    facts = {
        **check_facts(found),
        "passed": not failed and not missed,
        "target": [
            {"name": v.requirement.name, "value": v.value, "least": v.requirement.least, "most": v.requirement.most,
             "unit": v.requirement.unit, "passed": v.passed}
            for v in verdicts
        ],
    }  # fmt: skip
    answer(facts, "\n".join([check_words(found), *(verdict.words for verdict in verdicts)]), as_json)
    if not failed and not missed:
        return 0
    if not as_json:
        rms = (f"total RMS {value:.4g} {unit}, limit {limit:g} {unit}" for value, limit, unit in failed)
        what = "; ".join([*rms, *missed])
        raise QualityError(what, where=str(raster), hint="look at the largest errors and the systematic shift")
    return QualityError.exit_code
