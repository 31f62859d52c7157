"""Error of a lattice against the exact model, measured where its cells may show the image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.sensor.map_to_image import MapToImage
from geomosaic.types import BoolArray, FloatArray, IntArray

# Both ends of the normalised height range.
ENDS = np.array([-1.0, 1.0])
# Doubtful cells that are judged at first, and at most at once: 4096 of 4 x 4 pixels at five heights take some 30 MB.
FIRST_JUDGED, MOST_JUDGED = 4, 4096
# Times the admissible error that nodes at half the step do not mend, as what bends errs a quarter there.
HOPELESS = 4.0
_LEVELS = (-1.0, -0.5, 0.0, 0.5, 1.0)


def at_heights(nodes: FloatArray, heights: Sequence[float]) -> FloatArray:
    """Image positions of a lattice's nodes at some heights.

    Parameters
    ----------
    nodes : array (rows, cols, 8)
        Coefficients of a cubic in normalised height: four of col, then four of row, from the constant up.
    heights : sequence of float (T,)
        Normalised heights.

    Returns
    -------
    array (T, rows, cols, 2)
        (col, row) in pixels.
    """
    powers = np.vander(heights, 4, increasing=True)
    # One at a time, not a matrix product: the same digits on every machine.
    image: FloatArray = np.einsum("rcap,tp->trca", nodes.reshape(*nodes.shape[:2], 2, 4), powers)
    return image


def both(flags: BoolArray) -> BoolArray:
    """Whether both flags of each pair hold.

    Parameters
    ----------
    flags : bool array (..., 2)

    Returns
    -------
    bool array (...)
    """
    # `all` over an axis of two takes ten times as long.
    return flags[..., 0] & flags[..., 1]


@dataclass(frozen=True, eq=False)
class LatticeError:
    """Errors of a lattice against the exact model.

    Attributes
    ----------
    error : float
        Largest over the cells that may show the image, in pixels.
    cubic : float
        Largest at nodes that show the image, where only the cubic in height can err.
    ragged : bool
        Whether some of those cells are only partly seen by the model.
    seen : bool array (rows, cols)
        Cells that may show the image.
    worst : array (rows, cols)
        Largest error of each of those cells, 0 in others.
    """

    error: float
    cubic: float
    ragged: bool
    seen: BoolArray
    worst: FloatArray

    def share(self, error: float) -> float:
        """Share of the cells that may show the image, 0 to 1, that err by more than `error`."""
        return float((self.worst[self.seen] > error).mean()) if self.seen.any() else 0.0


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells of a lattice under construction; its parts are those of `lattice.Lattice`, and two more.

    `places` (2 · rows + 1, 2 · cols + 1, 2) is the surface map of nodes and of what lies half-way between; `exact`
    (levels, 2 · rows + 1, 2 · cols + 1, 2) what the model says there at the heights `ENDS`, one level where flat;
    `ends` (levels, rows + 1, cols + 1, 2) what the nodes say.

    Errors count in image pixels, or in output pixels where those are larger: nobody sees a hundredth of an image pixel
    in an output ten times coarser.
    """

    mapper: MapToImage
    grid: Grid
    window: Window
    step: int
    middle: float
    half: float
    places: FloatArray
    nodes: FloatArray
    ends: FloatArray
    exact: FloatArray
    scale: float

    def measure(self, admissible: float, *, thorough: bool) -> LatticeError:
        """Error against the model at nodes, edges and centres of cells, at both ends of the height range.

        Parameters
        ----------
        admissible : float
            Pixels.
        thorough : bool
            Measure the cells that err more again, at every output pixel and height at which they show the image:
            outside of it the model may be rough, and nobody will see that.
        """
        # Between nodes a smooth mapping errs most there: at the centres where it bends alike in both directions, at the
        # middles of edges where it bends one way along and the other way across, as every conformal one does.
        ends = self.ends
        with np.errstate(invalid="ignore"):
            off = _halved(ends) - self.exact
            misses = np.sqrt(off[..., 0] ** 2 + off[..., 1] ** 2) / self._unit
            inside = both((self.exact > 0.0) & (self.exact < np.array(self.mapper.model.size)))
        miss, shown = np.fmax.reduce(misses), np.logical_or.reduce(inside)
        corners = np.stack([_corners(end) for end in ends])
        # Only cells that may show the image: beside it a model may be as rough as it likes.
        counts = _touch(corners.reshape(-1, *corners.shape[2:]), self.mapper.model.size)
        worst = np.fmax(_around(miss).ravel(), 0.0)
        # Where samples that show the image err by far too much, nothing clears their cells.
        if thorough and (self.step == 1 or not (misses[inside] > HOPELESS * admissible).any()):
            # The exact model at every pixel is dear: it judges only the cells that the samples cannot clear, the worst
            # first. One that fails is enough to ask for closer nodes; only of the closest all errors are wanted.
            doubtful = np.flatnonzero(counts & (worst > admissible))
            doubtful = doubtful[np.argsort(-worst[doubtful], kind="stable")]
            # Of pixels as cells the model has been asked at their centres: all are judged at once, for nothing.
            first, count = 0, FIRST_JUDGED if self.step > 1 else len(doubtful)
            while first < len(doubtful):
                some = doubtful[first : first + count]
                worst[some] = self._in_the_image(some) / self._unit
                if self.step > 1 and worst[some].max() > admissible:
                    break
                first, count = first + count, min(4 * count, MOST_JUDGED)
        known = both(np.isfinite(corners)).sum(axis=1)
        ragged = bool((counts & (known < 4).any(axis=0)).any())
        worst[~counts] = 0.0
        error = float(worst.max(initial=0.0))
        # The surface's own map is interpolated as well: a shift of its place, in output pixels, counts the same.
        if self.half and not self.mapper.to_surface.identical:
            shift = _halved(self.places[None, ::2, ::2])[0] - self.places
            with np.errstate(invalid="ignore"):
                error = float(np.fmax(error, np.fmax.reduce(np.hypot(*shift.reshape(-1, 2).T)) / self._pixel))
        cubic = float(np.fmax.reduce(miss[::2, ::2][shown[::2, ::2]], initial=0.0))
        return LatticeError(error, cubic, ragged, counts.reshape(self._shape), worst.reshape(self._shape))

    @property
    def _shape(self) -> tuple[int, int]:
        return self.nodes.shape[0] - 1, self.nodes.shape[1] - 1

    @property
    def _pixel(self) -> float:
        """Size of an output pixel in units of the surface's map."""
        return float(np.hypot(*(self.places[0, 2] - self.places[0, 0]))) / self.step

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

    def _in_the_image(self, cells: IntArray) -> FloatArray:
        """Largest error (N,) in image pixels over all output pixels of cells (N,) and heights that show the image."""
        inner = (np.arange(self.step) + 0.5) / self.step
        c, r = (axis.ravel()[:, None] for axis in np.meshgrid(inner, inner))
        heights: Sequence[float]
        if self.step == 1:
            heights = (-1.0, 1.0) if self.half else (-1.0,)  # any height, where it plays no part
            exact = self.exact[:, 1::2, 1::2].reshape(len(heights), -1, 1, 2)[:, cells]
        else:
            heights = _LEVELS if self.half else (0.0,)
            # All heights in one go: of few places the way to the model costs more than its answer.
            xy, z = self._surface_xy(inner, cells), self.middle + self.half * np.array(heights)
            exact = self.mapper.image(np.tile(xy, (len(z), 1)), np.repeat(z, len(xy)))
            exact = exact.reshape(len(z), len(cells), -1, 2)
        corners = [_corners(nodes)[:, cells, None] for nodes in at_heights(self.nodes, heights)]
        a, b, below_a, below_b = np.stack(corners, axis=1)
        near = (1 - r) * ((1 - c) * a + c * b) + r * ((1 - c) * below_a + c * below_b)
        with np.errstate(invalid="ignore"):
            shown = both((exact > -1.0) & (exact < np.array(self.mapper.model.size) + 1.0))
            miss = np.where(shown, np.hypot(*np.moveaxis(near - exact, -1, 0)), 0.0)
        worst: FloatArray = np.fmax(np.fmax.reduce(miss, axis=(0, 2)), 0.0)
        return worst


