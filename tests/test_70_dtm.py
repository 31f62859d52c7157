"""DTM from contours, spot heights, breaklines and lakes: the ground is a formula, and comes back."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pytest
import shapely
from contourpy import contour_generator
from scipy.interpolate import LinearNDInterpolator

from geomosaic.cli.main import run
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.relief.contours import contours
from geomosaic.relief.dtm import DtmResult, dtm
from geomosaic.surface.dem import Dem
from geomosaic.surface.plate_grid import PlateData, solve_grid
from geomosaic.surface.thin_plate import Folds, Heights

CRS = "EPSG:32633"
CORNER = np.array([500_000.0, 5_000_000.0])
INTERVAL = 10.0


def ground(xy: np.ndarray) -> np.ndarray:
    """Two summits, a hollow, a shoulder and ripples over a slope; 1000 m of land, about 110 m high."""
    x, y = (xy - CORNER).T
    bells = [(300, 420, 120, 80), (700, 600, 90, 60), (620, 250, 150, -50), (900, 850, 200, 50)]
    hills = sum(h * np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * s * s)) for a, b, s, h in bells)
    return 200 + 0.02 * x + hills + 8 * np.sin(x / 90) * np.cos(y / 110)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Contours every 10 m, traced on the formula at 1 m, and 43 spot heights, the summits and the hollow among them."""
    folder = tmp_path_factory.mktemp("terrain")
    axis = np.linspace(0.0, 1000.0, 1001)
    places = np.stack(np.meshgrid(axis, axis), axis=-1) + CORNER
    generator = contour_generator(z=ground(places.reshape(-1, 2)).reshape(1001, 1001), name="serial")
    lines, levels = [], []
    for level in np.arange(100.0, 400.0, INTERVAL):
        for line in generator.lines(level):
            if len(line) > 2:
                lines.append(shapely.LineString(line + CORNER))
                levels.append(level)
    gpd.GeoDataFrame({"height": levels}, geometry=lines, crs=CRS).to_file(folder / "contours.gpkg")
    spots = (
        np.vstack([np.random.default_rng(2).uniform(20, 980, (40, 2)), [[300, 420], [700, 600], [620, 250]]]) + CORNER
    )
    rows = [",".join(map(repr, row)) for row in np.column_stack([spots, ground(spots)]).tolist()]
    (folder / "heights.csv").write_text("#CRS: EPSG:32633\nx,y,z\n" + "\n".join(rows) + "\n")
    return folder / "contours.gpkg", folder / "heights.csv"


