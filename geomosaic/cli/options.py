"""Options that commands share, named as rio names them."""

from __future__ import annotations

import click

from geomosaic.cli.declared_options import FILE, stack
from geomosaic.cli.values import band_names, band_numbers, box, map_crs, pairs, pixel

json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on standard output.")
debug_option = click.option("--debug", is_flag=True, expose_value=False, help="Show the traceback of an error.")

overwrite_option = click.option("--overwrite", is_flag=True, help="Replace the output if it exists.")
dem_heights_option = click.option(
    "--dem-heights", metavar="DATUM", help="Vertical datum of the DEM, where the file does not say it."
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

image_options = stack(
    click.option("--sensor", help="Sensor of the images; see `geomosaic sensors`."),
    click.option("--camera", type=FILE, help="Camera description, or calibration certificate (TOML)."),
    click.option("--exterior", type=FILE, help="Orientation table: image, x, y, z and angles."),
    click.option("--exterior-crs", "--crs", "crs", metavar="CRS", help="CRS of the positions, such as EPSG:32633."),
    click.option(
        "--heights",
        metavar="DATUM",
        help="Vertical datum of the positions: ellipsoidal, egm96, an EPSG code or a geoid grid file.",
    ),
    click.option("--dem", type=FILE, help="Digital elevation model."),
    click.option("--height", type=float, metavar="METRES", help="One height for all the ground, instead of a DEM."),
    click.option("--dem-heights", metavar="DATUM", help="Vertical datum of the DEM or of --height."),
    band_option,
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
    click.option("--fiducials", type=FILE, help="Fiducials measured in scans of film: image, id, col, row."),
    click.option(
        "--corrections",
        metavar="FILE",
        help="Correction grid of image coordinates; {image} in the name takes each image's name.",
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
    group="input",
)

area_options = stack(
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
    group="geometry",
)
like_option = stack(
    click.option("--like", type=FILE, metavar="RASTER", help="Take CRS, pixels and extent of this raster."),
    group="geometry",
)
output_option = stack(click.option("-o", "--output", type=FILE, required=True, help="File to write."), group="output")
running_options = stack(json_option, debug_option, group="running")

band_names_option = stack(
    click.option(
        "--bands",
        "band_names",
        callback=band_names,
        metavar="NAMES",
        help="Bands by description or colour, such as red,green,blue, wherever each file has them.",
    ),
    group="input",
)

usable_options = stack(
    click.option("--margin", type=click.FloatRange(0), metavar="PIXELS", help="Border of every image not to be used."),
    click.option("--usable", type=FILE, help="Polygons beyond which images are not to be used: image, col, row."),
    group="input",
)

NOT_BY_RULE = ("rule", "order", "base", "dtype", "convert", "water", "water_fill")
"""Options that commands which place photos themselves do not have."""
