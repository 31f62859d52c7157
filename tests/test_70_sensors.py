"""One mosaic of several sensors: each pixel from the image that a rule names, in its place, in the colours of all.

Photos, a line scanner's scene and an old raster of one analytic land (`sensors_rig`): bands in other orders, pixels of
2, 5 and 2.5 m, of 2024, 2019 and 1985.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mosaic_rig
import numpy as np
import pytest
import rasterio
import sensors_rig as rig
from affine import Affine
from pyproj import CRS

import geomosaic as gm
from geomosaic.block import Footprint, OrientedImage
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.inputs.build import build_block, join_blocks
from geomosaic.inputs.declarations import on_ground
from geomosaic.jobs.project import run_project
from geomosaic.mosaicking.precedence import cloud_cover, image_order, image_ranks
from geomosaic.options.mosaic import RuleOptions
from geomosaic.render.extent import footprints

BANDS = ("red", "green", "nir")
PIXEL = 5.0
BOUNDS = (399_400.0, 5_499_600.0, 400_600.0, 5_500_400.0)


@pytest.fixture(scope="module")
def placed(tmp_path_factory: pytest.TempPathFactory) -> rig.Sensors:
    """Pixels that say where they lie: red is east, green north, infrared height."""
    return rig.write_sensors(
        tmp_path_factory.mktemp("placed"), rig.coordinates, dtype="float32", old_bands=("green", "nir", "red")
    )


@pytest.fixture(scope="module")
def coloured(tmp_path_factory: pytest.TempPathFactory) -> rig.Sensors:
    """Colours of the land; the scene at another exposure, the old raster panchromatic."""
    return rig.write_sensors(
        tmp_path_factory.mktemp("coloured"), rig.colours, later=lambda xy: 0.7 * rig.colours(xy) + 25.0
    )


def blocks(of: rig.Sensors, **of_old: Any) -> list[gm.Block]:
    """The three sensors, scene first."""
    given = {"crs": rig.CRS, "heights": "egm96", "band_names": BANDS}
    return [
        gm.Block(of.scene, "pushbroom", band_names=BANDS, cloud_cover=3.0),
        gm.Block(
            of.photos, "frame", camera=of.folder / "camera.toml", exterior=of.folder / "exterior.csv", cloud_cover=20.0,
            **given,
        ),
        gm.Block(of.old, **{"band_names": BANDS, "acquired": "1985-07-12", "cloud_cover": 10.0, **of_old}),
    ]  # fmt: skip


def mosaic(of: rig.Sensors, out: Path, *, images: list[gm.Block] | None = None, **options: Any) -> gm.MosaicResult:
    """Mosaic over the rig's DEM, nothing balanced unless asked."""
    hard = {} if "rule" in options else {"blend": "none"}
    return gm.mosaic(
        images or blocks(of), out, dem=of.folder / "dem.tif", dem_heights="egm96", dst_crs=rig.CRS, resolution=PIXEL,
        bounds=BOUNDS, **{"balance": False, "stac": False, "overwrite": True, **hard, **options},
    )  # fmt: skip


