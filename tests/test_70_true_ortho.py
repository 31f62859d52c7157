"""True ortho of a city of 40 boxes whose hidden places are known in closed form, by every kind of sensor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import shapely
from city_rig import CORNER, FOCAL, PIXEL, SIDE, WALL_CLASS, City, photograph, places
from pyproj import CRS
from rpc_rig import SIZE as RPC_SIZE

from geomosaic.geo.crs import with_heights
from geomosaic.geo.grid import Grid
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.render import RenderOptions
from geomosaic.products.mosaics import make_mosaic
from geomosaic.products.orthos import make_ortho
from geomosaic.raster.vector import read_layer
from geomosaic.render.occlusion import Visibility
from geomosaic.sensor import registry
from geomosaic.sensor.map_to_image import Ground, MapToImage
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.surface.dem import Dem
from geomosaic.types import BoolArray, FloatArray

BOUNDS = (CORNER[0], CORNER[1], CORNER[0] + SIDE, CORNER[1] + SIDE)
CENTRES = np.array([[x, y, 420.0] for y in (90.0, 230.0) for x in (60.0, 160.0, 260.0)])
MAP = with_heights(CRS.from_epsg(32633), "ellipsoidal")


Truth = tuple[FloatArray, list[BoolArray]]


@pytest.fixture(scope="module")
def truth(city: tuple[City, Path]) -> Truth:
    """Class of each place, and whether each photo sees it."""
    x, y = places()
    z, kind = city[0].roof(x, y)
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    return kind, [~city[0].blocked(np.tile(c, (len(points), 1)), points).reshape(x.shape) for c in CENTRES]


@pytest.fixture(scope="module")
def city(tmp_path_factory: pytest.TempPathFactory) -> tuple[City, Path]:
    city, folder = City.of(), tmp_path_factory.mktemp("city")
    city.write_dsm(folder / "dsm.tif")
    rows = ["image,x,y,z,omega,phi,kappa"]
    for number, centre in enumerate(CENTRES):
        photograph(city, centre, folder / f"p{number}.tif")
        x, y = CORNER + centre[:2]
        rows.append(f"p{number},{x},{y},{centre[2]},0,0,0")
    (folder / "exterior.csv").write_text("\n".join(rows))
    return city, folder


def inputs(folder: Path, *numbers: int) -> Block:
    options = {"camera": {"focal_length_px": FOCAL}, "treatment": "planar"}
    return Block(
        tuple(folder / f"p{i}.tif" for i in numbers), "frame", options=options, exterior=folder / "exterior.csv",
        crs="EPSG:32633", heights="ellipsoidal", dem=folder / "dsm.tif", dem_heights="ellipsoidal",
    )  # fmt: skip


def near_edges(kind: FloatArray) -> BoolArray:
    """Places with another class within one pixel."""
    padded = np.pad(kind, 1, mode="edge")
    shifts = [
        padded[1 + i : 1 + i + kind.shape[0], 1 + j : 1 + j + kind.shape[1]] for i in (-1, 0, 1) for j in (-1, 0, 1)
    ]
    return np.asarray(np.any([shift != kind for shift in shifts], axis=0))


def test_a_mosaic_shows_nothing_hidden_and_says_what_no_image_sees(
    city: tuple[City, Path], truth: Truth, tmp_path: Path
) -> None:
    _, folder = city
    kind, seen = truth
    shown = {}
    for true_ortho in (False, True):
        out = tmp_path / f"mosaic-{true_ortho}.tif"
        options = MosaicOptions.of(resampling="nearest", true_ortho=true_ortho, balance=False, feather=4.0)
        result = make_mosaic(inputs(folder, *range(6)), Area(None, PIXEL, BOUNDS), out, options)
        with rasterio.open(out) as mosaic, rasterio.open(out.with_name(out.stem + "-labels.tif")) as labels:
            values, valid, label = mosaic.read(1), mosaic.dataset_mask() > 0, labels.read(1)
        shown[true_ortho] = sum(int(((label == i + 1) & valid & ~seen[i]).sum()) for i in range(6))
        wrong = (values != kind) & valid
        if true_ortho:
            none = ~np.any(seen, axis=0)
            assert result.hidden_pixels == (label == 7).sum()
            assert (label[none] == 7).all()
            assert not valid[label == 7].any()
            assert (valid | (label == 7)).all()
            assert (label == 7).sum() < 1.6 * none.sum()
            # Walls are in no ortho, and roofs are sharp.
            # They differ within a pixel of an edge, or of what their own image does not see.
            beside = np.any([near_edges(view.astype(float)) & (label == i + 1) for i, view in enumerate(seen)], axis=0)
            assert not (wrong & ~near_edges(kind) & ~beside).any()
            assert ((values == WALL_CLASS) & valid).mean() < 0.002
        else:
            assert result.hidden_pixels is None
            assert (wrong & ~near_edges(kind)).sum() > 3000  # roofs twice, and walls
    assert shown[False] > 5000
    assert shown[True] == 0


def test_one_ortho_leaves_out_what_it_cannot_see(city: tuple[City, Path], truth: Truth, tmp_path: Path) -> None:
    """Nothing hidden is shown; nothing is called hidden but what walls hide that may stand between the same nodes."""
    made_of, folder = city
    _, seen = truth
    valid = []
    for true_ortho in (False, True):
        out = tmp_path / f"o{true_ortho}.tif"
        options = RenderOptions(resampling="nearest", true_ortho=true_ortho)
        result = make_ortho(inputs(folder, 4), Area(None, PIXEL, BOUNDS), out, options)
        with rasterio.open(out) as dataset:
            valid.append(dataset.dataset_mask() > 0)
    plain, true = valid
    assert result.hidden_pixels == (plain & ~true).sum()
    assert (plain & ~seen[4]).sum() > 15_000
    assert not (true & ~seen[4]).any()
    wrongly = seen[4] & plain & ~true
    assert wrongly.sum() / (seen[4] & plain).sum() < 0.007
    x, y = places()
    points = np.column_stack([x.ravel(), y.ravel(), made_of.roof(x, y)[0].ravel()])
    largest = City(farthest_walls(made_of.boxes, PIXEL))
    possible = largest.blocked(np.tile(CENTRES[4], (len(points), 1)), points).reshape(x.shape)
    assert not (wrongly & ~possible).any()
    # Who shows nothing hidden must leave out what any city of the same nodes hides: no answer is below these 0.5 %.
    least = possible & seen[4] & plain & (roofs_of(largest, x, y) == roofs_of(made_of, x, y))
    assert 0.005 < least.sum() / (seen[4] & plain).sum() < 0.007
    assert not (least & true).any()


def roofs_of(city: City, x: FloatArray, y: FloatArray) -> FloatArray:
    """Heights at places."""
    return city.roof(x, y)[0]


def test_nodes_between_the_pixels_serve_as_well(city: tuple[City, Path], truth: Truth, tmp_path: Path) -> None:
    """Surface models of others have their nodes anywhere: no ring of nothing stays about the houses."""
    made_of, folder = city
    kind, seen = truth
    made_of.write_dsm(tmp_path / "between.tif", shift=PIXEL / 2)
    options = MosaicOptions.of(resampling="nearest", true_ortho=True, balance=False, feather=0.0)
    moved = replace(inputs(folder, *range(6)), dem=tmp_path / "between.tif")
    make_mosaic(moved, Area(None, PIXEL, BOUNDS), tmp_path / "m.tif", options)
    with rasterio.open(tmp_path / "m.tif") as mosaic, rasterio.open(tmp_path / "m-labels.tif") as labels:
        values, valid, label = mosaic.read(1), mosaic.dataset_mask() > 0, labels.read(1)
    assert sum(int(((label == i + 1) & valid & ~seen[i]).sum()) for i in range(6)) == 0
    assert (label == 7).sum() < 2.3 * (~np.any(seen, axis=0)).sum()
    assert ((values == WALL_CLASS) & valid).mean() < 0.006
    beside = np.any([near_edges(view.astype(float)) & (label == i + 1) for i, view in enumerate(seen)], axis=0)
    wrong = (values != kind) & valid
    assert not (wrong & ~near_edges(kind) & ~beside).any()


def test_a_thin_tower_hides_all_that_lies_behind_it(tmp_path: Path) -> None:
    """Of a tower two nodes wide a depth buffer shows the ground between the few pixels it falls into (M-portion)."""
    tower = City(np.array([[150.2, 140.3, 151.4, 141.5, 90.0], [170.0, 100.0, 171.3, 119.0, 60.0]]))
    tower.write_dsm(tmp_path / "dsm.tif")
    eye = np.array([20.0, 60.0, 420.0])
    options = {"camera": {"focal_length_px": 500.0}, "treatment": "planar", "position": [*(CORNER + eye[:2]), eye[2]],
               "orientation": {"system": "opk", "omega": 0.0, "phi": 0.0, "kappa": 0.0}}  # fmt: skip
    hidden, points = shades(registry.build("frame", SensorRequest("i", (1000, 1000), options, MAP)), tmp_path, tower)
    blocked = tower.blocked(np.tile(eye, (len(points), 1)), points)
    assert blocked.sum() > 1000
    assert not (blocked & ~hidden).any()
    assert (hidden & ~blocked).sum() < 0.9 * blocked.sum()


def test_seams_go_round_all_roofs_of_the_city(city: tuple[City, Path], tmp_path: Path) -> None:
    """The boxes stand 4 m apart: there is a way between any two. Seams halfway between photos cut some."""
    made_of, folder = city
    roofs = [shapely.box(*np.tile(CORNER, 2) + box[:4] + (PIXEL, PIXEL, -PIXEL, -PIXEL)) for box in made_of.boxes]
    cut = {}
    for way in ("nearest", "graph-cut"):
        options = MosaicOptions.of(seams=way)
        make_mosaic(inputs(folder, *range(6)), Area(None, PIXEL, BOUNDS), tmp_path / f"{way}.tif", options)
        lines = read_layer(tmp_path / f"{way}.gpkg", "seamlines").geometry
        cut[way] = sum(any(line.intersects(roof) for line in lines) for roof in roofs)
    assert cut["nearest"] > 4
    assert cut["graph-cut"] == 0


def farthest_walls(boxes: FloatArray, node: float) -> FloatArray:
    """The same heights at the nodes, and walls as far out as these allow."""
    far = boxes.copy()
    far[:, :2] = (np.ceil(boxes[:, :2] / node - 0.5) - 0.5) * node + 1e-6
    far[:, 2:4] = (np.ceil(boxes[:, 2:4] / node - 0.5) + 0.5) * node - 1e-6
    return far


def test_a_surface_model_finer_than_the_pixels_is_heeded_as_it_is(
    city: tuple[City, Path], truth: Truth, tmp_path: Path
) -> None:
    """Means over pixels would be lower than roofs, and show hidden places; and walls are known better."""
    made_of, folder = city
    made_of.write_dsm(tmp_path / "fine.tif", pixel=PIXEL / 4)
    masks = []
    for true_ortho in (False, True):
        out = tmp_path / f"o{true_ortho}.tif"
        options = RenderOptions(resampling="nearest", true_ortho=true_ortho)
        fine = replace(inputs(folder, 4), dem=tmp_path / "fine.tif")
        make_ortho(fine, Area(None, PIXEL, BOUNDS), out, options)
        with rasterio.open(out) as dataset:
            masks.append(dataset.dataset_mask() > 0)
    plain, true = masks
    seen = truth[1][4]
    assert not (true & ~seen).any()
    assert (seen & plain & ~true).sum() / (seen & plain).sum() < 0.0042


def sensors() -> dict[str, tuple[str, dict[str, Any]]]:
    middle = [*(CORNER + SIDE / 2).tolist(), 600.0]
    return {
        "frame": ("frame", {
            "camera": {"focal_length_px": 800.0}, "position": [middle[0] - 300.0, middle[1] - 120.0, 600.0],
            "orientation": {"system": "opk", "omega": 12.0, "phi": -24.0, "kappa": 20.0},
        }),
        "scanner": ("panoramic", {
            "kind": "scanner", "position": [middle[0] - 200.0, *middle[1:]], "heading": 10.0, "advance": 0.6,
            "field_of_view": 70.0,
        }),
        "panoramic": ("panoramic", {
            "kind": "panoramic", "position": [middle[0], middle[1] - 150.0, 600.0], "heading": 100.0, "advance": 20.0,
            "field_of_view": 80.0, "focal_length": 600.0, "pixel_size": 0.5, "image_motion": 10.0,
        }),
        "pushbroom": ("pushbroom", {
            "track": "track.csv", "focal_length_px": 900.0, "columns": "right", "start_time": 100.0,
            "line_period": 0.02,
        }),
    }  # fmt: skip


@pytest.mark.parametrize("name", ["frame", "scanner", "panoramic", pytest.param("pushbroom", marks=pytest.mark.slow)])
def test_every_sensor_is_judged_along_its_own_lines_of_sight(city: tuple[City, Path], name: str) -> None:
    made_of, folder = city
    sensor, options = sensors()[name]
    if name == "pushbroom":  # eastwards along the city's southern edge, looking to the north by up to 45 degrees
        times = 98.0 + 4.0 * np.arange(8)
        rows = [f"{t},{CORNER[0] - 120.0 + 24.0 * (t - 98.0)},{CORNER[1] - 60.0},620.0,-20.0,2.0,90.0" for t in times]
        (folder / "track.csv").write_text("\n".join(["time,x,y,z,roll,pitch,heading", *rows]))
        options = {**options, "track": str(folder / "track.csv")}
    model = registry.build(sensor, SensorRequest("image", (1000, 1000), options, MAP))
    hidden, points = shades(model, folder, made_of)
    assert hasattr(model, "rays")
    ground = Transform(MAP, model.crs)(points + np.array([*CORNER, 0.0]))
    colrow = model.ground_to_image(ground)
    assert np.isfinite(colrow).all()
    origins, _ = model.rays(colrow)
    eyes = Transform(model.crs, MAP)(origins) - np.array([*CORNER, 0.0])
    judge(made_of, eyes, points, hidden)


def test_a_model_of_rational_polynomials_is_judged_too(city: tuple[City, Path]) -> None:
    """An oblique parallel projection as an RPC: all lines of sight go by 0.45 east and −0.3 north per metre."""
    from geomosaic_rpc import Rpc, RpcModel

    made_of, folder = city
    to_geographic = Transform(MAP, CRS.from_epsg(4979))
    middle = to_geographic(np.array([[*(CORNER + SIDE / 2), 15.0]]))[0]
    step = to_geographic(np.array([[CORNER[0] + SIDE / 2 + 200.0, CORNER[1] + SIDE / 2 + 200.0, 15.0]]))[0] - middle
    along = to_geographic(np.array([[CORNER[0] + SIDE / 2 + 200.0, CORNER[1] + SIDE / 2, 15.0]]))[0] - middle
    numbers = np.zeros((4, 20))
    numbers[1::2, 0] = 1.0
    # Normalised longitude, latitude, height are in 200 m, 200 m, 100 m: x − 0.45 z, y + 0.3 z.
    numbers[0, 1:4] = 1.0, 0.0, -0.225
    numbers[2, 1:4] = 0.0, -1.0, -0.15
    numbers = numbers[:, [0, 1, 2, 3, *range(4, 20)]]
    model = RpcModel.of(
        Rpc(
            np.array([2000.0, 1500.0]), np.array([500.0, 500.0]), middle, np.array([along[0], step[1], 100.0]), numbers
        ),
        RPC_SIZE,
    )
    hidden, points = shades(model, folder, made_of)
    # The axes of degrees are turned by the convergence of 0 at the central meridian: the map's within centimetres.
    eyes = points + 2000.0 * np.array([0.45, -0.3, 1.0])
    judge(made_of, eyes, points, hidden)


def shades(model: SensorModel, folder: Path, city: City) -> tuple[BoolArray, FloatArray]:
    """What the kernel calls hidden at all pixels; and their points (N, 3) from the corner."""
    surface = Dem.open(folder / "dsm.tif", heights="ellipsoidal")
    grid = Grid.from_bounds(CRS.from_epsg(32633), BOUNDS, PIXEL)
    below = Ground.under(grid, surface)
    ground = below.block(grid.window)
    found = (
        Visibility(grid, below)
        .block(ground)
        .hidden(MapToImage.between(grid.crs, surface.crs, model), np.ones(grid.shape, dtype=np.uint8))
    )
    assert found is not None
    x, y = places()
    points = np.column_stack([x.ravel(), y.ravel(), city.roof(x, y)[0].ravel()])
    return found.ravel() > 0, points


def judge(city: City, eyes: FloatArray, points: FloatArray, hidden: BoolArray) -> None:
    blocked = city.blocked(eyes, points)
    assert blocked.mean() > 0.03
    assert (blocked & ~hidden).sum() == 0
    assert (hidden & ~blocked).sum() / (~blocked).sum() < 0.012


def test_the_result_does_not_depend_on_tiles(city: tuple[City, Path], tmp_path: Path) -> None:
    _, folder = city
    surface = Dem.open(folder / "dsm.tif", heights="ellipsoidal")
    model = registry.build("frame", SensorRequest("image", (1000, 1000), sensors()["frame"][1], MAP))
    grid = Grid.from_bounds(CRS.from_epsg(32633), BOUNDS, PIXEL)
    below = Ground.under(grid, surface)
    mapper, wanted = MapToImage.between(grid.crs, surface.crs, model), np.ones((256, 256), dtype=np.uint8)
    whole = Visibility(grid, below).block(below.block(grid.window))
    first = whole.hidden(mapper, np.ones(grid.shape, dtype=np.uint8))
    assert first is not None
    from geomosaic.geo.grid import Window

    found = Visibility(grid, below).block(below.block(Window(256, 256, 256, 256))).hidden(mapper, wanted)
    assert found is not None
    assert (found != first[256:512, 256:512]).mean() < 1e-3  # heights of the block fit the lines of sight


def test_a_block_holds_the_heights_of_few_images_and_gives_the_same(
    city: tuple[City, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, folder = city
    surface = Dem.open(folder / "dsm.tif", heights="ellipsoidal")
    model = registry.build("frame", SensorRequest("image", (1000, 1000), sensors()["frame"][1], MAP))
    grid = Grid.from_bounds(CRS.from_epsg(32633), BOUNDS, PIXEL)
    below = Ground.under(grid, surface)
    mappers, wanted = (
        [MapToImage.between(grid.crs, surface.crs, model) for _ in range(4)],
        np.ones(grid.shape, np.uint8),
    )
    found, held = [], []
    for room in (1 << 30, 0):
        monkeypatch.setattr("geomosaic.render.occlusion.HELD", room)
        shades = Visibility(grid, below).block(below.block(grid.window))
        found.append([shades.hidden(mapper, wanted) for mapper in (*mappers, mappers[0])])
        held.append(sum(sight is not None for _, sight in shades._known.values()))
    assert held == [4, 1]
    assert all(np.array_equal(a, b) for a, b in zip(*found, strict=True))
    assert found[0][0] is not None
    assert found[0][0].any()
