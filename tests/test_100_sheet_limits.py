"""Sheets of odd wishes: long titles, other scripts, lent fonts, large figures, wrong places; read back by PDFium."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pytest
import shapely
from sheet_reading import SheetPdf, crossing, overlaps
from sheet_rig import LEFT, TOP, write

import geomosaic as gm
from geomosaic.cli.main import run

pytestmark = pytest.mark.ci


@pytest.fixture(scope="module")
def raster(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(
        tmp_path_factory.mktemp("raster") / "grey.tif", np.full((3, 90, 120), 140, np.uint8), "EPSG:32633", 10.0
    )


def made(
    raster: Path, folder: Path, layout: str, capsys: pytest.CaptureFixture[str], *more: Any
) -> tuple[SheetPdf, str]:
    """Sheet of a layout, and what was said."""
    (folder / "layout.toml").write_text(layout, encoding="utf-8")
    out = folder / "sheet.pdf"
    words = [str(word) for word in more]
    code = run(["sheet", str(raster), "--layout", str(folder / "layout.toml"), "--dpi", "72", *words, "-o", str(out)])
    said = capsys.readouterr().err
    assert code == 0, said
    return SheetPdf(out), said


def check(sheet: SheetPdf) -> None:
    """No two texts overlap, none leaves the paper or crosses the neatline or the frame of the panel."""
    letters, boxes = sheet.characters()
    assert overlaps(letters, boxes) == []
    size = sheet.trim[2:] - sheet.trim[:2]
    assert (boxes[:, :2] >= 1.0).all()
    assert (boxes[:, 2:] <= size - 1.0).all()
    frames = sheet.paths(range(4, 7))
    frames = frames[((frames[:, 2:] - frames[:, :2]) > 25.0).all(axis=1)]
    for frame in (*frames, sheet.map_box()):
        assert not crossing(boxes, frame).size, "".join(letters[k] for k in crossing(boxes, frame))


LONG = (
    "An exceedingly long title of a sheet that somebody has written without a thought of the paper it has to stand on, "
)


@pytest.mark.parametrize("paper", [pytest.param("A3", marks=pytest.mark.slow), "A4", "150x210"])
def test_long_titles_are_made_smaller_then_cut_and_reported(
    raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], paper: str
) -> None:
    layout = (
        f'[sheet]\npaper = "{paper}"\ntitle = """{LONG}\\n{LONG}"""\nsubtitle = "{LONG}"\nseries = "{LONG}"\n'
        f'number = "33-117-4-c-2-Southern-Annex"\nname = "{LONG}"\n[legend]\ntitle = "{LONG}"\n'
    )
    sheet, said = made(raster, tmp_path, layout, capsys)
    check(sheet)
    assert said.count("no room above the map for all of") >= 2
    assert "An exceedingly long" in sheet.text
    assert "…" in sheet.text


def test_what_fits_is_not_cut(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    layout = '[sheet]\ntitle = "Sample Valley"\nsubtitle = "North"\nseries = "Series 1"\nnumber = "12"\nname = "Mill"\n'
    sheet, said = made(raster, tmp_path, layout, capsys)
    assert "no room" not in said
    assert "…" not in sheet.text
    assert "Series 1 · Mill" in sheet.text


@pytest.mark.parametrize("size", [4.0, 10.0])
def test_both_rows_of_coordinates_have_room(
    raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], size: float
) -> None:
    sheet, _ = made(raster, tmp_path, f"[grid]\nsize = {size}\n[graticule]\nsize = {size}\n", capsys)
    check(sheet)
    assert "399 600" in sheet.text
    assert "13°36′" in sheet.text


def test_a_font_lends_what_the_sheet_lacks(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A font of one glyph, made here, is embedded and its character read back; without it a note names it."""
    plain, said = made(raster, tmp_path, '[sheet]\ntitle = "\u5317 Hill"\n', capsys)
    assert "no glyph for: \u5317" in said
    one_glyph(tmp_path / "lent.ttf", "\u5317")
    (tmp_path / "sheet.pdf").unlink()
    sheet, said = made(raster, tmp_path, '[sheet]\ntitle = "\u5317 Hill"\nfonts = ["lent.ttf"]\n', capsys)
    assert "glyph" not in said
    assert "\u5317 Hill" in sheet.text
    assert sheet.fonts_embedded()
    assert len(sheet.data) > len(plain.data) - 20_000
    check(sheet)
    (tmp_path / "layout.toml").write_text('[sheet]\nfonts = ["none.ttf"]\n')
    assert run(["sheet", str(raster), "--layout", str(tmp_path / "layout.toml"), "-o", str(tmp_path / "b.pdf")]) == 1
    assert "the font cannot be read" in capsys.readouterr().err


