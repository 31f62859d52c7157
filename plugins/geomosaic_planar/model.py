"""The plane transformation as a sensor model."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.sensor.plugin import Parameters
from geomosaic.types import FloatArray
from geomosaic_planar import spline
from geomosaic_planar.terms import derivatives, evaluate, newton_inverse, parameter_names, projective_inverse, slopes


@dataclass(frozen=True, eq=False)
class Transformation:
    """Plane transformation, ground to image.

    Attributes
    ----------
    kind : str
        'conformal', 'affine', 'projective', 'polynomial' or 'tps' (thin plate spline).
    order : int
        Degree of the polynomial; 1 for the other kinds.
    centre : array (2,)
        Map position of u = v = 0; of a fit the mean of its points.
    scale : float
        Map units of u = 1 and v = 1; the points of a fit reach |u|, |v| ≤ 1.
    values : array (P,)
        Coefficients for normalised ground coordinates, see `geomosaic_planar.terms`; of a spline the image coordinates
        of its nodes.
    axes : str
        Handedness of (col, row) as the ground is seen in them: 'left' as usual, rows counting downwards; 'right' where
        rows count upwards or the image is mirrored. A part of a conformal transformation; of a model of another kind it
        follows from the coefficients (at the middle of the image).
    nodes : array (N, 2)
        Normalised places u, v of a spline's nodes; (0, 2) for other kinds.
    solved : spline.Solved, optional
        The spline through them; None for other kinds.
    """

    kind: str
    order: int
    centre: FloatArray
    scale: float
    values: FloatArray
    axes: str = "left"
    nodes: FloatArray = field(default_factory=lambda: spline.NO_NODES)
    solved: spline.Solved | None = None

    def __post_init__(self) -> None:
        _freeze(self, "centre", "values", "nodes")

    @property
    def fitted_spline(self) -> spline.Solved:
        """Spline through the nodes."""
        if self.solved is None:
            raise ValueError(f"a transformation of kind '{self.kind}' is no spline")
        return self.solved

    @cached_property
    def _treecode(self) -> spline.Treecode:
        return spline.Treecode(self.nodes, self.fitted_spline.coefficients)

    def normalised(self, xy: FloatArray) -> FloatArray:
        """Normalised ground u, v (N, 2) of map positions (N, 2) or (N, 3)."""
        return (np.asarray(xy, dtype=np.float64)[:, :2] - self.centre) / self.scale

    def image(self, uv: FloatArray) -> FloatArray:
        """Image (col, row) (N, 2) of normalised ground (N, 2), pixels; NaN behind the horizon of a projective map."""
        if self.kind != "tps":
            return evaluate(self.kind, self.order, self.values, uv, self.axes)
        if len(self.nodes) > spline.MANY:
            return self._treecode(uv)
        return spline.evaluate(self.nodes, self.fitted_spline.coefficients, uv)

    def slopes(self, uv: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by u, v (N, 2, 2) at normalised ground (N, 2)."""
        if self.kind == "tps":
            return spline.slopes(self.nodes, self.fitted_spline.coefficients, uv)
        return slopes(self.kind, self.order, self.values, uv, self.axes)

    def derivatives(self, uv: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by coefficients (N, 2, P) and by u, v (N, 2, 2) at normalised ground (N, 2)."""
        if self.kind != "tps":
            return derivatives(self.kind, self.order, self.values, uv, self.axes)
        shares, by_values = spline.influence(self.nodes, uv), np.zeros((len(uv), 2, len(self.values)))
        by_values[:, 0, : len(self.nodes)] = by_values[:, 1, len(self.nodes) :] = shares
        return by_values, self.slopes(uv)

    def ground(self, colrow: FloatArray) -> FloatArray:
        """Normalised ground (N, 2) of image points (N, 2); NaN where there is none."""
        if self.kind == "projective":
            return projective_inverse(self.values, colrow)
        start = np.zeros((len(colrow), 2))
        if self.kind == "tps":
            known = self.values.reshape(2, -1).T
            # From the node whose image is nearest Newton's method has the shortest way through the bends.
            start = self.nodes[[int(np.argmin(np.hypot(*(known - place).T))) for place in colrow]]
        return newton_inverse(self.image, self.slopes, colrow, start)

    def handedness(self, uv: FloatArray) -> str:
        """Handedness of the image's axes at a place (1, 2)."""
        # A conformal map keeps the handedness it was defined with; that of other kinds follows from their derivatives.
        (a, b), (c, d) = self.slopes(uv)[0]
        determinant = float(a * d - b * c)
        if self.kind == "conformal" or not np.isfinite(determinant) or determinant == 0.0:
            return self.axes
        return "right" if determinant > 0.0 else "left"

    def with_values(self, values: FloatArray) -> Transformation:
        """Transformation with other coefficients (P,)."""
        solved = spline.solve(self.nodes, values.reshape(2, -1).T) if self.kind == "tps" else None
        return replace(self, values=values, solved=solved)


def _freeze(value: Any, *names: str) -> None:
    """Arrays of a frozen dataclass, made its own and read-only."""
    for name in names:
        array = np.array(getattr(value, name), dtype=np.float64)
        array.setflags(write=False)
        object.__setattr__(value, name, array)


@dataclass(frozen=True, eq=False)
class PlanarModel:
    """Ground → image by a plane transformation; heights play no part.

    Attributes
    ----------
    transformation : Transformation
    crs : CRS
        Horizontal CRS of x and y.
    size : tuple of int
        Width and height of the image in pixels.
    sigmas : array (P,)
        A-priori standard deviations of the coefficients: 0 fixed, inf free.
    middle : array (2,)
        Map position of the middle of the image.
    reach : array (2,)
        Largest |u| and |v| that the image shows, from which the steps of the parameters follow.
    """

    transformation: Transformation
    crs: CRS
    size: tuple[int, int]
    sigmas: FloatArray
    middle: FloatArray
    reach: FloatArray

    def __post_init__(self) -> None:
        _freeze(self, "sigmas", "middle", "reach")

    @classmethod
    def of(
        cls,
        transformation: Transformation,
        crs: CRS,
        size: tuple[int, int],
        *,
        sigma: float = np.inf,
        where: str | None = None,
    ) -> Self:
        """Model of a plane transformation, with the ground it shows.

        Parameters
        ----------
        transformation : Transformation
            Given or fitted.
        crs : CRS
            Horizontal CRS of its map.
        size : tuple of int
            Width and height of the image in pixels.
        sigma : float
            A-priori standard deviation of every coefficient: 0 fixed, inf free.
        where : str, optional
            Name of the image in errors.

        Raises
        ------
        InputError
            No ground near its centre falls on the middle of the image.
        """
        # Of a fit without its statistics: the covariance of a spline has the square of its nodes.
        given = Transformation(*(getattr(transformation, each.name) for each in fields(Transformation)))
        uv = given.ground(np.array([[0.5, 0.5]]) * size)
        if not np.isfinite(uv).all():
            raise InputError(
                "the transformation shows no ground at the middle of the image",
                where=where,
                hint="check the points or coefficients; explicit ones of high order need 'centre' and 'scale'",
            )
        reach = np.maximum(_reach(given, size, uv), 1e-12)
        given = replace(given, axes=given.handedness(uv[:1]))
        return cls(given, crs, size, np.full(len(given.values), sigma), given.centre + given.scale * uv[0], reach)

    @property
    def parameters(self) -> Parameters:
        """Coefficients; a step moves some point of the image by one pixel."""
        own = self.transformation
        names = parameter_names(own.kind, own.order, len(own.nodes))
        units = tuple("" if name in ("c1", "c2") else "px" for name in names)
        if own.kind == "tps":
            return Parameters(names, units, own.values, self.sigmas, np.ones(len(names)))
        corners = np.array([[a, b] for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)]) * self.reach
        most = np.nanmax(np.abs(own.derivatives(corners)[0]), axis=(0, 1))
        return Parameters(names, units, own.values, self.sigmas, 1.0 / np.maximum(most, 1e-12))

    @property
    def seed(self) -> tuple[float, float, float]:
        """Ground at the middle of the image."""
        return float(self.middle[0]), float(self.middle[1]), 0.0

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) or (N, 2) in `crs` to (col, row) (N, 2); NaN behind the horizon of a projective map."""
        return self.transformation.image(self.transformation.normalised(xyz))

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by coefficients (N, 2, P) and by ground coordinates (N, 2, 3)."""
        by_values, by_uv = self.transformation.derivatives(self.transformation.normalised(xyz))
        return by_values, self._by_ground(by_uv)

    def ground_jacobian(self, xyz: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by ground coordinates (N, 2, 3)."""
        return self._by_ground(self.transformation.slopes(self.transformation.normalised(xyz)))

    def _by_ground(self, by_uv: FloatArray) -> FloatArray:
        by_ground = np.zeros((len(by_uv), 2, 3))
        by_ground[:, :, :2] = by_uv / self.transformation.scale
        by_ground[np.isnan(by_uv).any(axis=(1, 2))] = np.nan
        return by_ground

    def omission(self) -> FloatArray | None:
        """Of a spline: image at each node minus what a spline through all others gives there (N, 2), else None."""
        own = self.transformation
        if own.kind != "tps" or len(own.fitted_spline.omissions):
            return own.fitted_spline.omissions if own.kind == "tps" else None
        return spline.solve(own.nodes, own.values.reshape(2, -1).T).omissions

    def with_values(self, values: FloatArray) -> Self:
        """Model with other coefficients (P,)."""
        changed = self.transformation.with_values(self.parameters.with_values(values).values)
        axes = changed.handedness(changed.normalised(self.middle[None]))
        return replace(self, transformation=replace(changed, axes=axes))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values; infinite sigmas are written as null."""
        own, of_spline = self.transformation, {}
        if own.kind == "tps":
            of_spline = {"nodes": own.nodes.tolist(), "coefficients": own.fitted_spline.coefficients.tolist()}
        return {
            "kind": own.kind,
            "order": own.order,
            "crs": self.crs.to_wkt(),
            "size": list(self.size),
            "centre": own.centre.tolist(),
            "scale": own.scale,
            "values": own.values.tolist(),
            "sigmas": [None if np.isinf(sigma) else float(sigma) for sigma in self.sigmas],
            "middle": self.middle.tolist(),
            "reach": self.reach.tolist(),
            "axes": own.axes,
            **of_spline,
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it."""
        width, height = state["size"]
        nodes = np.array(state.get("nodes", spline.NO_NODES), dtype=np.float64)
        coefficients = np.array(state.get("coefficients", spline.NO_NODES), dtype=np.float64)
        solved = spline.Solved(coefficients, float("nan"), spline.NO_NODES) if len(nodes) else None
        transformation = Transformation(
            state["kind"], int(state["order"]), state["centre"], float(state["scale"]), state["values"],
            state.get("axes", "left"), nodes, solved,
        )  # fmt: skip
        sigmas = np.array([np.inf if sigma is None else sigma for sigma in state["sigmas"]], dtype=np.float64)
        crs, size = CRS.from_wkt(state["crs"]), (int(width), int(height))
        return cls(transformation, crs, size, sigmas, state["middle"], state["reach"])


def _reach(given: Transformation, size: tuple[int, int], uv: FloatArray) -> FloatArray:
    """Largest |u| and |v| of an image's corners, from its middle (1, 2)."""
    shifts = np.array([[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]]) * size
    if given.kind == "projective":  # corners beyond the horizon do not count
        places = projective_inverse(given.values, np.array(size) / 2.0 + shifts)
    else:  # near enough for the steps of the parameters, and never lost in the bends of a high order
        places = uv + shifts @ np.linalg.pinv(given.slopes(uv)[0]).T
    reach: FloatArray = np.nanmax(np.abs(np.vstack([uv, places])), axis=0)
    return reach
