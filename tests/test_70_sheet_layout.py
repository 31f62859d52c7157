"""Grids, pages, places of labels, layouts and styles, against geometry that is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from page_rig import page_of
from pyproj import CRS, Geod, Proj, Transformer

from geomosaic.errors import InputError
from geomosaic.geo.local_frames import map_place
from geomosaic.numbers import angle_text, grouped, multiples, nice_scale, nice_step
from geomosaic.options.check import build
from geomosaic.options.sheet import paper_size, parse_scale
from geomosaic.sheets.drawing.scale_and_north import bar_divisions, bar_length, north_angles, shown
from geomosaic.sheets.grid_lines import MapGrid, map_grid
from geomosaic.sheets.label_placement import LabelPlacer, LabelPosition, around_point, corners, labels_that_fit, overlap
from geomosaic.sheets.layout import Declination, Layout, MapPart, SheetPart
from geomosaic.sheets.notes import accuracy_statement, grid_line
from geomosaic.sheets.page import lay_out
from geomosaic.sheets.style import Line, Rule, Style, Symbol, built_in, parse_style
from geomosaic.sheets.vector_layers import overlay, parts_of, rule_matches, to_map

UTM33 = CRS("EPSG:32633")
AREA = (399_100.0, 5_499_300.0, 400_800.0, 5_500_700.0)


@pytest.mark.parametrize(
    ("least", "degrees", "step"),
    [
        (1.0, False, 1.0), (1.01, False, 2.0), (2.01, False, 5.0), (140.0, False, 200.0), (0.3, False, 0.5),
        (1 / 3600, True, 1 / 3600), (11 / 3600, True, 15 / 3600), (50 / 3600, True, 1 / 60), (0.9, True, 1.0),
        (0.3 / 3600, True, 0.5 / 3600), (20.0, True, 30.0),
    ],
)  # fmt: skip
def test_steps_of_grids_are_round(least: float, degrees: bool, step: float) -> None:
    assert nice_step(least, degrees=degrees) == pytest.approx(step)


def test_numbers_are_round_and_sufficient() -> None:
    assert [nice_scale(v) for v in (1001, 4999, 5000, 5001, 21000)] == [2000, 5000, 5000, 10000, 25000]
    assert multiples(399_100, 400_000, 200).tolist() == [399_200, 399_400, 399_600, 399_800, 400_000]
    assert multiples(-0.1, 0.3, 0.1) == pytest.approx([-0.1, 0.0, 0.1, 0.2, 0.3])
    assert grouped(5_500_000) == "5\u202f500\u202f000"
    assert [bar_length(v) for v in (999, 1000, 420, 0.7)] == pytest.approx([500, 1000, 400, 0.5])
    assert [bar_divisions(v) for v in (100, 200, 300, 400, 0.5)] == [5, 4, 3, 4, 5]


@pytest.mark.parametrize(
    ("value", "step", "signs", "text"),
    [
        (13.6083333333, 30 / 3600, "EW", "13°36′30″\u202fE"), (-0.25, 15 / 60, "NS", "0°15′\u202fS"),
        (12.0, 1.0, "EW", "12°\u202fE"), (59.999999999, 1 / 3600, "", "60°00′00″"),
        (-1.0559, 1 / 3600, "", "−1°03′21″"),
        (0.0, 1.0, "EW", "0°"), (10 + 0.5 / 3600, 0.5 / 3600, "", "10°00′00.5″"),
    ],
)  # fmt: skip
def test_angles_in_words(value: float, step: float, signs: str, text: str) -> None:
    """Rounding carries over: never 60 seconds."""
    assert angle_text(value, step, signs=signs) == text


@pytest.mark.parametrize(("seconds", "text"), [(0.5, "0.5″"), (0.05, "0.05″"), (10.0, "10″"), (300.0, "5′")])
def test_a_legend_names_the_interval_of_a_graticule_in_minutes_and_seconds(seconds: float, text: str) -> None:
    step = seconds / 3600
    grid = MapGrid(CRS("EPSG:4326"), (step, step), (), np.empty((0, 2)))
    assert grid_line(grid) == f"WGS 84, every {text}"


def test_grid_of_the_maps_own_crs() -> None:
    """Straight lines at whole multiples, from side to side."""
    grid = map_grid(UTM33, UTM33, AREA, 400.0)
    assert grid.interval == 500.0
    assert [line.value for line in grid.lines if line.axis == 0] == [399_500, 400_000, 400_500]
    assert [line.value for line in grid.lines if line.axis == 1] == [5_499_500, 5_500_000, 5_500_500]
    for line in grid.lines:
        assert len(line.pieces) == 1
        assert np.abs(line.pieces[0][:, line.axis] - line.value).max() < 1e-6
        assert {side for side, _, _ in line.ends} == ({"bottom", "top"} if line.axis == 0 else {"left", "right"})
    assert len(grid.crossings) == 9
    assert grid.label(grid.lines[0]) == "399\u202f500"


def test_graticule_against_proj() -> None:
    """Every point of a meridian has its longitude; where it leaves the sheet is where PROJ's line meets the side."""
    area = (300_000.0, 5_400_000.0, 700_000.0, 5_700_000.0)
    grid = map_grid(CRS("EPSG:4326"), UTM33, area, 80_000.0)
    back = Transformer.from_crs(UTM33, "EPSG:4326", always_xy=True)
    assert grid.interval == 2.0
    assert {line.axis for line in grid.lines} == {0, 1}
    for line in grid.lines:
        for piece in line.pieces:
            vertices = np.array(back.transform(*piece[1:-1].T)).T
            assert np.abs(vertices[:, line.axis] - line.value).max() < 1e-9
            # Between vertices the chord leaves the line: by less than 0.1 mm at 1:1,000,000.
            middle = (piece[:-1] + piece[1:]) / 2
            off = np.array(back.transform(*middle.T)).T[:, line.axis] - line.value
            assert np.abs(off).max() * 111_000 < 100.0
        for side, x, y in line.ends:
            assert min(abs(x - area[0]), abs(x - area[2]), abs(y - area[1]), abs(y - area[3])) < 1e-3, side
    assert grid.label(next(line for line in grid.lines if line.axis == 0 and line.value == 14.0)) == "14°\u202fE"


