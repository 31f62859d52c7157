"""What lies beside a mosaic: STAC item and vectors; names that are taken; what killed runs left."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
from affine import Affine
from pyproj import CRS, Geod

from geomosaic.block import Footprint
from geomosaic.errors import OutputError, OutputExistsError
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.outputs import MosaicFiles
from geomosaic.mosaicking.provenance import time_span
from geomosaic.mosaicking.records import SourceImages, write_vectors
from geomosaic.mosaicking.stac import write_item
from geomosaic.radiometry.gain_offset import solve_gain_offset
from geomosaic.raster.vector import read_layer
from geomosaic.render.ortho import GeometryRecord
from geomosaic.whole_files import partial, remove

METRES = Grid(CRS.from_epsg(32633), Affine(0.5, 0, 4e5, 0, -0.5, 5.5e6), 100, 100)
FEET = Grid(CRS.from_epsg(2263), Affine(2.0, 0, 9.8e5, 0, -2.0, 2e5), 100, 100)
DEGREES = Grid(CRS.from_epsg(4326), Affine(1e-5, 0, 13.0, 0, -1e-5, 60.0), 100, 100)


def made(folder: Path, grid: Grid, name: str = "m.stac.json", *, overwrite: bool = False) -> dict:
    folder.mkdir(exist_ok=True)
    mosaic, image = folder / "m.tif", folder / "photo.tif"
    mosaic.write_bytes(b"abc")
    image.write_bytes(b"photo")
    os.utime(image, (1_600_000_000, 1_600_000_000))
    left, bottom, right, top = grid.bounds
    outline = shapely.box(left, bottom, right, top)
    write_item(MosaicFiles(mosaic, item=folder / name), grid, [outline], [image], {}, overwrite=overwrite)
    return json.loads((folder / name).read_text())


@pytest.mark.parametrize("grid", [METRES, FEET, DEGREES], ids=["metres", "feet", "degrees"])
def test_the_item_keeps_the_schema_of_stac(tmp_path: Path, grid: Grid) -> None:
    """By the schemas that pystac brings; those of extensions are on the net."""
    pytest.importorskip("jsonschema")
    import pystac

    facts = made(tmp_path, grid)
    assert pystac.Item.from_dict({**facts, "stac_extensions": []}).validate()
    facts["assets"]["mosaic"]["roles"] = "data"
    with pytest.raises(pystac.STACValidationError):
        pystac.Item.from_dict({**facts, "stac_extensions": []}).validate()


def test_the_item_is_read_by_pystac_and_is_always_the_same(tmp_path: Path) -> None:
    import pystac

    facts = made(tmp_path / "a", METRES)
    item = pystac.Item.from_dict(facts)
    assert item.id == "m"
    assert item.assets["mosaic"].extra_fields["file:size"] == 3
    assert item.properties["proj:code"] == "EPSG:32633"
    assert facts["properties"]["datetime"] is None
    assert facts["properties"]["start_datetime"] == "1826-01-01T00:00:00Z"
    assert facts["properties"]["end_datetime"] == "2020-09-13T12:26:40Z"
    west, south, east, north = facts["bbox"]
    assert 13.0 < west < east < 14.0
    assert 49.0 < south < north < 50.0
    again = made(tmp_path / "b", METRES)
    assert again == facts
    assert (tmp_path / "a" / "m.stac.json").read_bytes() == (tmp_path / "b" / "m.stac.json").read_bytes()


@pytest.mark.parametrize(
    ("acquired", "times"),
    [
        (["2024-06-21T12:00:00+02:00"] * 2, ("2024-06-21T10:00:00Z", "2024-06-21T10:00:00Z", "taken")),
        (
            ["2024-06-21T12:00:00Z", "2024-06-21T12:00:00-03:30"],
            ("2024-06-21T12:00:00Z", "2024-06-21T15:30:00Z", "taken"),
        ),
        # Noon on Kiritimati is 22 h of the day before in Greenwich, noon on Baker Island its midnight.
        (["2024-06-21T12:00:00"] * 2, ("2024-06-20T22:00:00Z", "2024-06-22T00:00:00Z", "taken, zone unknown")),
        (["2024-06-21T12:00:00Z", ""], ("1826-01-01T00:00:00Z", "2024-06-21T12:00:00Z", "not known")),
        ([], ("1826-01-01T00:00:00Z", "2020-09-13T12:26:40Z", "not known")),
    ],
)
def test_times_are_of_acquisition_and_what_is_not_known_widens_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, acquired: list[str], times: tuple[str, str, str]
) -> None:
    """No file's time stands for the time an image was taken at: a copied file is no newer picture."""
    images = [tmp_path / "a.tif", tmp_path / "b.tif"]
    for image in images:
        image.write_bytes(b"photo")
        os.utime(image, (1_600_000_000, 1_600_000_000))
    first, last, known = time_span(acquired, images)
    assert (f"{first:%Y-%m-%dT%H:%M:%SZ}", f"{last:%Y-%m-%dT%H:%M:%SZ}", known) == times
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    assert time_span([], images)[1].year == 1970


