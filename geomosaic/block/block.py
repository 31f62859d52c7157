"""Oriented images and blocks: images with their sensor models, their common ground and control points."""

from __future__ import annotations

from dataclasses import dataclass, field

from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.sensor.model import SensorModel
from geomosaic.surface.model import Surface


@dataclass(frozen=True, eq=False)
class OrientedImage:
    """Oriented image: a file and the sensor model that says where its pixels lie.

    Attributes
    ----------
    name : str
        Unique in its block.
    path : str
        The image file.
    sensor : str
        Name of the sensor plugin the model comes from.
    model : SensorModel
    nodata : float, optional
        Value of missing pixels, in place of what the file says.
    bands : tuple of int, optional
        Bands to use, counted from 1, in this order; all but alpha unless given.
    usable : tuple of (col, row), optional
        Corners of the part of the image that may be used, in order: no fiducial marks, no border of the film.
    """

    name: str
    path: str
    sensor: str
    model: SensorModel
    nodata: float | None = None
    bands: tuple[int, ...] | None = None
    usable: tuple[tuple[float, float], ...] | None = None


@dataclass(frozen=True)
class ControlPoint:
    """One image measurement of a point known on the ground.

    Attributes
    ----------
    id : str
    xyz : tuple of float
        In the block's `crs`, metres.
    image : str
        Name of the scene it is measured in.
    colrow : tuple of float
        Pixels, corner-based.
    sigma_xy, sigma_z : float
        Standard deviations on the ground, metres.
    sigma_px : float
        Standard deviation of the measurement, pixels.
    role : str
        'control' takes part in adjustments, 'check' only judges them.
    where : str
        File and line, for messages.
    """

    id: str
    xyz: tuple[float, float, float]
    image: str
    colrow: tuple[float, float]
    sigma_xy: float = 0.0
    sigma_z: float = 0.0
    sigma_px: float = 1.0
    role: str = "control"
    where: str = field(default="", compare=False)


@dataclass(frozen=True, eq=False)
class OrientedBlock:
    """Oriented images over one surface, as `Block` describes them before it is built.

    Attributes
    ----------
    scenes : tuple of OrientedImage
    surface : Surface or None
        None where no model uses heights.
    control : tuple of ControlPoint
    crs : CRS, optional
        3-D CRS of the control points.
    """

    scenes: tuple[OrientedImage, ...]
    surface: Surface | None
    control: tuple[ControlPoint, ...] = ()
    crs: CRS | None = None

    def __post_init__(self) -> None:
        names = [scene.name for scene in self.scenes]
        if not names:
            raise InputError("a block needs at least one image")
        doubled = sorted({name for name in names if names.count(name) > 1})
        if doubled:
            raise InputError(
                f"two images share the name '{doubled[0]}'", hint="rename one, or list the files one by one"
            )

    def scene(self, name: str) -> OrientedImage:
        """Return the scene of that name."""
        for scene in self.scenes:
            if scene.name == name:
                return scene
        raise InputError(f"no image named '{name}' in the block")