def test_a_grid_of_the_next_zone_is_turned() -> None:
    """UTM 32 on a sheet in UTM 33: its lines lie at the difference of both convergences."""
    area = (210_000.0, 5_500_000.0, 212_000.0, 5_502_000.0)  # 11°E
    grid = map_grid(CRS("EPSG:32632"), UTM33, area, 400.0)
    line = next(line for line in grid.lines if line.axis == 0)
    dx, dy = line.pieces[0][-1] - line.pieces[0][0]
    turned = math.degrees(math.atan2(dx, dy))
    x, y = line.pieces[0].mean(axis=0)
    x32, y32 = Transformer.from_crs(UTM33, "EPSG:32632", always_xy=True).transform(x, y)
    expected = map_place(CRS("EPSG:32632"), x32, y32).convergence - map_place(UTM33, x, y).convergence
    assert abs(turned) > 4.0
    assert turned == pytest.approx(expected, abs=0.002)


def test_grids_that_cannot_be_drawn() -> None:
    with pytest.raises(InputError, match="1700 lines"):
        map_grid(UTM33, UTM33, AREA, 100.0, interval=1.0)
    with pytest.raises(InputError, match="lines on this sheet"):
        map_grid(CRS("EPSG:4326"), CRS("EPSG:3995"), (-2e5, -1e5, 1e5, 2e5), 1e4, interval=0.001)


def test_a_graticule_across_the_date_line() -> None:
    """Fiji: each vertex has the longitude that its line is labelled with; 180 degrees are neither east nor west."""
    area = (2_127_000.0, 4_017_000.0, 2_139_000.0, 4_026_000.0)
    fiji, degrees = CRS("EPSG:3460"), CRS("EPSG:4720")
    grid = map_grid(degrees, fiji, area, 2500.0)
    back = Transformer.from_crs(fiji, degrees, always_xy=True)
    meridians = [line for line in grid.lines if line.axis == 0]
    for line in grid.lines:
        (piece,) = line.pieces
        vertices = np.array(back.transform(*piece[1:-1].T)).T[:, line.axis]
        assert np.abs((vertices - line.value + 180.0) % 360.0 - 180.0).max() < 1e-9
        assert {side for side, _, _ in line.ends} == ({"left", "right"} if line.axis else {"bottom", "top"})
    assert [grid.label(line) for line in meridians] == ["179°58′\u202fE", "180°00′", "179°58′\u202fW"]
    x = [float(line.pieces[0][:, 0].mean()) for line in meridians]
    assert np.diff(x) == pytest.approx(2 / 60 * 111_320 * math.cos(math.radians(16.8)), rel=0.01)
    assert len(grid.crossings) == 3 * (len(grid.lines) - 3)