def pixels(out: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values (rows, cols, bands), labels (rows, cols), and places (rows, cols, 2) of the pixels."""
    with rasterio.open(out) as file, rasterio.open(out.with_name(f"{out.stem}-labels.tif")) as labels:
        col, row = np.meshgrid(np.arange(file.width) + 0.5, np.arange(file.height) + 0.5)
        x, y = file.transform @ (col, row)
        return np.moveaxis(file.read(), 0, 2), labels.read(1), np.dstack([x, y])


NAMES = ("IMAGERY.tif", "strip1_01.tif", "strip1_02.tif", "old.tif")
SCENE, PHOTOS, OLD = (0,), (1, 2), (3,)
# The scene is of February 2019, the photos of July 2024, the old raster of July 1985.
ORDERS: list[tuple[dict[str, Any], tuple[tuple[int, ...], ...]]] = [
    ({"order": "sensor"}, (SCENE, PHOTOS, OLD)),
    ({"order": "list"}, ((0, 1, 2, 3),)),
    ({"order": "resolution"}, ((2,), (1,), OLD, SCENE)),
    ({"order": "date"}, (PHOTOS, SCENE, OLD)),
    ({"order": "oldest"}, (OLD, SCENE, PHOTOS)),
    ({"order": "day", "day": "2018-01-01"}, (SCENE, PHOTOS, OLD)),
    ({"order": "season", "day": "12-20"}, (SCENE, OLD, PHOTOS)),
    ({"order": "season", "day": "2000-07-12"}, (OLD, PHOTOS, SCENE)),
    ({"order": "cloud"}, (SCENE, OLD, PHOTOS)),
    ({"order": "cloud", "base": "IMAGERY"}, (OLD, PHOTOS, SCENE)),
    ({"order": ("date", "name")}, ((1,), (2,), SCENE, OLD)),
]


@pytest.fixture(scope="module")
def built(placed: rig.Sensors) -> tuple[Any, Any]:
    """Scenes and outlines of the block."""
    parts = [on_ground(part, placed.folder / "dem.tif", "egm96") for part in blocks(placed)]
    block = join_blocks(parts, [build_block(part) for part in parts])
    return block.scenes, footprints(block.scenes, block.surface, CRS(rig.CRS))


@pytest.mark.parametrize(("given", "wanted"), ORDERS, ids=lambda value: str(value) if isinstance(value, dict) else "")
def test_images_are_ranked_by_what_is_declared_of_them_or_their_files_say(
    given: dict[str, Any], wanted: tuple[tuple[int, ...], ...], built: tuple[Any, Any]
) -> None:
    ranks = image_ranks(*built, RuleOptions(**given))
    assert ranks == [next(rank for rank, images in enumerate(wanted) if i in images) for i in range(4)]


def within(areas: np.ndarray) -> np.ndarray:
    """Pixels two or more from the border of an area (rows, cols): those at an image's edge are held there."""
    found = np.ones(areas.shape, dtype=bool)
    for shift, axis in ((-2, 0), (2, 0), (-2, 1), (2, 1)):
        found &= areas == np.roll(areas, shift, axis)
    return found


# Images of the map of Stadthagen: day of exposure, metres per pixel (Müller, Sauleda, section 6 and table 1).
STADTHAGEN = {
    "HAAP": ("1982-06-03", 3.4), "KFA 1000": ("1986-08-06", 6.8),
    "LANDSAT TM": ("1984-04-25", 30.0), "SPOT": ("1986-05-18", 20.0),
}  # fmt: skip


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ({"order": "resolution"}, "HAAP, KFA 1000, SPOT, LANDSAT TM"),
        ({"order": "date"}, "KFA 1000, SPOT, LANDSAT TM, HAAP"),
        ({"order": "season", "day": "05-10"}, "SPOT, LANDSAT TM, HAAP, KFA 1000"),
        ({"order": "day", "day": "1984-01-01"}, "LANDSAT TM, HAAP, SPOT, KFA 1000"),
        ({"order": "oldest", "rule": "last", "base": "KFA 1000"}, "SPOT, LANDSAT TM, HAAP, KFA 1000"),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_the_four_images_of_stadthagen_are_laid_in_the_order_of_their_dates_and_pixels(
    given: dict[str, Any], wanted: str
) -> None:
    model: Any = None
    scenes = [OrientedImage(name, "", "", model, acquired=day) for name, (day, _) in STADTHAGEN.items()]
    outlines = [Footprint(name, np.zeros((4, 2)), (0.0, 0.0), size, True) for name, (_, size) in STADTHAGEN.items()]
    order = image_order(scenes, outlines, RuleOptions(**given))
    assert ", ".join(scenes[i].name for i in order) == wanted


MADE: list[Any] = [
    ({"order": "sensor", "seams": "nearest"}, (SCENE, PHOTOS, OLD)),
    pytest.param({"order": "season", "day": "07-12", "seams": "order"}, (OLD, PHOTOS, SCENE), marks=pytest.mark.slow),
    pytest.param({"order": "resolution", "seams": "halve"}, (PHOTOS, OLD, SCENE), marks=pytest.mark.slow),
    ({"order": "oldest", "rule": "last", "base": "IMAGERY"}, (PHOTOS, OLD, SCENE)),
]


@pytest.mark.parametrize(("options", "wanted"), MADE, ids=lambda value: str(value) if isinstance(value, dict) else "")
def test_each_pixel_comes_from_the_sensor_that_the_order_names_and_lies_true(
    options: dict[str, Any], wanted: tuple[tuple[int, ...], ...], placed: rig.Sensors, tmp_path: Path
) -> None:
    """Within a tenth of a pixel of its image; who shows a place follows from cameras and outlines alone."""
    mosaic(placed, tmp_path / "m.tif", **options)
    values, labels, places = pixels(tmp_path / "m.tif")
    expected = np.full(labels.shape, -1)
    rank_of = np.full(len(NAMES) + 1, -1)
    for rank, images in reversed(list(enumerate(wanted))):
        shown = np.any([placed.shows[NAMES[i]](places.reshape(-1, 2)) for i in images], axis=0)
        expected[shown.reshape(labels.shape)] = rank
        rank_of[[i + 1 for i in images]] = rank
    assert all((expected == rank).sum() > 300 for rank in range(3))
    same = rank_of[labels] == expected
    assert same.mean() > 0.98
    assert same[within(expected)].all()
    seen = (labels > 0) & within(labels)
    off = np.hypot(*(values[..., :2] - (places - np.array(rig.GROUND.origin)))[seen].T)
    gsd = np.array([rig.SCENE_GSD, rig.PHOTO_GSD, rig.PHOTO_GSD, rig.OLD_GSD])[labels[seen] - 1]
    assert (off / gsd).max() < 0.1


def truth(names: tuple[str, ...], places: np.ndarray) -> np.ndarray:
    """Colours (rows, cols, bands) of the land, grey values."""
    found = rig.colours(places.reshape(-1, 2)).reshape(*places.shape[:2], 4)
    return found[..., [rig.PHOTO_BANDS.index(name) for name in names]]


def test_colours_are_matched_between_sensors_and_a_panchromatic_image_stays_grey(
    coloured: rig.Sensors, tmp_path: Path
) -> None:
    """The scene has 0.7 times the values, and 25 more; the old raster fills what the others leave."""
    out = tmp_path / "m.tif"
    with pytest.warns(GeomosaicWarning, match=r"old\.tif: one band beside images of 3, .* no image of several bands"):
        made = mosaic(coloured, out, balance=True, colour="gain", master="strip1_01.tif", order="sensor")
    values, labels, places = pixels(out)
    true = truth(BANDS, places)
    for label in (1, 2, 3):
        here = (labels == label) & within(labels)
        if here.any():
            assert np.sqrt(((values[here] - true[here]) ** 2).mean()) < 4.0
    grey = labels == 4
    xy = places[grey]
    assert grey.sum() > 3000
    assert np.ptp(values[grey], axis=1).max() == 0
    # Outlines have a hundred points: a pixel at the edge may belong to either.
    assert np.any([coloured.shows[name](xy) for name in NAMES[1:3]], axis=0).mean() < 0.002
    inside = within(labels) & grey
    assert np.corrcoef(values[inside][:, 0], true[inside].mean(axis=1))[0, 1] > 0.8
    assert abs(values[inside].mean() - true[inside].mean()) < 6.0
    assert any("old.tif: grey values times" in note for note in made.balance.notes)


def test_a_raster_of_another_season_is_left_out_of_the_balance_and_the_photos_keep_theirs(
    coloured: rig.Sensors, tmp_path: Path
) -> None:
    """Fields that are bright in one are dark in the other: no gain brings them together."""
    step, left, top = 8.0, rig.GROUND.origin[0] - 480.0, rig.GROUND.origin[1] + 320.0
    col, row = np.meshgrid(np.arange(120) + 0.5, np.arange(80) + 0.5)
    seen = 295.0 - rig.colours(np.column_stack([left + step * col.ravel(), top - step * row.ravel()]))
    place = Affine(step, 0.0, left, 0.0, -step, top)
    raster = rig.write(
        tmp_path / "winter.tif", 0.5 * seen.reshape(80, 120, 4), rig.PHOTO_BANDS, "uint8", crs=rig.CRS, transform=place
    )
    images = [gm.Block(raster, band_names=BANDS), blocks(coloured)[1]]
    made = mosaic(coloured, tmp_path / "m.tif", images=images, balance=True, colour="gain", blend="none")
    assert any("too different for one colour balance" in note for note in made.balance.notes)
    assert np.array_equal(made.balance.gain[0], np.ones(3))


def flat(path: Path, values: tuple[float, ...], col: float = 0.0, **more: Any) -> Path:
    """A raster of 60 x 40 pixels of 1 m with the same values everywhere but for a faint pattern."""
    pattern = np.arange(40 * 60).reshape(40, 60, 1) % 7
    return mosaic_rig.write(path, (np.array(values) + pattern).astype(np.uint8), col, **more)


def test_panchromatic_images_are_mixed_in_or_refused_if_wanted(tmp_path: Path) -> None:
    out, tags = tmp_path / "out.tif", {"photometric": "MINISBLACK"}
    three = flat(tmp_path / "three.tif", (90, 120, 60))
    one = flat(tmp_path / "one.tif", (200,), 30.0, **tags)

    def shown(**options: Any) -> np.ndarray:
        with pytest.warns(GeomosaicWarning, match="one band beside images of 3"):
            mosaic_rig.run([one, three], out, **options)
        return mosaic_rig.read(out)[0][20]

    for options in ({}, {"rule": "first"}, {"rule": "last"}, {"seams": "graph-cut"}, {"seams": "order"}):
        row = shown(**options)
        assert (row[:58, 0] < 100).all()
        assert (row[61:] >= 200).all()
    for options in ({"rule": "first"}, {"seams": "order", "blend": "none"}):
        row = shown(panchromatic="mix", **options)
        assert (row[31:] >= 200).all()
    with pytest.raises(InputError, match="the image has one band, others have 3"):
        mosaic_rig.run([one, three], out, panchromatic="refuse")
    with pytest.raises(InputError, match=r"`rule=mean` mixes all images, and 'one.tif' has one band"):
        mosaic_rig.run([one, three], out, rule="mean")
    # One band that is said to be of a colour stands for no other.
    flat(tmp_path / "one.tif", (200,), 30.0, descriptions=("nir",), **tags)
    with pytest.raises(InputError, match=r"has 3 bands, 'one\.tif' has 1 band"):
        mosaic_rig.run([one, three], out)


def test_a_panchromatic_image_fills_gaps_of_a_colour_image_to_the_pixel(tmp_path: Path) -> None:
    """A slanting edge and a hole of missing pixels, which seams follow in cells only."""
    row, col = np.mgrid[0:600, 0:800]
    known = (col + 0.4 * row < 650) & (np.hypot(col - 200, row - 300) > 40.0)
    colour = np.where(known[..., None], [90.0, 120.0, 60.0], 0.0).astype(np.uint8)
    three = mosaic_rig.write(tmp_path / "three.tif", colour, nodata=0)
    one = mosaic_rig.write(tmp_path / "one.tif", np.full((600, 800, 1), 200, np.uint8), photometric="MINISBLACK")
    with pytest.warns(GeomosaicWarning, match="one band beside images of 3"):
        mosaic_rig.run([one, three], tmp_path / "out.tif")
    values = mosaic_rig.read(tmp_path / "out.tif")[0]
    assert (values[known] == [90, 120, 60]).all()
    assert (values[~known] == 200).all()


def cloudy(folder: Path, name: str, mask: np.ndarray, **more: Any) -> gm.Block:
    """A raster and its cloud mask, as a block."""
    path = flat(folder / f"{name}.tif", (90, 120, 60), **more)
    mosaic_rig.write(folder / f"{name}-clouds.tif", mask[..., None].astype(np.uint8))
    return gm.Block(path, clouds=str(folder / "{image}-clouds.tif"), cloud_values=(8, 9))


@pytest.mark.parametrize("options", [{"rule": "first"}, {"blend": "none"}], ids=str)
def test_nothing_under_a_cloud_is_shown_where_another_image_is_clear(options: dict[str, Any], tmp_path: Path) -> None:
    """Masks in pixels twice as large, of whose values some are clouds; what all clouds hide stays empty."""
    first, second = np.full((20, 30), 4), np.zeros((20, 30))
    first[4:12, 6:20], second[8:16, 15:28] = 8, 9
    parts = [cloudy(tmp_path, "a", first), cloudy(tmp_path, "b", second)]
    assert [round(cloud_cover(build_block(part).scenes[0]), 3) for part in parts] == [18.667, 17.333]
    gm.mosaic(parts, tmp_path / "m.tif", stac=False, balance=False, **options)
    _, labels, _ = pixels(tmp_path / "m.tif")
    hidden = [np.kron(mask > 7, np.ones((2, 2), dtype=bool)) for mask in (first, second)]
    assert (labels[hidden[0] & ~hidden[1]] == 2).all()
    assert (labels[hidden[1] & ~hidden[0]] == 1).all()
    assert (labels[hidden[0] & hidden[1]] == 0).all()
    assert (labels[~hidden[0] | ~hidden[1]] > 0).all()
    # The least clouded first.
    gm.mosaic(parts, tmp_path / "m.tif", stac=False, rule="first", order="cloud", overwrite=True)
    assert (pixels(tmp_path / "m.tif")[1][~hidden[1]] == 2).all()


def test_a_cloud_mask_of_another_view_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"the cloud mask has 30 x 30 pixels, the image 60 x 40"):
        build_block(cloudy(tmp_path, "a", np.zeros((30, 30))))


