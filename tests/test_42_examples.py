"""The example that `geomosaic sensors NAME` shows runs as it is shown."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from geomosaic.cli.main import run
from geomosaic.inputs.build import build_block
from geomosaic.project.load import load_project
from geomosaic.sensor.registry import sensors
from geomosaic.sensor.solve.inverse import image_to_ground

BUILT_IN = ("frame", "panoramic", "planar", "pushbroom", "rpc")


def shown(name: str, capsys: pytest.CaptureFixture[str]) -> tuple[tuple[int, int], str, dict[str, str]]:
    """Size, project and files of an example, out of what the command prints."""
    assert run(["sensors", name]) == 0
    out = capsys.readouterr().out
    head, _, rest = out.partition("example: a project, project.toml, for image.tif of ")
    assert "inputs:" in head
    found = re.match(r"(\d+) x (\d+) pixels\n", rest)
    assert found, out
    size = int(found[1]), int(found[2])
    parts = re.split(r"^with (.+):$", rest[found.end() :], flags=re.MULTILINE)
    texts = ["\n".join(line.removeprefix("  ") for line in part.strip("\n").splitlines()) + "\n" for part in parts]
    return size, texts[0], dict(zip(parts[1::2], texts[2::2], strict=True))


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.filterwarnings("ignore::UserWarning")  # a frame without refraction says so
def test_the_example_runs(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert name in {entry.name for entry in sensors()}
    size, project, files = shown(name, capsys)
    for file, text in files.items():
        (tmp_path / file).write_text(text)
    with rasterio.open(
        tmp_path / "image.tif", "w", driver="GTiff", width=size[0], height=size[1], count=1, dtype="uint8"
    ) as image:
        image.write(np.full((1, size[1], size[0]), 99, dtype=np.uint8))
    (tmp_path / "project.toml").write_text(project)
    block = build_block(load_project(tmp_path / "project.toml").inputs)
    model = block.scenes[0].model
    assert block.scenes[0].sensor == name
    pixels = np.array([[0.5, 0.5], [size[0] / 2, size[1] / 2], [size[0] - 0.5, size[1] - 0.5]])
    surface = block.surface
    ground = image_to_ground(model, pixels, surface)
    assert np.isfinite(ground).all()
    if surface is not None:
        from geomosaic.geo.transform import Transform

        ground = Transform(surface.crs, model.crs)(ground)
    assert np.abs(model.ground_to_image(ground) - pixels).max() < 1e-3


@pytest.mark.parametrize("name", BUILT_IN)
def test_json_has_it_too(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    size, project, files = shown(name, capsys)
    assert run(["sensors", name, "--json"]) == 0
    example: dict[str, Any] = json.loads(capsys.readouterr().out)["example"]
    assert (tuple(example["size"]), example["files"].keys()) == (size, files.keys())
    assert example["project"].split() == project.split()
