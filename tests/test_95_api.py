"""The public API: values and files, results and their files, errors that name parameters, an untouched process."""

from __future__ import annotations

import ast
import gc
import os
import re
import shutil
import signal
import subprocess
import sys
import types
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from cli_rig import elsewhere
from pyproj import CRS
from sheet_rig import write

import geomosaic as gm
from geomosaic.errors import GeomosaicError, InputError
from geomosaic.raster.sink import RasterProduct

SAMPLE = Path(__file__).parents[1] / "data" / "sample"
FILES = {
    "camera": SAMPLE / "camera.toml",
    "exterior": SAMPLE / "exterior.csv",
    "crs": "EPSG:32633",
    "heights": "egm96",
}
PLACE = {"resolution": 4.0, "bounds": (399700.0, 5500200.0, 400100.0, 5500600.0)}
PHOTO = SAMPLE / "photos" / "strip1_02.jpg"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    output = tmp_path_factory.mktemp("api") / "ortho.tif"
    return gm.ortho(gm.Scene(PHOTO, "frame", **FILES), output, dem=SAMPLE / "dem.tif", **PLACE)


def test_misspelt_keys_of_a_camera_and_of_a_sensor_are_named_before_anything_is_missed() -> None:
    """A camera as it is made, a sensor's input before the block says which ones it lacks."""
    with pytest.raises(InputError, match="Camera: unknown key 'focal_lenght'") as caught:
        gm.Camera(focal_lenght=153.2, pixel_size=14.0)
    assert "did you mean 'focal_length'?" in str(caught.value.hint)
    assert gm.Camera(fiducials={"A": (1.0, 2.0)}, focal_length=153.2)["focal_length"] == 153.2
    photo = gm.Scene(PHOTO, "frame", exterior=FILES["exterior"], options={"camra": str(FILES["camera"])})
    with pytest.raises(InputError, match="sensor 'frame' has no input 'camra'") as caught:
        gm.ortho(photo, "none.tif", dem=100.0, resolution=4.0)
    assert "did you mean 'camera'?" in str(caught.value.hint)


