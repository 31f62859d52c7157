"""Elements of a sheet at positions of their own, measured in what was written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pytest
import shapely
from PIL import Image
from sheet_reading import SheetPdf
from sheet_rig import LEFT, TOP, write

import geomosaic as gm
from geomosaic.errors import GeomosaicWarning, InputError

PLACES = {
    "title": ("sheet", "title_position", "Title"), "number": ("sheet", "number_position", "Sheet"),
    "legend": ("legend", "position", "Legend"), "scalebar": ("scalebar", "position", ":"),
    "north": ("north", "position", "GN"), "notes": ("notes", "position", "Coordinate reference"),
}  # fmt: skip


@pytest.fixture(scope="module")
def raster(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A green square kilometre in UTM 33."""
    values = np.array([40, 120, 60], np.uint8).repeat(250 * 250).reshape(3, 250, 250)
    return write(tmp_path_factory.mktemp("raster") / "green.tif", values, "EPSG:32633", 4.0)


def layout(path: Path, *tables: str) -> Path:
    path.write_text('[sheet]\npaper = "A4"\ntitle = "Title here"\nnumber = "33"\n' + "\n".join(tables))
    return path


def place_of(pdf: SheetPdf, words: str) -> np.ndarray:
    """Left end and lower edge of a text, mm."""
    return next(line.box[:2] for line in pdf.lines() if line.text.startswith(words.replace(" ", "")))


def test_elements_stand_where_the_layout_puts_them_and_the_map_stays(raster: Path, tmp_path: Path) -> None:
    whole = gm.sheet(raster, tmp_path / "whole.pdf", layout=layout(tmp_path / "a.toml"))
    height = whole.page.height
    # Each where it stood anyhow, 7 mm to the right and 11 mm down.
    tables: dict[str, str] = {}
    for name, (table, key, _) in PLACES.items():
        start = whole.elements[name]
        tables[table] = tables.get(table, "") + f"{key} = {[start[0] + 7.0, height - start[3] + 11.0]}\n"
    more = [tables.pop("sheet"), *(f"[{table}]\n{keys}" for table, keys in tables.items())]
    other = gm.sheet(raster, tmp_path / "other.pdf", layout=layout(tmp_path / "b.toml", *more))
    assert other.page.neatline == whole.page.neatline
    before, after = SheetPdf(tmp_path / "whole.pdf"), SheetPdf(tmp_path / "other.pdf")
    for name, (_, _, words) in PLACES.items():
        box = np.array(other.elements[name])
        np.testing.assert_allclose(box[[0, 3]] - np.array(whole.elements[name])[[0, 3]], [7.0, -11.0], atol=1e-9)
        at = place_of(after, words)
        np.testing.assert_allclose(at - place_of(before, words), [7.0, -11.0], atol=0.02, err_msg=name)
        # The texts lie in the boxes that are told, but for the reach of letters below their line.
        assert (at >= box[:2] - 0.6).all(), name
        assert (at <= box[2:] + 0.6).all(), name


@pytest.mark.filterwarnings("ignore:.*of 100 names have no room")
def test_a_legend_on_the_map_stands_on_white_and_names_keep_off_it(raster: Path, tmp_path: Path) -> None:
    places = [shapely.Point(LEFT + x, TOP - y) for x in range(50, 1000, 100) for y in range(50, 1000, 100)]
    frame = geopandas.GeoDataFrame({"name": [f"P{k}" for k in range(100)]}, geometry=places, crs="EPSG:32633")
    frame.to_file(tmp_path / "places.gpkg")
    layer = '[[layer]]\nfile = "places.gpkg"\nstyle = "point"\nlabel = "name"\n'
    at = "[legend]\nposition = [60.0, 110.0]\nwidth = 40.0\n"
    file = layout(tmp_path / "a.toml", 'panel = "none"', at, layer)
    made = gm.sheet(raster, tmp_path / "a.pdf", layout=file, scale="1:10000")
    left, bottom, right, top = made.elements["legend"]
    assert right - left <= 40.0
    names = [line for line in SheetPdf(tmp_path / "a.pdf").lines() if line.text[:1] == "P" and line.text[1:].isdigit()]
    assert 60 < len(names) < 100
    for name in names:
        x, y = (name.box[:2] + name.box[2:]) / 2
        assert not (left - 1.5 < x < right + 1.5 and bottom - 1.5 < y < top + 1.5)
    gm.sheet(raster, tmp_path / "a.png", layout=file, scale="1:10000", dpi=100)
    pixels = np.asarray(Image.open(tmp_path / "a.png"))
    rows = [round((made.page.height - v) / 25.4 * 100) for v in (top + 1.0, bottom - 1.0)]
    cols = [round(v / 25.4 * 100) for v in (left - 1.0, right + 1.0)]
    ground = pixels[rows[0] : rows[1], cols[0] : cols[1]]
    assert (ground == 255).all(axis=2).mean() > 0.6
    assert not (ground == [40, 120, 60]).all(axis=2).any()


