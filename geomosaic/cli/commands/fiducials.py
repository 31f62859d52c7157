"""Find the fiducial marks of scanned films.

Help group: Orientation and accuracy
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import FILE, options_of, running_options
from geomosaic.cli.output import answer, notes
from geomosaic.cli.values import Number
from geomosaic.limits import POSITIVE
from geomosaic.options.control import SearchOptions


@click.command()
@click.argument("scans", type=FILE, nargs=-1, required=True, metavar="SCAN...")
@click.option("--camera", type=FILE, required=True, help="Calibration certificate (TOML).")
@click.option("--template", type=FILE, required=True, help="Picture of one mark, or a scan that shows one.")
@click.option(
    "--at", type=Number(), nargs=2, metavar="COL ROW", help="Place of a mark in the template, if that is a scan."
)
@click.option("--pixel-size", type=Number(limits=POSITIVE), required=True, help="Pixels of the scans, µm.")
@options_of(SearchOptions, "search", without=("pixel_size",))
@click.option("-o", "--output", type=FILE, required=True, help="Table to write.")
@click.option("--overwrite", is_flag=True, help="Replace the table if it exists.")
@running_options
def command(
    scans: tuple[Path, ...], output: Path, overwrite: bool, as_json: bool, search: dict[str, Any], **flags: Any
) -> None:
    """Find the fiducial marks of scanned films, given a picture of one of them.

    \b
    Example:
      geomosaic fiducials scans/*.tif --camera certificate.toml \\
        --template scans/0417.tif --at 512 498 --pixel-size 14 -o marks.csv
    """
    from geomosaic.fiducials import find_fiducials

    with notes():
        found = find_fiducials(
            scans,
            flags["camera"],
            flags["template"],
            flags["pixel_size"],
            at=flags["at"] or None,
            **search,
            output=output,
            overwrite=overwrite,
        )
    words, facts = [], {}
    for image, marks in found.items():
        there = [mark for mark in marks.values() if mark.found]
        missing = [name for name, mark in marks.items() if not mark.found]
        worst = f", sigmas by noise up to {max(mark.sigma for mark in there):.3f} px" if there else ""
        lost = f"; not found: {', '.join(missing)}" if missing else ""
        words.append(f"{image}: {len(there)} of {len(marks)} fiducials found{worst}{lost}")
        facts[image] = {
            name: {"col": mark.col, "row": mark.row, "sigma": mark.sigma, "correlation": mark.correlation}
            for name, mark in marks.items()
            if mark.found
        }
    answer({"output": str(output), "fiducials": facts}, "\n".join([*words, f"{output} written"]), as_json)
