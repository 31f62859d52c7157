"""A flight of which nothing is reported: straight from A to E, constant angles, and what disturbs them.

The projection centre of row j of n is A + j/n·(E − A) (equation (5) of Müller and Sauleda, 1988, after Konecny, Kruck
and Lohmann, 1986). With constant omega, phi, kappa that is the ideal flight. Curved orbits, manoeuvres and the turning
Earth disturb it; since a path and the angle across it act nearly alike on the image, the path stays straight and the
angles become functions of time. Eight additional parameters hold that, with s = 2j/n − 1 (−1 at A, 1 at E), L(s) =
(3s² − 1)/2, and v the same over the columns:

    omega(s) = omega + omega1·s + omega2·L(s)    linear: the view turns as the ground passes below, seen in relief only
    phi(s)   = phi   + phi1·s   + phi2·L(s)      the same for the other axis; squared terms: speed and side drift change
    kappa(s) = kappa + kappa1·s + kappa2·L(s)    linear: lines that are not parallel; squared: their turn is uneven
    along slope of a detector  + bend·L(v)       a line that is curved
    across slope of a detector + stretch·L(v)    pixels that grow towards both ends of the line

From afar a centre that moves and an angle that turns after it are the same but for relief, and would be estimated with
correlations of nearly 1. So A and E are not unknowns themselves but follow from what the image tells well: the ground
points (xa, ya) and (xe, ye), at local height 0, on which the principal point of row 0 and row n falls, and how far away
they are,

    A = (xa, ya, 0) + da·z(omega − omega1, phi − phi1),   E = (xe, ye, 0) + de·z(omega + omega1, phi + phi1)

z being the third row of M. The six are as free as the coordinates of A and E.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from pyproj import CRS

from geomosaic.geo.local_frames import LocalFrame
from geomosaic.types import FloatArray
from geomosaic_pushbroom.platform import Bend
from geomosaic_pushbroom.pose import Pose

IDEAL = ("xa", "ya", "da", "xe", "ye", "de", "omega", "phi", "kappa")
ADDITIONAL = ("omega1", "phi1", "kappa1", "omega2", "phi2", "kappa2", "bend", "stretch")


@dataclass(frozen=True, eq=False)
class Straight:
    """Straight flight in east, north, up metres at the middle of the scene.

    Angles turn east, north, up into image axes, M = R3(κ)·R2(φ)·R1(ω): x towards growing columns, z up; rows come from
    the flight alone, so y may point either way along it. bend and stretch are in pixels at the ends of the line.

    Attributes
    ----------
    frame : LocalFrame
    rows : int
        Number n of rows: A is at row 0 and E at row n.
    focal : float
        Camera constant in pixels.
    """

    kind: ClassVar[str] = "straight"
    names: ClassVar[tuple[str, ...]] = (*IDEAL, *ADDITIONAL)
    units: ClassVar[tuple[str, ...]] = ("m",) * 6 + ("deg",) * 9 + ("px",) * 2
    frame: LocalFrame
    rows: int
    focal: float

    def ends(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A and E, east, north, up in metres (3,) each."""
        centre, turn = values[6:9], values[9:12]
        found = []
        for angles, (x, y, distance) in ((centre - turn, values[:3]), (centre + turn, values[3:6])):
            z = omega_phi_kappa(*np.radians(angles)[:, None])[0, 2]
            found.append(np.array([x, y, 0.0]) + distance * z)
        return found[0], found[1]

    def pose(self, values: FloatArray, rows: FloatArray) -> Pose:
        """Pose at rows (N,)."""
        share = (rows / self.rows)[:, None]
        start, end = self.ends(values)
        local = start + share * (end - start)
        s = 2.0 * share[:, 0] - 1.0
        curve = 1.5 * s * s - 0.5
        omega, phi, kappa = (np.radians(values[6 + i] + values[9 + i] * s + values[12 + i] * curve) for i in range(3))
        matrices = omega_phi_kappa(omega, phi, kappa)
        e, n, u = self.frame.axes
        position = self.frame.origin + local[:, :1] * e + local[:, 1:2] * n + local[:, 2:] * u
        axes = matrices[:, :, :1] * e + matrices[:, :, 1:2] * n + matrices[:, :, 2:] * u
        return Pose(position, axes)

    def bend(self, values: FloatArray) -> Bend:
        """Bend and stretch of the line, pixels to slopes."""
        return Bend(float(values[16]) / self.focal, float(values[15]) / self.focal)

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        frame = {"origin": self.frame.origin.tolist(), "axes": self.frame.axes.tolist()}
        return {**frame, "crs": self.frame.crs.to_wkt(), "rows": self.rows, "focal": self.focal}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Rebuild from `to_dict`."""
        frame = LocalFrame(CRS.from_wkt(state["crs"]), np.array(state["origin"]), np.array(state["axes"]))
        return cls(frame, state["rows"], state["focal"])


def omega_phi_kappa(omega: FloatArray, phi: FloatArray, kappa: FloatArray) -> FloatArray:
    """Ground→image rotations R3(κ)·R2(φ)·R1(ω) of angles (N,) in radians; shape (N, 3, 3)."""
    cw, sw, cp, sp, ck, sk = (f(a) for a in (omega, phi, kappa) for f in (np.cos, np.sin))
    rows = [
        [cp * ck, cw * sk + sw * sp * ck, sw * sk - cw * sp * ck],
        [-cp * sk, cw * ck - sw * sp * sk, sw * ck + cw * sp * sk],
        [sp, -sw * cp, cw * cp],
    ]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)
