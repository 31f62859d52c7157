"""Trajectory of the scanner: poses in east, north, up, smooth curves through them, and circular orbits.

In inertial axes the satellite runs on a circle of radius r with the angular speed n = √(GM / r³). At latitude φ of a
sphere the azimuth of that motion is asin(cos i / cos φ) for inclination i, measured at the ascending pass (Vallado,
Fundamentals of Astrodynamics, on launch azimuth). The Earth turns below it by ω = 7.292115e-5 rad/s, which is what
skews the image. The body's axes: down to the ellipsoid, forward along the inertial velocity: no yaw hides the skew.

Time τ counts lines (scanner) or sweeps (sweeps, panoramic camera) from the middle of the image. Attitude is heading,
pitch and roll of aviation: the body's axes are forward, right and down; heading counts clockwise from north, pitch is
positive nose up, roll positive right wing down. Body → north, east, down is Rz(heading)·Ry(pitch)·Rx(roll).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, Protocol, Self

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.crs import geographic
from geomosaic.geo.local_frames import LocalFrame, enu_axes
from geomosaic.geo.transform import Transform
from geomosaic.sensor.ray_corrections import RayCorrection
from geomosaic.types import FloatArray, IntArray

Three = tuple[FloatArray, FloatArray, FloatArray]
STRAIGHT = RayCorrection()


class Sight(NamedTuple):
    """Ground as seen at times, with derivatives.

    Attributes
    ----------
    body : array (N, 3)
        Forward, right, down, in metres.
    by_ground : array (N, 3, 3)
        By east, north, up of the ground; by those of the place but for the sign.
    by_angle : array (N, 3, 3)
        By heading, pitch and roll, per radian.
    by_tau : array (N, 3)
    """

    body: FloatArray
    by_ground: FloatArray
    by_angle: FloatArray
    by_tau: FloatArray


class Flight(Protocol):
    """Flight path as a scan needs it: positions and axes over τ."""

    @property
    def pace(self) -> float:
        """Metres per unit of τ."""

    def around(self, enu: FloatArray, half: float) -> tuple[FloatArray, FloatArray]:
        """Two times (N,) near those at which ground (N, 3) is abeam, for an image from −`half` to `half`."""

    def places(self, tau: FloatArray) -> FloatArray:
        """Projection centres (N, 3) at times (N,)."""

    def to_body(self, enu: FloatArray, tau: FloatArray) -> Three:
        """Ground (N, 3) as seen at times (N,): forward, right, down, in metres."""

    def to_enu(self, body: FloatArray, tau: FloatArray) -> FloatArray:
        """Directions (N, 3) forward, right, down at times (N,) as east, north, up."""

    def sight(self, enu: FloatArray, tau: FloatArray, correction: RayCorrection = STRAIGHT) -> Sight:
        """Ground (N, 3) as seen at times (N,), with derivatives, through an atmosphere that bends rays.

        Parameters
        ----------
        enu : array (N, 3)
            Ground, east, north, up in metres.
        tau : array (N,)
            Times.
        correction : RayCorrection
            Bending of rays by the atmosphere.
        """


@dataclass(frozen=True)
class Turn:
    """Attitude that changes linearly: heading, pitch and roll with their rates.

    Attributes
    ----------
    attitude : array (3,)
        Heading, pitch, roll in radians at τ = 0.
    rates : array (3,)
        Radians per unit of τ.
    """

    attitude: FloatArray
    rates: FloatArray

    def apply(self, north: FloatArray, east: FloatArray, down: FloatArray, tau: FloatArray) -> Three:
        """Components along the axes before the turn (N,) to those after it: forward, right, down.

        Parameters
        ----------
        north, east, down : array (N,)
            Components before the turn.
        tau : array (N,)
        """
        ch, sh, cp, sp, cr, sr = self._turns(tau)
        ahead, aside = north * ch + east * sh, -north * sh + east * ch
        forward, below = cp * ahead - sp * down, sp * ahead + cp * down
        return forward, cr * aside + sr * below, -sr * aside + cr * below

    def undo(self, forward: FloatArray, right: FloatArray, down: FloatArray, tau: FloatArray) -> Three:
        """The inverse of `apply`: north, east, down.

        Parameters
        ----------
        forward, right, down : array (N,)
            Components after the turn.
        tau : array (N,)
        """
        ch, sh, cp, sp, cr, sr = self._turns(tau)
        # Undone in the reverse order: roll, pitch, heading.
        aside, below = cr * right - sr * down, sr * right + cr * down
        ahead, lower = cp * forward + sp * below, -sp * forward + cp * below
        return ch * ahead - sh * aside, sh * ahead + ch * aside, lower

    def sight(
        self,
        line: FloatArray,
        velocity: FloatArray,
        axes: tuple[FloatArray, FloatArray],
        tau: FloatArray,
        correction: RayCorrection,
    ) -> Sight:
        """Lines (N, 3) from moving places to the ground, seen in axes (3, 3, N) of given rates after the turn.

        Parameters
        ----------
        line : array (N, 3)
            From moving places to the ground, metres.
        velocity : array (N, 3)
            Of the places, metres per unit of τ.
        axes : tuple of array (3, 3, N)
            Axes before the turn, and their derivatives by τ.
        tau : array (N,)
        correction : RayCorrection
        """
        bent, slopes = line, np.broadcast_to(np.eye(3), (len(line), 3, 3))
        if not correction.none:
            bent, slopes = np.column_stack(correction.seen(*line.T)), correction.slopes(*line.T)
        unturned, turning = (np.moveaxis(part, 2, 0) for part in axes)
        one, zero = np.ones_like(tau), np.zeros_like(tau)
        columns = ((one, zero, zero), (zero, one, zero), (zero, zero, one))
        turn = np.stack([np.column_stack(self.apply(a, b, c, tau)) for a, b, c in columns], axis=2)
        body = np.einsum("nij,nj->ni", turn @ unturned, bent)
        roll = self.attitude[2] + self.rates[2] * tau
        about_pitch = np.column_stack([np.zeros_like(roll), np.cos(roll), -np.sin(roll)])
        # Each angle turns what is seen backwards about its axis: down before all turns, right before roll, forward.
        about = turn[:, :, 2], about_pitch, np.broadcast_to(np.eye(3)[0], body.shape)
        by_angle = -np.stack([np.cross(axis, body) for axis in about], axis=2)
        by_ground = turn @ unturned @ slopes
        moving = np.einsum("nij,nj->ni", turn @ turning, bent) - np.einsum("nij,nj->ni", by_ground, velocity)
        return Sight(body, by_ground, by_angle, moving + by_angle @ self.rates)

    def _turns(self, tau: FloatArray) -> tuple[FloatArray, ...]:
        heading, pitch, roll = (
            a + rate * tau if rate else a for a, rate in zip(self.attitude, self.rates, strict=True)
        )
        return np.cos(heading), np.sin(heading), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)


@dataclass(frozen=True)
class Track:
    """Straight flight at constant speed, with linearly changing attitude.

    Attributes
    ----------
    position : array (3,)
        East, north, up in metres at τ = 0.
    velocity : array (3,)
        Metres per unit of τ.
    turn : Turn
    """

    position: FloatArray
    velocity: FloatArray
    turn: Turn

    @property
    def pace(self) -> float:
        """Metres per unit of τ."""
        return float(np.linalg.norm(self.velocity))

    def around(self, enu: FloatArray, half: float) -> tuple[FloatArray, FloatArray]:
        """The ends of the image (N,): between them a straight flight changes little."""
        return np.full(len(enu), -half), np.full(len(enu), half)

    def places(self, tau: FloatArray) -> FloatArray:
        """Projection centres (N, 3) at times (N,)."""
        return self.position + tau[:, None] * self.velocity

    def to_body(self, enu: FloatArray, tau: FloatArray) -> Three:
        """Ground (N, 3) as seen at times (N,): forward, right, down, in metres."""
        offset = enu - self.places(tau)
        return self.turn.apply(offset[:, 1], offset[:, 0], -offset[:, 2], tau)

    def to_enu(self, body: FloatArray, tau: FloatArray) -> FloatArray:
        """Directions (N, 3) forward, right, down at times (N,) as east, north, up."""
        north, east, down = self.turn.undo(body[:, 0], body[:, 1], body[:, 2], tau)
        return np.column_stack([east, north, -down])

    def sight(self, enu: FloatArray, tau: FloatArray, correction: RayCorrection = STRAIGHT) -> Sight:
        """Ground (N, 3) as seen at times (N,), with derivatives."""
        line = enu - self.places(tau)
        level = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])[:, :, None]
        axes = np.broadcast_to(level, (3, 3, len(tau)))
        return self.turn.sight(line, np.broadcast_to(self.velocity, line.shape), (axes, 0.0 * axes), tau, correction)


@dataclass(frozen=True, eq=False)
class Poses:
    """Reported positions and attitudes, with smooth curves through them.

    Components of positions and axes run on cubic Hermite curves whose slope at a node is that of the parabola through
    it and its neighbours; the axes are then made orthonormal again. Before the first and after the last pose the flight
    goes on at the velocity it had there, with its attitude.

    Attributes
    ----------
    times : array (K,)
        τ, in order.
    places : array (K, 3)
        East, north, up of the image's frame, metres.
    axes : array (K, 3, 3)
        Rows forward, right, down in east, north, up.
    """

    times: FloatArray
    places: FloatArray
    axes: FloatArray

    @cached_property
    def _values(self) -> FloatArray:
        return np.column_stack([self.places, self.axes.reshape(-1, 9)])

    @cached_property
    def _slopes(self) -> FloatArray:
        edge: Literal[1, 2] = 2 if len(self.times) > 2 else 1
        return np.gradient(self._values, self.times, axis=0, edge_order=edge)

    @cached_property
    def _cubics(self) -> FloatArray:
        """Cubics between poses (48, K − 1): four times 12 components, constant first, 0 to 1 along each interval."""
        values, slopes, width = self._values, self._slopes, np.diff(self.times)[:, None]
        start, end, rise = slopes[:-1] * width, slopes[1:] * width, np.diff(values, axis=0)
        cubics = values[:-1], start, 3.0 * rise - 2.0 * start - end, start + end - 2.0 * rise
        return np.ascontiguousarray(np.column_stack(cubics).T)

    @cached_property
    def pace(self) -> float:
        """Mean speed in metres per unit of τ."""
        steps = np.linalg.norm(np.diff(self.places, axis=0), axis=1)
        return float(steps.sum() / (self.times[-1] - self.times[0]))

    def at(self, tau: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places (3, N) and axes (3, 3, N) at times (N,), by component: a search asks for them millions of times."""
        t = self.times
        inside = np.clip(tau, t[0], t[-1])
        k = np.clip(np.searchsorted(t, inside, side="right") - 1, 0, len(t) - 2)
        u = (inside - t[k]) / (t[k + 1] - t[k])
        c0, c1, c2, c3 = self._cubics.take(k, axis=1).reshape(4, 12, -1)
        found = c0 + u * (c1 + u * (c2 + u * c3))
        # A cubic runs away beyond its nodes; a straight line goes on sensibly for the steps of a search.
        beyond = tau - inside
        if beyond.any():
            first, last = (slope[:3, None] for slope in self._slopes[[0, -1]])
            found[:3] += beyond * np.where(beyond < 0.0, first, last)
        return found[:3], _square(*found[3:].reshape(3, 3, -1))

    def rates(self, tau: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rates of change of `at` per unit of τ: places (3, N) and axes (3, 3, N)."""
        t = self.times
        inside = np.clip(tau, t[0], t[-1])
        k = np.clip(np.searchsorted(t, inside, side="right") - 1, 0, len(t) - 2)
        width = t[k + 1] - t[k]
        u = (inside - t[k]) / width
        c0, c1, c2, c3 = self._cubics.take(k, axis=1).reshape(4, 12, -1)
        found, rates = c0 + u * (c1 + u * (c2 + u * c3)), (c1 + u * (2.0 * c2 + 3.0 * u * c3)) / width
        first, last = (slope[:, None] * (np.arange(12) < 3)[:, None] for slope in self._slopes[[0, -1]])
        rates = np.where(tau < t[0], first, np.where(tau > t[-1], last, rates))
        return rates[:3], _square_rates(found[3:].reshape(3, 3, -1), rates[3:].reshape(3, 3, -1))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {name: getattr(self, name).tolist() for name in ("times", "places", "axes")}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(*(np.array(state[name]) for name in ("times", "places", "axes")))


def _square(forward: FloatArray, right: FloatArray, down: FloatArray) -> FloatArray:
    """Orthonormal axes (3, 3, N) by the Gram-Schmidt process: forward is kept, right next, down completes them."""
    forward = forward / np.sqrt(_dot(forward, forward))
    right = right - _dot(right, forward) * forward
    right /= np.sqrt(_dot(right, right))
    down = np.stack([forward[i - 2] * right[i - 1] - forward[i - 1] * right[i - 2] for i in range(3)])
    return np.stack([forward, right, down])


def _square_rates(axes: FloatArray, rates: FloatArray) -> FloatArray:
    """Rates of change (3, 3, N) of what `_square` makes of axes (3, 3, N) that change at given rates."""
    (_, right, _), (moving, turning, _) = axes, rates
    ahead, aside, _ = _square(*axes)
    length = np.sqrt(_dot(axes[0], axes[0]))
    forward = (moving - _dot(moving, ahead) * ahead) / length
    share = _dot(right, ahead)
    off = right - share * ahead
    change = turning - (_dot(turning, ahead) + _dot(right, forward)) * ahead - share * forward
    side = (change - _dot(change, aside) * aside) / np.sqrt(_dot(off, off))
    down = np.cross(forward, aside, axis=0) + np.cross(ahead, side, axis=0)
    return np.stack([forward, side, down])


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Scalar products (N,) of vectors (3, N); written out, a product of matrices may round a point differently."""
    product: FloatArray = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@dataclass(frozen=True, eq=False)
class Curve:
    """Reported poses with the corrections of an adjustment.

    Attributes
    ----------
    poses : Poses
    shift : array (3,)
        East, north, up in metres at τ = 0.
    drift : array (3,)
        Metres per unit of τ.
    turn : Turn
        From reported to true axes.
    """

    poses: Poses
    shift: FloatArray
    drift: FloatArray
    turn: Turn

    @property
    def pace(self) -> float:
        """Metres per unit of τ."""
        return self.poses.pace

    def around(self, enu: FloatArray, half: float) -> tuple[FloatArray, FloatArray]:
        """Last pose (N,) before ground (N, 3) is abeam, and where the chord to the next pose says it is.

        Both ends of the image for ground that is abeam beyond them.
        """
        # Bisection among the planes of scan of the poses: it costs as much as a single step of the search, and in
        # turbulence, where scans turn back over the ground, it ends where chords across the whole image run about.
        planes, times = self._planes(half)
        low, high = np.zeros(len(enu), dtype=np.intp), np.full(len(enu), len(times) - 1)
        ahead, behind = _before(planes, low, enu), _before(planes, high, enu)
        crossed = (ahead > 0.0) & (behind <= 0.0)
        for _ in range((len(times) - 2).bit_length()):
            middle = (low + high) // 2
            lead = _before(planes, middle, enu)
            upper = lead > 0.0
            low, ahead = np.where(upper, middle, low), np.where(upper, lead, ahead)
            high, behind = np.where(upper, high, middle), np.where(upper, behind, lead)
        with np.errstate(divide="ignore", invalid="ignore"):
            between = times[low] + (times[high] - times[low]) * (ahead / (ahead - behind))
        return np.where(crossed, times[low], -half), np.where(crossed, between, half)

    @cached_property
    def _forward(self) -> FloatArray:
        """Planes of scan (4, K) at the poses: unit normals forward, and their distances from the frame's origin."""
        times = self.poses.times
        normals = self.to_enu(np.tile([1.0, 0.0, 0.0], (len(times), 1)), times).T
        return np.vstack([normals, _dot(normals, self.places(times).T)])

    def _planes(self, half: float) -> tuple[FloatArray, FloatArray]:
        """Planes (4, K) and times (K,) of the poses from the image's begin to its end: a track may turn back after."""
        times = self.poses.times
        first = max(0, int(np.searchsorted(times, -half, side="right")) - 1)
        last = int(np.searchsorted(times, half)) + 1
        return self._forward[:, first:last], times[first:last]

    def places(self, tau: FloatArray) -> FloatArray:
        """Projection centres (N, 3) at times (N,)."""
        return self.poses.at(tau)[0].T + self.shift + tau[:, None] * self.drift

    def to_body(self, enu: FloatArray, tau: FloatArray) -> Three:
        """Ground (N, 3) as seen at times (N,): forward, right, down, in metres."""
        places, axes = self.poses.at(tau)
        offset = enu.T - (places + self.shift[:, None] + tau * self.drift[:, None])
        forward, right, down = (_dot(axis, offset) for axis in axes)
        return self.turn.apply(forward, right, down, tau)

    def to_enu(self, body: FloatArray, tau: FloatArray) -> FloatArray:
        """Directions (N, 3) forward, right, down at times (N,) as east, north, up."""
        _, (forward, right, down) = self.poses.at(tau)
        f, r, d = self.turn.undo(body[:, 0], body[:, 1], body[:, 2], tau)
        return np.column_stack(f * forward + r * right + d * down)

    def sight(self, enu: FloatArray, tau: FloatArray, correction: RayCorrection = STRAIGHT) -> Sight:
        """Ground (N, 3) as seen at times (N,), with derivatives."""
        _, axes = self.poses.at(tau)
        velocity, turning = self.poses.rates(tau)
        return self.turn.sight(enu - self.places(tau), velocity.T + self.drift, (axes, turning), tau, correction)


def _before(planes: FloatArray, index: IntArray, enu: FloatArray) -> FloatArray:
    """Metres (N,) by which ground (N, 3) lies ahead of planes of scan (4, K), each of the plane of its index (N,)."""
    at = planes.take(index, axis=1)
    lead: FloatArray = _dot(at[:3], enu.T) - at[3]
    return lead


@dataclass(frozen=True)
class Refracted:
    """Flight whose lines of sight are bent by the atmosphere, or by the Earth's curvature in the planar treatment.

    Attributes
    ----------
    flight : Flight
    correction : RayCorrection
        About the vertical at the middle of the image.
    """

    flight: Flight
    correction: RayCorrection

    @property
    def pace(self) -> float:
        """Metres per unit of τ."""
        return self.flight.pace

    def around(self, enu: FloatArray, half: float) -> tuple[FloatArray, FloatArray]:
        """As if lines of sight were straight, which misses by a small part of a pixel."""
        return self.flight.around(enu, half)

    def places(self, tau: FloatArray) -> FloatArray:
        """Projection centres (N, 3) at times (N,)."""
        return self.flight.places(tau)

    def to_body(self, enu: FloatArray, tau: FloatArray) -> Three:
        """Ground (N, 3) as seen at times (N,): forward, right, down, in metres."""
        places = self.flight.places(tau)
        return self.flight.to_body(places + np.column_stack(self.correction.seen(*(enu - places).T)), tau)

    def to_enu(self, body: FloatArray, tau: FloatArray) -> FloatArray:
        """Directions (N, 3) forward, right, down at times (N,) as east, north, up."""
        true = self.correction.true(self.flight.to_enu(body, tau))
        return true / np.sqrt(_dot(true.T, true.T))[:, None]

    def sight(self, enu: FloatArray, tau: FloatArray, correction: RayCorrection = STRAIGHT) -> Sight:
        """Ground (N, 3) as seen at times (N,), with derivatives."""
        return self.flight.sight(enu, tau, self.correction)


# Earth's gravitational constant, m³/s² (WGS 84).
GM = 3.986004418e14
# Angular speed of the Earth, rad/s (WGS 84).
SPIN = 7.292115e-5
# Seconds between poses: the curve through them then keeps to the circle within 0.01 mm.
STEP = 0.25


def _inertial_azimuth(inclination: float, latitude: float, *, ascending: bool) -> float:
    """Azimuth of the inertial motion on a circular orbit."""
    # asin(cos i / cos φ), see the head of this module.
    sine = math.cos(inclination) / math.cos(latitude)
    if abs(sine) > 1.0:
        raise InputError(
            f"an orbit of inclination {math.degrees(inclination):g} degrees does not reach the latitude "
            f"{math.degrees(latitude):.2f}",
            hint="check inclination and position",
        )
    return math.asin(sine) if ascending else math.pi - math.asin(sine)


def orbit_poses(frame: LocalFrame, inclination: float, ascending: bool, seconds: float, half: float) -> Poses:
    """Poses of a satellite on a circular orbit through the origin of a frame at τ = 0.

    Parameters
    ----------
    frame : LocalFrame
    inclination : float
        Radians.
    ascending : bool
        Whether it flies north.
    seconds : float
        Of one unit of τ.
    half : float
        τ at the end of the image; the poses reach a tenth beyond.

    Raises
    ------
    InputError
        The orbit does not reach the latitude of the frame.
    """
    start = frame.origin
    # A circular orbit through the given position: its height stays that of the middle of the image.
    radius = float(np.linalg.norm(start))
    up = start / radius
    latitude, longitude = math.asin(up[2]), math.degrees(math.atan2(up[1], up[0]))
    azimuth = _inertial_azimuth(inclination, latitude, ascending=ascending)
    east, north, _ = enu_axes(longitude, math.degrees(latitude))
    ahead = math.sin(azimuth) * east + math.cos(azimuth) * north
    reach = 1.1 * half + 1.0
    count = 2 * max(2, math.ceil(reach * seconds / STEP)) + 1
    tau = np.linspace(-reach, reach, count)
    t = tau * seconds
    n = math.sqrt(GM / radius**3)
    c, s = np.cos(n * t)[:, None], np.sin(n * t)[:, None]
    places = _turned(radius * (c * up + s * ahead), -SPIN * t)
    # The inertial velocity, not that over the ground: no yaw steering follows the turning Earth.
    forward = _turned(c * ahead - s * up, -SPIN * t)
    lonlat = Transform(frame.crs, geographic(frame.crs))(places)
    down = -np.stack([enu_axes(longitude, latitude)[2] for longitude, latitude in lonlat[:, :2]])
    right = np.cross(down, forward)
    right /= np.linalg.norm(right, axis=1)[:, None]
    axes = np.stack([np.cross(right, down), right, down], axis=1)
    return Poses(tau, frame.to_enu(places), axes @ frame.axes.T)


def _turned(xyz: FloatArray, angle: FloatArray) -> FloatArray:
    """Vectors (N, 3) rotated about the Earth's axis by angles (N,): inertial to Earth-fixed where the angle is −ω·t."""
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([c * xyz[:, 0] - s * xyz[:, 1], s * xyz[:, 0] + c * xyz[:, 1], xyz[:, 2]])
