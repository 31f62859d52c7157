"""Vector edge matching: lines cut at the edges of sheets and moved there meet again, by the weights of the sheets."""

from __future__ import annotations

from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import shapely

from geomosaic.cli.main import run
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.orientation.edges.line_ends import Bend
from geomosaic.products.vector_edges import match_vector_edges

CRS = "EPSG:32633"
X, Y = 500_000.0, 5_000_000.0
# Roads across the edge at y = 0, every 90 m.
EASTS = np.arange(60.0, 1000.0, 90.0)


def road(east: float, south: float, north: float) -> np.ndarray:
    """A winding road between two y, a vertex every 10 m."""
    y = np.linspace(south, north, int((north - south) / 10) + 1)
    return np.column_stack([X + east + 15 * np.sin(y / 70 + east), Y + y])


def sheet(path: Path, lines: list[np.ndarray], **columns: list[object]) -> Path:
    columns = columns or {"kind": ["road"] * len(lines)}
    shapes = [shapely.LineString(line) for line in lines]
    gpd.GeoDataFrame(columns, geometry=shapes, crs=CRS).to_file(path, layer="lines")
    return path


def two_sheets(folder: Path, noise: float = 0.6) -> tuple[Path, Path, np.ndarray, np.ndarray]:
    """Sheets to the north and south of y = 0, each with errors of its own at the edge; and the ends there."""
    rng = np.random.default_rng(7)
    off = rng.uniform(-noise, noise, (2, len(EASTS), 2))
    north = [road(east, 0, 400) for east in EASTS]
    south = [road(east, -400, 0) for east in EASTS]
    for k in range(len(EASTS)):
        north[k][0] += off[0, k]
        south[k][-1] += off[1, k]
    # A side road begins at a vertex of the first road, 20 m from the edge.
    side = np.vstack([north[0][2], north[0][2] + [40.0, 5.0]])
    a = sheet(folder / "north.gpkg", [*north, side])
    b = sheet(folder / "south.gpkg", south)
    return a, b, np.array([line[0] for line in north]), np.array([line[-1] for line in south])


def test_ends_meet_in_their_mean_and_the_sheet_holds_together(tmp_path: Path) -> None:
    a, b, north, south = two_sheets(tmp_path)
    made = match_vector_edges([a, b], tmp_path / "joined.gpkg", tolerance=2.0)
    assert made.places == len(EASTS)
    assert (made.unmatched, made.differences) == (0, 0)
    apart = np.hypot(*(north - south).T)
    assert made.before == pytest.approx((np.sqrt(np.mean(apart**2)), apart.max()))
    assert made.after < 1e-8
    found = made.read("lines")
    mine, theirs = found[found.sheet == "north.gpkg"].geometry, found[found.sheet == "south.gpkg"].geometry
    ends = np.array([line.coords[0] for line in mine][:-1])
    assert np.abs(ends - np.array([line.coords[-1] for line in theirs])).max() < 1e-8
    assert np.abs(ends - (north + south) / 2).max() < 1e-8
    # The side road still begins on its road; 40 m away, 20 times the tolerance, nothing has moved.
    assert mine.iloc[-1].coords[0] == mine.iloc[0].coords[2]
    for line, old in zip(theirs, gpd.read_file(b).geometry, strict=True):
        far = np.hypot(*(np.array(old.coords) - old.coords[-1]).T) > 60.0
        assert (np.array(line.coords)[far] == np.array(old.coords)[far]).all()
    joins = made.read("edge_joins")
    assert len(joins) == len(EASTS)
    assert np.allclose(np.sort(joins["distance"]), np.sort(apart))


def test_the_weights_of_the_sheets_decide_who_moves(tmp_path: Path) -> None:
    """Sigmas of 1 and 2 share a misfit as 1 to 4; a sheet of sigma 0 stays to the bit."""
    a, b, north, south = two_sheets(tmp_path)
    shared = match_vector_edges([a, b], tmp_path / "w.gpkg", tolerance=2.0, sigma=(1.0, 2.0)).read("lines")
    ends = np.array([line.coords[-1] for line in shared[shared.sheet == "south.gpkg"].geometry])
    assert np.abs(ends - (0.8 * north + 0.2 * south)).max() < 1e-8
    held = match_vector_edges([a, b], tmp_path / "h.gpkg", tolerance=2.0, sigma=(0.0, 1.0))
    assert held.moved[0] == 0.0
    kept = held.read("lines")
    assert list(kept[kept.sheet == "north.gpkg"].geometry) == list(gpd.read_file(a).geometry)


def test_what_does_not_meet_is_listed_with_the_reason(tmp_path: Path) -> None:
    """A road that ends 5 m aside, a river beside a road, and a dead end in the middle of a sheet, which is none."""
    north = [road(60, 0, 400), road(160, 0, 400), road(260, 0, 400), road(360, 150, 400)]
    south = [road(60, -400, 0), road(160, -400, 0) + np.array([5.0, 0.0]), road(260, -400, 0)]
    a = sheet(
        tmp_path / "a.gpkg",
        north,
        kind=["road", "road", "road", "road"],
        name=["A1", "x", "y", "z"],
        lanes=[2, 2, 2, 1],
    )
    b = sheet(tmp_path / "b.gpkg", south, kind=["road", "road", "river"], name=["A1", "x", "y"], lanes=[4, 2, 2])
    made = match_vector_edges([a, b], tmp_path / "j.gpkg", tolerance=2.0, same=("kind",))
    assert made.places == 1
    lost = made.read("edge_unmatched")
    assert sorted(zip(lost.sheet, lost.row, lost.why, strict=True)) == [
        ("a.gpkg", 2, "no end within the tolerance"),
        ("a.gpkg", 3, "the nearest end is of another layer or kind"),
        ("b.gpkg", 2, "no end within the tolerance"),
        ("b.gpkg", 3, "the nearest end is of another layer or kind"),
    ]
    assert lost.nearest[0] == pytest.approx(5.0)
    different = made.read("edge_differences")
    assert [(row.column, row["values"]) for _, row in different.iterrows()] == [("lanes", "2 | 4")]


