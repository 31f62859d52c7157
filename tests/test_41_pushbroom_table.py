"""The table of docs/pushbroom.md: check points of a SPOT-like scene after refinement by 1 to 16 control points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import CRS
from spot_rig import SIZE, Satellite, with_places

from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest

TOLD, BIASED = Satellite(attitude=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0)), Satellite()
ALONE = {"metadata": "none", "flying_height": 832_000.0}
# Control points, inputs, and the RMS in pixels (col, row) of the mean trial.
TABLE: list[tuple[int, dict[str, Any], tuple[float, float]]] = [
    (0, {}, (8.14, 3.19)),
    (1, {}, (0.52, 0.64)),
    (3, {}, (0.24, 0.23)),
    (4, {}, (0.18, 0.19)),
    (6, {}, (0.15, 0.13)),
    (9, {}, (0.13, 0.14)),
    (16, {}, (0.11, 0.11)),
    (9, ALONE, (0.51, 0.25)),
    (16, ALONE, (0.24, 0.23)),
]


@pytest.mark.slow
@pytest.mark.parametrize(("count", "options", "told"), TABLE)
def test_the_published_table(tmp_path: Path, count: int, options: dict[str, Any], told: tuple[float, float]) -> None:
    """Twenty trials of 0.3 px noise; the mean RMS of 200 check points is what the page says, within a quarter."""
    (tmp_path / "METADATA.DIM").write_text(TOLD.dimap())
    check, truth = BIASED.points(200, 800.0, 9)
    trials = []
    for trial in range(20 if count else 1):
        given = {"metadata": "METADATA.DIM"} | options
        if count:
            ground, image = BIASED.points(count, 800.0, 100 + trial, with_places(count))
            noisy = image + np.random.default_rng(trial).normal(0.0, 0.3, image.shape)
            rows = np.column_stack([ground, noisy]).tolist()
            given["points"] = [dict(zip(("x", "y", "z", "col", "row"), r, strict=True)) | {"sigma": 0.3} for r in rows]
        model = registry.build("pushbroom", SensorRequest("scene", SIZE, given, CRS.from_epsg(4978), str(tmp_path)))
        trials.append(np.sqrt(((model.ground_to_image(check) - truth) ** 2).mean(axis=0)))
    mean, worst = np.mean(trials, axis=0), np.max(trials, axis=0)
    print(f"{count} {options}: mean {mean.round(2)}, largest {worst.round(2)}")
    np.testing.assert_allclose(mean, told, rtol=0.25)
