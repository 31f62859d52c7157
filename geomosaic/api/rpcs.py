"""Rational polynomials: fitted to the model of any sensor, or refined by control and tie points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from geomosaic.inputs.declarations import Block, as_block
from geomosaic.options.control import RpcOptions
from geomosaic.options.declaration import compose
from geomosaic.rpc.refine import ImageRpc
from geomosaic.rpc.write import RpcInputs, make_rpcs
from geomosaic.sensor.registry import rational_sensor
from geomosaic.types import PathLike


def fit_rpc(
    images: Block | Sequence[PathLike] | PathLike,
    **options: Any,
) -> tuple[ImageRpc, ...]:
    """RPC of each image, fitted to the model of its sensor.

    Parameters
    ----------
    images : Scene, Block, sequence of path or path
        Paths are of images that come with an RPC.
    **options
        Of `RpcOptions`: `height_range`, `tags`, `text`, `grid`, `folder`, `overwrite`.

    Returns
    -------
    tuple of ImageRpc
        With the RMS and the largest error of the fit, pixels.

    Raises
    ------
    InputError, SolveError, OutputError
    """
    return make_rpcs(RpcInputs(_block(images), compose(RpcOptions, options)))


def refine_rpc(
    images: Block | Sequence[PathLike] | PathLike,
    kind: str,
    *,
    ties: PathLike | None = None,
    fixed: Sequence[str] = (),
    sigma_px: float = 0.5,
    **options: Any,
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
    **options
        Of `RpcOptions`; `height_range` for an RPC with a correction grid, which is fitted first.

    Returns
    -------
    tuple of ImageRpc
        With the residuals before and after, pixels.

    Raises
    ------
    InputError, SolveError, OutputError
    """
    wanted = compose(RpcOptions, options)
    return make_rpcs(RpcInputs(_block(images), wanted, kind, _path(ties), tuple(fixed), sigma_px))


def _block(images: Block | Sequence[PathLike] | PathLike) -> Block:
    return images if isinstance(images, Block) else replace(as_block(images), sensor=rational_sensor())


def _path(given: PathLike | None) -> Path | None:
    return None if given is None else Path(given)
