"""Georeferencing by control: maps whose texture is a formula, drawn through transformations that are known."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from PIL import Image
from rasterio.control import GroundControlPoint
from rasterio.warp import Resampling, reproject

from geomosaic.accuracy.product_check import against_reference
from geomosaic.errors import InputError, OutputExistsError
from geomosaic.geo.crs import parse_crs
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import metres_per_unit
from geomosaic.georeferencing.fit_diagnostics import BadControlError
from geomosaic.georeferencing.run import Georeferenced, georeference
from geomosaic.options.control import ControlOptions, FitOptions
from geomosaic.options.inputs import Area
from geomosaic.options.render import RenderOptions
from geomosaic.raster.vector import read_layer
from geomosaic.sensor.corrected import model_from_dict

CRS = "EPSG:32633"
LEFT, TOP, RES = 611_000.0, 5_412_000.0, 2.0
WIDTH, HEIGHT = 480, 360
PLAIN = RenderOptions(threads=2, driver="GTiff", overwrite=True)
Map = Callable[[np.ndarray], np.ndarray]


def texture(xy: np.ndarray) -> np.ndarray:
    """Grey values 0..255 (N, 2) of map places: waves of 34 to 230 m."""
    x, y = (xy - (LEFT, TOP)).T
    waves = [np.sin(x / a + b) * np.cos(y / c) for a, b, c in ((11.0, 0.3, 17.0), (23.0, 1.7, 13.0), (37.0, 0.9, 41.0))]
    return np.clip(np.column_stack([120 + 30 * sum(waves), 110 + 25 * waves[0] + 20 * waves[2]]), 0, 255)


def affine_map(colrow: np.ndarray) -> np.ndarray:
    """Turned by 17°, 2 m pixels, a little oblique; image → map."""
    c, r = ((colrow - (WIDTH / 2, HEIGHT / 2)) * RES).T
    return np.column_stack([LEFT + 900 + 0.95 * c + 0.30 * r, TOP - 900 + 0.28 * c - 0.96 * r])


def conformal_map(colrow: np.ndarray) -> np.ndarray:
    c, r = ((colrow - (WIDTH / 2, HEIGHT / 2)) * RES).T
    return np.column_stack([LEFT + 900 + 0.95 * c + 0.30 * r, TOP - 900 + 0.30 * c - 0.95 * r])


def projective_map(colrow: np.ndarray) -> np.ndarray:
    c, r = ((colrow - (WIDTH / 2, HEIGHT / 2)) * RES).T
    w = 1 + 2.0e-4 * c - 3.5e-4 * r
    return np.column_stack([LEFT + 900 + (0.95 * c + 0.30 * r) / w, TOP - 900 + (0.28 * c - 0.96 * r) / w])


def bent_map(colrow: np.ndarray) -> np.ndarray:
    """Affine with a bend of some pixels, as a paper map has."""
    xy = affine_map(colrow)
    c, r = (colrow / (WIDTH, HEIGHT)).T
    return xy + RES * np.column_stack([6 * c * r + 4 * r**2, 5 * c**2 - 3 * c])


def image(path: Path, to_map: Map, **profile: object) -> Path:
    """The picture that shows `texture` through a transformation."""
    c, r = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    values = texture(to_map(np.column_stack([c.ravel(), r.ravel()]))).reshape(HEIGHT, WIDTH, 2)
    kind = {"driver": "GTiff", "dtype": "float32", "count": 2, "width": WIDTH, "height": HEIGHT, **profile}
    with rasterio.open(path, "w", **kind) as file:
        file.write(np.moveaxis(values, -1, 0).astype(np.float32))
    return path


def truth(path: Path, like: Path) -> Path:
    """`texture` itself on the grid of a product."""
    with rasterio.open(like) as file:
        t, size = file.transform, (file.height, file.width)
        profile = {"transform": t, "crs": file.crs, "height": size[0], "width": size[1]}
    c, r = np.meshgrid(np.arange(size[1]) + 0.5, np.arange(size[0]) + 0.5)
    values = texture(np.column_stack([t.c + t.a * c.ravel(), t.f + t.e * r.ravel()]))
    with rasterio.open(path, "w", driver="GTiff", dtype="float32", count=2, **profile) as file:
        file.write(np.moveaxis(values.reshape(*size, 2), -1, 0).astype(np.float32))
    return path


def places(across: int = 4, down: int = 3) -> np.ndarray:
    """Control points all over the image, not in rows."""
    c, r = np.meshgrid(np.linspace(12, WIDTH - 12, across), np.linspace(9, HEIGHT - 9, down))
    shake = np.random.default_rng(3).uniform(-8, 8, (across * down, 2))
    return np.column_stack([c.ravel(), r.ravel()]) + shake


def table(path: Path, colrow: np.ndarray, xy: np.ndarray, roles: list[str] | None = None) -> Path:
    rows = [
        f"P{i},{x:.12f},{y:.12f},{c:.9f},{r:.9f},{'control' if roles is None else roles[i]}"
        for i, ((c, r), (x, y)) in enumerate(zip(colrow, xy, strict=True))
    ]
    path.write_text("\n".join(["id,x,y,col,row,role", *rows]) + "\n")
    return path


def run(folder: Path, to_map: Map, model: str, colrow: np.ndarray | None = None, **more: object) -> Georeferenced:
    points = places(6, 5) if colrow is None else colrow
    request = FitOptions(model, **{k: v for k, v in more.items() if k in ("threshold", "robust", "insist")})
    place = Area(**{k: v for k, v in more.items() if k in ("resolution", "bounds")} | {"dst_crs": more.get("dst")})
    return georeference(
        image(folder / "scan.tif", to_map),
        folder / "map.tif",
        source=ControlOptions(control=table(folder / "gcps.csv", points, to_map(points)), crs=CRS),
        fit=request,
        area=place,
        render=PLAIN,
    )


@pytest.mark.parametrize(
    ("to_map", "model"),
    [
        pytest.param(conformal_map, "conformal", marks=pytest.mark.slow),
        pytest.param(affine_map, "affine", marks=pytest.mark.slow),
        (projective_map, "projective"),
        (bent_map, "poly3"),
        (bent_map, "tps"),
    ],
)
def test_a_map_of_known_texture_lies_where_it_should(tmp_path, to_map, model):
    """The product against the formula on the same grid, by matching: within hundredths of a pixel."""
    made = run(tmp_path, to_map, model)
    assert made.product.valid_pixels > 100_000
    found = against_reference(tmp_path / "map.tif", truth(tmp_path / "truth.tif", tmp_path / "map.tif"), tile=48)
    assert found["matched"] == found["tiles"] > 40
    assert found["registration_rms_px"] < (0.03 if model == "tps" else 0.01)
    assert max(map(abs, found["shift_px"])) < 0.01


def test_auto_takes_what_the_image_is(tmp_path):
    points = places(6, 5) + np.random.default_rng(1).normal(0, 0.3, (30, 2))
    for to_map, wanted in (
        (conformal_map, "conformal"),
        (affine_map, "affine"),
        (projective_map, "projective"),
    ):
        made = georeference(
            image(tmp_path / "scan.tif", to_map),
            tmp_path / "map.tif",
            source=ControlOptions(control=table(tmp_path / "gcps.csv", points, to_map(places(6, 5))), crs=CRS),
            model="auto",
            render=PLAIN,
            report=False,
        )
        assert made.solution.model == wanted
        assert "left out of the fit" in made.facts["choice"]["why"]
        tried = {row["model"]: row for row in made.facts["choice"]["tried"]}
        assert set(tried) >= {"conformal", "affine", "projective", "poly2", "tps"}
        assert made.facts["accuracy"]["residuals"]["px"]["rms_total"] == pytest.approx(0.42, abs=0.1)
        assert made.report is None
        assert not list(tmp_path.glob("*-control*"))


@pytest.mark.parametrize(("model", "order", "tps"), [("affine", 1, False), ("poly2", 2, False), ("tps", 1, True)])
def test_the_same_picture_as_gdal(tmp_path, model, order, tps):
    """GDAL's warper, through the same points, onto the same grid."""
    made = run(tmp_path, bent_map, model, insist=True)
    with rasterio.open(tmp_path / "map.tif") as file:
        ours, seen = file.read(), file.dataset_mask() > 0
        crs, transform = file.crs, file.transform
    with rasterio.open(tmp_path / "scan.tif") as file:
        picture = file.read()
    colrow = places(6, 5)
    gcps = [GroundControlPoint(row=r, col=c, x=x, y=y) for (c, r), (x, y) in zip(colrow, bent_map(colrow), strict=True)]
    theirs = np.full_like(ours, np.nan)
    how = {"SRC_METHOD": "GCP_TPS"} if tps else {"SRC_METHOD": "GCP_POLYNOMIAL", "MAX_GCP_ORDER": str(order)}
    # rasterio lets GDAL interpolate the geometry along each line within 0.125 px: short lines, small errors.
    for first in range(0, theirs.shape[2], 20):
        part = np.full_like(theirs[:, :, first : first + 20], np.nan)
        reproject(
            picture,
            part,
            gcps=gcps,
            src_crs=crs,
            dst_crs=crs,
            dst_transform=transform @ Affine.translation(first, 0),
            dst_nodata=np.nan,
            resampling=Resampling.bilinear,
            XSCALE="1",  # no wider kernel where the output is a hair coarser
            YSCALE="1",
            **how,
        )
        theirs[:, :, first : first + 20] = part
    both = seen & np.isfinite(theirs).all(axis=0)
    assert both.sum() > 0.97 * max(seen.sum(), np.isfinite(theirs[0]).sum())
    away = np.abs(ours - theirs)[:, both]
    # A pixel is worth up to 8 grey values here: a shift of 0.05 px would make the median 0.15 at least.
    assert np.median(away) < 0.05
    assert np.percentile(away, 99.9) < 0.3
    assert made.product.lattice_error <= 0.02


