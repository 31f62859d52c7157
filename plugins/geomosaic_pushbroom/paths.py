"""Flight paths of a scanner over time: orbit and attitude samples, angles or quaternions, tables of poses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal, Protocol, Self

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray
from geomosaic_pushbroom.pose import (
    Pose,
    cross,
    interpolation_slopes,
    matrices_of_quaternions,
    matrix_rates,
    satellite_pose,
    satellite_rates,
    turned,
    turning_axes,
    unit,
    unit_rates,
)

# Ephemeris points taken together, as the SPOT Geometry Handbook has it.
NODES = 8


@dataclass(frozen=True, eq=False)
class Orbit:
    """Lagrange polynomial through the ephemeris points about a scene.

    The nodes are chosen once for the scene, so that its orbit is one smooth curve, and the polynomial is written in
    powers of time: evaluating it is then a few products.

    Attributes
    ----------
    span : float
        Seconds of u = 1, where u = t / span; t counts from the middle of the scene.
    range : tuple of float
        First and last time that the nodes cover, in seconds.
    position, velocity : array (K, 3)
        Coefficients of powers of u; geocentric metres, metres per second.
    """

    span: float
    range: tuple[float, float]
    position: FloatArray
    velocity: FloatArray

    @classmethod
    def through(cls, times: FloatArray, positions: FloatArray, velocities: FloatArray, where: str) -> Self:
        """Orbit through the eight points about time 0, all where there are fewer.

        Parameters
        ----------
        times : array (K,)
            Seconds from the middle of the scene.
        positions, velocities : array (K, 3)
            Geocentric; metres, metres per second.
        where : str
            File, named in errors.

        Raises
        ------
        InputError
            Fewer than four points, two of one time, none on one side of the scene, or no satellite's orbit.
        """
        order = np.argsort(times, kind="stable")
        t, p, v = times[order], positions[order], velocities[order]
        if len(t) < 4 or not (np.diff(t) > 0.0).all() or not t[0] < 0.0 < t[-1]:
            raise InputError(
                f"{len(t)} ephemeris points do not give an orbit about the scene",
                where=where,
                hint="at least four are needed, of different times, before and after the middle of the scene",
            )
        # From the Earth's surface to beyond the geostationary orbit: another unit or another frame falls outside.
        for values, least, most, words in ((p, 6.4e6, 5e7, "positions"), (v, 1e3, 2e4, "velocities")):
            known = np.isfinite(values).all() and np.abs(values).max() < most
            length = np.linalg.norm(values, axis=1) if known else np.zeros(1)
            if not ((length > least) & (length < most)).all():
                raise InputError(
                    f"{words} of the ephemeris are not those of a satellite",
                    where=where,
                    hint="they must be Earth-centred (ITRF), in metres and metres per second",
                )
        first = int(np.clip(np.searchsorted(t, 0.0) - NODES // 2, 0, max(0, len(t) - NODES)))
        chosen = slice(first, first + NODES)
        # A polynomial through many points swings at its ends; eight about the scene put it in the middle of the curve.
        t, p, v = t[chosen], p[chosen], v[chosen]
        span = float(np.abs(t).max())
        # Times of -1 to 1 keep the powers of the polynomial apart: in seconds the system would be singular.
        powers = np.vander(t / span, increasing=True)
        both = np.asarray(np.linalg.solve(powers, np.column_stack([p, v])), dtype=np.float64)
        return cls(span, (float(t[0]), float(t[-1])), both[:, :3], both[:, 3:])

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions and velocities (N, 3) at times (N,) in seconds; NaN outside the ephemeris."""
        # A polynomial of the seventh degree runs away beyond its nodes.
        u = np.where((times >= self.range[0]) & (times <= self.range[1]), times, np.nan)[:, None] / self.span
        return horner(self.position, u), horner(self.velocity, u)

    def rates(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rates of change (N, 3) of the positions and velocities of `at`."""
        u = times[:, None] / self.span
        return _horner_slope(self.position, u) / self.span, _horner_slope(self.velocity, u) / self.span

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "span": self.span,
            "range": list(self.range),
            "position": self.position.tolist(),
            "velocity": self.velocity.tolist(),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        first, last = state["range"]
        return cls(state["span"], (first, last), np.array(state["position"]), np.array(state["velocity"]))


def horner(coefficients: FloatArray, u: FloatArray) -> FloatArray:
    """Polynomials of several components, by Horner's rule.

    Parameters
    ----------
    coefficients : array (K, D)
        Lowest power first.
    u : array (N, 1)

    Returns
    -------
    array (N, D)
    """
    total = np.broadcast_to(coefficients[-1], (len(u), coefficients.shape[1]))
    for row in coefficients[-2::-1]:
        total = total * u + row
    return total


def _horner_slope(coefficients: FloatArray, u: FloatArray) -> FloatArray:
    """Derivatives (N, D) of `horner` by u."""
    if len(coefficients) == 1:
        return np.zeros((len(u), coefficients.shape[1]))
    return horner(coefficients[1:] * np.arange(1, len(coefficients))[:, None], u)


# Attitudes of these missions are small about their orbital axes; values in degrees exceed this at once.
_STEEPEST = 0.2  # radians, and radians per second


def samples_in_order(times: FloatArray, values: FloatArray, what: str, where: str) -> tuple[FloatArray, FloatArray]:
    """Attitude samples in the order of time.

    Parameters
    ----------
    times : array (K,)
        Seconds.
    values : array (K, 3)
        Pitch, roll, yaw in radians, or their speeds in radians per second.
    what : str
        Name of the list, for the message.
    where : str
        Named in errors.

    Returns
    -------
    times : array (K,)
    values : array (K, 3)

    Raises
    ------
    InputError
        There is none, two have one time, or they are no radians; names the list.
    """
    order = np.argsort(times, kind="stable")
    times, values = times[order], values[order]
    if not len(times) or not (np.diff(times) > 0.0).all():
        raise InputError(f"{what} is empty, or has two values of one time", where=where, hint="get the file again")
    if not np.abs(values).max() <= _STEEPEST:
        raise InputError(
            f"{what} reaches {np.abs(values).max():g}: these are no radians", where=where, hint="get the file again"
        )
    return times, values


def require_cover(times: FloatArray, rows: int, middle: float, period: float, where: str) -> None:
    """Check that attitudes reach over the scene, up to a tenth of it, and that the line period is one.

    Parameters
    ----------
    times : array (K,)
        Of the attitudes, seconds from the row `middle`.
    rows : int
        Of the scene.
    middle : float
        Row at which the times are 0.
    period : float
        Seconds per row.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The line period is none, or the attitudes leave out more than a tenth of the scene.
    """
    if not 0.0 < period < 1.0:
        raise InputError(f"the line period is {period:g} s", where=where, hint="get the file again")
    first, last = -middle * period, (rows - middle) * period
    lost = max(times[0] - first, last - times[-1])
    if lost > 0.1 * (last - first):
        raise InputError(
            f"the attitudes leave {lost:.2f} s of the scene out, which takes {last - first:.2f} s",
            where=where,
            hint="get the whole file: attitudes must cover the scene",
        )


@dataclass(frozen=True, eq=False)
class QuaternionTable:
    """Orbit with quaternions linear between the times of a table, and normalised.

    Beyond its ends the table goes on at the mean speed of its outer tenth, for as long as its own duration.

    Attributes
    ----------
    orbit : Orbit
    times : array (K,)
        Seconds from the middle of the scene.
    quaternions : array (K, 4)
        From satellite to geocentric axes, see `satellite_pose`; neighbours of the same sign.
    """

    kind: ClassVar[str] = "quaternion_table"
    orbit: Orbit
    times: FloatArray
    quaternions: FloatArray

    @cached_property
    def _nodes(self) -> tuple[FloatArray, FloatArray]:
        t, q = self.times, self.quaternions
        back = max(1, len(t) // 10)
        length = t[-1] - t[0]
        first = q[0] - (q[back] - q[0]) * (length / (t[back] - t[0]))
        last = q[-1] + (q[-1] - q[-1 - back]) * (length / (t[-1] - t[-1 - back]))
        return np.concatenate([[t[0] - length], t, [t[-1] + length]]), np.vstack([first, q, last])

    def pose(self, times: FloatArray) -> Pose:
        """Pose at times (N,)."""
        position, _ = self.orbit.at(times)
        nodes, values = self._nodes
        return satellite_pose(position, np.column_stack([np.interp(times, nodes, column) for column in values.T]))

    def rates(self, times: FloatArray) -> Pose:
        """Rates of change of the pose per second at times (N,)."""
        nodes, values = self._nodes
        q = np.column_stack([np.interp(times, nodes, column) for column in values.T])
        return satellite_rates(self.orbit.rates(times)[0], q, interpolation_slopes(times, nodes, values))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        table = {"times": self.times.tolist(), "quaternions": self.quaternions.tolist()}
        return {"orbit": self.orbit.to_dict(), **table}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(Orbit.from_dict(state["orbit"]), np.array(state["times"]), np.array(state["quaternions"]))


class Path(Protocol):
    """Flight path as reported; x right, y forward, z up in the scanner's axes."""

    kind: ClassVar[str]

    def pose(self, times: FloatArray) -> Pose:
        """Pose at times (N,), seconds from the middle of the scene; NaN where nothing is known."""

    def rates(self, times: FloatArray) -> Pose:
        """Rates of change of the pose per second at times (N,)."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""


@dataclass(frozen=True, eq=False)
class AnglePath:
    """Orbit with attitude angles about the orbital axes (SPOT 1 to 5).

    z is the direction from the Earth's centre, x = velocity × z, y = z × x; velocity is that in the turning Earth's
    frame, as the ephemeris gives it. The angles are interpolated linearly and stay as they are beyond their ends.

    Attributes
    ----------
    orbit : Orbit
    times : array (K,)
        Of the angles, seconds from the middle of the scene.
    angles : array (K, 3)
        Pitch, roll, yaw in radians, see `pose.turned`.
    """

    kind: ClassVar[str] = "angles"
    orbit: Orbit
    times: FloatArray
    angles: FloatArray

    def pose(self, times: FloatArray) -> Pose:
        """Pose at times (N,)."""
        position, velocity = self.orbit.at(times)
        # Not the ellipsoid's normal: SPOT's orbital axes refer to the Earth's centre.
        z = unit(position)
        x = unit(cross(velocity, z))
        axes = np.stack([x, cross(z, x), z], axis=1)
        pitch, roll, yaw = (np.interp(times, self.times, column) for column in self.angles.T)
        return Pose(position, turned(axes, pitch, roll, yaw))

    def rates(self, times: FloatArray) -> Pose:
        """Rates of change of the pose per second at times (N,)."""
        (position, velocity), (moving, speeding) = self.orbit.at(times), self.orbit.rates(times)
        z, dz = unit(position), unit_rates(position, moving)
        across, turning = cross(velocity, z), cross(speeding, z) + cross(velocity, dz)
        x, dx = unit(across), unit_rates(across, turning)
        angles = tuple(np.interp(times, self.times, column) for column in self.angles.T)
        axes = turned(np.stack([x, cross(z, x), z], axis=1), *angles)
        changing = turned(np.stack([dx, cross(dz, x) + cross(z, dx), dz], axis=1), *angles)
        speeds = interpolation_slopes(times, self.times, self.angles)
        turn = sum(axis * speed[:, None] for axis, speed in zip(turning_axes(*angles), speeds.T, strict=True))
        return Pose(moving, changing + np.stack([cross(turn, axes[:, :, i]) for i in range(3)], axis=2))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"orbit": self.orbit.to_dict(), "times": self.times.tolist(), "angles": self.angles.tolist()}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(Orbit.from_dict(state["orbit"]), np.array(state["times"]), np.array(state["angles"]))


@dataclass(frozen=True, eq=False)
class QuaternionPath:
    """Orbit with a polynomial for each component of the quaternion from satellite to geocentric axes (Pléiades).

    Of the satellite's axes the first points forward, the second right and the third to the ground.

    Attributes
    ----------
    orbit : Orbit
    offset, scale : float
        Seconds: the polynomials run over (t − offset) / scale.
    quaternion : array (K, 4)
        Coefficients, lowest power first; scalar component first.
    """

    kind: ClassVar[str] = "quaternions"
    orbit: Orbit
    offset: float
    scale: float
    quaternion: FloatArray

    def pose(self, times: FloatArray) -> Pose:
        """Pose at times (N,)."""
        position, _ = self.orbit.at(times)
        return satellite_pose(position, horner(self.quaternion, (times[:, None] - self.offset) / self.scale))

    def rates(self, times: FloatArray) -> Pose:
        """Rates of change of the pose per second at times (N,)."""
        u = (times[:, None] - self.offset) / self.scale
        q, speeds = horner(self.quaternion, u), _horner_slope(self.quaternion, u) / self.scale
        return satellite_rates(self.orbit.rates(times)[0], q, speeds)

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        numbers = {"offset": self.offset, "scale": self.scale, "quaternion": self.quaternion.tolist()}
        return {"orbit": self.orbit.to_dict(), **numbers}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(Orbit.from_dict(state["orbit"]), state["offset"], state["scale"], np.array(state["quaternion"]))


@dataclass(frozen=True, eq=False)
class TrackPath:
    """Poses of a table from GNSS and inertial measurement, on smooth curves.

    Positions and components of quaternions run on cubic Hermite curves whose slope at a node is that of the parabola
    through it and its neighbours; quaternions are then brought to length one. Before the first and after the last pose
    the flight goes on at its mean speed.

    Attributes
    ----------
    times : array (K,)
        Seconds from the middle of the scene.
    positions : array (K, 3)
        Geocentric metres.
    quaternions : array (K, 4)
        From the scanner's to geocentric axes, scalar first, neighbours of the same sign.
    """

    kind: ClassVar[str] = "track"
    times: FloatArray
    positions: FloatArray
    quaternions: FloatArray

    @cached_property
    def _curve(self) -> tuple[FloatArray, FloatArray]:
        """Values at the nodes relative to the first (K, 7), and their slopes."""
        # Relative to the first position: geocentric coordinates of 6e6 m would cost the curve digits.
        values = np.column_stack([self.positions - self.positions[0], self.quaternions])
        edge: Literal[1, 2] = 2 if len(self.times) > 2 else 1
        return values, np.gradient(values, self.times, axis=0, edge_order=edge)

    def pose(self, times: FloatArray) -> Pose:
        """Pose at times (N,)."""
        found, _, beyond, speed = self._at(times)
        position = self.positions[0] + found[:, :3] + beyond[:, None] * speed
        return Pose(position, np.ascontiguousarray(matrices_of_quaternions(found[:, 3:]).transpose(0, 2, 1)))

    def rates(self, times: FloatArray) -> Pose:
        """Rates of change of the pose per second at times (N,)."""
        found, rates, beyond, speed = self._at(times)
        rates = np.where((beyond == 0.0)[:, None], rates, 0.0)
        velocity = rates[:, :3] + np.where((beyond == 0.0)[:, None], 0.0, speed)
        return Pose(velocity, matrix_rates(found[:, 3:], rates[:, 3:]).transpose(0, 2, 1))

    def _at(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Values (N, 7) of the curve and their rates, seconds (N,) beyond its ends, and mean speed (3,)."""
        t = self.times
        # A cubic runs away beyond its nodes; there the flight goes on straight, at its mean speed.
        inside = np.clip(times, t[0], t[-1])
        k = np.clip(np.searchsorted(t, inside, side="right") - 1, 0, len(t) - 2)
        width = (t[k + 1] - t[k])[:, None]
        u = (inside - t[k])[:, None] / width
        values, slopes = self._curve
        first, last, start, end = values[k], values[k + 1], slopes[k] * width, slopes[k + 1] * width
        rise = last - first
        second, third = 3.0 * rise - 2.0 * start - end, start + end - 2.0 * rise
        found = first + u * (start + u * (second + u * third))
        rates = (start + u * (2.0 * second + u * 3.0 * third)) / width
        return found, rates, times - inside, (self.positions[-1] - self.positions[0]) / (t[-1] - t[0])

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        names = ("times", "positions", "quaternions")
        return {name: getattr(self, name).tolist() for name in names}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(np.array(state["times"]), np.array(state["positions"]), np.array(state["quaternions"]))


PATHS: dict[str, type[AnglePath] | type[QuaternionPath] | type[QuaternionTable] | type[TrackPath]] = {
    path.kind: path for path in (AnglePath, QuaternionPath, QuaternionTable, TrackPath)
}
