"""Interior orientation of a scan: pixels to millimetres of the camera, by its fiducial marks.

Three kinds (lecture on image rectification; Kraus, Photogrammetry, 2.1): conformal (4 parameters: shift, turn, scale),
affine (6: also another scale across and a shear, as film and scanners have them), projective (8).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.estimation.equations import Equations
from geomosaic.estimation.solver import Problem, Stopping, solve
from geomosaic.estimation.statistics import sigma0_of
from geomosaic.types import FloatArray

# Names, and the fewest marks each needs.
KINDS = {"conformal": 2, "affine": 3, "projective": 4}


@dataclass(frozen=True, eq=False)
class InteriorOrientation:
    """Interior orientation, pixels to millimetres, fitted to fiducial marks.

    Attributes
    ----------
    kind : str
        'conformal', 'affine' or 'projective'.
    matrix : array (3, 3)
        Homogeneous (col, row, 1) in pixels → (x, y, 1) in mm of the fiducial axes, x right, y up.
    residuals : array (N, 2)
        Measured, brought to the fiducial axes, minus calibrated; micrometres.
    sigma0 : float
        Standard deviation of a coordinate, micrometres; NaN without redundancy.
    redundancy : int
        Observations less unknowns.
    bring : array (3, 3)
        Pixels → the coordinates of the fit: about the middle of the marks, with radii near one.
    cofactors : array (U, U)
        Of the unknowns of the fit, for marks of equal weight.
    """

    kind: str
    matrix: FloatArray
    residuals: FloatArray
    sigma0: float
    redundancy: int
    bring: FloatArray
    cofactors: FloatArray

    def sigmas(self, colrow: FloatArray) -> FloatArray:
        """Standard deviations (N, 2) of x and y in the film of pixels (N, 2), as the marks give them; micrometres.

        By the law of propagation; NaN without redundancy. The measurement of the pixels themselves is not in them.
        """
        p = apply(self.bring, colrow)
        design = _design(self.kind, p, self.matrix @ np.linalg.inv(self.bring), self.mirrored)
        variances = np.einsum("ij,jk,ik->i", design, self.cofactors, design)
        out: FloatArray = self.sigma0 * np.sqrt(variances.reshape(2, -1).T)
        return out

    @property
    def rms(self) -> float:
        """Root mean square length of the residuals, micrometres."""
        return float(np.sqrt((self.residuals**2).sum(axis=1).mean()))

    @property
    def mirrored(self) -> bool:
        """Whether the scan shows the film from its back."""
        return bool(np.linalg.det(self.matrix[:2, :2]) > 0.0)  # rows count downwards, y up

    @property
    def turn(self) -> float:
        """Direction of the fiducial x axis in the scan, in degrees, counter-clockwise from its columns."""
        dx, dy = np.linalg.inv(self.matrix[:2, :2])[:, 0]
        return float(np.degrees(np.arctan2(-dy, dx)))

    @property
    def pixel(self) -> tuple[float, float]:
        """Size of a pixel along columns and rows, micrometres."""
        across, down = 1000.0 * np.linalg.norm(self.matrix[:2, :2], axis=0)
        return float(across), float(down)


def fit_interior(colrow: FloatArray, calibrated: FloatArray, kind: str, mirrored: bool = False) -> InteriorOrientation:
    """Interior orientation, pixels to millimetres, by least squares.

    Parameters
    ----------
    colrow : array (N, 2)
        Measured marks in pixels.
    calibrated : array (N, 2)
        The same marks in mm, x right, y up; at least as many as `KINDS` says, not all in line.
    kind : str
        'conformal', 'affine' or 'projective'.
    mirrored : bool
        Whether a conformal fit may only mirror, or not mirror, the film; the other two kinds do what the marks say.
    """
    image, film = np.asarray(colrow, dtype=np.float64), np.asarray(calibrated, dtype=np.float64)
    # About their middles and with radii near one, so that no accuracy is lost to large numbers.
    middle = image.mean(axis=0)
    scale = float(np.sqrt(((image - middle) ** 2).sum(axis=1).mean())) or 1.0
    p = (image - middle) / scale
    bring = np.array([[1.0, 0.0, -middle[0]], [0.0, 1.0, -middle[1]], [0.0, 0.0, scale]]) / scale
    if kind == "conformal":
        matrix, unknowns = _conformal(p, film, mirrored), 4
    else:
        affine = Equations(np.column_stack([p, np.ones(len(p))]), film).step().T
        matrix, unknowns = np.vstack([affine, [0.0, 0.0, 1.0]]), 6
        if kind == "projective":
            matrix, unknowns = solve(_Projective(p, film), matrix, RULES).state, 8
    residuals = 1000.0 * (apply(matrix, p) - film)
    redundancy = 2 * len(p) - unknowns
    sigma0 = sigma0_of(float((residuals**2).sum()), redundancy)
    full = matrix @ bring
    result = full / full[2, 2]
    # The design of the fitted matrix, not of the start: cofactors hold at the solution.
    design = _design(kind, p, matrix, bool(np.linalg.det(result[:2, :2]) > 0.0))
    cofactors = Equations(design, np.zeros(len(design))).parameter_cofactors()
    return InteriorOrientation(kind, result, residuals, sigma0, redundancy, bring, cofactors)


def _design(kind: str, p: FloatArray, matrix: FloatArray, mirrored: bool) -> FloatArray:
    """Derivatives (2·N, U) of x of all points (N, 2), then y, by the unknowns of a kind."""
    one, zero = np.ones(len(p)), np.zeros(len(p))
    if kind == "conformal":
        m = -1.0 if mirrored else 1.0
        return np.vstack(
            [np.column_stack([m * p[:, 0], p[:, 1], one, zero]), np.column_stack([-p[:, 1], m * p[:, 0], zero, one])]
        )
    matrix = matrix / matrix[2, 2]
    w = p @ matrix[2, :2] + 1.0
    base, nothing = np.column_stack([p, one]) / w[:, None], np.zeros((len(p), 3))
    if kind == "affine":
        return np.vstack([np.column_stack([base, nothing]), np.column_stack([nothing, base])])
    x, y = apply(matrix, p).T
    return np.vstack(
        [
            np.column_stack([base, nothing, -x[:, None] * base[:, :2]]),
            np.column_stack([nothing, base, -y[:, None] * base[:, :2]]),
        ]
    )


def apply(matrix: FloatArray, xy: FloatArray) -> FloatArray:
    """Points mapped by a homography.

    Parameters
    ----------
    matrix : array (3, 3)
    xy : array (N, 2)

    Returns
    -------
    array (N, 2)
    """
    x, y = np.asarray(xy, dtype=np.float64).T
    # Written out instead of a matrix product: BLAS may round a point differently from one array length to the next.
    a, b, c = (row[0] * x + row[1] * y + row[2] for row in matrix)
    return np.column_stack([a / c, b / c])


def _conformal(p: FloatArray, film: FloatArray, mirrored: bool) -> FloatArray:
    """Conformal matrix (3, 3) of x = a·m·p₁ + b·p₂ + e,  y = b·m·p₁ − a·p₂ + f, with m = 1, or −1 where mirrored."""
    m = -1.0 if mirrored else 1.0
    design = _design("conformal", p, np.eye(3), mirrored)
    # Linear in its unknowns, as the affine one is: one step from nothing.
    a, b, e, f = Equations(design, film.T.ravel()).step()
    return np.array([[a * m, b, e], [b * m, -a, f], [0.0, 0.0, 1.0]])


# Unknowns are millimetres of the film over radii near one: steps of 1e-12 are rounding.
RULES = Stopping(rounds=30, step=1e-12, near=1e-6)


@dataclass(frozen=True, eq=False)
class _Projective(Problem[FloatArray]):
    """Marks at p (N, 2) and in the film (N, 2), mm; a state is the homography (3, 3) whose last element is 1."""

    p: FloatArray
    film: FloatArray

    def linearise(self, state: FloatArray) -> Equations:
        return Equations(
            _design("projective", self.p, state, mirrored=False), (self.film - apply(state, self.p)).T.ravel()
        )

    def squares(self, state: FloatArray) -> float:
        return float(((self.film - apply(state, self.p)) ** 2).sum())

    def moved(self, state: FloatArray, step: FloatArray) -> FloatArray:
        after: FloatArray = state + np.append(step, 0.0).reshape(3, 3)
        return after
