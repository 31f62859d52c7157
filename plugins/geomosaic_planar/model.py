"""The plane transformation as a sensor model."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
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
        Coefficients for normalised ground coordinates; of a spline the image coordinates of its nodes.
    axes : str
        'left' or 'right': handedness of the image's axes, of a conformal transformation; 'left' for other kinds, whose
        coefficients carry it.
    nodes : array (N, 2)
        Normalised places of a spline's nodes; (0, 2) for other kinds.
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


@dataclass(frozen=True, eq=False)
class PlanarModel:
    """Ground → image by a plane transformation; heights play no part.

    Attributes
    ----------
    kind : str
        'conformal', 'affine', 'projective', 'polynomial' or 'tps' (thin plate spline).
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
        Coefficients, see `geomosaic_planar.terms`; of a spline the image coordinates of its nodes.
    sigmas : array (P,)
        A-priori standard deviations of the coefficients: 0 fixed, inf free.
    middle : array (2,)
        Map position of the middle of the image.
    reach : array (2,)
        Largest |u| and |v| that the image shows, from which the steps of the parameters follow.
    axes : str
        Handedness of (col, row) as the ground is seen in them: 'left' as usual, rows counting downwards; 'right' where
        rows count upwards or the image is mirrored. A part of a conformal transformation; of other kinds it follows
        from the coefficients (at the middle of the image).
    nodes : array (N, 2)
        Normalised places u, v of a spline's nodes; none for other kinds.
    coefficients : array (N + 3, 2)
        Of a spline, see `geomosaic_planar.spline`; they follow from `nodes` and `values`.
    omissions : array (N, 2)
        Leave-one-out errors of a spline that was fitted, pixels; none of one that was read.
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
    axes: str = "left"
    nodes: FloatArray = field(default_factory=lambda: spline.NO_NODES)
    coefficients: FloatArray = field(default_factory=lambda: spline.NO_NODES)
    omissions: FloatArray = field(default_factory=lambda: spline.NO_NODES)

    def __post_init__(self) -> None:
        for name in ("centre", "values", "sigmas", "middle", "reach", "nodes", "coefficients", "omissions"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

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
        given = transformation
        values = np.asarray(given.values, dtype=np.float64)
        middle = np.asarray(given.centre, dtype=np.float64)
        none = spline.NO_NODES
        coefficients, omissions = (
            (none, none) if given.solved is None else (given.solved.coefficients, given.solved.omissions)
        )
        model = cls(
            given.kind, given.order, crs, size, given.centre, float(given.scale), values, np.full(len(values), sigma),
            middle, np.ones(2), given.axes, given.nodes, coefficients, omissions,
        )  # fmt: skip
        uv = model._shown(np.array([[0.5, 0.5]]) * size)
        if not np.isfinite(uv).all():
            raise InputError(
                "the transformation shows no ground at the middle of the image",
                where=where,
                hint="check the points or coefficients; explicit ones of high order need 'centre' and 'scale'",
            )
        reach = np.maximum(model._corners(uv), 1e-12)
        middle = middle + given.scale * uv[0]
        return replace(model, middle=middle, reach=reach, axes=model._axes_handedness(uv[:1]))

    @cached_property
    def _treecode(self) -> spline.Treecode:
        return spline.Treecode(self.nodes, self.coefficients)

    def _image(self, uv: FloatArray) -> FloatArray:
        if self.kind == "tps":
            if len(self.nodes) > spline.MANY:
                return self._treecode(uv)
            return spline.evaluate(self.nodes, self.coefficients, uv)
        return evaluate(self.kind, self.order, self.values, uv, self.axes)

    def _slopes(self, uv: FloatArray) -> FloatArray:
        if self.kind == "tps":
            return spline.slopes(self.nodes, self.coefficients, uv)
        return slopes(self.kind, self.order, self.values, uv, self.axes)

    def _shown(self, colrow: FloatArray) -> FloatArray:
        """Normalised ground (N, 2) of image points; NaN where there is none."""
        if self.kind == "projective":
            return projective_inverse(self.values, colrow)
        start = np.zeros((len(colrow), 2))
        if self.kind == "tps":
            known = self.values.reshape(2, -1).T
            # From the node whose image is nearest Newton's method has the shortest way through the bends.
            start = self.nodes[[int(np.argmin(np.hypot(*(known - place).T))) for place in colrow]]
        return newton_inverse(self._image, self._slopes, colrow, start)

    def _corners(self, uv: FloatArray) -> FloatArray:
        """Largest |u| and |v| of the image's corners, from its middle (1, 2)."""
        shifts = np.array([[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]]) * self.size
        if self.kind == "projective":  # corners beyond the horizon do not count
            places = projective_inverse(self.values, np.array(self.size) / 2.0 + shifts)
        else:  # near enough for the steps of the parameters, and never lost in the bends of a high order
            places = uv + shifts @ np.linalg.pinv(self._slopes(uv)[0]).T
        reach: FloatArray = np.nanmax(np.abs(np.vstack([uv, places])), axis=0)
        return reach

    def _axes_handedness(self, uv: FloatArray) -> str:
        """Handedness of the image's axes at a place (1, 2)."""
        # A conformal map keeps the handedness it was defined with; that of other kinds follows from their derivatives.
        (a, b), (c, d) = self._slopes(uv)[0]
        determinant = float(a * d - b * c)
        if self.kind == "conformal" or not np.isfinite(determinant) or determinant == 0.0:
            return self.axes
        return "right" if determinant > 0.0 else "left"

    @property
    def parameters(self) -> Parameters:
        """Coefficients; a step moves some point of the image by one pixel."""
        names = parameter_names(self.kind, self.order, len(self.nodes))
        units = tuple("" if name in ("c1", "c2") else "px" for name in names)
        if self.kind == "tps":
            return Parameters(names, units, self.values, self.sigmas, np.ones(len(names)))
        corners = np.array([[a, b] for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)]) * self.reach
        effect = np.abs(derivatives(self.kind, self.order, self.values, corners, self.axes)[0])
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
        return self._image(self._normalised(xyz))

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by coefficients (N, 2, P) and by ground coordinates (N, 2, 3)."""
        uv = self._normalised(xyz)
        if self.kind == "tps":
            shares = spline.influence(self.nodes, uv)
            by_values, by_uv = np.zeros((len(uv), 2, len(self.values))), self._slopes(uv)
            by_values[:, 0, : len(self.nodes)] = by_values[:, 1, len(self.nodes) :] = shares
        else:
            by_values, by_uv = derivatives(self.kind, self.order, self.values, uv, self.axes)
        return by_values, self._by_ground(by_uv)

    def ground_jacobian(self, xyz: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by ground coordinates (N, 2, 3)."""
        return self._by_ground(self._slopes(self._normalised(xyz)))

    def _by_ground(self, by_uv: FloatArray) -> FloatArray:
        by_ground = np.zeros((len(by_uv), 2, 3))
        by_ground[:, :, :2] = by_uv / self.scale
        by_ground[np.isnan(by_uv).any(axis=(1, 2))] = np.nan
        return by_ground

    def omission(self) -> FloatArray | None:
        """Of a spline: image at each node minus what a spline through all others gives there (N, 2), else None."""
        if self.kind != "tps" or len(self.omissions):
            return self.omissions if self.kind == "tps" else None
        return spline.solve(self.nodes, self.values.reshape(2, -1).T).omissions

    def with_values(self, values: FloatArray) -> Self:
        """Model with other coefficients (P,)."""
        new = self.parameters.with_values(values).values
        if self.kind == "tps":
            solved = spline.solve(self.nodes, new.reshape(2, -1).T)
            changed = replace(self, values=new, coefficients=solved.coefficients, omissions=solved.omissions)
        else:
            changed = replace(self, values=new)
        return replace(changed, axes=changed._axes_handedness((self.middle - self.centre)[None] / self.scale))

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
            "axes": self.axes,
            **({"nodes": self.nodes.tolist(), "coefficients": self.coefficients.tolist()} if len(self.nodes) else {}),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it."""
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
            axes=state.get("axes", "left"),
            nodes=np.array(state.get("nodes", spline.NO_NODES), dtype=np.float64),
            coefficients=np.array(state.get("coefficients", spline.NO_NODES), dtype=np.float64),
        )