def test_every_public_name_loads_and_is_typed():
    assert 25 <= len(gm.__all__) - 1 <= 55
    for name in gm.__all__:
        assert getattr(gm, name) is not None
    stub = ast.parse(Path(gm.__file__).with_suffix(".pyi").read_text())
    typed = {alias.name: node.module for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert typed == gm._HOMES


def test_public_functions_document_their_parameters():
    import inspect

    for name in gm.__all__:
        function = getattr(gm, name)
        if not isinstance(function, types.FunctionType):
            continue
        text = inspect.getdoc(function)
        assert text is not None, name
        assert "Raises\n" in text or name == "sensors", name
        described = " ".join(line.split(" : ")[0] for line in text.splitlines() if not line.startswith(" "))
        for parameter in inspect.signature(function).parameters:
            assert parameter in described.replace("*", "").replace(",", " ").split(), (name, parameter)


def test_public_functions_take_few_parameters_and_options_by_name():
    """Options are fields of options classes: a signature that grows is one that nobody reads."""
    import inspect

    for name in gm.__all__:
        function = getattr(gm, name)
        if isinstance(function, types.FunctionType):
            assert len(inspect.signature(function).parameters) <= 10, name


def test_options_of_a_mosaic_show_what_was_given():
    assert (
        repr(gm.MosaicOptions.of(blend="multiband", tolerance=0)) == "MosaicOptions(tolerance=0.0, blend='multiband')"
    )


def test_options_given_whole_may_be_changed_one_by_one():
    from geomosaic.options.control import GeoreferenceOptions
    from geomosaic.options.declaration import compose

    render = gm.RenderOptions(resampling="nearest", threads=2)
    made = compose(GeoreferenceOptions, {"render": render, "threads": 1, "model": "affine"})
    assert made.render == gm.RenderOptions(resampling="nearest", threads=1)
    assert made.fit.model == "affine"


def test_a_progress_callback_needs_no_other_option_beside_it():
    from geomosaic.options.control import GeoreferenceOptions
    from geomosaic.options.declaration import compose

    def progress(done, total, stage):
        raise AssertionError

    for kind in (GeoreferenceOptions, gm.MosaicOptions):
        assert compose(kind, {"progress": progress}).render.progress is progress


def test_values_make_the_same_ortho_as_files(made, tmp_path):
    rows = [line.split(",") for line in (SAMPLE / "exterior.csv").read_text().splitlines()]
    x, y, z, *angles = next([float(v) for v in row[1:7]] for row in rows if row[0] == PHOTO.name)
    exterior = gm.Exterior(x, y, z, *angles, crs="EPSG:32633", heights="egm96")
    with rasterio.open(SAMPLE / "dem.tif") as file:
        grid = gm.Grid.from_profile(file.profile)
        dem = gm.Dem.from_array(file.read(1), grid, "egm96")
    photo = gm.Scene(PHOTO, "frame", camera=gm.Camera.read(SAMPLE / "camera.toml"), exterior=exterior)
    again = gm.ortho(photo, tmp_path / "values.tif", dem=dem, like=made.grid)
    assert np.array_equal(again.read().filled(), made.read().filled())
    assert again.lattice_error == made.lattice_error


def test_control_points_as_values_are_those_of_their_table():
    table = gm.read_control(SAMPLE / "gcps.csv", image=PHOTO.name, crs="EPSG:32633+5773")
    from geomosaic.inputs.build import build_block

    by_file = build_block(gm.Scene(PHOTO, "frame", control=SAMPLE / "gcps.csv", dem=SAMPLE / "dem.tif", **FILES))
    by_value = build_block(gm.Scene(PHOTO, "frame", control=table, dem=SAMPLE / "dem.tif", **FILES))
    assert len(by_value.control) == len(by_file.control) > 0
    assert [p.xyz for p in by_value.control] == [p.xyz for p in by_file.control]
    assert [p.colrow for p in by_value.control] == [p.colrow for p in by_file.control]


def test_the_command_line_makes_the_same_pixels(made, tmp_path):
    out = tmp_path / "cli.tif"
    left, bottom, right, top = PLACE["bounds"]
    words = f"ortho {PHOTO} --sensor frame --camera {FILES['camera']} --exterior {FILES['exterior']} --exterior-crs "
    words += f"EPSG:32633 --heights egm96 --dem {SAMPLE / 'dem.tif'} --res 4 --bounds {left} {bottom} {right} {top}"
    told = elsewhere(*words.split(), "-o", out)
    assert told.returncode == 0, told.stderr
    with rasterio.open(out) as one, rasterio.open(made.path) as other:
        assert np.array_equal(one.read(), other.read())
        assert one.profile == other.profile


def test_a_mosaic_of_georeferenced_rasters_and_its_arrays(made, tmp_path):
    mosaic = gm.mosaic([made.path], tmp_path / "mosaic.tif", balance=False)
    assert isinstance(mosaic, RasterProduct)
    assert mosaic.grid == made.grid
    assert np.array_equal(mosaic.read().filled(), made.read().filled())


def test_a_mosaic_takes_images_of_different_sensors(made, tmp_path):
    """A frame photo, an RPC scene and a georeferenced raster over one ground: each shows what its ortho shows."""
    copy = shutil.copy(PHOTO.with_name("strip1_03.jpg"), tmp_path / "scene.jpg")
    table = tmp_path / "exterior.csv"
    table.write_text((SAMPLE / "exterior.csv").read_text().replace("strip1_03.jpg", "scene.jpg"))
    dem, bounds = SAMPLE / "dem.tif", (399700.0, 5500200.0, 400400.0, 5500600.0)
    gm.fit_rpc(gm.Scene(copy, "frame", dem=dem, **{**FILES, "exterior": table}), text=True)
    place = {"resolution": 4.0, "bounds": bounds}
    frame, rational = gm.Scene(PHOTO, "frame", dem=dem, **FILES), gm.Scene(copy, "rpc", dem=dem)
    alone = [gm.ortho(scene, tmp_path / f"{scene.sensor}.tif", **place).read() for scene in (frame, rational)]
    alone.append(gm.ortho(made.path, tmp_path / "raster.tif", **place).read())
    for several, orthos in (([frame, rational], alone[:2]), ([rational, made.path], alone[1:])):
        mosaic = gm.mosaic(several, tmp_path / "mixed.tif", balance=False, feather="0m", overwrite=True, **place)
        with rasterio.open(mosaic.labels) as file:
            labels = file.read(1)
        for number, ortho in enumerate(orthos, start=1):
            assert (labels == number).sum() > 1000
            assert np.array_equal(mosaic.read()[:, labels == number], ortho[:, labels == number])
    with pytest.raises(InputError, match="different grounds"):
        gm.mosaic([frame, replace(rational, dem=None, height=300.0, dem_heights="egm96")], tmp_path / "none.tif")


def test_a_result_reads_what_its_file_holds(made):
    with rasterio.open(made.path) as file:
        values, mask = file.read(), file.dataset_mask()
    array = made.read()
    assert array.shape == values.shape
    assert array.dtype == values.dtype
    assert np.array_equal(array.data[:, mask > 0], values[:, mask > 0])
    assert np.array_equal(array.mask[0], mask == 0)
    part = made.read(gm.Window(10, 20, 1000, 7), bands=[2])
    assert np.array_equal(part.filled(0), array[1:2, 20:27, 10:].filled(0))
    with pytest.raises(InputError, match="lies outside"):
        made.read(gm.Window(9999, 0, 1, 1))
    assert "EPSG:32633" in repr(made)
    assert len(repr(made)) < 200


def test_values_and_results_are_shown_in_one_line(made, tmp_path):
    with rasterio.open(SAMPLE / "dem.tif") as file:
        dem = gm.Dem.from_array(file.read(1), gm.Grid.from_profile(file.profile), "egm96")
    scene = gm.Scene(PHOTO, "frame", dem=dem, **FILES)
    project = gm.new_project(tmp_path / "p.toml", gm.Scene(PHOTO, "frame", dem=SAMPLE / "dem.tif", **FILES))
    points = gm.read_control(SAMPLE / "gcps.csv", image=PHOTO.name, crs="EPSG:32633+5773")
    found = gm.locate(scene, [[100.0, 100.0], [-5.0, 10.0]])
    state = gm.run_project(tmp_path / "p.toml", dry_run=True)
    shown = [*map(repr, (made.grid, dem, scene, points, found, project, state))]
    assert all(len(text) < 250 and "\n" not in text for text in shown), shown
    said = (
        "EPSG:32633",
        "EGM96",
        "camera='camera.toml'",
        "5 points, 3",
        "2 points, 1 without",
        "p.toml",
        "mosaic stale",
    )
    assert [text for text, words in zip(shown, said, strict=True) if words not in text] == []


def test_a_result_as_xarray(made):
    pytest.importorskip("rioxarray")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        array = made.to_xarray()
    assert array.shape == (3, *made.grid.shape)
    assert np.array_equal(np.nan_to_num(array.values), made.read().astype("float32").filled(0))


def test_without_rioxarray_a_hint_says_what_to_install(made, monkeypatch):
    monkeypatch.setitem(sys.modules, "rioxarray", None)
    with pytest.raises(InputError) as caught:
        made.to_xarray()
    assert caught.value.hint == "pip install rioxarray"


def test_a_grid_goes_through_a_rasterio_profile(made, tmp_path):
    grid = gm.Grid(CRS("EPSG:32633"), Affine(2.0, 0.5, 100.0, 0.25, -3.0, 200.0), 7, 5)
    with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", count=1, dtype="uint8", **grid.to_profile()) as file:
        file.write(np.zeros((1, 5, 7), np.uint8))
    with rasterio.open(tmp_path / "a.tif") as file:
        assert gm.Grid.from_profile(file.profile) == grid
    with pytest.raises(InputError, match="no crs"):
        gm.Grid.from_profile({"transform": grid.transform, "width": 7, "height": 5})


class BoxLike:
    """Stand-in for odc-geo's GeoBox."""

    def __init__(self, shape, affine, crs):
        self.shape, self.affine, self.crs = shape, affine, CRS(crs)


def test_a_grid_goes_through_anything_like_a_geobox():
    grid = gm.Grid.from_bounds(CRS("EPSG:25832"), (600000.0, 5300000.0, 600070.0, 5300050.0), 10.0)
    assert gm.Grid.from_geobox(grid.to_geobox(BoxLike)) == grid


def test_a_grid_goes_through_a_geobox():
    pytest.importorskip("odc.geo")
    grid = gm.Grid.from_bounds(CRS("EPSG:25832"), (600000.0, 5300000.0, 600070.0, 5300050.0), 10.0)
    box = grid.to_geobox()
    assert tuple(box.shape) == grid.shape
    assert gm.Grid.from_geobox(box) == grid


def test_angles_say_their_system():
    assert gm.Exterior(0, 0, 9, roll=1, pitch=2, yaw=3).system == "rpy"
    assert gm.Exterior(0, 0, 9, 1, 2, 3, system="pok").system == "pok"
    with pytest.raises(InputError, match="are not the angles"):
        gm.Exterior(0, 0, 9, omega=1)
    with pytest.raises(InputError, match="different crs"):
        gm.Block(
            ("a.tif", "b.tif"),
            "frame",
            exterior={
                "a.tif": gm.Exterior(0, 0, 9, 1, 2, 3, crs="EPSG:32633"),
                "b.tif": gm.Exterior(0, 0, 9, 1, 2, 3, crs="EPSG:32634"),
            },
        )
    with pytest.raises(AttributeError):
        gm.Exterior(0, 0, 9, 1, 2, 3).crs = "EPSG:4326"


def test_one_value_for_several_images_is_refused():
    with pytest.raises(InputError, match="one value is given for 2 images"):
        gm.Block(("a.tif", "b.tif"), "frame", exterior=gm.Exterior(0, 0, 9, 1, 2, 3))


def test_what_would_do_nothing_is_refused(made, tmp_path):
    with pytest.raises(InputError, match="`resolution` would do nothing with `like`"):
        gm.ortho(made.path, tmp_path / "x.tif", like=made.grid, resolution=2.0)
    with pytest.raises(InputError, match="`resolution` would do nothing"):
        gm.reproject(tmp_path / "a.gpkg", tmp_path / "b.gpkg", dst_crs="EPSG:4326", resolution=1.0)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("bounds", lambda photo, out: gm.ortho(photo, out, bounds=(0, 0, 1))),
        ("dst_crs", lambda photo, out: gm.ortho(photo, out, dst_crs="EPSG:999999")),
        ("scene", lambda photo, out: gm.ortho([photo, photo], out)),
        ("output", lambda photo, out: gm.ortho(photo, None)),
        ("dem", lambda photo, out: gm.ortho(photo, out, dem=np.zeros((3, 3)))),
        ("dem", lambda photo, out: gm.ortho(photo, out, dem=True)),
        ("scene", lambda photo, out: gm.locate(str(PHOTO), [[1, 2]])),
        ("scene", lambda photo, out: gm.draw_vectors([photo], out, out)),
        ("images", lambda photo, out: gm.develop([PHOTO], out, "surface.toml")),
        ("images", lambda photo, out: gm.match_edges(3, out, "gcps.csv", "common.csv", "EPSG:32633")),
        ("scans", lambda photo, out: gm.find_fiducials(3, "camera.toml", "mark.png", 20.0)),
        ("exterior", lambda photo, out: gm.Scene(PHOTO, "frame", exterior=(1, 2, 3))),
        ("images", lambda photo, out: gm.mosaic(3, out)),
        ("images", lambda photo, out: gm.mosaic([], out)),
        ("render", lambda photo, out: gm.ortho(photo, out, render={"threads": 2})),
        ("near", lambda photo, out: gm.georeference(PHOTO, out, SAMPLE / "gcps.csv", near=5)),
        ("pixels", lambda photo, out: gm.locate(photo, np.zeros(3))),
        ("pixels", lambda photo, out: gm.locate(photo, [("a", "b")])),
        ("modle", lambda photo, out: gm.georeference(PHOTO, out, SAMPLE / "gcps.csv", modle="affine")),
        ("sigmas", lambda photo, out: gm.locate(photo, [[1, 2]], sigmas={"omega": -1})),
        ("first_pixel", lambda photo, out: gm.locate(photo, [[1, 2]], first_pixel=0.3)),
        ("src_crs", lambda photo, out: gm.locate(photo, [[1, 2]], src_crs="EPSG:32633")),
        ("height_range", lambda photo, out: gm.fit_rpc(photo, height_range=5)),
        ("height", lambda photo, out: gm.plan("photo", height="high")),
        ("x", lambda photo, out: gm.Exterior("a", 0, 9, 1, 2, 3)),
    ],
)
def test_a_wrong_call_names_its_parameter(name, call, tmp_path):
    photo = gm.Scene(PHOTO, "frame", **FILES, dem=SAMPLE / "dem.tif")
    with pytest.raises(InputError) as caught:
        call(photo, tmp_path / "none.tif")
    assert f"`{name}`" in f"{caught.value.where} {caught.value.what}"
    assert not list(tmp_path.iterdir())