@pytest.mark.filterwarnings("ignore:at 1.4000 the paper shows")
def test_without_head_and_panel_the_map_is_larger(raster: Path, tmp_path: Path) -> None:
    rooms = []
    for k, more in enumerate(("", 'head = "none"\ntitle_position = [20.0, 20.0]\nnumber_position = [90.0, 20.0]')):
        made = gm.sheet(raster, tmp_path / f"{k}.png", layout=layout(tmp_path / "a.toml", more), dpi=72, scale=4000)
        rooms.append(made.page.neatline[3] - made.page.neatline[1])
    assert rooms[1] - rooms[0] == pytest.approx(15.0)
    with pytest.warns(GeomosaicWarning, match=r"the title is left out; \[sheet\] title_position gives it a place"):
        gm.sheet(
            raster,
            tmp_path / "2.png",
            layout=layout(tmp_path / "a.toml", 'head = "none"\nnumber_position = [90.0, 20.0]'),
            dpi=72,
        )


@pytest.mark.parametrize(
    ("text", "what", "where"),
    [
        ("[legend]\nposition = [20.0, 400.0]", "beyond the paper", "[legend] position"),
        ("[legend]\nposition = [-1.0, 4.0]", "out of range", "[legend] position"),
        ("[legend]\nwidth = 40.0", "`width` would do nothing without `position`", "[legend]"),
        ("[north]\nposition = [20.0]", "1 value where 2 belong", "[north] position"),
    ],
)  # fmt: skip
def test_positions_that_cannot_be_are_refused(raster: Path, tmp_path: Path, text: str, what: str, where: str) -> None:
    with pytest.raises(InputError) as caught:
        gm.sheet(raster, tmp_path / "a.png", layout=layout(tmp_path / "a.toml", text), dpi=72)
    assert what in caught.value.what
    assert where in str(caught.value.where)
    assert not (tmp_path / "a.png").exists()


def test_a_layer_has_the_colour_and_width_of_the_layout(raster: Path, tmp_path: Path) -> None:
    line = shapely.LineString([(LEFT + 100, TOP - 500), (LEFT + 900, TOP - 500)])
    geopandas.GeoDataFrame({"kind": ["a"]}, geometry=[line], crs="EPSG:32633").to_file(tmp_path / "r.gpkg")

    def rows(layer: dict[str, Any]) -> int:
        """Rows of pixels of the pure colour through the middle of the line."""
        keys = "".join(f"{key} = {value!r}\n" for key, value in layer.items())
        file = layout(tmp_path / "a.toml", "[grid]\nstyle='none'", f"[[layer]]\nfile = 'r.gpkg'\n{keys}")
        made = gm.sheet(raster, tmp_path / "a.tif", layout=file, dpi=254, scale=10000, overwrite=True)
        pixels = np.asarray(Image.open(made.path))
        return int((pixels[:, pixels.shape[1] // 2] == [0, 0, 255]).all(axis=1).sum())

    assert rows({"style": "line"}) == 0
    assert rows({"style": "line", "color": "#0000ff", "width": 2.0}) in (19, 20, 21)
    (tmp_path / "s.toml").write_text('column = "kind"\n[[category]]\nvalue = "a"\nline = { color = "red" }\n')
    with pytest.raises(InputError, match="categories or classes with colours"):
        rows({"style": "s.toml", "color": "#0000ff"})
