"""Stretch, sharpen or pan-sharpen a raster for print.

Help group: Maps
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import FILE, debug_option, json_option, overwrite_option
from geomosaic.cli.output import answer, notes
from geomosaic.cli.sheet_flags import look_options


@click.command()
@click.argument("raster", type=FILE)
@look_options
@click.option("--radius", type=click.FloatRange(0.3, 50), help="Of sharpening, pixels.  [default: 1]")
@click.option("--pan", type=FILE, help="Sharpen the bands with this panchromatic raster; keeps the sample type.")
@click.option(
    "--method",
    type=click.Choice(["regression", "brovey", "weighted"]),
    default="regression",
    show_default=True,
    help="Of pan-sharpening.",
)
@click.option("-f", "--driver", type=click.Choice(["COG", "GTiff"]), default="COG", show_default=True, help="Format.")
@click.option("-o", "--output", type=FILE, required=True, help="File to write.")
@overwrite_option
@json_option
@debug_option
def command(raster: Path, pan: Path | None, output: Path, method: str, as_json: bool, **flags: Any) -> None:
    """Make an 8-bit picture for print of a raster, or give its bands the detail of a panchromatic one.

    Without --pan the bands are stretched, their local contrast evened, shaded by a hillshade and sharpened, in this
    order.
    With --pan all bands (or those of -b) are brought to the pixels of the pan raster, which must be in the same CRS.

    \b
    Examples:
      geomosaic enhance scene.tif -b 4,3,2 --stretch percentile --gamma 1.2 -o print.tif
      geomosaic enhance xs.tif --pan pan.tif --method regression -o sharp.tif
    """
    from geomosaic.enhancement.raster import enhance, pan_sharpen
    from geomosaic.errors import InputError

    common = {"driver": flags.pop("driver"), "overwrite": flags.pop("overwrite")}
    with notes():
        if pan is not None:
            used = [
                f"--{key}"
                for key in ("stretch", "limits", "percentiles", "gamma", "clahe", "sharpen", "radius", "hillshade")
                if flags[key] is not None
            ]
            if used:
                raise InputError(
                    f"{', '.join(used)} goes with a picture, --pan with measurements",
                    where="--pan",
                    hint="pan-sharpen first, then enhance the result",
                )
            made = pan_sharpen(raster, pan, output, method=method, bands=flags["bands"], **common)
            model = made.model
            weights = [float(w) for w in model.weights]
            facts = {
                "output": str(output),
                "method": method,
                "weights": weights,
                "offset": model.offset,
                "r2": model.r2,
            }
            shown = ", ".join(f"{w:.4g}" for w in weights)
            answer(
                facts, f"{output}: the bands explain {100 * model.r2:.1f} % of the pan band (weights {shown})", as_json
            )
            return
        enhance(raster, output, **flags, **common)
    answer({"output": str(output)}, str(output), as_json)
