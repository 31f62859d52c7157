"""`geomosaic rpc --grid`: the RPC and the grid together are the sensor, where the RPC alone cannot be."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rpc_rig import blank
from spot_rig import SIZE, Satellite

from geomosaic.cli.main import run
from geomosaic.geo.transform import Transform
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block
from geomosaic.rpc import write
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.sensor.solve import image_to_height
from geomosaic_pushbroom.metadata import read_metadata
from geomosaic_rpc.model import WGS84


def trembling() -> str:
    """Attitude that turns to and fro by some microradians, as measured flights do; 24 µrad are a pixel."""
    step = iter(range(10_000))  # yaw, pitch and roll of each eighth of a second

    def turn(match: re.Match[str]) -> str:
        t = float(next(step) // 3) * 0.125
        size = {"YAW": 0.0, "PITCH": 4e-6, "ROLL": -5e-6}[match[1]]
        return f"<{match[1]}>{float(size * (np.sin(5.0 * t) + 0.4 * np.sin(11.0 * t)))!r}<"

    return re.sub(r"<(YAW|PITCH|ROLL)>0\.0<", turn, Satellite().dimap())


def apart(image: Path, corrections: Path | None, exact: SensorModel, high: float) -> float:
    """Largest distance in pixels between the image's RPC, with a grid or not, and a sensor, at places of its own."""
    block = build_block(
        Block((image,), sensor="rpc", corrections=corrections and str(corrections), options={"refine": "none"})
    )
    model = block.scenes[0].model
    rng = np.random.default_rng(3)
    places = rng.uniform([0, 0], model.size, (3000, 2))
    ground = image_to_height(exact, places, rng.uniform(0.0, high, len(places)), WGS84)
    return float(np.hypot(*(model.ground_to_image(Transform(WGS84, model.crs)(ground)) - places).T).max())


@pytest.mark.ci
def test_rpc_and_grid_are_the_sensor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Any] = []
    fit = write.fit_rpc_and_grid

    def once(*given: Any) -> Any:
        """The fit, made for the first run only."""
        if not made:
            made.append(fit(*given))
        return made[0]

    monkeypatch.setattr(write, "fit_rpc_and_grid", once)
    image = blank(tmp_path / "IMAGERY.TIF", SIZE)
    (tmp_path / "METADATA.DIM").write_text(trembling())
    words = ["rpc", str(image), "--sensor", "pushbroom", "--height-range", "0", "900", "--text", "--grid"]
    assert run([*words, "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)["images"]
    exact = registry.build("pushbroom", SensorRequest("s", SIZE, {"metadata": "METADATA.DIM"}, None, str(tmp_path)))
    grid = tmp_path / "IMAGERY_RPC_grid.csv"
    assert told["written"] == [str(tmp_path / "IMAGERY_RPC.TXT"), str(grid)]
    assert apart(image, None, exact, 900.0) > 0.1
    assert apart(image, grid, exact, 900.0) < min(0.01, 2.0 * told["grid_worst_px"])
    assert run(words) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert run([*words, "--overwrite"]) == 0
    assert "with the grid" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("name", ["otb-sensor-geoms/spot5/spot5-1.geom", "cosicorr-spot-dimap/SPOT5.DIM"])
def test_an_rpc_with_its_grid_follows_a_trembling_attitude(
    real_data: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """The RPC alone is a tenth of a pixel off at most, as its attitude trembles; with the grid 0.01 px."""
    folder, _, rest = name.partition("/")
    file = real_data(folder) / rest
    size = read_metadata(file).size
    image = blank(tmp_path / "scene.tif", size)
    words = ["rpc", str(image), "--sensor", "pushbroom", "--option", f"metadata={file}"]
    assert run([*words, "--height-range", "0", "1000", "--text", "--grid", "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)["images"]
    assert told["grid_worst_px"] < 0.005
    exact = registry.build("pushbroom", SensorRequest("s", size, {"metadata": str(file)}, None))
    assert apart(image, None, exact, 1000.0) > 0.05
    assert apart(image, tmp_path / "scene_RPC_grid.csv", exact, 1000.0) < 0.01
