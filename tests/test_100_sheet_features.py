"""Sheets from the command line: bleed, records, spot heights, local frames, light colours, dead runs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pytest
import rasterio
import shapely
from PIL import Image
from pyproj import Transformer
from sheet_reading import SheetPdf
from sheet_rig import LEFT, TOP, write

from geomosaic.cli.main import run

pytestmark = pytest.mark.ci

LOCAL = 'LOCAL_CS["wall",UNIT["metre",1],AXIS["Easting",EAST],AXIS["Northing",NORTH]]'


@pytest.fixture(scope="module")
def raster(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An even green."""
    values = np.full((3, 450, 600), 90, np.uint8)
    return write(tmp_path_factory.mktemp("raster") / "green.tif", values, "EPSG:32633", 2.0)


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two hills and a pit, the nodes of which are highest and lowest at places that are known."""
    x, y = np.meshgrid(np.arange(260) * 5.0, np.arange(200) * 5.0)
    z = 200.0 + 0.003 * x
    for col, row, height in ((60, 60, 80.0), (180, 70, 55.0), (120, 140, -45.0)):
        z += height * np.exp(-((x - 5.0 * col) ** 2 + (y - 5.0 * row) ** 2) / (2 * 80.0**2))
    z[60, 60] += 1.0  # a rock that means of nodes would level
    return write(tmp_path_factory.mktemp("dem") / "dem.tif", z.astype(np.float32), "EPSG:32633+5773", 5.0)


def sheet(capsys: pytest.CaptureFixture[str], *words: Any) -> tuple[dict[str, Any], str]:
    code, said = run(["sheet", *map(str, words), "--json"]), capsys.readouterr()
    assert code == 0, said.err
    return json.loads(said.out), said.err


def test_bleed_is_paper_beyond_the_trim(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Same map at the same place of the trim; the paper grows, marks point at the trim from outside the bleed."""
    layout = tmp_path / "layout.toml"
    layout.write_text('[sheet]\ntitle = "B"\nbleed = 3.0\n[scalebar]\nlength = 500.0\n')
    plain = tmp_path / "plain.toml"
    plain.write_text('[sheet]\ntitle = "B"\n[scalebar]\nlength = 500.0\n')
    pages = []
    for name in (layout, plain):
        out = tmp_path / f"{name.stem}.pdf"
        made, _ = sheet(capsys, raster, "--layout", name, "--scale", "1:5000", "--paper", "A3", "-o", out)
        assert made["paper_mm"] == [420.0, 297.0]
        pages.append(SheetPdf(out))
    cut, whole = pages
    assert cut.media == pytest.approx([0, 0, 436, 313], abs=0.01)
    assert cut.trim == pytest.approx([8, 8, 428, 305], abs=0.01)
    assert cut.bleed == pytest.approx([5, 5, 431, 308], abs=0.01)
    assert cut.viewport()[0] == pytest.approx(whole.viewport()[0], abs=0.001)
    (letters, boxes), (same, others) = cut.characters(), whole.characters()
    assert letters == same
    assert boxes == pytest.approx(others, abs=0.01)
    paths = cut.paths(range(2, 3))
    marks = paths[(paths[:, 0] < -2.9) | (paths[:, 1] < -2.9) | (paths[:, 2] > 422.9) | (paths[:, 3] > 299.9)]
    assert len(marks) == 8
    for mark in marks:
        middle, size = (mark[:2] + mark[2:]) / 2, mark[2:] - mark[:2]
        assert size.max() == pytest.approx(5.0, abs=0.25)  # widths of lines included
        edge = (0.0, 297.0) if size[0] > size[1] else (0.0, 420.0)
        assert min(abs(middle[int(size[0] > size[1])] - v) for v in edge) < 0.01
    png = tmp_path / "b.png"
    sheet(capsys, raster, "--layout", layout, "--paper", "A3", "--dpi", "72", "-o", png)
    with Image.open(png) as image:
        assert image.size == (round(436 / 25.4 * 72), round(313 / 25.4 * 72))


