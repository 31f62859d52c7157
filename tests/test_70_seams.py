"""Seams by similarity through the whole pipe: what two images show differently comes from one of them, whole."""

from __future__ import annotations

import hashlib
import json
import warnings
from pathlib import Path

import geopandas
import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine

from geomosaic.raster.vector import read_layer

LEFT, TOP, WIDTH, HEIGHT, STEP = 500_000.0, 5_500_000.0, 600, 420, 300
HOUSE = (410, 180, 480, 250)
"""Columns and rows of the ground: across the line halfway between both centres, at column 450."""


def tile(path: Path, col: int, house: int) -> Path:
    rng = np.random.default_rng(0)
    ground = rng.integers(90, 110, (3, HEIGHT, WIDTH + STEP), dtype=np.uint8)
    left, top, right, bottom = HOUSE
    ground[:, top:bottom, left:right] = house
    profile = {"driver": "GTiff", "width": WIDTH, "height": HEIGHT, "count": 3, "dtype": "uint8", "crs": "EPSG:32631"}
    with rasterio.open(path, "w", transform=Affine(1.0, 0.0, LEFT + col, 0.0, -1.0, TOP), **profile) as dataset:
        dataset.write(ground[:, :, col : col + WIDTH])
    return path


@pytest.fixture
def tiles(tmp_path) -> list[Path]:
    return [tile(tmp_path / "a.tif", 0, 220), tile(tmp_path / "b.tif", STEP, 20)]


def house(path: Path) -> np.ndarray:
    """What the mosaic shows of the house, without its rim."""
    with rasterio.open(path) as dataset:
        (c0, r0), (c1, r1) = (~dataset.transform @ (LEFT + c, TOP - r) for c, r in (HOUSE[:2], HOUSE[2:]))
        return dataset.read()[:, round(r0) + 2 : round(r1) - 2, round(c0) + 2 : round(c1) - 2]


def test_a_house_comes_from_one_image(tell, tiles, tmp_path):
    options = ("--res", 1, "--no-balance", "--feather", 6)
    for seams, whole in (("nearest", False), ("graph-cut", True)):
        out = tmp_path / f"{seams}.tif"
        code, said, _ = tell("mosaic", *tiles, *options, "--seams", seams, "-o", out, "--json", "--threads", 1)
        assert code == 0
        assert (len(np.unique(house(out))) == 1) == whole
        assert json.loads(said)["valid_pixels"] == HEIGHT * (WIDTH + STEP)
    again = tmp_path / "again.tif"
    assert tell("mosaic", *tiles, *options, "--seams", "graph-cut", "-o", again, "--threads", 3)[0] == 0
    assert (
        hashlib.sha256(again.read_bytes()).digest()
        == hashlib.sha256((tmp_path / "graph-cut.tif").read_bytes()).digest()
    )


def test_the_shares_divide_the_footprints_among_them(tell, sample, tmp_path):
    out = tmp_path / "m.tif"
    words = [
        "--sensor", "frame", "--camera", sample / "camera.toml", "--exterior", sample / "exterior.csv",
        "--crs", "EPSG:32633", "--heights", "egm96", "--dem", sample / "dem.tif", "--res", 5, "--seams", "graph-cut",
        "--no-balance", "--no-labels",
    ]  # fmt: skip
    code, _, err = tell("mosaic", *sorted((sample / "photos").glob("*.jpg")), *words, "-o", out)
    assert code == 0, err
    shares, prints = (read_layer(out.with_suffix(".gpkg"), name) for name in ("seams", "footprints"))
    everything = shapely.union_all(prints.geometry)
    assert all(share.is_valid for share in shares.geometry)
    assert shares.area.sum() == pytest.approx(shapely.union_all(shares.geometry).area, rel=1e-9)
    assert shares.area.sum() == pytest.approx(everything.area, rel=1e-9)
    assert shapely.union_all(shares.geometry).difference(everything).area < 1e-6 * everything.area
    by_image = dict(zip(prints["image"], prints.geometry, strict=True))
    for name, share in zip(shares["image"], shares.geometry, strict=True):
        assert share.difference(by_image[name]).area < 1e-9 * everything.area
    lines = read_layer(out.with_suffix(".gpkg"), "seamlines")
    assert len(lines) >= 11


def seams_of(out: Path) -> shapely.Geometry:
    return shapely.union_all(read_layer(out.with_suffix(".gpkg"), "seamlines").geometry)


def layer(path: Path, shapes: list[shapely.Geometry], crs: str | None = "EPSG:32631", **columns: list) -> Path:
    geopandas.GeoDataFrame(columns, geometry=shapes, crs=crs).to_file(path, layer="one", engine="pyogrio")
    return path


def place(*colrow: float) -> list[tuple[float, float]]:
    return [(LEFT + c, TOP - r) for c, r in zip(colrow[::2], colrow[1::2], strict=True)]


