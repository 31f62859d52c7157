"""The plane transformation as a sensor model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.sensor.parameters import Parameters
from geomosaic.types import FloatArray
from geomosaic_planar.terms import derivatives, evaluate, parameter_names


@dataclass(frozen=True, eq=False)
class PlanarModel:
    """Ground → image by a conformal, affine, projective or polynomial transformation; heights play no part.

    Attributes
    ----------
    kind : str
        'conformal', 'affine', 'projective' or 'polynomial'.
    order : int
        Degree of the polynomial; 1 for the other kinds.
    crs : CRS
        Horizontal CRS of x and y.
    size : tuple of int
        Width and height of the image in pixels.
    centre : array (2,)
        Map position of u = v = 0.
    scale : float
        Map units of u = 1 and v = 1.
    values : array (P,)
        Coefficients, see `geomosaic_planar.terms`.
    sigmas : array (P,)
        A-priori standard deviations of the coefficients: 0 fixed, inf free.
    middle : array (2,)
        Map position of the middle of the image.
    reach : array (2,)
        Largest |u| and |v| that the image shows, from which the steps of the parameters follow.
    """

    kind: str
    order: int
    crs: CRS
    size: tuple[int, int]
    centre: FloatArray
    scale: float
    values: FloatArray
    sigmas: FloatArray
    middle: FloatArray
    reach: FloatArray

    def __post_init__(self) -> None:
        for name in ("centre", "values", "sigmas", "middle", "reach"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def of(
        cls,
        kind: str,
        order: int,
        crs: CRS,
        size: tuple[int, int],
        centre: FloatArray,
        scale: float,
        values: FloatArray,
        sigma: float = np.inf,
        where: str | None = None,
    ) -> Self:
        """Make a model and find the ground it shows.

        Raises
        ------
        InputError
            No ground near `centre` falls on the middle of the image.
        """
        values = np.asarray(values, dtype=np.float64)
        corners = np.array([[0.5, 0.5], [0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]) * size
        uv = _inverse(kind, order, values, corners)
        if not np.isfinite(uv[0]).all():
            raise InputError(
                "the transformation shows no ground at the middle of the image",
                where=where,
                mend="check the points or coefficients; explicit ones of high order need 'centre' and 'scale'",
            )
        # Corners without ground (beyond a projective horizon) do not count.
        reach = np.maximum(np.nanmax(np.abs(uv), axis=0), 1e-12)
        middle = np.asarray(centre, dtype=np.float64) + scale * uv[0]
        return cls(kind, order, crs, size, centre, float(scale), values, np.full(len(values), sigma), middle, reach)

    @property
    def parameters(self) -> Parameters:
        """Coefficients; a step moves some point of the image by one pixel."""
        names = parameter_names(self.kind, self.order)
        units = tuple("" if name in ("c1", "c2") else "px" for name in names)
        corners = np.array([[a, b] for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)]) * self.reach
        effect = np.abs(derivatives(self.kind, self.order, self.values, corners)[0])
        most = np.nanmax(effect, axis=(0, 1))
        return Parameters(names, units, self.values, self.sigmas, 1.0 / np.maximum(most, 1e-12))

    @property
    def seed(self) -> tuple[float, float, float]:
        """Ground at the middle of the image."""
        return float(self.middle[0]), float(self.middle[1]), 0.0

    def _normalised(self, xyz: FloatArray) -> FloatArray:
        points = np.asarray(xyz, dtype=np.float64)
        uv: FloatArray = (points[:, :2] - self.centre) / self.scale
        return uv

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) or (N, 2) in `crs` to (col, row) (N, 2); NaN behind the horizon of a projective map."""
        return evaluate(self.kind, self.order, self.values, self._normalised(xyz))

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by coefficients (N, 2, P) and by ground coordinates (N, 2, 3)."""
        by_values, by_uv = derivatives(self.kind, self.order, self.values, self._normalised(xyz))
        by_ground = np.zeros((len(by_uv), 2, 3))
        by_ground[:, :, :2] = by_uv / self.scale
        by_ground[np.isnan(by_uv).any(axis=(1, 2))] = np.nan
        return by_values, by_ground

    def with_values(self, values: FloatArray) -> Self:
        """Return a model with other coefficients (P,)."""
        return replace(self, values=self.parameters.with_values(values).values)

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values; infinite sigmas are written as null."""
        return {
            "kind": self.kind,
            "order": self.order,
            "crs": self.crs.to_wkt(),
            "size": list(self.size),
            "centre": self.centre.tolist(),
            "scale": self.scale,
            "values": self.values.tolist(),
            "sigmas": [None if np.isinf(sigma) else float(sigma) for sigma in self.sigmas],
            "middle": self.middle.tolist(),
            "reach": self.reach.tolist(),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Rebuild a model from `to_dict`."""
        width, height = state["size"]
        return cls(
            kind=state["kind"],
            order=int(state["order"]),
            crs=CRS.from_wkt(state["crs"]),
            size=(int(width), int(height)),
            centre=np.array(state["centre"], dtype=np.float64),
            scale=float(state["scale"]),
            values=np.array(state["values"], dtype=np.float64),
            sigmas=np.array([np.inf if sigma is None else sigma for sigma in state["sigmas"]], dtype=np.float64),
            middle=np.array(state["middle"], dtype=np.float64),
            reach=np.array(state["reach"], dtype=np.float64),
        )


def _inverse(kind: str, order: int, values: FloatArray, colrow: FloatArray) -> FloatArray:
    """Normalised ground (N, 2) of image points by Newton's method from u = v = 0; NaN where there is none."""
    uv = np.zeros((len(colrow), 2))
    if kind == "projective":  # linear in closed form, so the start cannot lie behind the horizon
        a, c = values[:6].reshape(2, 3), values[6:]
        matrix = a[None, :, 1:] - colrow[:, :, None] * c
        right = colrow - a[:, 0]
        return _solve2(matrix, right) * np.where(np.isfinite(_visible(values, matrix, right)), 1.0, np.nan)[:, None]
    for _ in range(50):
        left = colrow - evaluate(kind, order, values, uv)
        change = _solve2(derivatives(kind, order, values, uv)[1], left)
        uv = uv + change
        if not (np.abs(change) > 1e-13 * np.maximum(1.0, np.abs(uv))).any():
            break
    left = np.abs(colrow - evaluate(kind, order, values, uv)).max(axis=1)
    uv[~(left < 1e-3)] = np.nan
    return uv


def _visible(values: FloatArray, matrix: FloatArray, right: FloatArray) -> FloatArray:
    uv = _solve2(matrix, right)
    seen: FloatArray = evaluate("projective", 1, values, uv)[:, 0]
    return seen


def _solve2(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve 2 × 2 systems (N, 2, 2), (N, 2); NaN where singular."""
    (a, b), (c, d) = matrix[:, 0].T, matrix[:, 1].T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        determinant = a * d - b * c
        x = (d * right[:, 0] - b * right[:, 1]) / determinant
        y = (a * right[:, 1] - c * right[:, 0]) / determinant
    solution = np.column_stack([x, y])
    solution[~np.isfinite(solution).all(axis=1)] = np.nan
    return solution
