"""Sheets and contours from the command line, measured on what was written."""

from __future__ import annotations

import json
import re
import zlib
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine
from PIL import Image
from pyproj import Transformer
from sheet_reading import SheetPdf, overlaps

from geomosaic.cli.main import run

LEFT, TOP, PIXEL = 399_000.0, 5_500_600.0, 1.0
SIZE = (1200, 900)
BLOCK = 100
"""The raster is a chequerboard of this many metres; its corners lie at whole multiples."""


@pytest.fixture(scope="module")
def raster(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A chequerboard of two greens in UTM 33."""
    path = tmp_path_factory.mktemp("raster") / "board_map.tif"
    row, col = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    light = ((row // BLOCK + col // BLOCK) % 2).astype(np.uint8)
    values = np.stack([80 + 80 * light, 120 + 80 * light, 70 + 80 * light]).astype(np.uint8)
    with rasterio.open(
        path, "w", driver="GTiff", width=SIZE[0], height=SIZE[1], count=3, dtype="uint8", crs="EPSG:32633",
        transform=Affine(PIXEL, 0, LEFT, 0, -PIXEL, TOP),
    ) as out:  # fmt: skip
        out.write(values)
    return path


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cone of slope 1:5 about the middle of the board, in EGM96 heights."""
    path = tmp_path_factory.mktemp("dem") / "cone.tif"
    x = LEFT - 100 + 10 * (np.arange(140) + 0.5)
    y = TOP + 100 - 10 * (np.arange(110) + 0.5)
    z = 300.0 - 0.2 * np.hypot(x[None] - (LEFT + 600), y[:, None] - (TOP - 450))
    with rasterio.open(
        path, "w", driver="GTiff", width=140, height=110, count=1, dtype="float32", crs="EPSG:32633+5773",
        transform=Affine(10, 0, LEFT - 100, 0, -10, TOP + 100),
    ) as out:  # fmt: skip
        out.write(z.astype(np.float32), 1)
    return path


@pytest.fixture(scope="module")
def roads(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two roads in longitude and latitude, one of which ends far outside."""
    path = tmp_path_factory.mktemp("roads") / "roads.geojson"
    lines = [
        shapely.LineString([(LEFT + 100, TOP - 250), (LEFT + 900, TOP - 250)]),
        shapely.LineString([(LEFT + 450, TOP - 900), (LEFT + 450, TOP + 9000)]),
    ]
    frame = geopandas.GeoDataFrame({"name": ["Long Street", "Straße Łódź"]}, geometry=lines, crs="EPSG:32633")
    frame.to_crs("EPSG:4326").to_file(path)
    return path


def sheet(capsys: pytest.CaptureFixture[str], *words: Any) -> dict[str, Any]:
    """Run the command; returns what it prints as JSON."""
    code, text = run(["sheet", *map(str, words), "--json"]), capsys.readouterr().out
    assert code == 0, text
    found: dict[str, Any] = json.loads(text)
    return found


def paths_of(pdf: bytes) -> list[np.ndarray]:
    """Vertices of all paths of a PDF in mm, read off its content streams."""
    found = []
    for raw in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.DOTALL):
        try:
            text = zlib.decompress(raw)
        except zlib.error:
            continue
        if b" l\n" not in text:
            continue
        for piece in re.findall(rb"((?:-?[\d.]+ -?[\d.]+ [ml]\n)+)", text):
            numbers = np.array(re.findall(rb"(-?[\d.]+) (-?[\d.]+) [ml]\n", piece), dtype=float)
            found.append(numbers * 25.4 / 72.0)
    return found


def widths(paths: list[np.ndarray], height: float) -> list[float]:
    """Widths of the upright rectangles of a height, mm."""
    boxes = [np.ptp(path, axis=0) for path in paths if len(path) in (4, 5)]
    return [float(w) for w, h in boxes if abs(h - height) < 0.02]


def test_a_bar_of_ten_centimetres_measures_ten_centimetres(
    raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Read off the vectors of the PDF: within 0.01 mm; and so is the neatline."""
    layout = tmp_path / "layout.toml"
    layout.write_text('[scalebar]\nlength = 500.0\n[sheet]\ntitle = "Board"\n')
    out = tmp_path / "sheet.pdf"
    made = sheet(capsys, raster, "--layout", layout, "--scale", "1:5000", "--paper", "A3", "-o", out)
    paths = paths_of(out.read_bytes())
    assert pytest.approx(min(widths(paths, 2.2), key=lambda w: abs(w - 100.0)), abs=0.01) == 100.0
    # Five parts of 20 mm each, black in one row or the other.
    assert sum(abs(w - 20.0) < 0.01 for w in widths(paths, 1.1)) == 5
    left, bottom, right, top = made["neatline_mm"]
    assert right - left == pytest.approx((made["bounds"][2] - made["bounds"][0]) / 5.0, abs=1e-9)
    corners = np.array([(left, bottom), (right, bottom), (right, top), (left, top)])
    assert any(len(path) in (4, 5) and np.abs(path[:4] - corners).max() < 0.01 for path in paths), (
        "the neatline is not where it is said to be"
    )


def test_the_picture_lies_true_in_the_png(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Edges of the chequerboard in a 300 dpi PNG, against where scale and neatline put them: within a pixel."""
    out = tmp_path / "sheet.png"
    layout = tmp_path / "layout.toml"
    layout.write_text('[grid]\nstyle = "none"\n[graticule]\nstyle = "none"\n')
    words = ("--layout", layout, "--scale", "1:5000", "--paper", "A3", "--dpi", "300")
    made = sheet(capsys, raster, *words, "-o", out)
    with Image.open(out) as image:
        assert image.info["dpi"] == pytest.approx((300, 300), abs=0.1)
        assert image.size == (round(420 / 25.4 * 300), round(297 / 25.4 * 300))
        pixels = np.asarray(image.convert("L")).astype(float)
    left, bottom, right, top = made["neatline_mm"]
    row = pixels.shape[0] - round((bottom + top) / 2 / 25.4 * 300 + 3)
    inside = slice(int((left + 3) / 25.4 * 300), int((right - 3) / 25.4 * 300))
    steps = np.abs(np.diff(pixels[row, inside]))
    edges = (
        np.flatnonzero((steps > 20) & (steps >= np.roll(steps, 1)) & (steps >= np.roll(steps, -1))) + inside.start + 1
    )
    metres = made["bounds"][0] + (edges / 300 * 25.4 - left) * 5.0
    off = metres - np.round(metres / BLOCK) * BLOCK
    assert len(edges) >= 8
    assert np.abs(off).max() < 5.0 * 25.4 / 300  # a pixel of the print


def test_the_geotiff_is_cut_at_the_neatline(
    raster: Path, roads: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its upper left corner is that of the neatline, its pixels are those of the print, and the roads are burned in."""
    out = tmp_path / "map.tif"
    bounds = (399_050.0, 5_499_800.0, 400_050.0, 5_500_550.0)
    made = sheet(
        capsys, raster, "--scale", "1:5000", "--bounds", *bounds, "--dpi", "254", "--vector", f"{roads}:road", "-o", out
    )
    assert made["bounds"] == pytest.approx(bounds)
    with rasterio.open(out) as dataset:
        assert dataset.crs.to_epsg() == 32633
        assert (dataset.width, dataset.height) == (2000, 1500)
        assert tuple(dataset.bounds) == pytest.approx(bounds)
        red = dataset.read(1)
        col, row = (int(v) for v in ~dataset.transform @ (LEFT + 600.0, TOP - 250.0))
        assert red[row, col] == 255  # the middle of a white road
        col, row = (int(v) for v in ~dataset.transform @ (LEFT + 330.0, TOP - 330.0))
        assert red[row, col] == 80 + 80 * 0


# By default series are held to it as PDF and GeoTIFF, in test_100_sheets.
@pytest.mark.parametrize("suffix", ["png", *(pytest.param(s, marks=pytest.mark.slow) for s in ("pdf", "tif"))])
def test_equal_runs_make_equal_bytes(
    raster: Path, roads: Path, dem: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    files = [tmp_path / f"{name}.{suffix}" for name in "ab"]
    title = [] if suffix == "tif" else ["--title", "T"]
    for file in files:
        sheet(capsys, raster, "--vector", roads, "--contours", dem, "--dpi", "100", *title, "-o", file)
    assert files[0].read_bytes() == files[1].read_bytes()


def test_the_pdf_says_where_it_lies(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its measure dictionary puts the neatline's corners where they are: GPTS against PROJ within a millimetre."""
    out = tmp_path / "sheet.pdf"
    made = sheet(capsys, raster, "-o", out)
    text = out.read_bytes()
    assert text.count(b"/Type /Viewport") == 1
    assert b"/Subtype /GEO" in text
    assert b"/EPSG 32633" in text

    def numbers(key: bytes) -> list[float]:
        found = re.search(key + rb" \[ ([^\]]*)\]", text)
        assert found
        return [float(v) for v in found[1].split()]

    assert np.array(numbers(b"/BBox")) * 25.4 / 72 == pytest.approx(made["neatline_mm"], abs=1e-5)
    lat, lon = np.array(numbers(b"/GPTS")).reshape(-1, 2).T
    x, y = Transformer.from_crs("EPSG:4326", "EPSG:32633", always_xy=True).transform(lon, lat)
    share = np.array(numbers(b"/LPTS")).reshape(-1, 2)
    left, bottom, right, top = made["bounds"]
    assert x == pytest.approx(left + share[:, 0] * (right - left), abs=1e-3)
    assert y == pytest.approx(bottom + share[:, 1] * (top - bottom), abs=1e-3)
    # The cross-reference of the update leads to the page, and on to the table before it.
    start = int(re.findall(rb"startxref\s+(\d+)", text)[-1])
    assert text[start : start + 4] == b"xref"
    at = int(text[start:].split(b"\n")[2].split()[0])
    assert b"/VP" in text[at : text.index(b"endobj", at)]


def test_a_river_is_named_along_its_bends(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Read back from the PDF: the name is one text, each letter lies on the river, and none meets another."""
    pytest.importorskip("pypdfium2", reason="reading PDF back needs pypdfium2")
    t = np.radians(np.linspace(150.0, 30.0, 500))
    river = np.column_stack([LEFT + 600 + 250 * np.cos(t), TOP - 600 + 250 * np.sin(t)])  # 50 mm on paper
    frame = geopandas.GeoDataFrame(
        {"name": ["Sinuosa Grande 1"]}, geometry=[shapely.LineString(river)], crs="EPSG:32633"
    )
    frame.to_file(tmp_path / "river.gpkg")
    style = tmp_path / "river.toml"
    style.write_text('[line]\ncolor = "#2060c0"\n[label]\ncolumn = "name"\nsize = 14.0\nitalic = true\n')
    out = tmp_path / "sheet.pdf"
    layer = f"{tmp_path / 'river.gpkg'}:{style}"
    made = sheet(capsys, raster, "--scale", "1:5000", "--paper", "A3", "--title", "River", "--vector", layer, "-o", out)
    pdf = SheetPdf(out)
    assert "Sinuosa Grande 1" in pdf.text
    letters, boxes = pdf.characters()
    assert overlaps(letters, boxes) == []
    first = "".join(letters).index("SinuosaGrande1")
    box, (left, bottom, right, top) = pdf.map_box(), made["bounds"]
    share = ((boxes[:, :2] + boxes[:, 2:]) / 2 - box[:2]) / (box[2:] - box[:2])
    ground = (left, bottom) + share[first : first + 14] * (right - left, top - bottom)
    off = shapely.distance(shapely.points(ground), shapely.LineString(river)) / 5.0  # mm on paper
    assert off.max() < 1.0  # small letters and tails lie lower or higher than the middle of the capitals
    straight = shapely.LineString([ground[0], ground[-1]])
    assert shapely.distance(shapely.points(ground), straight).max() / 5.0 > 1.0


def test_text_stays_text_in_embedded_fonts(
    raster: Path, roads: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Read back by PDFium: page size, title, a name beyond Latin-1, coordinates; every font is in the file."""
    pdfium = pytest.importorskip("pypdfium2", reason="reading PDF back needs pypdfium2")
    style = tmp_path / "roads.toml"
    style.write_text('[line]\ncolor = "red"\n[label]\ncolumn = "name"\n')
    out = tmp_path / "sheet.pdf"
    sheet(capsys, raster, "--title", "Zażółć $5 & Ελλάδα", "--vector", f"{roads}:{style}", "--paper", "A4", "-o", out)
    document = pdfium.PdfDocument(str(out))
    page = document[0]
    assert [v * 25.4 / 72 for v in page.get_size()] == pytest.approx([297.0, 210.0], abs=0.01)
    text = page.get_textpage().get_text_range().replace("\u202f", " ")
    for words in ("Zażółć $5 & Ελλάδα", "Long Street", "Straße Łódź", "399 500", "1 : 10 000", "Legend"):
        assert words in text, words
    data = out.read_bytes()
    assert data.count(b"/FontFile2") == data.count(b"/Type /FontDescriptor") > 0
    # Each font is cut to its characters once, those beyond Latin-1 with the others.
    embedded = re.findall(rb"/Type0 /BaseFont /[A-Z]{6}\+([\w-]+)", data)
    assert len(embedded) == len(set(embedded)) == data.count(b"/FontFile2")


def test_glyphs_that_are_missing_are_named(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sheet", str(raster), "--title", "地図 map", "--dpi", "72", "-o", str(tmp_path / "s.png")]) == 0
    assert "no glyph for: 地 図" in capsys.readouterr().err


def test_contours_on_sheet_and_in_a_geopackage(
    raster: Path, dem: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rings of the cone have the radius of their height; those that leave the DEM end at its nodes."""
    out = tmp_path / "contours.gpkg"
    assert run(["contours", str(dem), "--interval", "20", "--index", "2", "-o", str(out), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    frame = geopandas.read_file(out, layer="contours")
    assert frame.crs.to_epsg() == 32633
    assert facts["lines"] == len(frame)
    assert facts["heights"] == "EGM96 height"
    assert facts["deviation"] <= facts["tolerance"] == 2.0
    rings = frame[frame.geometry.is_closed]
    assert len(rings) >= 4
    for height, main, ring in zip(rings["height"], rings["main"], rings.geometry, strict=True):
        xy = np.asarray(ring.coords)[:, :2]
        radius = np.hypot(xy[:, 0] - (LEFT + 600), xy[:, 1] - (TOP - 450))
        assert np.abs(radius - (300 - height) / 0.2).max() < 10.0  # the tolerance of 2 m on a slope of 1:5
        assert main == (height % 40 == 0)
    made = sheet(
        capsys,
        raster,
        "--contours",
        dem,
        "--interval",
        "20",
        "--dpi",
        "72",
        "--scale",
        "1:5000",
        "-o",
        tmp_path / "s.png",
    )
    assert made["contours"] > 5
    assert made["contour_interval"] == 20


def test_accuracy_comes_from_the_report(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = tmp_path / "report.json"
    report.write_text(
        json.dumps({"orient": {"rms_check_px": 0.5, "control": [{"role": "check"}]}, "mosaic": {}, "check": {}})
    )
    sheet(capsys, raster, "--report", report, "--dpi", "72", "-o", tmp_path / "a.png")
    report.write_text('{"type": "FeatureCollection"}')
    assert run(["sheet", str(raster), "--report", str(report), "-o", str(tmp_path / "b.png")]) == 1
    assert "no report of a project" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scale", "1:0"], "no scale"),
        (["--paper", "B7"], "no paper"),
        (["--bounds", "0", "0", "10", "10"], "beside the picture"),
        (["--vector", "{roads}:raod"], "did you mean 'road'"),
        (["--vector", "nowhere.gpkg"], "does not exist"),
        (["--vector", "{bare}"], "the layer has no CRS"),
        (["--layout", "{layout}"], "did you mean 'title'"),
        (["--scale", "1:100", "--paper", "A4", "--bounds", "399100", "5499800", "399900", "5500500"], "has room for"),
    ],
)
def test_bad_input_is_reported_and_nothing_is_written(
    raster: Path, roads: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    bare = tmp_path / "bare.shp"
    geopandas.GeoDataFrame(geometry=[shapely.Point(LEFT + 9, TOP - 9)], crs=32633).to_file(bare)
    bare.with_suffix(".prj").unlink()
    layout = tmp_path / "layout.toml"
    layout.write_text('[sheet]\ntitel = "x"\n')
    out = tmp_path / "out.pdf"
    given = [word.format(roads=roads, bare=bare, layout=layout) for word in words]
    assert run(["sheet", str(raster), *given, "-o", str(out)]) in (1, 2)
    assert said in capsys.readouterr().err
    assert not out.exists()
    assert not list(tmp_path.glob(".*partial*"))


def test_other_refusals(raster: Path, dem: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sheet", str(raster), "-o", str(tmp_path / "x.svg")]) == 1
    assert "end the name in .pdf" in capsys.readouterr().err
    (tmp_path / "x.png").write_text("mine")
    assert run(["sheet", str(raster), "-o", str(tmp_path / "x.png")]) == 1
    assert (tmp_path / "x.png").read_text() == "mine"
    turned = tmp_path / "turned.tif"
    with rasterio.open(
        turned, "w", driver="GTiff", width=9, height=9, count=1, dtype="uint8", crs="EPSG:32633",
        transform=Affine(1, 0.1, LEFT, 0.1, -1, TOP),
    ) as out:  # fmt: skip
        out.write(np.ones((1, 9, 9), np.uint8))
    assert run(["sheet", str(turned), "-o", str(tmp_path / "y.png")]) == 1
    assert "not north up" in capsys.readouterr().err
    assert run(["contours", str(dem), "--interval", "1000", "-o", str(tmp_path / "c.gpkg")]) == 1
    assert "do not reach a multiple" in capsys.readouterr().err
    assert run(["contours", str(raster), "-o", str(tmp_path / "c.gpkg")]) == 1
    assert "vertical datum" in capsys.readouterr().err


def test_a_distance_of_spot_heights_without_any_is_refused(
    dem: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "c.gpkg"
    assert run(["contours", str(dem), "--prominence", "0", "--spacing", "30", "-o", str(out)]) == 1
    assert "--spacing would do nothing with --prominence 0.0" in capsys.readouterr().err
    assert not out.exists()
