"""Orbit of a radar satellite: positions, velocities and accelerations between its state vectors.

Each interval between two neighbouring states has a polynomial of time of degree 7 at most: through the positions and
velocities of the four states about it (Hermite interpolation), or through the positions of eight where velocities are
not known (Lagrange interpolation). Neighbouring polynomials agree at the state between them, with Hermite in the
velocity too. See any textbook of numerical analysis, for example Stoer and Bulirsch, Introduction to Numerical
Analysis, section 2.1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import BoolArray, FloatArray, IntArray

# Conditions of each polynomial: positions and velocities of four states, or positions of eight.
CONDITIONS = 8
# Metres by which states that are left out may lie off the orbit through the others. Rounded annotations reach 0.01 m;
# velocities in an inertial frame miss the change of Earth-fixed positions by 500 m/s.
LARGEST_MISMATCH = 10.0
# Seconds between two states at most, a tenth of a revolution; and how much larger the largest distance may be.
_LONGEST, _UNEVEN = 600.0, 100.0
# From the Earth's surface to beyond the geostationary orbit: another unit or another frame falls outside.
_POSITIONS, _VELOCITIES = (6.4e6, 5e7), (1e3, 2e4)


@dataclass(frozen=True, eq=False)
class StateVectors:
    """State vectors of a satellite.

    Attributes
    ----------
    times : array (K,)
        Seconds from the epoch of the scene, growing.
    positions : array (K, 3)
        Geocentric and Earth-fixed (EPSG:4978), metres.
    velocities : array (K, 3), optional
        In the same rotating frame, metres per second.
    """

    times: FloatArray
    positions: FloatArray
    velocities: FloatArray | None = None

    @classmethod
    def checked(cls, times: FloatArray, positions: FloatArray, velocities: FloatArray | None, where: str) -> Self:
        """State vectors in the order of time, found to be those of a satellite.

        Parameters
        ----------
        times : array (K,)
        positions : array (K, 3)
        velocities : array (K, 3) or None
        where : str
            File, named in errors.

        Raises
        ------
        InputError
            Too few states, two of one time, or positions and velocities that no satellite has.
        """
        order = np.argsort(times, kind="stable")
        t, p = times[order], positions[order]
        v = None if velocities is None else velocities[order]
        # One more than a cubic takes: without one that can be left out the error of the orbit is not known.
        least = 3 if v is not None else 5
        if len(t) < least or not (np.diff(t) > 0.0).all():
            raise InputError(
                f"{len(t)} state vectors do not make an orbit",
                where=where,
                hint="at least 3 of different times are needed, or 5 where they have no velocities",
            )
        gaps = np.diff(t)
        if gaps.max() > _UNEVEN * gaps.min() or gaps.max() > _LONGEST:
            raise InputError(
                f"the state vectors are {gaps.min():g} to {gaps.max():g} s apart, too uneven or too far to interpolate",
                where=where,
                hint="correct their times; products have one every 1 to 60 s",
            )
        for values, (low, high), words in ((p, _POSITIONS, "positions"), (v, _VELOCITIES, "velocities")):
            if values is None:
                continue
            length = np.linalg.norm(values, axis=1)
            if not ((length > low) & (length < high)).all():
                raise InputError(
                    f"the {words} of the state vectors are not those of a satellite",
                    where=where,
                    hint="they must be geocentric and Earth-fixed (EPSG:4978), in metres and metres per second",
                )
        return cls(t, p, v)

    def without(self, index: int) -> StateVectors:
        """The same without one state."""
        kept = np.arange(len(self.times)) != index
        return StateVectors(
            self.times[kept], self.positions[kept], None if self.velocities is None else self.velocities[kept]
        )

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "times": self.times.tolist(),
            "positions": self.positions.tolist(),
            "velocities": None if self.velocities is None else self.velocities.tolist(),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """State vectors of a state, as `to_dict` gives it."""
        velocities = state["velocities"]
        return cls(
            np.array(state["times"]),
            np.array(state["positions"]),
            None if velocities is None else np.array(velocities),
        )


@dataclass(frozen=True, eq=False)
class Orbit:
    """Orbit interpolated between state vectors.

    Attributes
    ----------
    states : StateVectors
    pieces : array (I, D, 3)
        Coefficients, highest power first, of the polynomials of the I intervals between states: position in metres from
        that of the state at which the interval begins, over (time − middle of the interval) / half its length.
    """

    states: StateVectors
    pieces: FloatArray

    @classmethod
    def through(cls, states: StateVectors) -> Self:
        """Orbit through state vectors.

        Parameters
        ----------
        states : StateVectors
            At least three with velocities, or five.
        """
        pieces = [_piece(states, interval) for interval in range(len(states.times) - 1)]
        return cls(states, np.array(pieces))

    @property
    def span(self) -> tuple[float, float]:
        """First and last time that the states cover, seconds."""
        return float(self.states.times[0]), float(self.states.times[-1])

    def within(self, times: FloatArray) -> BoolArray:
        """Which times (N,) lie between the states, or beyond them by their distance at most."""
        t = self.states.times
        within: BoolArray = (times >= t[0] - (t[1] - t[0])) & (times <= t[-1] + (t[-1] - t[-2]))
        return within

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity and acceleration at times.

        Parameters
        ----------
        times : array (N,)
            Seconds from the epoch of the scene; beyond the states the outer polynomials go on.

        Returns
        -------
        positions, velocities, accelerations : array (N, 3)
            Geocentric and Earth-fixed; metres, seconds. Derivatives are those of the interpolated positions.
        """
        known = self.states.times
        interval = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(self.pieces) - 1)
        half = 0.5 * (known[1:] - known[:-1])[interval]
        u = ((times - known[interval]) / half - 1.0)[:, None]
        position, velocity, acceleration = (np.zeros((len(times), 3)) for _ in range(3))
        # Horner's rule for a polynomial and its first two derivatives (the second halved).
        for power in range(self.pieces.shape[1]):
            acceleration = acceleration * u + velocity
            velocity = velocity * u + position
            position = position * u + self.pieces[interval, power]
        position += self.states.positions[interval]
        rate = 1.0 / half[:, None]
        return position, velocity * rate, 2.0 * acceleration * rate * rate

    def mismatch(self) -> float:
        """Largest distance of an inner state from the orbit through all others, metres.

        It bounds the error of the interpolation between states, as leaving a state out doubles their distance.
        """
        worst = 0.0
        for index in range(1, len(self.states.times) - 1):
            there = Orbit.through(self.states.without(index)).at(self.states.times[index : index + 1])[0]
            worst = max(worst, float(np.linalg.norm(there[0] - self.states.positions[index])))
        return worst