@pytest.fixture
def quiet(tmp_path) -> list[Path]:
    """Two images that show the same everywhere, their overlap from column 300 to 600."""
    return [tile(tmp_path / "a.tif", 0, 100), tile(tmp_path / "b.tif", STEP, 100)]


def test_what_is_to_be_kept_out_of_is_never_cut(tell, quiet, tmp_path):
    boxes = [shapely.box(*place(c, r + 22)[0], *place(c + 40, r)[0]) for r in range(10, 400, 40) for c in (390, 434)]
    avoid = layer(tmp_path / "houses.gpkg", boxes)
    common = ("--res", 1, "--no-balance", "--feather", 0)
    free, out = tmp_path / "free.tif", tmp_path / "out.tif"
    assert tell("mosaic", *quiet, *common, "-o", free)[0] == 0
    assert tell("mosaic", *quiet, *common, "--seams", "graph-cut", "--avoid", avoid, "-o", out)[0] == 0
    assert seams_of(free).intersection(shapely.union_all(boxes)).length > 100
    assert seams_of(out).intersection(shapely.union_all(boxes).buffer(-0.01)).length == 0
    with rasterio.open(out.with_name("out-labels.tif")) as labels:
        for box in boxes:
            west, south, east, north = box.bounds
            (c0, r0), (c1, r1) = (~labels.transform @ xy for xy in ((west, north), (east, south)))
            assert len(np.unique(labels.read(1)[round(r0) : round(r1), round(c0) : round(c1)])) == 1


def test_a_road_is_followed(tell, quiet, tmp_path):
    road = shapely.LineString(place(440, -10, 500, 120, 400, 260, 470, 430))
    out = tmp_path / "out.tif"
    words = ("--res", 1, "--no-balance", "--seams", "graph-cut", "--follow", layer(tmp_path / "road.gpkg", [road]))
    assert tell("mosaic", *quiet, *words, "-o", out)[0] == 0
    found = seams_of(out)
    assert found.intersection(road.buffer(5)).length > 0.9 * found.length
    assert found.length > 0.95 * HEIGHT


def test_no_roof_is_cut_where_the_surface_tells_of_roofs(tell, quiet, tmp_path):
    heights = np.full((HEIGHT + 40, WIDTH + STEP + 40), 50, dtype=np.float32)
    roofs = [(400, r, 448, r + 30) for r in range(15, 400, 45)]
    for left, top, right, bottom in roofs:
        heights[top + 20 : bottom + 20, left + 20 : right + 20] = 58
    profile = {"driver": "GTiff", "width": heights.shape[1], "height": heights.shape[0], "count": 1, "dtype": "float32"}
    transform = Affine(1.0, 0.0, LEFT - 20, 0.0, -1.0, TOP + 20)
    with rasterio.open(tmp_path / "dsm.tif", "w", crs="EPSG:32631", transform=transform, **profile) as dataset:
        dataset.write(heights, 1)
    out = tmp_path / "out.tif"
    words = (
        "--res",
        1,
        "--no-balance",
        "--seams",
        "graph-cut",
        "--dem",
        tmp_path / "dsm.tif",
        "--dem-heights",
        "egm96",
    )
    code, _, err = tell("mosaic", *quiet, *words, "-o", out)
    assert code == 0, err
    roofs_there = shapely.union_all([shapely.box(*place(a, d)[0], *place(c, b)[0]) for a, b, c, d in roofs])
    middle = shapely.LineString(place(450, 0, 450, HEIGHT))
    assert middle.distance(roofs_there) < 3  # halfway, where seams cost the same everywhere
    assert seams_of(out).intersection(roofs_there).length == 0


def test_an_overlap_is_halved(tell, quiet, tmp_path):
    out = tmp_path / "out.tif"
    assert tell("mosaic", *quiet, "--res", 1, "--seams", "halve", "-o", out)[0] == 0
    areas = read_layer(out.with_suffix(".gpkg"), "seams").area
    assert areas.tolist() == pytest.approx([HEIGHT * 450] * 2, rel=0.01)


BOWTIE = shapely.Polygon(place(310, 10, 500, 300, 500, 10, 310, 300))
BAD = {
    "road without CRS": ("--follow", [shapely.LineString(place(1, 1, 9, 9))], None, "has no CRS"),
    "line to avoid": ("--avoid", [shapely.LineString(place(1, 1, 9, 9))], "EPSG:32631", "LineString, not an area"),
    "house that crosses itself": ("--avoid", [BOWTIE], "EPSG:32631", "Self-intersection"),
    "point to follow": ("--follow", [shapely.Point(place(1, 1)[0])], "EPSG:32631", "Point, not a line or area"),
    "share that crosses itself": ("--cutlines", [BOWTIE], "EPSG:32631", "Self-intersection"),
    "share without CRS": ("--cutlines", [shapely.box(0, 0, 1, 1)], None, "has no CRS"),
    "open share": ("--cutlines", [shapely.LineString(place(1, 1, 9, 9, 5, 20))], "EPSG:32631", "not an area"),
    "share elsewhere": ("--cutlines", [shapely.box(0, 0, 100, 100)], "EPSG:32631", "outside of what 'a.tif' shows"),
}


