"""Sheet schemes: published sheets and their edges, from a place to a sheet and back, neighbours, curved neatlines."""

from __future__ import annotations

import random

import numpy as np
import pytest
import shapely
from pyproj import CRS, Geod, Transformer

from geomosaic.errors import InputError
from geomosaic.sheets.series.inputs import SCHEMES
from geomosaic.sheets.series.inputs import sheet_scheme as scheme
from geomosaic.sheets.series.national import DIVISIONS, Mgrs, from_roman, roman
from geomosaic.sheets.series.regular import DIRECTIONS, GridScheme, Polygons, Scheme, regular, sheet_place, sheets_on


def dms(degrees: float, minutes: float = 0.0, seconds: float = 0.0) -> float:
    return degrees + minutes / 60 + seconds / 3600


# Name, lower left and upper right corner (longitude, latitude), and a place on the sheet.
# Divisions and letters: Dz.U. 2012 poz. 1247 section 18 (Poland). Towns lie on the sheets that bear their names.
PUBLISHED: list[tuple[str, int, str, tuple[float, float], tuple[float, float], tuple[float, float]]] = [
    # The international map: N-34 Warszawa, M-34, N-37 Moskva, O-36 Leningrad, M-33 Praha.
    ("international", 1_000_000, "N-34", (18, 52), (24, 56), (21.01, 52.23)),
    ("international", 1_000_000, "M-34", (18, 48), (24, 52), (19.94, 50.06)),
    ("international", 1_000_000, "O-36", (30, 56), (36, 60), (30.32, 59.94)),
    ("international", 1_000_000, "M-33", (12, 48), (18, 52), (14.42, 50.09)),
    # Sheets 1:1 000 000 of the Soviet general staff and of the state geological map of Russia, and a town on each.
    ("international", 1_000_000, "N-36", (30, 52), (36, 56), (32.05, 54.78)),  # Smolensk
    ("international", 1_000_000, "O-37", (36, 56), (42, 60), (39.87, 57.62)),  # Yaroslavl
    ("international", 1_000_000, "O-40", (54, 56), (60, 60), (56.25, 58.0)),  # Perm
    ("international", 1_000_000, "O-41", (60, 56), (66, 60), (60.6, 56.84)),  # Yekaterinburg
    ("international", 1_000_000, "N-41", (60, 52), (66, 56), (61.4, 55.16)),  # Chelyabinsk
    ("international", 1_000_000, "N-40", (54, 52), (60, 56), (55.97, 54.73)),  # Ufa
    ("international", 1_000_000, "N-43", (72, 52), (78, 56), (73.37, 54.98)),  # Omsk
    ("international", 1_000_000, "N-44", (78, 52), (84, 56), (82.92, 55.03)),  # Novosibirsk
    ("international", 1_000_000, "O-38", (42, 56), (48, 60), (44.0, 56.33)),  # Nizhny Novgorod
    ("international", 1_000_000, "N-39", (48, 52), (54, 56), (50.15, 53.2)),  # Samara
    ("international", 1_000_000, "M-36", (30, 48), (36, 52), (30.52, 50.45)),  # Kiev
    ("international", 1_000_000, "M-53", (132, 48), (138, 52), (135.08, 48.48)),  # Khabarovsk
    ("international", 1_000_000, "P-36", (30, 60), (36, 64), (34.35, 61.78)),  # Petrozavodsk
    # South of the equator: Rio de Janeiro, Brisbane, Sydney, Melbourne, Perth, Darwin.
    ("international", 1_000_000, "SF-23", (-48, -24), (-42, -20), (-43.2, -22.9)),
    ("international", 1_000_000, "SG-56", (150, -28), (156, -24), (153.03, -27.47)),
    ("international", 1_000_000, "SI-56", (150, -36), (156, -32), (151.21, -33.87)),
    ("international", 1_000_000, "SJ-55", (144, -40), (150, -36), (144.96, -37.81)),
    ("international", 1_000_000, "SH-50", (114, -32), (120, -28), (115.86, -31.95)),
    ("international", 1_000_000, "SD-52", (126, -16), (132, -12), (130.84, -12.46)),
    ("international", 500_000, "M-34-A", (18, 50), (21, 52), (19.94, 50.06)),
    ("international", 250_000, "M-34-A-c", (18, 50), (dms(19, 30), 51), (19.0, 50.3)),
    ("international", 200_000, "N-34-XV", (20, 54), (21, dms(54, 40)), (20.5, 54.35)),
    # Soviet sheets 1:100 000: Moscow N-37-4, Leningrad O-36-1, Kiev M-36-50, Minsk N-35-80; N-37-144 is the last one.
    ("soviet", 100_000, "N-37-4", (37.5, dms(55, 40)), (38, 56), (37.62, 55.75)),
    ("soviet", 100_000, "O-36-1", (30, dms(59, 40)), (30.5, 60), (30.32, 59.94)),
    ("soviet", 100_000, "M-36-50", (30.5, dms(50, 20)), (31, dms(50, 40)), (30.52, 50.45)),
    ("soviet", 100_000, "N-35-80", (27.5, dms(53, 40)), (28, 54), (27.56, 53.9)),
    ("soviet", 100_000, "N-37-144", (41.5, 52), (42, dms(52, 20)), (41.7, 52.1)),
    # Poland: Warszawa-Zachód N-34-138 and -Wschód N-34-139, Kraków M-34-64, and the divisions of one sheet.
    ("puwg1992", 100_000, "N-34-138", (20.5, 52), (21, dms(52, 20)), (20.9, 52.2)),
    ("puwg1992", 100_000, "N-34-139", (21, 52), (21.5, dms(52, 20)), (21.1, 52.25)),
    ("puwg1992", 100_000, "M-34-64", (19.5, 50), (20, dms(50, 20)), (19.94, 50.06)),
    # Towns of Poland and the sheets 1:100 000 they lie on.
    ("puwg1992", 100_000, "N-33-130", (16.5, dms(52, 20)), (17, dms(52, 40)), (16.93, 52.41)),  # Poznań
    ("puwg1992", 100_000, "M-33-35", (17, 51), (17.5, dms(51, 20)), (17.03, 51.11)),  # Wrocław
    ("puwg1992", 100_000, "N-34-50", (18.5, dms(54, 20)), (19, dms(54, 40)), (18.65, 54.35)),  # Gdańsk
    ("puwg1992", 100_000, "M-34-3", (19, dms(51, 40)), (19.5, 52), (19.45, 51.77)),  # Łódź
    ("puwg1992", 100_000, "M-34-34", (22.5, 51), (23, dms(51, 20)), (22.57, 51.25)),  # Lublin
    ("puwg1992", 100_000, "M-34-63", (19, 50), (19.5, dms(50, 20)), (19.02, 50.26)),  # Katowice
    ("puwg1992", 100_000, "M-34-69", (22, 50), (22.5, dms(50, 20)), (22.03, 50.04)),  # Rzeszów
    ("puwg1992", 100_000, "N-33-90", (14.5, dms(53, 20)), (15, dms(53, 40)), (14.55, 53.43)),  # Szczecin
    ("puwg1992", 100_000, "N-34-107", (23, 53), (23.5, dms(53, 20)), (23.16, 53.13)),  # Białystok
    ("puwg1992", 100_000, "M-34-100", (19.5, 49), (20, dms(49, 20)), (19.95, 49.3)),  # Zakopane
    ("puwg1992", 100_000, "N-34-77", (20, dms(53, 40)), (20.5, 54), (20.48, 53.78)),  # Olsztyn
    ("puwg1992", 100_000, "M-34-42", (20.5, dms(50, 40)), (21, 51), (20.63, 50.87)),  # Kielce
    ("puwg1992", 100_000, "N-33-69", (16, 54), (16.5, dms(54, 20)), (16.18, 54.19)),  # Koszalin
    ("puwg1992", 100_000, "M-34-39", (19, dms(50, 40)), (19.5, 51), (19.12, 50.81)),  # Częstochowa
    ("puwg1992", 100_000, "N-34-70", (22.5, 54), (23, dms(54, 20)), (22.93, 54.1)),  # Suwałki
    ("puwg1992", 50_000, "M-34-64-D", (19.75, 50), (20, dms(50, 10)), (19.94, 50.06)),
    ("puwg1992", 25_000, "M-34-64-D-c", (19.75, 50), (dms(19, 52, 30), dms(50, 5)), (19.8, 50.02)),
    ("puwg1992", 10_000, "M-34-64-D-c-3", (19.75, 50), (dms(19, 48, 45), dms(50, 2, 30)), (19.78, 50.02)),
    # Germany: outermost sheets of TK 25, after the lexicon of geoinformatics of the University of Rostock (List or
    # Ust on Sylt, Selfkant, Görlitz, Biberkopf), Utting am Ammersee and Regensburg, Mannheim-Nordost, München.
    ("tk", 25_000, "0916", (dms(8, 20), 55), (dms(8, 30), dms(55, 6)), (8.42, 55.03)),
    ("tk", 25_000, "4901", (dms(5, 50), 51), (6, dms(51, 6)), (5.8664, 51.051)),
    ("tk", 25_000, "4855", (dms(14, 50), dms(51, 6)), (15, dms(51, 12)), (14.987, 51.155)),
    ("tk", 25_000, "8727", (dms(10, 10), dms(47, 12)), (dms(10, 20), dms(47, 18)), (10.236, 47.27)),
    ("tk", 25_000, "7932", (11, 48), (dms(11, 10), dms(48, 6)), (11.09, 48.03)),
    ("tk", 25_000, "6938", (12, 49), (dms(12, 10), dms(49, 6)), (12.10, 49.01)),
    ("tk", 25_000, "6417", (dms(8, 30), dms(49, 30)), (dms(8, 40), dms(49, 36)), (8.53, 49.52)),
    ("tk", 25_000, "7835", (dms(11, 30), dms(48, 6)), (dms(11, 40), dms(48, 12)), (11.575, 48.137)),
    # TK 25 that bear the names of towns.
    ("tk", 25_000, "6518", (dms(8, 40), dms(49, 24)), (dms(8, 50), dms(49, 30)), (8.69, 49.41)),  # Heidelberg-Nord
    ("tk", 25_000, "6916", (dms(8, 20), 49), (dms(8, 30), dms(49, 6)), (8.404, 49.012)),  # Karlsruhe-Nord
    ("tk", 25_000, "7121", (dms(9, 10), dms(48, 48)), (dms(9, 20), dms(48, 54)), (9.28, 48.81)),  # Stuttgart-Nordost
    ("tk", 25_000, "7220", (9, dms(48, 42)), (dms(9, 10), dms(48, 48)), (9.108, 48.727)),  # Stuttgart-Südwest
    ("tk", 25_000, "5208", (7, dms(50, 42)), (dms(7, 10), dms(50, 48)), (7.1, 50.735)),  # Bonn
    ("tk", 25_000, "5007", (dms(6, 50), dms(50, 54)), (7, 51), (6.96, 50.94)),  # Köln
    ("tk", 25_000, "6532", (11, dms(49, 24)), (dms(11, 10), dms(49, 30)), (11.077, 49.453)),  # Nürnberg
    ("tk", 25_000, "4948", (dms(13, 40), 51), (dms(13, 50), dms(51, 6)), (13.74, 51.05)),  # Dresden
    ("tk", 25_000, "4640", (dms(12, 20), dms(51, 18)), (dms(12, 30), dms(51, 24)), (12.375, 51.34)),  # Leipzig
    ("tk", 25_000, "3624", (dms(9, 40), dms(52, 18)), (dms(9, 50), dms(52, 24)), (9.73, 52.375)),  # Hannover
    ("tk", 25_000, "5818", (dms(8, 40), dms(50, 6)), (dms(8, 50), dms(50, 12)), (8.69, 50.115)),  # Frankfurt Ost
    ("tk", 25_000, "8532", (11, dms(47, 24)), (dms(11, 10), dms(47, 30)), (11.095, 47.485)),  # Garmisch
    ("tk", 25_000, "6015", (dms(8, 10), dms(49, 54)), (dms(8, 20), 50), (8.27, 49.98)),  # Mainz
    ("tk", 25_000, "6205", (dms(6, 30), dms(49, 42)), (dms(6, 40), dms(49, 48)), (6.641, 49.757)),  # Trier
    ("tk", 50_000, "L 7934", (dms(11, 20), 48), (dms(11, 40), dms(48, 12)), (11.575, 48.137)),
    ("tk", 50_000, "L 6516", (dms(8, 20), dms(49, 24)), (dms(8, 40), dms(49, 36)), (8.47, 49.49)),
    ("tk", 100_000, "C 7934", (dms(11, 20), 48), (12, dms(48, 24)), (11.575, 48.137)),
    ("tk", 200_000, "CC 7934", (dms(11, 20), 48), (dms(12, 40), dms(48, 48)), (11.575, 48.137)),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "scale", "name", "low", "high", "place"), PUBLISHED, ids=lambda v: str(v))
