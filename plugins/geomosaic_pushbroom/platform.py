"""Platforms of a scanner: pose of each image row as a function of the adjustable parameters.

`ReportedFlight` follows what was reported, with small corrections; `StraightFlight` is for scenes of which nothing is
reported. There the projection centre of row j of n is A + j/n·(E − A) (equation (5) of Müller and Sauleda, 1988, after
Konecny, Kruck and Lohmann, 1986). With constant omega, phi, kappa that is the ideal flight. Curved orbits, manoeuvres
and the turning Earth disturb it; since a path and the angle across it act nearly alike on the image, the path stays
straight and the angles become functions of time. Eight additional parameters hold that, with s = 2j/n − 1 (−1 at A, 1
at E), L(s) = (3s² − 1)/2, and v the same over the columns:

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
from typing import Any, ClassVar, NamedTuple, Protocol, Self

import numpy as np

from geomosaic.geo.local_frames import LocalFrame
from geomosaic.types import FloatArray
from geomosaic_pushbroom.paths import PATHS, Path
from geomosaic_pushbroom.pose import Pose, combined, turned


class LineDistortion(NamedTuple):
    """Changes of the look directions over the line: multiples of its second Legendre polynomial, as slopes.

    Attributes
    ----------
    stretch : float
        Across the flight.
    bend : float
        Along the flight.
    """

    stretch: float = 0.0
    bend: float = 0.0


class Platform(Protocol):
    """Poses over image rows."""

    kind: ClassVar[str]
    names: ClassVar[tuple[str, ...]]
    units: ClassVar[tuple[str, ...]]

    def pose(self, values: FloatArray, rows: FloatArray) -> Pose:
        """Pose at image rows (N,) with parameter values (P,)."""

    def bend(self, values: FloatArray) -> LineDistortion:
        """Changes of the look directions with parameter values (P,)."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""


@dataclass(frozen=True, eq=False)
class ReportedFlight:
    """Reported flight with corrections that control points determine.

    With t the seconds from the middle of the scene, the pose of the path at t + `time` is moved by (across, along, up)
    along its own axes and then turned by `pose.turned` with pitch + pitch_rate·t and so on.

    Attributes
    ----------
    path : Path
        Flight as it was reported.
    period : float
        Seconds from one row to the next.
    middle : float
        Row at t = 0.
    """

    kind: ClassVar[str] = "flight"
    names: ClassVar[tuple[str, ...]] = (
        "roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate", "across", "along", "up", "time",
    )  # fmt: skip
    units: ClassVar[tuple[str, ...]] = ("deg",) * 3 + ("deg/s",) * 3 + ("m",) * 3 + ("s",)
    path: Path
    period: float
    middle: float

    def pose(self, values: FloatArray, rows: FloatArray) -> Pose:
        """Pose at rows (N,)."""
        t = (rows - self.middle) * self.period
        position, axes = self.path.pose(t + values[9])
        shift = np.broadcast_to(values[6:9], position.shape)
        roll, pitch, yaw = (np.radians(values[i] + values[i + 3] * t) for i in range(3))
        return Pose(position + combined(axes, shift), turned(axes, pitch, roll, yaw))

    def bend(self, values: FloatArray) -> LineDistortion:
        """The look directions are those of the calibration."""
        return LineDistortion()

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"path": self.path.kind, **self.path.to_dict(), "period": self.period, "middle": self.middle}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(PATHS[state["path"]].from_dict(state), state["period"], state["middle"])


IDEAL = ("xa", "ya", "da", "xe", "ye", "de", "omega", "phi", "kappa")
ADDITIONAL = ("omega1", "phi1", "kappa1", "omega2", "phi2", "kappa2", "bend", "stretch")


@dataclass(frozen=True, eq=False)
class StraightFlight:
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
        # The second Legendre polynomial is orthogonal to 1 and s: squared terms hardly correlate with the others.
        curve = 1.5 * s * s - 0.5
        omega, phi, kappa = (np.radians(values[6 + i] + values[9 + i] * s + values[12 + i] * curve) for i in range(3))
        matrices = omega_phi_kappa(omega, phi, kappa)
        e, n, u = self.frame.axes
        position = self.frame.origin + local[:, :1] * e + local[:, 1:2] * n + local[:, 2:] * u
        axes = matrices[:, :, :1] * e + matrices[:, :, 1:2] * n + matrices[:, :, 2:] * u
        return Pose(position, axes)

    def bend(self, values: FloatArray) -> LineDistortion:
        """Bend and stretch of the line, pixels to slopes."""
        return LineDistortion(float(values[16]) / self.focal, float(values[15]) / self.focal)

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {**self.frame.to_dict(), "rows": self.rows, "focal": self.focal}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(LocalFrame.from_dict(state), state["rows"], state["focal"])


def omega_phi_kappa(omega: FloatArray, phi: FloatArray, kappa: FloatArray) -> FloatArray:
    """Rotations from ground to image axes, M = R3(κ)·R2(φ)·R1(ω).

    Parameters
    ----------
    omega, phi, kappa : array (N,)
        Radians.

    Returns
    -------
    array (N, 3, 3)
        Rows are the image axes x, y, z in ground components.
    """
    cw, sw, cp, sp, ck, sk = (f(a) for a in (omega, phi, kappa) for f in (np.cos, np.sin))
    rows = [
        [cp * ck, cw * sk + sw * sp * ck, sw * sk - cw * sp * ck],
        [-cp * sk, cw * ck - sw * sp * sk, sw * ck + cw * sp * sk],
        [sp, -sw * cp, cw * cp],
    ]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)
