"""One point of a reference found in a photo through its sensor model, against the photo's true camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from reference_rig import ORIGIN, block, dem, photo, reference

from geomosaic.geo.transform import Transform
from geomosaic.inputs.build import build_block
from geomosaic.reference_matching.drawing import Drawer, georeferenced
from geomosaic.reference_matching.match import Reference, match_place


def test_points_of_a_reference_are_found_where_the_true_camera_sees_them(tmp_path: Path) -> None:
    """Reference of another season, orientation 8 m (some 6 px) off."""
    path, camera = photo(tmp_path)
    oriented = build_block(block(path, dem(tmp_path), (6.0, -5.0, 2.0, 0.0, 0.0, 0.0)))
    scene, grid = georeferenced(reference(tmp_path), "the reference")
    random = np.random.default_rng(2)
    to_earth = Transform(oriented.surface.crs, camera.crs)
    errors = []
    with (
        (opened := Reference.open(scene, grid)).drawer,
        Drawer.open(oriented.scenes[0], oriented.surface, grid.crs) as drawer,
    ):
        for xy in ORIGIN + random.uniform(-160.0, 160.0, (30, 2)):
            found = match_place(drawer, opened, (float(xy[0]), float(xy[1])), reach=10)
            if found is None:
                continue
            place = drawer.mapper.surface_xy(xy[None])
            xyz = np.column_stack([place, oriented.surface.height(place)])
            true = camera.ground_to_image(to_earth(xyz))[0]
            errors.append(found.colrow - true)
        assert match_place(drawer, opened, (float(ORIGIN[0]) + 9000.0, float(ORIGIN[1]))) is None
    lengths = np.hypot(*np.array(errors).T)
    assert len(errors) > 15
    assert np.median(lengths) < 0.3
    assert (lengths < 1.0).mean() > 0.9
