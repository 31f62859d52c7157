"""Marks in images: fiducial and other marks found by least-squares matching of a template.

Whole pixels come from the peak of the normalised cross-correlation, fractions from least-squares matching (Förstner
1982; Gruen 1985) with two shifts, scale, rotation, gain and offset. Pixels of a mark that do not fit, as those of
scratches, dust and frame lettering, lose their weight step by step (Beaton and Tukey's biweight). A mark may be light
on dark in the one image and dark on light in the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.estimation.statistics import BIWEIGHT_LIMIT, MAD_TO_SIGMA, biweight
from geomosaic.types import AnyArray, FloatArray

_MARK_ITERATIONS = 25
# Step in pixels, and relative change of scale, at which the iteration ends.
_MARK_CONVERGED = 5e-4
# Smallest correlation of a symmetric template with itself turned by 180°.
MIN_SYMMETRY = 0.8
# A-priori standard deviation of scale and rotation (radians).
PRIOR_SIGMA = 0.02
# Pixels from the peak of the correlation beyond which the matching has drifted to something else.
MAX_DISTANCE = 4.0
# Peaks of the correlation from which matching starts.
PEAKS = 6
# Windows about a mark that was pointed at, each nearer to its centre.
_WINDOWS = 6
# Smallest robust scale of residuals, in parts of the contrast: sampling and blur of two images differ by as much.
MIN_RESIDUAL_SCALE = 0.03


@dataclass(frozen=True)
class MarkTemplate:
    """Image of a mark, and where its centre is.

    Attributes
    ----------
    values : array (rows, cols)
        Grey values.
    centre : tuple of float
        (col, row) of the mark's centre; (0.5, 0.5) is the centre of the upper-left pixel.
    """

    values: FloatArray
    centre: tuple[float, float]

    @classmethod
    def symmetric(cls, values: AnyArray) -> MarkTemplate:
        """Template of a mark with two-fold symmetry (dot, cross, ring), whose centre is found from the symmetry.

        The mark lies about in the middle, whole; the centre is NaN where the image is not symmetric about any place.
        """
        grey = np.asarray(values, dtype=np.float64)
        found = _centre_of_symmetry(grey)
        return cls(grey, (found.col, found.row))


@dataclass(frozen=True)
class Mark:
    """Located mark; NaN where none was found.

    Attributes
    ----------
    col, row : float
        Centre in pixels of the image searched; (0.5, 0.5) is the centre of its upper-left pixel.
    sigma : float
        Standard deviation of a coordinate from the matching, mean of both, in pixels; small where the image is clean.
    correlation : float
        Of the template with the image there, 0 to 1, over the pixels that kept their weight.
    """

    col: float
    row: float
    sigma: float
    correlation: float

    @property
    def found(self) -> bool:
        """Whether a mark was found."""
        return bool(np.isfinite(self.col))


def _centre_of_symmetry(values: AnyArray) -> Mark:
    """Place about which an image of a mark in its middle looks the same turned by 180°; NaN where there is none."""
    grey = np.asarray(values, dtype=np.float64)
    rows, cols = grey.shape
    reach = min(rows, cols) // 6
    inner = slice(reach, rows - reach), slice(reach, cols - reach)
    turned = MarkTemplate(grey[::-1, ::-1][inner], ((cols - 2 * reach) / 2, (rows - 2 * reach) / 2))
    found = locate_mark(grey, turned, MIN_SYMMETRY)
    # The turned picture has its mark where the middle mirrors it: the centre is off by half of the shift.
    return Mark((found.col + cols / 2) / 2, (found.row + rows / 2) / 2, found.sigma / 2, found.correlation)


def measure_mark(picture: AnyArray, colrow: tuple[float, float], half: int = 12) -> Mark:
    """Centre of the symmetric mark nearest to a place that was pointed at.

    Parameters
    ----------
    picture : array (rows, cols)
        Grey values.
    colrow : tuple of float
        Place pointed at, pixels; (0.5, 0.5) is the centre of the upper-left pixel.
    half : int
        Pixels on each side that hold the mark; the place may be wrong by as many.

    Returns
    -------
    Mark
        NaN where nothing there is symmetric, or where the border of the picture is too near.
    """
    grey, lost = np.asarray(picture, dtype=np.float64), Mark(np.nan, np.nan, np.nan, 0.0)
    col, row = (int(np.floor(value)) for value in colrow)
    # A window moves to the mark in steps: one that shows but a part of it is drawn towards the whole.
    for _ in range(_WINDOWS):
        left, top = col - half, row - half
        if min(left, top) < 0 or top + 2 * half >= grey.shape[0] or left + 2 * half >= grey.shape[1]:
            return lost
        window = _levelled(grey[top : top + 2 * half + 1, left : left + 2 * half + 1])
        if not np.ptp(window) > 0.0:
            return lost
        found = _centre_of_symmetry(window)
        if not found.found:
            col, row = _towards_contrast(window, left, top)
        elif (here := (int(left + found.col), int(top + found.row))) == (col, row):
            return Mark(left + found.col, top + found.row, found.sigma, found.correlation)
        else:
            col, row = here
        if abs(col + 0.5 - colrow[0]) > half or abs(row + 0.5 - colrow[1]) > half:
            return lost
    return Mark(left + found.col, top + found.row, found.sigma, found.correlation) if found.found else lost


def _levelled(window: FloatArray) -> FloatArray:
    """Window less the plane through its border: light that falls off to one side moves a centre of symmetry."""
    rows, cols = np.mgrid[-1.0 : 1.0 : window.shape[0] * 1j, -1.0 : 1.0 : window.shape[1] * 1j]
    design = np.column_stack([np.ones(window.size), rows.ravel(), cols.ravel()])
    border = np.maximum(np.abs(rows), np.abs(cols)).ravel() > 0.85
    plane = np.linalg.lstsq(design[border], window.ravel()[border], rcond=None)[0]
    level: FloatArray = window - (design @ plane).reshape(window.shape)
    return level


def _towards_contrast(window: FloatArray, left: int, top: int) -> tuple[int, int]:
    """Pixel (col, row) at the centre of mass of what differs from the background of a window."""
    apart = np.abs(window - np.median(window))
    apart = np.where(apart > 0.5 * apart.max(), apart, 0.0)
    rows, cols = np.mgrid[0 : window.shape[0], 0 : window.shape[1]]
    return left + round(float((apart * cols).sum() / apart.sum())), top + round(
        float((apart * rows).sum() / apart.sum())
    )


def locate_mark(picture: AnyArray, template: MarkTemplate, least: float = 0.6) -> Mark:
    """Location of the one mark in an image.

    Parameters
    ----------
    picture : array (rows, cols)
        Grey values, in which the whole of the template fits.
    template : MarkTemplate
        In the scale of the image, to about 10 %, and rotated by no more than a few degrees (dots and rings: at all).
    least : float
        Smallest correlation of a mark.

    Returns
    -------
    Mark
        NaN where nothing correlates with the template as `least` asks.
    """
    from scipy.ndimage import spline_filter

    lost = Mark(np.nan, np.nan, np.nan, 0.0)
    grey, pattern = np.asarray(picture, dtype=np.float64), template.values
    if any(a < b for a, b in zip(grey.shape, pattern.shape, strict=True)) or pattern.std() < 1e-9:
        return lost
    coefficients = spline_filter(grey, order=3, mode="mirror")
    matcher = _Matcher.of(template)
    left, top = np.subtract(template.centre, 0.5)
    found = [matcher.match(coefficients, (col + left, row + top)) for col, row in _whole_places(grey, pattern)]
    best = max(found, key=lambda one: one.correlation, default=lost)
    return best if best.found and best.correlation >= least else lost


@dataclass(frozen=True)
class _Matcher:
    """Template with its derivatives: design columns of shift right and down, scale, rotation, gain, offset."""

    across: FloatArray  # (rows * cols,) from the centre, pixels
    down: FloatArray
    columns: FloatArray  # (rows * cols, 6)
    prior: FloatArray  # (6,) weights of scale and turn being as they are, in shares of the contrast
    contrast: float
    shape: tuple[int, int]

    @classmethod
    def of(cls, template: MarkTemplate) -> _Matcher:
        pattern = template.values
        rows, cols = np.mgrid[0 : pattern.shape[0], 0 : pattern.shape[1]]
        across, down = (cols + 0.5 - template.centre[0]).ravel(), (rows + 0.5 - template.centre[1]).ravel()
        by_row, by_col = (_slope(pattern, axis).ravel() for axis in (0, 1))
        scale, turn = across * by_col + down * by_row, across * by_row - down * by_col
        columns = np.column_stack([by_col, by_row, scale, turn, pattern.ravel(), np.ones(pattern.size)])
        prior = np.array([0.0, 0.0, 1.0 / PRIOR_SIGMA**2, 1.0 / PRIOR_SIGMA**2, 0.0, 0.0])
        return cls(across, down, columns, prior, float(np.ptp(pattern)), (pattern.shape[0], pattern.shape[1]))

    def match(self, coefficients: FloatArray, start: tuple[float, float]) -> Mark:
        """Mark near a position (col, row); both count from the centre of the first pixel."""
        from scipy.ndimage import map_coordinates

        lost = Mark(np.nan, np.nan, np.nan, 0.0)
        x, y, scale, turn = *start, 1.0, 0.0
        weights = np.ones(len(self.columns))
        # Not by `estimation.solver`: the derivatives are the template's, the same in each round (inverse compositional,
        # Baker and Matthews 2004), so that the sum of squares they belong to is not the one to be lowered.
        for _ in range(_MARK_ITERATIONS):
            cosine, sine = scale * np.cos(turn), scale * np.sin(turn)
            places = [
                y + self.across * sine + self.down * cosine,
                x + self.across * cosine - self.down * sine,
            ]
            there = map_coordinates(coefficients, places, order=3, mode="mirror", prefilter=False)
            weighted = self.columns * weights[:, None]
            normal = weighted.T @ self.columns
            # The prior counts as one pixel of full contrast: enough where the mark determines no scale or rotation.
            normal += np.diag(self.prior * self.contrast**2)
            try:
                solution = np.linalg.solve(normal, weighted.T @ there)
            except np.linalg.LinAlgError:
                return lost
            gain = float(solution[4])
            if abs(gain) < 1e-6:
                return lost
            misfit = there - self.columns @ solution
            width = max(MAD_TO_SIGMA * float(np.median(np.abs(misfit))), MIN_RESIDUAL_SCALE * abs(gain) * self.contrast)
            weights = biweight(misfit / (BIWEIGHT_LIMIT * width))
            right, below, larger, turned = solution[:4] / gain
            length = float(np.hypot(right, below))
            # No step is longer than a pixel: the gradients describe the mark no farther than that.
            shrink = min(1.0, 1.0 / length) if length > 0.0 else 1.0
            x, y = x - shrink * right, y - shrink * below
            scale, turn = scale / (1.0 + np.clip(larger, -0.05, 0.05)), turn - np.clip(turned, -0.05, 0.05)
            if np.hypot(x - start[0], y - start[1]) > MAX_DISTANCE or abs(scale - 1.0) > 0.2 or abs(turn) > 0.2:
                return lost
            if length < _MARK_CONVERGED and abs(larger) < _MARK_CONVERGED:
                break
        pattern = self.columns[:, 4]
        energy = (pattern - pattern.mean()) ** 2
        if weights @ energy < 0.5 * energy.sum():
            return lost  # more than half of the mark does not fit: only its background does
        place = x + float(self.across[0]), y + float(self.down[0])
        prior = np.diag(self.prior * self.contrast**2)
        sigma = _sigma(self.shape, self.columns, misfit, width, prior, gain, place)
        return Mark(float(x) + 0.5, float(y) + 0.5, sigma, _correlation(pattern, there, weights))


def _slope(pattern: FloatArray, axis: int) -> FloatArray:
    """Gradient of the cubic spline through the pixels; differences of neighbours make sharp edges too flat."""
    from scipy.ndimage import correlate1d, spline_filter1d

    slopes: FloatArray = correlate1d(
        spline_filter1d(pattern, order=3, axis=axis, mode="mirror"), [-0.5, 0.0, 0.5], axis=axis, mode="mirror"
    )
    return slopes


def _whole_places(grey: FloatArray, pattern: FloatArray) -> list[tuple[int, int]]:
    """Upper-left pixels (col, row) of the highest peaks of the normalised cross-correlation of either sign."""
    # A scratch through the mark, or lettering, may correlate better than the mark; so matching starts from several.
    from scipy.signal import fftconvolve

    t = pattern - pattern.mean()
    window = grey - grey.mean()
    cross = fftconvolve(window, t[::-1, ::-1], mode="valid")
    box = np.ones_like(t)
    mean = fftconvolve(window, box, mode="valid") / t.size
    power = fftconvolve(window**2, box, mode="valid") / t.size - mean**2
    # Flat places correlate with nothing: their variance is rounding.
    floor = 1e-6 * float(np.max(power, initial=0.0)) + 1e-12
    score = np.abs(cross) / (np.sqrt(np.maximum(power, floor)) * t.std() * t.size)
    places: list[tuple[int, int]] = []
    apart = max(2, min(pattern.shape) // 8)
    for _ in range(PEAKS):
        row, col = (int(i) for i in np.unravel_index(int(np.argmax(score)), score.shape))
        if not score[row, col] > 0.1:
            break
        places.append((col, row))
        score[max(row - apart, 0) : row + apart + 1, max(col - apart, 0) : col + apart + 1] = 0.0
    return places


def _correlation(a: FloatArray, b: FloatArray, weights: FloatArray) -> float:
    """Absolute weighted correlation."""
    total = float(weights.sum())
    if not total > 0.0:
        return 0.0
    da, db = a - (weights @ a) / total, b - (weights @ b) / total
    both = float(np.sqrt((weights @ da**2) * (weights @ db**2)))
    return abs(float(weights @ (da * db))) / both if both > 0.0 else 0.0


def _sigma(
    shape: tuple[int, int],
    columns: FloatArray,
    misfit: FloatArray,
    width: float,
    prior: FloatArray,
    gain: float,
    place: tuple[float, float],
) -> float:
    """Standard deviation of the shifts."""
    # The covariance of an M-estimator is B⁻¹·M·B⁻¹ with B = Σ ψ'·a·aᵀ and M = Σ ψ²·a·aᵀ over pixels with rows a of the
    # design, ψ being misfit times weight (Huber, Robust Statistics, 1981, section 6.5). That holds for independent
    # misfits. Interpolation between pixels removes the high frequencies of their noise and keeps the low ones, which
    # carry the location. So M is multiplied by the ratio of what gradients and misfits keep.
    share = np.minimum((misfit / (BIWEIGHT_LIMIT * width)) ** 2, 1.0)
    pull, slope = misfit * (1.0 - share) ** 2, (1.0 - share) * (1.0 - 5.0 * share)
    bread = np.linalg.pinv((columns * slope[:, None]).T @ columns + prior)
    counted = float(np.count_nonzero(share < 1.0))
    meat = (columns * (pull**2)[:, None]).T @ columns * (counted / max(counted - columns.shape[1], 1.0))
    variances = np.diag(bread @ meat @ bread)[:2] * [_coarse(columns[:, k].reshape(shape), place) for k in range(2)]
    return float(np.sqrt(max(float(variances.mean()), 0.0))) / abs(gain)


def _coarse(slopes: FloatArray, place: tuple[float, float]) -> float:
    """Part of its energy that an image keeps under interpolation, over the part that white noise keeps."""
    # Interpolating noise and multiplying by gradients is multiplying the noise by gradients that the same weights
    # smooth.
    from scipy.ndimage import convolve1d, map_coordinates, spline_filter1d

    one = np.zeros(41)
    one[20] = 1.0
    smooth, kept = slopes, 1.0
    for axis, at in ((1, place[0]), (0, place[1])):
        weights = map_coordinates(spline_filter1d(one), [np.arange(1.0, 40.0) + at % 1.0], order=3, prefilter=False)
        smooth = convolve1d(smooth, weights, axis=axis, mode="constant")
        kept *= float((weights**2).sum())
    return float((smooth**2).sum() / max((slopes**2).sum() * kept, 1e-300))