def test_published_sheets(
    kind: str, scale: int, name: str, low: object, high: object, place: tuple[float, float]
) -> None:
    series = scheme(kind, scale)
    assert isinstance(series, GridScheme)
    assert series.cell(name) == pytest.approx((*low, *high), abs=1e-12)
    assert series.find(*place) == series.proper(name)
    assert series.scale == scale


# French sheets and towns on them: 2314 Paris, 2214 Versailles, 2043 Toulouse, 3145 Marseille, 2302 Dunkerque.
@pytest.mark.parametrize(
    ("name", "number", "place"),
    [
        ("XXIII-14", "2314 O", (2.35, 48.856)), ("XXII-14", "2214 O", (2.13, 48.80)),
        ("XX-43", "2043 E", (1.444, 43.604)),
        ("XXXI-45", "3145 O", (5.37, 43.296)), ("XXIII-2", "2302 O", (2.377, 51.034)),
    ],
)  # fmt: skip
def test_french_sheets(name: str, number: str, place: tuple[float, float]) -> None:
    large, small = scheme("ign", 50_000), scheme("ign", 25_000)
    assert large.find(*place) == name
    assert small.find(*place) == number
    assert isinstance(large, GridScheme)
    assert large.proper(number[:4]) == name
    # In gons from Paris the edges are round.
    gons = (np.array(large.cell(name)) - [2.337229167, 0, 2.337229167, 0]) / 0.9
    assert np.abs(gons / 0.2 - np.round(gons / 0.2)).max() < 1e-6


