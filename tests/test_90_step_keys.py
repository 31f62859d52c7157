"""What makes a step of a project stale besides its files: sidecars, sources of virtual rasters, sensor plugins."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import rasterio
import shapely
from PIL import Image

from geomosaic.errors import InputError
from geomosaic.geo.crs import parse_crs
from geomosaic.jobs.manifest import Layout
from geomosaic.jobs.project import job_of, run_steps, status_of
from geomosaic.options.declaration import STAGES, option, stage_values
from geomosaic.options.mosaic import BlendOptions, MosaicOptions
from geomosaic.project.load import load_project
from geomosaic.raster.info import companions
from geomosaic.raster.vector import Layer, read_layer, write_layers
from geomosaic.sensor import registry

WORLD = "2.0\n0.0\n0.0\n-2.0\n{}\n5500399.0\n"
PROJECT = """
format = 1
[project]
images = ["*.png", "virtual.tif"]
[sensor]
name = "planar"
[exterior]
crs = "EPSG:32633"
[output]
resolution = 4.0
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """Two pictures with world files, and a virtual raster of a third; run once."""
    rng = np.random.default_rng(1)
    for name, left in (("a", 400001), ("b", 400201)):
        Image.fromarray(rng.integers(50, 200, (200, 200), dtype=np.uint8)).save(tmp_path / f"{name}.png")
        (tmp_path / f"{name}.pgw").write_text(WORLD.format(left))
    (tmp_path / "in").mkdir()
    Image.fromarray(rng.integers(50, 200, (200, 200), dtype=np.uint8)).save(tmp_path / "in" / "c.bmp")
    (tmp_path / "virtual.tif").write_text(
        '<VRTDataset rasterXSize="200" rasterYSize="200"><GeoTransform>400300, 2, 0, 5500400, 0, -2</GeoTransform>'
        '<VRTRasterBand dataType="Byte" band="1"><SimpleSource><SourceFilename relativeToVRT="1">in/c.bmp'
        "</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    file = tmp_path / "trial.toml"
    file.write_text(PROJECT)
    run_steps(load_project(file))
    return file


def stale(file: Path) -> dict[str, str]:
    return {state.name: state.reason for state in status_of(load_project(file)) if not state.fresh}


def test_images_that_differ_in_their_extension_have_an_ortho_each(project):
    own = load_project(project)
    assert [path.name for path in Layout(own).orthos] == ["a.tif", "b.tif", "virtual.tif"]
    for name in ("A.bmp", "a.png.bmp"):
        (project.parent / name).write_bytes((project.parent / "in" / "c.bmp").read_bytes())
    (project.parent / "A.bpw").write_text(WORLD.format(400401))
    (project.parent / "a.png.bpw").write_text(WORLD.format(400501))
    project.write_text(PROJECT.replace('"*.png"', '"*.png", "*.bmp"') + "orthos = true\n")
    layout = Layout(load_project(project))
    run_steps(layout.project)
    names = [path.name for path in layout.orthos]
    assert names == ["a.png.tif", "b.png.tif", "A.bmp.tif", "a.png.bmp.tif", "virtual.tif.tif"]
    lefts = []
    for path in layout.orthos:
        with rasterio.open(path) as image:
            lefts.append(image.bounds.left)
    assert lefts == [400000, 400200, 400400, 400500, 400300]


def test_nothing_is_stale_after_a_run_nor_after_a_move(project):
    assert stale(project) == {}
    place = project.parent.with_name("elsewhere")
    project.parent.rename(place)
    assert stale(place / project.name) == {}


def test_a_changed_world_file(project):
    """Its pixels stay what they were, and move by 100 m."""
    before = (project.parent / "output" / "mosaic.tif").read_bytes()
    (project.parent / "b.pgw").write_text(WORLD.format(400101))
    assert "georeference or kind of b.png" in stale(project)["orient"]
    assert {"orient", "mosaic"} <= set(stale(project))
    run_steps(load_project(project))
    assert stale(project) == {}
    assert (project.parent / "output" / "mosaic.tif").read_bytes() != before


def test_a_new_mask_and_a_changed_source(project):
    mask = project.parent / "a.png.msk"
    kind = {"driver": "GTiff", "width": 200, "height": 200, "count": 1, "dtype": "uint8"}
    with rasterio.open(mask, "w", **kind) as image:
        image.write(np.zeros((1, 200, 200), np.uint8))
        image.update_tags(INTERNAL_MASK_FLAGS_1="2")
    assert stale(project)["orient"] == "'georeference or kind of a.png' changed, and 1 more"
    mask.unlink()
    assert stale(project) == {}
    source = project.parent / "in" / "c.bmp"
    data = bytearray(source.read_bytes())
    data[-1] ^= 255
    source.write_bytes(data)
    assert stale(project)["mosaic"].startswith(("c.bmp changed", "step 'orient'"))


def test_a_nodata_value_beside_a_raster_counts_and_statistics_do_not(project):
    sidecar = project.parent / "a.png.aux.xml"
    statistics = '<Metadata><MDI key="STATISTICS_MEAN">120</MDI></Metadata>'
    sidecar.write_text(f'<PAMDataset><PAMRasterBand band="1">{statistics}</PAMRasterBand></PAMDataset>')
    assert stale(project) == {}
    sidecar.write_text(
        f'<PAMDataset><PAMRasterBand band="1"><NoDataValue>60</NoDataValue>{statistics}</PAMRasterBand></PAMDataset>'
    )
    assert stale(project)["orient"] == "'georeference or kind of a.png' changed"


def test_another_version_of_a_sensor_plugin(project, monkeypatch):
    def installed(version: str) -> None:
        found = registry.SensorEntry("planar", "acme-sensors", version, "geomosaic_planar:plugin")
        monkeypatch.setattr(registry, "_entry", lambda point: found)

    installed("1.0")
    run_steps(load_project(project))
    assert stale(project) == {}
    installed("1.1")
    assert stale(project)["orient"] == "'version of acme-sensors' changed"


def test_a_file_that_an_input_of_the_sensor_names(project):
    (project.parent / "lens.txt").write_text("one")
    project.write_text(
        PROJECT.replace('name = "planar"', 'name = "planar"\nextra = { table = ["lens.txt", "no.txt"] }')
    )
    tables = load_project(project).inputs.tables
    assert [path.name for path in tables] == ["lens.txt"]
    assert tables[0] in job_of(load_project(project)).steps[0].inputs


def test_an_option_that_does_not_say_its_stage_counts_for_all_of_them():
    """Whoever forgets the stage of a new option costs a run, and not a rerun that keeps old pixels."""

    @dataclass(frozen=True)
    class Powered(BlendOptions):
        power: float = option(1.0, "Exponent of the ramps.")

    keys = [stage_values(MosaicOptions(blending=Powered(power=power)), "all") for power in (1.0, 1.0, 2.0)]
    assert keys[0] == keys[1] != keys[2]
    for stage in STAGES:
        assert stage == "all" or "power" not in str(stage_values(MosaicOptions(blending=Powered(power=2.0)), stage))


def test_companions_are_what_gdal_reads(tmp_path):
    with rasterio.open(
        tmp_path / "scene.img", "w", driver="ENVI", width=10, height=10, count=1, dtype="uint8"
    ) as image:
        image.write(np.ones((1, 10, 10), np.uint8))
    assert [path.name for path in companions(tmp_path / "scene.img").files] == ["scene.hdr"]


def test_water_and_rules_are_keys_of_the_project(project):
    """With the words of the command; what a rule does not need is not asked for, and what it cannot heed is refused."""
    write_layers(
        project.parent / "lake.gpkg",
        {"water": Layer(parse_crs("EPSG:32633"), "Polygon", [shapely.box(400210, 5500100, 400390, 5500300)], {})},
        overwrite=True,
    )
    project.write_text(PROJECT + '[mosaic]\nwater = "lake.gpkg"\n')
    run_steps(load_project(project))
    assert stale(project) == {}
    with (project.parent / "lake.gpkg").open("ab") as file:
        file.write(b"moved")
    assert "lake.gpkg" in stale(project)["mosaic"]
    for rule, keys, labelled in (("last", 'order = "name"\nbase = "a.png"\n', True), ("mean", "", False)):
        project.write_text(PROJECT + f'[mosaic]\nrule = "{rule}"\n{keys}')
        layout = Layout(load_project(project))
        layout.labels.unlink(missing_ok=True)
        outcome = run_steps(layout.project)
        assert layout.labels.is_file() == labelled
        assert layout.report.is_file()
        assert outcome.facts["mosaic"]["rule"] == rule
        assert not outcome.facts["mosaic"]["balanced"]
        assert read_layer(layout.vectors, "footprints")["sha256"].str.len().tolist() == [64] * 3
        assert stale(project) == {}
    project.write_text(PROJECT + '[mosaic]\nrule = "mean"\nwater = "lake.gpkg"\n')
    with pytest.raises(InputError, match=r"water would do nothing with .mosaic. rule"):
        run_steps(load_project(project))
    project.write_text(PROJECT + '[mosaic]\nrule = "mena"\n')
    with pytest.raises(InputError, match="rule"):
        load_project(project)
