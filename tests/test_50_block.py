"""What images cover, and blocks of them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import GROUND, MAP, Hills, PinholeOverMap
from pyproj import Transformer

from geomosaic.block import OrientedBlock, OrientedImage, footprint
from geomosaic.errors import InputError
from geomosaic.geo.crs import parse_crs
from geomosaic.geo.grid import Grid
from geomosaic.surface.model import Plane, Surface

X, Y, Z = PinholeOverMap().centre
GROUND_HEIGHT = 40.0
PLANE = Plane(GROUND, GROUND_HEIGHT)


def scene(name: str = "photo", **camera: object) -> OrientedImage:
    return OrientedImage(name, f"{name}.tif", "pinhole", PinholeOverMap(**camera))


def on_the_plane(model: PinholeOverMap, colrow: np.ndarray, height: float = GROUND_HEIGHT) -> np.ndarray:
    """Where pixels lie on a plane, from the collinearity equations turned round; NaN above the horizon."""
    width, rows = model.size
    ray = (
        np.column_stack([(colrow[:, 0] - width / 2), -(colrow[:, 1] - rows / 2), np.full(len(colrow), -model.focal)])
        @ model.rotation
    )
    down = np.where(ray[:, 2] < 0, (height - model.centre[2]) / ray[:, 2], np.nan)
    return np.array(model.centre)[:2] + ray[:, :2] * down[:, None]


def corners(model: PinholeOverMap) -> np.ndarray:
    width, height = model.size
    return np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=float)


def test_corners_and_border_are_exact() -> None:
    photo = scene()
    found = footprint(photo, PLANE, MAP)
    assert found.complete
    assert found.name == "photo"
    exact = on_the_plane(photo.model, corners(photo.model))
    for corner in exact:
        assert np.hypot(*(found.ring - corner).T).min() < 1e-5
    # Straight edges stay straight on a plane, so the polygon is that of the corners.
    import shapely

    truth = shapely.Polygon(exact)
    assert found.polygon.symmetric_difference(truth).area < 1e-6 * truth.area
    left, bottom, right, top = found.bounds
    assert (left, bottom, right, top) == pytest.approx([*exact.min(axis=0), *exact.max(axis=0)], abs=1e-5)


def test_sampling_is_the_ground_size_of_a_pixel() -> None:
    upright = scene(tilt=(0.0, 0.0, 0.3))
    assert footprint(upright, PLANE, MAP).sampling == pytest.approx((Z - GROUND_HEIGHT) / 1000.0, rel=1e-9)


def test_the_centre_is_the_nadir_where_the_image_shows_it() -> None:
    class WithRays(PinholeOverMap):
        def rays(self, colrow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            width, height = self.size
            d = np.column_stack(
                [colrow[:, 0] - width / 2, height / 2 - colrow[:, 1], np.full(len(colrow), -self.focal)]
            )
            d = d @ self.rotation
            return np.tile(self.centre, (len(colrow), 1)), d / np.linalg.norm(d, axis=1, keepdims=True)

    near = WithRays()
    assert footprint(OrientedImage("a", "a.tif", "pinhole", near), PLANE, MAP).centre == pytest.approx((X, Y), abs=1e-6)
    # Tilted by 45°, the photo does not show the ground under the camera: its middle counts.
    far = WithRays(tilt=(0.8, 0.0, 0.0))
    middle = on_the_plane(far, np.array([[500.0, 400.0]]))[0]
    assert footprint(OrientedImage("a", "a.tif", "pinhole", far), PLANE, MAP).centre == pytest.approx(middle, abs=1e-4)
    # A model without rays has no projection centre to ask for.
    assert footprint(scene(), PLANE, MAP).centre == pytest.approx(
        on_the_plane(PinholeOverMap(), np.array([[500.0, 400.0]]))[0], abs=1e-4
    )


def test_relief_moves_the_outline() -> None:
    hills, photo = Hills(), scene()
    found = footprint(photo, hills, MAP)
    assert found.complete
    back = photo.model.ground_to_image(np.column_stack([found.ring, hills.height(found.ring)]))
    width, height = photo.model.size
    rim = np.min([back[:, 0], back[:, 1], width - back[:, 0], height - back[:, 1]], axis=0)
    assert np.abs(rim).max() < 1e-3  # every point of the outline lies on the image's border
    assert np.hypot(*(found.ring - footprint(photo, PLANE, MAP).ring).T).max() > 5


def test_part_of_the_image_in_the_sky() -> None:
    photo = scene(tilt=(1.25, 0.0, 0.0))
    upper = on_the_plane(photo.model, corners(photo.model))
    assert np.isnan(upper[:2]).all()  # the upper corners look above the horizon
    found = footprint(photo, PLANE, MAP)
    assert not found.complete
    assert np.isfinite(found.ring).all()
    for corner in upper[2:]:
        assert np.hypot(*(found.ring - corner).T).min() < 1e-3
    back = photo.model.ground_to_image(np.column_stack([found.ring, np.full(len(found.ring), GROUND_HEIGHT)]))
    assert (back > -1e-3).all()
    assert (back < np.array(photo.model.size) + 1e-3).all()
    horizon = 400 - 1000 / np.tan(1.25)
    assert horizon < back[:, 1].min() < horizon + 40


def test_in_another_map() -> None:
    other = parse_crs("EPSG:32632")
    ring = footprint(scene(), PLANE, MAP).ring
    moved = np.column_stack(Transformer.from_crs(MAP, other, always_xy=True).transform(*ring.T))
    assert np.abs(footprint(scene(), PLANE, other).ring - moved).max() < 1e-4


class _Patch(Hills):
    """Hills that are known within 300 m of a place only."""

    place: tuple[float, float] = (X, Y)

    def height(self, xy: np.ndarray) -> np.ndarray:
        known = (np.abs(xy - np.array(self.place)) < 300).all(axis=1)
        return np.where(known, super().height(xy), np.nan)


def _at(place: tuple[float, float]) -> Surface:
    surface = _Patch()
    object.__setattr__(surface, "place", place)
    return surface


def test_a_dem_that_ends_within_the_image() -> None:
    found = footprint(scene(), _at((X, Y)), MAP)
    assert not found.complete
    assert np.isfinite(found.ring).all()
    # Bisection goes to a 4096th of the half image, a quarter of a pixel.
    assert (np.abs(found.ring - (X, Y)).max(axis=1) <= 300).all()
    assert np.abs(found.ring - (X, Y)).max() > 297


@pytest.mark.parametrize("hole", [(-40.0, -40.0, 40.0, 40.0), (-5e3, -5e3, 150.0, 5e3)], ids=["hole", "edge"])
def test_a_dem_without_heights_in_the_middle_of_the_image(hole: tuple[float, float, float, float]) -> None:
    surface = Hills()
    whole = footprint(scene(), surface, MAP)
    left, bottom, right, top = hole
    height = surface.height

    def with_hole(xy: np.ndarray) -> np.ndarray:
        x, y = xy[:, 0] - X, xy[:, 1] - Y
        return np.where((x > left) & (x < right) & (y > bottom) & (y < top), np.nan, height(xy))

    object.__setattr__(surface, "height", with_hole)
    found = footprint(scene(), surface, MAP)
    assert np.isfinite(found.ring).all()
    assert found.sampling == pytest.approx(whole.sampling, rel=0.05)  # relief
    if hole[0] == -40.0:
        np.testing.assert_allclose(found.ring, whole.ring, atol=1e-6)
        assert found.complete
    else:
        assert not found.complete
        assert found.ring[:, 0].min() > X + 149


def test_a_dem_elsewhere() -> None:
    with pytest.raises(InputError) as caught:
        footprint(scene("stray"), _at((X + 5000, Y)), MAP)
    assert caught.value.where == "stray"
    assert "DEM" in caught.value.what
    assert caught.value.hint


def test_a_hole_of_the_dem_under_the_camera_is_no_dem_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("geomosaic.block._nadir", lambda scene, crs: (X, Y))
    for reach, words in ((8000.0, "hole of the DEM"), (3000.0, "outside the DEM")):
        surface = _at((X + 5000, Y))  # heights are known there only
        area = (X - reach, Y - reach, X + reach, Y + reach) if reach > 5000 else (X + 4000, Y - 300, X + 6000, Y + 300)
        object.__setattr__(surface, "grid", Grid.from_bounds(MAP, area, 100.0))
        with pytest.raises(InputError, match=words):
            footprint(scene("stray"), surface, MAP)


def test_a_dem_elsewhere_is_reported_with_its_extent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Degrees that pass for metres show themselves."""
    monkeypatch.setattr("geomosaic.block._nadir", lambda scene, crs: (X, Y))
    surface = _at((X + 5000, Y))
    object.__setattr__(surface, "grid", Grid.from_bounds(MAP, (14.5, 49.66, 14.55, 49.7), 0.01))
    with pytest.raises(InputError, match=r"the DEM reaches over x 14\.5 to 14\.55, y 49\.66 to 49\.7 \(WGS 84 / UTM"):
        footprint(scene("stray"), surface, MAP)


