"""A SPOT scene through the command line: METADATA.DIM beside it, a DEM, and an ortho that shows the right pixels."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import Transformer
from spot_rig import SIZE, TO_LLH, Satellite, with_places

from geomosaic.cli.main import run
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block

TOLD = Satellite(attitude=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0))
BIASED = Satellite()
TO_MAP = Transformer.from_crs(4979, 32624, always_xy=True)


def pattern(col: np.ndarray, row: np.ndarray) -> np.ndarray:
    return 128.0 + 60.0 * np.sin(col / 9.0) + 60.0 * np.sin(row / 11.0)


def slope(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the ground: a tilted plane, 0 to 800 m over the scene."""
    return 400.0 + 0.008 * (x - X) - 0.003 * (y - Y)


LON, LAT, _ = TO_LLH.transform(*TOLD.ground(SIZE[0] / 2, SIZE[1] / 2, 400.0))
X, Y = TO_MAP.transform(LON, LAT)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene as it is delivered, and a DEM."""
    folder = tmp_path_factory.mktemp("scene")
    row, col = np.mgrid[0 : SIZE[1], 0 : SIZE[0]] + 0.5
    profile = {"driver": "GTiff", "count": 1}
    image = np.round(pattern(col, row)).astype(np.uint8)
    with rasterio.open(folder / "IMAGERY.TIF", "w", width=SIZE[0], height=SIZE[1], dtype="uint8", **profile) as file:
        file.write(image, 1)
    (folder / "METADATA.DIM").write_text(TOLD.dimap())
    step, count = 1500.0, 70
    place = Affine(step, 0.0, X - step * count / 2, 0.0, -step, Y + step * count / 2)
    c, r = np.meshgrid(np.arange(count) + 0.5, np.arange(count) + 0.5)
    heights = slope(place.c + step * c, place.f - step * r)
    with rasterio.open(
        folder / "dem.tif", "w", width=count, height=count, dtype="float64", crs=32624, transform=place, **profile
    ) as file:
        file.write(heights, 1)
    return folder


def seen(satellite: Satellite, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Image points near the middle and the map places on the slope that they show."""
    rng = np.random.default_rng(4)
    image = np.array(SIZE) / 2 + rng.uniform(-120, 120, (count, 2))
    places = []
    for col, row in image:
        height = 400.0
        for _ in range(8):
            x, y, _ = TO_MAP.transform(*TO_LLH.transform(*satellite.ground(col, row, height)))
            height = slope(x, y)
        places.append((x, y))
    return image, np.array(places)


def words(scene: Path, output: Path, *more: str) -> list[str]:
    area = [str(v) for v in (X - 4000, Y - 4000, X + 4000, Y + 4000)]
    ground = ["--dem", str(scene / "dem.tif"), "--dem-heights", "ellipsoidal"]
    place = ["--res", "10", "--bounds", *area, "-o", str(output)]
    return ["ortho", str(scene / "IMAGERY.TIF"), "--sensor", "pushbroom", *ground, *place, *more]


def worst(ortho: Path, image: np.ndarray, places: np.ndarray) -> float:
    """Largest difference of grey values, 6.7 of which are a pixel at the steepest."""
    with rasterio.open(ortho) as file:
        values = file.read(1).astype(float)
        col, row = (places.T - [[file.transform.c], [file.transform.f]]) / [[file.transform.a], [file.transform.e]]
    i, j = np.floor(row - 0.5).astype(int), np.floor(col - 0.5).astype(int)
    v, u = row - 0.5 - i, col - 0.5 - j
    found = (1 - v) * ((1 - u) * values[i, j] + u * values[i, j + 1])
    found += v * ((1 - u) * values[i + 1, j] + u * values[i + 1, j + 1])
    return float(np.abs(found - pattern(*image.T)).max())


def test_ortho_of_a_scene(scene: Path, tmp_path: Path) -> None:
    assert run(words(scene, tmp_path / "ortho.tif")) == 0
    assert worst(tmp_path / "ortho.tif", *seen(TOLD, 200)) < 1.5


def test_ortho_with_control_points(scene: Path, tmp_path: Path) -> None:
    """The attitude is off by 10 pixels; four points put it right. Heights and CRS are declared as for any control."""
    ground, image = BIASED.points(4, 800.0, 3, with_places(4))
    xyz = np.column_stack(TO_MAP.transform(*TO_LLH.transform(*ground.T)))
    rows = np.column_stack([xyz, image]).tolist()
    points = json.dumps([dict(zip(("x", "y", "z", "col", "row"), row, strict=True)) | {"sigma": 0.1} for row in rows])
    declared = ("--crs", "EPSG:32624", "--heights", "ellipsoidal")
    assert run(words(scene, tmp_path / "wrong.tif")) == 0
    assert run(words(scene, tmp_path / "right.tif", *declared, "--option", f"points={points}")) == 0
    assert worst(tmp_path / "wrong.tif", *seen(BIASED, 100)) > 30.0
    assert worst(tmp_path / "right.tif", *seen(BIASED, 100)) < 2.5


def test_control_of_a_project_refines_the_scene(scene: Path, tmp_path: Path) -> None:
    """Points of role control are passed to the sensor, check points are not; refine = none keeps them away."""
    ground, image = BIASED.points(4, 800.0, 3, with_places(4))
    xyz = np.column_stack(TO_MAP.transform(*TO_LLH.transform(*ground.T)))
    lines = ["id,x,y,z,image,col,row,role"]
    for i, (place, pixel) in enumerate(zip(xyz.tolist(), image.tolist(), strict=True)):
        lines.append(",".join(map(str, [i, *place, "IMAGERY.TIF", *pixel, "control"])))
    lines.append(",".join(map(str, ["far", *xyz[0], "IMAGERY.TIF", 5.0, 5.0, "check"])))
    (tmp_path / "gcps.csv").write_text("\n".join(lines))
    inputs = Block(
        (scene / "IMAGERY.TIF",), "pushbroom", crs="EPSG:32624", heights="ellipsoidal", dem=scene / "dem.tif",
        dem_heights="ellipsoidal", control=tmp_path / "gcps.csv",
    )  # fmt: skip
    refined = build_block(inputs).scenes[0].model
    assert np.abs(refined.ground_to_image(ground) - image).max() < 1.0
    left = build_block(replace(inputs, options={"refine": "none"})).scenes[0].model
    assert np.abs(left.ground_to_image(ground) - image).max() > 3.0


def test_missing_input_is_reported(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = tmp_path / "IMAGERY.TIF"
    image.write_bytes((scene / "IMAGERY.TIF").read_bytes())
    alone = [str(image) if word.endswith("IMAGERY.TIF") else word for word in words(scene, tmp_path / "o.tif")]
    assert run(alone) == 1
    assert "put its metadata beside the image" in " ".join(capsys.readouterr().err.split())
    # Of another size: named, not taken; of the image's size: taken, whatever its name.
    (tmp_path / "SPOT6.XML").write_text(re.sub(r"<NROWS>\d+", "<NROWS>77", TOLD.dimap()))
    assert run(alone) == 1
    assert "SPOT6.XML (3000 x 77 pixels)" in " ".join(capsys.readouterr().err.split())
    (tmp_path / "mine.xml").write_text(TOLD.dimap())
    assert run(alone) == 0


def test_the_inputs_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sensors", "pushbroom"]) == 0
    told = capsys.readouterr().out
    assert all(word in told for word in ("METADATA.DIM", "track", "additional", "focal_length_px"))
