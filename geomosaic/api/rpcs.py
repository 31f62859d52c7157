"""Rational polynomials: fitted to the model of any sensor, or refined by control and tie points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from geomosaic.inputs.declarations import Block, as_block
from geomosaic.options.control import RefineOptions, RpcOptions
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
    **options: Any,
) -> tuple[ImageRpc, ...]:
    """RPC of each image, corrected by the control points of the block and by tie points.

    Parameters
    ----------
    images : Scene, Block, sequence of path or path
        That come with an RPC; `control` of the block takes part.
    kind : str
        'shift', 'drift' (shift and drift) or 'affine'.
    **options
        Of `TieOptions` (`ties` between the images, `fixed` images, `sigma_px`) and `RpcOptions`; `height_range` for an
        RPC with a correction grid, which is fitted first.
        RPC with a correction grid, which is fitted first.

    Returns
    -------
    tuple of ImageRpc
        With the residuals before and after, pixels.

    Raises
    ------
    InputError, SolveError, OutputError
    """
    asked = compose(RefineOptions, options)
    return make_rpcs(RpcInputs(_block(images), asked.files, kind, asked.tied))


def _block(images: Block | Sequence[PathLike] | PathLike) -> Block:
    return images if isinstance(images, Block) else replace(as_block(images), sensor=rational_sensor())
