"""Accuracy rasters: the textbooks' m_O = m_DTM · r / c, and true errors of perturbed orientations and heights."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import product_rig
import pytest
import rasterio
import rpc_rig
from affine import Affine
from helpers import GROUND, Hills, PinholeOverMap
from pyproj import CRS
from spot_rig import Satellite

import geomosaic
from geomosaic.block import ControlPoint, OrientedBlock, OrientedImage, footprint
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal, parse_crs, with_heights
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block, Scene
from geomosaic.inputs.orientation_covariance import orientation, with_sigmas
from geomosaic.options.render import RenderOptions, UncertaintyOptions
from geomosaic.render.accuracy import AccuracyRaster, Uncertainties, write_accuracy
from geomosaic.sensor import registry
from geomosaic.sensor.error_propagation import InputUncertainty, ellipses
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.sensor.solve import image_to_ground
from geomosaic.surface.model import Plane, Surface

CENTRE = (500000.0, 5500000.0)


def frame(**more: object) -> SensorModel:
    """A photo 40° off the nadir."""
    options = {
        "camera": {"focal_length_px": 1000.0, "distortion": {"model": "brown", "k1": -0.02}},
        "position": [500000.0, 5499200.0, 1000.0],
        "orientation": {"system": "opk", "omega": 40.0, "phi": -5.0, "kappa": 25.0},
        "ground_height": 0.0,
        **more,
    }
    return registry.build("frame", SensorRequest("photo", (1000, 800), options, GROUND))


def made(
    folder: Path,
    model: SensorModel,
    surface: Surface | None,
    grid: Grid,
    covariance: np.ndarray | None = None,
    threads: int = 1,
    **given: object,
) -> AccuracyRaster:
    """Accuracy raster of one image that is shown everywhere on a grid."""
    shown = folder / "shown.tif"
    profile = grid.to_profile() | {"driver": "GTiff", "count": 1, "dtype": "uint8", "compress": "deflate"}
    with rasterio.open(shown, "w", **profile) as raster:
        raster.write(np.ones((1, *grid.shape), dtype=np.uint8))
    image = OrientedImage("photo", str(shown), "frame", model, covariance=covariance)
    block, render = OrientedBlock((image,), surface), RenderOptions(tolerance=0.0, threads=threads)
    known = Uncertainties.of(block, UncertaintyOptions(accuracy=True, **given), render)  # type: ignore[arg-type]
    return write_accuracy(folder / "shown-accuracy.tif", shown, block, grid, known, render, labelled=False)


def grid_about(crs: CRS, middle: tuple[float, float], size: tuple[int, int], pixel: float) -> Grid:
    left, top = middle[0] - size[0] * pixel / 2, middle[1] + size[1] * pixel / 2
    return Grid(horizontal(crs), Affine(pixel, 0.0, left, 0.0, -pixel, top), *size)


def cells(raster: AccuracyRaster, every: int) -> tuple[np.ndarray, np.ndarray]:
    """Places (N, 2) of some cells and their values (N, 5)."""
    values = np.moveaxis(raster.read().filled(np.nan), 0, -1)
    rows, cols = np.mgrid[every // 2 : values.shape[0] : every, every // 2 : values.shape[1] : every]
    places = raster.grid.xy(np.column_stack([cols.ravel() + 0.5, rows.ravel() + 0.5]))
    return places, values[rows.ravel(), cols.ravel()]


def test_heights_move_a_vertical_photo_by_the_textbooks_formula(tmp_path: Path) -> None:
    """m_O = m_DTM · r / c along the radius, nothing across it."""
    model = PinholeOverMap(tilt=(0.0, 0.0, 0.0), size=(2200, 2200))
    grid = grid_about(GROUND, CENTRE, (2000, 1600), 1.0)
    raster = made(tmp_path, model, Plane(GROUND, 0.0), grid, sigma_dem=2.0)
    assert raster.grid.resolution == (8.0, 8.0)
    places, values = cells(raster, 7)
    x, y = (places - CENTRE).T
    np.testing.assert_allclose(values[:, 0], 2.0 * np.abs(x) / 1000.0, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(values[:, 1], 2.0 * np.abs(y) / 1000.0, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(np.hypot(values[:, 0], values[:, 1]), 2.0 * np.hypot(x, y) / 1000.0, rtol=1e-5)
    np.testing.assert_allclose(values[:, 2], np.sign(x * y), atol=1e-5)  # all of it along one line
    np.testing.assert_allclose(values[:, 3], 2.0 * np.hypot(x, y) / 1000.0, rtol=1e-5)
    np.testing.assert_allclose(values[:, 4], 0.0, atol=1e-6)
    assert raster.parts == ("heights", "interpolation")
    assert any("orientation takes no part" in note for note in raster.notes)


@dataclass(frozen=True)
class Slope(Hills):
    """A plane that falls to the north-east by 30°."""

    def height(self, xy: np.ndarray) -> np.ndarray:
        return -np.tan(np.radians(30.0)) * (xy - CENTRE).sum(axis=1) / np.sqrt(2.0)

    @property
    def range(self) -> tuple[float, float]:
        return -1000.0, 1000.0


@dataclass(frozen=True)
class Wrong:
    """A surface whose heights are wrong: everywhere by the same, or by a field that changes from place to place."""

    surface: Surface
    by: float
    waves: np.ndarray | None = None

    @property
    def crs(self) -> CRS:
        return self.surface.crs

    @property
    def spacing(self) -> float:
        return 5.0

    @property
    def range(self) -> tuple[float, float]:
        low, high = self.surface.range
        return low - 6 * abs(self.by) - 1.0, high + 6 * abs(self.by) + 1.0

    def height(self, xy: np.ndarray) -> np.ndarray:
        field: float | np.ndarray = 1.0
        if self.waves is not None:  # of unit variance: sums of many waves are nearly normal
            phase = (xy - CENTRE) @ self.waves[:2] + self.waves[2]
            field = np.sqrt(2.0 / self.waves.shape[1]) * np.cos(phase).sum(axis=1)
        return self.surface.height(xy) + self.by * field


def share_within(
    raster: AccuracyRaster,
    model: SensorModel,
    surface: Surface,
    certainty: InputUncertainty,
    trials: int,
    field: bool = False,
) -> float:
    """Share of true errors, along x and y, that the raster's standard deviations hold."""
    rng = np.random.default_rng(20)
    places, values = cells(raster, max(1, raster.grid.width // 5))
    seen = np.isfinite(values[:, 0])
    places, values = places[seen], values[seen]
    xyz = np.column_stack([places, surface.height(places)])
    image = model.ground_to_image(Transform(surface.crs, model.crs)(xyz))
    inside = ((image > 0) & (image < model.size)).all(axis=1)
    xyz, image, sigma = xyz[inside], image[inside], values[inside, :2]
    assert len(xyz) > 8
    assert isinstance(certainty.height, float)
    root = np.linalg.cholesky(certainty.orientation + 1e-30 * np.eye(len(certainty.orientation)))
    held = []
    for _ in range(trials):
        noisy = model.with_values(model.parameters.values + root @ rng.normal(size=len(root)))
        waves = None
        if field:
            waves = np.vstack([rng.normal(0.0, 0.004, (2, 30)), rng.uniform(0.0, 2 * np.pi, (1, 30))])
        by = certainty.height * (1.0 if field else rng.normal())
        level = isinstance(surface, Plane)
        ground = replace(surface, z=surface.z + by) if level and not field else Wrong(surface, by, waves)
        found = image_to_ground(noisy, image, ground)
        held.append(np.abs(found[:, :2] - xyz[:, :2]) <= sigma)
    return float(np.mean(held))


CORRELATED = np.random.default_rng(5).normal(size=(6, 6)) * 0.5 + 2.0 * np.eye(6)
ROOT = np.diag([0.1, 0.1, 0.15, 0.006, 0.006, 0.01]) @ CORRELATED / 2.0


def share_of_photo(folder: Path, surface: Surface, field: bool, trials: int) -> float:
    model, covariance = frame(), ROOT @ ROOT.T
    grid = grid_about(GROUND, CENTRE, (900, 900), 1.0)
    raster = made(folder, model, surface, grid, covariance, sigma_dem=0.4, accuracy_step=2)
    return share_within(raster, model, surface, InputUncertainty(None, 0.4, covariance), trials, field)


SURFACES = {"hills": Hills(amplitude=40.0), "slope of 30 degrees": Slope()}


@pytest.mark.parametrize(("surface", "field"), [("hills", True), ("slope of 30 degrees", False)])
def test_standard_deviations_hold_as_many_true_errors_as_they_should(tmp_path: Path, surface: str, field: bool) -> None:
    assert 0.64 <= share_of_photo(tmp_path, SURFACES[surface], field, 100) <= 0.72


@pytest.mark.slow
@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("field", [False, True], ids=["shifted", "rough"])
def test_standard_deviations_hold_true_errors_in_many_trials(tmp_path: Path, surface: str, field: bool) -> None:
    assert 0.65 <= share_of_photo(tmp_path, SURFACES[surface], field, 1000) <= 0.71


def satellite(folder: Path) -> tuple[SensorModel, CRS]:
    (folder / "METADATA.DIM").write_text(Satellite().dimap())
    request = SensorRequest("scene", (3000, 3000), {"metadata": "METADATA.DIM"}, None, str(folder))
    return registry.build("pushbroom", request), with_heights(parse_crs("EPSG:32624"), "ellipsoidal")


def test_standard_deviations_of_a_scanner_in_orbit_hold_true_errors(tmp_path: Path) -> None:
    model, crs = satellite(tmp_path)
    _, covariance, note = orientation(model, {})
    assert "a-priori" in note
    x, y, _ = Transform(model.crs, crs)(np.array([model.seed]))[0]
    grid, surface = grid_about(crs, (x, y), (1600, 1600), 20.0), Plane(crs, 300.0)
    raster = made(tmp_path, model, surface, grid, covariance, sigma_dem=10.0)
    share = share_within(raster, model, surface, InputUncertainty(None, 10.0, covariance), 120)
    assert 0.64 <= share <= 0.72
    assert raster.plan > 10.0


def test_errors_that_a_file_of_rpcs_states_are_errors_on_the_ground(tmp_path: Path) -> None:
    """3 and 4 m along each axis make 5 m on level ground, whatever the scale of the image."""
    model = rpc_rig.model("none")
    model = replace(model, rpc=replace(model.rpc, errors=(3.0, 4.0)))
    lon, _, height = model.seed
    crs = with_heights(parse_crs(f"EPSG:{32601 + int((lon + 180.0) // 6)}"), "ellipsoidal")
    middle = Transform(model.crs, crs)(np.array([model.seed]))[0]
    _, covariance, note = orientation(model, {})
    assert "states" in note
    assert covariance is not None
    grid, level = grid_about(crs, (middle[0], middle[1]), (800, 800), 5.0), Plane(crs, height)
    raster = made(tmp_path, model, level, grid, covariance, sigma_dem=5.0)
    share = share_within(raster, model, level, InputUncertainty(None, 5.0, covariance), 150)
    assert 0.62 <= share <= 0.74  # two parameters: no more than two independent errors a trial
    alone = ellipses(model, level, crs, middle[None], InputUncertainty(None, None, covariance))
    np.testing.assert_allclose(alone.semi_axes, 5.0, rtol=2e-3)  # metres of the map are not quite those of the ground


def test_beyond_its_control_a_photo_is_less_accurate_as_true_errors_show(tmp_path: Path) -> None:
    """Points in the middle ninth of a photo, measured again and again: the raster is right at its edges, too."""
    model, level = frame(), Plane(GROUND, 0.0)
    rng = np.random.default_rng(8)
    image = rng.uniform([330.0, 260.0], [670.0, 540.0], (25, 2))
    ground = image_to_ground(model, image, Hills(amplitude=40.0))

    def measured() -> tuple[SensorModel, np.ndarray]:
        noisy = image + rng.normal(0.0, 0.5, image.shape)
        points = [
            ControlPoint(str(i), tuple(xyz), "photo", tuple(place), sigma_px=0.5)
            for i, (xyz, place) in enumerate(zip(ground.tolist(), noisy.tolist(), strict=True))
        ]
        found, covariance, _ = orientation(model, {}, points, GROUND)
        assert covariance is not None
        return found, covariance

    _, covariance = measured()
    grid = grid_about(GROUND, CENTRE, (800, 800), 1.0)
    raster = made(tmp_path, model, level, grid, covariance, accuracy_step=2)
    places, values = cells(raster, 99)
    pixel = model.ground_to_image(Transform(GROUND, model.crs)(np.column_stack([places, np.zeros(len(places))])))
    inside = ((pixel > 0) & (pixel < model.size)).all(axis=1)
    places, values, pixel = places[inside], values[inside], pixel[inside]
    middle = ((pixel > (330, 260)) & (pixel < (670, 540))).all(axis=1)
    plan = np.hypot(values[:, 0], values[:, 1])
    assert plan[~middle].max() > 2.0 * plan[middle].mean()
    held = []
    for _ in range(60):
        found, _ = measured()
        held.append(np.abs(image_to_ground(found, pixel, level)[:, :2] - places) <= values[:, :2])
    assert 0.6 <= np.mean(held) <= 0.76


def test_between_its_nodes_the_raster_is_that_of_exact_propagation(tmp_path: Path) -> None:
    """Over relief of a tenth of the flying height, and of three quarters on one slope."""
    model, covariance, grid = frame(), ROOT @ ROOT.T, grid_about(GROUND, CENTRE, (900, 900), 1.0)
    for surface, within in ((Hills(amplitude=50.0), 0.01), (Slope(), 0.002)):
        raster = made(tmp_path, model, surface, grid, covariance, sigma_dem=0.4, sigma_px=0.3, accuracy_step=1)
        raster.path.rename(tmp_path / "done.tif")
        raster = replace(raster, path=tmp_path / "done.tif")
        places, values = cells(raster, 37)
        xyz = np.column_stack([places, surface.height(places)])
        exact = ellipses(model, surface, GROUND, xyz, InputUncertainty(0.3, 0.4, covariance)).covariance
        deviations = np.sqrt(exact[:, [0, 1], [0, 1]])
        error = np.abs(values[:, :2] / deviations - 1.0)
        assert error.max() < within
        np.testing.assert_allclose(values[:, 2], exact[:, 0, 1] / deviations.prod(axis=1), atol=within)
        away = places - (500000.0, 5499200.0)  # from straight below the camera
        along = away / np.linalg.norm(away, axis=1)[:, None]
        for band, view in ((3, along), (4, along[:, ::-1] * [1.0, -1.0])):
            expected = np.sqrt(np.einsum("ni,nij,nj->n", view, exact[:, :2, :2], view))
            np.testing.assert_allclose(values[:, band], expected, rtol=within)


def test_a_raster_of_height_errors_counts_at_each_place(tmp_path: Path) -> None:
    model = PinholeOverMap(tilt=(0.0, 0.0, 0.0), size=(2200, 2200))
    grid = grid_about(GROUND, CENTRE, (800, 800), 1.0)
    half = np.where(np.arange(100) < 50, 1.0, 3.0)
    profile = {"driver": "GTiff", "width": 100, "height": 80, "count": 1, "dtype": "float32", "crs": "EPSG:32633"}
    place = Affine(10.0, 0.0, CENTRE[0] - 500.0, 0.0, -10.0, CENTRE[1] + 400.0)
    sigmas = tmp_path / "sigma.tif"
    with rasterio.open(sigmas, "w", **profile, transform=place) as raster:
        raster.write(np.broadcast_to(half, (1, 80, 100)).astype(np.float32))
    flat = Plane(GROUND, 0.0)
    found = made(tmp_path, model, flat, grid, sigma_dem=sigmas)
    places, values = cells(found, 9)
    x = places[:, 0] - CENTRE[0]
    clear = np.abs(x) > 20.0
    expected = np.where(x < 0.0, 1.0, 3.0) * np.abs(x) / 1000.0
    np.testing.assert_allclose(values[clear, 0], expected[clear], rtol=1e-4)
    with rasterio.open(sigmas, "r+") as raster:
        raster.write(np.full((1, 80, 100), -1.0, dtype=np.float32))
    found.path.unlink()
    with pytest.raises(InputError, match="negative"):
        made(tmp_path, model, flat, grid, sigma_dem=sigmas)


def test_places_beyond_the_raster_of_height_errors_are_told(tmp_path: Path) -> None:
    model, grid = PinholeOverMap(tilt=(0.0, 0.0, 0.0), size=(2200, 2200)), grid_about(GROUND, CENTRE, (800, 800), 1.0)
    profile = grid_about(GROUND, (CENTRE[0] - 298.0, CENTRE[1]), (400, 800), 1.0).to_profile()
    with rasterio.open(tmp_path / "s.tif", "w", **profile, driver="GTiff", count=1, dtype="float32") as raster:
        raster.write(np.ones((1, 800, 400), dtype=np.float32))
    found = made(tmp_path, model, Plane(GROUND, 0.0), grid, sigma_dem=tmp_path / "s.tif")
    assert found.cells == 38 * 100  # columns of 8 m up to 98 m west of the middle
    assert any(note.startswith("62 % of the area has no known accuracy") for note in found.notes)


def test_nothing_known_is_no_accuracy(tmp_path: Path) -> None:
    grid = grid_about(GROUND, CENTRE, (100, 100), 1.0)
    with pytest.raises(InputError, match="nothing says how accurate"):
        made(tmp_path, frame(), Plane(GROUND, 0.0), grid)


def test_cells_without_image_or_height_hold_nothing(tmp_path: Path) -> None:
    model = frame()
    outline = footprint(OrientedImage("photo", "", "frame", model), Plane(GROUND, 0.0), GROUND)
    assert outline.complete
    grid = grid_about(GROUND, CENTRE, (64, 64), 1.0)
    raster = made(tmp_path, model, Plane(GROUND, 0.0), grid, ROOT @ ROOT.T)
    assert np.isfinite(raster.read(Window(0, 0, 4, 4)).filled(np.nan)).all()


def test_the_raster_does_not_depend_on_threads(tmp_path: Path) -> None:
    grid, files = grid_about(GROUND, CENTRE, (620, 530), 1.0), []
    for threads in (1, 3):
        (folder := tmp_path / str(threads)).mkdir()
        made(folder, frame(), Hills(), grid, ROOT @ ROOT.T, threads=threads, sigma_dem=0.5, accuracy_step=1)
        files.append((folder / "shown-accuracy.tif").read_bytes())
    assert files[0] == files[1]


def test_standard_deviations_of_the_interior_orientation_count(tmp_path: Path) -> None:
    """A focal length 1 % too long draws a vertical photo together by 1 % of the distance from its middle."""
    model = frame(position=[*CENTRE, 1000.0], orientation={"system": "opk", "omega": 0.0, "phi": 0.0, "kappa": 0.0},
                  camera={"focal_length_px": 1000.0}, treatment="planar")  # fmt: skip
    interior = model.interior
    sigmas = np.where(np.array(interior.names) == interior.names[0], 0.01 * interior.values[0], 0.0)
    model = model.with_interior(replace(interior, sigmas=sigmas))
    known = {"east": 0.0, "north": 0.0, "up": 0.0, "omega": 0.0, "phi": 0.0, "kappa": 0.0}
    image = with_sigmas(OrientedImage("photo", "", "frame", model), known)
    assert "interior" in image.known_by
    grid = grid_about(GROUND, CENTRE, (600, 600), 1.0)
    places, values = cells(made(tmp_path, model, Plane(GROUND, 0.0), grid, image.covariance), 7)
    # Between nodes 38 m apart a square of the distance is too large by up to a quarter of the square of 38 m.
    expected = (0.01 * (places - CENTRE)) ** 2
    assert ((values[:, :2] ** 2 - expected > -1e-4) & (values[:, :2] ** 2 - expected < 0.38**2 / 4)).all()
    assert expected.max() > 100 * 0.38**2 / 4


def test_an_ortho_and_a_mosaic_bring_their_accuracy_with_them(tmp_path: Path) -> None:
    (tmp_path / "camera.toml").write_text("size = [200, 160]\nfocal_length_px = 200.0\n")
    rows = ["image,x,y,z,omega,phi,kappa"]
    for number in range(2):
        product_rig.write(tmp_path / f"p{number}.tif", np.full((160, 200, 1), 90, dtype=np.uint8))
        rows.append(f"p{number}.tif,{CENTRE[0] + 100.0 * number},{CENTRE[1]},200,0,0,0")
    (tmp_path / "exterior.csv").write_text("\n".join(rows))
    shared = {
        "camera": tmp_path / "camera.toml", "exterior": tmp_path / "exterior.csv", "crs": "EPSG:32633",
        "heights": "ellipsoidal", "height": 0.0, "options": {"treatment": "planar"},
    }  # fmt: skip
    files = tuple(tmp_path / f"p{number}.tif" for number in range(2))
    scene, block = Scene(files[:1], "frame", **shared), Block(files, "frame", **shared)  # type: ignore[arg-type]
    made = geomosaic.ortho(scene, tmp_path / "o.tif", accuracy=True, sigma_dem=1.0, accuracy_step=2)
    assert made.accuracy is not None
    assert made.accuracy.path == tmp_path / "o-accuracy.tif"
    seen = np.ma.getmaskarray(made.read())[0, 1::2, 1::2]
    values = made.accuracy.read()
    assert (np.ma.getmaskarray(values)[0][:-1, :-1] == seen[: values.shape[1] - 1, : values.shape[2] - 1]).all()
    assert made.accuracy.quantiles[1.0] == pytest.approx(np.hypot(0.5, 0.4), abs=0.02)  # r / c at the corners
    target = tmp_path / "target.toml"
    target.write_text("position_error = 0.2\n")
    both = geomosaic.mosaic(
        block, tmp_path / "m.tif", accuracy=True, sigma_dem=1.0, accuracy_step=1, resolution=1.0, balance=False,
        accuracy_target=target, sigmas=dict.fromkeys(("east", "north", "up", "omega", "phi", "kappa"), 0.0),
    )  # fmt: skip
    assert both.accuracy is not None
    assert both.accuracy.target == 0.2
    with rasterio.open(tmp_path / "m-accuracy.tif") as raster, rasterio.open(tmp_path / "m-labels.tif") as labels:
        sigma, label = raster.read(1), labels.read(1)
        x = (raster.transform @ (np.arange(raster.width) + 0.5, np.zeros(raster.width)))[0] - CENTRE[0]
        assert raster.units[:2] == ("m", "m")
    assert {1, 2} <= set(np.unique(label).tolist())
    nearest = np.abs(x - 100.0 * (label - 1.0)) / 200.0
    np.testing.assert_allclose(sigma[label > 0], np.hypot(nearest, 0.02 / np.sqrt(3.0))[label > 0], atol=2e-3)


def test_standard_deviations_that_would_do_nothing_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="without `accuracy`"):
        geomosaic.ortho("a.tif", tmp_path / "o.tif", sigma_dem=1.0)
    with pytest.raises(InputError, match="no option is named `accuracy`"):
        geomosaic.reproject("a.tif", tmp_path / "o.tif", dst_crs="EPSG:32633", accuracy=True)
    grid = grid_about(GROUND, CENTRE, (100, 100), 1.0)
    with pytest.raises(InputError, match="use no heights"):
        made(tmp_path, frame(), None, grid, sigma_dem=1.0)
