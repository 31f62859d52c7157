"""Vectors through control: what was drawn over an image, and drawings in coordinates of their own, on the map."""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import shapely
from test_70_georeference import CRS, HEIGHT, LEFT, PLAIN, TOP, affine_map, image, places, projective_map, table

from geomosaic.cli.main import run
from geomosaic.errors import InputError
from geomosaic.geo.densify import transformed
from geomosaic.georeferencing.drawing import georeference_vectors
from geomosaic.georeferencing.run import georeference

# A plan in millimetres of paper, y upwards, its lower left corner anywhere.
PLAN = shapely.MultiPolygon([shapely.box(-40.0, 15.0, 300.0, 215.0) - shapely.box(50.0, 60.0, 90.0, 120.0)])


def plan_map(xy: np.ndarray) -> np.ndarray:
    """1:2000, turned by 12 degrees, the paper shrunk by 0.4 % across."""
    x, y = xy[:, 0] * 2.0 * 0.996, xy[:, 1] * 2.0
    c, s = math.cos(math.radians(12.0)), math.sin(math.radians(12.0))
    return np.column_stack([LEFT + c * x - s * y, TOP + s * x + c * y])


def plan_control(path: Path, header: str = "id,x,y,drawing_x,drawing_y") -> Path:
    at = np.array([[-40, 15], [300, 15], [300, 215], [-40, 215], [120, 90], [210, 160.0]])
    pairs = zip(at.tolist(), plan_map(at).tolist(), strict=True)
    rows = [",".join(map(repr, [k, *xy, *ab])) for k, (ab, xy) in enumerate(pairs)]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def write(path: Path, geometries: list[object], **columns: object) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # there is no CRS, on purpose
        gpd.GeoDataFrame(columns, geometry=geometries).to_file(path)
    return path


def test_a_cad_drawing_without_crs_lies_where_its_control_says(tmp_path: Path) -> None:
    """A DXF in millimetres: every vertex within a hundredth of a millimetre of the formula, on the ground."""
    lines = [shapely.LineString([(0.0, 20.0), (120.5, 80.25), (290.0, 200.0)]), shapely.Point(33.0, 44.0)]
    drawing = write(tmp_path / "plan.dxf", lines, Layer=["roads", "marks"])
    made = georeference_vectors(drawing, tmp_path / "plan.gpkg", plan_control(tmp_path / "c.csv"), crs=CRS)
    found = made.read()
    assert made.carried.layers == {"entities": 2}
    assert found.crs.to_epsg() == 32633
    assert list(found.Layer) == ["roads", "marks"]
    given = shapely.get_coordinates(lines)
    assert np.abs(shapely.get_coordinates(found.geometry) - plan_map(given)).max() < 1e-5
    assert made.solution.model in ("affine", "poly1")
    assert made.carried.added == 0
    facts = json.loads((tmp_path / "plan-control.json").read_text())
    assert facts["image"]["unit"] == 0.1
    assert facts["product"]["features"] == 2
    page = (tmp_path / "plan-control.html").read_text()
    assert "a pixel stands for 0.1 of its units" in page
    assert "vertices put in" in page


def test_qgis_points_of_a_vector_layer_place_it(tmp_path: Path) -> None:
    """QGIS writes sourceX and sourceY of vectors in their own coordinates; areas keep their holes."""
    control = plan_control(tmp_path / "c.points", "id,mapX,mapY,sourceX,sourceY")
    rows = [line.split(",")[1:] for line in control.read_text().splitlines()]
    control.write_text("\n".join(",".join(row) + (",enable" if k == 0 else ",1") for k, row in enumerate(rows)) + "\n")
    drawing = write(tmp_path / "plan.geojson", [PLAN], name=["court"])
    made = georeference_vectors(
        drawing, tmp_path / "out.geojson", control, crs=CRS, model="affine", dst_crs="EPSG:32634", report=False
    )
    assert made.report is None
    assert made.read().crs.to_epsg() == 32634
    back = made.read().to_crs(CRS).geometry[0]
    expected = shapely.transform(PLAN, plan_map)
    assert len(back.geoms[0].interiors) == 1
    assert shapely.hausdorff_distance(back, expected) < 1e-2  # GeoJSON keeps so many digits


def bend(xy: np.ndarray) -> np.ndarray:
    """Columns and rows of map places: a polynomial of order 2, some pixels off a plane."""
    x, y = ((xy - (LEFT + 900, TOP - 900)) / 500.0).T
    return np.column_stack([240 + 220 * x + 9 * x * y + 6 * y**2, 180 - 220 * y + 8 * x**2 - 5 * x * y])