# Names that publications give for places (Honolulu 4Q FJ, Washington Monument 18S UJ 23480 06470,
# Eiffel tower 31U DQ 48251 11932, Vienna 33U XP, Bergen in zone 32V, Longyearbyen in 33X).
@pytest.mark.parametrize(
    ("place", "name"),
    [
        ((-157.916861, 21.309444), "4QFJ"), ((-77.0352, 38.8895), "18SUJ2306"), ((2.2945, 48.8582), "31UDQ4811"),
        ((16.3725, 48.2085), "33UXP"), ((5.32, 60.39), "32VKN"), ((15.63, 78.22), "33XWG"),
    ],
)  # fmt: skip
def test_published_squares(place: tuple[float, float], name: str) -> None:
    assert Mgrs(1000).find(*place).startswith(name)


def test_squares_against_an_independent_library() -> None:
    mgrs = pytest.importorskip("mgrs").MGRS()
    random.seed(7)
    for size, digits in ((100_000, 0), (10_000, 1), (1000, 2), (100, 3)):
        squares = Mgrs(size)
        for _ in range(250):
            x, y = random.uniform(-180, 180), random.uniform(-80, 83.99)
            assert squares.find(x, y) == mgrs.toMGRS(y, x, MGRSPrecision=digits).lstrip("0")