def test_the_report_and_the_vectors_say_the_same(tmp_path):
    colrow = places(5, 4)
    measured = colrow + np.random.default_rng(5).normal(0, 0.4, colrow.shape)
    roles = ["check" if i % 4 == 1 else "control" for i in range(len(colrow))]
    made = georeference(
        image(tmp_path / "scan.tif", affine_map),
        tmp_path / "map.tif",
        source=ControlOptions(control=table(tmp_path / "gcps.csv", measured, affine_map(colrow), roles), crs=CRS),
        model="affine",
        render=PLAIN,
    )
    facts = json.loads((tmp_path / "map-control.json").read_text())
    assert facts == json.loads(json.dumps(made.facts))
    # Independent arithmetic: the textbook's equations by least squares on plain arrays.
    own = np.array([role == "control" for role in roles])
    xy = affine_map(colrow)
    design = np.column_stack([np.ones(len(xy)), xy - xy[own].mean(axis=0)])
    solved = np.linalg.lstsq(design[own], measured[own], rcond=None)[0]
    left = measured - design @ solved
    points = {point["id"]: point for point in facts["points"]}
    for i in range(len(colrow)):
        assert points[f"P{i}"]["residual_px"] == pytest.approx(left[i], abs=1e-6)
        # On the map: where the measured pixel lies, minus where the control has it.
        to_map = np.linalg.inv(solved[1:].T)
        assert points[f"P{i}"]["residual_m"] == pytest.approx(to_map @ left[i], abs=1e-6)
        assert points[f"P{i}"]["state"] == roles[i]
    hat = design[own] @ np.linalg.pinv(design[own])
    first = int(np.flatnonzero(own)[0])
    assert points[f"P{first}"]["redundancy_numbers"] == pytest.approx([1 - hat[0, 0]] * 2, abs=1e-6)
    assert points[f"P{first}"]["leave_one_out_px"] == pytest.approx(left[first] / (1 - hat[0, 0]), abs=1e-6)
    accuracy = facts["accuracy"]
    per_axis = np.sqrt((left[own] ** 2).mean(axis=0))
    assert accuracy["residuals"]["px"]["rms"] == pytest.approx(per_axis, abs=1e-6)
    assert accuracy["residuals"]["px"]["rms_total"] == pytest.approx(np.hypot(*per_axis), abs=1e-6)
    assert accuracy["residuals"]["px"]["circular_error_95"] == pytest.approx(
        2.5 * np.hypot(*per_axis) / np.sqrt(2), abs=1e-6
    )
    assert accuracy["redundancy"] == 2 * own.sum() - 6
    assert facts["check"]["check_points"] == 5
    assert "asks for 20 check points" in facts["check"]["nssda_statement"]
    assert facts["check"]["px"]["rms_total"] == pytest.approx(np.sqrt((left[~own] ** 2).sum(axis=1).mean()), abs=1e-6)
    model = model_from_dict(facts["fit"]["state"])
    assert model.ground_to_image(np.column_stack([xy, np.zeros(len(xy))])) == pytest.approx(design @ solved, abs=1e-6)
    vectors, spots = (read_layer(tmp_path / "map-control.gpkg", name) for name in ("residuals", "points"))
    assert len(vectors) == len(spots) == len(colrow)
    enlarged = vectors.enlarged[0]
    for _, row in vectors.iterrows():
        (x0, y0), (x1, y1) = row.geometry.coords
        assert ((x1 - x0) / enlarged, (y1 - y0) / enlarged) == pytest.approx(points[row.id]["residual_m"], abs=1e-5)
    page = (tmp_path / "map-control.html").read_text()
    assert page.count("<circle") == len(colrow)
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page


