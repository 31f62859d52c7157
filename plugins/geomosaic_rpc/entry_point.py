"""Entry point of the sensor 'rpc': its inputs, its capabilities, its fits of other models, and an example."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from geomosaic.sensor.inputs import known_inputs
from geomosaic.sensor.plugin import Capabilities, ControlUse, SensorExample, SensorInput, SensorModel, SensorRequest
from geomosaic.types import FloatArray, IntArray

if TYPE_CHECKING:
    from geomosaic_rpc.fit import RpcFit
    from geomosaic_rpc.model import RpcModel
    from geomosaic_rpc.refinement import Refinement
    from geomosaic_rpc.tie_correction import TieCorrection

INPUTS = (
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


class RpcPlugin:
    """Plugin of the sensor 'rpc', which also fits, corrects and writes RPCs of other sensors.

    Its modules are loaded when they are asked for. See `geomosaic.sensor.plugin` for the power of fitting RPCs.
    """

    name = "rpc"
    summary = "satellite scenes with rational polynomial coefficients (RPC00B), refined by shift, drift or affine"
    inputs = INPUTS
    capabilities = Capabilities(control=ControlUse.ADJUSTMENT, embedded=True)
    example = EXAMPLE

    @property
    def model(self) -> type[RpcModel]:
        """Class of the models."""
        from geomosaic_rpc.model import RpcModel

        return RpcModel

    def files(self, path: Path) -> tuple[Path, ...]:
        """Files beside an image that its RPC may come from."""
        from geomosaic_rpc.build import files_beside

        return files_beside(path)

    def build(self, request: SensorRequest) -> RpcModel:
        """Model of one image; see `geomosaic_rpc.build`."""
        from geomosaic_rpc.build import build_model

        known_inputs(request.options, INPUTS, self.name, request.image)
        return build_model(request)

    @property
    def kinds(self) -> Mapping[str, int]:
        """Corrections in the image, and the least number of control points of each."""
        from geomosaic_rpc.refinement import LEAST

        return LEAST

    def fit_rational(self, model: SensorModel, heights: tuple[float, float]) -> RpcFit:
        """RPC fitted to a model; see `geomosaic_rpc.fit_rpc`."""
        from geomosaic_rpc.fit import fit_rpc

        return fit_rpc(model, heights)

    def rewrite_rational(self, model: RpcModel) -> RpcFit | None:
        """RPC with drift and affine corrections fitted into its coefficients; None where there are none."""
        from geomosaic_rpc.write import rewritten

        # A shift moves the offsets of an RPC and needs no fit.
        return rewritten(model) if model.parameters.values[2:].any() else None

    def refine_rational(
        self,
        model: RpcModel,
        xyz: FloatArray,
        colrow: FloatArray,
        kind: str,
        sigmas_px: FloatArray | None,
        ids: Sequence[str],
    ) -> Refinement:
        """RPC corrected by control points (N, 3) and their pixels (N, 2); see `geomosaic_rpc.refine`."""
        from geomosaic_rpc.refinement import refine

        return refine(model, xyz, colrow, kind, sigmas_px, ids)

    def correct_rational_by_ties(
        self,
        models: Sequence[RpcModel],
        image: IntArray,
        point: IntArray,
        colrow: FloatArray,
        kind: str,
        sigma_px: float,
        fixed: Sequence[int],
    ) -> TieCorrection:
        """RPCs corrected by tie points, image (M,) and point (M,) at pixels (M, 2); see `correct_by_ties`."""
        from geomosaic_rpc.tie_correction import TieMeasurements, correct_by_ties

        return correct_by_ties(models, TieMeasurements(image, point, colrow), kind, sigma_px=sigma_px, fixed=fixed)

    def rational_tags(self, model: RpcModel) -> dict[str, str]:
        """GDAL's RPC domain of an RPC, its corrections included."""
        from geomosaic_rpc.write import plain, tags_of

        return tags_of(plain(model))

    def rational_text(self, model: RpcModel) -> str:
        """Text of an _RPC.TXT file of an RPC, its corrections included."""
        from geomosaic_rpc.write import plain, text_of

        return text_of(plain(model))
