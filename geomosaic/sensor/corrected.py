"""Sensor models with a correction grid: small corrections of image coordinates on a regular grid over the image.

    corrected = ideal + d(ideal)

The **ideal** position is where the wrapped model puts a ground point; the **corrected** one is where the image really
shows it. So a grid holds *real minus ideal*, looked up at the ideal position: for a camera with systematic image errors
these are the mean residuals (measured minus computed) of its photos, and for two photos that are to meet along an edge
they are the residuals of their common points. The way back, from a measured position to a line of sight, takes the
correction off again, by iteration to 1e-9 pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self, cast

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.sensor.plugin import (
    Calibration,
    ControlBlunder,
    HasInterior,
    HasLeftOut,
    HasRadiometry,
    HasRays,
    Parameters,
    SensorModel,
    WrappedModel,
)
from geomosaic.sensor.registry import plugin
from geomosaic.sensor.solve.newton import jacobian
from geomosaic.types import FloatArray

METHODS = ("bicubic", "bilinear")
BEYOND = ("zero", "held")
# Pixels per pixel: a grid that changes faster between neighbouring nodes is refused, for it may fold the image.
STEEPEST = 0.5
# Cells beyond the outermost node from where on nothing changes any more.
_FAR = 4


@dataclass(frozen=True, eq=False)
class CorrectionGrid:
    """Corrections (d_col, d_row) at the nodes of a regular grid, interpolated between them.

    A correction (`Corrected`) is added to the ideal image position, and looked up there.

    Attributes
    ----------
    origin : array (2,)
        Image position (col, row) of the first node in pixels, corner-based as all image coordinates.
    spacing : array (2,)
        Pixels from one node to the next, along columns and along rows.
    nodes : array (R, C, 2)
        d_col and d_row in pixels; nodes[r, c] lies at origin + (c, r) · spacing.
    method : str
        'bicubic': cubic convolution (Keys 1981, a = −1/2), which meets the nodes and has continuous slopes;
        'bilinear': straight between nodes.
    beyond : str
        Outside the outermost nodes: 'zero' (as if further nodes were 0, so the correction runs out smoothly within two
        cells, bilinear within one) or 'held' (as if the outermost nodes were repeated).

    Raises
    ------
    InputError
        Numbers that are not finite, fewer than one node, or corrections so steep that they may fold the image.
    """

    origin: FloatArray
    spacing: FloatArray
    nodes: FloatArray
    method: str = "bicubic"
    beyond: str = "zero"

    def __post_init__(self) -> None:
        for name in ("origin", "spacing", "nodes"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if self.origin.shape != (2,) or self.spacing.shape != (2,) or self.nodes.ndim != 3 or self.nodes.shape[2] != 2:
            raise ValueError(f"shapes {self.origin.shape}, {self.spacing.shape}, {self.nodes.shape} make no grid")
        for name, known in (("method", METHODS), ("beyond", BEYOND)):
            if getattr(self, name) not in known:
                raise InputError(
                    f"a correction grid has no {name} '{getattr(self, name)}'", hint=f"choose {' or '.join(known)}"
                )
        if not self.nodes.size or not all(np.isfinite(a).all() for a in (self.origin, self.spacing, self.nodes)):
            raise InputError("a correction grid has a number that is not finite, or no node", hint="give every node")
        if not (self.spacing > 0.0).all():
            raise InputError("the spacing of a correction grid is not positive", hint="give pixels greater than 0")
        if self.steepest > STEEPEST:
            raise InputError(
                f"the corrections change by {self.steepest:.2g} pixels per pixel between neighbouring nodes: more than "
                f"{STEEPEST} may fold the image",
                hint="look for a wrong node, or points that contradict each other, and for corrections in other units",
            )

    @property
    def steepest(self) -> float:
        """Largest change between neighbouring nodes, in pixels per pixel; the border counts as `beyond` has it."""
        nodes = self._padded()
        along = np.linalg.norm(np.diff(nodes, axis=1), axis=2).max() / self.spacing[0]
        down = np.linalg.norm(np.diff(nodes, axis=0), axis=2).max() / self.spacing[1]
        return float(np.hypot(along, down))

    def _padded(self) -> FloatArray:
        padding = ((1, 1), (1, 1), (0, 0))
        return np.pad(self.nodes, padding) if self.beyond == "zero" else np.pad(self.nodes, padding, mode="edge")

    def at(self, colrow: FloatArray) -> FloatArray:
        """Corrections (N, 2) in pixels at image positions (N, 2); NaN where a position is."""
        return self._sum(colrow, (0, 0))

    def slopes(self, colrow: FloatArray) -> FloatArray:
        """Derivatives (N, 2, 2) of (d_col, d_row) by (col, row), at image positions (N, 2)."""
        # A bilinear grid has none on the lines between nodes: those of the cell to the right and below are given.
        by_col = self._sum(colrow, (1, 0)) / self.spacing[0]
        by_row = self._sum(colrow, (0, 1)) / self.spacing[1]
        return np.stack([by_col, by_row], axis=2)

    def weights(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Nodes that count at image positions, and by how much.

        Parameters
        ----------
        colrow : array (N, 2)
            Finite positions inside the outermost nodes.

        Returns
        -------
        index : int array (N, 4, 4)
            Of `nodes`, flattened over rows and columns; clipped where a node lies outside, see `beyond`.
        weight : array (N, 4, 4)
            0 for nodes outside that count as 0.
        """
        rows, columns, _ = self.nodes.shape
        index, weight = [], []
        for axis, count in ((1, rows), (0, columns)):
            first, part = self._cell(colrow[:, axis], axis)
            i = first[:, None] + np.arange(-1, 3)
            w = self._kernel(part, 0)
            index.append(np.clip(i, 0, count - 1))
            weight.append(np.where((i < 0) | (i >= count), 0.0, w) if self.beyond == "zero" else w)
        flat = index[0][:, :, None] * columns + index[1][:, None, :]
        return flat, weight[0][:, :, None] * weight[1][:, None, :]

    def _sum(self, colrow: FloatArray, order: tuple[int, int]) -> FloatArray:
        """Sum over the 4 × 4 nodes around each position, differentiated `order` times by col and row in cells."""
        image = np.asarray(colrow, dtype=np.float64)
        lost = ~np.isfinite(image).all(axis=1)
        rows, columns, _ = self.nodes.shape
        (c, u), (r, v) = (self._cell(np.where(lost, 0.0, image[:, axis]), axis) for axis in (0, 1))
        wc, wr = self._kernel(u, order[0]), self._kernel(v, order[1])
        total = np.zeros((len(image), 2))
        for j in range(4):
            row = r + j - 1
            line = np.zeros((len(image), 2))
            for i in range(4):
                column = c + i - 1
                value = self.nodes[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
                if self.beyond == "zero":
                    value = np.where(
                        ((row >= 0) & (row < rows) & (column >= 0) & (column < columns))[:, None], value, 0.0
                    )
                line += wc[:, i, None] * value
            total += wr[:, j, None] * line
        total[lost] = np.nan
        return total

    def _cell(self, position: FloatArray, axis: int) -> tuple[FloatArray, FloatArray]:
        """Number of the node before a position (N,), and the way from it in cells, 0 to 1."""
        count = self.nodes.shape[1 - axis]
        # Far outside all is constant, and whole numbers would not reach.
        cells = np.clip((position - self.origin[axis]) / self.spacing[axis], -_FAR, count - 1 + _FAR)
        first = np.floor(cells)
        return first.astype(np.int64), cells - first

    def _kernel(self, t: FloatArray, order: int) -> FloatArray:
        """Weights (N, 4) of the nodes −1, 0, 1, 2 at t, or their derivatives."""
        zero, one = np.zeros_like(t), np.ones_like(t)
        if self.method == "bilinear":
            return np.column_stack([zero, -one, one, zero] if order else [zero, one - t, t, zero])
        # Cubic convolution with a = -1/2 (Keys, IEEE Trans. ASSP 29 (1981), p. 1153): it passes through the nodes.
        if order:
            parts = ((-3 * t + 4) * t - 1, (9 * t - 10) * t, (-9 * t + 8) * t + 1, (3 * t - 2) * t)
        else:
            parts = (
                ((-t + 2) * t - 1) * t,
                (3 * t - 5) * t * t + 2,
                ((-3 * t + 4) * t + 1) * t,
                (t - 1) * t * t,
            )
        return np.column_stack(parts) / 2

    def ideal(self, colrow: FloatArray) -> FloatArray:
        """Ideal positions (N, 2) whose corrected positions are given (N, 2), to 1e-9 pixel."""
        # Solves p + d(p) = given by Newton's method; the corrections are too flat (`STEEPEST`) for a second solution.
        image = np.asarray(colrow, dtype=np.float64)
        # First guess: the correction at the corrected place, off by slope times correction only.
        place = image - self.at(image)
        for _ in range(30):
            left = image - place - self.at(place)
            if not (np.abs(left) > 1e-10).any():
                break
            slopes = self.slopes(place) + np.eye(2)
            (a, b), (c, d) = slopes[:, 0].T, slopes[:, 1].T
            determinant = a * d - b * c
            newton = np.column_stack([d * left[:, 0] - b * left[:, 1], a * left[:, 1] - c * left[:, 0]])
            trial = place + newton / determinant[:, None]
            worse = np.abs(image - trial - self.at(trial)).max(axis=1) > 0.9 * np.abs(left).max(axis=1)
            # Over a kink of a bilinear grid Newton may turn in circles; the plain step always comes closer.
            place = np.where(worse[:, None], place + left, trial)
        return place

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "origin": self.origin.tolist(),
            "spacing": self.spacing.tolist(),
            "nodes": self.nodes.tolist(),
            "method": self.method,
            "beyond": self.beyond,
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Grid of a state, as `to_dict` gives it."""
        return cls(state["origin"], state["spacing"], state["nodes"], state["method"], state["beyond"])


@dataclass(frozen=True, eq=False)
class Corrected(WrappedModel):
    """A sensor model with a correction grid behind it; make one with `Corrected.of`.

    The parameters are those of the wrapped model; the grid is held. It can be wrapped again: corrections of a camera
    first, those of an edge on top.

    Attributes
    ----------
    model : SensorModel
        Ground to ideal image position.
    grid : CorrectionGrid
        Real minus ideal position, at the ideal position, in pixels.
    sensor : str
        Name of the sensor plugin that `model` comes from, by which its state finds back.
    """

    grid: CorrectionGrid
    sensor: str

    @staticmethod
    def of(model: SensorModel, grid: CorrectionGrid, sensor: str) -> Corrected:
        """Corrected model; it has rays, and an interior orientation, where the wrapped model has them.

        Parameters
        ----------
        model : SensorModel
        grid : CorrectionGrid
        sensor : str
            Name of the model's sensor.
        """
        return _KINDS[isinstance(model, HasRays), isinstance(model, HasInterior)](model, grid, sensor)

    @property
    def crs(self) -> CRS:
        """That of the wrapped model."""
        return self.model.crs

    @property
    def seed(self) -> tuple[float, float, float]:
        """That of the wrapped model."""
        return self.model.seed

    @property
    def amplitudes(self) -> bool:
        """Whether pixels are amplitudes, as the wrapped model says; see `HasRadiometry`."""
        return isinstance(self.model, HasRadiometry) and self.model.amplitudes

    @property
    def calibration(self) -> Calibration | None:
        """That of the wrapped model, if it has any."""
        return self.model.calibration if isinstance(self.model, HasRadiometry) else None

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) in `crs` to corrected (col, row) (N, 2)."""
        ideal = self.model.ground_to_image(xyz)
        return ideal + self.grid.at(ideal)

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives by the parameters (N, 2, P) and by ground coordinates (N, 2, 3), by the chain rule."""
        by_parameters, by_ground = jacobian(self.model, xyz)
        turn = self._turn(xyz)
        return turn @ by_parameters, turn @ by_ground

    def _turn(self, xyz: FloatArray) -> FloatArray:
        """Derivatives of the corrected by the ideal position (N, 2, 2)."""
        return np.eye(2) + self.grid.slopes(self.model.ground_to_image(xyz))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values, with the sensor's name."""
        kind = "corrected" if isinstance(self.model, Corrected) else "state"
        return {"sensor": self.sensor, kind: self.model.to_dict(), "grid": self.grid.to_dict()}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it; the sensor's plugin must be installed."""
        inner = (
            Corrected.from_dict(state["corrected"])
            if "corrected" in state
            else plugin(state["sensor"]).model.from_dict(state["state"])
        )
        return cast(Self, Corrected.of(inner, CorrectionGrid.from_dict(state["grid"]), state["sensor"]))


@dataclass(frozen=True, eq=False)
class CorrectedWithRays(Corrected):
    """A corrected model whose wrapped model has lines of sight in closed form."""

    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to origins and unit directions (N, 3): those of the ideal positions."""
        return cast(HasRays, self.model).rays(self.grid.ideal(colrow))


@dataclass(frozen=True, eq=False)
class CorrectedWithInterior(Corrected):
    """A corrected model whose wrapped model has an interior orientation."""

    @property
    def interior(self) -> Parameters:
        """That of the wrapped model."""
        return cast(HasInterior, self.model).interior

    def with_interior(self, interior: Parameters) -> Self:
        """Model with another interior orientation behind the same grid."""
        return replace(self, model=cast(SensorModel, cast(HasInterior, self.model).with_interior(interior)))

    def interior_jacobian(self, xyz: FloatArray) -> FloatArray:
        """Derivatives by the interior orientation (N, 2, Q), by the chain rule."""
        return self._turn(xyz) @ cast(HasInterior, self.model).interior_jacobian(xyz)


@dataclass(frozen=True, eq=False)
class CorrectedWithBoth(CorrectedWithRays, CorrectedWithInterior):
    """A corrected model whose wrapped model has lines of sight and an interior orientation."""


# By whether the wrapped model has rays, and an interior orientation: powers are seen by their methods.
_KINDS: dict[tuple[bool, bool], type[Corrected]] = {
    (False, False): Corrected,
    (True, False): CorrectedWithRays,
    (False, True): CorrectedWithInterior,
    (True, True): CorrectedWithBoth,
}


def model_to_dict(name: str, model: SensorModel) -> dict[str, Any]:
    """State of a model with the sensor's name, as JSON values; corrections around the model are kept.

    Parameters
    ----------
    name : str
        Sensor.
    model : SensorModel

    Returns
    -------
    dict
        Keys `sensor`, and `corrected` or `state`.
    """
    return {"sensor": name, "corrected" if isinstance(model, Corrected) else "state": model.to_dict()}


def model_from_dict(state: dict[str, Any]) -> SensorModel:
    """Model of a state that `model_to_dict` made.

    Parameters
    ----------
    state : dict

    Raises
    ------
    SensorError
        The sensor is not installed here.
    """
    if "corrected" in state:
        return Corrected.from_dict(state["corrected"])
    return plugin(state["sensor"]).model.from_dict(state["state"])


def left_out(model: SensorModel) -> tuple[ControlBlunder, ...]:
    """Control points that contradict the others, and took no part in the fit of a model, corrected or not.

    Parameters
    ----------
    model : SensorModel
    """
    inner = model.model if isinstance(model, Corrected) else model
    return inner.left_out if isinstance(inner, HasLeftOut) else ()