def test_the_control_report_names_options_as_the_command_line_does(tmp_path):
    """Backticks are for the library; a page says --without."""
    colrow = places(6, 4)
    measured = colrow + np.random.default_rng(3).normal(0, 0.1, colrow.shape)
    measured[7] += (40.0, 0.0)
    scan = image(tmp_path / "scan.tif", affine_map)
    given = ControlOptions(control=table(tmp_path / "gcps.csv", measured, affine_map(colrow)), crs="EPSG:32633")
    made = georeference(scan, tmp_path / "map.tif", source=given, model="affine", insist=True)
    assert any("`without=" in found.hint for found in made.solution.diagnostics)
    page = (tmp_path / "map-control.html").read_text()
    assert "--without P" in page
    assert "`" not in page.partition("<svg")[0]


def test_points_are_deleted_down_to_the_threshold_with_a_table(tmp_path):
    colrow = places(6, 4)
    xy = affine_map(colrow)
    measured = colrow + np.random.default_rng(2).normal(0, 0.2, colrow.shape)
    measured[[4, 17]] += [[3.0, -2.0], [0.0, 5.0]]
    given = ControlOptions(control=table(tmp_path / "gcps.csv", measured, xy), crs=CRS)
    scan = image(tmp_path / "scan.tif", affine_map)
    made = georeference(scan, tmp_path / "map.tif", source=given, model="affine", threshold=0.4, render=PLAIN)
    deletion = made.facts["deletion"]
    assert [row["id"] for row in deletion["deleted"]] == ["P17", "P4"]
    assert deletion["rms_all_px"] > deletion["deleted"][0]["rms_after_px"] > deletion["deleted"][1]["rms_after_px"]
    assert deletion["rms_left_px"] < 0.4
    assert deletion["reached"]
    assert [p["id"] for p in made.facts["points"] if p["state"] == "deleted"] == ["P4", "P17"]
    # Beside it the robust result: the same two, without a threshold.
    assert made.facts["robust"]["blunders"] == ["P4", "P17"]
    assert made.facts["robust"]["agree"]
    robust = georeference(scan, tmp_path / "map.tif", source=given, model="affine", robust=True, render=PLAIN)
    assert [p["id"] for p in robust.facts["points"] if p["state"] == "suspect"] == ["P4", "P17"]
    assert not robust.solution.diagnostics
    for name, value in robust.facts["accuracy"]["residuals"]["px"].items():
        assert value == pytest.approx(made.facts["accuracy"]["residuals"]["px"][name]), name


