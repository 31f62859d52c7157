"""Pan-sharpening: the detail of a panchromatic band in the colours of coarser bands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import AnyArray, FloatArray

METHODS = ("regression", "brovey", "weighted")


@dataclass(frozen=True, eq=False)
class PanModel:
    """Linear model of the pan band from the others: pan = Σ weights · bands + offset; and gains of its detail.

    Attributes
    ----------
    method : str
    weights, gains : array (bands,)
    offset : float
    r2 : float
        Share of the variance of the (reduced) pan band that the bands explain.
    """

    method: str
    weights: FloatArray
    offset: float
    gains: FloatArray
    r2: float


def pan_model(method: str, bands: AnyArray, pan: AnyArray) -> PanModel:
    """Pan model from samples at the resolution of the bands.

    'regression': weights by least squares, gains cov(band, synthetic) / var(synthetic) (Gram-Schmidt adaptive: Aiazzi,
    Baronti and Selva, IEEE TGRS 45(10), 2007). 'weighted': the same weights, the detail added to all bands alike.
    'brovey': bands · pan / synthetic, with the same weights (Gillespie and others, 1987, has equal ones).

    Parameters
    ----------
    bands : array (N, bands)
    pan : array (N,)
        Means of the pan band over the same pixels.

    Raises
    ------
    InputError
        Unknown method, or too few or constant samples.
    """
    if method not in METHODS:
        raise InputError(f"there is no method '{method}'", where="`method`", hint=f"one of {', '.join(METHODS)}")
    x, y = bands.astype(np.float64), pan.astype(np.float64)
    if len(x) < 10 * (x.shape[1] + 1) or np.ptp(y) == 0:
        raise InputError("the bands and the pan band share too little ground", hint="do both show the same area?")
    mean = x.mean(axis=0)
    weights = np.linalg.lstsq(x - mean, y - y.mean(), rcond=None)[0]
    offset = float(y.mean() - mean @ weights)
    synthetic = x @ weights + offset
    spread = synthetic.var()
    gains = np.array([np.mean((x[:, k] - mean[k]) * (synthetic - synthetic.mean())) for k in range(x.shape[1])])
    gains = gains / spread if method == "regression" else np.ones(x.shape[1])
    r2 = 1.0 - float(np.var(y - synthetic) / np.var(y))
    return PanModel(method, weights, offset, gains, r2)


def pan_sharpened(model: PanModel, bands: AnyArray, pan: AnyArray) -> FloatArray:
    """Pan-sharpened bands (rows, cols, bands) from bands and pan (rows, cols), both on the pixels of the pan band."""
    x, y = bands.astype(np.float64), pan.astype(np.float64)
    synthetic = x @ model.weights + model.offset
    if model.method == "brovey":
        ratio = y / np.where(np.abs(synthetic) > 1e-9, synthetic, 1.0)
        return x * np.where(np.abs(synthetic) > 1e-9, ratio, 1.0)[..., None]
    sharp: FloatArray = x + model.gains * (y - synthetic)[..., None]
    return sharp


def magnified(values: AnyArray, rows: FloatArray, cols: FloatArray) -> FloatArray:
    """Cubic convolution (a = -0.5) of bands (R, C, bands) at rows and columns of a grid along their axes.

    Parameters
    ----------
    rows, cols : array
        Image coordinates: 0.5 is the centre of the first pixel. Beyond the edge the last pixel goes on.
    """
    picked = _along(values.astype(np.float64), rows, 0)
    return _along(picked, cols, 1)


def _along(values: FloatArray, places: FloatArray, axis: int) -> FloatArray:
    first = np.floor(places - 0.5).astype(int)
    t = places - 0.5 - first
    # Keys, 1981, with a = -0.5.
    weights = (
        -0.5 * t**3 + t**2 - 0.5 * t, 1.5 * t**3 - 2.5 * t**2 + 1.0,
        -1.5 * t**3 + 2.0 * t**2 + 0.5 * t, 0.5 * t**3 - 0.5 * t**2,
    )  # fmt: skip
    shape = [1] * values.ndim
    shape[axis] = len(places)
    total = np.zeros(())
    for k, weight in enumerate(weights):
        index = np.clip(first + k - 1, 0, values.shape[axis] - 1)
        total = total + np.take(values, index, axis=axis) * weight.reshape(shape)
    return total
