"""Vectors in image coordinates carried to the map by the fit of their image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from geomosaic.block import Footprint, OrientedImage
from geomosaic.errors import InputError
from geomosaic.geo.densify import transformed
from geomosaic.geo.pixel_axes import PixelAxes
from geomosaic.geo.transform import Transform
from geomosaic.options.control import VectorOptions
from geomosaic.raster.vector import VectorProduct, layer_names, plain_tables, read_layer
from geomosaic.raster.vector_copy import rewrite_layers
from geomosaic.sensor.solve import image_to_ground
from geomosaic.types import FloatArray

if TYPE_CHECKING:
    from geopandas import GeoDataFrame


@dataclass(frozen=True)
class CarriedVectors(VectorProduct):
    """Vectors carried to the map by a fit; `read` gives their layers.

    Attributes
    ----------
    path : Path
    layers : dict of str to int
        Number of features by layer.
    lost : int
        Features left out, since the fit has no ground for a vertex of theirs.
    added : int
        Vertices put in where the fit bends lines.
    tolerance_px : float
        Pixels by which a line between two vertices may miss the fit.
    crs : CRS
        Of the output.
    """

    path: Path
    layers: dict[str, int]
    lost: int
    added: int
    tolerance_px: float
    crs: CRS

    @property
    def facts(self) -> dict[str, Any]:
        """JSON values."""
        from geomosaic.geo.crs import crs_label

        return {
            "path": str(self.path), "crs": crs_label(self.crs), "layers": self.layers,
            "features": sum(self.layers.values()), "lost": self.lost, "added": self.added,
            "tolerance_px": self.tolerance_px,
        }  # fmt: skip


def carry(
    path: Path,
    output: Path,
    to_image: Callable[[FloatArray], FloatArray],
    scene: OrientedImage,
    outline: Footprint,
    crs: CRS,
    tolerance: float,
    *,
    overwrite: bool,
) -> CarriedVectors:
    """All layers of a vector file on the map; attributes and z stay as they are.

    Parameters
    ----------
    path, output : Path
    to_image : callable
        From coordinates of the file (M, 2) to columns and rows.
    scene : OrientedImage
        With the fitted model.
    outline : Footprint
        Of the image in `crs`; its sampling makes map units of the tolerance.
    crs : CRS
        Of the output.
    tolerance : float
        Pixels by which a line between two vertices may miss the fit.
    overwrite : bool

    Raises
    ------
    InputError
        Nothing of it has a place, or the output cannot take it.
    """
    to_map = Transform(scene.model.crs, crs)

    def change(xy: FloatArray) -> FloatArray:
        return to_map(image_to_ground(scene.model, to_image(xy))[:, :2])

    lost = added = 0

    def carried(frame: GeoDataFrame, name: str) -> GeoDataFrame:
        nonlocal lost, added
        made, more = transformed(list(frame.geometry.values), change, tolerance * outline.sampling)
        placeless = np.array([new is None and old is not None for old, new in zip(frame.geometry, made, strict=True)])
        lost, added = lost + int(placeless.sum()), added + more
        moved = frame.set_geometry(np.array(made, dtype=object)).set_crs(crs, allow_override=True)
        return moved[~placeless]

    nothing = InputError(
        "the fit has no ground for any of the features",
        where=str(path),
        hint="check the control, or choose another fit",
    )
    layers = rewrite_layers(path, output, carried, nothing, overwrite=overwrite)
    return CarriedVectors(output, layers, lost, added, tolerance, crs)


def image_axes(options: VectorOptions, size: tuple[int, int]) -> PixelAxes:
    """How vectors drawn over an image count its pixels.

    Parameters
    ----------
    options : VectorOptions
    size : tuple of int
        Width and height of the image, pixels.

    Raises
    ------
    InputError
        The vectors lie beside the image, or nothing says how they count rows.
    """
    assert options.vectors is not None
    left, bottom, right, top = vector_bounds(options.vectors)
    rows = options.vector_rows
    if rows is None and top > 0.0:
        raise InputError(
            f"the vectors have y from {bottom:.6g} to {top:.6g}, which does not say how they count rows",
            where=str(options.vectors),
            hint="say it as `vector_rows`: down, negative or up",
        )
    axes = PixelAxes(size[1], rows or "negative")
    corners = axes.colrow(np.array([[left, bottom], [right, top]]))
    low, high = corners.min(axis=0), corners.max(axis=0)
    if (high < 0.0).any() or (low > size).any():
        raise InputError(
            f"the vectors lie beside the image of {size[0]} x {size[1]} pixels: columns {low[0]:.6g} to {high[0]:.6g}, "
            f"rows {low[1]:.6g} to {high[1]:.6g}",
            where=str(options.vectors),
            hint="say how they count rows as `vector_rows`; vectors that lie on the map need no fit",
        )
    return axes


def vector_bounds(path: Path) -> tuple[float, float, float, float]:
    """Left, bottom, right, top of all layers of a vector file, in its units.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        The file cannot be read, or has no features.
    """
    tables = plain_tables(path) if (names := layer_names(path)) else []
    frames = [read_layer(path, name) for name in names if name not in tables]
    bounds = np.array([frame.total_bounds for frame in frames if len(frame)]).reshape(-1, 4)
    bounds = bounds[np.isfinite(bounds).all(axis=1)]
    if not len(bounds):
        raise InputError("the file has no features", where=str(path), hint="name another file")
    left, bottom = bounds[:, :2].min(axis=0).tolist()
    right, top = bounds[:, 2:].max(axis=0).tolist()
    return left, bottom, right, top
