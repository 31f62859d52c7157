"""Calibration of a scene to the wanted quantity, by what its product holds."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray
from geomosaic_sar.calibration import FLATTENED, PixelTable, SarCalibration
from geomosaic_sar.geometry import ImageGeometry
from geomosaic_sar.scene import RadarScene
from geomosaic_sar.sentinel1_calibration import read_calibration
from geomosaic_sar.zero_doppler import ellipsoid_incidence

# Nodes along columns and rows at which incidence angles are computed; between them they are nearly linear.
_NODES = 65, 9
_POLARISATION = re.compile(r"(?:^|[_-])(HH|HV|VH|VV)(?:[_.-]|$)", re.IGNORECASE)


def scene_calibration(file: Path, scene: RadarScene, kind: str, *, denoised: bool, image: str) -> SarCalibration:
    """Calibration of a scene.

    Parameters
    ----------
    file : Path
        Its metadata, beside which the tables of Sentinel-1 lie.
    scene : RadarScene
    kind : str
        See `SarCalibration`.
    denoised : bool
        Whether thermal noise is taken off.
    image : str
        File of the image, whose name tells which of several polarisations it is.

    Raises
    ------
    InputError
        The product holds no such calibration, or its file is missing or damaged.
    """
    if scene.polarisation:
        return read_calibration(file, scene.polarisation, kind, denoised=denoised)
    known = _of_polarisation(scene, image, str(file))
    if denoised and known.noise is None:
        raise InputError(
            "the metadata tell no thermal noise", where=str(file), hint="give noise_removal = false, or add the noise"
        )
    wanted = "beta0" if kind == FLATTENED else kind
    amplitude = known.amplitude
    if wanted != known.kind:
        amplitude = _turned(amplitude, scene, known.kind, wanted)
    return SarCalibration(kind, amplitude, known.noise if denoised else None)


def _of_polarisation(scene: RadarScene, image: str, where: str) -> SarCalibration:
    """Calibration that stands in the metadata, of the polarisation that the image's name tells."""
    if not scene.calibrations:
        raise InputError(
            "the metadata hold no calibration", where=where,
            hint="TerraSAR-X: <calibrationConstant> with calFactor; a JSON table: "
            '"calibration": {"quantity": "beta0", "factor": ...}; or give calibration = \'none\'',
        )  # fmt: skip
    if len(scene.calibrations) == 1:
        return next(iter(scene.calibrations.values()))
    named = _POLARISATION.search(Path(image).name)
    found = scene.calibrations.get(named[1].upper()) if named else None
    if found is None:
        raise InputError(
            f"the product has the polarisations {', '.join(scene.calibrations)}; the image's name tells none of them",
            where=image,
            hint="keep the names of the product, such as IMAGE_HH_....tif",
        )
    return found


def _turned(amplitude: PixelTable, scene: RadarScene, given: str, wanted: str) -> PixelTable:
    """Table of another quantity, by the incidence angles on the ellipsoid."""
    (width, height), (across, down) = scene.size, _NODES
    cols = np.union1d(np.linspace(0.5, width - 0.5, min(width, across)), amplitude.cols)
    rows = np.linspace(0.5, height - 0.5, min(height, down))
    angle = _incidence(scene.geometry, cols, rows, scene.height)
    by_beta = {"beta0": np.ones_like(angle), "sigma0": np.sin(angle), "gamma0": np.tan(angle)}
    factor = by_beta[wanted] / by_beta[given]
    return replace(amplitude, cols=cols, rows=rows, values=amplitude.at(cols, rows) / np.sqrt(factor))


def _incidence(geometry: ImageGeometry, cols: FloatArray, rows: FloatArray, height: float) -> FloatArray:
    """Incidence angles (R, C) on the ellipsoid at some columns and rows, radians."""
    col, row = (axis.ravel() for axis in np.meshgrid(cols, rows))
    times = geometry.times(row)
    angles = ellipsoid_incidence(geometry.orbit, times, geometry.axis.ranges(col, times), geometry.side, height)
    return angles.reshape(len(rows), len(cols))