ALL = [(kind, s) for kind in ("international", "puwg1992", "soviet") for s in DIVISIONS] + [
    ("tk", s) for s in (25_000, 50_000, 100_000, 200_000)
] + [("ign", 50_000), ("ign", 25_000)]  # fmt: skip


@pytest.mark.parametrize(("kind", "scale"), ALL)
def test_there_and_back(kind: str, scale: int) -> None:
    """Every place lies on the sheet that is found for it; names and neighbours lead back; sheets tile the ground."""
    series = scheme(kind, scale)
    assert isinstance(series, GridScheme)
    random.seed(scale)
    for _ in range(60):
        x, y = random.uniform(-3.5, 1.5) + (11 if kind != "ign" else 0), random.uniform(48.5, 50.9)
        name = series.find(x, y)
        left, bottom, right, top = series.cell(name)
        assert left <= x < right
        assert bottom <= y < top
        assert series.proper(name.lower() if kind != "tk" else name) == name
        opposite = dict(zip(DIRECTIONS, reversed(DIRECTIONS), strict=True))
        around = series.neighbours(name)
        assert len(around) == 8
        for way, other in around.items():
            assert series.neighbours(other)[opposite[way]] == name
            east, north = DIRECTIONS[way]
            assert series.cell(other)[:2] == pytest.approx(
                (left + east * (right - left), bottom + north * (top - bottom))
            )
        assert series.find(left, bottom) == name  # on its own corner
        assert series.find(right, top) == around["NE"]
    box = (9.01, 48.01, 9.74, 48.52)
    cells = [shapely.box(*series.cell(n)) for n in series.within(box)]
    assert shapely.union_all(cells).contains(shapely.box(*box))
    assert sum(c.area for c in cells) == pytest.approx(shapely.union_all(cells).area)