def test_true_north_is_where_the_meridian_runs() -> None:
    """Convergence against the closed form tan γ = tan(λ − λ0)·sin φ (sphere; 1e-3 degrees here) and PROJ's own."""
    place = map_place(UTM33, 400_000.0, 5_500_000.0)
    spherical = math.degrees(
        math.atan(math.tan(math.radians(place.longitude - 15.0)) * math.sin(math.radians(place.latitude)))
    )
    assert place.convergence == pytest.approx(spherical, abs=1e-3)
    factors = Proj(UTM33).get_factors(place.longitude, place.latitude)
    assert place.convergence == pytest.approx(factors.meridian_convergence, abs=1e-6)
    # A kilometre to true north on the ellipsoid, seen on the map, is the direction that the arrow has.
    lon, lat, _ = Geod(ellps="WGS84").fwd(place.longitude, place.latitude, 0.0, 1000.0)
    x, y = Transformer.from_crs("EPSG:4326", UTM33, always_xy=True).transform(lon, lat)
    assert math.degrees(math.atan2(x - 400_000.0, y - 5_500_000.0)) == pytest.approx(
        north_angles(place.convergence)[0], abs=2e-4
    )
    # West of the central meridian true north is to the right of grid north.
    assert north_angles(place.convergence)[0] > 0
    assert north_angles(-1.0, Declination(4.0)) == [1.0, 5.0]


@pytest.mark.parametrize("angles", [[1.0, 5.0], [5.0, 1.0], [-2.0, -2.5], [3.0, -3.0], [40.0, 41.0], [0.0, 2.0]])
def test_arrows_stand_clear_of_each_other(angles: list[float]) -> None:
    """At least 12 degrees apart, on their own side and in their order; an angle of 0 stays 0."""
    drawn = shown(angles)
    apart = sorted([0.0, *(a for a in drawn if a)])
    assert min(np.diff(apart), default=99) >= 12.0
    assert all(math.copysign(1, a) == math.copysign(1, b) for a, b in zip(angles, drawn, strict=True) if a)
    assert [a == 0 for a in angles] == [b == 0 for b in drawn]
    assert np.argsort(drawn).tolist() == np.argsort(angles).tolist()


def test_page_has_the_exact_scale() -> None:
    """Neatline in mm times the scale is the area in metres, and both ways between map and page agree."""
    layout = Layout(sheet=SheetPart(title="x", paper="A4"), map=MapPart(scale=10_000.0, bounds=AREA))
    page = lay_out(layout, UTM33, (398_986.0, 5_499_220.0, 400_982.0, 5_500_783.0))
    assert (page.width, page.height) == (297.0, 210.0)
    assert page.bounds == pytest.approx(AREA)
    assert page.neatline[2] - page.neatline[0] == pytest.approx(170.0)
    assert page.neatline[3] - page.neatline[1] == pytest.approx(140.0)
    assert page.to_page(np.array([AREA[:2], AREA[2:]])) == pytest.approx(np.reshape(page.neatline, (2, 2)))
    places = np.array([[399_876.5, 5_500_123.25], [0.0, 0.0]])
    assert page.to_map(page.to_page(places)) == pytest.approx(places, abs=1e-6)


@pytest.mark.parametrize("paper", ["A4", "A3", "A0", "500x300"])
@pytest.mark.parametrize("panel", ["right", "bottom", "none"])
@pytest.mark.parametrize("orientation", ["portrait", "landscape"])
def test_nothing_leaves_the_paper(paper: str, panel: str, orientation: str) -> None:
    """Border, panel, foot and head stand inside the margins and beside each other."""
    sheet = SheetPart(title="x", paper=paper, panel=panel, orientation=orientation, margin=12.0)
    page = lay_out(Layout(sheet=sheet), UTM33, (0.0, 0.0, 5000.0, 4000.0))
    boxes = [shapely.box(*box) for box in (page.border, page.head, page.foot, page.panel) if box]
    inside = shapely.box(12.0, 12.0, page.width - 12.0, page.height - 12.0).buffer(1e-6)
    assert all(inside.contains(box) for box in boxes)
    assert all(a.intersection(b).area < 1e-6 for i, a in enumerate(boxes) for b in boxes[:i])
    assert shapely.box(*page.border).contains(shapely.box(*page.neatline))
    assert page.width > page.height if orientation == "landscape" else page.width < page.height


