"""The lattice held against the model at every pixel, where a coarse grid makes it hard."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from affine import Affine
from helpers import GROUND, MAP, ArrayReader, PinholeOverMap

from geomosaic.geo.grid import Grid, Window
from geomosaic.kernels.warp import Geometry, coordinates
from geomosaic.resample.warp import Colour, Sampling, Target, warp
from geomosaic.sensor.lattice import Lattice, blocks, build
from geomosaic.sensor.map_to_image import BlockGround, Ground, MapToImage
from geomosaic.surface.model import HeightPatch, Plane


@dataclass(frozen=True)
class Squared(PinholeOverMap):
    """A conformal mapping, as every map projection to another is: it bends one way along, the other way across."""

    def ground_to_image(self, xyz: np.ndarray) -> np.ndarray:
        z = (np.asarray(xyz)[:, 0] - 500000.0 + 1j * (5500000.0 - np.asarray(xyz)[:, 1])) / 1000.0
        w = 500.0 * (1.0 + z + 0.05 * z * z)
        return np.column_stack([w.real, w.imag])


def lattices_of(model: PinholeOverMap, grid: Grid, tolerance: float = 0.02) -> list[Lattice]:
    below = Ground.under(grid, Plane(GROUND, 0.0))
    mapper = MapToImage.between(MAP, GROUND, model)
    return [
        lattice
        for window in blocks(grid.window)
        for lattice in build(mapper, grid, below.block(window.intersection(grid.window)), tolerance)
    ]


def errors(model: PinholeOverMap, grid: Grid, lattice: Lattice) -> np.ndarray:
    """Interpolated less exact place (N, 2) of all pixels of the lattice that show the image, in image pixels."""
    window = lattice.window
    cols, rows = np.empty((2, window.height, window.width))
    geometry = Geometry(lattice.nodes, np.zeros((1, 1, 2)), np.zeros((1, 1), np.float32), 0.0, 0.0, True, lattice.step)
    need = np.ones((-(-window.height // 64), -(-window.width // 64)), dtype=np.uint8)
    coordinates(geometry, 0, 1, model.size, need, cols, rows)
    c, r = np.meshgrid(window.col + np.arange(window.width) + 0.5, window.row + np.arange(window.height) + 0.5)
    xy = grid.xy(np.column_stack([c.ravel(), r.ravel()]))
    exact = model.ground_to_image(np.column_stack([xy, np.zeros(len(xy))]))
    shown = (exact > 0).all(axis=1) & (exact < np.array(model.size)).all(axis=1)
    return (np.column_stack([cols.ravel(), rows.ravel()]) - exact)[shown]


def true_error(model: PinholeOverMap, grid: Grid, lattice: Lattice) -> float:
    """Largest distance, in pixels that errors count in."""
    return float(np.hypot(*errors(model, grid, lattice).T).max(initial=0.0)) / max(1.0, lattice.scale)


@pytest.mark.parametrize("model", [PinholeOverMap(tilt=(0.5, 0.1, 0.4)), Squared()])
@pytest.mark.parametrize("tolerance", [0.05, 0.02])
def test_interpolated_geometry_errs_to_no_side(model: PinholeOverMap, tolerance: float) -> None:
    """A chord between nodes lies on one side of its curve, and the picture would lie there as a whole."""
    grid = Grid.from_bounds(MAP, (499400.0, 5499600.0, 500600.0, 5501400.0), 1.0)
    off = np.concatenate([errors(model, grid, lattice) for lattice in lattices_of(model, grid, tolerance)])
    assert np.sqrt((off**2).sum(axis=1).mean()) > 0.01 * tolerance  # the lattice is coarse enough to err
    assert np.hypot(*off.mean(axis=0)) < 0.0005


def test_straight_geometry_keeps_every_bit_of_its_nodes() -> None:
    model = PinholeOverMap(tilt=(0.0, 0.0, 0.0))
    grid = Grid.from_bounds(MAP, (499600.0, 5499600.0, 500400.0, 5500400.0), 1.0)
    for lattice in lattices_of(model, grid):
        xy = lattice.surface.reshape(-1, 2)
        exact = model.ground_to_image(np.column_stack([xy, np.zeros(len(xy))])).reshape(lattice.surface.shape)
        assert np.array_equal(lattice.nodes[..., ::4], exact)


@pytest.mark.parametrize("resolution", [0.5, 2.0, 8.0])
def test_oblique_photos_of_a_plane(resolution: float) -> None:
    model = PinholeOverMap(tilt=(0.77, 0.1, 0.4))
    grid = Grid.from_bounds(MAP, (499000.0, 5499600.0, 501000.0, 5502600.0), resolution)
    lattices = lattices_of(model, grid)
    assert max(true_error(model, grid, lattice) for lattice in lattices) <= 0.02
    assert 0.001 < max(lattice.error for lattice in lattices) <= 0.02


@pytest.mark.parametrize("tolerance", [0.2, 0.02])
def test_what_bends_one_way_along_and_the_other_way_across_is_measured(tolerance: float) -> None:
    """At the centres of cells such a mapping errs nowhere."""
    model = Squared()
    grid = Grid.from_bounds(MAP, (499000.0, 5499000.0, 501000.0, 5501000.0), 2.0)
    lattices = lattices_of(model, grid, tolerance)
    assert lattices
    for lattice in lattices:
        error = true_error(model, grid, lattice)
        assert error <= tolerance
        assert error <= 1.5 * lattice.error + 1e-9


class CountingReader(ArrayReader):
    read_pixels, largest = 0, 0

    def read(self, window, shrink=1):
        self.read_pixels += window.width * window.height
        self.largest = max(self.largest, window.width * window.height)
        return super().read(window, shrink)


@pytest.mark.parametrize("heading", [0.0, 0.8])
def test_a_turned_photo_on_a_coarse_grid_is_not_read_over_and_over(
    monkeypatch: pytest.MonkeyPatch, heading: float
) -> None:
    from geomosaic.resample import warp as module

    monkeypatch.setattr(module, "MOST_PIXELS", 60_000)
    model = replace(PinholeOverMap(), tilt=(0.02, 0.01, heading))
    grid = Grid.from_bounds(MAP, (499000.0, 5499000.0, 501000.0, 5501000.0), 4.0)
    reader = CountingReader(np.full((800, 1000, 1), 77, dtype=np.uint8))
    out, valid = np.zeros((*grid.shape, 1), np.uint8), np.zeros(grid.shape, np.uint8)
    for lattice in lattices_of(model, grid):
        w = lattice.window
        inside = slice(w.row, w.stop_row), slice(w.col, w.stop_col)
        warp(
            reader,
            model.size,
            lattice,
            None,
            Sampling("average"),
            Colour.identity(1),
            Target(out[inside], valid[inside]),
        )
    assert (valid * 16).sum() > 0.9 * 800_000
    assert (out[valid > 0] == 77).all()
    assert reader.read_pixels < 4 * 800_000
    assert reader.largest < 4 * 260 * 260


@pytest.mark.parametrize("beyond", [(-30.0, 0.0), (30.0, 0.0), (0.0, -30.0), (0.0, 30.0)])
def test_no_height_is_known_beyond_the_heights_of_a_block(beyond: tuple[float, float]) -> None:
    """A part of a block may lie wholly beyond the DEM, on any side."""
    patch = HeightPatch(np.arange(16, dtype=np.float32).reshape(4, 4), Affine(1, 0, 0, 0, -1, 4))
    below = BlockGround(Window(0, 0, 64, 64), patch, patch.range)
    places = np.array([[1.0, 1.0], [3.0, 3.0]])
    assert below.over(places) == (0.0, 15.0)
    assert np.isnan(below.over(places + beyond)).all()