def test_a_sheet_has_one_name_in_all_its_spellings() -> None:
    polish, soviet = scheme("puwg1992", 10_000), scheme("soviet", 10_000)
    for spelling in ("M-34-64-D-c-3", "M-34-064-D-c-3", "m-34-64-d-c-3", "M-34-64-Dc3", "M 34 64 D c 3"):
        assert polish.proper(spelling) == "M-34-64-D-c-3"
    assert soviet.proper("N-37-4-D-c-2") == "N-37-4-Г-в-2"
    assert soviet.proper("N-37-4-G-v-2") == "N-37-4-Г-в-2"
    assert soviet.proper("N-37-4-Г-в-2") == "N-37-4-Г-в-2"
    assert soviet.map_crs("N-37-4-Г-в-2") == "EPSG:28407"
    assert polish.map_crs("M-34-64-D-c-3") == "EPSG:2180"
    assert scheme("international", 25_000).map_crs("M-33-47-A-a") == "EPSG:32633"
    assert scheme("international", 200_000).proper("N-34-15") == "N-34-XV"
    assert scheme("tk", 50_000).proper("L7934") == "L 7934"
    assert Mgrs(1000).proper("31u dq 48 11") == "31UDQ4811"
    world = scheme("international", 1_000_000)
    assert [world.proper(name) for name in ("NK-19", "sf 23", "SF23", "N-34")] == ["K-19", "SF-23", "SF-23", "N-34"]
    assert scheme("international", 25_000).proper("NM-34-64-D-c") == "M-34-64-D-c"
    assert world.map_crs("SF-23") == "EPSG:32723"
    assert world.neighbours("SA-23")["N"] == "A-23"
    assert world.neighbours("A-23")["SW"] == "SA-22"
    assert [from_roman(roman(n)) for n in range(1, 100)] == list(range(1, 100))
    assert (roman(49), roman(94), roman(36)) == ("XLIX", "XCIV", "XXXVI")


