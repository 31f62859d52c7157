"""Two pictures of the same ground drawn on one grid: found roughly as wholes, then place by place.

Where both are good enough for features, these and one homography (MAGSAC) say how the second lies on the first. Other
seasons and sensors may leave no feature: then the correlation of both, with the local mean and contrast taken out, has
its peak at the shift.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.matching.descriptors import match_descriptors
from geomosaic.matching.features import Features, detect, spread
from geomosaic.matching.least_squares import HALF, PatchMatches, match_patches
from geomosaic.matching.two_view import LEAST_MATCHES, robust_homography
from geomosaic.types import AnyArray, BoolArray, ByteArray, Float32Array, FloatArray, IntArray

# Percentiles of values that become 0 and 255 for features.
LOW, HIGH = 0.5, 99.5
# Side in pixels of the neighbourhood whose mean and contrast are taken out before correlation.
LOCAL = 31
# Height of a correlation peak over the standard deviation of the rest of the search: noise reaches five, as the largest
# of some ten thousand values.
LEAST_PEAK = 9.0
# Half side of the patches that find whole pixels: larger than those of least squares, which start from there.
PATCH = 12


@dataclass(frozen=True, eq=False)
class Picture:
    """One band on a grid.

    Attributes
    ----------
    values : float32 array (rows, cols)
    valid : bool array (rows, cols)
    """

    values: Float32Array
    valid: BoolArray

    @property
    def eight_bits(self) -> ByteArray:
        """Values between the extremes, 0 where there is none."""
        seen = self.values[self.valid]
        low, high = np.percentile(seen, (LOW, HIGH)) if seen.size else (0.0, 1.0)
        scaled = (self.values - low) * (255.0 / max(high - low, 1e-12))
        return np.where(self.valid, np.clip(np.rint(scaled), 0.0, 255.0), 0.0).astype(np.uint8)

    def inner(self, border: int) -> BoolArray:
        """Pixels (rows, cols) that have valid ones only within `border` pixels; the picture's edge counts as none."""
        import cv2

        side = 2 * border + 1
        padded = np.pad(self.valid, border).astype(np.uint8)
        kept: BoolArray = cv2.erode(padded, np.ones((side, side), dtype=np.uint8))[border:-border, border:-border] != 0
        return kept

    def features(self, most: int) -> Features:
        """Its features, none at its edges."""
        return detect(self.eight_bits, most, self.inner(8))


@dataclass(frozen=True, eq=False)
class Alignment:
    """Places of two pictures that agree with one homography.

    Attributes
    ----------
    matrix : array (3, 3)
        From pixels of the first to pixels of the second, corner-based.
    first, second : array (K, 2)
        The places; none where only a shift is known.
    """

    matrix: FloatArray
    first: FloatArray
    second: FloatArray

    def places(self, colrow: FloatArray) -> FloatArray:
        """Places (N, 2) in the second picture of places (N, 2) in the first."""
        w = np.column_stack([colrow, np.ones(len(colrow))]) @ self.matrix.T
        with np.errstate(divide="ignore", invalid="ignore"):
            found: FloatArray = w[:, :2] / w[:, 2:]
        return found


def align_features(first: Features, second: Features, tolerance: float = 3.0) -> Alignment | None:
    """Alignment of two pictures by their features.

    Parameters
    ----------
    first, second : Features
    tolerance : float
        Pixels of the second within which a match agrees.

    Returns
    -------
    Alignment or None
        None where fewer agree than may by chance.
    """
    matches = match_descriptors(first, second)
    one, other = first.colrow[matches[:, 0]], second.colrow[matches[:, 1]]
    found = agreeing_with_homography(one, other, tolerance)
    if found is None:
        return None
    matrix, kept = found
    # A homography that turns the picture over, or squeezes it to a line, is chance.
    size = np.linalg.svd(matrix[:2, :2] / matrix[2, 2], compute_uv=False)
    if np.linalg.det(matrix) * matrix[2, 2] <= 0.0 or size[0] > 4.0 * size[1]:
        return None
    return Alignment(matrix, one[kept], other[kept])


def agreeing_with_homography(
    one: FloatArray, other: FloatArray, tolerance: float
) -> tuple[FloatArray, BoolArray] | None:
    """Homography (3, 3) of places (N, 2), and those (N,) that agree with it; None where fewer do than may by chance.

    Parameters
    ----------
    one, other : array (N, 2)
    tolerance : float
        Pixels of the other.
    """
    # Several directions of one feature are one place.
    if len(np.unique(one, axis=0)) < LEAST_MATCHES:
        return None
    found = robust_homography(one, other, tolerance)
    return found if found is not None and len(np.unique(one[found[1]], axis=0)) >= LEAST_MATCHES else None


