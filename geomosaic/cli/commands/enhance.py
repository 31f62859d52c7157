"""Stretch, sharpen or pan-sharpen a raster for print.

Help group: Maps
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import FILE, options_of, output_option, running_options, stack
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes
from geomosaic.options.render import RenderOptions
from geomosaic.options.sheet import StretchOptions


@grouped_command()
@click.argument("raster", type=FILE)
@options_of(StretchOptions, made=False)
@stack(
    click.option("--radius", type=click.FloatRange(0.3, 50), help="Of sharpening, pixels.  [default: 1]"),
    click.option("--pan", type=FILE, help="Sharpen the bands with this panchromatic raster; keeps the sample type."),
    click.option(
        "--method",
        type=click.Choice(["regression", "brovey", "weighted"]),
        default="regression",
        show_default=True,
        help="Of pan-sharpening.",
    ),
    group="colour",
)
@options_of(RenderOptions, "common", made=False, only=("driver", "overwrite", "max_output"))
@output_option
@running_options
def command(
    raster: Path,
    pan: Path | None,
    output: Path,
    radius: float | None,
    method: str,
    as_json: bool,
    options: dict[str, Any],
    common: dict[str, Any],
) -> None:
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

    with notes():
        if pan is not None:
            given = options if radius is None else {**options, "radius": radius}
            used = [f"--{key}" for key in given if key != "bands"]
            if used:
                raise InputError(
                    f"{', '.join(used)} goes with a picture, --pan with measurements",
                    where="--pan",
                    hint="pan-sharpen first, then enhance the result",
                )
            made = pan_sharpen(raster, pan, output, method=method, bands=options.get("bands"), **common)
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
        enhance(raster, output, radius=radius, **options, **common)
    answer({"output": str(output)}, str(output), as_json)