@pytest.mark.parametrize(
    ("series", "name"),
    [
        (scheme("puwg1992", 10_000), "M-34-64-D-c-5"), (scheme("puwg1992", 10_000), "M-34-145-D-c-1"),
        (scheme("puwg1992", 10_000), "M-61-64-D-c-1"), (scheme("puwg1992", 10_000), "M-34-64-D-c"),
        (scheme("puwg1992", 100_000), "M-34-64-D"), (scheme("tk", 50_000), "L 7835"), (scheme("tk", 50_000), "7934"),
        (scheme("international", 500_000), "SF-23-A"), (scheme("international", 1_000_000), "SF-61"),
        (scheme("puwg1992", 1_000_000), "SF-23"), (scheme("international", 1_000_000), "SX-23"),
        (scheme("ign", 25_000), "2314"), (scheme("ign", 50_000), "2314 O"), (Mgrs(1000), "31UDQ48"), (Mgrs(), "31ODQ"),
        (Mgrs(), "31UZQ"), (Mgrs(), "32XMA"), (Mgrs(), "31UDK"), (regular("EPSG:32633", (1000, 1000)), "A1"),
    ],
    ids=lambda v: v if isinstance(v, str) else "",
)  # fmt: skip
def test_no_such_sheet(series: Scheme, name: str) -> None:
    with pytest.raises(InputError, match=name):
        series.edges(name)


def test_schemes_that_need_more() -> None:
    for name in SCHEMES:
        if name not in ("mgrs",):
            with pytest.raises(InputError):
                scheme(name)
    for name, scale in (("tk", 10_000), ("ign", 100_000), ("international", 5000)):
        with pytest.raises(InputError, match="1:"):
            scheme(name, scale)
    with pytest.raises(InputError, match="no scheme"):
        scheme("puwg92", 10_000)
    with pytest.raises(InputError, match="no sheet there"):
        scheme("tk", 25_000).find(-30.0, 50.0)
    with pytest.raises(InputError, match="no sheet there"):
        scheme("puwg1992", 25_000).find(float("nan"), 50.0)
    with pytest.raises(InputError, match="UTM ends"):
        Mgrs().find(0, 85)


def test_regular_grids() -> None:
    series = regular("EPSG:32633", (600.0, 400.0), origin=(0.5, 0.0), scale=2000)
    assert series.find(400_000, 5_500_000) == "C666-R13750"
    assert series.cell("C666-R13750") == (399_600.5, 5_500_000.0, 400_200.5, 5_500_400.0)
    assert series.find(-0.1, -0.1) == "C-1-R-1"
    assert series.neighbours("c0-r0")["SW"] == "C-1-R-1"
    assert series.title == "the grid of 600 x 400 m in WGS 84 / UTM zone 33N (EPSG:32633)"
    own = regular("+proj=tmerc +lat_0=49 +lon_0=16 +ellps=GRS80 +units=m", (500.0, 500.0))
    assert own.title == "the grid of 500 x 500 m in Transverse Mercator (custom)"
    # Tenths of a metre are tenths: no float creeps along the columns.
    fine = regular("EPSG:32633", (0.1, 0.1))
    assert fine.cell("C3-R7") == (0.3, 0.7, 0.4, 0.8)
    assert fine.find(0.3, 0.7) == "C3-R7"


def test_drawn_sheets() -> None:
    rings = {
        n: np.array([(x, y), (x + 10, y), (x + 10, y + 10), (x, y + 10)], dtype=float)
        for n, x, y in (("a", 0, 0), ("b", 10, 0), ("c", 0, 10), ("far", 100, 100))
    }
    series = Polygons("drawn", "EPSG:32633", rings)
    assert series.find(12, 3) == "b"
    assert series.neighbours("a") == {"N": "c", "E": "b"}
    assert list(series.within((11, 1, 12, 2))) == ["b"]
    with pytest.raises(InputError, match="no sheet there"):
        series.find(50, 50)
    with pytest.raises(InputError, match="no sheet of"):
        series.edges("d")