INPUTS_AS_OUTPUTS = {
    "sheet": ("map.tif", lambda photo, own: gm.sheet(own, own, overwrite=True)),
    "DEM of a sheet": ("dem.tif", lambda photo, own: gm.sheet(PHOTO, own, contours=own, overwrite=True)),
    "fiducials": (
        "scan.tif",
        lambda photo, own: gm.find_fiducials([own], SAMPLE / "camera.toml", PHOTO, 20.0, output=own, overwrite=True),
    ),
    "locate": ("pixels.csv", lambda photo, own: gm.locate(photo, own, output=own, overwrite=True)),
    "draw_vectors": ("map.gpkg", lambda photo, own: gm.draw_vectors(photo, own, own, overwrite=True)),
    "contours": ("dem.gpkg", lambda photo, own: gm.contours(own, own, overwrite=True)),
    "propose_water": ("map.gpkg", lambda photo, own: gm.propose_water(own, SAMPLE / "dem.tif", own, overwrite=True)),
}


@pytest.mark.parametrize("making", INPUTS_AS_OUTPUTS)
def test_no_input_is_overwritten(making, tmp_path):
    name, call = INPUTS_AS_OUTPUTS[making]
    own = tmp_path / name
    own.write_bytes(b"what a user made")
    with pytest.raises(InputError, match="one of the inputs"):
        call(gm.Scene(PHOTO, "frame", **FILES), own)
    assert own.read_bytes() == b"what a user made"


