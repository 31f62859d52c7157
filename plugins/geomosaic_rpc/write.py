"""RPCs for other programs: TIFF tags and _RPC.TXT, both RPC00B with pixel centres counted from 0."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from geomosaic.errors import OutputExistsError
from geomosaic.raster.image_metadata import write_rpc_tags
from geomosaic.stores.path import to_path
from geomosaic.types import PathLike
from geomosaic.whole_files import write_atomic
from geomosaic_rpc.coefficients import Rpc
from geomosaic_rpc.fit import RpcFit, fit_rpc
from geomosaic_rpc.formats import POLYNOMIALS, SCALARS
from geomosaic_rpc.model import RpcModel

_UNITS = {"LINE": "pixels", "SAMP": "pixels", "LAT": "degrees", "LONG": "degrees", "HEIGHT": "meters"}


def plain(model: RpcModel) -> Rpc:
    """Coefficients that include the corrections of a model, which no RPC format has a place for.

    Parameters
    ----------
    model : RpcModel

    Raises
    ------
    SolveError
        No rational polynomials describe the corrected model.
    """
    # A shift goes into the offsets and nothing is lost. Drift and affine corrections are fitted again, over the heights
    # the RPC was made for; `fit_rpc` of the model tells the error, which is far below 0.001 px.
    values = model.parameters.values
    if not values[2:].any():
        return model.rpc.moved(float(values[0]), float(values[1]))
    return rewritten(model).model.rpc


def rewritten(model: RpcModel) -> RpcFit:
    """RPC fitted to a model with its corrections, over the heights its RPC was made for.

    Parameters
    ----------
    model : RpcModel

    Raises
    ------
    SolveError
        As `fit_rpc`.
    """
    # Beyond these heights the producer's polynomials are extrapolated, and a fit would copy their bends.
    middle, half = float(model.rpc.ground_offset[2]), abs(float(model.rpc.ground_scale[2]))
    return fit_rpc(model, (middle - half, middle + half))


def tags_of(rpc: Rpc) -> dict[str, str]:
    """GDAL's metadata domain 'RPC' of coefficients, in full precision.

    Parameters
    ----------
    rpc : Rpc

    Returns
    -------
    dict of str
        Texts by name; errors of −1 where they are not known.
    """
    numbers = dict(zip(SCALARS, _scalars(rpc), strict=True))
    bias, random = rpc.errors or (-1.0, -1.0)  # -1: unknown
    tags = {"ERR_BIAS": _text(bias), "ERR_RAND": _text(random)}
    tags |= {name: _text(value) for name, value in numbers.items()}
    return tags | {
        name: " ".join(map(_text, row)) for name, row in zip(POLYNOMIALS, rpc.coefficients.tolist(), strict=True)
    }


def text_of(rpc: Rpc) -> str:
    """Text of an _RPC.TXT file, in full precision.

    Parameters
    ----------
    rpc : Rpc
    """
    lines = [
        f"{name}: {_text(value)} {_UNITS[name.partition('_')[0]]}"
        for name, value in zip(SCALARS, _scalars(rpc), strict=True)
    ]
    if rpc.errors is not None:
        lines = [f"ERR_BIAS: {_text(rpc.errors[0])} meters", f"ERR_RAND: {_text(rpc.errors[1])} meters", *lines]
    rows = dict(zip(POLYNOMIALS, rpc.coefficients.tolist(), strict=True))
    for name in ("LINE_NUM_COEFF", "LINE_DEN_COEFF", "SAMP_NUM_COEFF", "SAMP_DEN_COEFF"):
        lines += [f"{name}_{k}: {_text(value)}" for k, value in enumerate(rows[name], 1)]
    return "\n".join(lines) + "\n"


def write_text(model: RpcModel, image: PathLike, *, overwrite: bool = False) -> Path:
    """Write the RPC of a model, corrections included, as the _RPC.TXT file that belongs to an image.

    Parameters
    ----------
    model : RpcModel
    image : path
        Image file, NAME.tif; the RPC becomes NAME_RPC.TXT beside it.
    overwrite : bool
        Replace a file of that name.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    OutputExistsError
        There is one already.
    SolveError
        As `plain`.
    """
    path = to_path(image)
    path = path.with_name(f"{path.stem}_RPC.TXT")
    if path.exists() and not overwrite:
        raise OutputExistsError("the RPC file exists", where=str(path), hint="move it away, or allow overwriting")
    write_atomic(path, text_of(plain(model)), "ascii")
    return path


def write_tags(model: RpcModel, image: PathLike) -> None:
    """Write the RPC of a model, corrections included, into the tags of an existing TIFF; its pixels stay as they are.

    Parameters
    ----------
    model : RpcModel
    image : path
        TIFF file.

    Raises
    ------
    OutputError
        The file is no TIFF that can be changed.
    SolveError
        As `plain`.
    """
    write_rpc_tags(image, tags_of(plain(model)))


def _scalars(rpc: Rpc) -> list[float]:
    """Values of `SCALARS`; in RPC00B the centre of the first pixel is 0, not 0.5."""
    (sample, line), (lon, lat, height) = (rpc.image_offset - 0.5).tolist(), rpc.ground_offset.tolist()
    (samples, lines), (lons, lats, heights) = rpc.image_scale.tolist(), rpc.ground_scale.tolist()
    return [line, sample, lat, lon, height, lines, samples, lats, lons, heights]


def _text(value: float) -> str:
    """Shortest text that gives the same number back."""
    return repr(float(np.float64(value)))
