"""The camera written a second time, on its own: the truth that outputs are held against, and what photos are made with.

Two treatments of a camera that is given in a map: `planar`, collinearity in map coordinates, as orthority does it; and
`rigorous`, on the ellipsoid: map to geocentric coordinates, angles turned from grid north to true north.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pyproj import Proj, Transformer

from benchmarks.scene import BASE, CENTRE, CRS, RIPPLE, SWING, Camera, Satellite, Shot

Floats = npt.NDArray[np.float64]


def relief(x: Floats, y: Floats) -> Floats:
    """Height of the ground in metres."""
    u, v = x - CENTRE[0], y - CENTRE[1]
    hills = SWING * np.sin(u / 1500 + 0.3) * np.cos(v / 1300 - 0.5)
    heights: Floats = BASE + hills + RIPPLE * np.sin(u / 300) * np.sin(v / 280)
    return heights


def rotation(angles: tuple[float, float, float]) -> Floats:
    """Map to image, x right, y up: R3(kappa) R2(phi) R1(omega)."""
    (so, sp, sk), (co, cp, ck) = np.sin(np.radians(angles)), np.cos(np.radians(angles))
    r1 = np.array([[1, 0, 0], [0, co, so], [0, -so, co]])
    r2 = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    r3 = np.array([[ck, sk, 0], [-sk, ck, 0], [0, 0, 1]])
    return np.asarray(r3 @ r2 @ r1, dtype=np.float64)


def distorted(camera: Camera, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Brown's model on coordinates of focal length one, y down."""
    k, rr = camera.brown, x * x + y * y
    radial = 1 + rr * (k["k1"] + rr * (k["k2"] + rr * k["k3"]))
    u = x * radial + 2 * k["p1"] * x * y + k["p2"] * (rr + 2 * x * x)
    v = y * radial + k["p1"] * (rr + 2 * y * y) + 2 * k["p2"] * x * y
    return u, v


def image(camera: Camera, axes: Floats) -> Floats:
    """Camera axes (N, 3), x right, y up, looking along -z, to (col, row)."""
    u, v = distorted(camera, axes[:, 0] / -axes[:, 2], axes[:, 1] / axes[:, 2])
    return np.column_stack([u, v]) * camera.focal + camera.principal_point


def planar(camera: Camera, shot: Shot, xyz: Floats) -> Floats:
    """Map (N, 3) to (col, row), the Earth taken for flat."""
    return image(camera, (xyz - shot.position) @ rotation(shot.angles).T)


def rigorous(camera: Camera, shot: Shot, xyz: Floats) -> Floats:
    """Map (N, 3), heights ellipsoidal, to (col, row), on the ellipsoid."""
    geographic = Transformer.from_crs(CRS, "EPSG:4326", always_xy=True)
    geocentric = Transformer.from_pipeline("+proj=cart +ellps=WGS84")

    def earth(p: Floats) -> Floats:
        lon, lat = geographic.transform(p[:, 0], p[:, 1])
        return np.column_stack(geocentric.transform(lon, lat, p[:, 2]))

    centre = np.array([shot.position])
    lon, lat = geographic.transform(*shot.position[:2])
    turn = np.radians(Proj(CRS).get_factors(lon, lat).meridian_convergence)
    (sl, cl), (sb, cb) = (
        (np.sin(np.radians(lon)), np.cos(np.radians(lon))),
        (np.sin(np.radians(lat)), np.cos(np.radians(lat))),
    )
    east_north_up = np.array([[-sl, cl, 0], [-sb * cl, -sb * sl, cb], [cb * cl, cb * sl, sb]])
    # Grid north stands `turn` clockwise of true north: components along the grid from those along east and north.
    to_grid = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    axes = (earth(xyz) - earth(centre)) @ (rotation(shot.angles) @ to_grid @ east_north_up).T
    return image(camera, np.asarray(axes, dtype=np.float64))


def rational(scene: Satellite, xyz: Floats) -> Floats:
    """Map (N, 3), heights ellipsoidal, to (col, row) by rational polynomials, (0, 0) the upper-left pixel's corner."""
    lon, lat = Transformer.from_crs(CRS, "EPSG:4326", always_xy=True).transform(xyz[:, 0], xyz[:, 1])
    at = np.stack([lon, lat, xyz[:, 2]]) - np.array([*scene.place, BASE])[:, None]
    x, y, z = at / np.array(scene.scales[2:])[:, None]
    one = np.ones_like(x)
    powers = (
        one, x, y, z, x * y, x * z, y * z, x * x, y * y, z * z, x * y * z, x**3, x * y * y, x * z * z, x * x * y, y**3,
        y * z * z, x * x * z, y * y * z, z**3,
    )  # fmt: skip
    col, row, below = (sum(value * powers[k] for k, value in part.items()) for part in scene.terms)
    return np.column_stack([col, row]) / below[:, None] * scene.scales[:2] + np.array(scene.middle) + 0.5


def ground(camera: Camera, shot: Shot, colrow: Floats) -> Floats:
    """Where rays of (col, row) (N, 2) meet the relief, planar, to about a centimetre: (N, 3)."""
    seen = (colrow - camera.principal_point) / camera.focal
    x, y = seen[:, 0].copy(), seen[:, 1].copy()
    for _ in range(12):
        u, v = distorted(camera, x, y)
        x, y = x + seen[:, 0] - u, y + seen[:, 1] - v
    ray = np.column_stack([x, -y, -np.ones_like(x)]) @ rotation(shot.angles)
    z = np.full(len(ray), BASE)
    for _ in range(40):
        along = (z - shot.position[2]) / ray[:, 2]
        z = relief(shot.position[0] + along * ray[:, 0], shot.position[1] + along * ray[:, 1])
    along = (z - shot.position[2]) / ray[:, 2]
    return np.asarray(np.array(shot.position) + along[:, None] * ray, dtype=np.float64)