@pytest.mark.parametrize("case", BAD)
def test_layers_that_cannot_be_used(case, tell, quiet, tmp_path):
    flag, shapes, crs, said = BAD[case]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a layer without CRS
        file = layer(tmp_path / "bad.gpkg", shapes, crs, image=["a.tif"] * len(shapes))
    words = ("--seams", "graph-cut", flag, file, "--res", 1, "-o", tmp_path / "out.tif")
    code, _, err = tell("mosaic", *quiet, *words)
    assert code == 1
    assert said in err
    assert not (tmp_path / "out.tif").exists()


def test_labels_are_no_cutlines_and_weights_have_names(tell, quiet, tmp_path):
    out = tmp_path / "out.tif"
    code, _, err = tell("mosaic", *quiet, "--res", 1, "--cutlines", quiet[0], "-o", out)
    assert (code, "not a vector file" in err) == (1, True)
    code, _, err = tell("mosaic", *quiet, "--res", 1, "--seams", "graph-cut", "--seam-weight", "colors=1", "-o", out)
    assert (code, "did you mean 'colour'" in err) == (2, True)
    code, _, err = tell("mosaic", *quiet, "--res", 1, "--seam-weight", "colour=2", "-o", out)
    assert (code, "would do nothing without --seams graph-cut" in err) == (1, True)
    code, _, err = tell("mosaic", *quiet, "--res", 1, "--exclude", "c.tif", "-o", out)
    assert (code, "--exclude: 'c.tif' is no image of this mosaic" in err) == (1, True)


def test_an_image_that_is_left_out_shows_nothing(tell, quiet, tmp_path):
    out = tmp_path / "out.tif"
    assert tell("mosaic", *quiet, "--res", 1, "--exclude", "b.tif", "-o", out)[0] == 0
    with rasterio.open(out.with_name("out-labels.tif")) as labels:
        assert np.unique(labels.read(1)).tolist() == [0, 1]
        assert (labels.read(1) == 1).sum() == WIDTH * HEIGHT


def test_marks_and_borders_of_film_are_never_used(tell, quiet, tmp_path):
    marked = []
    for number, file in enumerate(quiet):
        with rasterio.open(file) as dataset:
            values, profile = dataset.read(), dataset.profile
        values[:, :30], values[:, -30:], values[:, :, :30], values[:, :, -30:] = 255, 255, 255, 255  # the border
        values[:, 180:240, 30:60] = 255  # a clock
        marked.append(tmp_path / f"film{number}.tif")
        with rasterio.open(marked[-1], "w", **profile) as dataset:
            dataset.write(values)
    for seams in ("nearest", "graph-cut"):
        out = tmp_path / f"{seams}.tif"
        words = ("--res", 1, "--margin", 31, "--seams", seams, "-o", out)
        assert tell("mosaic", *marked, *words)[0] == 0
        with rasterio.open(out) as mosaic:
            assert mosaic.height == HEIGHT - 62
            left, shown = mosaic.read()[:, :, :40], mosaic.read()[:, :, 40:]
        assert (left == 255).any()  # the clock, which the margin does not cut off
        assert shown.max() < 250
    table = tmp_path / "usable.csv"
    corners = [(31, 31), (569, 31), (569, 389), (31, 389), (31, 245), (65, 245), (65, 175), (31, 175)]
    table.write_text("image,col,row\n" + "".join(f"*,{c},{r}\n" for c, r in corners))
    out = tmp_path / "polygon.tif"
    assert tell("mosaic", *marked, "--res", 1, "--usable", table, "-o", out)[0] == 0
    with rasterio.open(out) as mosaic:
        assert mosaic.read().max() < 250
        assert mosaic.dataset_mask()[150, 5] == 0
    for text, said in (
        ("image,col,row\n*,1,1\n*,9,9\n", "has 2 corners"),
        ("image,col,row\n*,1,1\n*,9,9\n*,9,1\n*,1,9\n", "crosses itself"),
        ("image,col,row\n*,-9,-9\n*,-5,-9\n*,-5,-1\n", "lies outside of 'film0.tif'"),
    ):
        table.write_text(text)
        code, _, err = tell("mosaic", *marked, "--res", 1, "--usable", table, "-o", tmp_path / "bad.tif")
        assert (code, said in err) == (1, True), err
    code, _, err = tell("mosaic", *marked, "--res", 1, "--margin", 300, "-o", tmp_path / "bad.tif")
    assert (code, "leaves nothing" in err) == (1, True)
