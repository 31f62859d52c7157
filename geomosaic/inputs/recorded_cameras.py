"""Cameras that photos record (EXIF) against the one they are declared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from geomosaic.block import OrientedImage
from geomosaic.errors import InputError
from geomosaic.raster.image_metadata import read_photo_tags, tag_number

# Of each tag what a message calls it.
TAGS = {"Make": "maker", "Model": "model", "BodySerialNumber": "serial number"}
FOCAL = {"FocalLength": "focal length (mm)", "FocalLengthIn35mmFilm": "focal length (mm in 35 mm film)"}
# Share of the focal length by which it must differ: lenses that focus nearer write it a little longer.
SAME_FOCAL = 0.02


def check_recorded_cameras(images: Sequence[OrientedImage]) -> None:
    """Check that photos declared with one camera record no other maker, model, serial number or focal length.

    Parameters
    ----------
    images : sequence of OrientedImage
        Of one camera; those without tags say nothing.

    Raises
    ------
    InputError
        Names two of them, and what they record.
    """
    first: dict[str, tuple[str, str | float]] = {}
    for image in images:
        exif = read_photo_tags(image.path).exif
        for name, value in _recorded(exif).items():
            other, known = first.setdefault(name, (image.name, value))
            if _differ(known, value):
                raise InputError(
                    f"{other} and {image.name} are declared with one camera, and record another {name}: {known} and "
                    f"{value}",
                    where="`interior`",
                    hint="declare two cameras, with a table [[images]] and a camera of its own for some of the images; "
                    "if they are one all the same, say so: `trusted`",
                )


def _recorded(exif: Mapping[str, str]) -> dict[str, str | float]:
    """What a photo records of its camera, by the words of a message."""
    found: dict[str, str | float] = {what: exif[tag].strip() for tag, what in TAGS.items() if exif.get(tag, "").strip()}
    for tag, what in FOCAL.items():
        if focal := tag_number(exif.get(tag, "").strip().strip("()")):
            found[what] = focal
    return found


def _differ(one: str | float, other: str | float) -> bool:
    if isinstance(one, str) or isinstance(other, str):
        return one != other
    return abs(one - other) > SAME_FOCAL * max(one, other)