def test_blunders_stop_the_work_and_are_named(tmp_path):
    """One of twelve, and 30 % of twenty: nothing is drawn unless the user insists."""
    scan = image(tmp_path / "scan.tif", affine_map)
    for count, wrong in (((4, 3), [5]), ((5, 4), [0, 3, 7, 11, 14, 18])):
        colrow = places(*count)
        measured = colrow + np.random.default_rng(4).normal(0, 0.2, colrow.shape)
        measured[wrong] += np.random.default_rng(8).uniform(20, 90, (len(wrong), 2))
        given = ControlOptions(control=table(tmp_path / "gcps.csv", measured, affine_map(colrow)), crs=CRS)
        with pytest.raises(BadControlError) as stop:
            georeference(scan, tmp_path / "map.tif", source=given, model="affine", render=PLAIN)
        named = next(found.points for found in stop.value.diagnostics if found.code == "blunder")
        assert named == tuple(f"P{i}" for i in wrong)
        assert f"`without=P{wrong[0]}`" in (stop.value.hint or "")
        assert not (tmp_path / "map.tif").exists()
    insisted = georeference(scan, tmp_path / "map.tif", source=given, model="affine", insist=True, render=PLAIN)
    assert insisted.facts["accuracy"]["residuals"]["px"]["rms_total"] > 5
    without = ControlOptions(control=given.control, crs=CRS, without=tuple(f"P{i}" for i in wrong))
    clean = georeference(scan, tmp_path / "map.tif", source=without, model="affine", render=PLAIN)
    assert clean.facts["accuracy"]["residuals"]["px"]["rms_total"] < 0.4