@pytest.fixture(scope="module")
def model(data: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> DtmResult:
    return dtm(
        tmp_path_factory.mktemp("dtm") / "dtm.tif", contours=data[0], points=data[1], resolution=5, heights="egm96"
    )


def errors(made: DtmResult) -> np.ndarray:
    """Height minus truth at all nodes that have one."""
    values = made.read()[0]
    col, row = np.meshgrid(np.arange(made.grid.width) + 0.5, np.arange(made.grid.height) + 0.5)
    truth = ground(made.grid.xy(np.column_stack([col.ravel(), row.ravel()]))).reshape(values.shape)
    return np.ma.compressed(values - truth)


def test_the_ground_comes_back_from_its_contours(data: tuple[Path, Path], model: DtmResult) -> None:
    """RMS below a thirtieth of the interval, and the largest error below a quarter of it; triangles are far worse."""
    off = errors(model)
    assert np.sqrt(np.mean(off**2)) < 0.25
    assert np.abs(off).max() < 2.2
    assert model.heights.startswith("EGM96")
    assert model.line_rms < 0.01
    vertices = shapely.get_coordinates(gpd.read_file(data[0]).geometry)[::3]
    flat = LinearNDInterpolator(vertices, np.round(ground(vertices) / INTERVAL) * INTERVAL)
    places = CORNER + np.random.default_rng(1).uniform(50, 950, (2000, 2))
    triangles = flat(places) - ground(places)
    assert np.sqrt(np.nanmean(triangles**2)) > 1.4


def test_spot_heights_are_kept_and_tell_the_error(data: tuple[Path, Path], model: DtmResult) -> None:
    """As any user of the file interpolates: within a millimetre; left out, they are missed as far as the ground is."""
    spots = np.loadtxt(data[1], delimiter=",", skiprows=2)
    with closing(Dem.open(model.path)) as surface:
        kept = surface.height(spots[:, :2]) - spots[:, 2]
    assert np.abs(kept).max() < 1e-3
    assert model.spot_worst < 1e-3
    assert np.isfinite(model.left_out).all()
    # Without number 5 at all, from the start.
    rows = data[1].read_text().splitlines()
    fewer = data[1].with_name("fewer.csv")
    fewer.write_text("\n".join(rows[:7] + rows[8:]) + "\n")
    again = dtm(data[1].with_name("fewer.tif"), contours=data[0], points=fewer, resolution=5)
    with closing(Dem.open(again.path, heights="egm96")) as surface:
        assert spots[5, 2] - surface.height(spots[5:6, :2])[0] == pytest.approx(model.left_out[5], abs=1e-3)
    rms = np.sqrt(np.mean(model.left_out**2))
    assert 0.5 < rms / np.sqrt(np.mean(errors(model) ** 2)) < 2.0


def test_spot_heights_that_contradict_each_other_are_told(data: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "two.csv").write_text("x,y,z\n500500,5000500,230\n500500,5000500,235\n")
    with pytest.warns(GeomosaicWarning, match="a spot height is missed by 2.5 m, as it contradicts another one"):
        dtm(tmp_path / "dtm.tif", contours=data[0], points=tmp_path / "two.csv", resolution=20)


def test_a_mistyped_spot_height_is_named(data: tuple[Path, Path], tmp_path: Path) -> None:
    lines = data[1].read_text().splitlines()
    east, north, height = lines[7].split(",")
    lines[7] = f"{east},{north},{float(height) + 300.0}"
    (tmp_path / "h.csv").write_text("\n".join(lines))
    with pytest.warns(
        GeomosaicWarning, match=r"miss the spot height .* by 3\d\d m, .* of the contours, 10 m.* mistyped height"
    ):
        made = dtm(tmp_path / "dtm.tif", contours=data[0], points=tmp_path / "h.csv", resolution=20)
    assert np.abs(made.left_out).argmax() == 5


def test_hilltops_are_no_flats(data: tuple[Path, Path], tmp_path: Path) -> None:
    """Contours alone: within the last contour of a summit the ground goes on to rise, of the hollow to fall."""
    made = dtm(tmp_path / "dtm.tif", contours=data[0], resolution=5)
    tops = CORNER + np.array([[300.0, 420.0], [700.0, 600.0]])
    with closing(Dem.open(made.path, heights="egm96")) as surface:
        heights = surface.height(tops)
    last = np.floor(ground(tops) / INTERVAL) * INTERVAL
    assert (heights > last + 0.5 * (ground(tops) - last)).all()
    assert np.abs(heights - ground(tops)).max() < 0.25 * INTERVAL
    assert not len(made.left_out)


def test_contours_of_the_dtm_are_those_it_was_made_of(
    data: tuple[Path, Path], model: DtmResult, tmp_path: Path
) -> None:
    made = contours(model.path, tmp_path / "again.gpkg", interval=INTERVAL, tolerance=0.2, dem_heights="egm96")
    found, given = made.read("contours"), gpd.read_file(data[0])
    for level in sorted(set(given.height)):
        one, other = (shapely.union_all(frame.geometry[frame.height == level].values) for frame in (given, found))
        inside = shapely.box(*(CORNER + 15), *(CORNER + 985))
        one, other = shapely.intersection(one, inside), shapely.intersection(other, inside)
        line = shapely.get_coordinates(shapely.segmentize(one, 5.0))
        away = shapely.distance(shapely.points(line), other)
        assert np.quantile(away, 0.99) < 1.5  # a third of a node
        assert other.length == pytest.approx(one.length, rel=0.05)


def test_patches_meet_without_a_seam() -> None:
    """One plate of 160 x 150 nodes in four patches, against the same in one."""
    rng = np.random.default_rng(4)
    places = rng.uniform(0, (149, 159), (700, 2))
    heights = 50 * np.sin(places[:, 0] / 40) + 30 * np.cos(places[:, 1] / 55)
    nothing = Heights(np.empty((0, 2)), np.empty(0), np.empty(0))
    given = PlateData(Heights(places, heights, np.full(700, 10.0)), nothing, np.empty((0, 2, 2)))
    from geomosaic.surface import plate_grid

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plate_grid, "WHOLE", 400)
        (whole,) = solve_grid(given, (160, 150))
        patch.setattr(plate_grid, "WHOLE", 100)
        patch.setattr(plate_grid, "PATCH", 80)
        bands = list(solve_grid(given, (160, 150)))
    assert len(bands) == 2
    parts = np.vstack([band.heights for band in bands])
    assert np.abs(parts - whole.heights).max() < 0.05
    assert np.sqrt(np.mean((parts - whole.heights) ** 2)) < 0.002


def test_the_slope_breaks_along_breaklines(tmp_path: Path) -> None:
    """A roof of two slopes, from points off the ridge: with the ridge it is met, without it is rounded."""

    def roof(xy: np.ndarray) -> np.ndarray:
        return 100.0 - 0.5 * np.abs(xy[:, 0] - CORNER[0] - 201.0)

    x, y = np.meshgrid(np.arange(0.0, 401.0, 50.0), np.arange(0.0, 401.0, 50.0))
    points = np.column_stack([x.ravel(), y.ravel()]) + CORNER
    rows = [f"{a!r},{b!r},{c!r}" for (a, b), c in zip(points.tolist(), roof(points).tolist(), strict=True)]
    (tmp_path / "p.csv").write_text("x,y,z\n" + "\n".join(rows) + "\n")
    ridge = shapely.LineString([(CORNER[0] + 201.0, CORNER[1] - 5, 100.0), (CORNER[0] + 201.0, CORNER[1] + 405, 100.0)])
    gpd.GeoDataFrame({"kind": ["ridge"]}, geometry=[ridge], crs=CRS).to_file(tmp_path / "ridge.gpkg")
    off = {}
    for name, more in {"with": {"breaklines": tmp_path / "ridge.gpkg"}, "without": {}}.items():
        made = dtm(tmp_path / f"{name}.tif", points=tmp_path / "p.csv", crs=CRS, resolution=4, **more)
        # Across the middle, and near the end of the ridge at the border of the data.
        at = CORNER + np.column_stack([np.tile(np.linspace(110, 290, 181), 2), np.repeat([230.0, 398.0], 181)])
        with closing(Dem.open(made.path, heights="egm96")) as surface:
            off[name] = np.abs(surface.height(at) - roof(at))
    # A bilinear surface breaks at nodes only, here 1 m beside the ridge: off by the change of slope over that metre.
    assert off["with"].max() < 1.01
    assert off["without"].max() > 3.0


