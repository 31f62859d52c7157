"""How far a lattice is from the exact model, measured where its cells may show the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.sensor.mapper import MapToImage
from geomosaic.types import BoolArray, FloatArray, IntArray

_LEVELS = (-1.0, -0.5, 0.0, 0.5, 1.0)


def at_height(nodes: FloatArray, t: float) -> FloatArray:
    """Image (rows, cols, 2) of a lattice's nodes (rows, cols, 8) at a normalised height."""
    n = nodes
    col = ((n[..., 3] * t + n[..., 2]) * t + n[..., 1]) * t + n[..., 0]
    row = ((n[..., 7] * t + n[..., 6]) * t + n[..., 5]) * t + n[..., 4]
    return np.stack([col, row], axis=-1)


@dataclass(frozen=True)
class Cells:
    """The cells of a lattice under construction; its parts are those of `lattice.Lattice`.

    Errors count in image pixels, or in output pixels where those are larger: nobody sees a hundredth of an image pixel
    in an output ten times coarser.
    """

    mapper: MapToImage
    grid: Grid
    window: Window
    step: int
    middle: float
    half: float
    surface: FloatArray
    nodes: FloatArray
    scale: float

    def error(self, admissible: float, *, thorough: bool) -> tuple[float, bool, BoolArray]:
        """Measure at the centres of cells, where a bilinear interpolation errs most, at both ends of the height range.

        Parameters
        ----------
        admissible : float
            Pixels.
        thorough : bool
            Measure the cells that err more again, at every output pixel and height at which they show the image:
            outside of it the model may be rough, and nobody will see that.

        Returns
        -------
        error : float
            Largest over the cells that may show the image, in pixels.
        ragged : bool
            Whether some of those cells are only partly seen by the model.
        seen : bool array (rows, cols)
            Cells that may show the image.
        """
        xy = self._surface_xy(np.array([0.5]), np.arange(self._shape[0] * self._shape[1]))
        levels = (-1.0, 1.0) if self.half else (0.0,)
        corners = np.stack([_corners(at_height(self.nodes, t)) for t in levels])
        counts = _touch(corners.reshape(-1, *corners.shape[2:]), self.mapper.model.size, 0.5)
        miss = np.zeros(len(xy))
        for t, around in zip(levels, corners, strict=True):
            with np.errstate(invalid="ignore"):
                off = np.hypot(*(_mean(around) - self._image(xy, t)).T)
            miss = np.fmax(miss, off / self._unit)
        if thorough:
            doubtful = np.flatnonzero(counts & (miss > admissible))
            if len(doubtful):
                miss[doubtful] = self._in_the_image(doubtful) / self._unit
        known = np.isfinite(corners).all(axis=-1).sum(axis=1)
        ragged = bool((counts & (known < 4).any(axis=0)).any())
        worst = float(miss[counts].max(initial=0.0))
        # The surface's own map is interpolated as well: a shift of its place, in output pixels, counts the same.
        shift = np.hypot(*(_mean(_corners(self.surface)) - xy).T) / self._pixel
        if self.half and np.isfinite(shift).any():
            worst = max(worst, float(np.nanmax(shift)))
        return worst, ragged, counts.reshape(self._shape)

    def height_error(self) -> float:
        """Largest error in pixels at the nodes that show the image, at the ends of the height range: the cubic's."""
        flat, size = self.surface.reshape(-1, 2), np.array(self.mapper.model.size)
        worst = 0.0
        for t in (-1.0, 1.0):
            exact = self._image(flat, t)
            with np.errstate(invalid="ignore"):
                shown = ((exact > 0.0) & (exact < size)).all(axis=1)
            miss = np.hypot(*(at_height(self.nodes, t).reshape(-1, 2) - exact)[shown].T)
            worst = max(worst, float(miss.max(initial=0.0)))
        return worst / self._unit

    @property
    def _shape(self) -> tuple[int, int]:
        return self.nodes.shape[0] - 1, self.nodes.shape[1] - 1

    @property
    def _pixel(self) -> float:
        """Size of an output pixel in units of the surface's map."""
        return float(np.hypot(*(self.surface[0, 1] - self.surface[0, 0]))) / self.step

    @property
    def _unit(self) -> float:
        """Size of the pixels that errors count in, in image pixels."""
        return max(1.0, self.scale) if np.isfinite(self.scale) else 1.0

    def _surface_xy(self, inner: FloatArray, cells: IntArray) -> FloatArray:
        """Surface map (N · n², 2) of places `inner` (n,), 0 to 1 along each side, of cells (N,)."""
        down, across = np.divmod(cells, self._shape[1])
        c, r = np.meshgrid(inner, inner)
        cols = self.window.col + self.step * (across[:, None] + c.ravel())
        rows = self.window.row + self.step * (down[:, None] + r.ravel())
        return self.mapper.surface_xy(self.grid.xy(np.column_stack([cols.ravel(), rows.ravel()])))

    def _image(self, surface_xy: FloatArray, t: float) -> FloatArray:
        return self.mapper.image(surface_xy, np.full(len(surface_xy), self.middle + self.half * t))

    def _in_the_image(self, cells: IntArray) -> FloatArray:
        """Largest error (N,) in image pixels over all output pixels of cells (N,) and heights that show the image."""
        inner = (np.arange(self.step) + 0.5) / self.step
        c, r = (axis.ravel()[None, :, None] for axis in np.meshgrid(inner, inner))
        xy, size = self._surface_xy(inner, cells), np.array(self.mapper.model.size)
        worst = np.zeros(len(cells))
        for t in _LEVELS if self.half else (0.0,):
            exact = self._image(xy, t).reshape(len(cells), -1, 2)
            a, b, below_a, below_b = _corners(at_height(self.nodes, t))[:, cells, None]
            near = (1 - r) * ((1 - c) * a + c * b) + r * ((1 - c) * below_a + c * below_b)
            with np.errstate(invalid="ignore"):
                shown = ((exact > -1.0) & (exact < size + 1.0)).all(axis=-1)
                miss = np.where(shown, np.hypot(*np.moveaxis(near - exact, -1, 0)), 0.0)
            worst = np.fmax(worst, np.fmax.reduce(miss, axis=1))
        return worst


def _corners(nodes: FloatArray) -> FloatArray:
    """Nodes (rows, cols, 2) by corner and cell: (4, cells, 2)."""
    rows, cols = nodes.shape[0] - 1, nodes.shape[1] - 1
    return np.stack([nodes[i : i + rows, j : j + cols].reshape(-1, 2) for i in (0, 1) for j in (0, 1)])


def _mean(corners: FloatArray) -> FloatArray:
    """Middle of each cell."""
    mean: FloatArray = (corners[0] + corners[1] + corners[2] + corners[3]) / 4
    return mean


def _touch(places: FloatArray, size: tuple[int, int], around: float) -> BoolArray:
    """Whether the boxes about places (K, N, 2), and `around` times as much on each side, meet the image: (N,)."""
    low, high = np.fmin.reduce(places), np.fmax.reduce(places)
    pad = around * (high - low) + 1.0
    with np.errstate(invalid="ignore"):
        touch: BoolArray = ((high + pad > 0) & (low - pad < np.array(size))).all(axis=-1)
    return touch
