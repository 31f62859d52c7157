"""Georeferencing request: image, control and what is asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from geomosaic.control.parsing import Reading
from geomosaic.control.points import ControlPoints
from geomosaic.control.read import read_control
from geomosaic.errors import InputError, did_you_mean
from geomosaic.raster.info import SourceInfo, control_point_count

MODELS = ("conformal", "affine", "projective", "poly1", "poly2", "poly3", "poly4", "poly5", "tps")
"""Fits by name, the ones of fewer parameters first."""


@dataclass(frozen=True)
class ControlInput:
    """Where the control of an image is, and what its file does not say.

    Attributes
    ----------
    path : Path or ControlPoints, optional
        The file, or the points; without one the control is inside the image, or in a world file beside it.
    crs : str, optional
        CRS of the ground.
    rows : str, optional
        'up' or 'down', for a QGIS file whose rows have an unusual sign.
    pixels : str, optional
        'corner' or 'centre': what whole numbers are in the file.
    without : tuple of str
        Names of points that are left out.
    near : tuple of float, optional
        Longitude and latitude near the image, degrees.
    """

    path: Path | ControlPoints | None = None
    crs: str | None = None
    rows: str | None = None
    pixels: str | None = None
    without: tuple[str, ...] = ()
    near: tuple[float, float] | None = None


@dataclass(frozen=True)
class FitRequest:
    """Which fit.

    Attributes
    ----------
    model : str
        One of `MODELS`, or 'auto'.
    crs : str, optional
        CRS in which the fit is made; that of the control where it is projected, else that of the output.
    threshold : float, optional
        Total RMS in pixels down to which the worst points are deleted.
    robust : bool
        Leave the points out that the robust fit finds wrong.
    insist : bool
        Go on where the advice has errors.
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
    """Return kind and order as the sensor 'planar' takes them."""
    return ("polynomial", int(model[4:])) if model.startswith("poly") else (model, 1)


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
    if isinstance(given.path, ControlPoints):
        return Reading(given.path.without(given.without, "`gcps`"), "values")
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
            hint="`geomosaic ortho` draws it where it lies; to place it anew, give `gcps`",
        )
    raise InputError(
        "no control: the image has no control points in it, and there is no world file beside it",
        where=info.path,
        hint="give a table of points with `gcps`: id,x,y,col,row",
    )


def world_file(image: Path) -> Path | None:
    """Return the world file of an image: photo.tfw, photo.tifw or photo.wld for photo.tif, whatever the capitals."""
    ending = image.suffix[1:].casefold()
    if not ending:
        return None
    names = {f"{image.stem}.{end}".casefold() for end in (ending[0] + ending[-1] + "w", ending + "w", "wld")}
    found = [file for file in sorted(image.absolute().parent.iterdir()) if file.name.casefold() in names]
    return image.with_name(found[0].name) if found else None
