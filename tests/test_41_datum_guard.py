"""Undeclared heights stop every sensor, with the metres and pixels at stake and the option that settles it."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rpc_rig
from affine import Affine
from pyproj import CRS
from solve_rig import PLACE

from geomosaic.errors import HeightDatumError
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.surface.model import undulation
from geomosaic_rpc.write import text_of

FLAT = CRS.from_epsg(32633)
HERE = undulation(FLAT, *PLACE[:2])


def at_stake(error: HeightDatumError) -> tuple[float, float]:
    """Metres and pixels of a message."""
    found = re.search(r"differ by ([\d.]+) m (?:here|there).*?up to ([\d.e+]+) px", error.what)
    assert found, error.what
    assert "ellipsoidal" in str(error.hint)
    return float(found[1]), float(found[2])


def refused(sensor: str, options: dict[str, Any], size: tuple[int, int], base: str = ".") -> HeightDatumError:
    with pytest.raises(HeightDatumError) as caught:
        registry.build(sensor, SensorRequest("one", size, options, FLAT, base))
    return caught.value


def test_a_frame_camera_is_guarded() -> None:
    options = {
        "camera": {"focal_length_px": 1000.0},
        "position": [*PLACE[:2], 2000.0],
        "orientation": {"system": "opk", "omega": 0, "phi": 0, "kappa": 0},
    }
    metres, pixels = at_stake(refused("frame", options, (1200, 1600)))
    assert metres == pytest.approx(abs(HERE), abs=0.06)
    assert pixels == pytest.approx(1000 * metres / 2000, abs=1)  # a corner 1000 px out, 2000 m above


def test_a_scanner_is_guarded() -> None:
    above, field = 3000.0, 90.0
    options = {
        "kind": "scanner", "position": [*PLACE[:2], above], "heading": 0.0, "advance": 4.0, "field_of_view": field,
    }  # fmt: skip
    metres, pixels = at_stake(refused("panoramic", options, (1000, 500)))
    edge = math.radians(field / 2)
    moved = math.atan(above * math.tan(edge) / (above - 1.0)) - edge  # raising the ground by a metre
    assert metres == pytest.approx(abs(HERE), abs=0.06)
    assert pixels == pytest.approx(metres * moved / math.radians(field / 1000), rel=0.02)


@pytest.mark.parametrize("height", [500.0, 4000.0])
def test_line_scanner_with_a_track(tmp_path: Path, height: float) -> None:
    rows = [f"{t},{PLACE[0] + 60 * t},{PLACE[1]},{height},0,0,90" for t in range(-3, 14)]
    (tmp_path / "track.csv").write_text("time,x,y,z,roll,pitch,heading\n" + "\n".join(rows) + "\n")
    options = {
        "track": "track.csv", "focal_length_px": 1000.0, "start_time": 0.0, "line_period": 0.01, "columns": "right",
        "ground_height": 0.0,
    }  # fmt: skip
    metres, pixels = at_stake(refused("pushbroom", options, (800, 1000), str(tmp_path)))
    assert metres == pytest.approx(abs(HERE), abs=0.06)
    # 400 px out. The model's own start of the ground is the ellipsoid's 0.
    assert pixels == pytest.approx(400 * metres / height, rel=0.02)


def test_line_scanner_from_points() -> None:
    points = [{"id": str(i), "x": PLACE[0] + i, "y": PLACE[1], "z": 1.0, "col": i, "row": i} for i in range(8)]
    error = refused("pushbroom", {"points": points, "flying_height": 3000.0}, (800, 1000))
    assert "the control points have no vertical datum" in error.what  # of no model nothing can be said in pixels


def test_control_of_an_rpc_needs_a_vertical_datum(tmp_path: Path) -> None:
    model = rpc_rig.model()
    (tmp_path / "one_RPC.TXT").write_text(text_of(model.rpc))
    ground = rpc_rig.ground(5)
    image = model.ground_to_image(ground)
    points = [{"x": x, "y": y, "z": z, "col": c, "row": r} for (x, y, z), (c, r) in zip(ground, image, strict=True)]
    options = {"rpc": "one_RPC.TXT", "points": points}
    with pytest.raises(HeightDatumError) as caught:
        registry.build("rpc", SensorRequest("one", rpc_rig.SIZE, options, CRS.from_epsg(4326), str(tmp_path)))
    metres, pixels = at_stake(caught.value)
    assert metres == pytest.approx(abs(undulation(CRS.from_epsg(4326), 12.3, 45.6)), abs=0.06)
    moved = model.ground_to_image(ground + np.array([0, 0, metres])) - image
    assert pixels == pytest.approx(np.hypot(*moved.T).max(), rel=0.2)


def test_dem_under_a_scene_that_carries_its_own_model(tmp_path: Path) -> None:
    """No table of positions tells how far it moves: the scene's own model does."""
    model = rpc_rig.model()
    with rasterio.open(tmp_path / "one.tif", "w", driver="GTiff", width=4000, height=3000, count=1, dtype="uint8"):
        pass
    (tmp_path / "one_RPC.TXT").write_text(text_of(model.rpc))
    transform = Affine(0.01, 0, 12.2, 0, -0.01, 45.7)
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", width=20, height=20, count=1, dtype="float32", crs="EPSG:4326",
        transform=transform,
    ) as file:  # fmt: skip
        file.write(np.full((1, 20, 20), 400, dtype=np.float32))
    with pytest.raises(HeightDatumError) as caught:
        build_block(Block((tmp_path / "one.tif",), "rpc", dem=tmp_path / "dem.tif"))
    metres, pixels = at_stake(caught.value)
    assert metres == pytest.approx(abs(undulation(CRS.from_epsg(4326), 12.3, 45.6)), abs=0.2)
    ground = rpc_rig.ground(5)
    moved = model.ground_to_image(ground + np.array([0, 0, metres])) - model.ground_to_image(ground)
    assert pixels == pytest.approx(np.hypot(*moved.T).max(), rel=0.2)
