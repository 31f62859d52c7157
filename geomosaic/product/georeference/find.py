"""The control of one image: in the file that is named, in the image itself, or in a world file beside it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from geomosaic.control.read import read_control
from geomosaic.control.reading import Reading
from geomosaic.errors import InputError
from geomosaic.product.georeference.request import ControlInput
from geomosaic.raster.info import SourceInfo, control_point_count


def find_control(info: SourceInfo, given: ControlInput) -> Reading:
    """Read the control of an image.

    Parameters
    ----------
    info : SourceInfo
        Of the image.
    given : ControlInput

    Raises
    ------
    InputError
        There is none, or it cannot be read.
    """
    image = Path(info.path)
    path = given.path if given.path is not None else _own(info)
    reading = read_control(path, image=image.name, crs=given.crs, size=info.size, sign=given.rows, count=given.pixels)
    notes = list(reading.notes)
    if given.path is not None and info.transform is not None:
        notes.append("the georeference that the image has already is not used")
    control = reading.control.without(given.without, str(path))
    return replace(reading, control=control, notes=tuple(notes))


def _own(info: SourceInfo) -> Path:
    image = Path(info.path)
    if control_point_count(image):
        return image
    beside = world_file(image)
    if beside is not None:
        return beside
    if info.transform is not None:
        raise InputError(
            "the image has a georeference already and no control points",
            where=info.path,
            mend="`geomosaic ortho` draws it where it lies; to place it anew, give --gcps",
        )
    raise InputError(
        "no control: the image has no control points in it, and there is no world file beside it",
        where=info.path,
        mend="give a table of points with --gcps: id,x,y,col,row",
    )


def world_file(image: Path) -> Path | None:
    """Return the world file of an image: photo.tfw, photo.tifw or photo.wld for photo.tif, whatever the capitals."""
    ending = image.suffix[1:].casefold()
    if not ending:
        return None
    names = {f"{image.stem}.{end}".casefold() for end in (ending[0] + ending[-1] + "w", ending + "w", "wld")}
    found = [file for file in sorted(image.absolute().parent.iterdir()) if file.name.casefold() in names]
    return image.with_name(found[0].name) if found else None
