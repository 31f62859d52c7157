"""Every kind of bad control is recognised and named, and good control is left in peace."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS

from geomosaic.control.coordinate_diagnostics import Diagnostic
from geomosaic.control.diagnostics import contradictions, diagnose, hull_area, points_needed
from geomosaic.control.points import ControlPoints, Origin
from geomosaic.control.read import read_control_file
from geomosaic.errors import InputError
from geomosaic.estimation.expected_errors import convex_hull
from geomosaic.types import FloatArray

SIZE = (4000, 3000)
PIXEL = 0.25
LIKE_A_GRID = np.array(
    [[300, 250], [2050, 180], [3700, 300],
     [260, 1500], [1900, 1480], [3750, 1550],
     [350, 2750], [2000, 2800], [3650, 2700]], dtype=float
)  # fmt: skip
ZONE_33 = (612_345.0, 5_412_000.0)


def ground(colrow: FloatArray, turn: float = 8.0, origin: tuple[float, float] = ZONE_33) -> FloatArray:
    """A tilted photo over the plane: nearly a similarity, with a little perspective; y upwards, rows downwards."""
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    flat = (colrow - [2000, 1500]) * [1, -1] * PIXEL @ np.array([[c, s], [-s, c]])
    return origin + flat / (1.0 + 2e-5 * flat[:, :1])


def good(colrow: FloatArray = LIKE_A_GRID, crs: str = "EPSG:32633", **how: object) -> ControlPoints:
    noise = np.random.default_rng(4).normal(0.0, 0.3, colrow.shape)
    count = len(colrow)
    return ControlPoints(
        tuple(f"P{i}" for i in range(count)),
        colrow + noise,
        ground(colrow, **how),
        CRS(crs),
        np.ones(count),
        ("control",) * count,
        np.ones(count, dtype=bool),
        tuple(Origin("points.csv", i + 2) for i in range(count)),
    )


def degrees(control: ControlPoints) -> ControlPoints:
    return control.to_crs(CRS("EPSG:4326"))


def moved(control: ControlPoints, **parts: FloatArray) -> ControlPoints:
    return replace(control, **parts)


def codes(found: tuple[Diagnostic, ...]) -> list[str]:
    return [finding.code for finding in found]


def with_last(image: tuple[float, float], of: int, aside: float = 0.0) -> ControlPoints:
    """The good set and one more point: at an image place, with the ground of another."""
    control = good()
    return ControlPoints(
        (*control.names, "again"),
        np.vstack([control.colrow, image]),
        np.vstack([control.ground, control.ground[of] + aside]),
        control.crs,
        np.append(control.sigma, 1.0),
        (*control.roles, "control"),
        np.append(control.enabled, True),
        (*control.origins, Origin("points.csv", 11)),
    )


@pytest.mark.parametrize("turn", [0.0, 8.0, 44.0, 90.0, 133.0, 180.0, 270.0])
@pytest.mark.parametrize("kind", ["conformal", "affine", "projective", "poly2", "tps"])
def test_good_control_has_no_diagnostics(turn: float, kind: str) -> None:
    assert diagnose(good(turn=turn), kind=kind, size=SIZE, near=(16.5, 48.8)) == ()
    assert diagnose(degrees(good(turn=turn)), kind=kind, size=SIZE) == ()


ROW = np.column_stack([np.linspace(200, 3800, 9), np.linspace(300, 2700, 9)])
NEAR_ROW = ROW + np.array([[0, 60], [0, -60], [0, 60]] * 3)
ALL_BUT_ONE = np.array([[200, 200], [2000, 1500], [3800, 2800], [3700, 300]]) * 1.0
CLUSTER = LIKE_A_GRID * 0.15 + [500, 400]
MIDDLE = (LIKE_A_GRID - [2000, 1500]) * 0.62 + [2000, 1500]
NO_CORNER = np.vstack([np.delete(LIKE_A_GRID, [1, 2, 5], axis=0), [1600.0, 180.0]])


def mirror_rows(control: ControlPoints) -> ControlPoints:
    return moved(control, colrow=control.colrow * [1, -1] + [0, SIZE[1]])


CASES: dict[str, tuple[Callable[[], ControlPoints], list[str], str, dict[str, object]]] = {
    "too few": (lambda: good(LIKE_A_GRID[[0, 8]]), ["few-points"], "2 places, and a fit .affine. needs 3", {}),
    "too few for an order": (
        lambda: good(),
        ["few-points"],
        "9 places, and a fit .polynomial of order 3. needs 10",
        {"kind": "polynomial", "order": 3},
    ),
    "no redundancy": (
        lambda: good(LIKE_A_GRID[[0, 2, 6, 8]]),
        ["no-redundancy"],
        "4 places just determine the fit",
        {"kind": "projective"},
    ),
    "on a line": (lambda: good(ROW), ["collinear"], "on a line: 0.", {}),
    "nearly on a line": (lambda: good(NEAR_ROW), ["collinear"], "on a line, nearly", {}),
    "on a line, for a conformal fit": (
        lambda: good(ROW),
        ["collinear"],
        "on a line: 0.* nothing checks it beside the line",
        {"kind": "conformal"},
    ),
    "all but one on a line": (
        lambda: good(ALL_BUT_ONE),
        ["collinear", "no-redundancy"],
        "all points but P3 lie on a line",
        {"kind": "projective"},
    ),
    "one cluster": (lambda: good(CLUSTER), ["clustered"], "surround 1.6% of the image", {}),
    "an empty corner": (lambda: good(NO_CORNER), ["empty-corner"], "near the upper right corner", {}),
    "only the middle": (lambda: good(MIDDLE), ["extrapolation"], "of the image lies outside the hull", {}),
    "one place, two grounds": (
        lambda: with_last(tuple(good().colrow[3] + 0.1), of=4, aside=50.0),
        ["one-place-two-grounds"],
        r"P3 \(points.csv, line 5\) and again \(points.csv, line 11\) are one place in the image",
        {},
    ),
    "one ground, two places": (
        lambda: with_last((2500.0, 900.0), of=4),
        ["one-ground-two-places"],
        "P4 .* and again .* are one place on the ground",
        {},
    ),
    "the same twice": (lambda: with_last(tuple(good().colrow[4]), of=4), ["repeated"], "counts twice", {}),
    "x and y": (lambda: moved(good(), ground=good().ground[:, ::-1]), ["swapped-axes"], "axes exchanged", {}),
    "x and y in a local system": (
        lambda: replace(
            moved(good(), ground=good(origin=(0.0, 0.0)).ground[:, ::-1]),
            crs=CRS('LOCAL_CS["site",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'),
        ),
        ["swapped-axes"],
        "mirrored",
        {},
    ),
    "latitude and longitude": (
        lambda: moved(degrees(good()), ground=degrees(good()).ground[:, ::-1]),
        ["latitude-longitude-swapped"],
        "mirrored",
        {},
    ),
    "latitude beyond the pole": (
        lambda: moved(degrees(good()), ground=(degrees(good()).ground + np.array([-117.0, 0.0]))[:, ::-1]),
        ["latitude-longitude-swapped"],
        "axes exchanged",
        {},
    ),
    "a neighbouring zone": (lambda: good(origin=(1_100_000.0, 5.4e6)), ["wrong-zone"], "neighbouring zone", {}),
    "a zone that only a place nearby betrays": (
        lambda: good(),
        ["wrong-zone"],
        "they do in EPSG:32632",
        {"near": (10.5, 48.8)},
    ),
    "degrees in a metric CRS": (
        lambda: replace(degrees(good()), crs=CRS("EPSG:32633")),
        ["degrees-in-metres"],
        "look like degrees",
        {},
    ),
    "degrees in a world-wide metric CRS": (
        lambda: replace(degrees(good()), crs=CRS("EPSG:3857")),
        ["degrees-in-metres"],
        "look like degrees",
        {},
    ),
    "metres in degrees": (
        lambda: replace(good(), crs=CRS("EPSG:4326")),
        ["metres-in-degrees"],
        "look like metres",
        {},
    ),
    "feet": (lambda: moved(good(), ground=good().ground / 0.3048), ["wrong-unit"], "look like feet", {}),
    "kilometres": (lambda: moved(good(), ground=good().ground / 1000), ["wrong-unit"], "like kilometres", {}),
    "metres in feet": (
        lambda: moved(good(crs="EPSG:2263"), ground=ground(LIKE_A_GRID, origin=(300_000.0, 60_000.0))),
        ["wrong-unit"],
        "look like metres",
        {},
    ),
    "a lost digit": (
        lambda: moved(good(), ground=np.vstack([[61_234.5, 5_412_300.0], good().ground[1:]])),
        ["outside-crs-area"],
        "1 of 9 points does not lie in the area of use .*: P0",
        {},
    ),
    "rows from the bottom": (lambda: mirror_rows(good()), ["mirrored-rows"], "mirrored in the image", {}),
    "columns from the right": (
        lambda: moved(good(), colrow=good().colrow * [-1, 1] + [SIZE[0], 0]),
        ["mirrored-columns"],
        "mirrored in the image",
        {},
    ),
    "rows upwards from the top": (
        lambda: moved(good(), colrow=good().colrow * [1, -1]),
        ["negative-rows"],
        "rows are negative",
        {},
    ),
    "beyond the edge": (
        lambda: moved(good(), colrow=np.vstack([good().colrow[:-1], [4100.0, 2700.0]]), ground=np.vstack(
            [good().ground[:-1], ground(np.array([[4100.0, 2700.0]]))])),
        ["outside-image"],
        "1 of 9 points lies outside the image of 4000 × 3000 pixels: P8",
        {},
    ),
    "of a larger image": (lambda: moved(good(), colrow=good().colrow * 4), ["outside-image"], "8 of 9", {}),
    "col and row exchanged": (
        lambda: moved(good(), colrow=good().colrow[:, ::-1]),
        ["swapped-columns-rows"],
        "3 of 9 points lie outside .*, and all inside with col and row exchanged, which also turns the mirrored",
        {},
    ),
    "col and row exchanged in a square image": (
        lambda: moved(good(), colrow=good().colrow[:, ::-1]),
        ["swapped-axes"],
        "mirrored",
        {"size": (4000, 4000)},
    ),
}  # fmt: skip


@pytest.mark.parametrize(("make", "expected", "message", "options"), CASES.values(), ids=CASES.keys())
def test_bad_control_is_diagnosed_with_its_cause(
    make: Callable[[], ControlPoints], expected: list[str], message: str, options: dict[str, object]
) -> None:
    found = diagnose(make(), **{"size": SIZE, **options})
    assert codes(found) == expected
    assert re.search(message, found[0].what), found[0].what
    assert all(finding.hint for finding in found)


def table_rows() -> list[str]:
    """What is said of every case, as lines of the table of the docs (see `test_70_georeference_diagnostics.py`)."""
    lines = []
    for case, (make, _, _, options) in CASES.items():
        for finding in diagnose(make(), **{"size": SIZE, **options})[:1]:
            lines.append(f"| {case} | `{finding.code}` ({finding.severity}) | {finding.what} | {finding.hint} |")
    return lines


def test_points_left_out_do_not_count() -> None:
    control = with_last(tuple(good().colrow[3] + 0.1), of=4)
    assert diagnose(control.without(["again"]), size=SIZE) == ()
    as_check = replace(good(), roles=("check",) * 7 + ("control",) * 2)
    assert codes(diagnose(as_check, size=SIZE)) == ["few-points"]


def test_a_mirrored_image_with_a_point_beyond_its_edge_is_not_taken_for_exchanged_columns() -> None:
    """A film scanned from its back, and a mark on its border: no exchange mends both."""
    control = moved(good(), colrow=good().colrow * [-1, 1] + [SIZE[0], 0])
    colrow = np.vstack([control.colrow[:-1], [4020.0, 2700.0]])
    assert "swapped-columns-rows" not in codes(diagnose(moved(control, colrow=colrow), size=SIZE))


def test_a_third_of_blunders_hides_no_mirror_and_makes_none() -> None:
    random = np.random.default_rng(1)
    colrow = random.uniform([50, 50], [3950, 2950], (40, 2))
    for seed in range(20):
        control = good(colrow)
        wrong = np.random.default_rng(seed).permutation(40)[:12]
        shifted = control.ground.copy()
        shifted[wrong] += np.random.default_rng(seed).uniform(-400, 400, (12, 2))
        blundered = moved(control, ground=shifted)
        assert "mirrored-rows" not in codes(diagnose(blundered, size=SIZE))
        assert "mirrored-rows" in codes(diagnose(mirror_rows(blundered), size=SIZE))


def test_the_area_of_a_hull_is_exact() -> None:
    square = np.array([[0, 0], [2, 0], [2, 2], [0, 2], [1, 1], [1, 0]], dtype=float)
    assert hull_area(square) == 4.0
    assert hull_area(square[:2]) == 0.0
    assert hull_area(np.array([[0.0, 0], [1, 1], [2, 2]])) == 0.0


def test_the_hull_is_that_of_qhull() -> None:
    from scipy.spatial import ConvexHull

    chance = np.random.default_rng(3)
    far = ZONE_33 + chance.normal(0.0, 300.0, (200, 2))
    crowd = np.repeat(chance.integers(0, 9, (80, 2)).astype(float), 2, axis=0)
    for points in (far, far[:3], crowd):
        found = convex_hull(points)
        known = ConvexHull(points - points.mean(axis=0))
        assert {tuple(points[i]) for i in found} == {tuple(points[i]) for i in known.vertices}
        assert hull_area(points - points.mean(axis=0)) == pytest.approx(known.volume, rel=1e-9)
    unknown = np.vstack([[[np.nan, 0.0]], far])
    assert convex_hull(unknown) == [i + 1 for i in convex_hull(far)]
    assert sorted(convex_hull(np.array([[1.0, 1.0], [0.0, 0.0], [2.0, 2.0]]))) == [1, 2]


def test_each_model_needs_its_number_of_points() -> None:
    assert [points_needed("poly1"), points_needed("poly2"), points_needed("polynomial", 5), points_needed("tps")] == [
        3,
        6,
        21,
        3,
    ]
    with pytest.raises(InputError, match=r"no fit 'afine'[^$]*did you mean 'affine'"):
        points_needed("afine")


def cosicorr(folder: Path) -> ControlPoints:
    rows = np.genfromtxt(folder / "basemap_VS_SP2_GCP_expec.csv", delimiter=",", skip_header=1)
    count = len(rows)
    return ControlPoints(
        tuple(map(str, range(count))), rows[:, 3:5] + 0.5, rows[:, 5:7], CRS("EPSG:32636"), np.ones(count),
        ("control",) * count, np.ones(count, dtype=bool), tuple(Origin("gcps", i + 2) for i in range(count)),
    )  # fmt: skip


def test_real_control_is_diagnosed_as_documented(real_data: Callable[[str], Path]) -> None:
    """What is said of real sets, and why it is true."""
    scene = read_control_file(real_data("rio-tiler-gcps") / "cog_gcps.tif").control
    found = diagnose(scene, kind="poly3", size=(1280, 837))
    # Sentinel-1, descending: range runs west, so that columns do. A program wrote it, so it is no warning.
    assert [(finding.code, finding.severity) for finding in found] == [("mirrored-columns", "note")]
    folder = real_data("rasterio-fixtures")
    # 7449 x 11522 pixels were measured, the picture has 791 x 718.
    landsat = read_control_file(folder / "RGB.byte.gcp.vrt").control
    assert codes(diagnose(landsat, size=(791, 718))) == ["outside-image"]
    assert diagnose(landsat, size=(7449, 11522)) == ()
    # Three corners of four, for an affine fit.
    gemini = read_control_file(folder / "white-gemini-iv.vrt").control
    assert codes(diagnose(gemini, size=(1024, 768))) == ["no-redundancy", "empty-corner"]
    # All points but one lie left of column 3273: none is within 3500 pixels of the upper right corner.
    spot = cosicorr(real_data("cosicorr-spot-dimap"))
    assert np.hypot(*(spot.colrow - [6000, 0]).T).min() > 3500
    found = diagnose(spot, kind="poly2", size=(6000, 6000))
    assert codes(found) == ["empty-corner"]
    assert "near the upper right corner" in found[0].what
    kite = read_control_file(real_data("odm-copr") / "gcp_list.txt", image="IMG_0031.jpg").control
    # gcp00 and gcp04, 20 m apart, are marked 1.2 px apart in this photo: one mark is wrong, and with it all on a line.
    found = diagnose(kite, size=(4272, 2848))
    assert codes(found) == ["one-place-two-grounds", "collinear", "no-redundancy"]
    assert found[0].points == ("gcp04", "gcp00")


def test_real_ties_have_no_diagnostics(real_data: Callable[[str], Path]) -> None:
    folder = real_data("otb-sensor-geoms")
    rows = np.loadtxt(folder / "QB_TOULOUSE_MUL_Extract_500_500_in_tie_points.txt")
    count = len(rows)
    ties = ControlPoints(
        tuple(map(str, range(count))), rows[:, :2], rows[:, 2:], CRS("EPSG:4326"), np.ones(count),
        ("control",) * count, np.ones(count, dtype=bool), tuple(Origin("ties", i + 2) for i in range(count)),
    )  # fmt: skip
    assert diagnose(ties, kind="poly3", near=(1.42, 43.61)) == ()
    # The header says 'row col', and the numbers are col, row: read as it says, the ground is mirrored.
    as_headed = moved(ties, colrow=ties.colrow[:, ::-1])
    found = diagnose(as_headed, kind="poly3", near=(1.42, 43.61))
    assert codes(found) == ["latitude-longitude-swapped"]
    assert "exchange col and row" in found[0].hint


@pytest.mark.parametrize("kind", ["one place", "in pairs", "a line of columns"])
def test_many_repeated_points_are_told_in_a_few_findings(kind: str) -> None:
    """Time and memory grow with the number of points, however they lie."""
    count = 10_000
    places = np.random.default_rng(1).uniform(0.0, 3000.0, (count, 2))
    if kind == "one place":
        places[:] = places[0]
        places[:2] += [[900.0, 0.0], [0.0, 900.0]]
    elif kind == "in pairs":
        places[1::2] = places[::2]
    else:
        places[:, 0] = 7.0
    points = ControlPoints.from_arrays(places, places * [1.0, -1.0] + [5e5, 5.5e6], "EPSG:32633")
    found = contradictions(points)
    assert len(found) <= 11
    if kind != "a line of columns":
        assert [finding.code for finding in found] == ["repeated"] * 11
        assert "further pairs of points" in found[-1].what


@pytest.mark.parametrize("far", [0.0, 3e8])
def test_points_on_one_place_are_found_wherever_they_lie(far: float) -> None:
    """Against all distances: the search looks at neighbouring squares only."""
    chance = np.random.default_rng(11)
    places = chance.uniform(-400.0, 400.0, (150, 2)) + far
    places[130:] = places[:20] + chance.uniform(-3.0, 3.0, (20, 2))
    points = ControlPoints.from_arrays(places, chance.uniform(0.0, 1e5, (150, 2)), "EPSG:32633")
    apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
    close = {(points.names[i], points.names[j]) for i, j in np.argwhere(np.triu(apart <= 2.0, 1))}
    assert 5 <= len(close) <= 10
    assert {finding.points for finding in contradictions(points)} == close


def test_more_points_than_an_image_can_have_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("geomosaic.control.parsing.MOST", 20)
    file = tmp_path / "a.points"
    rows = "".join(f"{500000 + i},5500000,{i},-{i},1\n" for i in range(21))
    file.write_text(f"#CRS: EPSG:32633\nmapX,mapY,sourceX,sourceY,enable\n{rows}")
    with pytest.raises(InputError, match="21 points of the image, and 20 are taken"):
        read_control_file(file, size=(40, 40))
