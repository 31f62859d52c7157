"""What the core asks of a plugin of rational polynomials: see `geomosaic.sensor.rational`."""

from __future__ import annotations

from collections.abc import Sequence

from geomosaic.sensor.model import SensorModel
from geomosaic.types import FloatArray, IntArray
from geomosaic_rpc.fit import RpcFit, fit_rpc
from geomosaic_rpc.model import RpcModel
from geomosaic_rpc.refine import LEAST, Refinement, refine
from geomosaic_rpc.tie_correction import Relation, Sights, relate
from geomosaic_rpc.write import plain, rewritten, tags_of, text_of


class RationalPower:
    """Fitting, correcting and writing, by the names the core knows."""

    kinds = LEAST

    def fit_rational(self, model: SensorModel, heights: tuple[float, float]) -> RpcFit:
        """See `fit_rpc`."""
        return fit_rpc(model, heights)

    def rewrite_rational(self, model: RpcModel) -> RpcFit | None:
        """Fit drift and affine corrections into the coefficients; None where there are none."""
        return rewritten(model) if model.parameters.values[2:].any() else None

    def refine_rational(
        self, model: RpcModel, xyz: FloatArray, colrow: FloatArray, kind: str, sigmas_px: FloatArray | None
    ) -> Refinement:
        """See `refine`."""
        return refine(model, xyz, colrow, kind, sigmas_px)

    def relate_rational(
        self,
        models: Sequence[RpcModel],
        image: IntArray,
        point: IntArray,
        colrow: FloatArray,
        kind: str,
        sigma_px: float,
        fixed: Sequence[int],
    ) -> Relation:
        """See `relate`."""
        return relate(models, Sights(image, point, colrow), kind, sigma_px=sigma_px, fixed=fixed)

    def rational_tags(self, model: RpcModel) -> dict[str, str]:
        """GDAL's RPC domain, corrections included."""
        return tags_of(plain(model))

    def rational_text(self, model: RpcModel) -> str:
        """Text of an _RPC.TXT file, corrections included."""
        return text_of(plain(model))