def test_a_lake_is_level_and_its_shore_a_fold(data: tuple[Path, Path], tmp_path: Path) -> None:
    centre = shapely.Point(CORNER + np.array([620.0, 250.0]))
    lake = centre.buffer(60) - centre.buffer(20)
    level = 178.25
    peak = tmp_path / "peak.csv"
    peak.write_text(f"x,y,z\n{CORNER[0] + 620},{CORNER[1] + 250},{level + 4}\n")
    gpd.GeoDataFrame({"level": [level]}, geometry=[lake], crs=CRS).to_file(tmp_path / "lake.gpkg")
    made = dtm(tmp_path / "dtm.tif", contours=data[0], water=tmp_path / "lake.gpkg", points=peak, resolution=5)
    col, row = np.meshgrid(np.arange(made.grid.width) + 0.5, np.arange(made.grid.height) + 0.5)
    xy = made.grid.xy(np.column_stack([col.ravel(), row.ravel()]))
    inside = shapely.contains_xy(lake, *xy.T)
    values = made.read()[0].ravel()
    assert inside.sum() > 350
    assert np.abs(values[inside] - level).max() < 1e-4
    island = np.hypot(*(xy - CORNER - [620, 250]).T) < 8
    assert island.sum() > 4
    assert (values[island] > level + 1.5).all()
    assert made.lakes == 1


def test_folds_stand_at_the_nodes_nearest_to_a_line() -> None:
    line = np.array([[[1.6, 0.2], [1.6, 0.7]], [[1.6, 0.7], [1.6, 1.2]], [[1.6, 1.2], [2.1, 1.3]]])
    folds = Folds.of(line, (3, 4))
    assert np.argwhere(folds.across).tolist() == [[1, 2]]
    assert np.argwhere(folds.down).tolist() == [[1, 2]]
    assert np.argwhere(folds.cells).tolist() == [[0, 1], [1, 1]]
    again = Folds.of(line + 5, (3, 4), (5, 5))
    assert (again.across == folds.across).all()
    assert (again.down == folds.down).all()


CASES: dict[str, tuple[dict[str, Any], str]] = {
    "nothing": ({"resolution": 5}, "nothing has heights"),
    "no spacing": ({"contours": "c"}, "nothing says how far apart"),
    "scale": ({"contours": "c", "map_scale": 7000}, "K-2.8 has no grid interval for 1:7000"),
    "column": ({"contours": "c", "resolution": 5, "height_field": "h"}, "there is no column 'h'"),
    "no points": ({"points": "c", "resolution": 5}, "the file has no points"),
    "elsewhere": ({"contours": "c", "resolution": 5, "bounds": (0, 0, 100, 100)}, "no data lie in it"),
    "degrees": ({"contours": "c", "resolution": 5, "crs": "EPSG:4326"}, "no cells of one size"),
}


@pytest.mark.parametrize("case", CASES)
def test_what_cannot_be_made_is_told(data: tuple[Path, Path], tmp_path: Path, case: str) -> None:
    options, words = CASES[case]
    options = {name: data[0] if value == "c" else value for name, value in options.items()}
    with pytest.raises(InputError, match=words):
        dtm(tmp_path / "x.tif", **options)
    assert not (tmp_path / "x.tif").exists()


def test_heights_on_one_line_are_no_surface(tmp_path: Path) -> None:
    (tmp_path / "line.csv").write_text("x,y,z\n" + "".join(f"{500_000 + 9 * k},5000100,{k}\n" for k in range(5)))
    with pytest.raises(InputError, match="all heights lie on one line"):
        dtm(tmp_path / "x.tif", points=tmp_path / "line.csv", crs=CRS, resolution=5)


def test_the_command_says_the_errors_and_the_interval_of_the_guidelines(
    data: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--contours", str(data[0]), "--points", str(data[1]), "--map-scale", "1:10000", "-o"]
    assert run(["dtm", *words, str(tmp_path / "d.tif")]) == 0
    said = capsys.readouterr().out
    assert "pixels of 15 metre" in said
    assert "43 spot heights: met within " in said
    assert "spot heights left out in turn: missed by" in said
    assert "K-2.8 advises nodes every 15 to 20 m" in said
