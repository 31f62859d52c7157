"""`geomosaic reproject`: rasters and vectors to another CRS, against independent ways to the same places."""

from __future__ import annotations

import json
import re
import warnings
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pyproj
import pytest
import rasterio
import shapely
from affine import Affine
from PIL import Image
from rasterio.warp import Resampling, reproject

LAMBERT, UTM = "EPSG:2154", "EPSG:32631"
LEFT, TOP, SIZE = 770_500.0, 6_277_700.0, 260


def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Ground as a function of Lambert coordinates, smooth enough for bilinear values to be nearly exact."""
    waves = [np.sin((x - LEFT) / 23.0 + k) + np.cos((y - TOP) / 31.0 - k) for k in (0.0, 1.0)]
    return np.stack([6000 * wave + 30000 for wave in waves])


@pytest.fixture
def lambert(tmp_path) -> Path:
    path = tmp_path / "lambert.tif"
    transform = Affine(1.0, 0.0, LEFT, 0.0, -1.0, TOP)
    c, r = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    x, y = transform @ (c, r)
    profile = {"driver": "GTiff", "width": SIZE, "height": SIZE, "count": 2, "dtype": "uint16", "crs": LAMBERT}
    with rasterio.open(path, "w", transform=transform, **profile) as dataset:
        dataset.write(np.round(texture(x, y)).astype(np.uint16))
    return path


def test_lambert_to_utm_shows_the_ground_where_it_is(tell, lambert, tmp_path):
    out = tmp_path / "utm.tif"
    code, said, _ = tell(
        "reproject", lambert, "--dst-crs", UTM, "--res", 1, "--resampling", "cubic", "-o", out, "--json"
    )
    assert code == 0
    facts = json.loads(said)
    assert facts["lattice_error_px"] <= 0.02
    assert "RGF93" in facts["operation"]
    with rasterio.open(out) as dataset:
        values, valid, transform = dataset.read(), dataset.dataset_mask() > 0, dataset.transform
        assert dataset.crs.to_epsg() == 32631
    rows, cols = np.nonzero(valid)
    xy = transform @ (cols + 0.5, rows + 0.5)
    x, y = pyproj.Transformer.from_crs(UTM, LAMBERT, always_xy=True).transform(*xy)
    inside = (x > LEFT + 3) & (x < LEFT + SIZE - 3) & (y < TOP - 3) & (y > TOP - SIZE + 3)
    miss = values[:, rows[inside], cols[inside]] - texture(x[inside], y[inside])
    assert inside.sum() > 0.9 * SIZE**2
    assert np.abs(miss).max() < 10  # of 12 000: half a value of rounding and less than 0.02 px of 260 values per pixel


def test_like_takes_the_grid_of_another_raster_and_agrees_with_gdal(tell, lambert, tmp_path):
    model, out = tmp_path / "model.tif", tmp_path / "o.tif"
    x, y = pyproj.Transformer.from_crs(LAMBERT, UTM, always_xy=True).transform(LEFT + 60, TOP - 60)
    turned = Affine.translation(x, y) @ Affine.rotation(12.0) @ Affine.scale(1.5, -1.5)
    profile = {"driver": "GTiff", "width": 70, "height": 50, "count": 1, "dtype": "uint8", "crs": UTM}
    with rasterio.open(model, "w", transform=turned, **profile) as dataset:
        dataset.write(np.zeros((1, 50, 70), dtype=np.uint8))
    assert tell("reproject", lambert, "--like", model, "-o", out)[0] == 0
    with rasterio.open(out) as mine, rasterio.open(lambert) as source:
        assert mine.transform.almost_equals(turned)
        assert (mine.width, mine.height) == (70, 50)
        theirs = np.zeros((2, 50, 70), dtype=np.float64)
        reproject(
            rasterio.band(source, [1, 2]), theirs, dst_transform=turned, dst_crs=UTM, resampling=Resampling.bilinear,
            tolerance=0.0,
        )  # fmt: skip
        seen = (mine.dataset_mask() > 0) & (theirs > 0).all(axis=0)
        assert seen.sum() > 3000
        # GDAL widens bilinear where pixels grow by half; ours samples.
        assert np.abs(mine.read() - theirs)[:, seen].max() < 30


def test_rasters_of_several_pixel_sizes_become_the_bands_of_one(tell, tmp_path):
    rng = np.random.default_rng(3)
    names, sizes = ("B01", "B02", "B03", "B05"), (6.0, 1.0, 1.0, 2.0)
    for name, pixel in zip(names, sizes, strict=True):
        side = round(180 / pixel)
        values = rng.integers(1, 9000, (1, side, side), dtype=np.uint16)
        values[0, : side // 4, : side // 3] *= name != "B03"  # nodata in one of them only
        place = Affine(pixel, 0.0, LEFT, 0.0, -pixel, TOP)
        profile = {"driver": "GTiff", "count": 1, "dtype": "uint16", "crs": LAMBERT, "transform": place, "nodata": 0}
        with rasterio.open(tmp_path / f"{name}.tif", "w", width=side, height=side, **profile) as dataset:
            dataset.write(values)
    paths, stack, alone = [tmp_path / f"{name}.tif" for name in names], tmp_path / "stack.tif", tmp_path / "alone.tif"
    code, said, err = tell("reproject", *paths, "--dst-crs", UTM, "-o", stack, "--json")
    assert (code, err) == (0, "")
    assert json.loads(said)["operation"].count("RGF93 v1 / Lambert-93 to") == 1
    with rasterio.open(stack) as dataset:
        assert dataset.descriptions == names
        assert dataset.res == (1.0, 1.0)
        values, valid = dataset.read(), dataset.dataset_mask() > 0
    everywhere = np.ones_like(valid)
    for path, band in zip(paths, values, strict=True):
        assert tell("reproject", path, "--like", stack, "-o", alone, "--overwrite")[0] == 0
        with rasterio.open(alone) as dataset:
            everywhere &= dataset.dataset_mask() > 0
            assert np.array_equal(band[valid], dataset.read(1)[valid])
    assert 0.8 < valid.mean() < 0.92
    assert np.array_equal(valid, everywhere)
    assert not values[:, ~valid].any()


def test_files_that_cannot_be_the_bands_of_one_raster_are_refused(tell, lambert, tmp_path):
    def other(name, dtype, left):
        place = Affine(1.0, 0.0, left, 0.0, -1.0, TOP)
        profile = {"driver": "GTiff", "width": 50, "height": 50, "count": 1, "dtype": dtype, "crs": LAMBERT}
        with rasterio.open(tmp_path / name, "w", transform=place, **profile) as dataset:
            dataset.write(np.full((1, 50, 50), 7, dtype=dtype))
        return tmp_path / name

    (tmp_path / "roads.gpkg").touch()
    far, wide, signed = (
        other("far.tif", "uint16", LEFT + 900),
        other("u.tif", "uint32", LEFT),
        other("i.tif", "int32", LEFT),
    )
    for files, said in (
        ((lambert, far), "shown by all images"),
        ((wide, signed), "no sample type holds the values of int32 and uint32"),
        ((lambert, tmp_path / "roads.gpkg"), "roads.gpkg: this is a file of vectors"),
    ):
        code, _, err = tell("reproject", *files, "--dst-crs", UTM, "-o", tmp_path / "o.tif")
        assert code == 1
        assert said in err
        assert not (tmp_path / "o.tif").exists()


def test_the_bytes_do_not_depend_on_how_a_file_stores_its_bands(tell, lambert, tmp_path):
    made = set()
    for interleave in ("band", "pixel"):
        for more in ({"tiled": True, "blockxsize": 64, "blockysize": 64}, {"compress": "deflate"}):
            with rasterio.open(lambert) as dataset:
                profile, values = dataset.profile, dataset.read()
            stored, out = tmp_path / "stored.tif", tmp_path / "out.tif"
            with rasterio.open(stored, "w", **{**profile, "interleave": interleave, **more}) as dataset:
                dataset.write(values)
            words = ("--dst-crs", UTM, "--resampling", "cubic", "--overwrite")
            assert tell("reproject", stored, *words, "-o", out)[0] == 0
            made.add(out.read_bytes())
    assert len(made) == 1


def test_bounds_are_widened_to_aligned_pixels_on_demand(tell, lambert, tmp_path):
    x, y = pyproj.Transformer.from_crs(LAMBERT, UTM, always_xy=True).transform(LEFT + 100, TOP - 100)
    bounds = (x - 30.3, y - 20.2, x + 30.1, y + 20.4)
    for flag, aligned in ((), False), (("--target-aligned-pixels",), True):
        out = tmp_path / f"{aligned}.tif"
        assert tell("reproject", lambert, "--dst-crs", UTM, "--res", 2, "--bounds", *bounds, *flag, "-o", out)[0] == 0
        with rasterio.open(out) as dataset:
            assert (dataset.bounds.left % 2 == 0) == aligned
            assert (dataset.bounds.top % 2 == 0) == aligned
            assert dataset.bounds.left <= bounds[0]
            assert dataset.bounds.right >= bounds[2]


def test_a_crs_that_is_not_what_it_says(tell, lambert, tmp_path):
    odd = tmp_path / "odd.tif"
    wkt = pyproj.CRS(LAMBERT).to_wkt("WKT1_GDAL").replace("RGF93 v1 / Lambert-93", "EPSG:2154")
    wkt = wkt.replace('DATUM["Reseau_Geodesique_Francais_1993_v1"', 'DATUM["unknown"')
    wkt = re.sub(r',AUTHORITY\["EPSG","\d+"\]', "", wkt)
    with rasterio.open(lambert) as source:
        profile, values = {**source.profile, "crs": rasterio.crs.CRS.from_wkt(wkt)}, source.read()
    with rasterio.open(odd, "w", **profile) as dataset:
        dataset.write(values)
    _, _, err = tell("reproject", odd, "--dst-crs", UTM, "-o", tmp_path / "o.tif")
    assert "--src-crs EPSG:2154" in err
    code, _, err = tell("reproject", odd, "--src-crs", LAMBERT, "--dst-crs", UTM, "-o", tmp_path / "p.tif")
    assert (code, err) == (0, "")


def test_vectors_keep_their_attributes_and_layers(tell, tmp_path):
    roads = gpd.GeoDataFrame(
        {"name": ["a", "é"], "width": [3.5, None]},
        geometry=[shapely.LineString([(LEFT, TOP), (LEFT + 50, TOP - 70)]), shapely.Point(LEFT, TOP).buffer(9)],
        crs=LAMBERT,
    )
    wells = gpd.GeoDataFrame({"depth": [4]}, geometry=[shapely.Point(LEFT, TOP, 120.0)], crs=LAMBERT)
    path, out = tmp_path / "in.gpkg", tmp_path / "out.gpkg"
    roads.to_file(path, layer="roads")
    wells.to_file(path, layer="wells")
    code, said, _ = tell("reproject", path, "--dst-crs", UTM, "-o", out, "--json")
    assert code == 0
    assert json.loads(said)["layers"] == {"roads": 2, "wells": 1}
    for name, before in (("roads", roads), ("wells", wells)):
        after = gpd.read_file(out, layer=name)
        assert after.crs == UTM
        expected = before.to_crs(UTM)
        assert all(a.equals_exact(b, 1e-6) for a, b in zip(after.geometry, expected.geometry, strict=True))
        assert (after.has_z == before.has_z).all()
        if name == "wells":
            assert after.geometry[0].z == 120.0
        plain = [column for column in before if column != "geometry"]
        assert after[plain].astype(object).equals(before[plain].astype(object)) or after[plain].equals(before[plain])
    first = out.read_bytes()
    assert tell("reproject", path, "--dst-crs", UTM, "-o", out, "--overwrite")[0] == 0
    assert out.read_bytes() == first
    code, _, err = tell("reproject", path, "--dst-crs", UTM, "-o", tmp_path / "o.geojson")
    assert code == 1
    assert "2 layers" in err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in.gpkg", "out.gpkg"]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ((), 1, "--dst-crs or --like"),
        (("--like", "m.tif", "--res", "2"), 1, "leave out --res or --like"),
        (("--dst-crs", "EPSG:99999"), 2, "99999"),
    ],
)
def test_wrong_words_are_refused_with_their_exit_code(tell, lambert, tmp_path, words, code, said):
    got, _, err = tell("reproject", lambert, *words, "-o", tmp_path / "o.tif")
    assert got == code
    assert said in err


@pytest.mark.parametrize("lines", ["2 2 2 2", "2 1e6 0 -2", "2 0 1e5 -2"])
def test_a_world_file_whose_pixels_are_flat_is_refused_at_once(tell, tmp_path, lines):
    """Rotations in degrees, or lines in another order: the output would be without end, or empty."""
    Image.fromarray(np.full((20, 30), 7, np.uint8)).save(tmp_path / "a.png")
    (tmp_path / "a.pgw").write_text("\n".join([*lines.split(), "500000", "5500000"]))
    code, _, err = tell("reproject", tmp_path / "a.png", "--src-crs", UTM, "--dst-crs", UTM, "-o", tmp_path / "o.tif")
    assert code == 1
    assert "nearly on one line" in err
    assert "check the world file" in err


def test_a_turned_world_file_needs_no_resolution(tell, tmp_path):
    Image.fromarray(np.full((20, 30), 7, np.uint8)).save(tmp_path / "a.png")
    (tmp_path / "a.pgw").write_text("1.7\n1\n1\n-1.7\n500000\n5500000\n")
    code, out, _ = tell("reproject", tmp_path / "a.png", "--src-crs", UTM, "--dst-crs", UTM, "-o", tmp_path / "o.tif")
    assert code == 0
    assert "of 2 metre" in out


def test_input_without_georeferencing_is_reported(tell, tmp_path):
    path = tmp_path / "p.geojson"
    shape = gpd.GeoDataFrame({"n": [1, 2]}, geometry=[shapely.Point(3.0, 45.0), shapely.Point(3.0, 95.0)], crs=4326)
    shape.to_file(path)
    code, out, _ = tell("reproject", path, "--dst-crs", UTM, "-o", tmp_path / "o.fgb")
    assert code == 0
    assert "left out, without a place in" in out
    metres = tmp_path / "metres.geojson"
    gpd.GeoDataFrame({"n": [1]}, geometry=[shapely.Point(LEFT, TOP)], crs=4326).to_file(metres)
    code, _, err = tell("reproject", metres, "--dst-crs", UTM, "-o", tmp_path / "p.gpkg")
    assert code == 1
    assert "none of the features has a place" in err
    assert not (tmp_path / "p.gpkg").exists()
    bare = tmp_path / "bare.gpkg"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gpd.GeoDataFrame({"n": [1, 2]}, geometry=list(shape.geometry)).to_file(bare)
    code, _, err = tell("reproject", bare, "--dst-crs", UTM, "-o", tmp_path / "q.gpkg")
    assert code == 1
    assert "--src-crs" in err


def test_a_shapefile_is_written_whole(tell, tmp_path):
    """Places, attributes and CRS are those of the GeoPackage; what it cannot keep is told; an older one goes whole."""
    before = gpd.GeoDataFrame(
        {"name": ["a", "é"], "population_of_town": [3, 4]},
        geometry=[shapely.Point(LEFT, TOP), shapely.Point(LEFT + 5, TOP)], crs=LAMBERT,
    )  # fmt: skip
    path, out = tmp_path / "in.gpkg", tmp_path / "towns.shp"
    before.to_file(path)
    (tmp_path / "towns.qix").write_bytes(b"an index of other towns")
    code, _, err = tell("reproject", path, "--dst-crs", UTM, "-o", out)
    assert code == 0
    assert "populatio" in err
    assert not (tmp_path / "towns.qix").exists()
    after = gpd.read_file(out)
    assert after.crs == UTM
    assert list(after["name"]) == ["a", "é"]
    assert list(after["population"]) == [3, 4]
    assert all(a.equals_exact(b, 1e-6) for a, b in zip(after.geometry, before.to_crs(UTM).geometry, strict=True))
    parts = {part.name: part.read_bytes() for part in tmp_path.glob("towns.*")}
    assert sorted(parts) == ["towns.cpg", "towns.dbf", "towns.prj", "towns.shp", "towns.shx"]
    assert tell("reproject", path, "--dst-crs", UTM, "-o", out)[0] == 1
    assert tell("reproject", path, "--dst-crs", UTM, "-o", out, "--overwrite")[0] == 0
    assert {part.name: part.read_bytes() for part in tmp_path.glob("towns.*")} == parts
    back = tmp_path / "back.shp"
    assert tell("reproject", out, "--dst-crs", LAMBERT, "-o", back)[0] == 0
    assert tell("reproject", back, "--dst-crs", UTM, "-o", back, "--overwrite")[0] == 1
    mixed = tmp_path / "mixed.gpkg"
    lines = [shapely.Point(LEFT, TOP), shapely.LineString([(LEFT, TOP), (LEFT, TOP + 5)])]
    gpd.GeoDataFrame({"n": [1, 2]}, geometry=lines, crs=LAMBERT).to_file(mixed)
    code, _, err = tell("reproject", mixed, "--dst-crs", UTM, "-o", tmp_path / "m.shp")
    assert code == 1
    assert "LineString and Point" in err
    assert not [part for part in tmp_path.iterdir() if "partial" in part.name or part.stem == "m"]


def test_tables_without_places_and_empty_layers(tell, tmp_path):
    """A GeoPackage as QGIS leaves it: styles in a table, a layer with nothing in it yet."""
    path, out = tmp_path / "in.gpkg", tmp_path / "out.gpkg"
    towns = gpd.GeoDataFrame({"name": ["a"]}, geometry=[shapely.Point(LEFT, TOP)], crs=LAMBERT)
    towns.to_file(path, layer="towns")
    towns.iloc[:0].to_file(path, layer="plans")
    styles = pd.DataFrame({"f_table_name": ["towns"], "styleQML": ["<qgis/>"]})
    pyogrio.write_dataframe(styles, path, layer="layer_styles", append=True)
    code, said, err = tell("reproject", path, "--dst-crs", UTM, "-o", out, "--json")
    assert (code, err) == (0, "")
    assert json.loads(said)["layers"] == {"towns": 1, "plans": 0}
    assert list(pyogrio.list_layers(out)[:, 0]) == ["towns", "plans", "layer_styles"]
    assert pyogrio.read_dataframe(out, layer="layer_styles").equals(styles)
    assert gpd.read_file(out, layer="plans").crs == UTM
    one = tmp_path / "one.gpkg"
    towns.to_file(one, layer="towns")
    pyogrio.write_dataframe(styles, one, layer="layer_styles", append=True)
    code, _, err = tell("reproject", one, "--dst-crs", UTM, "-o", tmp_path / "one.geojson")
    assert code == 0
    assert "left out: layer_styles" in err
    bare = tmp_path / "bare.gpkg"
    pyogrio.write_dataframe(styles, bare, layer="layer_styles")
    assert tell("reproject", bare, "--dst-crs", UTM, "-o", tmp_path / "b.gpkg")[0] == 1


def test_options_of_pixels_do_nothing_for_vectors(tell, tmp_path):
    path = tmp_path / "p.geojson"
    gpd.GeoDataFrame({"n": [1]}, geometry=[shapely.Point(3.0, 45.0)], crs=4326).to_file(path)
    for words in (("--res", 5), ("--bounds", 0, 0, 1, 1), ("--resampling", "cubic"), ("--nodata", 0)):
        code, _, err = tell("reproject", path, "--dst-crs", UTM, *words, "-o", tmp_path / "o.gpkg")
        assert code == 1
        assert f"{words[0]} would do nothing" in err
    assert tell("reproject", path, "--dst-crs", UTM, "-o", path, "--overwrite")[0] == 1
    assert tell("reproject", path, "--like", path, "--target-aligned-pixels", "-o", tmp_path / "o.gpkg")[0] == 1


def test_a_raster_without_georeferencing_gets_a_hint(tell, lambert, tmp_path):
    """No CRS, no geotransform, control points instead, metres that call themselves degrees and the other way round."""
    with rasterio.open(lambert) as source:
        profile, values, transform = source.profile, source.read(), source.transform
    degrees = Affine(1e-5, 0, 3.8, 0, -1e-5, 43.6)
    for changes, code, part in (
        ({"crs": None}, 1, "give --src-crs; its coordinates (x 770500 to 770760, y 6277440 to 6277700) are no degrees"),
        ({"crs": None, "transform": degrees}, 1, "could be degrees"),
        ({"crs": "EPSG:4326"}, 1, "are no longitudes and latitudes"),
        ({"transform": degrees}, 0, "look like degrees"),
        ({"transform": Affine.identity()}, 1, "geomosaic georeference"),
    ):
        odd, out = tmp_path / "odd.tif", tmp_path / "o.tif"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with rasterio.open(odd, "w", **{**profile, **changes}) as dataset:
                dataset.write(values)
        got, _, err = tell("reproject", odd, "--dst-crs", UTM, "-o", out, "--overwrite")
        assert (got, part in err) == (code, True)
        if "crs" in changes and "transform" not in changes:
            words = ("reproject", odd, "--src-crs", LAMBERT, "--dst-crs", UTM, "-o", out, "--overwrite")
            assert tell(*words)[::2] == (0, "")
    corners = [rasterio.control.GroundControlPoint(r, c, *(transform @ (c, r))) for r in (0, 260) for c in (0, 260)]
    profile.pop("transform")
    with rasterio.open(odd, "w", **{**profile, "gcps": corners, "crs": LAMBERT}) as dataset:
        dataset.write(values)
    assert "but 4 control points" in tell("reproject", odd, "--dst-crs", UTM, "-o", tmp_path / "q.tif")[2]


def test_bands_keep_their_names_and_the_meaning_of_their_values(tell, lambert, tmp_path):
    out = tmp_path / "o.tif"
    with rasterio.open(lambert, "r+") as dataset:
        dataset.scales, dataset.offsets, dataset.units = (0.1, 0.2), (5.0, -3.0), ("K", "m")
        dataset.set_band_description(1, "heat")
    assert tell("reproject", lambert, "--dst-crs", UTM, "-o", out)[0] == 0
    with rasterio.open(out) as dataset:
        assert (dataset.scales, dataset.offsets, dataset.units) == ((0.1, 0.2), (5.0, -3.0), ("K", "m"))
        assert dataset.descriptions == ("heat", None)


def on_the_globe(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    """Unit vectors: pictures of the globe without a seam in their values."""
    lam, phi = np.radians(lon), np.radians(lat)
    return np.stack([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)])


@pytest.mark.parametrize(
    ("bounds", "crs", "target", "words", "share"),
    [
        # The whole globe, in both countings of longitude, around a pole and across the date line.
        ((-180, -90, 180, 90), "EPSG:4326", "EPSG:3995", (*("--bounds", -4e6, -4e6, 4e6, 4e6), "--res", 5e4), 1.0),
        ((0, -90, 360, 90), "EPSG:4326", "EPSG:3995", (*("--bounds", -4e6, -4e6, 4e6, 4e6), "--res", 5e4), 1.0),
        ((-180, -90, 180, 90), "EPSG:4326", "EPSG:4326", (*("--bounds", 150, -60, 210, 60), "--res", 2), 1.0),
        # Parts of it beside the date line and around a pole, to their own extent.
        ((170, -20, 190, 0), "EPSG:4326", "EPSG:32701", (), 0.95),
        ((600_000, 7_800_000, 1_000_000, 8_200_000), "EPSG:32760", "EPSG:4326", (), 0.95),
        ((-3e6, -3e6, 3e6, 3e6), "EPSG:3995", "EPSG:4326", ("--res", 2), 0.75),
    ],
)
def test_date_line_and_poles(tell, tmp_path, bounds, crs, target, words, share):
    path, out, (wide, tall) = tmp_path / "globe.tif", tmp_path / "o.tif", (180, 120)
    left, bottom, right, top = bounds
    transform = Affine((right - left) / wide, 0, left, 0, (bottom - top) / tall, top)
    x, y = transform @ tuple(np.meshgrid(np.arange(wide) + 0.5, np.arange(tall) + 0.5))
    values = on_the_globe(*pyproj.Transformer.from_crs(crs, 4326, always_xy=True).transform(x, y)).astype("f4")
    profile = {"driver": "GTiff", "width": wide, "height": tall, "count": 3, "dtype": "float32", "crs": crs}
    with rasterio.open(path, "w", transform=transform, **profile) as dataset:
        dataset.write(values)
    code, said, _ = tell("reproject", path, "--dst-crs", target, *words, "-o", out, "--json")
    assert code == 0
    assert json.loads(said)["lattice_error_px"] <= 0.02
    with rasterio.open(out) as dataset:
        shown, valid = dataset.read(), dataset.dataset_mask() > 0
        c, r = np.meshgrid(np.arange(dataset.width) + 0.5, np.arange(dataset.height) + 0.5)
        place = pyproj.Transformer.from_crs(target, 4326, always_xy=True).transform(*(dataset.transform @ (c, r)))
    miss = np.sqrt(((shown - on_the_globe(*place)) ** 2).sum(axis=0))
    assert valid.mean() >= share
    assert miss[valid].max() < 0.02  # half a pixel of 2 degrees at the rims, bilinear values elsewhere
    assert dataset.width * dataset.height < 60_000


def test_every_pixel_exactly(tell, tmp_path):
    """At tolerance 0 the lattice has a node at every pixel: places are PROJ's own."""
    path, out = tmp_path / "colrow.tif", tmp_path / "o.tif"
    c, r = np.meshgrid(np.arange(120) + 0.5, np.arange(120) + 0.5)
    transform = Affine(300.0, 0.0, LEFT, 0.0, -300.0, TOP)  # 36 km: the curves of the two maps differ
    profile = {"driver": "GTiff", "width": 120, "height": 120, "count": 2, "dtype": "float64", "crs": LAMBERT}
    with rasterio.open(path, "w", transform=transform, **profile) as dataset:
        dataset.write(np.stack([c, r]))
    code, said, err = tell("reproject", path, "--dst-crs", UTM, "--res", 300, "--tolerance", 0, "-o", out, "--json")
    assert (code, err) == (0, "")
    assert json.loads(said)["lattice_error_px"] < 1e-7
    with rasterio.open(out) as dataset:
        shown, valid = dataset.read(), dataset.dataset_mask() > 0
        rows, cols = np.nonzero(valid)
        xy = dataset.transform @ (cols + 0.5, rows + 0.5)
    places = pyproj.Transformer.from_crs(UTM, LAMBERT, always_xy=True).transform(*xy)
    true = np.array(~transform @ np.array(places))
    inside = ((true > 0.5) & (true < 119.5)).all(axis=0)
    assert inside.sum() > 10_000
    assert np.abs(shown[:, rows, cols] - true)[:, inside].max() < 1e-6
