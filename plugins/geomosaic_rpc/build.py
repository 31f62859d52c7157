"""RPC models of an image: the coefficients found for it, refined by control points."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import GeomosaicWarning, InputError, SolveError
from geomosaic.geo.transform import Transform
from geomosaic.sensor.inputs import choice, number, numbers, point_rows
from geomosaic.sensor.plausibility import require_vertical_datum
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.types import FloatArray
from geomosaic_rpc.coefficients import Rpc
from geomosaic_rpc.find import OWN, FoundRpc, find_rpc, own_rpc, read_rpc
from geomosaic_rpc.model import KINDS, WGS84, RpcModel, refine

POINT = ("x", "y", "z", "col", "row")


def build_model(request: SensorRequest) -> RpcModel:
    """RPC model of one image, refined by its control points.

    Parameters
    ----------
    request : SensorRequest
        Image with its file, size in pixels, options of the sensor; the CRS is that of the control points.

    Returns
    -------
    RpcModel
        Ground in WGS 84 longitude, latitude (degrees) and ellipsoidal height (metres).

    Raises
    ------
    InputError
        There is no RPC, there are several, or an input is unknown or out of range.
    SolveError
        The control points do not determine the refinement.
    """
    where, options = request.image, request.options
    kind = choice(options.get("refine", "shift"), KINDS, "refine", where)
    found = _chosen(request)
    first = number(options["first_pixel"], "first_pixel", where) if "first_pixel" in options else None
    rpc = found.fields.rpc(f"{where} ({found.source})", first)
    corner = numbers(options.get("offset", (0.0, 0.0)), 2, "offset", where)
    if "offset" not in options:
        _warn_of_a_part(rpc, request.size, where)
    notes = (f"RPC of {found.source}, format {found.fields.format}",)
    model = RpcModel.of(rpc.moved(-corner[0], -corner[1]), request.size, kind, where=where, notes=notes)
    return _refined(model, request, kind) if options.get("points") else model


def _chosen(request: SensorRequest) -> FoundRpc:
    """RPC that the inputs name, or the one of the image."""
    named = request.options.get("rpc")
    if named is not None and (not isinstance(named, str) or not named.strip()):
        raise InputError(f"input 'rpc' is {named!r}, not the name of a file", where=request.image)
    if named is not None and named != OWN:
        file = Path(request.base) / named
        if not file.is_file():
            raise InputError(f"there is no RPC file '{named}'", where=request.image, hint="check the path")
        return FoundRpc(file.name, read_rpc(file))
    if request.path is None:
        raise InputError(
            "nothing says where the RPC is: neither a file of the image nor one of the RPC is known",
            where=request.image,
            hint="give rpc = FILE",
        )
    if named is None:
        return find_rpc(request.path, request.image)
    own = own_rpc(request.path)
    if own is None:
        raise InputError("the image carries no RPC", where=request.image, hint="name its file: rpc = FILE")
    return own


def _warn_of_a_part(rpc: Rpc, size: tuple[int, int], where: str) -> None:
    """Warning about an image much smaller than the scene whose RPC counts from the corner of the scene."""
    whole = 2.0 * np.abs(rpc.image_scale)
    corner = rpc.image_offset - np.abs(rpc.image_scale)
    # An RPC's box may reach a little beyond its scene; an image of less than half of it is a cut, or was reduced.
    if (np.abs(corner) < 0.02 * whole).all() and (np.array(size) < 0.5 * whole).any():
        warnings.warn(
            f"{where}: the image has {size[0]} x {size[1]} pixels, its RPC is made for about {whole[0]:.0f} x "
            f"{whole[1]:.0f}; it is taken for the upper-left part. If it is another part, give offset = [col, row] of "
            "its corner in the scene; if it was reduced, its RPC does not fit",
            GeomosaicWarning,
            stacklevel=4,
        )


def _refined(model: RpcModel, request: SensorRequest, kind: str) -> RpcModel:
    """Model corrected by the control points of the inputs; wrong ones are named."""
    where = request.image
    if kind == "none":
        raise InputError("there are control points, but refine is 'none'", where=where, hint="leave one of them out")
    if request.crs is None:
        raise InputError("the control points have no CRS", where=where, hint="name it, e.g. EPSG:32633")
    require_vertical_datum(request.crs, "the control points", where, lambda _: model)
    names, ground, image, sigmas = _points(request.options["points"], where)
    try:
        found = refine(model, Transform(request.crs, WGS84)(ground), image, kind, sigmas)
    except SolveError as error:
        error.where = where
        raise
    if not found.used.all():
        left = ", ".join(
            f"{name} ({length:.1f} px)"
            for name, length, used in zip(names, np.hypot(*found.residuals.T), found.used, strict=True)
            if not used
        )
        warnings.warn(
            f"{where}: control points that contradict the others were left out: {left}", GeomosaicWarning, stacklevel=4
        )
    return found.model


def _points(points: Any, where: str) -> tuple[list[str], FloatArray, FloatArray, FloatArray | None]:
    """Names, ground (N, 3), image (N, 2) and sigmas (N,) of control points; no sigmas where none is given."""
    names, rows = point_rows(points, POINT, where)
    table = np.array(rows)
    known = all("sigma" in point for point in points)
    return names, table[:, :3], table[:, 3:5], table[:, 5] if known else None
