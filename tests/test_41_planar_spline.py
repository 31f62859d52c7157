"""Thin plate spline: through every point, against scipy and GDAL, exact on what it must reproduce, refusals."""

from __future__ import annotations

import json
import pickle
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from pyproj import CRS

from geomosaic.errors import InputError, SolveError
from geomosaic.geo.grid import Grid
from geomosaic.sensor.lattice import Lattice, blocks, build
from geomosaic.sensor.map_to_image import Ground, MapToImage
from geomosaic.sensor.plugin import SensorRequest
from geomosaic_planar import PlanarModel, fit_planar, plugin, spline

UTM = CRS.from_epsg(32633)
SIZE = (6000, 4000)


def warped(count: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Ground and image of a scan that is bent by some tens of pixels."""
    rng = np.random.default_rng(seed)
    colrow = rng.uniform([0.0, 0.0], SIZE, (count, 2))
    flat = colrow + 30.0 * np.sin(colrow[:, ::-1] / 900.0) + rng.normal(0.0, 1.0, colrow.shape)
    return flat * [0.4, -0.4] + [512_300.0, 5_403_800.0], colrow


def spline_of(xy: np.ndarray, colrow: np.ndarray) -> PlanarModel:
    return PlanarModel.of(fit_planar("tps", xy, colrow), UTM, SIZE)


def ground3(xy: np.ndarray) -> np.ndarray:
    return np.column_stack([xy, np.zeros(len(xy))])


@pytest.mark.parametrize("count", [3, 4, 12, 200])
def test_it_passes_through_every_point(count: int) -> None:
    xy, colrow = warped(count)
    fitted = fit_planar("tps", xy, colrow)
    assert np.abs(fitted.residuals).max() < 1e-8
    assert np.isnan(fitted.sigma0)
    model = spline_of(xy, colrow)
    np.testing.assert_allclose(model.ground_to_image(ground3(xy)), colrow, rtol=0.0, atol=1e-8)
    assert model.transformation.axes == "left"


def test_a_spline_is_that_of_scipy() -> None:
    from scipy.interpolate import RBFInterpolator

    xy, colrow = warped(80)
    at = warped(500, seed=9)[0]
    scaled = (xy - xy.mean(axis=0)) / 1000.0
    other = RBFInterpolator(scaled, colrow, kernel="thin_plate_spline", degree=1)
    np.testing.assert_allclose(
        spline_of(xy, colrow).ground_to_image(ground3(at)), other((at - xy.mean(axis=0)) / 1000.0), rtol=0.0, atol=1e-6
    )


@pytest.mark.parametrize("count", [5, 30, 200])
def test_a_spline_is_the_one_of_gdal(count: int) -> None:
    from rasterio.control import GroundControlPoint
    from rasterio.transform import GCPTransformer

    xy, colrow = warped(count)
    at = warped(300, seed=11)[0]
    points = [GroundControlPoint(row=r, col=c, x=x, y=y, z=0.0) for (x, y), (c, r) in zip(xy, colrow, strict=True)]
    with GCPTransformer(points, tps=True) as transformer:
        rows, cols = transformer.rowcol(at[:, 0], at[:, 1], op=lambda value: value)
    found = spline_of(xy, colrow).ground_to_image(ground3(at))
    np.testing.assert_allclose(found, np.column_stack([cols, rows]), rtol=0.0, atol=1e-6)


def test_an_affine_image_stays_affine_everywhere() -> None:
    """Bending energy is 0 for an affine map, so the spline is that map, far outside its nodes too."""
    xy, _ = warped(30)
    matrix, shift = np.array([[2.1, 0.4], [0.3, -1.9]]), np.array([-1000.0, 2500.0])
    middle = xy.mean(axis=0)
    far = middle + (xy - middle) * 20.0
    model = spline_of(xy, (xy - middle) @ matrix.T + shift)
    np.testing.assert_allclose(
        model.ground_to_image(ground3(far)), (far - middle) @ matrix.T + shift, rtol=0.0, atol=1e-6
    )


def test_state_and_new_values() -> None:
    xy, colrow = warped(25)
    model = spline_of(xy, colrow)
    state = json.loads(json.dumps(model.to_dict()))
    assert len(state["nodes"]) == 25
    assert state["axes"] == "left"
    at = ground3(warped(100, seed=5)[0])
    np.testing.assert_array_equal(PlanarModel.from_dict(state).ground_to_image(at), model.ground_to_image(at))
    moved = model.with_values(model.transformation.values + np.repeat([3.0, -2.0], 25))  # the whole image shifts
    np.testing.assert_allclose(
        moved.ground_to_image(at), model.ground_to_image(at) + np.array([3.0, -2.0]), rtol=0.0, atol=1e-7
    )


@pytest.mark.parametrize("count", [150, 450])
def test_a_point_does_not_depend_on_its_company(count: int) -> None:
    xy, colrow = warped(count)
    model, at = spline_of(xy, colrow), ground3(warped(9000, seed=6)[0])
    whole = model.ground_to_image(at)
    parts = np.vstack([model.ground_to_image(part) for part in np.array_split(at, 7)])
    assert whole.tobytes() == parts.tobytes()


@pytest.mark.parametrize("clustered", [False, True])
def test_a_spline_of_many_points_is_summed_by_cells_as_it_is_point_by_point(clustered: bool) -> None:
    xy, colrow = warped(600)
    if clustered:  # a few dense patches, as of sheets that were digitised one by one
        middles = xy[:6].repeat(100, axis=0)
        xy, colrow = middles + 0.02 * (xy - middles), colrow[:6].repeat(100, axis=0) + 0.02 * (colrow - colrow.mean(0))
    model = spline_of(xy, colrow)
    rng, spread = np.random.default_rng(4), np.ptp(xy, axis=0)
    near, far = (xy.mean(axis=0) + spread * rng.uniform(-size, size, (400, 2)) for size in (0.5, 4.0))
    at = np.vstack([near, far, xy[:100], [[np.nan, 0.0], [np.inf, 0.0]]])
    own = model.transformation
    exact = spline.evaluate(own.nodes, own.fitted_spline.coefficients, own.normalised(at))
    np.testing.assert_allclose(model.ground_to_image(ground3(at)), exact, rtol=0.0, atol=3e-6)
    assert np.isnan(exact[-2:]).all()
    again = pickle.loads(pickle.dumps(model)).ground_to_image(ground3(at))
    np.testing.assert_array_equal(again, model.ground_to_image(ground3(at)))


@pytest.mark.parametrize(
    ("xy", "says"),
    [
        ([[0, 0], [9, 0], [0, 9], [9, 9], [9, 0]], "points 2 and 5 lie on one place"),
        ([[0, 0], [9, 0], [0, 9], [9, 9], [9, 1e-9]], "points 2 and 5 lie on one place"),
        ([[5e5 + k, 5e6 + 2 * k] for k in range(6)], "on a line"),
        ([[0, 0], [1, 1]], "2 control points do not determine"),
    ],
)
def test_what_determines_no_spline_is_refused(xy: list[list[float]], says: str) -> None:
    ground = np.array(xy, dtype=float)
    with pytest.raises(SolveError, match=says) as caught:
        fit_planar("tps", ground, ground * 3.0 + 1.0, where="scan 7")
    assert caught.value.where == "scan 7"
    assert caught.value.hint


def test_a_spline_by_the_plugin() -> None:
    xy, colrow = warped(10)
    points = [{"x": x, "y": y, "col": c, "row": r} for (x, y), (c, r) in zip(xy, colrow, strict=True)]
    options: dict[str, Any] = {"kind": "tps", "points": points}
    model = plugin.build(SensorRequest("scan", SIZE, options, UTM))
    np.testing.assert_allclose(model.ground_to_image(ground3(xy)), colrow, rtol=0.0, atol=1e-8)
    with pytest.raises(InputError, match="no coefficients"):
        plugin.build(SensorRequest("scan", SIZE, {"kind": "tps", "coefficients": [1, 2]}, UTM))


@dataclass(frozen=True, eq=False)
class Counting(PlanarModel):
    """A plane transformation that counts the places it is asked for."""

    asked: list[int] = field(default_factory=list)

    def ground_to_image(self, xyz: np.ndarray) -> np.ndarray:
        self.asked.append(len(xyz))
        return super().ground_to_image(xyz)


def lattices_of(model: PlanarModel, grid: Grid, tolerance: float) -> list[Lattice]:
    mapper, below = MapToImage.between(grid.crs, None, model), Ground.under(grid, None)
    return [
        lattice
        for block in blocks(grid.window)
        for lattice in build(mapper, grid, below.block(block.intersection(grid.window)), tolerance)
    ]


def error_at_pixels(model: PlanarModel, grid: Grid, lattice: Lattice) -> float:
    """Largest distance from the model over pixels that show the image: every 7th each way, and those at the edges.

    NaN are pixels that have a lattice of their own.
    """
    window, step = lattice.window, lattice.step
    cols, rows = (np.union1d(np.arange(0, size, 7), size - 1) + 0.5 for size in (window.width, window.height))
    c, r = np.meshgrid(cols, rows)
    i, j = (c // step).astype(int), (r // step).astype(int)
    u, v, nodes = (c / step - i)[..., None], (r / step - j)[..., None], lattice.nodes[..., ::4]
    above = nodes[j, i] * (1 - u) + nodes[j, i + 1] * u
    found = above * (1 - v) + (nodes[j + 1, i] * (1 - u) + nodes[j + 1, i + 1] * u) * v
    xy = grid.xy(np.stack([window.col + c, window.row + r], axis=-1).reshape(-1, 2))
    exact = model.ground_to_image(ground3(xy)).reshape(found.shape)
    shown = ((exact > 0.0) & (exact < SIZE)).all(axis=-1)
    return float(np.fmax.reduce(np.hypot(*(found - exact)[shown].T), initial=0.0))


def bent(kind: str, count: int, noise: float, order: int = 1) -> tuple[Counting, Grid]:
    """Transformation through points with errors of some pixels, and a part of its map with edges within blocks."""
    xy, colrow = warped(count)
    colrow = colrow + np.random.default_rng(8).normal(0.0, noise, colrow.shape)
    model = Counting.of(fit_planar(kind, xy, colrow, order=order), UTM, SIZE)
    left, top = np.quantile(xy[:, 0], 0.3), np.quantile(xy[:, 1], 0.7)
    return model, Grid.from_bounds(UTM, (left, top - 0.4 * 1230, left + 0.4 * 2150, top), 0.4)


@pytest.mark.parametrize("tolerance", [0.1, 0.02])
@pytest.mark.parametrize(
    ("kind", "count", "noise", "order"),
    [("tps", 150, 0.3, 1), ("tps", 40, 6.0, 1), ("tps", 9, 100.0, 1), ("polynomial", 60, 5.0, 3)],
)
def test_between_nodes_a_bent_image_stays_within_the_tolerance(
    kind: str, count: int, noise: float, order: int, tolerance: float
) -> None:
    model, grid = bent(kind, count, noise, order)
    lattices = lattices_of(model, grid, tolerance)
    assert sum(lattice.window.width * lattice.window.height for lattice in lattices) >= grid.width * grid.height
    errors = [error_at_pixels(model, grid, lattice) / max(1.0, lattice.scale) for lattice in lattices]
    assert max(errors) <= tolerance / 2
    assert all(error <= lattice.error for error, lattice in zip(errors, lattices, strict=True))


def test_a_spline_is_asked_for_few_places() -> None:
    """Close nodes are needed for its bends, but not the spline itself at all of them."""
    model, grid = bent("tps", 150, 0.3)
    model.asked.clear()
    lattices = lattices_of(model, grid, 0.02)
    places = sum(4 * lattice.nodes[..., 0].size for lattice in lattices)
    assert min(lattice.step for lattice in lattices) <= 16
    assert sum(model.asked) < 0.4 * places
