"""Images whose pixels are numbers of a palette: between two numbers lies another colour, not one in between."""

from __future__ import annotations

from geomosaic.errors import InputError
from geomosaic.raster.info import SourceInfo


def refuse_palette(info: SourceInfo, resampling: str) -> None:
    """Stop before numbers of a palette are averaged.

    Raises
    ------
    InputError
        The colours of the image stand in a palette, and the resampling takes more than the nearest pixel.
    """
    if resampling != "nearest" and "palette" in info.colors:
        raise InputError(
            "the pixels of the image are numbers of a palette, between which there are no values",
            where=info.path,
            mend="expand them to colours first (gdal_translate -expand rgb); where they are classes, keep the numbers "
            "with --resampling nearest",
        )
