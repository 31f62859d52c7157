"""Orthos and mosaics by command: what they write, and what they never write over."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import rasterio
from cli_rig import PLACE, flags, photos
from PIL import Image

import geomosaic as gm


def test_a_project_and_the_command_make_the_same_bytes(tell, block, project, tmp_path):
    code, out, _ = tell("mosaic", *photos(block), *flags(block), *PLACE, "-o", tmp_path / "m.tif", "--json")
    assert code == 0
    facts = json.loads(out)
    assert (tmp_path / "m.tif").read_bytes() == (project.parent / "output" / "trial.tif").read_bytes()
    assert facts["lattice_error_px"] <= facts["tolerance_px"]
    assert sum(facts["pixels_per_image"]) == facts["valid_pixels"] > 50_000
    after, before = np.array(facts["overlap_difference_after"]), np.array(facts["overlap_difference_before"])
    assert (after < before).all()


def test_a_mosaic_and_nothing_else(tell, block, project, tmp_path):
    """The same bytes, without what says how they came about."""
    words = [*photos(block), *flags(block), *PLACE, "--no-labels", "--no-records", "--json"]
    code, out, err = tell("mosaic", *words, "-o", tmp_path / "m.tif")
    assert code == 0, err
    assert [path.name for path in tmp_path.iterdir()] == ["m.tif"]
    assert (tmp_path / "m.tif").read_bytes() == (project.parent / "output" / "trial.tif").read_bytes()
    facts = json.loads(out)
    assert facts["labels"] is facts["vectors"] is facts["stac"] is None
    assert sum(facts["pixels_per_image"]) == facts["valid_pixels"]


def test_georeferenced_images_need_no_sensor(tell, project, tmp_path):
    """A mosaic of a mosaic on its own grid is itself."""
    mosaic = project.parent / "output" / "trial.tif"
    words = ["--resampling", "nearest", "--no-balance", "--no-labels", "-f", "GTiff"]
    with rasterio.open(mosaic) as source:
        bounds = [str(v) for v in source.bounds]
        code, _, err = tell("mosaic", mosaic, "--res", 1, "--bounds", *bounds, *words, "-o", tmp_path / "again.tif")
        assert code == 0, err
        with rasterio.open(tmp_path / "again.tif") as again:
            seen = source.dataset_mask() > 0
            assert ((again.dataset_mask() > 0) == seen).mean() > 0.999
            both = seen & (again.dataset_mask() > 0)
            assert (again.read()[:, both] == source.read()[:, both]).all()
    assert not (tmp_path / "again-labels.tif").exists()


def test_an_output_is_never_written_over_unasked(tell, block, tmp_path):
    out = tmp_path / "o.tif"
    out.write_text("precious")
    words = ["ortho", photos(block)[0], *flags(block), "--res", 8, "-o", out]
    code, _, err = tell(*words)
    assert code == 1
    assert "--overwrite" in err
    assert out.read_text() == "precious"
    assert tell(*words, "--overwrite")[0] == 0
    with rasterio.open(out) as made:
        assert made.count == 3


def test_an_input_is_never_written_over_asked_for_or_not(tell, block, tmp_path):
    """The first photo as output, as companion of the output, and where the project file should be named."""
    own = tmp_path / "own"
    shutil.copytree(block, own)
    before = {path: path.read_bytes() for path in own.rglob("*.*")}
    link = own / "link.jpg"
    link.symlink_to(photos(own)[0])
    for output in (photos(own)[0], link, own / "dem.tif", own / "exterior.csv"):
        code, _, err = tell("ortho", photos(own)[0], *flags(own), "--res", 8, "--overwrite", "-o", output)
        assert code == 1
        assert "one of the inputs" in err
        assert str(output) in err
    labels = own / "all-labels.tif"
    labels.write_bytes(Path(photos(own)[1]).read_bytes())
    before[labels] = labels.read_bytes()
    code, _, err = tell("mosaic", labels, *flags(own), "--res", 8, "--overwrite", "-o", own / "all.tif")
    assert (code, "one of the inputs" in err) == (1, True)
    code, _, err = tell("new", *photos(own), *flags(own), "--overwrite")
    assert code == 2
    assert "the project file comes first" in err
    link.unlink()
    assert {path: path.read_bytes() for path in own.rglob("*.*")} == before


def test_a_raster_is_not_written_under_the_name_of_another_format(tell, block, tmp_path):
    for name, said in (("m.jpg", "called '.jpg'"), ("m.gpkg", "called '.gpkg'")):
        for command, image in (("ortho", photos(block)[:1]), ("mosaic", photos(block))):
            code, printed, err = tell(command, *image, *flags(block), "--res", 8, "-o", tmp_path / name)
            assert (code, printed) == (1, "")
            assert said in err
            assert "m.tif" in err
    code, _, err = tell("ortho", photos(block)[0], *flags(block), "--overwrite", "-o", os.devnull)
    assert (code, "no ordinary file" in err) == (1, True)
    code, _, err = tell("ortho", photos(block)[0], *flags(block), "--overwrite", "-o", tmp_path)
    assert (code, "is a folder" in err) == (1, True)
    assert not list(tmp_path.iterdir())


def test_numbers_of_a_palette_are_not_averaged(tell, block, tmp_path):
    """Between colour 3 and colour 5 of a palette lies colour 4, which may be any."""
    paletted = [tmp_path / Path(name).with_suffix(".png").name for name in photos(block)]
    for path, name in zip(paletted, photos(block), strict=True):
        with Image.open(name) as image:
            image.convert("P", palette=Image.Palette.ADAPTIVE).save(path)
    out = tmp_path / "out.tif"
    for command, images in (("ortho", paletted[:1]), ("mosaic", paletted), ("mosaic", [*paletted, "--rule", "first"])):
        words = (command, *images, *flags(block), "--res", 8, "-o", out)
        code, _, err = tell(*words)
        assert code == 1
        assert "palette" in err
        assert "gdal_translate -expand rgb" in err
        assert not out.exists()
    assert tell("ortho", paletted[0], *flags(block), "--res", 8, "--resampling", "nearest", "-o", out)[0] == 0
    with rasterio.open(out) as made, Image.open(paletted[0]) as image:
        assert set(np.unique(made.read(1))) <= set(np.unique(np.asarray(image))) | {0}


SITE = 'LOCAL_CS["Local Coordinates (m)",LOCAL_DATUM["Local Datum",0],UNIT["metre",1]]'


def test_a_block_in_a_local_frame_runs_from_draft_to_report_without_a_vertical_datum(tell, block, tmp_path):
    """A plane taken for a map: the same numbers on a map with the planar treatment give the same pixels."""
    shutil.copytree(block, tmp_path / "site")
    own = tmp_path / "site"
    with rasterio.open(block / "dem.tif") as dem:
        profile, heights = {**dem.profile, "crs": rasterio.CRS.from_wkt(SITE)}, dem.read()
    with rasterio.open(own / "dem.tif", "w", **profile) as copy:
        copy.write(heights)
    (own / "site.prj").write_text(SITE)
    local = flags(own, crs=own / "site.prj", heights=None)
    file = own / "site.toml"
    code, out, _ = tell("new", file, *photos(own)[:2], *local, "--gcps", own / "gcps.csv")
    assert (code, "needs" in out) == (0, False)
    assert 'crs = "site.prj"' in file.read_text()
    place = ("--res", "2", "--bounds", "399960", "5500100", "400160", "5500300")
    area = f"resolution = 2.0\nbounds = [{', '.join(place[3:])}]\n"
    file.write_text(file.read_text().replace("[output]\n", f"[output]\n{area}") + "max_check_rms_px = 1.0\n")
    code, out, err = tell("run", file)
    assert code == 0, err
    assert not list((own / "output").glob("*.stac.json"))
    map_words = [*flags(block), "--option", "treatment=planar"]
    code, _, err = tell("mosaic", *photos(block)[:2], *map_words, *place, "-o", tmp_path / "map.tif")
    assert code == 0, err
    with rasterio.open(own / "output" / "site.tif") as site, rasterio.open(tmp_path / "map.tif") as there:
        assert np.array_equal(site.read(), there.read())
    code, _, err = tell("ortho", photos(own)[0], *local, "--heights", "ellipsoidal", "-o", tmp_path / "o.tif")
    assert (code, "leave the vertical datum out" in err) == (1, True)


def test_images_of_several_sensors_stand_in_one_project(tell, block, tmp_path):
    """Photos, a scene with an RPC and a raster that lies as it says: the pixels that the library makes of them."""
    shutil.copytree(block, tmp_path / "own")
    own, frame = tmp_path / "own", flags(block)
    first, second, scene, _ = (Path(path).name for path in photos(block))
    rpc = f"{Path(scene).stem}_RPC.TXT"
    place = ("--res", "4", "--bounds", "399850", "5499850", "400250", "5500150")
    code, _, err = tell("rpc", photos(block)[2], *frame, "--text", "--folder", own)
    assert code == 0, err
    code, _, err = tell("ortho", photos(block)[3], *frame, *place, "-o", own / "lies.tif")
    assert code == 0, err
    file = own / "all.toml"
    file.write_text(
        f"""\