def _piece(states: StateVectors, interval: int) -> FloatArray:
    """Coefficients (D, 3), highest power first, of the polynomial of one interval between states."""
    known, velocities = states.times, states.velocities
    half = 0.5 * float(known[interval + 1] - known[interval])
    nodes = _nodes(len(known), interval, CONDITIONS // (1 if velocities is None else 2))
    u = (known[nodes] - known[interval]) / half - 1.0
    rows = [np.vander(u, len(u) * (1 if velocities is None else 2))]
    values = [states.positions[nodes] - states.positions[interval]]
    if velocities is not None:
        powers = np.arange(rows[0].shape[1] - 1, 0, -1)
        slopes = np.zeros_like(rows[0])
        slopes[:, :-1] = powers * np.vander(u, len(powers))
        rows.append(slopes)
        values.append(velocities[nodes] * half)
    found: FloatArray = np.linalg.solve(np.vstack(rows), np.vstack(values))
    missing = CONDITIONS - len(found)
    return np.vstack([np.zeros((missing, 3)), found]) if missing else found


def _nodes(count: int, interval: int, wanted: int) -> IntArray:
    """Numbers of the states about an interval, as many before it as after where there are."""
    number = min(wanted, count)
    first = min(max(interval + 1 - math.ceil(number / 2), 0), count - number)
    return np.arange(first, first + number)


def require_orbit(orbit: Orbit, first: float, last: float, where: str) -> None:
    """Check that state vectors cover a scene and agree with each other.

    Parameters
    ----------
    orbit : Orbit
    first, last : float
        Times of the first and the last row, seconds from the epoch of the scene.
    where : str
        File, named in errors.

    Raises
    ------
    InputError
        Rows lie outside the states, or states contradict their neighbours.
    """
    begin, end = orbit.span
    if first < begin or last > end:
        raise InputError(
            f"the orbit is too short: from the first row its state vectors cover {begin - first:.3f} to "
            f"{end - first:.3f} s, the rows of the scene 0 to {last - first:.3f} s",
            where=where,
            hint="give state vectors from before the first row to after the last one, and check that the times of both "
            "count from one epoch",
        )
    off = orbit.mismatch()
    if not off <= LARGEST_MISMATCH:
        raise InputError(
            f"the state vectors contradict each other: one lies {off:.3g} m off the orbit through the others",
            where=where,
            hint="check times and positions; velocities must be those in the Earth-fixed frame, not inertial ones",
        )