def one_glyph(path: Path, character: str) -> None:
    """Write a font of one character, a box."""
    from fontTools.fontBuilder import FontBuilder
    from fontTools.pens.ttGlyphPen import TTGlyphPen

    pen = TTGlyphPen(None)
    for k, corner in enumerate(((100, 0), (100, 800), (900, 800), (900, 0))):
        (pen.moveTo if k == 0 else pen.lineTo)(corner)
    pen.closePath()
    glyph = pen.glyph()
    font = FontBuilder(1000, isTTF=True)
    font.setupGlyphOrder([".notdef", "box"])
    font.setupCharacterMap({ord(character): "box"})
    font.setupGlyf({".notdef": glyph, "box": glyph})
    font.setupHorizontalMetrics({".notdef": (1000, 100), "box": (1000, 100)})
    font.setupHorizontalHeader(ascent=900, descent=-100)
    font.setupNameTable({"familyName": "Lent Sans", "styleName": "Regular"})
    font.setupOS2()
    font.setupPost()
    font.save(path)


def test_names_are_one_line_each(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    places = [shapely.Point(LEFT + 300, TOP - 300), shapely.Point(LEFT + 800, TOP - 600)]
    frame = geopandas.GeoDataFrame({"name": ["two\nlines", "\u0646\u0647\u0631"]}, geometry=places, crs=32633)
    frame.to_file(tmp_path / "places.gpkg")
    (tmp_path / "names.toml").write_text('[marker]\n[label]\ncolumn = "name"\n')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        layout = '[[layer]]\nfile = "places.gpkg"\nstyle = "names.toml"\n'
        sheet, said = made(raster, tmp_path, layout, capsys)
    assert "two lines" in sheet.text
    assert "glyph" not in said
    check(sheet)


@pytest.mark.parametrize("place", [(-20_000.0, -900_000.0), (900_000.0, 400_000.0), (-100_000.0, 1_500_000.0)])
def test_arrows_of_the_far_north_stay_in_their_panel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], place: tuple[float, float]
) -> None:
    """Grid north of a polar map points anywhere: up to 180 degrees from true north."""
    raster = write(tmp_path / "polar.tif", np.full((3, 90, 120), 140, np.uint8), "EPSG:3413", 300.0, place)
    sheet, said = made(raster, tmp_path, '[north]\nmagnetic_date = "2026"\n', capsys)
    assert "no room" not in said
    check(sheet)
    assert "meridian convergence" in sheet.text.replace("\n", " ").replace("\r", "")