def test_an_undetermined_fit_is_refused_even_when_insisted(tmp_path):
    scan = image(tmp_path / "scan.tif", affine_map)
    on_a_line = np.column_stack([np.linspace(10, 470, 6), np.linspace(20, 340, 6)])
    for colrow, model, code in ((on_a_line, "affine", "collinear"), (places()[:2], "affine", "few-points")):
        given = ControlOptions(control=table(tmp_path / "gcps.csv", colrow, affine_map(colrow)), crs=CRS)
        with pytest.raises(BadControlError, match=code):
            georeference(scan, tmp_path / "map.tif", source=given, model=model, render=PLAIN)
        with pytest.raises(BadControlError, match=code) as insisted:
            georeference(scan, tmp_path / "map.tif", source=given, model=model, insist=True, render=PLAIN)
        assert "`insist`" not in (insisted.value.hint or "")
        assert not (tmp_path / "map.tif").exists()
    # A conformal fit is determined by two points, and by a line of them.
    made = georeference(scan, tmp_path / "map.tif", source=given, model="conformal", render=PLAIN)
    assert made.product.valid_pixels > 0
    assert [found.code for found in made.solution.diagnostics] == ["no-redundancy"]


def test_a_fit_that_folds_the_image_is_not_drawn(tmp_path):
    """A polynomial of order 5 through points of the middle turns over towards the corners."""
    colrow = places(6, 5) * 0.3 + (WIDTH * 0.35, HEIGHT * 0.35)
    measured = colrow + np.random.default_rng(2).normal(0, 1.5, colrow.shape)
    given = ControlOptions(control=table(tmp_path / "gcps.csv", measured, affine_map(colrow)), crs=CRS)
    with pytest.raises(BadControlError, match="folded"):
        georeference(
            image(tmp_path / "scan.tif", affine_map),
            tmp_path / "map.tif",
            source=given,
            model="poly5",
            area=Area(bounds=(LEFT + 300, TOP - 1500, LEFT + 1500, TOP - 300), resolution=4.0),
            render=PLAIN,
        )