def test_four_sheets_meet_at_their_corner(tmp_path: Path) -> None:
    """One place of four sheets, a quarter of the sum each; a line that turns back meets none."""
    corner = np.array([X, Y])
    ends = np.array([[0.3, 0.2], [-0.4, 0.1], [-0.2, -0.3], [0.1, -0.4]]) + corner
    far = np.array([[80.0, 80.0], [-80.0, 80.0], [-80.0, -80.0], [80.0, -80.0]]) + corner
    paths = [sheet(tmp_path / f"{k}.gpkg", [np.vstack([ends[k], far[k]])]) for k in range(4)]
    made = match_vector_edges(paths, tmp_path / "j.gpkg", tolerance=1.5)
    assert made.places == 1
    starts = np.array([line.coords[0] for line in made.read("lines").geometry])
    assert np.abs(starts - ends.mean(axis=0)).max() < 1e-8
    back = sheet(tmp_path / "back.gpkg", [np.vstack([ends[2], far[0] + 3.0])])
    none = match_vector_edges([paths[0], back], tmp_path / "n.gpkg", tolerance=1.5)
    assert none.places == 0
    assert "the nearest line turns back" in set(none.read("edge_unmatched").why)


def test_a_bend_meets_its_places_and_ends_at_its_reach() -> None:
    rng = np.random.default_rng(0)
    places, given = rng.uniform(0, 1000, (60, 2)), rng.normal(0, 1, (60, 2))
    bend = Bend.through(places, given, 80.0)
    assert np.abs(bend.at(places) - given).max() < 1e-9
    assert not bend.at(np.array([[-100.0, -100.0]])).any()
    assert not Bend.through(np.empty((0, 2)), np.empty((0, 2)), 80.0).at(places).any()


def test_a_correction_that_is_too_steep_is_told(tmp_path: Path) -> None:
    """Two sheets overlap by 24 m; a correction of 12 m that ends after 9 m would turn the line back."""
    up = np.column_stack([np.full(60, X), Y - 12.0 + np.arange(60.0)])
    a, b = sheet(tmp_path / "a.gpkg", [up]), sheet(tmp_path / "b.gpkg", [(up * (1, -1) + np.array([0, 2 * Y]))[::-1]])
    with pytest.warns(GeomosaicWarning, match="turned back: give a larger `reach`"):
        match_vector_edges([a, b], tmp_path / "j.gpkg", tolerance=30.0, reach=9.0)


def test_the_command_joins_sheets_and_refuses_what_cannot_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b, _, _ = two_sheets(tmp_path)
    out = str(tmp_path / "j.gpkg")
    assert run(["edgematch", str(a), str(b), "--tolerance", "2", "--same", "kind", "-o", out]) == 0
    said = capsys.readouterr().out
    assert "ends meet at 11 places" in said
    assert "met none: 0; attributes that differ: 0" in said
    weights = ["--sigma", "0", "--sigma", "1"]
    assert run(["edgematch", str(a), str(b), "--tolerance", "2", *weights, "-o", out, "--overwrite"]) == 0
    assert "moved at most: north.gpkg 0, south.gpkg 1.02" in capsys.readouterr().out
    assert run(["edgematch", str(a), "--tolerance", "2", "-o", out, "--overwrite"]) == 1
    assert "between two sheets or more" in capsys.readouterr().err
    with pytest.raises(InputError, match="there is no column 'class'"):
        match_vector_edges([a, b], tmp_path / "k.gpkg", tolerance=2.0, same=("class",))
    with pytest.raises(InputError, match="1 standard deviation for 2 sheets"):
        match_vector_edges([a, b], tmp_path / "k.gpkg", tolerance=2.0, sigma=(1.0,))
    with pytest.raises(InputError, match="the sheet is given twice"):
        match_vector_edges([a, b, a], tmp_path / "k.gpkg", tolerance=2.0)
    assert not (tmp_path / "k.gpkg").exists()


def test_sheets_of_one_name_are_told_apart_by_their_folders(tmp_path: Path) -> None:
    for number, folder in enumerate(("north", "south")):
        (tmp_path / folder).mkdir()
        ends = np.array([[X, Y + 0.4 * number], [X, Y + 50.0 - 100.0 * number]])
        sheet(tmp_path / folder / "roads.gpkg", [ends])
    paths = [tmp_path / folder / "roads.gpkg" for folder in ("north", "south")]
    made = match_vector_edges(paths, tmp_path / "j.gpkg", tolerance=1.0)
    assert made.sheets == ("north/roads.gpkg", "south/roads.gpkg")
    assert set(made.read("lines").sheet) == set(made.sheets)
