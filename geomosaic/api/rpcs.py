"""Rational polynomials: fitted to the model of any sensor, or refined by control and tie points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from geomosaic.inputs.declarations import Block, as_block
from geomosaic.rpc.refine import ImageRpc
from geomosaic.rpc.write import RpcInputs, make_rpcs
from geomosaic.sensor.registry import rational_sensor
from geomosaic.types import PathLike


def fit_rpc(
    images: Block | Sequence[PathLike] | PathLike,
    *,
    height_range: tuple[float, float] | None = None,
    tags: bool = False,
    text: bool = False,
    grid: bool = False,
    folder: PathLike | None = None,
    overwrite: bool = False,
) -> tuple[ImageRpc, ...]:
    """RPC of each image, fitted to the model of its sensor.

    Parameters
    ----------
    images : Scene, Block, sequence of path or path
        Paths are of images that come with an RPC.
    height_range : tuple of float, optional
        Lowest and highest ellipsoidal height, metres; those of the DEM under the image unless given.
    tags : bool
        Write the RPC into the tags of the images (GeoTIFF), in place.
    text : bool
        Write IMAGE_RPC.TXT.
    grid : bool
        Write IMAGE_RPC_grid.csv, what the RPC cannot follow of the sensor.
    folder : path, optional
        For text files and grids; beside the images unless given.
    overwrite : bool
        Replace an RPC that the image or the file has.

    Returns
    -------
    tuple of ImageRpc
        With the RMS and the largest error of the fit, pixels.

    Raises
    ------
    InputError, SolveError, OutputError
    """
    return make_rpcs(
        RpcInputs(
            _block(images),
            heights=height_range,
            tags=tags,
            text=text,
            grid=grid,
            folder=_path(folder),
            overwrite=overwrite,
        )
    )


def refine_rpc(
    images: Block | Sequence[PathLike] | PathLike,
    kind: str,
    *,
    ties: PathLike | None = None,
    fixed: Sequence[str] = (),
    sigma_px: float = 0.5,
    height_range: tuple[float, float] | None = None,
    tags: bool = False,
    text: bool = False,
    folder: PathLike | None = None,
    overwrite: bool = False,
) -> tuple[ImageRpc, ...]:
    """RPC of each image, corrected by the control points of the block and by tie points.

    Parameters
    ----------
    images : Scene, Block, sequence of path or path
        That come with an RPC; `control` of the block takes part.
    kind : str
        'shift', 'drift' (shift and drift) or 'affine'.
    ties : path, optional
        Tie points between the images: id, image, col, row.
    fixed : sequence of str
        Images that tie points leave as they are.
    sigma_px : float
        Standard deviation of tie points, pixels.
    height_range : tuple of float, optional
        Of an RPC with a correction grid, which is fitted first; see `fit_rpc`.
    tags, text, folder, overwrite
        See `fit_rpc`.

    Returns
    -------
    tuple of ImageRpc
        With the residuals before and after, pixels.

    Raises
    ------
    InputError, SolveError, OutputError
    """
    return make_rpcs(
        RpcInputs(
            _block(images),
            heights=height_range,
            refine=kind,
            ties=_path(ties),
            fixed=tuple(fixed),
            sigma_px=sigma_px,
            tags=tags,
            text=text,
            folder=_path(folder),
            overwrite=overwrite,
        )
    )


def _block(images: Block | Sequence[PathLike] | PathLike) -> Block:
    return images if isinstance(images, Block) else replace(as_block(images), sensor=rational_sensor())


def _path(given: PathLike | None) -> Path | None:
    return None if given is None else Path(given)