def test_control_and_output_in_other_crs(tmp_path):
    """Control in degrees: the fit is made in the projected CRS of the output, and the map lies right there."""
    colrow = places(6, 5)
    degrees = Transform(parse_crs(CRS), parse_crs("EPSG:4326"))(affine_map(colrow))
    scan = image(tmp_path / "scan.tif", affine_map)
    table(tmp_path / "gcps.csv", colrow, degrees)
    given = ControlOptions(control=tmp_path / "gcps.csv", crs="EPSG:4326")
    made = georeference(scan, tmp_path / "map.tif", source=given, model="affine", render=PLAIN)
    assert made.facts["fit"]["crs"].endswith("(EPSG:32633)")  # the UTM zone it lies in
    assert made.facts["accuracy"]["residuals"]["px"]["rms_total"] < 1e-4
    found = against_reference(tmp_path / "map.tif", truth(tmp_path / "truth.tif", tmp_path / "map.tif"), tile=48)
    assert found["registration_rms_px"] < 0.03
    # Drawn in a third CRS, fitted in that of the (projected) control; the content lies where it did.
    table(tmp_path / "gcps.csv", colrow, affine_map(colrow))
    given = ControlOptions(control=tmp_path / "gcps.csv", crs=CRS)
    other = georeference(
        scan,
        tmp_path / "map2.tif",
        source=given,
        model="affine",
        dst_crs="EPSG:3035",
        resolution=2.0,
        render=PLAIN,
    )
    assert other.facts["fit"]["crs"].endswith("(EPSG:32633)")
    assert other.facts["product"]["crs"].endswith("(EPSG:3035)")
    again = against_reference(tmp_path / "map2.tif", tmp_path / "truth.tif", tile=48)
    assert again["registration_rms_px"] < 0.05
    # And in degrees, where a conformal fit would not be one.
    flat = georeference(
        scan,
        tmp_path / "map3.tif",
        source=given,
        model="affine",
        dst_crs="EPSG:4326",
        render=PLAIN,
        report=False,
    )
    assert flat.product.grid.crs.is_geographic
    assert against_reference(tmp_path / "map3.tif", tmp_path / "truth.tif", tile=48)["registration_rms_px"] < 0.05


def test_metres_of_a_degree():
    """Against the geodesic on the ellipsoid."""
    from pyproj import Geod

    crs, place = parse_crs("EPSG:4326"), np.array([16.5, 48.8])
    geod = Geod(ellps="WGS84")
    east = geod.inv(16.5 - 5e-4, 48.8, 16.5 + 5e-4, 48.8)[2] * 1e3
    north = geod.inv(16.5, 48.8 - 5e-4, 16.5, 48.8 + 5e-4)[2] * 1e3
    assert metres_per_unit(crs, place) == pytest.approx([east, north], rel=1e-6)
    assert metres_per_unit(parse_crs("EPSG:2263"), place) == pytest.approx([0.3048006096] * 2)  # US survey feet


def test_points_in_the_tiff_and_a_world_file(tmp_path):
    colrow = places()
    gcps = [
        GroundControlPoint(row=r, col=c, x=x, y=y, id=f"T{i}")
        for i, ((c, r), (x, y)) in enumerate(zip(colrow, affine_map(colrow), strict=True))
    ]
    tagged = image(tmp_path / "tagged.tif", affine_map, gcps=gcps, crs=CRS)
    made = georeference(tagged, tmp_path / "a.tif", model="affine", render=PLAIN)
    assert (made.facts["control"]["format"], made.facts["control"]["control"]) == ("raster", 12)
    picture = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH), dtype=np.uint8)
    Image.fromarray(picture).save(tmp_path / "photo.png")
    with pytest.raises(InputError, match="no world file"):
        georeference(tmp_path / "photo.png", tmp_path / "b.tif", render=PLAIN)
    step = affine_map(np.array([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5]]))
    a, b = step[1] - step[0], step[2] - step[0]
    numbers = [a[0], a[1], b[0], b[1], *step[0]]
    (tmp_path / "photo.pgw").write_text("".join(f"{value:.12f}\n" for value in numbers))
    with pytest.raises(InputError, match="which CRS"):
        georeference(tmp_path / "photo.png", tmp_path / "b.tif", render=PLAIN)
    made = georeference(tmp_path / "photo.png", tmp_path / "b.tif", source=ControlOptions(crs=CRS), render=PLAIN)
    assert (made.solution.model, made.facts["control"]["format"]) == ("affine", "world")
    # The model is the file's own affine: where pixel (100.5, 50.5) lies says the formula.
    spot = np.array([[100.5, 50.5]])
    model = made.solution.fit.model
    assert model.ground_to_image(np.column_stack([affine_map(spot), [0.0]])) == pytest.approx(spot, abs=1e-6)