def test_a_map_beside_the_picture_is_refused(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    layout, out = tmp_path / "layout.toml", tmp_path / "sheet.pdf"
    layout.write_text("[map]\nscale = 5000\ncentre = [500000.0, 5500000.0]\n")
    assert run(["sheet", str(raster), "--layout", str(layout), "-o", str(out)]) == 1
    assert "lies beside the picture" in capsys.readouterr().err
    layout.write_text('[sheet]\npaper = "5000x5000"\ndpi = 2400\n')
    assert run(["sheet", str(raster), "--layout", str(layout), "-o", str(out)]) == 1
    assert "too many pixels" in capsys.readouterr().err
    layout.write_text("[grid]\nsize = 40.0\n")
    assert run(["sheet", str(raster), "--layout", str(layout), "-o", str(out)]) == 1
    assert "give a number above 0 and at most 10" in capsys.readouterr().err
    assert not out.exists()


def test_what_small_paper_leaves_out_is_reported(
    raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sheet, said = made(raster, tmp_path, '[sheet]\npaper = "100x120"\n', capsys)
    assert "too small for legend, north arrow and notes" in said
    check(sheet)
    _, said = made(raster, tmp_path, '[sheet]\npaper = "100x120"\npanel = "none"\n', capsys, "--overwrite")
    assert "too small" not in said


def test_a_dem_with_gaps_is_reported(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    x, y = np.meshgrid(np.arange(60) * 10.0, np.arange(90) * 10.0)
    dem = write(tmp_path / "half.tif", (300 + 0.1 * x + 0.05 * y).astype(np.float32), "EPSG:32633+5773", 10.0)
    _, said = made(raster, tmp_path, "", capsys, "--contours", dem)
    assert "heights on 50 % of the sheet" in said


def test_facts_name_the_paper(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "s.png"
    assert run(["sheet", str(raster), "--paper", "80x200", "--dpi", "72", "-o", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["paper_mm"] == [80.0, 200.0]


def polygons(folder: Path, names: list[str | None]) -> Path:
    """Areas side by side."""
    boxes = [shapely.box(LEFT + 50 + 120 * k, TOP - 300, LEFT + 130 + 120 * k, TOP - 200) for k in range(len(names))]
    path = folder / "areas.gpkg"
    kinds = [("x", "y")[k % 2] for k in range(len(names))]
    geopandas.GeoDataFrame({"name": names, "kind": kinds}, geometry=boxes, crs="EPSG:32633").to_file(path)
    return path


def test_what_a_rule_hides_has_no_name(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nor has what no rule draws; a style without a symbol for its objects says so."""
    areas = polygons(tmp_path, ["Alpha", "Beta", "Gamma", "Delta"])
    style = tmp_path / "style.toml"
    rule = 'column = "kind"\n[label]\ncolumn = "name"\nsize = 5.0\n[[category]]\nvalue = "x"\n'
    for more in (
        "hide = true\n[[category]]\nvalue = 'y'\nline = { color = 'white' }\n",
        "line = { color = 'white' }\n",
    ):
        style.write_text(rule + more)
        text = made(raster, tmp_path, "", capsys, "--vector", f"{areas}:{style}", "--overwrite")[0].text
        shown = {name for name in ("Alpha", "Beta", "Gamma", "Delta") if name in text}
        assert shown == ({"Beta", "Delta"} if "hide" in more else {"Alpha", "Gamma"})
    style.write_text("[marker]\nsize = 2.0\n")
    assert (
        "nothing for polygons" in made(raster, tmp_path, "", capsys, "--vector", f"{areas}:{style}", "--overwrite")[1]
    )


def test_names_that_fit_nowhere_are_counted(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A line that is too short for its name, and one that turns too sharply."""
    t = np.radians(np.linspace(0, 300, 60))
    lines = [
        shapely.LineString([(LEFT + 100, TOP - 100), (LEFT + 120, TOP - 100)]),
        shapely.LineString(np.column_stack([LEFT + 500 + 20 * np.cos(t), TOP - 400 + 20 * np.sin(t)])),
        shapely.LineString([(LEFT + 100, TOP - 600), (LEFT + 1100, TOP - 600)]),
    ]
    path = tmp_path / "lines.gpkg"
    names = ["Allee zu kurz", "Rund um den Platz", "Lange Gerade"]
    geopandas.GeoDataFrame({"name": names}, geometry=lines, crs="EPSG:32633").to_file(path)
    style = tmp_path / "style.toml"
    style.write_text('[line]\ncolor = "red"\n[label]\ncolumn = "name"\n')
    sheet, said = made(raster, tmp_path, "", capsys, "--vector", f"{path}:{style}")
    assert "Lange Gerade" in sheet.text
    assert "Rund" not in sheet.text
    assert "2 of 3 names have no room" in said


@pytest.mark.parametrize(
    ("layout", "words", "told"),
    [
        ("[map]\nbounds = [399000, 5499000, 400000, 5500000]\ncentre = [399500, 5499500]\n", (), "bounds and a centre"),
        ("[map]\nscale = 0.5\n", (), "scale"),
        ("[scalebar]\nlength = 0.01\n", (), "too little for its figures"),
        (
            "",
            ("--scale", "1:5000", "--paper", "A4", "--bounds", "L", "B", "R", "T"),
            "the paper has room",
        ),
    ],
)
def test_what_does_not_fit_is_reported(
    layout: str, words: tuple[str, ...], told: str, raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each by its own name, and nothing is written."""
    places = {"L": LEFT - 4000, "B": TOP - 5000, "R": LEFT + 5000, "T": TOP + 4000}
    (tmp_path / "layout.toml").write_text(layout)
    flags = [str(places.get(word, word)) for word in words]
    code = run(["sheet", str(raster), "--layout", str(tmp_path / "layout.toml"), *flags, "-o", str(tmp_path / "x.pdf")])
    assert code != 0
    assert told in capsys.readouterr().err
    assert not (tmp_path / "x.pdf").exists()


def test_a_picture_that_is_cut_is_reported(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "of the picture's width" in made(raster, tmp_path, "", capsys, "--scale", "1:2500", "--paper", "A4")[1]


def test_a_map_that_is_small_on_its_paper_is_given_a_scale_that_fills_it(raster: Path, tmp_path: Path) -> None:
    def said(scale: float, **options: Any) -> list[str]:
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            gm.sheet(raster, tmp_path / f"{scale}.tif", scale=scale, dpi=72, overwrite=True, **options)
        return [str(item.message) for item in found]

    assert said(100_000, paper="A4") == ["at 1:100000 the map is 12 x 9 mm on A4; `scale=1:10000` fills the paper"]
    assert said(10_000, paper="A4") == []
    (large,) = said(3_000_000)
    assert large.startswith("at 1:3000000 the map is 0 x 0 mm on A4")
    # A part of the raster that is asked for, too.
    part = (LEFT + 100, TOP - 200, LEFT + 300, TOP - 100)
    (small,) = said(50_000, paper="A3", bounds=part)
    assert small == "at 1:50000 the map is 4 x 2 mm on A3; `scale=1:1000` fills the paper"


IDLE = (
    ("x.png --collar", "--collar would do nothing without --output .tif or --driver PDF"),
    ("x.pdf --collar", "--collar would do nothing"),
    ("x.mbtiles --collar", "--collar would do nothing"),
    ("x.png --driver COG", "--driver COG does not write '.png'"),
    ("x.pdf --driver COG", "--driver COG does not write '.pdf'"),
    ("x.tif --driver PDF", "--driver PDF does not write '.tif'"),
    ("x.pdf --interval 5", "--interval would do nothing without --contours"),
    ("x.pdf --dem-heights egm96", "--dem-heights would do nothing without --contours or --hillshade"),
    ("x.tif --report report.json", "--report would do nothing without --collar or --output .pdf or --output .png"),
    ("x.pdf --driver PDF --report report.json", "--report would do nothing without --collar"),
    ("x.pdf --layout bare.toml --report report.json", "--report would do nothing with `panel=none`"),
    ("x.tif --title T", "--title would do nothing"),
)


@pytest.mark.parametrize(("words", "told"), IDLE)
def test_an_option_that_would_do_nothing_is_refused(
    raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: str,
    told: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("bare.toml").write_text('[sheet]\npanel = "none"\n')
    assert run(["sheet", str(raster), "-o", *words.split()]) == 1
    assert told in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["bare.toml"]


def test_polygons_without_a_name_are_refused(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Empty and missing ones; before anything is made."""
    for names in (["A", None], ["A", " "]):
        areas = polygons(tmp_path, names)
        words = [
            "sheets",
            "make",
            str(raster),
            "--polygons",
            str(areas),
            "--scale",
            "1:25000",
            "-o",
            str(tmp_path / "out"),
        ]
        assert run(words) != 0
        assert "polygon 2 has no name" in capsys.readouterr().err
        areas.unlink()


def test_a_map_of_the_globe_has_no_georeference(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its corners are no places: the PDF says nothing of them rather than what is not true."""
    from affine import Affine

    path = tmp_path / "globe.tif"
    import rasterio

    with rasterio.open(
        path, "w", driver="GTiff", width=86, height=42, count=1, dtype="uint8", crs="EPSG:8857",
        transform=Affine(4e5, 0, -1.72e7, 0, -4e5, 8.4e6),
    ) as out:  # fmt: skip
        out.write(np.full((1, 42, 86), 140, np.uint8))
    sheet, said = made(path, tmp_path, '[graticule]\nstyle = "lines"\n', capsys)
    assert "no georeference" in said
    assert b"/GPTS" not in sheet.data
    assert "Scale factors at the centre: 0.86" in sheet.text


@pytest.mark.parametrize(("part", "key"), [("sheet", "subtitle"), ("notes", "sources")])
def test_a_text_that_no_sheet_holds_is_refused(
    raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], part: str, key: str
) -> None:
    layout = tmp_path / "layout.toml"
    layout.write_text(f'[{part}]\n{key} = "{"x" * 200_000}"\n')
    code = run(["sheet", str(raster), "--layout", str(layout), "-o", str(tmp_path / "sheet.pdf")])
    said = capsys.readouterr().err
    assert code == 1
    assert f"[{part}]: {key} has 200,000 characters, and a sheet takes 2,000" in said
