"""From declarations to models: reconstructions, the ground that a sensor is told, and what errors are about."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from helpers import PinholeOverMap, forget_sensors
from pyproj import CRS, Transformer

from geomosaic.block import OrientedImage
from geomosaic.cli.main import run
from geomosaic.errors import GeomosaicWarning, HeightDatumError, InputError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.exterior_orientation import RECONSTRUCTIONS
from geomosaic.inputs.ground import height_below
from geomosaic.inputs.images import with_usable
from geomosaic.options.inputs import ANGLE_SYSTEMS
from geomosaic.project.drafts import draft_project
from geomosaic.project.photo_block import EmbeddedInputs
from geomosaic.sensor import registry
from geomosaic.surface.model import Plane, undulation

UTM = "EPSG:32633"
CAMERA = {"projection_type": "brown", "width": 1200, "height": 900, "focal_x": 1.25, "focal_y": 1.25, "k1": -0.1}
LLA = {"longitude": 13.62, "latitude": 49.64, "altitude": 480.0}


def inputs(sample: Path, **more: Any) -> Block:
    """One photo of the sample."""
    given: dict[str, Any] = {
        "images": (sample / "photos" / "strip1_02.jpg",),
        "sensor": "frame",
        "camera": sample / "camera.toml",
        "exterior": sample / "exterior.csv",
        "crs": UTM,
        "heights": "egm96",
        "dem": sample / "dem.tif",
    }
    return Block(**(given | more))


def reconstruction(folder: Path, name: str = "reconstruction.json") -> Path:
    """One photo that looks straight down, 30 m west, 40 m north of the reference and 600 m above it."""
    shot = {"rotation": [math.pi, 0.0, 0.0], "translation": [30.0, 40.0, 600.0], "camera": "one"}
    content = [{"cameras": {"one": CAMERA}, "shots": {"strip1_02.jpg": shot}, "reference_lla": LLA}]
    (folder / name).write_text(json.dumps(content))
    return folder / name


def in_map(model: Any) -> np.ndarray:
    """The seed of a model in the map, heights above the ellipsoid."""
    crs = with_heights(parse_crs(UTM), "ellipsoidal")
    return Transform(model.crs, crs)(np.array([model.seed]))[0]


# Reconstructions


def test_a_reconstruction_of_opendronemap_is_in_map_axes(sample: Path, tmp_path: Path) -> None:
    """The same photo by a table: the reference brought to the map by PROJ, and the offset added there."""
    file = reconstruction(tmp_path)
    given = inputs(sample, camera=None, exterior=file, heights="ellipsoidal", angles="odm", dem=None, height=480.0)
    x, y = Transformer.from_crs(4326, 32633, always_xy=True).transform(LLA["longitude"], LLA["latitude"])
    table = tmp_path / "exterior.csv"
    table.write_text(f"image,x,y,z,omega,phi,kappa\nstrip1_02.jpg,{x - 30!r},{y + 40!r},1080,0,0,0\n")
    lens = {"size": [1200, 900], "focal_length_px": 1500, "distortion": {"model": "brown", "k1": -0.1}}
    by_table = replace(given, exterior=table, angles="opk", options={"camera": lens}, angle_unit="deg")
    one, other = (build_block(each).scenes[0].model for each in (given, by_table))
    rays = np.array([[0.5, 0.5], [600.0, 450.0], [1100.0, 30.0]])
    assert np.allclose(one.rays(rays)[0], other.rays(rays)[0], atol=1e-6)
    assert np.allclose(one.rays(rays)[1], other.rays(rays)[1], atol=1e-12)
    # As OpenSfM's own it counts from true north: 0.76° off here.
    turned = build_block(replace(given, angles="opensfm")).scenes[0].model
    ground = Transform(by_crs(), one.crs)(np.array([[x - 30.0, y + 240.0, 480.0]]))
    away = np.linalg.norm(one.ground_to_image(ground) - turned.ground_to_image(ground))
    assert away > 4.0


def by_crs() -> CRS:
    return with_heights(parse_crs(UTM), "ellipsoidal")


def test_odm_on_the_command_line_and_in_a_project(sample: Path, tmp_path: Path, capsys: Any) -> None:
    file, image = reconstruction(tmp_path), str(sample / "photos" / "strip1_02.jpg")
    ground = ["--height", "480", "--res", "4"]
    words = ["--sensor", "frame", "--exterior", str(file), "--angles", "odm"]
    framed = ["--exterior-crs", UTM, "--heights", "ellipsoidal"]
    assert run(["ortho", image, *words, *framed, *ground, "-o", str(tmp_path / "a.tif")]) == 0
    capsys.readouterr()
    assert run(["ortho", image, *words, *ground, "-o", str(tmp_path / "b.tif")]) == 1
    assert "--exterior-crs" in capsys.readouterr().err
    bare = ["--exterior-crs", UTM, "--dem", str(sample / "dem.tif")]
    assert run(["ortho", image, *words, *bare, "-o", str(tmp_path / "b.tif")]) == 1
    said = capsys.readouterr().err
    assert "no vertical datum" in said
    assert "--heights" in said

    project = tmp_path / "odm.toml"
    assert run(["new", str(project), image, *words, *framed, *ground[:2]]) == 0
    out = capsys.readouterr().out
    assert "needs" not in out
    assert 'angles = "odm"' in project.read_text()
    project.write_text(project.read_text().replace("# resolution = 0.5 ", "resolution = 4 "))
    assert run(["run", str(project)]) == 0
    with rasterio.open(tmp_path / "a.tif") as a, rasterio.open(tmp_path / "output" / "odm.tif") as b:
        assert a.shape == b.shape
        assert (a.read() == b.read()).mean() > 0.999


def test_a_draft_tells_reconstructions_apart(sample: Path, tmp_path: Path) -> None:
    """OpenDroneMap leaves OpenSfM's own beside the one that it has brought to its map."""
    given = inputs(sample, camera=None, exterior=reconstruction(tmp_path), crs=None, heights=None)
    draft = draft_project(tmp_path / "p.toml", EmbeddedInputs(given), None)
    assert '\n# angles = "odm"    # NEEDED: opensfm (' in draft.text
    assert "camera" not in draft.text
    assert [text.split(":")[0] for text in draft.needed] == ["the angle system of the reconstruction"]
    assert not any("angle system" in line for line in draft.recognised)
    framed = replace(given, crs=UTM, heights="ellipsoidal")
    assert any(
        "NEEDED" in line for line in draft_project(tmp_path / "p.toml", EmbeddedInputs(framed), None).text.splitlines()
    )
    with pytest.raises(InputError, match="angle system is not declared") as caught:
        build_block(framed)
    assert "opensfm" in str(caught.value.hint)
    assert not draft_project(tmp_path / "p.toml", EmbeddedInputs(replace(given, angles="opensfm")), "opensfm").needed
    own = reconstruction(tmp_path, "reconstruction.topocentric.json")
    draft = draft_project(tmp_path / "p.toml", EmbeddedInputs(given), None)
    assert 'angles = "odm"' in draft.text
    assert [text.split(":")[0] for text in draft.needed] == [
        "the CRS of the positions",
        "the vertical datum of the positions",
    ]
    assert (
        'angles = "opensfm"'
        in draft_project(tmp_path / "p.toml", EmbeddedInputs(replace(given, exterior=own)), None).text
    )