def test_the_same_bytes_for_any_number_of_threads_and_size_of_tiles(tmp_path):
    outputs = []
    for threads, tile in ((1, 1024), (3, 2048)):
        folder = tmp_path / str(threads)
        folder.mkdir()
        colrow = places(6, 5)
        scan = image(tmp_path / "scan.tif", bent_map)
        given = ControlOptions(control=table(tmp_path / "gcps.csv", colrow, bent_map(colrow)), crs=CRS)
        options = RenderOptions(threads=threads, tile=tile)
        georeference(scan, folder / "map.tif", source=given, model="tps", resolution=0.8, render=options)
        outputs.append([(folder / name).read_bytes() for name in ("map.tif", "map-control.gpkg")])
    assert outputs[0] == outputs[1]


def test_nothing_is_written_over(tmp_path):
    run(tmp_path, affine_map, "affine")
    kept = RenderOptions(driver="GTiff")
    given = ControlOptions(control=tmp_path / "gcps.csv", crs=CRS)
    with pytest.raises(OutputExistsError):
        georeference(tmp_path / "scan.tif", tmp_path / "map.tif", source=given, render=kept)
    (tmp_path / "map.tif").unlink()
    with pytest.raises(OutputExistsError, match="exists"):  # the report of an earlier run
        georeference(tmp_path / "scan.tif", tmp_path / "map.tif", source=given, render=kept)
    with pytest.raises(InputError, match="one of the inputs"):
        georeference(tmp_path / "scan.tif", tmp_path / "scan.tif", source=given, render=PLAIN)


def test_unseen_pixels_are_zero_and_masked_or_nodata(tmp_path):
    run(tmp_path, affine_map, "affine")
    with rasterio.open(tmp_path / "map.tif") as file:
        values, mask = file.read(), file.dataset_mask()
        assert file.nodata is None
    assert (mask == 0).any()
    assert (values[:, mask == 0] == 0).all()
    given = ControlOptions(control=tmp_path / "gcps.csv", crs=CRS)
    options = RenderOptions(driver="GTiff", nodata=-1.0, overwrite=True)
    georeference(tmp_path / "scan.tif", tmp_path / "map.tif", source=given, model="affine", render=options)
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.nodata == -1.0
        assert (file.read()[:, mask == 0] == -1.0).all()


def test_left_handed_and_right_handed_images(tmp_path):
    """A film scanned from its back: the ground is mirrored in the image, and comes out right all the same."""

    def mirrored(colrow: np.ndarray) -> np.ndarray:
        return conformal_map(np.column_stack([WIDTH - colrow[:, 0], colrow[:, 1]]))

    made = run(tmp_path, mirrored, "conformal")
    assert [found.code for found in made.solution.diagnostics] == ["mirrored-columns"]
    assert made.facts["fit"]["mirrored"]
    found = against_reference(tmp_path / "map.tif", truth(tmp_path / "truth.tif", tmp_path / "map.tif"), tile=48)
    assert found["registration_rms_px"] < 0.03


def test_grid_follows_the_image_unless_given(tmp_path):
    made = run(tmp_path, conformal_map, "conformal")
    assert made.product.grid.resolution[0] == pytest.approx(RES * np.hypot(0.95, 0.30), rel=0.05)
    assert made.product.grid.transform.c % made.product.grid.resolution[0] == pytest.approx(0, abs=1e-6)
    bounds = (LEFT + 700, TOP - 1000, LEFT + 900, TOP - 850)
    made = run(tmp_path, conformal_map, "conformal", bounds=bounds, resolution=2.5)
    assert made.product.grid.bounds == bounds
    assert made.product.grid.transform == Affine(2.5, 0, bounds[0], 0, -2.5, bounds[3])