def test_a_raster_in_another_crs(made, tmp_path):
    again = gm.reproject(made.path, tmp_path / "utm.tif", dst_crs="EPSG:25833", resolution=4.0)
    assert again.grid.crs.to_epsg() == 25833
    assert again.read().count() > 0.9 * made.read().count()


def test_places_of_pixels_and_back(made):
    photo = gm.Scene(PHOTO, "frame", **FILES, dem=SAMPLE / "dem.tif")
    found = gm.locate(photo, np.array([[600.0, 450.0], [100.0, 100.0]]), dst_crs="EPSG:32633", sigma_px=0.5)
    assert found.lost == 0
    colrow = made.grid.colrow(found.places.xyz[:1, :2])
    assert ((colrow >= 0) & (colrow <= made.grid.shape[::-1])).all()


def test_results_that_are_vectors_are_read(made, tmp_path):
    lines = gm.contours(SAMPLE / "dem.tif", tmp_path / "contours.gpkg", interval=20)
    assert len(lines.read()) == lines.lines
    moved = gm.reproject(lines.path, tmp_path / "moved.gpkg", dst_crs="EPSG:4326")
    assert len(moved.read("contours")) == lines.lines
    assert moved.read().crs.to_epsg() == 4326
    photo = gm.Scene(PHOTO, "frame", **FILES, dem=SAMPLE / "dem.tif")
    for output in (None, tmp_path / "places.gpkg"):
        places = gm.locate(photo, np.array([[600.0, 450.0], [100.0, 100.0]]), output=output)
        assert np.allclose(places.read().get_coordinates(), places.places.xyz[:, :2])
    drawn = gm.draw_vectors(photo, lines.path, tmp_path / "drawn.csv", rows="down")
    assert drawn.read()["feature"].nunique() == drawn.drawn


