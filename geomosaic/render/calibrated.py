"""Images read as the physical quantity that their sensor says their values stand for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from geomosaic.block import OrientedImage
from geomosaic.errors import InputError
from geomosaic.geo.grid import Window
from geomosaic.raster.info import SourceInfo, inspect
from geomosaic.sensor.plugin import Calibration, HasRadiometry, HasSensorPositions
from geomosaic.surface.model import Surface
from geomosaic.types import AnyArray

if TYPE_CHECKING:
    from geomosaic.render.illuminated_area import IlluminatedArea

# Pixels that are calibrated at once, so that intermediate arrays stay in a processor's cache.
_STRIP = 1 << 18


@dataclass(frozen=True, eq=False)
class CalibratedValues:
    """Quantity that the values of an image stand for; see `raster.source.Calibrated`.

    Attributes
    ----------
    calibration : Calibration
    amplitudes : bool
        Whether values are squared first.
    area : IlluminatedArea, optional
        What radar brightness is divided by.
    """

    calibration: Calibration
    amplitudes: bool
    area: IlluminatedArea | None = None

    @property
    def quantity(self) -> str:
        """Name of the quantity."""
        return self.calibration.quantity

    @property
    def unit(self) -> str:
        """Its unit."""
        return self.calibration.unit

    def __call__(self, values: AnyArray, window: Window) -> AnyArray:
        """Quantity (rows, cols, bands) of the values of a window, NaN where nothing is lit.

        Parameters
        ----------
        values : array (rows, cols, bands)
            As the file holds them.
        window : Window
            Of the image.
        """
        out = np.empty(values.shape, dtype=np.float32)
        cols = np.arange(window.col + 0.5, window.stop_col)
        rows = np.arange(window.row + 0.5, window.stop_row)
        many = max(1, _STRIP // max(1, window.width))
        for first in range(0, window.height, many):
            part = values[first : first + many]
            here = out[first : first + many]
            if self.amplitudes:
                np.multiply(part, part, out=here, dtype=np.float32)
            else:
                here[:] = part
            factor, offset = self.calibration.at(cols, rows[first : first + many])
            here *= factor.astype(np.float32, copy=False)[..., None]
            if offset.any():
                here += offset.astype(np.float32, copy=False)[..., None]
        if self.area is not None:
            out /= self.area.at(window)[..., None]
        return out


def calibration_of(scene: OrientedImage) -> Calibration | None:
    """Calibration of an image, None where its values stay as they are.

    Parameters
    ----------
    scene : OrientedImage
    """
    return scene.model.calibration if isinstance(scene.model, HasRadiometry) else None


def calibrated_values(scene: OrientedImage, surface: Surface | None) -> CalibratedValues | None:
    """Quantity that the values of an image are to be read as; None where they stay as they are.

    Parameters
    ----------
    scene : OrientedImage
    surface : Surface or None
        Ground, for what its relief does to the brightness.

    Raises
    ------
    InputError
        The sensor asks for terrain flattening, and there is no relief or no radar.
    """
    known = scene.model
    if not isinstance(known, HasRadiometry) or known.calibration is None:
        return None
    found = CalibratedValues(known.calibration, known.amplitudes)
    if not known.calibration.flattened:
        return found
    if surface is None or surface.range[0] == surface.range[1]:
        raise InputError(
            "terrain flattening needs the relief of the ground", where=scene.path,
            hint="give a DEM, or calibrate to gamma0 by the ellipsoid",
        )  # fmt: skip
    if not isinstance(scene.model, HasSensorPositions):
        raise InputError(
            "terrain flattening is for radar scenes without a correction grid", where=scene.path,
            hint="leave the correction grid out, or flatten nothing",
        )  # fmt: skip
    from geomosaic.render.illuminated_area import IlluminatedArea

    return replace(found, area=IlluminatedArea(scene.model, surface))


def image_info(scene: OrientedImage) -> SourceInfo:
    """Metadata of an image as it is read: of the quantity where its sensor calibrates it.

    Parameters
    ----------
    scene : OrientedImage
    """
    info, known = inspect(scene.path, scene.bands), calibration_of(scene)
    return info if known is None else info.calibrated(known.quantity, known.unit)


def check_quantities(scenes: Sequence[OrientedImage]) -> None:
    """Check that images which are to become one hold the same quantity.

    Parameters
    ----------
    scenes : sequence of OrientedImage

    Raises
    ------
    InputError
        Two of them do not.
    """
    names = [getattr(calibration_of(scene), "quantity", "values that are not calibrated") for scene in scenes]
    for scene, own in zip(scenes, names, strict=True):
        if own != names[0]:
            raise InputError(
                f"the image holds {own}, '{scenes[0].name}' holds {names[0]}", where=scene.path,
                hint="calibrate all to one quantity",
            )  # fmt: skip


def check_squares(scenes: Sequence[OrientedImage], resampling: str) -> None:
    """Check that powers are not squared.

    Parameters
    ----------
    scenes : sequence of OrientedImage
    resampling : str

    Raises
    ------
    InputError
        The resampling is that of amplitudes, and an image holds powers.
    """
    known = next((found for found in map(calibration_of, scenes) if found is not None), None)
    if known is not None and resampling == "rms":
        raise InputError(
            f"`resampling=rms` averages amplitudes in power, and {known.quantity} is power already",
            where=scenes[0].path, hint="leave it out, or use `resampling=average`",
        )  # fmt: skip


def overview_mean(scenes: Sequence[OrientedImage], resampling: str) -> str:
    """Mean of four pixels in the overviews of what images become: 'average', or 'rms' of amplitudes.

    Parameters
    ----------
    scenes : sequence of OrientedImage
    resampling : str
        Of the output.
    """
    models = [scene.model for scene in scenes]
    amplitudes = all(isinstance(one, HasRadiometry) and one.amplitudes and one.calibration is None for one in models)
    return "rms" if resampling == "rms" or amplitudes else "average"
