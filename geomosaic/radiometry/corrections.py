"""Corrections of an image's values: rising tone curves, and fields of light and lens by place and value.

Corrections are products, so their logarithms add up: log field = Σ βₖ·Bₖ(place). Places are given twice: in the image,
from its centre in units of half its diagonal (so 1 in the corners), and on the ground, from the nadir, east and north,
in units of half the footprint's diagonal. Effects of the camera are functions of the first, effects of sun and view of
the second.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from geomosaic.interpolation import interval
from geomosaic.types import AnyArray, FloatArray, IntArray

# Even powers of the radius: ρ², ρ⁴, ρ⁶ (D. B. Goldman, Vignette and exposure calibration, PAMI 32, 2010).
RADIAL = 3
# x, y, x² − y² and 2xy: the view-angle trend up to second order; x² + y² cannot be told from vignetting.
TREND = 4
# Intervals of the cubic splines of a hotspot across −1 … 1.
SPANS = 6
NODES = SPANS + 3
# Terms that images share; 'haze', 'gamma' and 'dodging' are each image's own.
SHARED = ("vignetting", "trend", "hotspot")
TERMS = (*SHARED, "haze", "gamma", "dodging")


def _width(terms: Collection[str], cameras: int) -> int:
    """Number of shared functions, columns of `shared_functions`, of a set of terms; each camera has a vignetting."""
    return (
        RADIAL * cameras * ("vignetting" in terms) + TREND * ("trend" in terms) + NODES * NODES * ("hotspot" in terms)
    )


def shared_functions(
    terms: Collection[str], cameras: int, camera: IntArray, image: FloatArray, view: FloatArray
) -> FloatArray:
    """Values of the functions that images share.

    Parameters
    ----------
    terms : collection of str
        Of `SHARED`.
    cameras : int
    camera : int array (N,)
        Number of the camera; below 0 for what no camera of the block took, where all functions are 0.
    image, view : array (N, 2)
        Positions in the image and on the ground, see above.

    Returns
    -------
    array (N, width)
    """
    parts = [np.zeros((len(camera), 0))]
    if "vignetting" in terms:
        rho2 = (image**2).sum(axis=1)
        radial = np.stack([rho2, rho2**2, rho2**3], axis=1)
        own = camera[:, None] == np.arange(cameras)
        parts.append((own[:, :, None] * radial[:, None, :]).reshape(len(camera), -1))
    if "trend" in terms:
        x, y = view.T
        parts.append(np.stack([x, y, x**2 - y**2, 2 * x * y], axis=1))
    if "hotspot" in terms:
        across, down = _cubic_splines(view[:, 0]), _cubic_splines(view[:, 1])
        parts.append((down[:, :, None] * across[:, None, :]).reshape(len(camera), -1))
    return np.where(camera[:, None] >= 0, np.concatenate(parts, axis=1), 0.0)


def excess_air_path(view: FloatArray) -> FloatArray:
    """Excess of the path through the air over that at the nadir.

    Parameters
    ----------
    view : array (..., 2)
        Positions on the ground from the nadir, in units of half the footprint's diagonal.

    Returns
    -------
    array (...)
        0 at the nadir, 1 in the corners.
    """
    # The path grows as 1 / cos θ ≈ 1 + tan²θ / 2, and tan θ with the distance from the nadir.
    return np.asarray((view**2).sum(axis=-1))


def prior_normal_matrix(terms: Collection[str], cameras: int) -> FloatArray:
    """Normal matrix of the prior on the shared functions: fields are no larger and no rougher than light makes.

    Parameters
    ----------
    terms : collection of str
        Of `SHARED`.
    cameras : int

    Returns
    -------
    array (width, width)
        In the order of `shared_functions`.
    """
    # Standard deviations in logarithms of a gain: 1 of coefficients of vignetting, 0.5 of a trend's and of a hotspot's
    # nodes, 0.1 of second differences of these nodes.
    size = _width(terms, cameras)
    normal, at = np.zeros((size, size)), 0
    if "vignetting" in terms:
        here = np.arange(at, at + RADIAL * cameras)
        normal[here, here] = 1.0
        at += len(here)
    if "trend" in terms:
        here = np.arange(at, at + TREND)
        normal[here, here] = 1 / 0.5**2
        at += TREND
    if "hotspot" in terms:
        normal[at:, at:] = np.eye(NODES * NODES) / 0.5**2 + roughness(NODES) / 0.1**2
    return normal


def roughness(nodes: int) -> FloatArray:
    """Normal matrix of the bending energy of a thin plate on a net of nodes, f_xx² + 2·f_xy² + f_yy².

    Parameters
    ----------
    nodes : int
        Along each side.

    Returns
    -------
    array (nodes², nodes²)
        Nodes row by row.
    """
    same = np.eye(nodes)
    slope, bend = (rule.T @ rule for rule in (np.diff(same, order, axis=0) for order in (1, 2)))
    # With the mixed term twice, the energy does not depend on the directions of rows and columns.
    return np.asarray(np.kron(same, bend) + np.kron(bend, same) + 2 * np.kron(slope, slope))


def _cubic_splines(t: FloatArray) -> FloatArray:
    """Uniform cubic B-splines (N, NODES) over −1 … 1; positions beyond are those of the ends."""
    first, u = interval((t + 1) / 2 * SPANS, SPANS + 1)
    weights = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]) / 6
    out = np.zeros((len(t), NODES))
    rows = np.arange(len(t))
    # Each position has four splines that are not 0.
    for k in range(4):
        out[rows, first + k] = weights[k]
    return out


def bilinear_weights(image: FloatArray, nodes: int) -> tuple[IntArray, FloatArray]:
    """Bilinear weights of the nodes of a net over −1 … 1.

    Parameters
    ----------
    image : array (N, 2)
        Positions in the image.
    nodes : int
        Along each side of the net.

    Returns
    -------
    number : int array (N, 4)
    weight : array (N, 4)
    """
    (col, row), (u, v) = (part.T for part in interval((image + 1) / 2 * (nodes - 1), nodes))
    number = np.stack([row * nodes + col, row * nodes + col + 1, (row + 1) * nodes + col, (row + 1) * nodes + col + 1])
    weight = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
    return number.T, weight.T


# Intervals of a tabulated curve over the range of values; linear in between.
CURVE_STEPS = 4096


@dataclass(frozen=True, eq=False)
class CorrectionField:
    """Correction by place and value, per band: net(place) · curve(value + dark − haze · path(place)) + offset.

    Attributes
    ----------
    net : array (rows, cols, bands)
        Gains at nodes; at least 2 × 2 of them.
    origin : (float, float)
        Column and row of the first node, in output pixels (the centre of the first pixel is 0.5, 0.5).
    spacing : (float, float)
        Output pixels between nodes, across and down.
    dark, offset : array (bands,)
    curve : array (bands, CURVE_STEPS + 1)
        Values for dark-corrected ones of 0, reach / CURVE_STEPS, ... reach; (bands, 0) where they stay as they are.
    reach : float
        Range of values.
    path : array (rows, cols)
        Excess air path at the nodes of the net; (0, 0) where there is no haze.
    haze : array (bands,)
        Grey values in the corners.
    """

    net: FloatArray
    origin: tuple[float, float]
    spacing: tuple[float, float]
    dark: FloatArray
    offset: FloatArray
    curve: FloatArray
    reach: float
    path: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    haze: FloatArray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(
        cls,
        net: FloatArray,
        origin: tuple[float, float],
        spacing: tuple[float, float],
        dark: FloatArray,
        gamma: FloatArray,
        reach: float,
        pivot: float,
    ) -> CorrectionField:
        """Field with tabulated powers that leave `pivot` unchanged; `net` holds all gains.

        Parameters
        ----------
        net : array (rows, cols, bands)
            Gains at nodes.
        origin : tuple of float
            Column and row of the first node, in output pixels.
        spacing : tuple of float
            Output pixels between nodes, across and down.
        dark, gamma : array (bands,)
            Grey values, and exponents of the powers.
        reach : float
            Range of values.
        pivot : float
            Grey value that stays as it is.
        """
        bands = len(dark)
        curve = np.zeros((bands, 0))
        if (gamma != 1.0).any():
            curve = pivot * (reach / pivot * np.arange(CURVE_STEPS + 1) / CURVE_STEPS)[None, :] ** gamma[:, None]
        return cls(np.ascontiguousarray(net, dtype=np.float64), origin, spacing, dark, np.zeros(bands), curve, reach)

    def then(self, gain: FloatArray, offset: FloatArray) -> CorrectionField:
        """Field followed by gain · corrected + offset."""
        return replace(self, net=np.ascontiguousarray(self.net * gain), offset=self.offset * gain + offset)

    def at(self, col: float, row: float) -> tuple[float, float]:
        """Position in the net, in nodes, of a position in output pixels."""
        return (col - self.origin[0]) / self.spacing[0], (row - self.origin[1]) / self.spacing[1]

    def __call__(self, values: AnyArray, cols: FloatArray, rows: FloatArray) -> FloatArray:
        """Corrected values of a raster (R, C, bands) with columns (C,) and rows (R,) in output pixels."""
        i, u = interval((cols - self.origin[0]) / self.spacing[0], self.net.shape[1])
        j, v = interval((rows - self.origin[1]) / self.spacing[1], self.net.shape[0])
        lines = self.net[j] + (self.net[j + 1] - self.net[j]) * v[:, None, None]
        gain = lines[:, i] + (lines[:, i + 1] - lines[:, i]) * u[None, :, None]
        clear = np.asarray(values, dtype=np.float64)
        if self.path.size:
            ways = self.path[j] + (self.path[j + 1] - self.path[j]) * v[:, None]
            clear = clear - self.haze * (ways[:, i] + (ways[:, i + 1] - ways[:, i]) * u)[..., None]
        return np.asarray(gain * self.tone(clear) + self.offset)

    def tone(self, values: FloatArray) -> FloatArray:
        """Values (..., bands) of the curve."""
        plain = values + self.dark
        if not self.curve.shape[1]:
            return plain
        at = np.maximum(plain * (CURVE_STEPS / self.reach), 0.0)
        step = np.minimum(at.astype(np.int64), CURVE_STEPS - 1)
        band = np.arange(self.curve.shape[0])
        low, high = self.curve[band, step], self.curve[band, step + 1]
        return np.asarray(low + (high - low) * (at - step))

    def line(self) -> tuple[FloatArray, FloatArray]:
        """Gain and offset (bands,) of the correction at the mean of the net, from a quarter to half of the range."""
        mean = self.net.mean(axis=(0, 1))
        ends = np.stack([np.full(len(self.dark), self.reach / 4), np.full(len(self.dark), self.reach / 2)])
        veil = self.haze * self.path.mean() if self.path.size else 0.0
        low, high = mean * self.tone(ends - veil) + self.offset
        gain = (high - low) / (ends[1] - ends[0])
        return gain, low - gain * ends[0]

    def digest(self) -> bytes:
        """Bytes of all that decides about values."""
        numbers = np.array([*self.origin, *self.spacing, self.reach])
        return b"".join(
            part.tobytes() for part in (self.net, numbers, self.dark, self.offset, self.curve, self.path, self.haze)
        )


@dataclass(frozen=True, eq=False)
class ToneCurve:
    """Rising curve per band: linear between its knots, of one slope beyond them.

    Attributes
    ----------
    knots : sequence of (x, y)
        One pair of arrays (K,) per band, x rising.
    slope : float
        Beyond them.
    """

    knots: Sequence[tuple[FloatArray, FloatArray]]
    slope: float = 1.0

    @classmethod
    def identity(cls, bands: int) -> ToneCurve:
        """Curve that leaves values as they are."""
        return cls([(np.zeros(1), np.zeros(1))] * bands)

    def __call__(self, values: AnyArray) -> FloatArray:
        """Values (..., bands) of the curve."""
        out = np.empty(values.shape, dtype=np.float64)
        for band, (x, y) in enumerate(self.knots):
            plain = np.asarray(values[..., band], dtype=np.float64)
            beyond = np.minimum(plain - x[0], 0.0) + np.maximum(plain - x[-1], 0.0)
            out[..., band] = np.interp(plain, x, y) + self.slope * beyond
        return out

    def line(self) -> tuple[FloatArray, FloatArray]:
        """Gain and offset (bands,) of the straight line between the quarters of the knots."""
        gain, offset = np.ones(len(self.knots)), np.zeros(len(self.knots))
        for band, (x, y) in enumerate(self.knots):
            low, high = len(x) // 4, (3 * (len(x) - 1)) // 4 if len(x) > 3 else len(x) - 1
            if x[high] > x[low]:
                gain[band] = (y[high] - y[low]) / (x[high] - x[low])
            offset[band] = np.mean(y) - gain[band] * np.mean(x)
        return gain, offset
