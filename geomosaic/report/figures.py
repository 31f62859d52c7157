"""Figures of the report as plain values: preview with footprints and seams, residual vectors, scale bars."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from geomosaic.numbers import round_below
from geomosaic.raster.pictures import jpeg_bytes, preview
from geomosaic.raster.vector import read_layer
from geomosaic.report.page import length_text
from geomosaic.types import FloatArray

# Pixels of the preview's longer side.
LONGEST = 1100


@dataclass(frozen=True)
class Outline:
    """Footprint of one image on the map.

    Attributes
    ----------
    name : str
    path : str
        SVG path, in pixels of the preview.
    x, y : float
        Position of the name, in the same pixels.
    """

    name: str
    path: str
    x: float
    y: float


@dataclass(frozen=True)
class MosaicMap:
    """Mosaic with footprints and seamlines, in pixels of its preview.

    Attributes
    ----------
    width, height : int
        Of the preview.
    picture : str
        Preview as a data URI.
    footprints : list of Outline
    seams : list of str
        SVG paths.
    bar_pixels : float
        Length of the scale bar.
    bar_text : str
        Its length on the ground.
    """

    width: int
    height: int
    picture: str
    footprints: list[Outline]
    seams: list[str]
    bar_pixels: float
    bar_text: str


@dataclass(frozen=True)
class Vector:
    """Point with its residual vector in a picture of the image plane.

    Attributes
    ----------
    x, y : float
        Measured image point, in units of the picture.
    dx, dy : float
        Enlarged residual, in the same units.
    state : str
        'control', 'check', or why it counts for neither.
    title : str
        Text on the vector.
    name : str
        Id of the point, where it stands beside it.
    cut : bool
        Whether the vector is longer than it is drawn.
    """

    x: float
    y: float
    dx: float
    dy: float
    state: str
    title: str
    name: str = ""
    cut: bool = False


@dataclass(frozen=True)
class ResidualPlot:
    """Residual vectors of all images in one image plane, enlarged.

    Attributes
    ----------
    width, height : float
        Of the picture.
    vectors : list of Vector
    bar : float
        Length of the scale bar of the residuals, in units of the picture.
    bar_text : str
        Its length in image pixels.
    """

    width: float
    height: float
    vectors: list[Vector]
    bar: float
    bar_text: str


def mosaic_map(mosaic: Path, vectors: Path, bounds: Sequence[float], unit: str) -> MosaicMap:
    """Map of the mosaic with footprints and seamlines.

    Parameters
    ----------
    mosaic, vectors : Path
        Raster, and GeoPackage with the layers `footprints` and `seamlines`.
    bounds : sequence of float
        Left, bottom, right, top of the raster in its CRS.
    unit : str
        Of that CRS, for the scale bar.
    """
    rgb, valid = preview(mosaic, LONGEST)
    height, width = valid.shape
    left, bottom, right, top = bounds
    scale = np.array([width / (right - left), -height / (top - bottom)])
    origin = np.array([left, top])

    def pixels(xy: ArrayLike) -> FloatArray:
        places: FloatArray = (np.asarray(xy, dtype=np.float64)[:, :2] - origin) * scale
        return places

    outlines = []
    for row in read_layer(vectors, "footprints").itertuples():
        x, y = pixels([(row.centre_x, row.centre_y)])[0]
        ring = " ".join(path_data(pixels(part.exterior.coords), closed=True) for part in _parts(row.geometry))
        outlines.append(Outline(str(row.image), ring, float(x), float(y)))
    seams = [
        path_data(pixels(part.coords))
        for geometry in read_layer(vectors, "seamlines").geometry
        for part in _parts(geometry)
        if part.geom_type == "LineString"
    ]
    length = round_below((right - left) / 5)
    text = length_text(length, "m" if unit == "metre" else unit)
    return MosaicMap(
        width, height, data_uri(jpeg_bytes(rgb, valid), "image/jpeg"), outlines, seams, length * float(scale[0]), text
    )


def residual_plot(
    points: Sequence[Mapping[str, Any]], size: tuple[int, int], measured: Mapping[str, Any]
) -> ResidualPlot:
    """Residual vectors at their image points, in one image plane 400 wide.

    Parameters
    ----------
    points : sequence of mapping
        id, image, role, col, row (residuals in px).
    size : tuple of int
        Width and height of the images.
    measured : mapping
        'id image' to measured (col, row).
    """
    known = [p for p in points if p["col"] is not None and f"{p['id']} {p['image']}" in measured]
    width = 400.0
    shrink = width / size[0]
    lengths = [math.hypot(p["col"], p["row"]) for p in known if p["role"] != "rejected"] or [1.0]
    # Residuals may all be 0, and are then drawn as points.
    longest = max(max(lengths), 1e-9)
    vectors = []
    for p in known:
        col, row = measured[f"{p['id']} {p['image']}"]
        title = f"{p['id']} in {p['image']}: {p['col']:+.2f}, {p['row']:+.2f} px"
        # What was left out may be a thousand times as long.
        enlarge = 36.0 / max(longest, math.hypot(p["col"], p["row"]) / 2.0)
        vectors.append(Vector(col * shrink, row * shrink, p["col"] * enlarge, p["row"] * enlarge, p["role"], title))
    bar = round_below(longest)
    return ResidualPlot(width, size[1] * shrink, vectors, bar * 36.0 / longest, f"{bar:g} px")


def path_data(points: FloatArray, closed: bool = False) -> str:
    """SVG path through points, to a tenth of a pixel.

    Parameters
    ----------
    points : array (N, 2)
        x to the right, y down, in pixels of the picture.
    closed : bool
        Whether the path ends where it began.

    Returns
    -------
    str
        Value of the attribute `d`.
    """
    text = "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
    return f"M{text}{'Z' if closed else ''}"


def residual_length(pair: Sequence[float | None]) -> float:
    """Length of a residual, by which tables are sorted, the largest first.

    Parameters
    ----------
    pair : sequence of float or None
        Pixels; None where the model has no image of the point.

    Returns
    -------
    float
        Infinite where it is not known.
    """
    # Points without a residual want looking at most: they stand before all others, and are never cut off.
    x, y = pair
    return math.inf if x is None or y is None else math.hypot(x, y)


def data_uri(picture: bytes, kind: str = "image/png") -> str:
    """Image as a data URI, so that a page needs no other file.

    Parameters
    ----------
    picture : bytes
        Encoded image.
    kind : str
        Its media type.
    """
    return f"data:{kind};base64,{base64.b64encode(picture).decode('ascii')}"


def _parts(geometry: Any) -> list[Any]:
    return list(getattr(geometry, "geoms", [geometry]))
