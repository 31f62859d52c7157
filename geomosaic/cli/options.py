"""Options that commands share, named as rio names them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from geomosaic.cli.memory import memory_limit
from geomosaic.cli.values import FilePath, band_numbers, box, map_crs, pairs, pixel

Function = TypeVar("Function", bound=Callable[..., Any])

RESAMPLING = ("nearest", "bilinear", "cubic", "lanczos", "average")
FILE = FilePath(path_type=Path)


def stack(*decorators: Callable[[Any], Any]) -> Callable[[Function], Function]:
    """Apply decorators so that options appear in `--help` in the order given here."""

    def apply(function: Function) -> Function:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return apply


json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on standard output.")
debug_option = click.option("--debug", is_flag=True, expose_value=False, help="Show the traceback of an error.")

machine_options = stack(
    click.option("--threads", type=click.IntRange(1), help="Worker threads.  [default: all processors]"),
    click.option(
        "--mem-limit",
        callback=memory_limit,
        metavar="SIZE",
        help="Memory the run may hold, such as 512M or 2G.  [default: 2G]",
    ),
    json_option,
    debug_option,
)

band_option = click.option(
    "-b",
    "--bidx",
    "bands",
    multiple=True,
    callback=band_numbers,
    metavar="NUMBERS",
    help="Bands of the images to use, such as 1,2,3.  [default: all but alpha]",
)

true_ortho_option = click.option(
    "--true-ortho", is_flag=True, help="Leave out what the surface model hides from an image; other images fill it."
)

image_options = stack(
    band_option,
    click.option("--sensor", help="Sensor of the images; see `geomosaic sensors`."),
    click.option("--camera", type=FILE, help="Camera description, or calibration certificate (TOML)."),
    click.option("--fiducials", type=FILE, help="Fiducials measured in scans of film: image, id, col, row."),
    click.option(
        "--corrections",
        metavar="FILE",
        help="Correction grid of image coordinates; {image} in the name takes each image's name.",
    ),
    click.option("--exterior", type=FILE, help="Orientation table: image, x, y, z and angles."),
    click.option("--exterior-crs", "--crs", "crs", metavar="CRS", help="CRS of the positions, such as EPSG:32633."),
    click.option(
        "--heights",
        metavar="DATUM",
        help="Vertical datum of the positions: ellipsoidal, egm96, an EPSG code or a geoid grid file.",
    ),
    click.option(
        "--angles",
        default="opk",
        show_default=True,
        help="Angle system of the table: opk, pok, matrix, patb, rpy, dji, opensfm, odm, pix4d, metashape, colmap, "
        "ori, printed.",
    ),
    click.option(
        "--angle-unit",
        type=click.Choice(["deg", "gon", "rad"]),
        help="Unit of the angles.  [default: deg]",
    ),
    click.option(
        "--angle-frame",
        type=click.Choice(["grid", "local"]),
        help="North of the angles: the map's grid, or true.  [default: as the system has it]",
    ),
    click.option(
        "--matrix", type=click.Choice(["ground_to_image", "image_to_ground"]), help="Direction of rotation matrices."
    ),
    click.option(
        "--trust-orientation",
        "trusted",
        is_flag=True,
        help="Do not look whether the orientation can be meant.",
    ),
    click.option(
        "--option",
        "sensor_options",
        multiple=True,
        callback=pairs,
        metavar="NAME=VALUE",
        help="Any other input of the sensor.",
    ),
    click.option("--dem", type=FILE, help="Digital elevation model."),
    click.option("--height", type=float, metavar="METRES", help="One height for all the ground, instead of a DEM."),
    click.option("--dem-heights", metavar="DATUM", help="Vertical datum of the DEM or of --height."),
)

output_options = stack(
    click.option(
        "--dst-crs",
        callback=map_crs,
        metavar="CRS",
        help="CRS of the output, such as EPSG:32633.  [default: that of the DEM, the positions or the control]",
    ),
    click.option(
        "--res", callback=pixel, metavar="UNITS", help="Pixel size in map units.  [default: that of the images]"
    ),
    click.option(
        "--bounds",
        callback=box,
        nargs=4,
        metavar="LEFT BOTTOM RIGHT TOP",
        help="Area in map units.  [default: all images]",
    ),
    click.option(
        "--resampling", type=click.Choice(RESAMPLING), default="bilinear", show_default=True, help="Resampling method."
    ),
    click.option(
        "--tolerance",
        type=click.FloatRange(0),
        default=0.02,
        show_default=True,
        help="Largest geometric error of the lattice, in image pixels; at 0 it has a node at every pixel.",
    ),
    click.option("--nodata", type=float, help="Value of unseen pixels.  [default: a mask]"),
    click.option(
        "-f", "--driver", type=click.Choice(["COG", "GTiff"]), default="COG", show_default=True, help="File format."
    ),
    click.option(
        "--co",
        "creation",
        multiple=True,
        callback=pairs,
        metavar="NAME=VALUE",
        help="Creation option of the format, as GDAL names it.",
    ),
    click.option("-o", "--output", type=FILE, required=True, help="File to write."),
    click.option("--overwrite", is_flag=True, help="Replace the output if it exists."),
)

usable_options = stack(
    click.option("--margin", type=click.FloatRange(0), metavar="PIXELS", help="Border of every image not to be used."),
    click.option("--usable", type=FILE, help="Polygons beyond which images are not to be used: image, col, row."),
)