def test_scale_and_paper_follow() -> None:
    """Without a scale the largest round one; without a paper the smallest that holds all."""
    extent = (0.0, 0.0, 1996.0, 1563.0)
    assert lay_out(Layout(), UTM33, extent).scale == 10_000.0
    small = lay_out(Layout(map=MapPart(scale=20_000.0)), UTM33, extent)
    assert sorted((small.width, small.height)) == [210.0, 297.0]
    assert lay_out(Layout(map=MapPart(scale=5_000.0)), UTM33, extent).width == 594.0
    feet = CRS("EPSG:2263")  # New York, US survey feet
    page = lay_out(Layout(map=MapPart(scale=1200.0), sheet=SheetPart(paper="A4")), feet, (0.0, 0.0, 300.0, 300.0))
    assert page.mm_per_unit == pytest.approx(1200 / 3937 * 1000 / 1200)


@pytest.mark.parametrize(
    ("layout", "crs", "words"),
    [
        (Layout(), "EPSG:4326", "not projected"),
        (Layout(map=MapPart(bounds=(0.0, 0.0, 10.0, 10.0))), "EPSG:32633", "beside the picture"),
        (Layout(map=MapPart(bounds=(10.0, 0.0, 0.0, 10.0))), "EPSG:32633", "enclose no area"),
        (Layout(sheet=SheetPart(paper="100x100", panel="bottom")), "EPSG:32633", "no room for a map"),
        (Layout(sheet=SheetPart(paper="A4"), map=MapPart(500.0, AREA)), "EPSG:32633", "has room for"),
    ],
)
def test_layouts_that_do_not_fit(layout: Layout, crs: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as failed:
        lay_out(layout, CRS(crs), (398_986.0, 5_499_220.0, 400_982.0, 5_500_783.0))
    assert failed.value.hint


@pytest.mark.parametrize(
    ("values", "words", "hint"),
    [
        ({"sheet": {"tittle": "x"}}, "unknown key 'tittle'", "did you mean 'title'"),
        ({"grids": {}}, "unknown key 'grids'", "did you mean 'grid'"),
        ({"grid": {"style": "line"}}, "'line' is not known", "did you mean 'lines'"),
        ({"grid": {"color": "blu"}}, "no colour", "did you mean 'blue'"),
        ({"grid": {"interval": 0}}, "out of range", "above 0"),
        ({"grid": {"interval": "x"}}, "not a number", "a number"),
        ({"sheet": {"dpi": 10}}, "out of range", "72"),
        ({"grid": 3}, "table of keys", "[grid]"),
        ({"map": {"bounds": [1, 2, 3]}}, "3 values where 4", "give 4"),
        ({"layer": [{"style": "road"}]}, "'file' is missing", "file = "),
        ({"grid": {"labels": 1}}, "not true or false", "true or false"),
    ],
)
def test_wrong_layouts_are_reported_with_a_hint(values: dict[str, object], words: str, hint: str) -> None:
    with pytest.raises(InputError) as failed:
        build(Layout, values, "layout.toml")
    assert words in failed.value.what
    assert hint in (failed.value.hint or "")
    assert "layout.toml" in (failed.value.where or "")


def test_papers_and_scales() -> None:
    assert paper_size("a3") == (297.0, 420.0)
    assert paper_size("300x200mm") == (300.0, 200.0)
    assert [parse_scale(t) for t in ("1:5000", "1 : 25 000", "2500", "1:10'000")] == [5000, 25000, 2500, 10000]
    for text in ("1:0", "0", "large", "1:", "1:2,5"):
        with pytest.raises(InputError, match="no scale"):
            parse_scale(text)
    with pytest.raises(InputError, match="no paper"):
        paper_size("B9")


def test_boxes_overlap_as_polygons_do() -> None:
    """The separating axes against shapely, for turned boxes at random."""
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(400):
        boxes = [
            corners(LabelPosition(*rng.uniform(0, 10, 2), rng.uniform(-90, 90)), *rng.uniform(1, 6, 2))
            for _ in range(2)
        ]
        area = shapely.Polygon(boxes[0]).intersection(shapely.Polygon(boxes[1])).area
        if 0 < area < 1e-6:
            continue
        hits += area > 0
        assert overlap(*boxes) == (area > 0)
    assert 50 < hits < 350


def test_labels_never_touch() -> None:
    """200 names at random points: those that are placed keep off each other, the symbols and the frame."""
    rng = np.random.default_rng(5)
    frame = (0.0, 0.0, 150.0, 100.0)
    placer = LabelPlacer(frame)
    points = rng.uniform((2, 2), (148, 98), (200, 2))
    for x, y in points:
        placer.block(float(x), float(y), 1.8)
    placed = [
        found
        for x, y in points
        if (found := placer.place("name", 12.0, 2.0, around_point(float(x), float(y), 12.0, 2.0, 1.7)))
    ]
    boxes = [shapely.Polygon(p.pieces[0].box()) for p in placed]
    assert 80 < len(placed) < 200
    assert all(a.distance(b) > 0.5 for i, a in enumerate(boxes) for b in boxes[:i])
    squares = [shapely.box(x - 0.9, y - 0.9, x + 0.9, y + 0.9) for x, y in points]
    assert all(box.intersection(square).area == 0 for box in boxes for square in squares)
    assert all(shapely.box(*frame).contains(box) for box in boxes)


def test_labels_stay_within_a_slanted_neatline() -> None:
    """Every corner of every text is inside; some that the frame alone would have taken are not there."""
    ring = np.array([(5.0, 0.0), (100.0, 6.0), (95.0, 100.0), (0.0, 94.0)])
    rng = np.random.default_rng(5)
    slanted, plain = (LabelPlacer((0.0, 0.0, 100.0, 100.0), outline=area) for area in (shapely.Polygon(ring), None))
    count = 0
    for x, y in rng.uniform(0, 100, (300, 2)):
        placed = slanted.place("name", 12.0, 2.0, around_point(x, y, 12.0, 2.0, 1.0))
        count += plain.place("name", 12.0, 2.0, around_point(x, y, 12.0, 2.0, 1.0)) is not None
        if placed is not None:
            box = shapely.Polygon(placed.pieces[0].box())
            assert shapely.Polygon(ring).contains(box)
            count -= 1
    assert count > 0
    assert slanted.inside(50.0, 50.0)
    assert not slanted.inside(1.0, 1.0)


def test_a_lone_name_stands_upper_right() -> None:
    spot = around_point(10.0, 10.0, 8.0, 2.0, 1.5)[0]
    assert spot.x > 10.0
    assert spot.y > 10.0


def test_labels_beside_each_other() -> None:
    assert labels_that_fit([30.0, 10.0, 12.0, 20.0], [5.0, 5.0, 5.0, 5.0], 2.0) == [1, 3, 0]


STYLE = {
    "column": "class",
    "line": {"color": "white", "width": 0.4},
    "category": [{"value": 1, "title": "One", "line": {"width": 1.0}}, {"value": "two"}],
}


def test_rules_choose_categories_by_number_and_text() -> None:
    """Numbers and text as values; objects that no rule names are drawn by the base and counted."""
    style = parse_style(STYLE, "roads.toml")
    assert style.rules[1].line == Line("#ffffff", 0.4)
    lines = [shapely.LineString([(0, i), (50, i)]) for i in range(1, 6)]
    cells = {"class": [1, "two", "1", None, "three"]}
    made = overlay(lines, cells, UTM33, style, "Roads", page_of(UTM33, (0, 0, 100, 100), 10.0), where="roads.gpkg")
    assert {g.title: len(g.geometries) for g in made.groups} == {"other": 2, "One": 2, "two": 1}
    assert "2 of 5 objects" in made.notes[0]
    with pytest.raises(InputError, match="no column 'class'") as failed:
        overlay(lines, {"clas": [1] * 5}, UTM33, style, "", page_of(UTM33, (0, 0, 9, 9), 9.0), where="r")
    assert failed.value.hint == "did you mean 'clas'?"


def test_graduated_classes_split_the_values() -> None:
    """Quantiles put as many objects in each class; the colours run from the first to the last."""
    style = parse_style({"graduated": {"column": "n", "count": 4, "start": "#000000", "end": "#0000ff"}}, "s.toml")
    points = [shapely.Point(i, i) for i in range(1, 41)]
    made = overlay(points, {"n": list(range(40))}, UTM33, style, "P", page_of(UTM33, (0, 0, 100, 100), 9.0), where="p")
    assert [len(group.geometries) for group in made.groups] == [10, 10, 10, 10]
    colors = [group.symbol.marker.color for group in made.groups if group.symbol.marker]
    assert colors == ["#000000", "#000055", "#0000aa", "#0000ff"]
    assert rule_matches(Rule(least=1.0, below=2.0), 1.0)
    assert not rule_matches(Rule(least=1.0, below=2.0), 2.0)
    assert not rule_matches(Rule(least=1.0), None)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, "draws nothing"),
        ({"category": [{"value": "x"}]}, "need a column"),
        ({"column": "c", "category": [{"title": "x"}]}, "no value"),
        ({"line": {"widht": 1}}, "unknown key 'widht'"),
        ({"marker": {"shape": "blob"}}, "'blob' is not known"),
        ({"label": {"size": 7}}, "'column' is missing"),
        ({"column": "c", "class": [{"title": "x"}]}, "no limits"),
    ],
)
def test_wrong_styles_are_reported_with_a_hint(values: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_style(values, "style.toml")


def test_unknown_style_names_the_nearest() -> None:
    with pytest.raises(InputError) as failed:
        built_in("raod")
    assert failed.value.hint == "did you mean 'road'?"


def test_long_sides_bend_with_the_map() -> None:
    """A parallel of latitude with two vertices is drawn as the curve it is on the map, within 2 cm."""
    area = (300_000.0, 5_400_000.0, 700_000.0, 5_700_000.0)
    parallel = np.array([shapely.LineString([(13.0, 50.0), (17.0, 50.0)])], dtype=object)
    (line,) = to_map(parallel, CRS("EPSG:4326"), UTM33, area, 1000.0)
    back = Transformer.from_crs(UTM33, "EPSG:4326", always_xy=True)
    xy = np.asarray(line.coords)
    middle = (xy[:-1] + xy[1:]) / 2
    assert np.abs(np.array(back.transform(*middle.T))[1] - 50.0).max() * 111_000 < 0.02
    chord = shapely.LineString([xy[0], xy[-1]])
    assert line.hausdorff_distance(chord) > 500.0


def test_what_lies_outside_the_sheet_is_left_out() -> None:
    here, beside = shapely.Point(5, 5), shapely.Point(500, 5)
    made = overlay(
        [beside, here, None], {}, UTM33, Style(symbol=Symbol(line=Line())), "P", page_of(UTM33, (0, 0, 10, 10), 9.0),
        where="p",
    )  # fmt: skip
    assert made.count == 1
    empty = overlay([beside], {}, UTM33, Style(), "P", page_of(UTM33, (0, 0, 10, 10), 9.0), where="p")
    assert empty.notes == ("no object lies on the sheet",)
    collection = shapely.GeometryCollection([shapely.MultiPoint([(0, 0), (1, 1)]), here.buffer(1)])
    assert [len(parts_of([collection], kind)) for kind in ("point", "line", "polygon")] == [2, 0, 1]


def test_accuracy_is_what_the_report_measured() -> None:
    report = {
        "orient": {"rms_check_px": 0.291, "control": [{"role": "check"}] * 3 + [{"role": "control"}]},
        "mosaic": {"grid": {"crs": "x, metre", "resolution": [0.5, 0.5]}},
        "check": {"reference": {"registration_rms_px": 0.2, "matched": 9}},
    }
    text = accuracy_statement(report, 10_000.0)
    assert "0.29 px RMS in the images (3 measurements)" in text
    assert "0.2 px = 0.1 m RMS (9 places)" in text
    assert "0.3 mm on the sheet are 3 m" in text
    assert accuracy_statement({"orient": {}, "check": {"reference": None}}, 1.0) == ""


def test_layouts_are_values() -> None:
    assert replace(Layout(), sheet=SheetPart(title="x")) == build(Layout, {"sheet": {"title": "x"}}, "l")
