"""Output in a CRS that is made for elsewhere, and control that is insisted on: what is drawn, and what is refused."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio
from test_70_georeference import CRS, PLAIN, affine_map, image, places, table, texture

from geomosaic.accuracy.product_check import check
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import parse_crs
from geomosaic.geo.grid import Window
from geomosaic.geo.transform import Transform
from geomosaic.georeferencing.fit_diagnostics import BadControlError
from geomosaic.georeferencing.run import georeference
from geomosaic.options.control import ControlOptions, FitOptions


@pytest.mark.parametrize("crs", ["EPSG:2193", "EPSG:3031", "EPSG:32601"])
def test_a_far_output_crs_is_reported_and_drawn_rightly(tmp_path: Path, crs: str) -> None:
    """Every pixel shows the ground that PROJ says it lies on, however distorted the map is there."""
    colrow = places()
    given = ControlOptions(control=table(tmp_path / "gcps.csv", colrow, affine_map(colrow)), crs=CRS)
    scan = image(tmp_path / "scan.tif", affine_map)
    with pytest.warns(GeomosaicWarning, match="far outside the area"):
        made = georeference(
            scan,
            tmp_path / "map.tif",
            source=given,
            model="affine",
            dst_crs=crs,
            resolution=_pixel(crs),
            render=PLAIN,
        )
    with rasterio.open(tmp_path / "map.tif") as file:
        values, seen = file.read(), file.dataset_mask() > 0
    grid = made.product.grid
    assert grid.crs == parse_crs(crs)
    assert seen.sum() > 20_000
    r, c = np.nonzero(seen)
    there = Transform(grid.crs, parse_crs(CRS))(grid.xy(np.column_stack([c, r]) + 0.5))
    errors = values[:, r, c].T - texture(there)
    assert np.sqrt((errors**2).mean()) < 1.5  # of 255; half a pixel aside it is 6
    # Checked by points whose places are known in another CRS again.
    degrees = Transform(parse_crs(CRS), parse_crs("EPSG:4326"))
    inner = places(3, 3) * 0.8 + 20.0
    seen_at = grid.colrow(Transform(parse_crs(CRS), grid.crs)(affine_map(inner)))
    points = table(tmp_path / "check.csv", seen_at, degrees(affine_map(inner)))
    found = check(tmp_path / "map.tif", points, crs="EPSG:4326")
    assert found.pixel_rms_total < 1e-3


def test_the_output_takes_the_grid_of_another_raster(tmp_path: Path) -> None:
    colrow = places()
    given = ControlOptions(control=table(tmp_path / "gcps.csv", colrow, affine_map(colrow)), crs=CRS)
    scan, fit = image(tmp_path / "scan.tif", affine_map), FitOptions("affine")
    first = georeference(scan, tmp_path / "first.tif", source=given, fit=fit, resolution=8.0, render=PLAIN).product.grid
    part = first.crop(Window(first.width // 4, first.height // 4, first.width // 2, first.height // 2))
    made = georeference(scan, tmp_path / "map.tif", source=given, fit=fit, like=part, render=PLAIN)
    assert made.product.grid == part


def _pixel(crs: str) -> float:
    """About 4 m on the ground: polar stereographic of the other pole enlarges eightfold."""
    return 32.0 if crs == "EPSG:3031" else 4.0


def test_an_output_crs_without_a_place_for_the_image_is_refused(tmp_path: Path) -> None:
    colrow = places()
    given = ControlOptions(control=table(tmp_path / "gcps.csv", colrow, affine_map(colrow)), crs=CRS)
    scan = image(tmp_path / "scan.tif", affine_map)
    with pytest.raises(InputError, match="has no place in") as refused:
        georeference(scan, tmp_path / "map.tif", source=given, model="affine", dst_crs="EPSG:5070", render=PLAIN)
    assert refused.value.where == "`dst_crs`"
    assert not (tmp_path / "map.tif").exists()


def degrees_of(folder: Path, *, change: dict[int, tuple[float, float]]) -> Path:
    """Control in longitude and latitude, some points of it typed wrong."""
    colrow = places()
    xy = Transform(parse_crs(CRS), parse_crs("EPSG:4326"))(affine_map(colrow))
    for index, place in change.items():
        xy[index] = place
    return table(folder / "degrees.csv", colrow, xy)


def test_what_has_no_place_on_the_earth_is_refused_whoever_insists(tmp_path: Path) -> None:
    """Metres said to be degrees, and one latitude of 489: the finding is told, and no --insist is offered."""
    scan = image(tmp_path / "scan.tif", affine_map)
    metres = table(tmp_path / "gcps.csv", places(), affine_map(places()))
    typed = degrees_of(tmp_path, change={4: (16.5, 489.0)})
    drawn = _map(tmp_path)
    for path, code in ((metres, "metres-in-degrees"), (typed, "outside-crs-area")):
        for insist in (False, True):
            given = ControlOptions(control=path, crs="EPSG:4326")
            with pytest.raises(BadControlError, match=code) as refused:
                georeference(scan, tmp_path / "map.tif", source=given, model="affine", insist=insist, render=PLAIN)
            assert "`insist`" not in (refused.value.hint or "")
            with pytest.raises(InputError, match=code) as refused_check:
                check(drawn, path, crs="EPSG:4326", insist=insist)
            assert "`insist`" not in (refused_check.value.hint or "")
    # Left out as told, the others are drawn: the point has no place, and needs none.
    given = ControlOptions(control=typed, crs="EPSG:4326", without=("P4",))
    made = georeference(scan, tmp_path / "map.tif", source=given, model="affine", render=PLAIN)
    assert made.solution.fit.rms_total < 0.01
    assert "P4" not in made.solution.fit.ids


def _map(folder: Path) -> Path:
    """A georeferenced raster."""
    colrow = places()
    given = ControlOptions(control=table(folder / "good.csv", colrow, affine_map(colrow)), crs=CRS)
    scan = image(folder / "scan.tif", affine_map)
    georeference(scan, folder / "other.tif", source=given, model="affine", render=PLAIN, report=False)
    return folder / "other.tif"


def test_who_insists_passes_every_check_that_leaves_something_to_draw(tmp_path: Path) -> None:
    """Exchanged axes and a neighbouring zone: refused, and drawn when insisted, with the finding in the result."""
    scan = image(tmp_path / "scan.tif", affine_map)
    exchanged = table(tmp_path / "exchanged.csv", places(), affine_map(places())[:, ::-1])
    for path, crs, code in ((exchanged, CRS, "swapped-axes"), (_good(tmp_path), "EPSG:2193", "wrong-zone|outside")):
        given = ControlOptions(control=path, crs=crs)
        with pytest.raises(BadControlError, match=code) as refused:
            georeference(scan, tmp_path / "map.tif", source=given, model="auto", render=PLAIN)
        assert "`insist`" in (refused.value.hint or "")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GeomosaicWarning)
            made = georeference(scan, tmp_path / "map.tif", source=given, model="auto", insist=True, render=PLAIN)
        assert made.product.valid_pixels > 0
        assert made.solution.diagnostics[0].severity == "error"


def _good(folder: Path) -> Path:
    return table(folder / "gcps.csv", places(), affine_map(places()))


def test_check_points_of_a_map_are_judged_alone_and_a_wrong_one_is_named(tmp_path: Path) -> None:
    """Points of role 'check' count, control points of the same table do not; a wrong one is named with its shift."""
    raster = _map(tmp_path)
    with rasterio.open(raster) as file:
        transform = file.transform
    inner = places(4, 4) * 0.9 + 15.0
    xy = affine_map(inner)
    seen = np.array([~transform @ tuple(place) for place in xy])
    errors = np.random.default_rng(6).normal(0.0, 0.2, seen.shape)
    roles = ["check" if i % 2 else "control" for i in range(16)]
    errors[::2] += 9.0  # control: other points of the table, which must not count
    points = table(tmp_path / "check.csv", seen + errors, xy, roles)
    found = check(raster, points, crs=CRS)
    assert found.ids == tuple(f"P{i}" for i in range(1, 16, 2))
    assert found.pixel_rms == pytest.approx(np.sqrt((errors[1::2] ** 2).mean(axis=0)), abs=1e-6)
    assert any("8 control points left out" in note for note in found.notes)
    assert not found.diagnostics
    errors[5] = (12.0, -7.0)
    table(tmp_path / "check.csv", seen + errors, xy, roles)
    odd = check(raster, points, crs=CRS)
    assert [(finding.code, finding.points) for finding in odd.diagnostics] == [("check-point", ("P5",))]
    assert "1 of 8 check points is off" in odd.diagnostics[0].what
    without = check(raster, points, crs=CRS, without=("P5",))
    assert len(without.ids) == 7
    assert not without.diagnostics