def test_help_lists_every_angle_system(capsys: Any) -> None:
    assert set(RECONSTRUCTIONS) <= set(ANGLE_SYSTEMS)
    assert run(["ortho", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert f"One of {', '.join(ANGLE_SYSTEMS)}." in text


# The ground


@pytest.mark.parametrize("declared", [True, False])
def test_what_undeclared_positions_cost_is_counted_above_the_dem(sample: Path, tmp_path: Path, declared: bool) -> None:
    x, y, z = 399821.031, 5500398.696, 1492.685
    dem = sample / "dem.tif"
    if not declared:
        dem = tmp_path / "bare.tif"
        with (
            rasterio.open(sample / "dem.tif") as source,
            rasterio.open(dem, "w", **(source.profile | {"crs": UTM})) as target,
        ):
            target.write(source.read())
    with rasterio.open(dem) as source:
        ground = float(next(source.sample([(x, y)]))[0])
    assert ground > 300.0  # or the test could not tell it from 0
    with pytest.raises(HeightDatumError) as caught:
        build_block(inputs(sample, heights=None, dem=dem))
    pixels = abs(undulation(parse_crs(UTM), x, y)) * math.hypot(1200, 900) / 2 / (z - ground)
    said = float(caught.value.what.split("(up to ")[1].split(" px")[0])
    assert said == pytest.approx(pixels, rel=0.01)
    assert said != pytest.approx(pixels * (z - ground) / z, rel=0.1)


def test_a_sensor_gets_the_height_of_the_ground(sample: Path) -> None:
    """Seed on the DEM, and steps of one pixel there; what the user says comes first."""
    told = build_block(inputs(sample))
    surface, model = told.surface, told.scenes[0].model
    assert surface is not None
    seed = Transform(model.crs, surface.crs)(np.array([model.seed]))
    assert seed[0, 2] == pytest.approx(surface.height(seed[:, :2])[0], abs=60.0)
    flown = 1492.685 - seed[0, 2]
    assert model.parameters.steps[0] == pytest.approx(flown / (45.2 / 36 * 1200), rel=0.01)
    own = build_block(inputs(sample, options={"ground_height": 0.0})).scenes[0].model
    low = Transform(own.crs, surface.crs)(np.array([own.seed]))
    assert low[0, 2] == pytest.approx(0.0, abs=0.1)
    # One height, and a camera whose place only the reconstruction knows.
    flat = build_block(inputs(sample, dem=None, height=700.0)).scenes[0].model
    assert Transform(flat.crs, surface.crs)(np.array([flat.seed]))[0, 2] == pytest.approx(700.0, abs=0.1)


def test_a_sensor_with_a_position_of_its_own_gets_the_height_of_the_ground(sample: Path, tmp_path: Path) -> None:
    given = inputs(
        sample,
        camera=None,
        exterior=reconstruction(tmp_path),
        heights="ellipsoidal",
        angles="odm",
        dem=None,
        height=480,
    )
    assert in_map(build_block(given).scenes[0].model)[2] == pytest.approx(480.0, abs=0.1)
    # A ground above the camera is none the sensor could use: it goes on with its own guess.
    assert in_map(build_block(replace(given, height=1500.0)).scenes[0].model)[2] < 1080.0


def test_the_height_below_counts_as_positions_do() -> None:
    flat, place = parse_crs(UTM), (400_000.0, 5_500_000.0)
    egm, ellipsoid = with_heights(flat, "egm96"), with_heights(flat, "ellipsoidal")
    geoid = undulation(flat, *place)
    assert abs(geoid) > 20.0
    assert height_below(Plane(ellipsoid, 500.0), egm, (*place, 900.0)) == pytest.approx(500.0 - geoid, abs=0.01)
    degrees = Plane(with_heights(parse_crs("EPSG:4326"), "egm96"), 500.0)
    assert height_below(degrees, ellipsoid, (*place, 900.0)) == pytest.approx(500.0 + geoid, abs=0.01)
    assert height_below(Plane(ellipsoid, 500.0), ellipsoid, (*place, 400.0)) is None
    assert height_below(Plane(ellipsoid, 500.0), flat, (*place, 900.0)) is None
    earth = Transform(ellipsoid, CRS.from_epsg(4978))(np.array([[*place, 900.0]]))[0]
    assert height_below(Plane(egm, 500.0), CRS.from_epsg(4978), earth.tolist()) == pytest.approx(
        500.0 + geoid, abs=0.01
    )


# What an error is about


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"options": {"treatmnet": "planar"}}, "treatmnet"),
        ({"options": {"treatment": "plain"}}, "treatment = 'plain'"),
        ({"options": {"scale_correction": "yes"}}, "scale_correction"),
        ({"options": {"sigmas": {"east": -1.0}}}, "negative"),
        ({"options": {"ground_height": "low"}}, "ground_height"),
        ({"options": {"camera": "none.toml"}, "camera": None}, "none.toml"),
        ({"camera": None}, "'camera' is missing"),
    ],
)
def test_errors_of_inputs_name_no_line_of_the_table(sample: Path, more: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        build_block(inputs(sample, **more))
    assert "strip1_02.jpg" in str(caught.value)
    assert "line" not in str(caught.value.where)


def test_errors_of_a_row_name_its_line(sample: Path, tmp_path: Path) -> None:
    table = tmp_path / "exterior.csv"
    rows = [line.split(",") for line in (sample / "exterior.csv").read_text().splitlines()]
    for row in rows[1:]:
        row[4] = str(float(row[4]) + 180.0)
    table.write_text("\n".join(map(",".join, rows)))
    with pytest.raises(InputError, match="sky") as caught:
        build_block(inputs(sample, exterior=table, options={"treatment": "rigorous"}, angle_unit="deg"))
    assert caught.value.where == f"strip1_02.jpg ({table}, line 3)"
    with pytest.raises(InputError, match="not above the ground") as caught:
        build_block(inputs(sample, options={"ground_height": 5000.0}))
    assert str(caught.value.where).endswith("exterior.csv, line 3)")


# Sensors of others


def test_a_sensor_without_angles_takes_the_positions_of_the_table(
    sample: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sensor that the docs show refuses what it does not know, and is given only what it has."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent / "sample_plugin"))
    entry = EntryPoint("vertical", "geomosaic_sample_vertical:plugin", registry.GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda **_: [entry])
    forget_sensors()
    try:
        given = inputs(sample, sensor="vertical", camera=None, options={"focal_length_px": 1500.0})
        model = build_block(given).scenes[0].model
        assert model.parameters.values.tolist() == [399821.031, 5500398.696, 1492.685]
        with pytest.raises(InputError, match="no input 'focal'") as caught:
            build_block(replace(given, options={"focal_length_px": 1500.0, "focal": 1}))
        assert caught.value.where == "strip1_02.jpg"
    finally:
        forget_sensors()


def test_a_table_that_a_sensor_cannot_use_is_no_secret(sample: Path) -> None:
    with pytest.raises(InputError, match="no input 'position'"):
        build_block(inputs(sample, sensor="planar", camera=None, options={"transform": [1, 0, 4e5, 0, -1, 55e5]}))


def test_film_of_which_nothing_is_left_out_is_reported() -> None:
    scene = OrientedImage("film.tif", "film.tif", "frame", PinholeOverMap())
    film = Block((Path("film.tif"),), "frame", fiducials=Path("marks.csv"))
    with pytest.warns(GeomosaicWarning, match=r"borders of the film would appear in the output \(film.tif\)"):
        assert with_usable(film, [scene])[0].usable is None
    assert with_usable(replace(film, margin=(5, 5, 5, 9)), [scene])[0].usable is not None
    assert with_usable(replace(film, fiducials=None), [scene])[0].usable is None
