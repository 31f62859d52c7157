"""Stretch, sharpen or pan-sharpen a raster for print.

Help group: Maps
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import FILE, options_of, output_option, running_options
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes
from geomosaic.errors import InputError
from geomosaic.options.render import RenderOptions
from geomosaic.options.sheet import PAN_METHODS, EnhanceOptions, PanOptions


@grouped_command()
@click.argument("raster", type=FILE)
@options_of(EnhanceOptions)
@options_of(PanOptions, "panned", made=True)
@options_of(RenderOptions, "common", only=("driver", "overwrite", "max_output"))
@output_option
@running_options
def command(
    raster: Path,
    output: Path,
    as_json: bool,
    options: dict[str, Any],
    panned: PanOptions,
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

    with notes():
        if panned.pan is not None:
            used = [f"--{key}" for key in options if key != "bands"]
            if used:
                raise InputError(
                    f"{', '.join(used)} goes with a picture, --pan with measurements",
                    where="--pan",
                    hint="pan-sharpen first, then enhance the result",
                )
            method = panned.method or PAN_METHODS[0]
            made = pan_sharpen(raster, panned.pan, output, method=method, bands=options.get("bands"), **common)
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
        enhance(raster, output, **options, **common)
    answer({"output": str(output)}, str(output), as_json)