def test_a_project_of_photos_takes_what_they_carry(tmp_path):
    draft = gm.new_project(tmp_path / "project.toml", gm.Block((PHOTO,), "frame", **FILES, dem=SAMPLE / "dem.tif"))
    assert draft.needed == []
    assert any("angle system: opk" in line for line in draft.recognised)
    unplaced = gm.new_project(tmp_path / "photos.toml", PHOTO)
    assert any("1 of 1 photos have a position" in line for line in unplaced.recognised)


def test_planning_derives_what_follows():
    assert gm.plan("photo", height=3000.0, camera_constant=150.0)["photo_scale"].value == pytest.approx(20000.0)
    scan = gm.plan("photo", photo_scale=8000.0, ortho_scale=2000.0, scan_dpi=1000.0)["scan_dpi"]
    assert (scan.limit, scan.kept) == (pytest.approx(1280.0), False)
    assert gm.plan("flight", ortho_scale=5000.0, camera_constant=150.0, area=(10e3, 8e3)).coverage.photos == 24
    assert gm.plan("area", area=(10e3, 8e3), photo_scale=10e3, ortho_pixel=0.5).raster == (16_000, 20_000)
    assert gm.plan("control", model="conformal", photos=12, ties=63).block.redundancy == 126 - 48
    assert {one.name for one in gm.plan("product", ortho_scale=5000.0, camera_constant=150.0)} >= {"scan_dpi"}
    assert gm.plan("tables", ortho_scale=(2000.0,))[0].ratio == 4.0
    with pytest.raises(gm.GeomosaicError, match="`camera_constant` is not given"):
        gm.plan("flight", ortho_scale=5000.0)
    with pytest.raises(InputError, match="no quantity 'heigt'") as caught:
        gm.plan("photo", heigt=1.0)
    assert "height" in caught.value.hint


