"""RPC plugin: from an image and its inputs to a model, with an example."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import GeomosaicWarning, InputError, SolveError
from geomosaic.geo.transform import Transform
from geomosaic.sensor.inputs import choice, known_inputs, number, numbers, point_rows
from geomosaic.sensor.plugin import SensorExample, SensorInput, SensorRequest
from geomosaic.sensor.vertical_datum import need_heights
from geomosaic.types import FloatArray
from geomosaic_rpc.capability import RationalPower
from geomosaic_rpc.coefficients import Rpc
from geomosaic_rpc.find import OWN, Found, files_beside, find_rpc, own_rpc, read_rpc
from geomosaic_rpc.model import KINDS, WGS84, RpcModel
from geomosaic_rpc.refine import refine

_ZEROS = ", ".join(["0.0"] * 16)
_ONE = ", ".join(["1.0", *["0.0"] * 19])

EXAMPLE = SensorExample(
    (4000, 3000),
    """\
[sensor]
name = "rpc"
rpc = "scene.RPB"

[dem]
height = 420.0
heights = "ellipsoidal"
""",
    {
        "scene.RPB": f"""\
satId = "XX01";
bandId = "P";
SpecId = "RPC00B";
BEGIN_GROUP = IMAGE
  errBias = 10.0;
  errRand = 0.5;
  lineOffset = 1499.5;
  sampOffset = 1999.5;
  latOffset = 45.6;
  longOffset = 12.3;
  heightOffset = 420.0;
  lineScale = 1500.0;
  sampScale = 2000.0;
  latScale = 0.0125;
  longScale = 0.021;
  heightScale = 500.0;
  lineNumCoef = (0.0, 0.14, -0.99, 0.05, {_ZEROS});
  lineDenCoef = ({_ONE});
  sampNumCoef = (0.0, 1.0, 0.12, 0.03, {_ZEROS});
  sampDenCoef = ({_ONE});
END_GROUP = IMAGE
END;
"""
    },
)


POINT = ("x", "y", "z", "col", "row")


class RpcPlugin(RationalPower):
    """Sensor 'rpc'."""

    name = "rpc"
    summary = "satellite scenes with rational polynomial coefficients (RPC00B), refined by shift, drift or affine"
    inputs = (
        SensorInput(
            "rpc",
            "file of the RPC: _RPC.TXT, RPB, DIMAP 2 or 3 XML, DigitalGlobe XML, OSSIM keyword list; or 'image', what "
            "the image itself carries (TIFF tags, NITF)",
            default="found in the image or beside it",
        ),
        SensorInput(
            "first_pixel",
            "what the RPC calls the centre of the upper-left pixel",
            "px",
            "that of the format: 1 for Pleiades and SPOT 6 and 7 XML, 0 for all others",
        ),
        SensorInput(
            "offset",
            "[col, row] of the image's corner in the scene the RPC was made for, for a part of it",
            "px",
            "0, 0",
        ),
        SensorInput(
            "refine",
            "what is corrected in the image: none, shift, drift (shift and drift along the rows) or affine",
            default="shift",
        ),
        SensorInput(
            "points", "control points for it, each with x, y, z, col, row and optionally id and sigma (pixels)", "CRS"
        ),
    )
    model = RpcModel
    example = EXAMPLE

    def files(self, path: Path) -> tuple[Path, ...]:
        """Files beside an image that its RPC may come from."""
        return files_beside(path)

    def build(self, request: SensorRequest) -> RpcModel:
        """Make the model of one image.

        Raises
        ------
        InputError
            There is no RPC, there are several, or an input is unknown or out of range.
        SolveError
            The control points do not determine the refinement.
        """
        where, options = request.image, request.options
        known_inputs(options, self.inputs, self.name, where)
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


def _chosen(request: SensorRequest) -> Found:
    """Find the RPC that the inputs name, or the one of the image."""
    named = request.options.get("rpc")
    if named is not None and (not isinstance(named, str) or not named.strip()):
        raise InputError(f"input 'rpc' is {named!r}, not the name of a file", where=request.image)
    if named is not None and named != OWN:
        file = Path(request.base) / named
        if not file.is_file():
            raise InputError(f"there is no RPC file '{named}'", where=request.image, hint="check the path")
        return Found(file.name, read_rpc(file))
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
    """Say so where the image is much smaller than the scene, and its RPC counts from the corner of the scene."""
    whole = 2.0 * np.abs(rpc.image_scale)
    corner = rpc.image_offset - np.abs(rpc.image_scale)
    if (np.abs(corner) < 0.02 * whole).all() and (np.array(size) < 0.5 * whole).any():
        warnings.warn(
            f"{where}: the image has {size[0]} x {size[1]} pixels, its RPC is made for about {whole[0]:.0f} x "
            f"{whole[1]:.0f}; it is taken for the upper-left part. If it is another part, give offset = [col, row] of "
            "its corner in the scene; if it was reduced, its RPC does not fit",
            GeomosaicWarning,
            stacklevel=4,
        )


def _refined(model: RpcModel, request: SensorRequest, kind: str) -> RpcModel:
    """Correct the model with the control points of the inputs; wrong ones are named."""
    where = request.image
    if kind == "none":
        raise InputError("there are control points, but refine is 'none'", where=where, hint="leave one of them out")
    if request.crs is None:
        raise InputError("the control points have no CRS", where=where, hint="name it, e.g. EPSG:32633")
    need_heights(request.crs, "the control points", where, lambda _: model)
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