def correlated_shift(first: Picture, second: Picture, reach: int) -> Alignment | None:
    """Shift of the second picture against the first by the peak of their correlation.

    Parameters
    ----------
    first, second : Picture
        On one grid, turned against each other by few degrees at most.
    reach : int
        Pixels that are searched each way.

    Returns
    -------
    Alignment or None
        None where no peak stands out.
    """
    a, b = _local_contrast(first), _local_contrast(second)
    rows, cols = (n + reach for n in a.shape)  # zeros beyond keep both ends apart
    product = np.fft.irfft2(np.conj(np.fft.rfft2(a, (rows, cols))) * np.fft.rfft2(b, (rows, cols)), (rows, cols))
    around = np.roll(product, (reach, reach), axis=(0, 1))[: 2 * reach + 1, : 2 * reach + 1]
    row, col = np.unravel_index(int(np.argmax(around)), around.shape)
    rest = np.ones(around.shape, dtype=bool)
    rest[max(0, row - 8) : row + 9, max(0, col - 8) : col + 9] = False
    if not rest.any() or around[row, col] - around[rest].mean() <= LEAST_PEAK * around[rest].std():
        return None
    shift = np.array([[1.0, 0.0, float(col) - reach], [0.0, 1.0, float(row) - reach], [0.0, 0.0, 1.0]])
    none = np.zeros((0, 2))
    return Alignment(shift, none, none)


def _local_contrast(picture: Picture) -> FloatArray:
    """Values less their local mean, over their local standard deviation; 0 where there are none."""
    import cv2

    share = cv2.blur(picture.valid.astype(np.float64), (LOCAL, LOCAL))
    values = np.where(picture.valid, picture.values, 0.0).astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = cv2.blur(values, (LOCAL, LOCAL)) / share
        deviation = np.sqrt(np.maximum(cv2.blur(values**2, (LOCAL, LOCAL)) / share - mean**2, 0.0))
    weak = ~picture.valid | (deviation < 1e-3 * max(float(np.nanmedian(deviation)), 1e-12))
    return np.where(weak, 0.0, (values - mean) / np.where(weak, 1.0, deviation))


def corners(picture: Picture, most: int, cell: float) -> IntArray:
    """Pixels (N, 2) that are well defined in both directions, the strongest of each cell first.

    Parameters
    ----------
    picture : Picture
    most : int
    cell : float
        Side of a cell, pixels.
    """
    import cv2

    strength = cv2.cornerMinEigenVal(picture.values, 7)
    strength[~picture.inner(PATCH + 2)] = 0.0
    peaks = (strength > 0.0) & (strength == cv2.dilate(strength, np.ones((11, 11), dtype=np.uint8)))
    rows, cols = np.nonzero(peaks)
    pixels = np.column_stack([cols, rows]).astype(np.int64)
    return pixels[spread(pixels.astype(np.float64), strength[rows, cols].astype(np.float64), cell, most)]


def match_corners(first: Picture, second: Picture, pixels: IntArray, reach: int) -> PatchMatches:
    """Places in the second picture of pixels of the first: by correlation to the pixel, then by least squares.

    Parameters
    ----------
    first, second : Picture
        On one grid.
    pixels : int array (N, 2)
        At least `PATCH` + 1 pixels within the first.
    reach : int
        Pixels that are searched each way.
    """
    import cv2

    whole = pixels.astype(np.float64) + 0.5
    lost = np.zeros(len(pixels), dtype=bool)
    # What is searched must lie within the second picture; valid is what the match ends on.
    side = PATCH + reach
    padded = np.pad(np.where(second.valid, second.values, 0.0).astype(np.float32), side)
    inner = second.inner(HALF + 2)
    for number, (col, row) in enumerate(pixels.tolist()):
        template = first.values[row - PATCH : row + PATCH + 1, col - PATCH : col + PATCH + 1]
        window = padded[row : row + 2 * side + 1, col : col + 2 * side + 1]
        score = cv2.matchTemplate(window, np.ascontiguousarray(template), cv2.TM_CCOEFF_NORMED)
        down, along = np.unravel_index(int(np.argmax(score)), score.shape)
        at = row + int(down) - reach, col + int(along) - reach
        lost[number] = not (0 <= at[0] < inner.shape[0] and 0 <= at[1] < inner.shape[1] and inner[at])
        whole[number] += (int(along) - reach, int(down) - reach)
    affine = np.broadcast_to(np.eye(2), (len(pixels), 2, 2))
    arrays: tuple[AnyArray, AnyArray] = (np.ascontiguousarray(first.values), np.ascontiguousarray(second.values))
    found = match_patches(*arrays, pixels, whole, affine, 2.0)
    for values in (found.colrow, found.affine, found.covariance, found.correlation):
        values[lost] = np.nan
    return found
