"""Monoplotting: known ground and pixels both ways, errors against trials, hidden ground against a formula."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import shapely
from helpers import GROUND, Hills, PinholeOverMap
from pyproj import CRS
from spot_rig import Satellite

from geomosaic.block import ControlPoint
from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import geographic, has_heights, height_name, parse_crs, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.inputs.orientation_covariance import orientation
from geomosaic.monoplotting.line_drawing import OCCLUDED, VISIBLE, View, draw, trace
from geomosaic.monoplotting.places import ground_crs, locate
from geomosaic.sensor import registry
from geomosaic.sensor.error_propagation import InputUncertainty, ellipses
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.surface.model import Plane
from geomosaic_rpc import fit_rpc

SIZE = (1000, 800)
WIDE = (498000.0, 5498000.0, 502000.0, 5502000.0)


def frame(**more: object) -> SensorModel:
    options = {
        "camera": {"focal_length_px": 1000.0, "distortion": {"model": "brown", "k1": -0.02}},
        "position": [500000.0, 5500000.0, 1000.0],
        "orientation": {"system": "opk", "omega": 8.0, "phi": -5.0, "kappa": 25.0},
        "ground_height": 0.0,
        **more,
    }
    return registry.build("frame", SensorRequest("photo", SIZE, options, GROUND))


def spot(tmp_path_factory: pytest.TempPathFactory) -> tuple[SensorModel, CRS]:
    folder = tmp_path_factory.mktemp("spot")
    (folder / "METADATA.DIM").write_text(Satellite().dimap())
    request = SensorRequest("scene", (3000, 3000), {"metadata": "METADATA.DIM"}, None, str(folder))
    return registry.build("pushbroom", request), with_heights(parse_crs("EPSG:32624"), "ellipsoidal")


@dataclass(frozen=True)
class Around(Hills):
    """The same hills about another place."""

    middle: tuple[float, float] = (0.0, 0.0)

    def height(self, xy: np.ndarray) -> np.ndarray:
        return super().height(xy - np.array(self.middle) + [500000.0, 5500000.0])


@pytest.fixture(scope="module", params=["frame", "rpc", "pushbroom"])
def seen(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[SensorModel, Hills]:
    """A sensor over analytic hills."""
    if request.param == "pushbroom":
        model, crs = spot(tmp_path_factory)
        x, y, _ = Transform(model.crs, crs)(np.array([model.seed]))[0]
        return model, Around(crs, 300.0, 20_000.0, 50.0, (x, y))
    model = frame()
    return (model if request.param == "frame" else fit_rpc(model, (-70.0, 70.0)).model), Hills()


def test_known_ground_and_pixels_both_ways(seen: tuple[SensorModel, Hills]) -> None:
    """Ground of a formula, seen by the sensor, is found again; and drawn where it is seen."""
    model, hills = seen
    image = np.random.default_rng(1).uniform([0, 0], model.size, (100, 2))
    found = locate(model, hills, image, hills.crs, InputUncertainty())
    assert found.seen.all()
    assert np.abs(hills.height(found.xyz[:, :2]) - found.xyz[:, 2]).max() < 1e-5
    back = model.ground_to_image(Transform(hills.crs, model.crs)(found.xyz))
    assert np.abs(back - image).max() < 1e-6
    drawn, state = View.of(model, hills, hills.crs).drape_to_image(found.xyz[:, :2])
    assert (state == VISIBLE).all()
    assert np.abs(drawn - image).max() < 1e-6 * (1.0 if model.size == SIZE else 10.0)


def test_places_in_another_crs_and_datum(seen: tuple[SensorModel, Hills]) -> None:
    model, hills = seen
    image = np.array([[300.5, 400.5]])
    own = locate(model, hills, image, hills.crs, InputUncertainty(pixel=0.5))
    lonlat = with_heights(geographic(hills.crs), "egm96")
    other = locate(model, hills, image, lonlat, InputUncertainty(pixel=0.5))
    assert np.allclose(other.xyz, Transform(hills.crs, lonlat)(own.xyz), atol=1e-9)
    assert abs(other.xyz[0, 2] - own.xyz[0, 2]) > 10.0
    # Metres along east and north against metres of the map: its scale is 0.9996 or so, its north turned by little.
    assert np.allclose(other.ellipses.semi_axes, own.ellipses.semi_axes, rtol=2e-3)
    assert np.isnan(locate(model, hills, image, hills.crs, InputUncertainty()).ellipses.semi_axes).all()


def trials(
    model: SensorModel, hills: Hills, image: np.ndarray, certainty: InputUncertainty, count: int, seed: int
) -> np.ndarray:
    """Places (count, 3) of one image point with errors in everything."""
    rng = np.random.default_rng(seed)
    assert certainty.pixel is not None
    assert certainty.height is not None
    assert certainty.orientation is not None
    root = np.linalg.cholesky(certainty.orientation)
    out = []
    for _ in range(count):
        noisy = model.with_values(model.parameters.values + root @ rng.normal(size=len(root)))
        lifted = Raised(hills, certainty.height * rng.normal())
        out.append(
            locate(noisy, lifted, image + certainty.pixel * rng.normal(size=2), hills.crs, InputUncertainty()).xyz[0]
        )
    return np.array(out)


@dataclass(frozen=True)
class Raised:
    """Hills that are wrong by a constant."""

    hills: Hills
    by: float

    @property
    def crs(self) -> CRS:
        return self.hills.crs

    @property
    def range(self) -> tuple[float, float]:
        return self.hills.range[0] + self.by, self.hills.range[1] + self.by

    @property
    def spacing(self) -> float:
        return self.hills.spacing

    def height(self, xy: np.ndarray) -> np.ndarray:
        return self.hills.height(xy) + self.by


def scatter_against_ellipse(count: int, places: np.ndarray, within: float) -> None:
    model, hills = frame(), Hills(amplitude=40.0)
    # Angles and positions that depend on each other, as they do after an adjustment.
    mixed = np.random.default_rng(5).normal(size=(6, 6)) * 0.5 + 2.0 * np.eye(6)
    root = np.diag([0.05, 0.05, 0.08, 0.003, 0.003, 0.01]) @ mixed / 2.0
    certainty = InputUncertainty(0.4, 0.5, root @ root.T)
    for k, image in enumerate(places):
        found = locate(model, hills, image[None], hills.crs, certainty)
        noisy = trials(model, hills, image[None], certainty, count, 10 + k)
        told, shown = found.ellipses.covariance[0], np.cov(noisy.T)
        assert np.allclose(noisy.mean(axis=0), found.xyz[0], atol=6 * np.sqrt(np.diag(told).max() / count))
        axes = np.sqrt(np.linalg.eigvalsh(shown[:2, :2]))[::-1]
        assert np.allclose(axes, found.ellipses.semi_axes[0], rtol=within)
        assert np.isclose(np.sqrt(shown[2, 2]), found.ellipses.sigma_z[0], rtol=within)
        # Whitened by what is told, the trials scatter like the unit ball.
        white = np.linalg.inv(np.linalg.cholesky(told[:2, :2]))
        assert np.allclose(white @ shown[:2, :2] @ white.T, np.eye(2), atol=2 * within)


def test_the_ellipse_is_the_scatter_of_trials() -> None:
    scatter_against_ellipse(400, np.array([[120.0, 700.0]]), 0.10)


@pytest.mark.slow
def test_the_ellipse_is_the_scatter_of_trials_everywhere() -> None:
    scatter_against_ellipse(3000, np.array([[120.0, 700.0], [850.0, 100.0], [510.0, 390.0], [950.0, 760.0]]), 0.05)


def test_an_ellipse_that_can_be_drawn_by_hand() -> None:
    """Straight down, 1 m per pixel: a circle; a wrong height pushes a point at 45° out by as much."""
    model = PinholeOverMap(tilt=(0.0, 0.0, 0.0), size=(2200, 2200))
    flat = Plane(GROUND, 0.0)
    ground = locate(model, flat, np.array([[2100.0, 1100.0], [1100.0, 100.0]]), GROUND, InputUncertainty()).xyz
    assert np.allclose(ground[:, :2], [[501000.0, 5500000.0], [500000.0, 5501000.0]])
    circle = ellipses(model, flat, GROUND, ground, InputUncertainty(pixel=0.5))
    assert np.allclose(circle.semi_axes, 0.5)
    assert np.allclose(circle.sigma_z, 0.0)
    out = ellipses(model, flat, GROUND, ground, InputUncertainty(pixel=0.5, height=2.0))
    assert np.allclose(out.semi_axes, [[np.hypot(2.0, 0.5), 0.5]] * 2)
    assert np.allclose(out.azimuth, [90.0, 0.0])
    assert np.allclose(out.sigma_z, 2.0)
    # Control as good as nothing else: the sigma of a camera's place moves the ground with it.
    camera = ellipses(model, flat, GROUND, ground, InputUncertainty(orientation=np.diag([3.0, 1.0, 0.0]) ** 2))
    assert np.allclose(camera.semi_axes, [[3.0, 1.0]] * 2)
    assert np.allclose(camera.azimuth, 90.0)


def test_where_the_orientation_comes_from() -> None:
    model = frame()
    names = model.parameters.names
    same, covariance, note = orientation(model, {})
    assert same is model
    assert covariance is None
    assert "takes no part" in note
    known = frame(sigmas={"position": 0.1, "angles": 0.01})
    _, covariance, _ = orientation(known, {})
    assert covariance is not None
    assert np.allclose(np.sqrt(np.diag(covariance)), [0.1] * 3 + [0.01] * 3)
    with pytest.raises(InputError, match=names[1]):
        orientation(model, {names[0]: 0.1})
    held = frame(sigmas=dict.fromkeys(("position", "angles"), 0.0))
    assert orientation(held, {})[1] is None  # held in adjustments: nobody says that it is exact
    with pytest.raises(InputError, match="no parameter 'omge'"):
        orientation(model, {"omge": 0.1})


def test_control_points_tell_how_good_the_orientation_is() -> None:
    """The covariance of the adjustment; one point that is wrong by 300 pixels does not count."""
    model, rng = frame(), np.random.default_rng(3)
    image = rng.uniform([0, 0], SIZE, (25, 2))
    ground = locate(model, Hills(), image, GROUND, InputUncertainty()).xyz
    noisy = image + rng.normal(0, 0.5, image.shape)

    def points(shift: float) -> list[ControlPoint]:
        moved = noisy + np.eye(25, 1) * shift
        return [
            ControlPoint(str(i), tuple(xyz), "photo", tuple(place), sigma_px=0.5)
            for i, (xyz, place) in enumerate(zip(ground.tolist(), moved.tolist(), strict=True))
        ]

    _, good, _ = orientation(model, {}, points(0.0)[1:], GROUND)
    _, robust, note = orientation(model, {}, points(300.0), GROUND)
    assert good is not None
    assert robust is not None
    assert np.allclose(good, robust)
    assert "24 points, 1 left out" in note or "24 control points, 1 left out" in note
    error = locate(model, Hills(), np.array([[500.0, 400.0]]), GROUND, InputUncertainty(orientation=good)).ellipses
    assert 0.03 < error.semi_axes[0, 1] <= error.semi_axes[0, 0] < 0.5  # 0.5 m over the root of a few points
    # A table of orientations that is 20 m off: the places are those of the adjusted photo.
    wrong = model.with_values(model.parameters.values + np.array([20.0, -15.0, 10.0, 0.5, 0.3, -0.2]))
    adjusted, again, _ = orientation(wrong, {}, points(300.0), GROUND)
    assert again is not None
    assert np.allclose(again, good, rtol=1e-3)
    place = [locate(m, Hills(), image[5:6], GROUND, InputUncertainty()).xyz[0] for m in (model, wrong, adjusted)]
    assert np.linalg.norm(place[1] - place[0]) > 10.0
    assert np.linalg.norm(place[2] - place[0]) < 1.0


@dataclass(frozen=True)
class Wall:
    """Level ground with a step down of 100 m at x = 500000, its wall 0.01 m wide."""

    crs: CRS = GROUND
    spacing: float = 0.05  # a search in steps of half of it may pass over what a ray only grazes

    @property
    def range(self) -> tuple[float, float]:
        return 0.0, 100.0

    def height(self, xy: np.ndarray) -> np.ndarray:
        return np.clip(100.0 - (xy[:, 0] - 500000.0) * 1e4, 0.0, 100.0)


def test_hidden_ground_against_a_formula() -> None:
    """A camera 400 m west of a wall of 100 m, 500 m up: ground is hidden for 400 · 100 / (500 − 100) = 100 m."""
    model = PinholeOverMap(size=(1600, 1200), centre=(499600.0, 5500000.0, 500.0), focal=500.0, tilt=(0.0, 0.0, 0.0))
    view = View.of(model, Wall(), GROUND)
    line = shapely.LineString([(499500.0, 5500050.0), (500300.0, 5500050.0)])
    pieces = trace(view, np.array(line.coords))
    assert [state for _, state in pieces] == [VISIBLE, OCCLUDED, VISIBLE]
    # Where the hidden piece ends, and the next begins: x = 500100 at height 0.
    end = (100.0 + 400.0) * 500.0 / 500.0 + 800.0
    assert pieces[1][0][-1, 0] == pytest.approx(end, abs=0.05)
    assert pieces[2][0][0, 0] == pytest.approx(end, abs=0.05)
    assert pieces[0][0][-1, 0] == pytest.approx(400.0 * 500.0 / 400.0 + 800.0, abs=0.05)
    left_out = draw(view, [line], WIDE, hidden=False)
    marked = draw(view, [line], WIDE, hidden=True)
    assert left_out.hidden == [False, False]
    assert marked.hidden == [False, True, False]
    inside = shapely.Point(500050.0, 5500000.0), shapely.Point(500150.0, 5500000.0)
    assert draw(view, inside, WIDE, hidden=True).hidden == [True, False]
    # A field that reaches into the hidden strip becomes what is seen of its outline; one outside stays a field.
    fields = [shapely.box(500050, 5499990, 500160, 5500010), shapely.box(500120, 5499990, 500160, 5500010)]
    kinds = draw(view, fields, WIDE, hidden=False)
    assert kinds.geometries[-1].geom_type == "Polygon"
    assert {g.geom_type for g, f in zip(kinds.geometries, kinds.feature, strict=True) if f == 0} == {"LineString"}


def test_hidden_ground_against_the_terrain_itself() -> None:
    """Over hills seen aslant: the straight line to the camera is walked through in small steps."""
    model = PinholeOverMap(size=(1000, 800), centre=(500000.0, 5499000.0, 420.0), tilt=(1.2, 0.0, 0.0), focal=900.0)
    hills = Hills(amplitude=80.0, wavelength=400.0)
    rng = np.random.default_rng(7)
    xy = rng.uniform([499700.0, 5499300.0], [500300.0, 5501500.0], (1500, 2))
    view = View.of(model, hills, GROUND)
    image, state = view.drape_to_image(xy)
    inside = view.within(image) & np.isfinite(image).all(axis=1)
    ground = np.column_stack([xy, hills.height(xy)])[inside]
    share = np.linspace(0.003, 1.0, 4000)
    walk = ground[:, None] + share[None, :, None] * (np.array(model.centre) - ground[:, None])
    clear = walk[..., 2] - hills.height(walk.reshape(-1, 3)[:, :2]).reshape(walk.shape[:2])
    lowest = clear.min(axis=1)
    sure = np.abs(lowest) > 0.5  # metres; a line that grazes is neither
    assert inside.sum() > 400
    hidden = state[inside] == OCCLUDED
    assert 0.1 < hidden.mean() < 0.9
    assert np.array_equal(hidden[sure & (lowest < 0)], np.ones((sure & (lowest < 0)).sum(), bool))
    assert (hidden[sure & (lowest > 0)]).sum() <= 0


def test_long_lines_follow_the_ground() -> None:
    """Two vertices, and between them a line that bends with hills, lens and map: each of its points lies on it."""
    model, hills = frame(), Hills()
    view = View.of(model, hills, GROUND)
    line = shapely.LineString([(499000.0, 5500100.0), (501000.0, 5500150.0)])
    (drawn,) = draw(view, [line], WIDE, hidden=False).geometries
    coords = np.array(drawn.coords)
    assert coords.min() >= 0.0
    assert (coords <= SIZE).all()
    assert len(coords) > 20
    xs = np.linspace(499000, 501000, 20001)
    truth = view.image(view.ground(np.column_stack([xs, 5500100.0 + (xs - 499000.0) * 0.025])))
    truth = truth[((truth > 0) & (truth < SIZE)).all(axis=1)]
    away = np.array([drawn.distance(point) for point in shapely.points(truth[::20])])
    assert away.max() < 0.05
    assert np.abs(coords[[0, -1]] - np.clip(coords[[0, -1]], 0, SIZE)).max() == 0.0
    straight = shapely.LineString([coords[0], coords[-1]])
    assert max(straight.distance(shapely.Point(c)) for c in coords) > 3.0


def test_vectors_beyond_the_photo_and_the_sky() -> None:
    """What lies behind an oblique camera, above its horizon or off the heights is not drawn; a field around all is."""
    model = PinholeOverMap(size=(1000, 800), centre=(500000.0, 5499000.0, 420.0), tilt=(1.2, 0.0, 0.0), focal=900.0)
    view = View.of(model, Plane(GROUND, 0.0), GROUND)
    behind = shapely.LineString([(499900.0, 5498000.0), (500100.0, 5498000.0)])
    through = shapely.LineString([(500000.0, 5498000.0), (500000.0, 5501000.0)])
    around = shapely.box(499000, 5499200, 501000, 5503000)
    drawn = draw(
        view, [behind, through, around, None, shapely.Point()], (490000, 5490000, 510000, 5510000), hidden=False
    )
    assert 0 not in drawn.feature
    assert {1, 2} == set(drawn.feature)
    (line,) = [g for g, f in zip(drawn.geometries, drawn.feature, strict=True) if f == 1]
    assert np.allclose(np.array(line.coords)[:, 0], 500.0, atol=0.05)


def test_the_crs_of_places() -> None:
    model = frame()
    egm = with_heights(parse_crs("EPSG:32633"), "egm96")
    surface = Plane(egm, 10.0)
    assert ground_crs(model, surface, None, None) == egm
    other = ground_crs(model, surface, parse_crs("EPSG:4326"), None)
    assert has_heights(other)
    assert "EGM96" in height_name(other)
    assert height_name(ground_crs(model, surface, parse_crs("EPSG:4326"), "ellipsoidal")) == "ellipsoidal"
    flat = registry.build(
        "planar", SensorRequest("map", SIZE, {"transform": [1, 0, 5e5, 0, -1, 55e5]}, parse_crs("EPSG:32633"))
    )
    assert len(ground_crs(flat, None, None, None).axis_info) == 2
    with pytest.raises(HeightDatumError, match="no part"):
        ground_crs(flat, None, None, "egm96")
    found = locate(flat, None, np.array([[10.0, 20.0]]), flat.crs, InputUncertainty(pixel=0.5))
    assert found.xyz.tolist() == [[500010.0, 5499980.0, 0.0]]
    assert np.allclose(found.ellipses.semi_axes, 0.5)


def test_what_sees_no_ground_is_nan() -> None:
    model = replace(PinholeOverMap(), tilt=(1.5, 0.0, 0.0))
    found = locate(
        model, Plane(GROUND, 0.0), np.array([[500.0, 10.0], [500.0, 790.0]]), GROUND, InputUncertainty(pixel=1.0)
    )
    assert found.seen.tolist() == [False, True]
    assert np.isnan(found.ellipses.semi_axes[0]).all()
    assert np.isfinite(found.ellipses.semi_axes[1]).all()
