"""Image positions of an adjusted block with their residuals, from the files that the adjustment wrote."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from pyproj import CRS

from geomosaic.block_adjustment.measurements import image_numbers
from geomosaic.geo.transform import Transform
from geomosaic.image_names import file_name, stem
from geomosaic.inputs.tie_points import TiePoints
from geomosaic.raster.vector import read_layer
from geomosaic.sensor.plugin import SensorModel
from geomosaic.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class ImageResiduals:
    """Image positions of the points of a block, N in all, and what the adjustment left of them.

    Attributes
    ----------
    ids : tuple of str (S,)
        Of the points.
    names : tuple of str (M,)
        Of the images.
    point, image : int array (N,)
        Of each image position.
    colrow : array (N, 2)
        As measured, pixels.
    residual : array (N, 2)
        Measured less computed from the adjusted point and model, pixels; NaN where one of them is not known.
    left_out : bool array (N,)
        Measurements that the adjustment left out as blunders.
    ground : array (S, 3)
        Adjusted points in `crs`; NaN of those without a place.
    crs : CRS or None
        None where nothing is adjusted.
    """

    ids: tuple[str, ...]
    names: tuple[str, ...]
    point: IntArray
    image: IntArray
    colrow: FloatArray
    residual: FloatArray
    left_out: BoolArray
    ground: FloatArray
    crs: CRS | None

    @cached_property
    def rays(self) -> IntArray:
        """Number of good rays (S,) of each point."""
        return np.bincount(self.point[~self.left_out], minlength=len(self.ids))

    def rms(self, image: int) -> float:
        """RMS length of the residuals in an image, pixels, without what was left out; NaN without any."""
        squares = (self.residual[(self.image == image) & ~self.left_out] ** 2).sum(axis=1)
        squares = squares[np.isfinite(squares)]
        return float(np.sqrt(squares.mean())) if len(squares) else float("nan")


def image_residuals(
    measured: TiePoints,
    models: Mapping[str, SensorModel | None],
    points: Path | None = None,
    left_out: Collection[tuple[str, str]] = (),
) -> ImageResiduals:
    """Residuals of image positions under adjusted models and points.

    Parameters
    ----------
    measured : TiePoints
        Of tie, control and check points; those in other images are left.
    models : mapping of str to SensorModel
        Adjusted, by the name of the image; None of one that has none yet.
    points : Path, optional
        GeoPackage `tie_points.gpkg` of the adjustment; no residuals without one.
    left_out : collection of (str, str)
        Image and point of measurements that were left out as blunders.
    """
    from pandas import factorize

    place = image_numbers(list(models))
    code, image_names = factorize(np.array([*measured.images], dtype=object))
    own = [place.get(file_name(name), place.get(stem(file_name(name)), -1)) for name in image_names]
    image = np.array(own, dtype=np.int64)[code]
    rows = np.flatnonzero(image >= 0)
    image, colrow = image[rows], np.asarray(measured.colrow)[rows]
    point, labels = factorize(np.array([*measured.points], dtype=object)[rows])
    ids = tuple(labels)
    ground, crs = np.full((len(ids), 3), np.nan), None
    if points is not None:
        ground, crs = _adjusted(points, ids)
    found = np.full((len(rows), 2), np.nan)
    for index, model in enumerate(models.values() if crs is not None else ()):
        mine = np.flatnonzero(image == index)
        mine = mine[np.isfinite(ground[point[mine]]).all(axis=1)]
        if len(mine) and crs is not None and model is not None:
            found[mine] = colrow[mine] - model.ground_to_image(Transform(crs, model.crs)(ground[point[mine]]))
    names = tuple(models)
    out = np.zeros(len(rows), dtype=np.bool_)
    if left_out:
        pairs = zip(image.tolist(), point.tolist(), strict=True)
        out[:] = [(names[one], ids[other]) in left_out for one, other in pairs]
    return ImageResiduals(ids, names, point, image, colrow, found, out, ground, crs)


def joined_positions(parts: Sequence[TiePoints]) -> TiePoints:
    """Image positions of several tables; of the same point in the same image the first counts.

    Parameters
    ----------
    parts : sequence of TiePoints
    """
    places = {
        (point, image): colrow
        for part in reversed(parts)
        for point, image, colrow in zip(part.points, part.images, np.asarray(part.colrow).tolist(), strict=True)
    }
    points, images = ([pair[index] for pair in places] for index in (0, 1))
    return TiePoints(points, images, np.array(list(places.values()), dtype=np.float64).reshape(-1, 2))


def _adjusted(path: Path, ids: Sequence[str]) -> tuple[FloatArray, CRS]:
    """Adjusted points (S, 3) by their names, and their CRS."""
    import shapely

    frame = read_layer(path, "tie_points")
    places = dict(zip(frame["id"], shapely.get_coordinates(frame.geometry.values, include_z=True), strict=True))
    nowhere = np.full(3, np.nan)
    return np.array([places.get(name, nowhere) for name in ids]).reshape(-1, 3), CRS(frame.crs)
