"""A project whose photo, heights and map show the same ground of a formula, to digitize in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from reference_rig import ANGLES, GROUND, ORIGIN, POSITION
from studio_control_rig import ScanProject, frame_project

from geomosaic.geo.transform import Transform
from geomosaic.testing.synthetic.block import PlainCamera


def digitizing_project(folder: Path) -> tuple[ScanProject, PlainCamera]:
    """Write a project of one photo with its true orientation, and its camera."""
    project, camera = frame_project(folder)
    header = "image,x,y,z,omega,phi,kappa,sigma_x,sigma_y,sigma_z,sigma_omega,sigma_phi,sigma_kappa"
    values = ",".join(map(str, (*POSITION, *ANGLES, 0.2, 0.2, 0.2, 0.01, 0.01, 0.01)))
    (folder / "exterior.csv").write_text(f"{header}\nphoto.tif,{values}\n", encoding="utf-8")
    return project, camera


def pixels_of(camera: PlainCamera, xy: np.ndarray) -> np.ndarray:
    """True pixels (N, 2) of places (N, 2) on the ground of the formula."""
    xyz = np.column_stack([xy, GROUND.height(xy)])
    return camera.ground_to_image(Transform(GROUND.crs, camera.crs)(xyz))


def road(count: int = 9) -> np.ndarray:
    """Places (N, 2) along a road that winds over the hills."""
    t = np.linspace(-1.0, 1.0, count)
    return np.column_stack([ORIGIN[0] + 30.0 + 170.0 * t, ORIGIN[1] - 30.0 + 70.0 * np.sin(2.5 * t)])


def line(coordinates: np.ndarray) -> dict[str, Any]:
    """GeoJSON of a line."""
    return {"type": "LineString", "coordinates": np.asarray(coordinates).tolist()}


def area(coordinates: np.ndarray) -> dict[str, Any]:
    """GeoJSON of an area whose outline is closed here."""
    ring = np.asarray(coordinates).tolist()
    return {"type": "Polygon", "coordinates": [[*ring, ring[0]]]}
