"""Find a radar scene by its simulation from DEM and orbit.

Help group: Orientation and accuracy
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import (
    FILE,
    PLANAR,
    RANKED,
    block_of,
    options_of,
    output_option,
    overwrite_option,
    running_options,
)
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes
from geomosaic.errors import InputError
from geomosaic.options.inputs import BlockInputs


@grouped_command()
@click.argument("image", type=FILE)
@options_of(BlockInputs, "inputs", without=(*PLANAR, *RANKED))
@click.option("--tile", type=click.IntRange(16, 1024), default=128, help="Side of the windows compared, pixels.")
@click.option("--reach", type=click.IntRange(1, 512), default=32, help="Largest shift looked for, pixels.")
@output_option
@click.option(
    "--simulation", type=FILE, help="GeoTIFF to write of the simulated scene as well: its brightness, pixel by pixel."
)
@overwrite_option
@running_options
def command(
    image: Path,
    output: Path,
    simulation: Path | None,
    overwrite: bool,
    as_json: bool,
    inputs: dict[str, Any],
    tile: int,
    reach: int,
) -> None:
    """Find control points of a radar scene by its simulation from DEM and orbit.

    \b
    Example:
      geomosaic simulate scene.tif --sensor sar --dem dem.tif --dem-heights egm96 -o control.csv
      geomosaic ortho scene.tif --sensor sar --gcps control.csv --exterior-crs EPSG:32632 --heights egm96 \\
        --dem dem.tif --dem-heights egm96 -o ortho.tif

    Windows of the scene are compared with what the slopes of the DEM should look like there. The table has the ground
    of the DEM, in its CRS and its vertical datum, places in the scene and their covariances.
    """
    from geomosaic.products.simulation import match_simulation, simulate_scene
    from geomosaic.raster.files import check_output

    check_output(output, overwrite=overwrite, inputs=(image,))
    if simulation == output:
        raise InputError("table and simulation would be one file", where=str(output), hint="give two names")
    with notes():
        scene = block_of((image,), inputs)
        if simulation is not None:
            simulate_scene(scene, simulation, overwrite=overwrite)
        found = match_simulation(scene, tile=tile, reach=reach)
        found.write(output)
    facts = {
        "output": str(output), "points": len(found.control), "shift_px": found.shift.tolist(),
        "sigma_px": found.sigma.tolist(), "simulation": None if simulation is None else str(simulation),
    }  # fmt: skip
    answer(facts, f"{found.summary}\n{output}", as_json)
