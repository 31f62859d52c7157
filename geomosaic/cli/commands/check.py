"""Measure a map at check points.

Help group: Orientation and accuracy
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import FILE, options_of, running_options, stack
from geomosaic.cli.output import answer, notes, say
from geomosaic.errors import QualityError
from geomosaic.options.control import CheckOptions, FitOptions


@click.command()
@click.argument("raster", type=FILE)
@click.option(
    "--points",
    "--gcps",
    "points",
    type=FILE,
    required=True,
    help="Check points: any file of control, or a table with measured_x, measured_y.",
)
@stack(
    options_of(CheckOptions),
    options_of(FitOptions, "policy", only=("insist",)),
    running_options,
)
def command(raster: Path, points: Path, as_json: bool, options: dict[str, Any], policy: dict[str, Any]) -> int:
    """Measure the accuracy of a georeferenced raster at points whose places are known.

    The points have true x, y and where they are seen: col, row in the raster, or measured_x, measured_y in its CRS.
    Points of role 'check' judge; where none has that role, all do.

    \b
    Example:
      geomosaic check map.tif --points check.csv --crs EPSG:32633 --max-rms 1.0
      geomosaic plan product --ortho-scale 1:5000 --camera-constant 150 --json > plan.json
      geomosaic check map.tif --points check.csv --target plan.json
    """
    from geomosaic.accuracy.check_points import LIMIT
    from geomosaic.accuracy.product_check import check
    from geomosaic.cli.measured_results import check_facts, check_text

    with notes():
        found = check(raster, points, **policy, **options)
    for finding in found.diagnostics:
        say(str(finding))
    target = [verdict for verdict in found.verdicts if verdict.requirement.source != LIMIT]
    facts = {
        **check_facts(found),
        "passed": found.passed,
        "target": [
            {"name": v.requirement.name, "value": v.value, "least": v.requirement.least, "most": v.requirement.most,
             "unit": v.requirement.unit, "passed": v.passed}
            for v in target
        ],
    }  # fmt: skip
    answer(facts, "\n".join([check_text(found), *(verdict.text for verdict in target)]), as_json)
    if not found.passed and not as_json:
        what = "; ".join(verdict.text for verdict in found.verdicts if not verdict.passed)
        raise QualityError(what, where=str(raster), hint="look at the largest errors and the systematic shift")
    return 0 if found.passed else QualityError.exit_code