def test_a_camera_below_the_ground(monkeypatch: pytest.MonkeyPatch) -> None:
    """Heights of the ground in feet are the usual cause; the sky is none."""
    buried = np.array([[X, Y, GROUND_HEIGHT - 10]])
    monkeypatch.setattr("geomosaic.block._origin", lambda scene: buried)
    monkeypatch.setattr("geomosaic.block._nadir", lambda scene, crs: (X, Y))
    with pytest.raises(InputError, match=r"below the ground: at 30\.0 m, where the ground is at 40\.0 m") as caught:
        footprint(scene("mole", centre=tuple(buried[0])), PLANE, MAP)
    assert "feet" in str(caught.value.hint)


def test_an_image_of_the_sky() -> None:
    with pytest.raises(InputError, match="sky") as caught:
        footprint(scene("up", tilt=(2.8, 0.0, 0.0)), PLANE, MAP)
    assert caught.value.where == "up"
    assert "angle" in str(caught.value.hint)


def test_a_block_finds_its_scenes_by_name() -> None:
    block = OrientedBlock((scene("a"), scene("b")), PLANE)
    assert block.scene("b").name == "b"
    with pytest.raises(InputError, match="'c'"):
        block.scene("c")
    with pytest.raises(InputError, match="share the name 'a'"):
        OrientedBlock((scene("a"), scene("b"), scene("a")), PLANE)
    with pytest.raises(InputError, match="at least one"):
        OrientedBlock((), PLANE)
