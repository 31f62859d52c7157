"""DEMs of every format that is read: written by GDAL, each gives the heights of the same grid as GeoTIFF."""

from __future__ import annotations

import warnings
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from affine import Affine

from geomosaic.errors import HeightDatumError, RasterReadError
from geomosaic.geo.grid import Window
from geomosaic.raster.environment import environment
from geomosaic.raster.formats import FORMATS, READ_DRIVERS
from geomosaic.raster.info import inspect, rasters_among
from geomosaic.raster.source import Source
from geomosaic.surface.dem import Dem

ROWS, COLS = 61, 81
UTM = Affine(10.0, 0.0, 500000.0, 0.0, -10.0, 5400000.0)
# One degree of SRTM3: posts on whole degrees, so that the outer pixels reach half a pixel beyond them.
DEGREE, POSTS = Affine(1 / 1200, 0.0, 15.0 - 1 / 2400, 0.0, -1 / 1200, 51.0 + 1 / 2400), 1201


def heights(rows: int, cols: int) -> np.ndarray:
    """Hills of 100 m, with a pond of unknown heights."""
    y, x = np.mgrid[:rows, :cols]
    values = 400.0 + 60.0 * np.sin(y / rows * 7.0) + 40.0 * np.cos(x / cols * 9.0)
    values[10:14, 20:25] = -9999.0
    return values


def geotiff(path: Path, dtype: str = "float32", *, degree: bool = False) -> Path:
    shape = (POSTS, POSTS) if degree else (ROWS, COLS)
    values = heights(*shape).round(0 if dtype == "int16" else 3).astype(dtype)
    with rasterio.open(
        path, "w", driver="GTiff", width=shape[1], height=shape[0], count=1, dtype=dtype, nodata=-9999,
        crs="EPSG:4326" if degree else "EPSG:32633", transform=DEGREE if degree else UTM,
    ) as dataset:  # fmt: skip
        dataset.write(values, 1)
    return path


# Driver: name of the file, sample type of the GeoTIFF, and the metres by which the format rounds.
WRITTEN = {
    "AAIGrid": ("a.asc", "float32", 0.0),
    "XYZ": ("a.xyz", "float32", 0.0),
    "EHdr": ("a.bil", "float32", 0.0),
    "LAN": ("a.lan", "int16", 0.0),
    "PCIDSK": ("a.pix", "float32", 0.0),
    "netCDF": ("a.nc", "float32", 0.0),
    "HFA": ("a.img", "float32", 0.0),
    "ENVI": ("a.dat", "float32", 0.0),
    "SAGA": ("a.sdat", "float32", 0.0),
    "GSAG": ("a.grd", "float32", 1e-4),
    "GSBG": ("a.grd", "float32", 0.0),
    "GS7BG": ("a.grd", "float32", 0.0),
}