format = 1
[project]
images = ["photos/{first}", "photos/{second}"]
[sensor]
name = "frame"
camera = "camera.toml"
[[images]]
path = "photos/{scene}"
sensor = "rpc"
rpc = "{rpc}"
[[images]]
path = "lies.tif"
sensor = "planar"
[exterior]
file = "exterior.csv"
crs = "EPSG:32633"
heights = "egm96"
[dem]
file = "dem.tif"
[output]
crs = "EPSG:32633"
resolution = 4.0
bounds = [{", ".join(place[3:])}]
"""
    )
    code, _, err = tell("run", file)
    assert code == 0, err
    code, out, _ = tell("status", file)
    assert (code, out.count("fresh")) == (0, 4)
    report = json.loads((own / "output" / "report.json").read_text())
    assert [group["sensor"] for group in report["orient"]["groups"]] == ["rpc", "planar"]
    given = {"camera": own / "camera.toml", "exterior": own / "exterior.csv", "crs": "EPSG:32633", "heights": "egm96"}
    parts = [
        gm.Block((own / "photos" / first, own / "photos" / second), "frame", **given),
        gm.Block((own / "photos" / scene,), "rpc", options={"rpc": str(own / rpc)}),
        own / "lies.tif",
    ]
    area = {"dst_crs": "EPSG:32633", "resolution": 4.0, "bounds": tuple(map(float, place[3:]))}
    made = gm.mosaic(parts, tmp_path / "library.tif", dem=own / "dem.tif", **area)
    with rasterio.open(own / "output" / "mosaic.tif") as there:
        assert np.array_equal(there.read(), made.read())
    (own / rpc).write_text((own / rpc).read_text() + "\n")
    _, out, _ = tell("status", file)
    assert f"{rpc} changed" in out


def test_an_image_stands_in_one_table_and_needs_a_sensor_for_tables_of_its_own(tell, block, tmp_path):
    def said(tables: str) -> str:
        (tmp_path / "p.toml").write_text(
            f'format = 1\n[project]\nimages = ["{block}/photos/*.jpg"]\n[sensor]\nname = "frame"\n{tables}'
        )
        return tell("run", tmp_path / "p.toml")[2]

    one = f'[[images]]\npath = "{photos(block)[0]}"\n'
    assert "stands in two tables" in said(one + "upwards = true\n" + one)
    assert "line 8: [[images]]: nodata needs a sensor" in said(f"\n\n{one}nodata = 0\n")
    assert "line 10: [[images]] path: " in said(f"{one}upwards = true\n[[images]]\npath = 5\n")
    assert "leave one of them out" in said(f'{one}[planar]\nkind = "uncontrolled"\n')