def test_images_without_a_date_or_a_share_of_cloud_are_named(tmp_path: Path) -> None:
    files = [flat(tmp_path / "a.tif", (9, 9, 9)), flat(tmp_path / "b.tif", (9, 9, 9), 20.0)]
    for order, told in (("oldest", "`acquired`"), ("cloud", "`cloud_cover`")):
        with pytest.raises(InputError, match="does not say") as caught:
            mosaic_rig.run(files, tmp_path / "m.tif", order=order)
        assert told in caught.value.hint
    with pytest.raises(InputError, match="all images are of one block"):
        mosaic_rig.run(files, tmp_path / "m.tif", order="sensor")
    for given, why in (
        ({"order": "season"}, "no day to count from"), ({"order": "day", "day": "07-12"}, "needs a year"),
        ({"order": "newest"}, "no order is named 'newest'"), ({"order": "season", "day": "13-40"}, "is no day"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=why):
            RuleOptions(**given)
    with pytest.raises(InputError, match="is no day"):
        gm.Block(files[0], acquired="12.7.1985")


@pytest.mark.filterwarnings("ignore::geomosaic.errors.GeomosaicWarning")
def test_a_project_of_three_sensors_makes_the_same_mosaic_as_the_library(coloured: rig.Sensors, tmp_path: Path) -> None:
    file = coloured.folder / "block.toml"
    file.write_text(
        f"""format = 1
[project]
name = "all"
images = ["strip1_*.tif"]
band_names = "red,green,nir"
cloud_cover = 20.0
{coloured.tables}
[[images]]
path = "scene/IMAGERY.tif"
sensor = "pushbroom"
declared_bands = ["nir", "646nm", "green"]
cloud_cover = 3.0
[[images]]
path = "old.tif"
sensor = "planar"
acquired = "1985-07-12"
cloud_cover = 10.0
[output]
crs = "{rig.CRS}"
resolution = {PIXEL}
bounds = {list(BOUNDS)}
[mosaic]
order = "cloud,date"
seam_quality = false
"""
    )
    done = run_project(file)
    assert not [state for state in run_project(file, dry_run=True).states if not state.fresh]
    options = {"balance": True, "blend": "feather", "order": ("cloud", "date")}
    order = [blocks(coloured)[i] for i in (1, 0, 2)]
    mosaic(coloured, tmp_path / "m.tif", images=order, **options)
    values, labels, _ = pixels(tmp_path / "m.tif")
    of_project = pixels(Path(done.facts["outputs"]["mosaic"]))
    assert np.array_equal(labels, of_project[1])
    assert np.array_equal(values, of_project[0])
    # A day that is declared otherwise makes it stale.
    file.write_text(file.read_text().replace("1985-07-12", "1986-07-12"))
    assert [state.name for state in run_project(file, dry_run=True).states if not state.fresh]