def test_neatlines_are_curved() -> None:
    """Every point of the neatline lies on its parallel or meridian, and the parallels bend away from their chords."""
    crs = CRS("EPSG:2180")
    place = sheet_place(scheme("puwg1992", 100_000), "M-34-64", crs)
    back = Transformer.from_crs(crs, "EPSG:4258", always_xy=True)
    lon, lat = back.transform(*place.ring.T)
    on = np.minimum.reduce([np.abs(lon - 19.5), np.abs(lon - 20), np.abs(lat - 50), np.abs(lat - (50 + 1 / 3))])
    assert on.max() < 1e-8
    (left, low), (right, end) = place.corners[0], place.corners[1]
    side = place.ring[:65]
    chord = low + (side[:, 0] - left) / (right - left) * (end - low)
    bend = np.abs(side[:, 1] - chord).max()
    # Sagitta of a parallel: s² tan(lat) / 8R.
    s = Geod(ellps="GRS80").inv(19.5, 50, 20, 50)[2]
    assert bend == pytest.approx(s**2 * np.tan(np.radians(50)) / (8 * 6.38e6), rel=0.03)
    # The scale of the pieces: chords of the 64 parts stay within 0.02 mm at the sheet's own scale.
    assert bend / 64**2 / 100_000 * 1000 < 0.02
    grown = sheet_place(scheme("puwg1992", 100_000), "M-34-64", crs, overlap=500.0)
    assert shapely.Polygon(grown.ring).contains(shapely.Polygon(place.ring).buffer(499))
    assert place.neighbours["E"] == "M-34-65"
    # In UTM a square stays four corners.
    assert len(sheet_place(Mgrs(1000), "33UXP0240", CRS("EPSG:32633")).ring) == 4


def test_square_at_the_edge_of_a_zone() -> None:
    """A square that the edge of the zone cuts ends there, the next begins there, and nothing is lost."""
    squares = Mgrs(100_000)
    name, other = squares.find(11.999, 49.5), squares.find(12.001, 49.5)
    assert (name[:2], other[:2]) == ("32", "33")
    assert squares.neighbours(name)["E"] == other
    crs, ring = squares.edges(name)
    lon = Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(*ring.T)[0]
    assert lon.max() == pytest.approx(12.0, abs=1e-6)
    box = (11.6, 49.3, 12.4, 49.7)
    parts = [
        shapely.Polygon(np.column_stack(Transformer.from_crs(c, "EPSG:4326", always_xy=True).transform(*r.T)))
        for c, r in map(squares.edges, squares.within(box))
    ]
    assert shapely.union_all(parts).buffer(1e-3).contains(shapely.box(*box))
    assert sum(p.area for p in parts) == pytest.approx(shapely.union_all(parts).area, rel=1e-3)


def test_sheets_of_an_area() -> None:
    """Those and only those that share ground with it."""
    series, crs = scheme("puwg1992", 10_000), CRS("EPSG:2180")
    bounds = sheet_place(series, "M-34-64-D-c-3", crs).bounds
    middle = ((bounds[0] + bounds[2]) / 2, (bounds[1] + bounds[3]) / 2)
    inside = (middle[0] - 100, middle[1] - 100, middle[0] + 100, middle[1] + 100)
    assert list(sheets_on(series, crs, inside)) == ["M-34-64-D-c-3"]
    # Its bounding box reaches into its neighbours, for the sides are not upright.
    assert set(sheets_on(series, crs, bounds)) > {"M-34-64-D-c-3"}
    with pytest.raises(InputError):
        list(sheets_on(series, CRS("EPSG:2180"), (1e9, 1e9, 2e9, 2e9)))


def test_sheets_across_the_date_line() -> None:
    """Those of an area are those that its places lie on, each once; the last column has the first one in the east."""
    series, utm = scheme("international", 100_000), CRS("EPSG:32601")
    bounds = (330_000.0, 7_300_000.0, 390_000.0, 7_360_000.0)
    x, y = np.meshgrid(np.linspace(bounds[0], bounds[2], 40)[1:-1], np.linspace(bounds[1], bounds[3], 40)[1:-1])
    places = np.column_stack(Transformer.from_crs(utm, 4326, always_xy=True).transform(x.ravel(), y.ravel()))
    names = list(sheets_on(series, utm, bounds))
    assert {series.find(*place) for place in places} <= set(names)
    assert len(names) == len(set(names)) < 12
    assert {name.split("-")[1] for name in names} == {"60", "01"}
    assert scheme("international", 1_000_000).neighbours("Q-60")["E"] == "Q-01"
    assert scheme("international", 1_000_000).neighbours("Q-01")["W"] == "Q-60"
