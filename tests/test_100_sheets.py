"""`geomosaic sheets` from the command line: whole series, resumed, the same bytes; the files of a sheet."""

from __future__ import annotations

import json
import sqlite3
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pypdfium2
import pytest
import rasterio
import shapely
from affine import Affine
from PIL import Image
from pyproj import CRS, Transformer
from sheet_reading import SheetPdf, overlaps
from sheet_rig import write

from geomosaic.cli.main import run
from geomosaic.errors import GeomosaicWarning
from geomosaic.options.sheet import SheetOptions
from geomosaic.sheets.inputs import sheet_inputs
from geomosaic.sheets.make import make_sheet
from geomosaic.sheets.series import make as series
from geomosaic.sheets.series.inputs import sheet_scheme, sheet_series
from geomosaic.sheets.series.regular import Polygons, sheet_place

POLISH = ("--scheme", "puwg1992", "--scale", "1:10000")
SHEET = "M-34-64-D-c-3"


@pytest.fixture(scope="module")
def raster(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Around the corner of four sheets in PUWG 1992: red ramps to the east, green to the north; 10 m."""
    path = tmp_path_factory.mktemp("series") / "map.tif"
    x, y = Transformer.from_crs(4258, 2180, always_xy=True).transform(19.8125, 50 + 2.5 / 60)
    row, col = np.mgrid[0:120, 0:140]
    values = np.stack([60 + col, 60 + row, np.full_like(row, 90)]).astype(np.uint8)
    with rasterio.open(
        path, "w", driver="GTiff", width=140, height=120, count=3, dtype="uint8", crs="EPSG:2180",
        transform=Affine(10, 0, round(x) - 700, 0, -10, round(y) + 600),
    ) as out:  # fmt: skip
        out.write(values)
    return path


def told(capsys: pytest.CaptureFixture[str], *words: Any) -> dict[str, Any]:
    """The JSON of a run that works."""
    capsys.readouterr()
    assert run(["sheets", *map(str, words), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert isinstance(found, dict)
    return found


def test_find_and_show(capsys: pytest.CaptureFixture[str]) -> None:
    assert told(capsys, "find", "19.78", "50.02", *POLISH)["name"] == SHEET
    assert told(capsys, "find", "11.575", "48.137", "--scheme", "tk", "--scale", "25000")["name"] == "7835"
    assert (
        told(capsys, "find", "-77.0352", "38.8895", "--scheme", "mgrs", "--size", "1000", "1000")["name"] == "18SUJ2306"
    )
    grid = ("--scheme", "grid", "--size", "500", "500", "--crs", "EPSG:32633")
    assert told(capsys, "find", "15", "0", *grid)["name"] == "C1000-R0"
    shown = told(capsys, "show", "M-34-064-Dc3", *POLISH)
    assert shown["name"] == SHEET
    assert shown["neighbours"]["S"] == "M-34-76-B-a-1"
    want = Transformer.from_crs(4258, 2180, always_xy=True).transform(19.75, 50.0)
    assert shown["map_corners"][0] == pytest.approx(want, abs=1e-3)
    assert run(["sheets", "show", SHEET, *POLISH]) == 0
    assert "E: M-34-64-D-c-4" in capsys.readouterr().out
    for words in (["find", "19", "50"], ["find", "19", "50", "--scheme", "tk"], ["show", "X-1", *POLISH]):
        assert run(["sheets", *words]) == 1


@pytest.fixture(scope="module")
def folder(raster: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All sheets as GeoTIFF."""
    out = tmp_path_factory.mktemp("out")
    words = ["sheets", "make", str(raster), *POLISH, "--format", "tif", "--dpi", "72", "-o", str(out)]
    assert run(words) == 0
    return out


def test_a_series_shows_all_of_the_raster_once(folder: Path, raster: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Four sheets meet on the raster: each shows it inside its neatline, none outside; together they show all of it."""
    frame = geopandas.read_file(folder / "index.gpkg", layer="sheets")
    assert sorted(frame["name"]) == [f"M-34-64-D-c-{k}" for k in (1, 2, 3, 4)]
    by_name = frame.set_index("name")
    assert by_name.loc[SHEET, "n"] == "M-34-64-D-c-1"
    assert by_name.loc[SHEET, "file"] == f"{SHEET}.tif"
    assert (by_name["scale"] == 10000).all()
    seen = 0.0
    with rasterio.open(raster) as file:
        area = shapely.box(*file.bounds)
    for name, row in by_name.iterrows():
        with rasterio.open(folder / row["file"]) as file:
            inside, values, transform = file.dataset_mask() > 0, file.read(), file.transform
        assert transform.a == pytest.approx(10_000 * 0.0254 / 72)
        rows, cols = np.nonzero(inside)
        place = row.geometry.buffer(2.0)
        few = np.random.default_rng(0).choice(len(rows), 300)
        assert all(
            place.contains(shapely.Point(transform @ (c + 0.5, r + 0.5)))
            for r, c in zip(rows[few], cols[few], strict=True)
        )
        assert inside.sum() * transform.a**2 == pytest.approx(row.geometry.area, rel=2e-3)
        blue = inside & (np.abs(values[2].astype(int) - 90) < 3)
        shown = blue.sum() * transform.a**2
        expected = row.geometry.intersection(area).area
        assert shown == pytest.approx(expected, rel=0.06), name  # grid and graticule lie over a few per cent
        seen += shown
    assert seen == pytest.approx(area.area, rel=0.06)
    page = pypdfium2.PdfDocument(folder / "index.pdf")[0].get_textpage().get_text_range()
    assert "Index of sheets" in page
    assert SHEET in page


def test_goes_on_where_it_was_stopped(
    folder: Path, raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Finished sheets are kept; one that is gone is made again to the same bytes; other options make all new."""
    words = ("make", raster, *POLISH, "--format", "tif", "--dpi", "72", "-o", folder)
    before = {path.name: path.read_bytes() for path in folder.glob("M-*.tif")}
    assert len(told(capsys, *words)["kept"]) == 4
    (folder / f"{SHEET}.tif").unlink()
    again = told(capsys, *words)
    assert [Path(path).name for path in again["made"]] == [f"{SHEET}.tif"]
    assert {path.name: path.read_bytes() for path in folder.glob("M-*.tif")} == before
    layout = tmp_path / "layout.toml"
    layout.write_text('[sheet]\ntitle = "Other"\n')
    assert len(told(capsys, *words, "--layout", layout, "--only", SHEET)["made"]) == 1
    # A file that is not ours is not replaced.
    foreign = folder / "M-34-64-D-c-4.tif"
    foreign.write_bytes(b"mine")
    assert run(["sheets", *map(str, words)]) == 1
    assert foreign.read_bytes() == b"mine"
    foreign.unlink()


def test_goes_on_after_ctrl_c(
    folder: Path, raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped after a sheet has its name and before that is noted: it is kept, the others follow, to the same bytes."""
    drawn = []

    def draw(task: Any) -> list[str]:
        drawn.append(task.path.name)
        told_of = plain(task)
        if len(drawn) == 2:
            raise KeyboardInterrupt
        return told_of

    plain = series._draw
    words = ("make", raster, *POLISH, "--format", "tif", "--dpi", "72", "-o", tmp_path / "out")
    with monkeypatch.context() as patch:
        patch.setattr(series, "_draw", draw)
        assert run(["sheets", *map(str, words)]) == 130
        assert "what is done stays done" in capsys.readouterr().err
    found = told(capsys, *words)
    assert sorted(Path(path).name for path in found["kept"]) == sorted(drawn)
    known = list(folder.glob("M-*.tif"))
    assert known
    assert all((tmp_path / "out" / path.name).read_bytes() == path.read_bytes() for path in known)
    # Stopped while older sheets are made anew: those that were not reached are still older ones.
    drawn.clear()
    with monkeypatch.context() as patch:
        patch.setattr(series, "_draw", draw)
        assert run(["sheets", *map(str, words), "--gamma", "2"]) == 130
    again = told(capsys, *words, "--gamma", "2")
    assert (len(again["kept"]), len(again["made"])) == (2, 2)


def test_the_index_knows_earlier_sheets_and_is_never_taken_from_others(
    raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ("make", raster, *POLISH, "--format", "tif", "--dpi", "72", "-o", out)
    for k in (1, 3):
        told(capsys, *words, "--only", f"M-34-64-D-c-{k}")
    assert list(geopandas.read_file(out / "index.gpkg")["name"]) == ["M-34-64-D-c-3", "M-34-64-D-c-1"]
    (out / "index.gpkg").write_bytes(b"mine")
    assert run(["sheets", *map(str, words)]) == 1
    assert "in the way of the index" in capsys.readouterr().err
    assert run(["sheets", *map(str, words[:-1]), str(raster)]) == 1
    assert "the output is a file" in capsys.readouterr().err
    assert (out / "index.gpkg").read_bytes() == b"mine"
    assert len(list(out.glob("M-*.tif"))) == 2


def test_two_sheets_never_make_one_file(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with rasterio.open(raster) as file:
        left, bottom, right, top = file.bounds
    parts = [shapely.box(left, bottom, left + 500, top), shapely.box(left + 500, bottom, right, top)]
    for names, part in ((["west/1", "West_1"], "'west/1'"), (["a", "Index"], "index of the series")):
        frame = geopandas.GeoDataFrame({"name": names}, geometry=parts, crs="EPSG:2180")
        frame.to_file(tmp_path / "plan.gpkg", layer="plan")
        words = ("make", raster, "--polygons", tmp_path / "plan.gpkg", "--scale", "5000", "-o", tmp_path / "out")
        assert run(["sheets", *map(str, words)]) == 1
        assert part in capsys.readouterr().err
        assert not (tmp_path / "out").exists()


@pytest.mark.ci
def test_processes_make_the_same_bytes(folder: Path, raster: Path, tmp_path: Path) -> None:
    words = ["make", raster, *POLISH, "--format", "tif", "--dpi", "72", "--workers", "2", "-o", tmp_path / "two"]
    assert run(["sheets", *map(str, words), "--only", "M-34-64-D-c-1", "--only", "M-34-64-D-c-2"]) == 0
    for name in ("M-34-64-D-c-1.tif", "M-34-64-D-c-2.tif"):
        assert (tmp_path / "two" / name).read_bytes() == (folder / name).read_bytes()


def test_page_of_a_sheet(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The page names the sheet and all its neighbours; it is the same when made again; a raster elsewhere is told."""
    files = []
    for name in ("a", "b"):
        words = ("make", raster, *POLISH, "--only", SHEET, "--dpi", "72", "-o", tmp_path / name)
        files.append(Path(told(capsys, *words)["made"][0]).read_bytes())
    assert files[0] == files[1]
    assert (tmp_path / "a" / "index.pdf").read_bytes() == (tmp_path / "b" / "index.pdf").read_bytes()
    assert (tmp_path / "a" / "index.gpkg").read_bytes() == (tmp_path / "b" / "index.gpkg").read_bytes()
    page = pypdfium2.PdfDocument(files[0])[0]
    text = page.get_textpage().get_text_range()
    for name in (SHEET, "M-34-64-D-c-1", "M-34-64-D-c-4", "M-34-76-B-a-1", "M-34-64-C-d-2"):
        assert name in text
    assert "Neighbouring sheets" in text
    assert text.count("M-34-64-D-c-1") == 2  # on the frame and in the index map
    assert run(["sheets", "make", str(raster), "--scheme", "tk", "--scale", "25000", "-o", str(tmp_path / "c")]) == 1
    far = ("make", raster, "--scheme", "international", "--scale", "1:10000", "--only", SHEET, "--dpi", "72")
    told(capsys, *far, "-o", tmp_path / "d")
    assert (tmp_path / "d" / f"{SHEET}.pdf").is_file()


def test_a_sheet_beside_the_raster(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is named before anything is drawn."""
    words = ("make", raster, *POLISH, "--only", SHEET, "--only", "N-34-1-A-a-1", "-o", tmp_path / "out")
    assert run(["sheets", *map(str, words)]) == 1
    assert "sheet N-34-1-A-a-1 shows nothing of the raster" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_drawn_sheets_and_overlap(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with rasterio.open(raster) as file:
        left, bottom, right, top = file.bounds
    middle = (left + right) / 2
    parts = [shapely.box(left, bottom, middle, top), shapely.box(middle, bottom, right, top)]
    frame = geopandas.GeoDataFrame({"nr": ["west/1", "east"]}, geometry=parts, crs="EPSG:2180")
    frame.to_file(tmp_path / "sheets.gpkg", layer="plan")
    words = (
        "make",
        raster,
        "--polygons",
        f"{tmp_path / 'sheets.gpkg'}#plan",
        "--name-column",
        "nr",
        "--scale",
        "1:5000",
    )
    found = told(capsys, *words, "--overlap", "50", "--format", "tif", "--dpi", "72", "-o", tmp_path / "out")
    assert sorted(Path(p).name for p in found["made"]) == ["east.tif", "west_1.tif"]
    with rasterio.open(tmp_path / "out" / "east.tif") as file:
        assert file.bounds.left == pytest.approx(middle - 50, abs=1e-6)
        assert file.bounds.top == pytest.approx(top + 50, abs=1e-6)
    assert run(["sheets", *map(str, words), "--name-column", "x", "-o", str(tmp_path / "o")]) == 1


def test_names_of_neighbours_stand_clear_of_coordinates(raster: Path, tmp_path: Path) -> None:
    """A parallel meets the frame in the middle of its side, where the name of the neighbour would stand."""
    with rasterio.open(raster) as file:
        left, bottom, right, top = file.bounds
    middle, names = (left + right) / 2, ("Gypsy Quay (j)", "(q) Pygmy Jay")
    parts = (shapely.box(left, bottom, middle, top), shapely.box(middle, bottom, right, top))
    rings = {name: np.asarray(part.exterior.coords)[:-1] for name, part in zip(names, parts, strict=True)}
    place = sheet_place(Polygons("Plan", "EPSG:2180", rings, 5000.0), names[1], CRS("EPSG:2180"))
    inputs = sheet_inputs(raster, SheetOptions(dpi=72))
    page = SheetPdf(make_sheet(inputs, tmp_path / "sheet.pdf", series=place).path)
    assert overlaps(*page.characters()) == []
    assert page.text.count(names[0]) == 2  # on the frame and in the index map


def test_a_scheme_says_where_it_has_sheets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    south = write(tmp_path / "south.tif", np.full((3, 20, 20), 90, np.uint8), "EPSG:32723", 100.0)
    words = ("--scheme", "international", "--scale", "1:50000")
    for said in (["find", "-43.2", "-22.9", *words], ["make", str(south), *words, "-o", str(tmp_path / "out")]):
        assert run(["sheets", *said]) == 1
        assert "below the equator there are sheets 1:1000000 alone: give --scale 1:1000000" in capsys.readouterr().err
    assert told(capsys, "find", "-43.2", "-22.9", *words[:2], "--scale", "1:1000000")["name"] == "SF-23"


def test_a_scheme_without_a_scale_says_which_scales_a_place_has(capsys: pytest.CaptureFixture[str]) -> None:
    for scale in ((), ("--scale", "1:50")):
        assert run(["sheets", "find", "-43.2", "-22.9", "--scheme", "international", *scale]) == 1
        said = capsys.readouterr().err
        assert "1:25000, 1:10000; below the equator there are sheets 1:1000000 alone" in said
    assert run(["sheets", "find", "11.6", "48.1", "--scheme", "tk"]) == 1
    assert "hint: give one of 1:25000, 1:50000, 1:100000, 1:200000\n" in capsys.readouterr().err


def test_the_length_of_a_value_that_is_missing_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sheets", "find", "15", "0", "--scheme", "mgrs", "--size", "8000", "--debug"]) == 2
    assert "'--size': 2 values belong here, W H, and '--debug' is none" in capsys.readouterr().err
    assert run(["sheets", "find", "15", "0", "--scheme", "mgrs", "--size", "8000", "8000"]) == 1
    assert "give 100000 100000, 10000 10000, 1000 1000, 100 100" in capsys.readouterr().err


REFUSED = (
    ("--format tif --title T", "--title would do nothing without --collar or --driver PDF or --format pdf"),
    ("--format kmz --report report.json", "--report would do nothing without --collar or --format pdf"),
    ("--collar", "--collar would do nothing without --format tif"),
    ("--format png --driver COG", "--driver COG does not write '.png'"),
    ("--scale 1:1000 --paper A4", "mm at 1:1000, the paper has room for"),
)


@pytest.mark.parametrize(("words", "said"), REFUSED)
def test_what_cannot_be_drawn_is_refused_before_there_is_a_folder(
    raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: str, said: str
) -> None:
    out = tmp_path / "out"
    scheme = ("--scheme", "mgrs", "--size", "10000", "10000")
    assert run(["sheets", "make", str(raster), *scheme, *words.split(), "-o", str(out)]) == 1
    assert said in capsys.readouterr().err
    assert not out.exists()


def test_the_index_has_the_scale_of_the_drawn_sheets(raster: Path, tmp_path: Path) -> None:
    layout = tmp_path / "layout.toml"
    layout.write_text('[map]\nscale = "1:500000"\n')
    words = {"only": (SHEET,), "format": "tif", "dpi": 72, "layout": layout}
    differs = "drawn at 1:500000, as .map. scale of the layout has it, not at 1:10000"
    small = "at 1:500000 the map is 9 x 9 mm on A4; `scale=1:50000` fills the paper"
    with pytest.warns(GeomosaicWarning, match=differs), pytest.warns(GeomosaicWarning, match=small):
        sheet_series(raster, tmp_path / "out", sheet_scheme("puwg1992", 10_000), **words)
    assert geopandas.read_file(tmp_path / "out" / "index.gpkg")["scale"].tolist() == [500_000.0]


def test_sizes_of_a_million_are_written_out(capsys: pytest.CaptureFixture[str]) -> None:
    grid = ("--scheme", "grid", "--size", "1000000", "2000000", "--crs", "EPSG:3031")
    assert run(["sheets", "show", "C0-R0", *grid, "--map-crs", "EPSG:4326"]) == 0
    said = capsys.readouterr().out
    assert "the grid of 1000000 x 2000000 m" in said
    assert "26.56505118  -69." in said  # degrees to a centimetre


def test_a_grid_without_a_size_or_crs_says_what_is_missing_as_it_is_typed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sheets", "find", "15", "0", "--scheme", "grid", "--crs", "EPSG:32633"]) == 1
    assert "hint: give --size\n" in capsys.readouterr().err
    assert run(["sheets", "find", "--help"]) == 0
    assert "--size W H" in " ".join(capsys.readouterr().out.split())


def sheet(raster: Path, output: Path, *words: str) -> Path:
    assert run(["sheet", str(raster), "--scale", "1:10000", "--dpi", "100", *words, "-o", str(output)]) == 0
    return output


def test_collar_and_world_files(raster: Path, tmp_path: Path) -> None:
    """With its collar the page is georeferenced as a whole: its map lies where that of the map alone does."""
    alone = sheet(raster, tmp_path / "map.tif", "--driver", "COG", "--world-file")
    page = sheet(raster, tmp_path / "page.tif", "--collar")
    sheet(raster, tmp_path / "page.png", "--world-file")
    with rasterio.open(alone) as a, rasterio.open(page) as b:
        assert a.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert b.width * 25.4 / 100 == pytest.approx(297, abs=0.2) or b.width * 25.4 / 100 == pytest.approx(
            210, abs=0.2
        )
        t, u = a.transform, b.transform
        spots = [t @ (c, r) for c, r in ((a.width * 0.3, a.height * 0.3), (a.width * 0.7, a.height * 0.6))]
        ours = np.array(list(a.sample(spots))).astype(int)
        theirs = np.array(list(b.sample(spots))).astype(int)
        assert np.abs(ours - theirs).max() <= 4
    for name, want in (("map.tfw", t), ("page.pgw", u)):
        v = [float(line) for line in (tmp_path / name).read_text().split()]
        assert v == pytest.approx([want.a, 0, 0, want.e, want.c + want.a / 2, want.f + want.e / 2], abs=1e-3)


def test_tiles_for_the_web(raster: Path, tmp_path: Path) -> None:
    """Tiles lie where they belong: they have the colours of places of the raster; and they are the same again."""
    first, again = sheet(raster, tmp_path / "a.mbtiles"), sheet(raster, tmp_path / "b.mbtiles")
    assert first.read_bytes() == again.read_bytes()
    with rasterio.open(raster) as file:
        t = file.transform
    to = Transformer.from_crs(2180, 3857, always_xy=True)
    base = sqlite3.connect(first)
    zooms = [z for (z,) in base.execute("select distinct zoom_level from tiles order by 1")]
    assert len(zooms) >= 3
    level, half = zooms[-1], 20037508.342789244
    hits = 0
    for col, row in ((33, 27), (70, 50), (104, 86), (23, 101)):
        x, y = to.transform(*(t @ (col + 0.5, row + 0.5)))
        px, py = ((x + half) / (2 * half) * 2**level * 256, (half - y) / (2 * half) * 2**level * 256)
        (blob,) = base.execute(
            "select tile_data from tiles where zoom_level=? and tile_column=? and tile_row=?",
            (level, int(px) // 256, 2**level - 1 - int(py) // 256),
        ).fetchone()
        seen = np.asarray(Image.open(BytesIO(blob)).convert("RGBA"))[int(py) % 256, int(px) % 256]
        hits += int(np.abs(seen[:3].astype(int) - [60 + col, 60 + row, 90]).max() <= 6 and seen[3] == 255)
    assert hits >= 3  # a grid line may run over one
    base.close()
    kmz, twin = sheet(raster, tmp_path / "a.kmz"), sheet(raster, tmp_path / "b.kmz")
    assert kmz.read_bytes() == twin.read_bytes()
    with zipfile.ZipFile(kmz) as archive:
        names = archive.namelist()
        assert names[0] == "doc.kml"
        assert "<north>50.0" in archive.read(next(n for n in names if n.endswith("0/0.kml"))).decode()
    assert not [path for path in tmp_path.iterdir() if "partial" in path.name]


def test_a_logo_stands_left_of_the_title(raster: Path, tmp_path: Path) -> None:
    """A logo stands left of the title, 11 mm high; one that cannot be read is an error."""
    Image.new("RGB", (40, 20), (255, 0, 0)).save(tmp_path / "logo.png")
    (tmp_path / "l.toml").write_text('[sheet]\ntitle = "Named"\nlogo = "logo.png"\n')
    page = sheet(raster, tmp_path / "page.png", "--layout", str(tmp_path / "l.toml"))
    red = (np.asarray(Image.open(page)).astype(int) - [255, 0, 0] == 0).all(axis=2)
    rows, cols = np.nonzero(red)
    assert (np.ptp(rows) + 1) / 100 * 25.4 == pytest.approx(11, abs=0.6)
    assert (np.ptp(cols) + 1) / 100 * 25.4 == pytest.approx(22, abs=0.6)
    (tmp_path / "logo.png").write_bytes(b"no picture")
    words = ["sheet", str(raster), "--layout", str(tmp_path / "l.toml"), "-o", str(tmp_path / "b.png")]
    assert run(words) == 1
    assert not (tmp_path / "b.png").exists()
