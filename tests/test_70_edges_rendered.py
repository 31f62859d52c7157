"""On pixels: roads that cross the seam of a mosaic jump without edge matching, and meet themselves after the join."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from edge_render import joined, photographs, roads, shifts
from edge_rig import rig
from test_60_edges import matched, no_matching


def test_roads_meet_themselves(tmp_path: Path) -> None:
    """Common points measured to 0.05 px; roads through them and half-way between."""
    r, lines = rig(2, "affine", common_sigma=0.05, wobble=0.0), roads(8)
    m = matched(r)
    paths = photographs(r, lines, tmp_path)
    jump = {}
    for name, models in (("none", no_matching(r)), ("adjusted", m.adjusted), ("joined", m.models)):
        values, labels, transform = joined(r, models, paths, tmp_path / f"{name}.tif")
        jump[name] = np.abs(shifts(values, labels, transform, lines))
    at_points, between = slice(0, None, 2), slice(1, None, 2)
    assert np.sqrt((jump["none"] ** 2).mean()) > 2.5
    assert np.sqrt((jump["adjusted"] ** 2).mean()) > 0.8
    assert jump["joined"][at_points].max() < 0.25
    assert jump["joined"][between].max() < 0.8
    assert np.sqrt((jump["joined"] ** 2).mean()) < 0.25
