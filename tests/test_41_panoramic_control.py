"""Strips and panoramic photos whose nominal numbers are off, put right by control points."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from solve_rig import MAP, PLACE, control

from geomosaic.errors import GeomosaicError
from geomosaic.geo.transform import Transform
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block
from geomosaic.sensor import corrected as state_of
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.testing import check_plugin
from geomosaic.types import FloatArray
from geomosaic_panoramic.model import PanoramicModel

SIZE = (1000, 1200)
X, Y = PLACE[:2]
SCANNER: dict[str, Any] = {
    "kind": "scanner", "position": [X, Y, 3450.0], "heading": 30.0, "course": 33.0, "pitch": 1.5, "roll": -2.0,
    "advance": 4.0, "field_of_view": 90.0, "ground_height": 450.0,
}  # fmt: skip
CAMERA: dict[str, Any] = {
    "kind": "panoramic", "position": [X, Y, 3450.0], "heading": 200.0, "pitch": 15.0, "roll": 1.0, "advance": 6.0,
    "field_of_view": 70.0, "focal_length": 609.6, "pixel_size": 0.5, "image_motion": 3.0, "columns": "left",
    "ground_height": 450.0,
}  # fmt: skip
WRONG: dict[str, dict[str, Any]] = {
    "scanner": {"position": [X + 90.0, Y - 70.0, 3510.0], "heading": 31.0, "course": 32.0, "pitch": 0.0, "roll": 0.0,
                "advance": 3.9},
    "panoramic": {"position": [X - 80.0, Y + 60.0, 3400.0], "heading": 201.0, "pitch": 13.5, "roll": 0.0,
                  "advance": 5.8},
}  # fmt: skip
"""What a flight plan says, by tens of pixels off."""
PLACES = {
    1: [(0.5, 0.5)],
    4: [(c, r) for c in (0.1, 0.9) for r in (0.1, 0.9)],
    9: [(c, r) for c in (0.1, 0.5, 0.9) for r in (0.1, 0.5, 0.9)],
}


def made(options: dict[str, Any]) -> PanoramicModel:
    model = registry.build("panoramic", SensorRequest("strip", SIZE, options, MAP))
    assert isinstance(model, PanoramicModel)
    return model


def points_of(truth: PanoramicModel, count: int, noise: float, seed: int) -> list[dict[str, float]]:
    """Control points in the map, as a project hands them on."""
    rng = np.random.default_rng(seed)
    image = np.array(PLACES[count]) * SIZE + rng.uniform(-20.0, 20.0, (count, 2))
    origins, directions = truth.rays(image)
    down = -(directions * truth.frame.axes[2]).sum(axis=1)
    ground = origins + directions * ((3000.0 + rng.uniform(-150.0, 150.0, count)) / down)[:, None]
    rows = np.column_stack([Transform(truth.crs, MAP)(ground), image + rng.normal(0.0, noise, image.shape)]).tolist()
    return [dict(zip(("x", "y", "z", "col", "row"), row, strict=True)) | {"sigma": 0.3} for row in rows]


def rms(model: PanoramicModel, truth: PanoramicModel, ground: FloatArray) -> float:
    off = model.ground_to_image(ground) - truth.ground_to_image(ground)
    return float(np.sqrt((off**2).sum(axis=1).mean()))


@pytest.mark.parametrize(("count", "most"), [(1, 20.0), (4, 3.0), (9, 0.5)])
@pytest.mark.parametrize("true", [SCANNER, CAMERA], ids=["scanner", "camera"])
def test_a_flight_known_from_a_plan_is_corrected(true: dict[str, Any], count: int, most: float) -> None:
    """Relief of 300 m under 3000 m, 0.3 px of noise: RMS of 200 check points."""
    truth, told = made(true), true | WRONG[true["kind"]]
    ground = control(truth, 200, relief=150.0)
    before = rms(made(told), truth, ground)
    after = [rms(made(told | {"points": points_of(truth, count, 0.3, seed)}), truth, ground) for seed in range(3)]
    print(
        f"{true['kind']}, {count} points: {before:.1f} px before, {np.mean(after):.2f} after, {max(after):.2f} at most"
    )
    assert before > 20.0
    assert max(after) < most


def test_without_noise_the_flight_is_found_again() -> None:
    truth = made(SCANNER)
    sigmas = {"position": 1e4, "angles": 90.0, "speed": 10.0}
    points = [point | {"sigma": 1e-3} for point in points_of(truth, 9, 0.0, 1)]
    found = made(SCANNER | WRONG["scanner"] | {"points": points, "sigmas": sigmas})
    ground = control(truth, 100, relief=150.0)
    assert rms(found, truth, ground) < 1e-3
    assert "9 control points: RMS 0.00 px" in found.notes[-1]


def test_what_is_fixed_stays_and_the_state_keeps_what_was_done() -> None:
    truth = made(SCANNER)
    points = points_of(truth, 9, 0.3, 2)
    told = SCANNER | {"heading": 31.0, "points": points}
    as_told = made(SCANNER | {"heading": 31.0}).parameters.values
    turned = made(told | {"sigmas": {"position": 0, "speed": 0, "angles": 0, "heading": 5}})
    fixed = np.array([name != "heading" for name in turned.parameters.names])
    np.testing.assert_array_equal(
        turned.parameters.values[fixed], made(SCANNER | {"heading": 31.0}).parameters.values[fixed]
    )
    again = state_of.model_from_dict(state_of.model_to_dict("panoramic", turned))
    assert isinstance(again, PanoramicModel)
    assert again.notes == turned.notes
    left = made(told | {"refine": "none"})
    np.testing.assert_array_equal(left.parameters.values, as_told)


def test_the_plugin_passes_the_check() -> None:
    options = SCANNER | {"points": points_of(made(SCANNER), 4, 0.3, 0), "sigmas": {"roll": 1.0}, "refine": "points"}
    check_plugin(registry.plugin("panoramic"), SensorRequest("strip", SIZE, options, MAP))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"points": 3}, "not a list of points"),
        ({"points": [{"x": 1.0}]}, "control point 1 has no y, z, col, row"),
        ({"points": [{"x": X, "y": Y, "z": 9000.0, "col": 1.0, "row": 1.0}]}, "sees none of the points"),
        ({"sigmas": {"rol": 1.0}}, "did you mean 'roll'"),
        ({"sigmas": {"roll": -1.0}}, "negative"),
        ({"sigmas": 3}, "not a table"),
        ({"refine": "all"}, "choose from: points, none"),
    ],
)
def test_what_is_wrong_is_said(change: dict[str, Any], said: str) -> None:
    with pytest.raises(GeomosaicError, match="strip") as caught:
        made(SCANNER | change)
    assert said in str(caught.value)


def test_control_of_a_project_refines_the_strip(tmp_path: Path) -> None:
    """Points of role control are passed to the sensor; the check point, grossly wrong, is not."""
    truth = made(SCANNER)
    image = tmp_path / "strip.tif"
    profile = {"driver": "GTiff", "width": SIZE[0], "height": SIZE[1], "count": 1, "dtype": "uint8", "sparse_ok": True}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(image, "w", **profile):
            pass
    lines = ["id,x,y,z,image,col,row,sigma_px,role"]
    for i, p in enumerate(points_of(truth, 9, 0.3, 4)):
        lines.append(f"{i},{p['x']!r},{p['y']!r},{p['z']!r},strip.tif,{p['col']!r},{p['row']!r},0.3,control")
    lines.append(f"far,{X},{Y},450.0,strip.tif,5.0,5.0,0.3,check")
    (tmp_path / "gcps.csv").write_text("\n".join(lines) + "\n")
    inputs = Block(
        (image,), "panoramic", options=SCANNER | WRONG["scanner"], crs="EPSG:32633", heights="egm96", height=450.0,
        control=tmp_path / "gcps.csv",
    )  # fmt: skip
    model = build_block(inputs).scenes[0].model
    assert isinstance(model, PanoramicModel)
    assert rms(model, truth, control(truth, 100, relief=150.0)) < 0.6