def test_sensors_are_listed():
    assert {"frame", "planar", "rpc"} <= {entry.name for entry in gm.sensors()}


def state():
    """What a library call must leave as it is."""
    return {
        "environment": dict(os.environ),
        "signals": [signal.getsignal(number) for number in sorted(signal.valid_signals())],
        "filters": list(warnings.filters),
        "showwarning": warnings.showwarning,
        "collector": (gc.isenabled(), gc.get_threshold(), gc.get_freeze_count()),
        "streams": (sys.stdin, sys.stdout, sys.stderr),
        "numpy": np.geterr(),
        "folder": Path.cwd(),
    }


def test_a_call_changes_nothing_of_its_process(made, tmp_path):
    before = state()
    gm.ortho(made.path, tmp_path / "again.tif", threads=2)
    gm.contours(SAMPLE / "dem.tif", tmp_path / "contours.gpkg", interval=20)
    with pytest.raises(GeomosaicError):
        gm.ortho(tmp_path / "missing.tif", tmp_path / "none.tif")
    assert state() == before


def test_importing_loads_no_numerical_library():
    code = "import sys, geomosaic; print(sorted({'numpy', 'pyproj', 'rasterio', 'click'} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_the_modules_of_values_run_their_examples():
    import doctest
    from importlib import import_module

    for name in sorted({*gm._HOMES.values()}):
        result = doctest.testmod(import_module(name))
        assert result.failed == 0, name


def test_an_error_names_the_parameter_and_each_command_its_flag(tmp_path):
    declared = {name: value for name, value in FILES.items() if name != "heights"}
    with pytest.raises(InputError) as caught:
        gm.ortho(gm.Scene(PHOTO, "frame", **declared), tmp_path / "x.tif", dem=SAMPLE / "dem.tif")
    assert "`heights`" in caught.value.hint
    words = ["ortho", PHOTO, "--sensor", "frame", "--camera", FILES["camera"], "--exterior", FILES["exterior"]]
    told = elsewhere(*words, "--exterior-crs", "EPSG:32633", "--dem", SAMPLE / "dem.tif", "-o", tmp_path / "x.tif")
    assert "--heights" in told.stderr
    assert "`" not in told.stderr
    text = (SAMPLE / "project.toml").read_text().replace('"photos/', f'"{SAMPLE}/photos/')
    text = text.replace('heights = "egm96"', "#")
    for name in ("camera.toml", "exterior.csv", "dem.tif", "gcps.csv", "truth/reflectance.tif"):
        text = text.replace(f'"{name}"', f'"{SAMPLE / name}"')
    (tmp_path / "project.toml").write_text(text)
    told = elsewhere("run", tmp_path / "project.toml")
    assert "[exterior] heights" in told.stderr


