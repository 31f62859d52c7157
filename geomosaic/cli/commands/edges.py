"""Join photos with control at their edges, and mosaic them.

Help group: Orthos and mosaics
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.options import (
    ERRORS,
    FILE,
    NOT_BY_RULE,
    band_option,
    options_of,
    output_option,
    running_options,
    stack,
)
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes, progress
from geomosaic.cli.results import mosaic_facts, mosaic_text
from geomosaic.options.mosaic import EdgeMosaicOptions
from geomosaic.whole_files import finite

if TYPE_CHECKING:
    from geomosaic.orientation.edges import EdgeMatch, Misfit


@grouped_command()
@click.argument("images", type=FILE, nargs=-1, required=True, metavar="IMAGE IMAGE...")
@click.option("--gcps", "control", type=FILE, required=True, help="Control points: id, x, y, image, col, row.")
@click.option("--common", type=FILE, required=True, help="Common points: id, image, col, row [, sigma_px].")
@click.option("--crs", required=True, metavar="CRS", help="CRS of the control points, such as EPSG:32633.")
@stack(
    options_of(EdgeMosaicOptions, without=(*NOT_BY_RULE, *ERRORS, "snap", "like")),
    band_option,
    output_option,
    running_options,
)
def command(
    images: tuple[Path, ...],
    control: Path,
    common: Path,
    crs: str,
    output: Path,
    as_json: bool,
    options: dict[str, Any],
) -> None:
    """Adjust photos to control and common points together, join them exactly, and mosaic them.

    What crosses an edge through a common point meets itself. Misfits before and after are told.
    """
    from geomosaic.products.edges import match_edges

    with notes(), progress(as_json) as report:
        done = match_edges(images, output, control, common, crs, progress=report, **options)
    facts = {**mosaic_facts(done.mosaic), "edges": _facts(done.match)}
    answer(facts, f"{_summary(done.match)}\n{mosaic_text(done.mosaic)}", as_json)


def _facts(matched: EdgeMatch) -> dict[str, Any]:
    from geomosaic.inputs.planar_facts import gross_error_facts

    s = matched.stations
    return {
        "sigma0": finite(matched.sigma0),
        "redundancy": matched.redundancy,
        "accuracy": matched.expected.facts,
        **gross_error_facts(matched.findings),
        "before": _misfit(matched.before),
        "after": _misfit(matched.after),
        "joined": _misfit(matched.joined),
        "residuals": [
            {"id": s.ids[k], "image": matched.photos[i].name, "col": float(v[0]), "row": float(v[1])}
            for k, i, v in zip(s.station, s.photo, matched.residuals, strict=True)
        ],
    }


def _misfit(misfit: Misfit) -> dict[str, Any]:
    points = zip(misfit.ids, misfit.pairs, misfit.lengths.tolist(), strict=True)
    return {
        "rms_px": finite(misfit.rms),
        "largest_px": finite(misfit.largest),
        "points": [{"id": name, "images": list(pair), "px": finite(length)} for name, pair, length in points],
    }


def _summary(matched: EdgeMatch) -> str:
    from geomosaic.estimation.expected_errors import expected_text, share_text
    from geomosaic.inputs.planar_facts import gross_error_facts, gross_error_lines

    stages = (
        ("each photo by its own control", matched.before),
        ("adjusted together", matched.after),
        ("joined exactly", matched.joined),
    )
    lines = [f"misfit at {len(set(matched.after.ids))} shared points, in pixels:      rms  largest"]
    lines += [f"  {name:<40} {stage.rms:7.3f}  {stage.largest:7.3f}" for name, stage in stages]
    accuracy = matched.expected.facts
    lines.append(f"sigma0 {matched.sigma0:.2f}, redundancy {matched.redundancy}{share_text(accuracy)}")
    lines.append(expected_text(accuracy))
    return "\n".join([*lines, *gross_error_lines(gross_error_facts(matched.findings)["wrong_points"])])
