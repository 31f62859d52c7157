"""Optional power of a sensor plugin: rational polynomials (RPC) in place of any model, corrected, and written.

The core imports no plugin. It asks the registry for one that has this power, and hands it models of any sensor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from geomosaic.sensor.model import SensorModel
from geomosaic.types import BoolArray, FloatArray, IntArray


class RationalFit(Protocol):
    """Rational polynomials fitted to a model, with their error at points that took no part in the fit."""

    @property
    def model(self) -> SensorModel:
        """The rational model."""

    @property
    def rms(self) -> float:
        """RMS distance from the model fitted to, pixels."""

    @property
    def worst(self) -> float:
        """Largest one."""

    @property
    def checks(self) -> int:
        """Number of check points."""

    @property
    def heights(self) -> tuple[float, float]:
        """Lowest and highest ellipsoidal height fitted to, metres."""


class RationalRefinement(Protocol):
    """A rational model corrected with control points."""

    @property
    def model(self) -> SensorModel:
        """Corrected."""

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations (P,) of its parameters."""

    @property
    def residuals(self) -> FloatArray:
        """Measured minus computed (N, 2), pixels."""

    @property
    def used(self) -> BoolArray:
        """Mask (N,) of the points that took part."""

    @property
    def rms_before(self) -> float:
        """RMS length of the residuals of the points used, before."""

    @property
    def rms_after(self) -> float:
        """And after."""


class RationalTieCorrection(Protocol):
    """Rational models corrected so that lines of sight of tie points meet."""

    @property
    def models(self) -> Sequence[SensorModel]:
        """Corrected."""

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations (K, P) of their parameters."""

    @property
    def used(self) -> BoolArray:
        """Mask of the tie points that took part."""

    @property
    def rms_before(self) -> float:
        """RMS length of the residuals of the measurements used, before, pixels."""

    @property
    def rms_after(self) -> float:
        """And after."""


@runtime_checkable
class HasRational(Protocol):
    """A plugin whose models are rational polynomials."""

    kinds: Mapping[str, int]
    """Corrections it knows, and how many control points each needs."""

    def fit_rational(self, model: SensorModel, heights: tuple[float, float]) -> RationalFit:
        """RPC fitted to any model with heights, between two ellipsoidal heights in metres."""

    def rewrite_rational(self, model: Any) -> RationalFit | None:
        """RPC fitted again where no format has a place for its correction, such as drift; None where none is needed."""

    def refine_rational(
        self, model: Any, xyz: FloatArray, colrow: FloatArray, kind: str, sigmas_px: FloatArray | None
    ) -> RationalRefinement:
        """RPC corrected by control points: (N, 3) in `model.crs`, (N, 2) pixels; wrong ones are left out."""

    def correct_rational_by_ties(
        self,
        models: Sequence[Any],
        image: IntArray,
        point: IntArray,
        colrow: FloatArray,
        kind: str,
        sigma_px: float,
        fixed: Sequence[int],
    ) -> RationalTieCorrection:
        """RPCs corrected by tie points: image (M,) and point (M,) of each measurement, colrow (M, 2)."""

    def rational_tags(self, model: Any) -> dict[str, str]:
        """GDAL's RPC domain of a rational model."""

    def rational_text(self, model: Any) -> str:
        """Text of its _RPC.TXT file."""