@pytest.mark.parametrize(
    ("command", "text", "said"),
    [
        ("mosaic", "leave out `balance=False`", "leave out --no-balance"),
        ("mosaic", "give `resolution` and `bands`", "give --res and --bidx"),
        ("mosaic", "`resampling=nearest`", "--resampling nearest"),
        ("mosaic", "see `geomosaic sensors` and `something`", "see `geomosaic sensors` and `something`"),
        ("run", "leave out `balance=False`", "leave out [mosaic] balance = false"),
        ("run", "`resampling=nearest` and `dem_heights`", "[output] resampling = 'nearest' and [dem] heights"),
        ("sheets", "no `name_column`", "no --name-column"),
    ],
)
def test_parameters_are_called_as_the_command_calls_them(command, text, said):
    from geomosaic.cli.output import translated

    assert translated(text, command) == said


def test_no_text_below_the_command_line_names_a_flag():
    """BandDifferences from whole command lines that are quoted; `options` declares flags and their help."""
    root, found = Path(gm.__file__).parent, []
    folders = [path for path in root.iterdir() if path.is_dir() and path.name not in ("cli", "options")]
    for path in [file for folder in (*folders, root.parent / "plugins") for file in folder.rglob("*.py")]:
        source = path.read_text()
        for node in ast.walk(ast.parse(source)) if re.search(r"(?<![\w-])--[a-z]", source) else ():
            text = node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""
            if re.search(r"(?<![\w-])--[a-z]", text) and not re.search("geomosaic [a-z]+ |model_converter", text):
                found.append(f"{path.relative_to(root.parent)}:{node.lineno}: {text[:60]}")
    assert found == []


def test_a_check_says_whether_the_map_keeps_its_limits(tmp_path):
    raster = write(tmp_path / "map.tif", np.full((1, 50, 60), 9, np.uint8), "EPSG:32633", 0.5, (500_000.0, 5_500_000.0))
    rows = [
        f"{k},{500_000 + c / 2 + 1.2},{5_500_000 - r / 2},{c},{r}"
        for k, (c, r) in enumerate([(5, 5), (50, 9), (30, 40)])
    ]
    (tmp_path / "points.csv").write_text("\n".join(["id,x,y,col,row", *rows]) + "\n")
    points = tmp_path / "points.csv"
    assert gm.check(raster, points, crs="EPSG:32633").passed
    found = gm.check(raster, points, crs="EPSG:32633", max_rms=3.0, max_rms_map=1.0, map_scale=5000.0)
    assert [verdict.passed for verdict in found.verdicts] == [True, False, True]
    assert not found.passed
    assert found.verdicts[1].text == "total RMS 1.2 m, limit 1 m"


def test_a_sheet_is_found_by_its_place_and_by_its_name():
    scheme = gm.sheet_scheme("puwg1992", 10_000)
    found = gm.find_sheet(scheme, (19.78, 50.02))
    assert found == gm.find_sheet(scheme, "M-34-064-Dc3")
    assert (found.name, found.neighbours["S"], found.map_crs) == ("M-34-64-D-c-3", "M-34-76-B-a-1", "EPSG:2180")
    assert found.corners[0] == [19.75, 50.0]
    for given in ({"size": (500.0, 500.0)}, {"crs": "EPSG:2180"}, {"name_column": "nr"}):
        with pytest.raises(gm.GeomosaicError, match="would do nothing"):
            gm.sheet_scheme("tk", 25_000, **given)


def test_the_state_of_a_project_is_told_without_running_it(tmp_path):
    found = gm.run_project(tmp_path / "demo", sample=True, dry_run=True)
    assert [state.name for state in found.states][:2] == ["orient", "mosaic"]
    assert not any(state.fresh for state in found.states)
    assert found.facts["outputs"] == {}
    with pytest.raises(gm.GeomosaicError, match="`force` would do nothing with `dry_run`"):
        gm.run_project(tmp_path / "demo" / "project.toml", dry_run=True, force=True)
