"""Mosaics: many images to one; photos joined at their edges; facades, towers and domes developed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from geomosaic.api.orthos import area, on_ground
from geomosaic.errors import InputError
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.inputs.declarations import Block, as_blocks, block_of, image_paths
from geomosaic.mosaicking.records import MosaicResult
from geomosaic.options.control import EdgeMosaicOptions
from geomosaic.options.declaration import compose
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.products import EdgeInputs, make_edge_mosaic, make_mosaic, make_planar_mosaic
from geomosaic.surface.dem import Dem
from geomosaic.types import PathLike
from geomosaic.whole_files import path_of

if TYPE_CHECKING:
    from geomosaic.developed.develop import DevelopedResult
    from geomosaic.orientation.edges import EdgeMatch


def mosaic(
    images: Block | Sequence[Block | PathLike] | PathLike,
    output: PathLike,
    *,
    dem: PathLike | Dem | float | None = None,
    dem_heights: str | None = None,
    dst_crs: str | None = None,
    resolution: float | None = None,
    bounds: Bounds | None = None,
    like: PathLike | Grid | None = None,
    **options: Any,
) -> MosaicResult:
    """Mosaic of raw or georeferenced images, each pixel resampled once.

    Parameters
    ----------
    images : Block, sequence of Block or path, or path
        A block with its orientation, or several of different sensors over one ground; paths of georeferenced images.
    output : path
        GeoTIFF to write; labels, vectors and the STAC item go beside it.
    dem, dem_heights, dst_crs, resolution, bounds, like
        See `ortho`.
    **options
        Of `MosaicOptions`, which is composed of `RenderOptions`, `ColourOptions`, `SeamOptions`, `BlendOptions` and
        others: flat, such as `blend="multiband", threads=2`, or whole, such as `blending=BlendOptions("multiband")`.

    Returns
    -------
    MosaicResult
        With gains, accuracies and what was written; `read()` gives the pixels.

    Raises
    ------
    GeomosaicError
        InputError, OutputError, SensorError or SolveError; nothing is left under the output's names.
    """
    blocks = tuple(on_ground(block, dem, dem_heights) for block in as_blocks(images))
    place, wanted = area(dst_crs, resolution, bounds, like), MosaicOptions.of(**options)
    planar = next((block.planar for block in blocks if block.planar is not None), None)
    if planar is None:
        return make_mosaic(blocks, place, path_of(output, "output"), wanted)
    if len(blocks) > 1:
        raise InputError(
            "photos that are placed together make a mosaic by themselves",
            where="`kind`",
            hint="make them alone, and mosaic the result with the others",
        )
    return make_planar_mosaic(blocks[0], planar, place, path_of(output, "output"), wanted)


@dataclass(frozen=True, eq=False)
class EdgeMosaic:
    """Photos joined exactly at common points, and their mosaic.

    Attributes
    ----------
    match : EdgeMatch
        Misfits before and after, residuals, blunders.
    mosaic : MosaicResult
    """

    match: EdgeMatch
    mosaic: MosaicResult


def match_edges(
    images: Sequence[PathLike],
    output: PathLike,
    gcps: PathLike,
    common: PathLike,
    crs: str,
    *,
    bands: tuple[int, ...] | None = None,
    **options: Any,
) -> EdgeMosaic:
    """Photos adjusted to control and common points together, joined exactly at their edges, and their mosaic.

    Parameters
    ----------
    images : sequence of path
    output : path
        GeoTIFF to write.
    gcps : path
        Control points: id, x, y, z, image, col, row.
    common : path
        Points that neighbours show: id, image, col, row and optionally sigma_px.
    crs : str
        Of the control points.
    bands : tuple of int, optional
        Counted from 1.
    **options
        Of `EdgeOptions` (`model`, `reach`, `robust`, `insist`), the extent (`dst_crs`, `resolution`, `bounds`) and
        `MosaicOptions`, flat.

    Returns
    -------
    EdgeMosaic

    Raises
    ------
    GeomosaicError
        InputError, OutputError or SolveError; nothing is left under the output's name.
    """
    asked = compose(EdgeMosaicOptions, options)
    inputs = EdgeInputs(image_paths(images), path_of(gcps, "gcps"), path_of(common, "common"), crs, asked.fit, bands)
    matched, made = make_edge_mosaic(inputs, asked.area, path_of(output, "output"), asked)
    return EdgeMosaic(matched, made)


def develop(
    images: Block,
    output: PathLike,
    surface: PathLike,
    *,
    oblique: float = 80.0,
    resolution: float | None = None,
    bounds: Bounds | None = None,
    **options: Any,
) -> DevelopedResult:
    """Photos of a facade, a tower or a dome on its developed surface, in metres.

    Parameters
    ----------
    images : Scene or Block
        Positions and control count in the frame of the surface file.
    output : path
        GeoTIFF to write.
    surface : path
        Surface file (TOML): plane, cylinder, cone, sphere or ellipsoid.
    oblique : float
        Largest angle between line of sight and normal that is drawn, degrees.
    resolution, bounds
        See `ortho`, in metres of the development.
    **options
        Of `MosaicOptions`, flat; of one image those of `RenderOptions` count.

    Returns
    -------
    DevelopedResult

    Raises
    ------
    GeomosaicError
        InputError, OutputError, SensorError or SolveError; nothing is left under the output's name.
    """
    if not 0.0 < oblique < 90.0:
        raise InputError(f"{oblique} degrees cannot be drawn", where="`oblique`", hint="more than 0 and less than 90")
    place = area(None, resolution, bounds, None)
    from geomosaic.developed.develop import make_developed

    return make_developed(
        block_of(images, "images"),
        path_of(surface, "surface"),
        place,
        path_of(output, "output"),
        MosaicOptions.of(**options),
        oblique,
    )
