"""Lists of an aerial block of IGN: cameras (.txt), orientations (.OPK), image points (.mes), control points (.app).

Orientations are in Lambert-93 with altitudes, stretched about the ground by the scale of the map; R turns its axes, off
east and north by the convergence, into those of the photo (x right, y up).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS, Proj, Transformer

from geomosaic.geo.local_frames import enu_axes, omega_phi_kappa, r3
from geomosaic.interchange.reconstruction import ImagePoints, ImagePose, ObjectPoints, Reconstruction, SurveyedPoints
from geomosaic.types import FloatArray

MAP = CRS.from_epsg(2154)
GEOCENTRIC = "EPSG:4964"  # RGF93


def read_cameras(folder: Path) -> dict[str, dict[str, Any]]:
    """Camera tables by name of all Camera*.txt."""
    found: dict[str, dict[str, Any]] = {}
    for file in sorted(folder.glob("Camera*.txt")):
        pairs = (line.partition("=") for line in file.read_text().splitlines() if "=" in line)
        values = {key.strip().lower(): value.strip() for key, _, value in pairs}
        found[values["name"]] = {
            "size": [int(float(values["width"])), int(float(values["height"]))],
            "focal_length_px": float(values["focal"]),
            "principal_point_px": [float(values["ppax"]), float(values["ppay"])],
            "distortion": {"model": "none"},
        }
    return found


def words(path: Path) -> list[list[str]]:
    """Words of the lines of a list that are not blank, without quotes."""
    return [line.replace('"', "").split() for line in path.read_text().splitlines() if line.strip()]


def to_geocentric(xyz: FloatArray) -> FloatArray:
    """Map coordinates and ellipsoidal heights (N, 3) to geocentric ones."""
    longitude, latitude = Transformer.from_crs(MAP, MAP.geodetic_crs, always_xy=True).transform(xyz[:, 0], xyz[:, 1])
    places = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    return np.column_stack(places.transform(longitude, latitude, xyz[:, 2]))


def undulation(path: Path, longitude: FloatArray, latitude: FloatArray) -> FloatArray:
    """Height (N,) of the geoid above the ellipsoid, bilinear in a grid."""
    import rasterio
    from scipy.ndimage import map_coordinates

    with rasterio.open(path) as grid:
        t = ~grid.transform
        columns, rows = (a * longitude + b * latitude + c for a, b, c in ((t.a, t.b, t.c), (t.d, t.e, t.f)))
        heights: FloatArray = map_coordinates(grid.read(1).astype(np.float64), [rows - 0.5, columns - 0.5], order=1)
    return heights


def read_borea(folder: Path) -> Reconstruction:
    """The block: poses and points geocentric, measurements of ties, control with ellipsoidal heights in the map.

    Parameters
    ----------
    folder : Path
        borea-ign-uce-block.
    """
    data = folder / "test/data/dataset2"
    ties, world = words(data / "all_liaisons2.mes"), words(data / "all_liaisons2_world.mes")
    rows = words(data / "23FD1305_alt_2.OPK")[1:]
    index = {row[0]: at for at, row in enumerate(rows)}
    ids = tuple(row[0] for row in world)
    number = {name: at for at, name in enumerate(ids)}
    places = np.array([row[1:4] for row in world], dtype=np.float64)
    kept = [row for row in ties if row[1] in index and row[0] in number]
    image = np.array([index[row[1]] for row in kept])
    point = np.array([number[row[0]] for row in kept])
    seen = ImagePoints(image, point, np.array([row[2:4] for row in kept], dtype=np.float64))
    surveyed = words(folder / "dataset/GCP_test.app")
    names = [row[0] for row in surveyed]
    measured = [row for row in words(data / "all_terrains2.mes") if row[1] in index and row[0] in names]
    control = SurveyedPoints(
        ObjectPoints(tuple(names), np.array([row[2:5] for row in surveyed], dtype=np.float64)),
        ImagePoints(
            np.array([index[row[1]] for row in measured]),
            np.array([names.index(row[0]) for row in measured]),
            np.array([row[2:4] for row in measured], dtype=np.float64),
        ),
        "EPSG:2154",
    )
    values = np.array([row[1:7] for row in rows], dtype=np.float64)
    ground = np.full(len(rows), np.median(places[:, 2]))
    for at in np.unique(image):
        ground[at] = places[point[image == at], 2].mean()
    poses = _poses(values, ground, folder / "dataset/fr_ign_RAF20.tif")
    images = tuple(
        ImagePose(row[0], row[7], rotation, centre) for row, (rotation, centre) in zip(rows, poses, strict=True)
    )
    points = ObjectPoints(ids, to_geocentric(places))
    return Reconstruction(read_cameras(folder / "dataset"), images, points, seen, GEOCENTRIC, control=control)


def _poses(values: FloatArray, ground: FloatArray, geoid: Path) -> list[tuple[FloatArray, FloatArray]]:
    """Geocentric rotation and centre of x, y, altitude, omega, phi, kappa (N, 6); ground heights (N,) ellipsoidal."""
    longitude, latitude = Transformer.from_crs(MAP, MAP.geodetic_crs, always_xy=True).transform(
        values[:, 0], values[:, 1]
    )
    factors = Proj(MAP).get_factors(longitude, latitude)
    n = undulation(geoid, longitude, latitude)
    # The altitude was stretched about the ground by the scale of the map.
    height = (values[:, 2] - (ground - n)) / factors.meridional_scale + ground
    centres = to_geocentric(np.column_stack([values[:, :2], height]))
    found = []
    for at, (omega, phi, kappa) in enumerate(np.radians(values[:, 3:])):
        to_photo = omega_phi_kappa(omega, phi, kappa) @ r3(-np.radians(factors.meridian_convergence[at]))
        rotation = np.diag([1.0, -1.0, -1.0]) @ to_photo @ enu_axes(longitude[at], latitude[at])
        found.append((rotation, centres[at]))
    return found