@pytest.mark.parametrize(
    ("grid", "gsd"),
    [
        (METRES, 0.5),
        (FEET, 2 * 1200 / 3937),
        (DEGREES, abs(Geod(ellps="WGS84").inv(13.0, 60.0, 13.0, 59.99999)[2])),
    ],
)
def test_gsd_is_in_metres(tmp_path: Path, grid: Grid, gsd: float) -> None:
    assert made(tmp_path, grid)["properties"]["gsd"] == pytest.approx(gsd, rel=1e-5)


def test_a_mosaic_in_an_unknown_datum_has_an_item_without_a_place(tmp_path: Path) -> None:
    """As of old files: UTM by its numbers, the ellipsoid named, the datum not. Nothing is guessed, nothing fails."""
    import pystac

    somewhere = 'GEOGCS["unknown",DATUM["Unknown based on WGS 84 ellipsoid",SPHEROID["WGS 84",6378137,298.257223563]],'
    degree = 'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]]'
    utm = (
        f'PROJCS["of old",{somewhere}{degree},PROJECTION["Transverse_Mercator"],PARAMETER["central_meridian",-75],'
        'PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],UNIT["metre",1]]'
    )
    for text, place, gsd in ((utm, METRES, 0.5), (somewhere + degree, DEGREES, 1.1141)):
        facts = made(tmp_path / text[:6], Grid(CRS.from_wkt(text), place.transform, 100, 100))
        assert facts["geometry"] is None
        assert "bbox" not in facts
        assert facts["properties"]["gsd"] == pytest.approx(gsd, rel=1e-4)
        assert pystac.Item.from_dict(facts).properties["proj:projjson"]["name"] in ("of old", "unknown")


def test_an_item_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made(tmp_path, METRES)
    with pytest.raises(OutputExistsError):
        made(tmp_path, METRES)
    before = (tmp_path / "m.stac.json").read_bytes()

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(OutputError, match="No space left"):
        made(tmp_path, METRES, overwrite=True)
    assert (tmp_path / "m.stac.json").read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m.stac.json", "m.tif", "photo.tif"]


def test_shares_and_footprints_are_layers_of_one_file(tmp_path: Path) -> None:
    boxes = [shapely.box(4e5, 5.5e6 - 50, 4e5 + 30, 5.5e6), shapely.box(4e5 + 20, 5.5e6 - 50, 4e5 + 50, 5.5e6)]
    outlines = [
        Footprint(f"photo {i}", np.array(box.exterior.coords)[:-1], (4e5 + 15 + 20 * i, 5.5e6 - 25), 0.5, True)
        for i, box in enumerate(boxes)
    ]
    shares = [shapely.box(4e5, 5.5e6 - 50, 4e5 + 25, 5.5e6), shapely.box(4e5 + 25, 5.5e6 - 50, 4e5 + 50, 5.5e6)]
    path = tmp_path / "m.gpkg"
    write_vectors(path, METRES, SourceImages(outlines, shares, [5, 7], solve_gain_offset(2, 3, [])), overwrite=False)
    footprints, lines = read_layer(path, "footprints"), read_layer(path, "seamlines")
    assert footprints["image"].tolist() == ["photo 0", "photo 1"]
    assert footprints["pixels"].tolist() == [5, 7]
    assert footprints["gain_3"].tolist() == [1.0, 1.0]
    assert footprints.geometry.area.tolist() == [1500.0, 1500.0]
    assert lines[["first", "second"]].values.tolist() == [["photo 0", "photo 1"]]
    assert lines.length[0] == pytest.approx(50.0)
    assert read_layer(path, "seams").geometry.area.tolist() == [1250.0, 1250.0]


CHILD = """
import sys, time
from pathlib import Path
from geomosaic.whole_files import partial
name = partial(Path(sys.argv[1]), ".gpkg")
name.write_bytes(b"half")
Path(f"{name}-journal").write_bytes(b"half")
print(name, flush=True)
time.sleep(60)
"""


@pytest.mark.skipif(os.name == "nt", reason="no signals")
def test_what_a_killed_run_left_goes_and_what_a_living_one_writes_stays(tmp_path: Path) -> None:
    final = tmp_path / "m[1].gpkg"
    others = [tmp_path / ".m[1].gpkg.partial-elsewhere-1", tmp_path / ".m1.gpkg.partial-x-1", tmp_path / "m[1].gpkg"]
    for other in others:
        other.write_bytes(b"mine")
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(final)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    name = Path(child.stdout.readline().strip())
    assert name.name.endswith(f"-{child.pid}.gpkg")
    own = partial(final)
    assert own.parent == tmp_path
    assert name.exists()
    child.send_signal(signal.SIGKILL)
    child.wait()
    child.stdout.close()
    assert partial(final) == own
    assert sorted(tmp_path.iterdir()) == sorted(others)
    own.write_bytes(b"")
    Path(f"{own}.1").write_bytes(b"")
    Path(f"{own}9").write_bytes(b"")
    remove(own)
    assert sorted(tmp_path.iterdir()) == sorted([*others, Path(f"{own}9")])


def test_many_records_are_gathered_in_little_time() -> None:
    record = GeometryRecord()
    for i in range(200_000):
        record.add(0.001 * (i % 7), float(i % 3))
    assert record.error == 0.006
    assert record.scale == 1.0