def as_format(driver: str, source: Path, name: str) -> Path:
    path = source.with_name(name)
    with environment(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rasterio.shutil.copy(str(source), str(path), driver=driver)
        if driver == "XYZ":  # which has no CRS of its own: assigned beside it, as the error advises
            path.with_name(f"{path.name}.aux.xml").write_text(
                '<PAMDataset><SRS>EPSG:32633</SRS><PAMRasterBand band="1"><NoDataValue>-9999</NoDataValue>'
                "</PAMRasterBand></PAMDataset>"
            )
    return path


@pytest.mark.parametrize("driver", WRITTEN)
def test_a_dem_gives_the_heights_of_its_geotiff(tmp_path, driver):
    name, dtype, rounding = WRITTEN[driver]
    truth = geotiff(tmp_path / "truth.tif", dtype)
    path = as_format(driver, truth, name)
    assert inspect(path).driver == driver
    xy = np.random.default_rng(3).uniform((499990.0, 5399380.0), (500820.0, 5400010.0), (4000, 2))
    with closing(Dem.open(truth, heights="egm96")) as known, closing(Dem.open(path, heights="egm96")) as read:
        assert read.grid.shape == known.grid.shape
        np.testing.assert_allclose(read.grid.transform[:6], known.grid.transform[:6], rtol=1e-9)
        assert read.crs.to_epsg() == known.crs.to_epsg() or read.grid.crs.to_epsg() == 32633
        expected = known.height(xy)
        np.testing.assert_allclose(read.height(xy), expected, atol=rounding, rtol=1e-6)
        assert np.isnan(expected).any()  # in the pond and outside, in both


@pytest.mark.parametrize(("driver", "name"), [("SRTMHGT", "N50E015.hgt"), ("DTED", "a.dt1"), ("USGSDEM", "a.dem")])
def test_a_dem_of_one_degree_gives_the_heights_of_its_geotiff(tmp_path, driver, name):
    truth = geotiff(tmp_path / "truth.tif", "int16", degree=True)
    with rasterio.open(truth, "r+") as dataset:
        dataset.write(np.where(dataset.read() < 0, 55, dataset.read()))  # each has another value for unknown heights
    if driver == "DTED":  # which has 601 posts along the parallel beyond 50 degrees north
        with rasterio.open(truth) as dataset:
            values, profile = dataset.read(1)[:, ::2], dataset.profile
        profile.update(width=601, transform=Affine(1 / 600, 0.0, 15.0 - 1 / 1200, *DEGREE[3:6]))
        with rasterio.open(truth, "w", **profile) as dataset:
            dataset.write(values, 1)
    path = as_format(driver, truth, name)
    assert inspect(path).driver == driver
    xy = np.random.default_rng(3).uniform((15.0, 50.0), (16.0, 51.0), (4000, 2))
    with closing(Dem.open(truth, heights="egm96")) as known, closing(Dem.open(path, heights="egm96")) as read:
        np.testing.assert_allclose(read.height(xy), known.height(xy), atol=1e-3)
    # Both formats are defined with heights above EGM96; that of USGS says nothing.
    if driver == "USGSDEM":
        with pytest.raises(HeightDatumError):
            Dem.open(path)
    else:
        with closing(Dem.open(path)) as read:
            assert read.crs.name.endswith("EGM96 geoid height")


@pytest.mark.parametrize("layout", ["BIL", "BIP", "BSQ"])
def test_pixels_in_each_of_the_three_orders_of_a_raw_file(tmp_path, layout):
    """Written byte by byte here: GDAL writes but one of them."""
    image = np.random.default_rng(4).integers(0, 255, (3, 20, 30), dtype=np.uint8)
    axes = {"BIL": (1, 0, 2), "BIP": (1, 2, 0), "BSQ": (0, 1, 2)}[layout]
    path = tmp_path / f"scene.{layout.lower()}"
    path.write_bytes(image.transpose(axes).tobytes())
    path.with_suffix(".hdr").write_text(f"NROWS 20\nNCOLS 30\nNBANDS 3\nNBITS 8\nLAYOUT {layout}\nBYTEORDER I\n")
    with Source(path) as source:
        values, _ = source.read(Window(0, 0, 30, 20))
    np.testing.assert_array_equal(values.transpose(2, 0, 1), image)


@pytest.mark.parametrize(("driver", "ending"), [("GIF", "gif"), ("PNM", "ppm"), ("WEBP", "webp"), ("LAN", "gis")])
def test_a_picture_of_another_format_has_the_pixels_of_its_geotiff(tmp_path, driver, ending):
    bands = 1 if driver in ("GIF", "LAN") else 3
    image = np.random.default_rng(4).integers(0, 255, (bands, 20, 30), dtype=np.uint8)
    truth = tmp_path / "truth.tif"
    with rasterio.open(truth, "w", driver="GTiff", width=30, height=20, count=bands, dtype="uint8") as dataset:
        dataset.write(image)
    path = tmp_path / f"a.{ending}"
    with rasterio.Env():
        rasterio.shutil.copy(str(truth), str(path), driver=driver, **({"LOSSLESS": True} if driver == "WEBP" else {}))
    with Source(path) as source:
        assert source.info.driver == driver
        np.testing.assert_array_equal(source.read(Window(0, 0, 30, 20))[0].transpose(2, 0, 1), image)


def test_a_variable_of_a_netcdf_file_of_many_is_named_by_a_virtual_raster(tmp_path):
    truth = geotiff(tmp_path / "truth.tif")
    with rasterio.open(truth) as dataset:
        values = dataset.read(1)
    path = tmp_path / "two.nc"
    with rasterio.open(truth) as dataset, rasterio.open(
        tmp_path / "two.tif", "w", **{**dataset.profile, "count": 2}
    ) as both:  # fmt: skip
        both.write(np.array([values + 5.0, values]))
    as_format("netCDF", tmp_path / "two.tif", "two.nc")
    with pytest.raises(RasterReadError, match=r"subdatasets: .*Band1") as caught:
        inspect(path)
    assert "gdal_translate -of VRT" in str(caught.value.hint)
    vrt = tmp_path / "second.vrt"
    with rasterio.open(f"NETCDF:{path}:Band2") as dataset:
        rasterio.shutil.copy(dataset, str(vrt), driver="VRT")
    with closing(Dem.open(vrt, heights="egm96")) as read, closing(Dem.open(truth, heights="egm96")) as known:
        xy = np.random.default_rng(3).uniform((500100.0, 5399500.0), (500700.0, 5399900.0), (500, 2))
        np.testing.assert_allclose(read.height(xy), known.height(xy), rtol=1e-6)
    vrt.write_text(vrt.read_text().replace("two.nc", "three.nc"))
    with pytest.raises(RasterReadError, match="there is no such file"):
        inspect(vrt)


@pytest.mark.parametrize("name", ["/vsicurl/http://127.0.0.1/a.nc", "http://127.0.0.1/a.nc"])
def test_a_virtual_raster_names_no_variable_of_an_address(tmp_path, name):
    path = tmp_path / "a.vrt"
    path.write_text(
        '<VRTDataset rasterXSize="10" rasterYSize="10"><VRTRasterBand dataType="Byte" band="1"><SimpleSource>'
        f'<SourceFilename relativeToVRT="0">NETCDF:"{name}":z</SourceFilename></SimpleSource>'
        "</VRTRasterBand></VRTDataset>"
    )
    with pytest.raises(RasterReadError, match="no file of this machine"):
        inspect(path)


def test_a_pcidsk_file_whose_pixels_lie_elsewhere_is_refused(tmp_path):
    """GDAL would open the other file in any format it knows, map services among them."""
    path = as_format("PCIDSK", geotiff(tmp_path / "truth.tif"), "a.pix")
    content = bytearray(path.read_bytes())
    header = (int(content[336:352]) - 1) * 512
    content[header + 64 : header + 128] = b"tiles.xml".ljust(64)
    path.write_bytes(content)
    with pytest.raises(RasterReadError, match=r"pixels in another file, 'tiles.xml'"):
        inspect(path)
    content[336:352] = b"no number here  "
    path.write_bytes(content)
    with pytest.raises(RasterReadError, match="damaged"):
        inspect(path)


@pytest.mark.parametrize(
    ("name", "head", "reason"),
    [
        ("a.ecw", b"e\x02\x03", "ECW is not read: its library is proprietary"),
        ("a.sid", b"msid\x04", "MrSID is not read: its library is proprietary"),
        ("MOD13.hdf", b"\x0e\x03\x13\x01", "HDF4 is not read: GDAL's wheels are built without its library"),
        ("hdr.adf", b"GRID1.2\x00", "Arc/Info binary grid is not read"),
        ("a.ers", b"DatasetHeader Begin", "may name any other file"),
        ("N50E015.hgt.zip", b"PK\x03\x04", "unpacked first"),
    ],
)
def test_a_format_that_is_not_read_is_refused_with_its_reason(tmp_path, name, head, reason):
    path = tmp_path / name
    path.write_bytes(head + bytes(400))
    with pytest.raises(RasterReadError, match=reason):
        inspect(path)


def test_a_table_of_points_is_no_grid_and_a_grid_of_heights_no_photo(tmp_path):
    table = tmp_path / "points.csv"
    table.write_text("".join(f"{x} {y} {x + y}\n" for y in (3, 2, 1) for x in (1, 2, 3)))
    grid = as_format("AAIGrid", geotiff(tmp_path / "truth.tif"), "dem.asc")
    photos, others = rasters_among([table, grid, tmp_path / "truth.tif"])
    assert [path.name for path in photos] == ["truth.tif"]
    assert [path.name for path in others] == ["points.csv", "dem.asc"]


def test_the_docs_list_the_formats_that_are_read_and_no_other():
    page = (Path(__file__).parents[1] / "docs" / "formats.md").read_text()
    table = page[page.index("| format |") :].split("\n\n")[0].splitlines()[2:]
    listed = [line.split("|")[2].strip(" `") for line in table]
    assert sorted(listed) == sorted(READ_DRIVERS)
    assert all(each.name in line for each in FORMATS for line in table if f"`{each.driver}`" in line)
