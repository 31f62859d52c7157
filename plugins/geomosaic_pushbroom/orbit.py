"""Orbit and attitude samples over time: positions, velocities and angles at any time of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray

NODES = 8
"""Ephemeris points taken together, as the SPOT Geometry Handbook has it."""


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
    result: FloatArray = total
    return result


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
