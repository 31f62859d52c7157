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
from numpy.polynomial.legendre import legder, legval, legvander

from geomosaic.geo.local_frames import LocalFrame
from geomosaic.types import FloatArray
from geomosaic_pushbroom.paths import PATHS, Path
from geomosaic_pushbroom.pose import Pose, combined, components, cross, turned, turning_axes


class LineDistortion(NamedTuple):
    """Changes of the look directions over the line: multiples of its second Legendre polynomial, as slopes.

    Attributes
    ----------
    stretch : float
        Across the flight.
    bend : float
        Along the flight.
    """

    stretch: Any = 0.0
    bend: Any = 0.0


class Sight(NamedTuple):
    """Components (N, 3) of ground points in the scanner's axes at their rows, and their derivatives.

    Attributes
    ----------
    seen : array (N, 3)
        Metres.
    by_values : array (N, 3, P)
        Per unit of each parameter.
    by_row : array (N, 3)
    by_ground : array (N, 3, 3)
        The scanner's axes.
    """

    seen: FloatArray
    by_values: FloatArray
    by_row: FloatArray
    by_ground: FloatArray


class Platform(Protocol):
    """Poses over image rows."""

    kind: ClassVar[str]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""

    def pose(self, values: FloatArray, rows: FloatArray) -> Pose:
        """Pose at image rows (N,) with parameter values (P,)."""

    def sight(self, values: FloatArray, rows: FloatArray, xyz: FloatArray) -> Sight:
        """Geocentric ground (N, 3) as seen at image rows (N,), with derivatives.

        Parameters
        ----------
        values : array (P,)
            Of the platform's parameters.
        rows : array (N,)
            Image rows.
        xyz : array (N, 3)
            Geocentric ground, metres.
        """

    def bend(self, values: FloatArray) -> LineDistortion:
        """Changes of the look directions with parameter values (P,)."""

    def bend_slopes(self) -> LineDistortion:
        """Derivatives of these by the parameters, (P,) each."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""


CORRECTIONS = ("roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate", "across", "along", "up", "time")
# Degree of the attitude's corrections: beyond, neighbouring coefficients are as good as free between measured points.
HIGHEST_DEGREE = 12


@dataclass(frozen=True, eq=False)
class ReportedFlight:
    """Reported flight with corrections that control points determine.

    With t the seconds from the middle of the scene, the pose of the path at t + `time` is moved by (across, along, up)
    along its own axes and then turned by `pose.turned` with pitch + pitch_rate·t + Σ pitch_k·P_k(t / half), k from 2 to
    `degree`, and so on. Legendre polynomials P_k say nothing of the mean and the trend over the scene, so that what
    they tell is not told twice.

    Attributes
    ----------
    path : Path
        Flight as it was reported.
    period : float
        Seconds from one row to the next.
    middle : float
        Row at t = 0.
    half : float
        Seconds of half a scene.
    degree : int
        Of the corrections of the attitude: 1 has a trend.
    """

    kind: ClassVar[str] = "flight"
    path: Path
    period: float
    middle: float
    half: float = 1.0
    degree: int = 1

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        curves = (f"{angle}_{k}" for angle in CORRECTIONS[:3] for k in range(2, self.degree + 1))
        return (*CORRECTIONS, *curves)

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        return ("deg",) * 3 + ("deg/s",) * 3 + ("m",) * 3 + ("s",) + ("deg",) * (3 * (self.degree - 1))

    def _turns(self, values: FloatArray, t: FloatArray) -> FloatArray:
        """Roll, pitch and yaw (3, N) at times (N,), in radians."""
        turns: FloatArray = values[:3, None] + values[3:6, None] * t
        if self.degree > 1:
            turns = turns + values[10:].reshape(3, -1) @ legvander(t / self.half, self.degree)[:, 2:].T
        return np.radians(turns)

    def pose(self, values: FloatArray, rows: FloatArray) -> Pose:
        """Pose at rows (N,)."""
        t = (rows - self.middle) * self.period
        position, axes = self.path.pose(t + values[9])
        shift = np.broadcast_to(values[6:9], position.shape)
        roll, pitch, yaw = self._turns(values, t)
        return Pose(position + combined(axes, shift), turned(axes, pitch, roll, yaw))

    def sight(self, values: FloatArray, rows: FloatArray, xyz: FloatArray) -> Sight:
        """Geocentric ground (N, 3) as seen at rows (N,), with derivatives."""
        t = (rows - self.middle) * self.period
        (position, axes), (velocity, turning) = self.path.pose(t + values[9]), self.path.rates(t + values[9])
        roll, pitch, yaw = self._turns(values, t)
        turn = turned(np.broadcast_to(np.eye(3), axes.shape), pitch, roll, yaw)
        seen = components(turn, components(axes, xyz - position) - values[6:9])
        about = turning_axes(pitch, roll, yaw)
        by_values = np.empty((len(rows), 3, len(self.names)))
        # The parameters are roll, pitch, yaw in degrees, the axes those of pitch, roll, yaw.
        for index, axis in enumerate((about[1], about[0], about[2])):
            by_values[:, :, index] = np.radians(cross(axis, seen))
            by_values[:, :, index + 3] = by_values[:, :, index] * t[:, None]
        by_values[:, :, 6:9] = -turn
        by_values[:, :, 9] = components(turn, components(turning, xyz - position) - components(axes, velocity))
        by_time = by_values[:, :, 9] + by_values[:, :, :3] @ values[3:6]
        if self.degree > 1:
            s, curves = t / self.half, values[10:].reshape(3, -1)
            powers = legvander(s, self.degree)[:, None, None, 2:]
            by_values[:, :, 10:] = (by_values[:, :, :3, None] * powers).reshape(len(rows), 3, -1)
            slopes = legval(s, legder(np.hstack([np.zeros((3, 2)), curves]).T)) / self.half
            by_time += np.einsum("nij,jn->ni", by_values[:, :, :3], slopes)
        return Sight(seen, by_values, self.period * by_time, turned(axes, pitch, roll, yaw))

    def bend(self, values: FloatArray) -> LineDistortion:
        """The look directions are those of the calibration."""
        return LineDistortion()

    def bend_slopes(self) -> LineDistortion:
        """No parameter changes them."""
        return LineDistortion(0.0, 0.0)

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        more = {"half": self.half, "degree": self.degree} if self.degree > 1 else {}
        return {"path": self.path.kind, **self.path.to_dict(), "period": self.period, "middle": self.middle, **more}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        more = {name: state[name] for name in ("half", "degree") if name in state}
        return cls(PATHS[state["path"]].from_dict(state), state["period"], state["middle"], **more)


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
        local, (omega, phi, kappa) = self._local(values, rows)
        matrices = omega_phi_kappa(omega, phi, kappa)
        e, n, u = self.frame.axes
        position = self.frame.origin + local[:, :1] * e + local[:, 1:2] * n + local[:, 2:] * u
        axes = matrices[:, :, :1] * e + matrices[:, :, 1:2] * n + matrices[:, :, 2:] * u
        return Pose(position, axes)

    def _local(self, values: FloatArray, rows: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """Position (N, 3) in the frame, and omega, phi, kappa (N,) in radians."""
        share = (rows / self.rows)[:, None]
        start, end = self.ends(values)
        s, curve = self._time(rows)
        angles = [np.radians(values[6 + i] + values[9 + i] * s + values[12 + i] * curve) for i in range(3)]
        return start + share * (end - start), angles

    def _time(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """s, −1 to 1 over the rows, and its second Legendre polynomial."""
        s = 2.0 * (rows / self.rows) - 1.0
        # The second Legendre polynomial is orthogonal to 1 and s: squared terms hardly correlate with the others.
        return s, 1.5 * s * s - 0.5

    def sight(self, values: FloatArray, rows: FloatArray, xyz: FloatArray) -> Sight:
        """Geocentric ground (N, 3) as seen at rows (N,), with derivatives."""
        local, angles = self._local(values, rows)
        matrices = omega_phi_kappa(*angles)
        seen = components(matrices, self.frame.to_enu(xyz) - local)
        zero, one = np.zeros_like(rows), np.ones_like(rows)
        kappa = angles[2]
        about = (
            matrices[:, :, 0],
            np.column_stack([np.sin(kappa), np.cos(kappa), zero]),
            np.column_stack([zero, zero, one]),
        )
        s, curve = self._time(rows)
        by_values = np.zeros((len(rows), 3, len(self.names)))
        for i, axis in enumerate(about):
            # Of R3·R2·R1 each angle turns what is seen backwards about its axis.
            by_angle = -np.radians(cross(axis, seen))
            for first, factor in ((6, one), (9, s), (12, curve)):
                by_values[:, :, first + i] = by_angle * factor[:, None]
        by_row = (by_values[:, :, 6:9] @ (2.0 * values[9:12, None] + 6.0 * s[:, None, None] * values[12:15, None]))[
            ..., 0
        ]
        share = rows / self.rows
        for weight, end, by_end in zip((1.0 - share, share), (0, 3), self._end_slopes(values), strict=True):
            columns = [end, end + 1, end + 2, 6, 7, 9, 10]
            by_values[:, :, columns] -= weight[:, None, None] * (matrices @ by_end)
        start, last = self.ends(values)
        by_row = (by_row - matrices @ (last - start)) / self.rows
        return Sight(seen, by_values, by_row, matrices @ self.frame.axes)

    def _end_slopes(self, values: FloatArray) -> list[FloatArray]:
        """Derivatives (3, 7) of A and of E by their x, y and distance, and by omega, phi, omega1, phi1."""
        found = []
        for sign, distance in ((-1.0, values[2]), (1.0, values[5])):
            (cw, cp), (sw, sp) = (f(np.radians(values[6:8] + sign * values[9:11])) for f in (np.cos, np.sin))
            by_omega = np.radians(distance) * np.array([0.0, -cw * cp, -sw * cp])
            by_phi = np.radians(distance) * np.array([cp, sw * sp, -cw * sp])
            z = np.array([sp, -sw * cp, cw * cp])
            x, y, _ = np.eye(3)
            found.append(np.column_stack([x, y, z, by_omega, by_phi, sign * by_omega, sign * by_phi]))
        return found

    def bend(self, values: FloatArray) -> LineDistortion:
        """Bend and stretch of the line, pixels to slopes."""
        return LineDistortion(float(values[16]) / self.focal, float(values[15]) / self.focal)

    def bend_slopes(self) -> LineDistortion:
        """Derivatives of these by the parameters, (P,) each."""
        one = np.eye(len(self.names)) / self.focal
        return LineDistortion(one[16], one[15])

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