def test_notes_come_from_the_records_beside_the_raster(
    raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Days of photography, sources, accuracy; nothing of records of another file; the layout wins."""
    mosaic = tmp_path / "mosaic.tif"
    mosaic.write_bytes(raster.read_bytes())
    size = mosaic.stat().st_size
    days = ("2021-05-04T09:00:00", "2021-05-06T11:30:00Z", "")
    sources = [{"image": f"{k}.jpg", "acquired": day, "gsd_metres": 0.2 + 0.05 * k} for k, day in enumerate(days)]
    item = {
        "properties": {"geomosaic:sources": sources},
        "assets": {"mosaic": {"href": "./mosaic.tif", "file:size": size}},
    }
    report = {
        "outputs": [{"path": "out/mosaic.tif", "bytes": size}],
        "orient": {"sensor": "frame", "rms_check_px": 0.42, "control": [{"role": "check"}] * 7},
    }
    (tmp_path / "mosaic.stac.json").write_text(json.dumps(item))
    (tmp_path / "report.json").write_text(json.dumps(report))
    made, _ = sheet(capsys, mosaic, "-o", tmp_path / "a.pdf")
    assert made["records"] == ["report.json", "mosaic.stac.json"]
    text = " ".join(SheetPdf(tmp_path / "a.pdf").text.split())
    assert "Date of photography: 2021-05-04 to 2021-05-06 (2 of 3 images say when)" in text
    assert "3 images, 0.jpg to 2.jpg, sensor frame, ground pixels of 0.2 to 0.3 m" in text
    assert "Check points 0.42 px RMS in the images (7 measurements)" in text

    layout = tmp_path / "layout.toml"
    layout.write_text('[notes]\nphotography = "spring 2021"\n')
    sheet(capsys, mosaic, "--layout", layout, "-o", tmp_path / "b.pdf")
    text = SheetPdf(tmp_path / "b.pdf").text
    assert "spring 2021" in text
    assert "2021-05-04" not in text
    layout.write_text("[notes]\nrecords = false\n")
    made, _ = sheet(capsys, mosaic, "--layout", layout, "--dpi", "72", "-o", tmp_path / "c.png")
    assert made["records"] == []

    item["assets"] = {"mosaic": {"href": "./mosaic.tif", "file:size": size + 1}}
    (tmp_path / "mosaic.stac.json").write_text(json.dumps(item))
    (tmp_path / "report.json").write_text("[1, 2")
    made, told = sheet(capsys, mosaic, "-o", tmp_path / "d.pdf")
    assert made["records"] == []
    assert "describes another mosaic.tif" in told
    assert "photography" not in SheetPdf(tmp_path / "d.pdf").text


def test_spot_heights_on_the_sheet_and_in_the_package(
    raster: Path, dem: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Heights of the nodes themselves, where they are; dots stand at their places."""
    out = tmp_path / "c.gpkg"
    assert run(["contours", str(dem), "--interval", "5", "--prominence", "20", "-o", str(out), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["summits"], facts["hollows"]) == (2, 1)
    frame = geopandas.read_file(out, layer="spot_heights")
    with rasterio.open(dem) as source:
        z = source.read(1)
    assert sorted(frame["kind"]) == ["hollow", "summit", "summit"]
    nodes = {"60,60", "180,70", "120,140"}
    for point, height in zip(frame.geometry, frame["height"], strict=True):
        col, row = (point.x - LEFT) / 5 - 0.5, (TOP - point.y) / 5 - 0.5
        assert height == pytest.approx(float(z[round(row), round(col)]), abs=1e-3)
        assert any(abs(col - int(n.split(",")[0])) <= 3 and abs(row - int(n.split(",")[1])) <= 3 for n in nodes)
    pdf = tmp_path / "s.pdf"
    made, _ = sheet(capsys, raster, "--contours", dem, "--interval", "10", "--scale", "1:20000", "-o", pdf)
    page = SheetPdf(pdf)
    text = page.text.split()
    top = float(z[60, 60])
    assert f"{top:.0f}" in text
    # The rock is one node of 5 m; the nodes that contours are drawn from are means over 7 m at this scale.
    label = next(line for line in page.lines() if line.text == f"{top:.0f}")
    left, bottom, _, _ = made["neatline_mm"]
    x = left + (LEFT + 302.5 - made["bounds"][0]) / 20.0
    y = bottom + (TOP - 302.5 - made["bounds"][1]) / 20.0
    assert np.hypot(*(label.box.reshape(2, 2).mean(axis=0) - (x, y))) < 4.5
    png = tmp_path / "s.png"
    sheet(capsys, raster, "--contours", dem, "--interval", "10", "--scale", "1:20000", "--dpi", "254", "-o", png)
    with Image.open(png) as image:
        assert image.convert("RGB").getpixel((int(10 * x), int(image.height - 10 * y))) == (0x9A, 0x5B, 0x22)
    layout = tmp_path / "l.toml"
    layout.write_text("[contours]\nspots = false\n")
    sheet(capsys, raster, "--layout", layout, "--contours", dem, "--interval", "10", "-o", tmp_path / "n.pdf")
    assert f"{top:.0f}" not in SheetPdf(tmp_path / "n.pdf").text.split()


def test_a_map_in_a_local_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exact scale and a grid of metres, no north and no place on the Earth, which the web would need."""
    wall = write(tmp_path / "wall.tif", np.full((3, 300, 500), 120, np.uint8), LOCAL, 0.02, (-5.0, 6.0))
    made, _ = sheet(capsys, wall, "--scale", "1:50", "-o", tmp_path / "wall.pdf")
    assert made["convergence_degrees"] is None
    left, bottom, right, top = made["neatline_mm"]
    assert (right - left, top - bottom) == pytest.approx((200.0, 120.0))
    page = SheetPdf(tmp_path / "wall.pdf")
    assert "not tied to the Earth" in page.text
    assert "convergence" not in page.text
    assert "−4" in page.text
    assert b"/Subtype /RL" in page.data
    sheet(capsys, wall, "--scale", "1:50", "--dpi", "127", "-o", tmp_path / "wall_map.tif")
    with rasterio.open(tmp_path / "wall_map.tif") as source:
        assert source.bounds == pytest.approx((-5.0, 0.0, 5.0, 6.0))
        assert (source.width, source.height) == (1000, 600)
    assert run(["sheet", str(wall), "-o", str(tmp_path / "wall.kmz")]) == 1
    assert "not tied to the Earth" in capsys.readouterr().err
    bare = tmp_path / "crack.shp"
    crack = geopandas.GeoDataFrame(geometry=[shapely.LineString([(-4, 1), (4, 5)])], crs=32633)
    crack.to_file(bare)
    bare.with_suffix(".prj").unlink()
    made, _ = sheet(capsys, wall, "--vector", bare, "--scale", "1:50", "-o", tmp_path / "crack.pdf")
    assert made["layers"] == {"crack": 1}
    crack.to_file(tmp_path / "earth.gpkg")
    assert run(["sheet", str(wall), "--vector", str(tmp_path / "earth.gpkg"), "-o", str(tmp_path / "y.pdf")]) == 1
    assert "the map in the local frame 'wall'" in capsys.readouterr().err
    degrees = write(tmp_path / "degrees.tif", np.zeros((1, 20, 20), np.uint8), "EPSG:4326", 0.001, (13.0, 49.0))
    assert run(["sheet", str(degrees), "-o", str(tmp_path / "x.pdf")]) == 1
    assert "no scale" in capsys.readouterr().err


def test_light_colours_can_be_read(raster: Path, dem: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Labels of a white grid are black beside the map; figures on light contours have a dark halo."""
    layout = tmp_path / "layout.toml"
    layout.write_text('[grid]\ncolor = "white"\n[graticule]\nstyle = "none"\n[contours]\ncolor = "#fff3c4"\n')
    made, _ = sheet(capsys, raster, "--layout", layout, "--scale", "1:5000", "--dpi", "100", "-o", tmp_path / "w.png")
    with Image.open(tmp_path / "w.png") as image:
        band = np.asarray(image.convert("L"))
    left, bottom, right, _ = (v / 25.4 * 100 for v in made["neatline_mm"])
    below = band[round(band.shape[0] - bottom + 8) : round(band.shape[0] - bottom + 22), round(left) : round(right)]
    assert (below < 90).sum() > 100


@pytest.mark.parametrize("suffix", ["mbtiles", "kmz"])
def test_a_dead_run_leaves_nothing(
    raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    """What a killed process left under a hidden name goes away with the next run; equal runs make equal bytes."""
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    host = os.uname().nodename if hasattr(os, "uname") else ""
    out = tmp_path / f"map.{suffix}"
    left = tmp_path / f".map.partial-{''.join(c for c in host if c.isalnum()) or 'here'}-{dead.pid}.{suffix}"
    left.write_bytes(b"half")
    left.with_name(f"{left.name}-journal").write_bytes(b"half")
    sheet(capsys, raster, "--dpi", "72", "--title", "T", "-o", out)
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    first = out.read_bytes()
    sheet(capsys, raster, "--dpi", "72", "--title", "T", "--overwrite", "-o", out)
    assert out.read_bytes() == first


@pytest.mark.parametrize("suffix", ["mbtiles", "kmz", "pdf", "png", "tif"])
def test_an_error_leaves_nothing(raster: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str) -> None:
    """The disk is full when the file is brought to it."""

    def full(path: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("geomosaic.whole_files.sync", full)
    assert run(["sheet", str(raster), "--dpi", "72", "-o", str(tmp_path / f"map.{suffix}")]) == 1
    assert list(tmp_path.iterdir()) == []


GPX = """<?xml version="1.0"?><gpx version="1.1" creator="x" xmlns="http://www.topografix.com/GPX/1/1"><trk><name>Walk</name>
<trkseg><trkpt lat="49.6415" lon="13.602"/><trkpt lat="49.645" lon="13.606"/><trkpt lat="49.647" lon="13.612"/></trkseg>
</trk></gpx>"""


def test_a_track_of_a_receiver(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """GPX has its empty layers first; where more than one is full, the others are named."""
    (tmp_path / "walk.gpx").write_text(GPX)
    made, told = sheet(capsys, raster, "--vector", f"{tmp_path / 'walk.gpx'}:track", "-o", tmp_path / "a.pdf")
    assert made["layers"] == {"walk": 1}
    assert "FILE#LAYER" not in told
    (tmp_path / "both.gpx").write_text(
        GPX.replace("<trk>", '<wpt lat="49.645" lon="13.606"><name>Hut</name></wpt><trk>')
    )
    _, told = sheet(capsys, raster, "--vector", tmp_path / "both.gpx", "-o", tmp_path / "b.pdf")
    assert "layer 'waypoints' is drawn; name one with FILE#LAYER for tracks" in told


def test_an_empty_layer_is_reported(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    empty = tmp_path / "none.geojson"
    empty.write_text('{"type": "FeatureCollection", "features": []}')
    made, told = sheet(capsys, raster, "--vector", empty, "-o", tmp_path / "a.pdf")
    assert made["layers"] == {"none": 0}
    assert "the layer is empty" in told


def test_rules_of_foreign_styles_are_reported(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A rule that is not understood is named in a note, and the sheet is made."""
    (tmp_path / "walk.gpx").write_text(GPX)
    (tmp_path / "walk.sld").write_text(
        '<StyledLayerDescriptor version="1.0.0" xmlns="http://www.opengis.net/sld" '
        'xmlns:ogc="http://www.opengis.net/ogc"><NamedLayer><UserStyle><FeatureTypeStyle>'
        "<Rule><LineSymbolizer><Stroke><CssParameter name='stroke'>#ff0000</CssParameter></Stroke></LineSymbolizer>"
        "</Rule>"
        "<Rule><ogc:Filter><ogc:BBOX/></ogc:Filter><LineSymbolizer><Stroke/></LineSymbolizer></Rule>"
        "</FeatureTypeStyle></UserStyle></NamedLayer></StyledLayerDescriptor>"
    )
    words = ("--vector", f"{tmp_path / 'walk.gpx'}:{tmp_path / 'walk.sld'}")
    _, told = sheet(capsys, raster, *words, "-o", tmp_path / "a.pdf")
    assert "not understood" in told
    assert "the rule 2 by its filter (BBOX)" in told


@pytest.mark.parametrize("collar", [False, True])
def test_a_raster_geopdf(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], collar: bool) -> None:
    """Read back by PDFium: the page has the size of the print, its pixels are those of the GeoTIFF of the same sheet,
    and its corners are where the GeoTIFF has them."""
    words = [raster, "--scale", "1:5000", "--dpi", "127", *(["--collar"] if collar else [])]
    titled = ["--title", "Grüne Fläche"]
    made, _ = sheet(capsys, *words, *titled, "--driver", "PDF", "-o", tmp_path / "a.pdf")
    sheet(capsys, *words, *(titled if collar else []), "-o", tmp_path / "a.tif")
    page = SheetPdf(tmp_path / "a.pdf")
    with rasterio.open(tmp_path / "a.tif") as source:
        wanted = np.moveaxis(source.read(), 0, 2)
        left, bottom, right, top = source.bounds
    size = np.array(wanted.shape[1::-1]) * 25.4 / 127
    assert page.media == pytest.approx([0, 0, *size], abs=1e-3)
    if not collar:
        neatline = np.array(made["neatline_mm"])
        assert size == pytest.approx(neatline[2:] - neatline[:2], abs=0.2)
    pixels, place = page.picture()
    assert np.array_equal(pixels, wanted)
    assert place == pytest.approx(page.media, abs=1e-3)
    assert page.title() == "Grüne Fläche"
    box, parts, degrees = page.viewport()
    assert box == pytest.approx(page.media, abs=1e-3)
    x, y = Transformer.from_crs("EPSG:4326", "EPSG:32633", always_xy=True).transform(*degrees.T)
    tenth = 0.5  # metres: 0.1 mm on the sheet
    assert x == pytest.approx(left + parts[:, 0] * (right - left), abs=tenth)
    assert y == pytest.approx(bottom + parts[:, 1] * (top - bottom), abs=tenth)
    first = (tmp_path / "a.pdf").read_bytes()
    sheet(capsys, *words, *titled, "--driver", "PDF", "--overwrite", "-o", tmp_path / "a.pdf")
    assert (tmp_path / "a.pdf").read_bytes() == first


def test_a_raster_geopdf_is_refused(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wall = write(tmp_path / "wall.tif", np.full((3, 300, 500), 120, np.uint8), LOCAL, 0.02, (-5.0, 6.0))
    for words, said in (([raster, "-o", "x.tif"], "end the name in .pdf"), ([wall, "-o", "x.pdf"], "not tied to the")):
        given = [str(tmp_path / word) if str(word).startswith("x.") else str(word) for word in words]
        assert run(["sheet", *given, "--driver", "PDF"]) == 1
        assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["wall.tif"]
