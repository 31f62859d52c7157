"""Georeferencing request: control points of an image, model and output grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from geomosaic.control.parsing import Reading
from geomosaic.control.points import ControlPoints
from geomosaic.control.read import read_control
from geomosaic.errors import InputError, did_you_mean
from geomosaic.raster.info import SourceInfo, control_point_count

MODELS = ("conformal", "affine", "projective", "poly1", "poly2", "poly3", "poly4", "poly5", "tps")
"""Names of models, those of fewer parameters first."""


@dataclass(frozen=True)
class ControlInput:
    """Source of an image's control points, with what its file does not declare.

    Attributes
    ----------
    path : Path or ControlPoints, optional
        File or points; without them the control in the image itself, or the world file beside it.
    crs : str, optional
        CRS of the ground coordinates.
    rows : str, optional
        'up' or 'down': direction of rows in a QGIS file with an unusual sign.
    pixels : str, optional
        'corner' or 'centre': position within the pixel of whole numbers in the file.
    without : tuple of str
        Names of points to leave out.
    near : tuple of float, optional
        Longitude and latitude near the image, degrees.
    """

    path: Path | ControlPoints | None = None
    crs: str | None = None
    rows: str | None = None
    pixels: str | None = None
    without: tuple[str, ...] = ()
    near: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.near is not None and not (isinstance(self.near, Sequence) and len(self.near) == 2):
            raise InputError(f"'{self.near}' is no place", where="`near`", hint="give longitude and latitude, degrees")


@dataclass(frozen=True)
class FitRequest:
    """Model of the fit and treatment of blunders.

    Attributes
    ----------
    model : str
        One of `MODELS`, or 'auto'.
    crs : str, optional
        CRS in which the fit is made; that of the control where it is projected, else that of the output.
    threshold : float, optional
        Total RMS in pixels down to which the worst points are deleted.
    robust : bool
        Leave out the blunders that the robust fit finds.
    insist : bool
        Continue in spite of errors among the findings.
    """

    model: str = "auto"
    crs: str | None = None
    threshold: float | None = None
    robust: bool = False
    insist: bool = False

    def __post_init__(self) -> None:
        if self.model not in ("auto", *MODELS):
            hint = did_you_mean(self.model, MODELS)
            raise InputError(
                f"there is no fit '{self.model}'", hint=f"{hint} choose one of auto, {', '.join(MODELS)}".strip()
            )
        if self.threshold is not None and not self.threshold > 0.0:
            raise InputError(f"a threshold of {self.threshold} pixels cannot be reached", hint="above 0")


def kind_order(model: str) -> tuple[str, int]:
    """Kind and order of a model, as options of the planar sensor."""
    return ("polynomial", int(model[4:])) if model.startswith("poly") else (model, 1)


def find_control(info: SourceInfo, given: ControlInput) -> Reading:
    """Control points of an image.

    Parameters
    ----------
    info : SourceInfo
        The image.
    given : ControlInput

    Raises
    ------
    InputError
        There are none, or they cannot be read.
    """
    image = Path(info.path)
    if isinstance(given.path, ControlPoints):
        return Reading(given.path.without(given.without, "`gcps`"), "values")
    path = given.path if given.path is not None else _control_of_image(info)
    reading = read_control(path, image=image.name, crs=given.crs, size=info.size, sign=given.rows, count=given.pixels)
    notes = list(reading.notes)
    if given.path is not None and info.transform is not None:
        notes.append("the georeference that the image has already is not used")
    control = reading.control.without(given.without, str(path))
    return replace(reading, control=control, notes=tuple(notes))


def _control_of_image(info: SourceInfo) -> Path:
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
            hint="`geomosaic ortho` draws it where it lies; to place it anew, give `gcps`",
        )
    raise InputError(
        "no control: the image has no control points in it, and there is no world file beside it",
        where=info.path,
        hint="give a table of points with `gcps`: id,x,y,col,row",
    )


def world_file(image: Path) -> Path | None:
    """World file of an image: photo.tfw, photo.tifw or photo.wld for photo.tif, in capitals or not."""
    ending = image.suffix[1:].casefold()
    if not ending:
        return None
    names = {f"{image.stem}.{end}".casefold() for end in (ending[0] + ending[-1] + "w", ending + "w", "wld")}
    found = [file for file in sorted(image.absolute().parent.iterdir()) if file.name.casefold() in names]
    return image.with_name(found[0].name) if found else None