def test_lines_drawn_over_a_bent_image_follow_the_fit(tmp_path: Path) -> None:
    """A straight line of the image is a curve of the map: everywhere within 0.1 px, by the formula itself."""
    grid = np.stack(np.meshgrid(np.linspace(-500, 500, 6), np.linspace(-380, 380, 5)), axis=-1).reshape(-1, 2)
    xy = grid + np.array([LEFT + 900, TOP - 900])
    control = table(tmp_path / "gcps.csv", bend(xy), xy)
    straight = shapely.LineString([(20.0, -30.0), (440.0, -300.0)])
    area = shapely.box(100.0, -250.0, 300.0, -80.0)
    traced = write(tmp_path / "traced.gpkg", [straight, area], kind=["road", "wood"])
    made = georeference(
        image(tmp_path / "scan.tif", affine_map), tmp_path / "map.tif", control, crs=CRS, model="poly2",
        vectors=traced, render=PLAIN,
    )  # fmt: skip
    assert made.carried is not None
    assert made.carried.path == tmp_path / "map-vectors.gpkg"
    assert made.carried.added > 4
    assert made.facts["vectors"]["features"] == 2
    found = made.carried.read()
    assert list(found.kind) == ["road", "wood"]
    for drawn, line in zip((straight, area.exterior), (found.geometry[0], found.geometry[1].exterior), strict=True):
        seen = bend(shapely.get_coordinates(shapely.segmentize(line, 0.5))) * (1.0, -1.0)
        off = shapely.distance(shapely.points(seen), drawn)
        assert off.max() < 0.11  # map units of the tolerance are those in the middle of the image
        vertices = bend(shapely.get_coordinates(line)) * (1.0, -1.0)
        assert shapely.distance(shapely.points(vertices), drawn).max() < 1e-5
    # A line that the fit leaves straight gets no vertex.
    flat = georeference(
        image(tmp_path / "flat.tif", projective_map), tmp_path / "flat-map.tif",
        table(tmp_path / "flat.csv", places(), projective_map(places())), crs=CRS, model="projective",
        vectors=traced, render=PLAIN, report=False,
    )  # fmt: skip
    assert flat.carried is not None
    assert flat.carried.added == 0


def test_rows_of_the_vectors_are_counted_as_they_say(tmp_path: Path) -> None:
    scan, control = image(tmp_path / "a.tif", affine_map), table(tmp_path / "g.csv", places(), affine_map(places()))
    down = write(tmp_path / "down.geojson", [shapely.LineString([(20.0, 30.0), (100.0, 300.0)])])
    up = write(tmp_path / "up.geojson", [shapely.LineString([(20.0, HEIGHT - 30.0), (100.0, HEIGHT - 300.0)])])
    found = []
    for rows, path in (("down", down), ("up", up)):
        made = georeference(
            scan, tmp_path / f"{rows}.tif", control, crs=CRS, model="affine", vectors=path, vector_rows=rows,
            render=PLAIN, report=False,
        )  # fmt: skip
        assert made.carried is not None
        found.append(shapely.get_coordinates(made.carried.read().geometry))
    truth = affine_map(np.array([[20.0, 30.0], [100.0, 300.0]]))
    assert np.abs(np.array(found) - truth).max() < 1e-5
    with pytest.raises(InputError, match="does not say how they count rows"):
        georeference(scan, tmp_path / "x.tif", control, crs=CRS, vectors=down, render=PLAIN)
    with pytest.raises(InputError, match="lie beside the image of 480 x 360"):
        georeference(scan, tmp_path / "x.tif", control, crs=CRS, vectors=down, vector_rows="negative", render=PLAIN)
    assert not (tmp_path / "x.tif").exists()


def test_a_transformation_that_is_blind_at_the_middle_is_followed_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """An inflection in the middle of a segment lies on the chord there; z and empty parts stay."""

    def wave(xy: np.ndarray) -> np.ndarray:
        return np.column_stack([xy[:, 0], xy[:, 1] + np.sin(2 * np.pi * xy[:, 0])])

    line = shapely.LineString([(0, 0, 5), (1, 0, 7)])
    (made, empty, lost), added = transformed([line, shapely.Point(), shapely.Point(math.nan, 0)], wave, 0.001)
    assert added > 10
    assert empty.is_empty
    assert lost is None
    at = np.linspace(0, 1, 500)
    curve = shapely.LineString(wave(np.column_stack([at, 0 * at])))
    assert shapely.hausdorff_distance(made, curve, densify=0.01) < 0.0015
    heights = shapely.get_coordinates(made, include_z=True)
    assert np.allclose(heights[:, 2], 5 + 2 * heights[:, 0])
    monkeypatch.setattr("geomosaic.geo.densify.MOST", 8)
    with pytest.raises(InputError, match="more than 8 vertices"):
        transformed([line], wave, 0.001)


def test_the_command_tells_an_image_from_a_drawing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drawing = write(tmp_path / "plan.dxf", [shapely.LineString([(0, 20), (290, 200)])], Layer=["roads"])
    words = ["--gcps", str(plan_control(tmp_path / "c.csv")), "--crs", CRS]
    assert run(["georeference", str(drawing), *words, "-o", str(tmp_path / "plan.gpkg")]) == 0
    said = capsys.readouterr().out
    assert "a pixel stands for 0.1 of the drawing's units" in said
    assert "entities: 1 feature" in said
    assert run(["georeference", str(drawing), *words, "--res", "1", "-o", str(tmp_path / "b.gpkg")]) == 1
    assert "a drawing has no pixels: --res would do nothing" in capsys.readouterr().err
    assert run(["georeference", str(drawing), "-o", str(tmp_path / "b.gpkg")]) == 1
    assert "drawing_x,drawing_y" in capsys.readouterr().err
    assert run(["georeference", str(drawing), *words, "-o", str(tmp_path / "b.tif")]) == 1
    assert "no format of vectors" in capsys.readouterr().err


def test_control_of_another_drawing_is_refused(tmp_path: Path) -> None:
    drawing = write(tmp_path / "plan.gpkg", [shapely.LineString([(5000, 20), (5290, 200)])], name=["a"])
    with pytest.raises(InputError, match="the control lies beside the drawing: x from -40 to 300"):
        georeference_vectors(drawing, tmp_path / "out.gpkg", plan_control(tmp_path / "c.csv"), crs=CRS)