def _corners(nodes: FloatArray) -> FloatArray:
    """Nodes (rows, cols, 2) by corner and cell: (4, cells, 2)."""
    rows, cols = nodes.shape[0] - 1, nodes.shape[1] - 1
    return np.stack([nodes[i : i + rows, j : j + cols].reshape(-1, 2) for i in (0, 1) for j in (0, 1)])


def _halved(nodes: FloatArray) -> FloatArray:
    """Positions (levels, rows, cols, 2) at nodes and, interpolated, half-way between them."""
    levels, rows, cols, _ = nodes.shape
    fine = np.empty((levels, 2 * rows - 1, 2 * cols - 1, 2))
    fine[:, ::2, ::2] = nodes
    fine[:, ::2, 1::2] = (nodes[:, :, 1:] + nodes[:, :, :-1]) / 2
    fine[:, 1::2] = (fine[:, 2::2] + fine[:, :-1:2]) / 2
    return fine


def _around(miss: FloatArray) -> FloatArray:
    """Largest of the nine values (2 · rows + 1, 2 · cols + 1) of each cell: (rows, cols)."""
    down = np.fmax(np.fmax(miss[:-1:2], miss[1::2]), miss[2::2])
    return np.fmax(np.fmax(down[:, :-1:2], down[:, 1::2]), down[:, 2::2])


def _touch(places: FloatArray, size: tuple[int, int]) -> BoolArray:
    """Whether the boxes about places (K, N, 2), and half as much on each side, meet the image: (N,)."""
    low, high = np.fmin.reduce(places), np.fmax.reduce(places)
    pad = 0.5 * (high - low) + 1.0
    with np.errstate(invalid="ignore"):
        return both((high + pad > 0) & (low - pad < np.array(size)))
