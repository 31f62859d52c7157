"""Rolling shutter: rows of a photo that are exposed one after the other while the camera moves.

    X in camera axes = R(a + t·w) · (X − C − t·v),   t = from −1/2 at the first row to 1/2 at the last

C and the angles a are those in the middle of the readout; v is the way and w the change of the angles during it. The
row in which a point is seen follows from its own time: m = f(X, t(m)), and by differentiation of that

    dm = (I − f_t·tᵀ)⁻¹ · df,   f_t the change of the image with time, t the change of time with the image
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.local_frames import r2, r3
from geomosaic.sensor.inputs import choice, known_keys, need, positive
from geomosaic.types import FloatArray
from geomosaic_frame.orientation import FLIP

NAMES = ("motion_east", "motion_north", "motion_up", "turn_omega", "turn_phi", "turn_kappa")
# Derivative of R(t)·v by t is −e×(R·v): the cross-product matrices of the axes, negated.
TURNS = (
    np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
    np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
)
# Axis (column, row) and sign in which time grows.
DIRECTIONS = {"down": (1, 1.0), "up": (1, -1.0), "right": (0, 1.0), "left": (0, -1.0)}
# Seconds beyond which a number is milliseconds.
LONGEST = 2.0
# Times beyond the image, from which on they go on ever more slowly, and by how much in all: what is far outside must
# not be taken for something far along the flight.
REACH, FADE = 0.75, 0.25
# Each round gains as many digits as the last two together; a drone moves a point by a hundredth of the image.
ROUNDS = 30
CONVERGED, LOST = 1e-14, 1e-10


@dataclass(frozen=True)
class RollingShutter:
    """Rolling shutter of a camera.

    Attributes
    ----------
    readout_time : float
        From the first row to the last, seconds.
    direction : str
        In which the readout runs over the image: a key of `DIRECTIONS`.
    size : tuple of int
        Width and height of the image in pixels.
    """

    readout_time: float
    direction: str
    size: tuple[int, int]

    @classmethod
    def from_table(cls, table: Mapping[str, Any], size: tuple[int, int], where: str) -> Self:
        """Shutter of a table: `readout_time` in seconds, and `direction`, default down.

        Parameters
        ----------
        table : mapping of str to object
        size : tuple of int
            Width and height in pixels.
        where : str
            Named in errors.

        Raises
        ------
        InputError
            A key is missing or unknown, or a value is out of range.
        """
        known_keys(table, ("readout_time", "direction"), where)
        text = "seconds from the first row to the last, such as 0.03"
        time = positive(need(table, "readout_time", where, text), "readout_time", where)
        if time > LONGEST:
            what = f"readout_time = {time:g}: no camera takes so many seconds"
            raise InputError(what, where=where, hint="give seconds, not milliseconds")
        return cls(time, choice(table.get("direction", "down"), DIRECTIONS, "direction", where), size)

    def to_dict(self) -> dict[str, Any]:
        """Table of `from_table`."""
        return {"readout_time": self.readout_time, "direction": self.direction}

    def scaled(self, size: tuple[int, int]) -> Self:
        """Shutter of a copy of the image in another resolution."""
        return replace(self, size=size)

    def _places(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Times (N,) that go on evenly, and by how much of `FADE` they are beyond `REACH`."""
        axis, sign = DIRECTIONS[self.direction]
        time = sign * (np.asarray(colrow, dtype=np.float64)[:, axis] / self.size[axis] - 0.5)
        return time, np.maximum(np.abs(time) - REACH, 0.0) / FADE

    def time(self, colrow: FloatArray) -> FloatArray:
        """Time (N,) at which pixels (N, 2) are exposed, from the middle of the readout, of the whole of it."""
        time, over = self._places(colrow)
        return np.where(over > 0.0, np.sign(time) * (REACH + FADE * (1.0 - np.exp(-over))), time)

    def slope(self, colrow: FloatArray) -> FloatArray:
        """Derivatives (N, 2) of `time` by column and row."""
        axis, sign = DIRECTIONS[self.direction]
        out = np.zeros((len(colrow), 2))
        out[:, axis] = sign / self.size[axis] * np.exp(-self._places(colrow)[1])
        return out

    def solved(self, image: Callable[[FloatArray], FloatArray], count: int) -> FloatArray:
        """Times (N,) at which points are seen, of a function from times to their image; NaN without one.

        By the secant method: where a point is seen at one time says when it is seen, but for the motion until then.
        """
        before = np.zeros(count)
        off_before = self.time(image(before))
        time, slope = off_before.copy(), np.full(count, -1.0)
        step = time
        for _ in range(ROUNDS):
            off = self.time(image(time)) - time
            change = time - before
            # Between times that are next to equal a slope is rounding.
            far = np.abs(change) > 1e-9
            np.divide(off - off_before, change, out=slope, where=far)
            step = -off / np.where(slope < -1e-3, slope, -1.0)
            before, off_before, time = time, off, time + step
            if not (np.abs(step) > CONVERGED).any():
                break
        return np.where(np.abs(step) <= LOST, time, np.nan)


@dataclass(frozen=True, eq=False)
class Scan:
    """Motion of a photo during its readout.

    Attributes
    ----------
    values : array (12,)
        Parameters of the photo: position, angles in degrees, motion, and turn in degrees.
    """

    values: FloatArray

    @property
    def motion(self) -> FloatArray:
        """Way (3,) during the readout."""
        return self.values[6:9]

    def _about(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Rotations (N, 3, 3) about x, y and z at times (N,); one alone (1, 3, 3) where the photo does not turn."""
        turn = self.values[9:12]
        angles = np.radians(self.values[3:6] + (time[:, None] if turn.any() else np.zeros((1, 1))) * turn)
        found = []
        for axis in range(3):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            one = np.zeros((len(angles), 3, 3))
            one[:, axis, axis] = 1.0
            one[:, i, i] = one[:, j, j] = np.cos(angles[:, axis])
            one[:, i, j] = np.sin(angles[:, axis])
            one[:, j, i] = -one[:, i, j]
            found.append(one)
        return found[0], found[1], found[2]

    def rotations(self, time: FloatArray) -> FloatArray:
        """Local frame → image, x right, y up, at times (N,): (N, 3, 3), or (1, 3, 3) where the photo does not turn."""
        x, y, z = self._about(time)
        return z @ y @ x

    def axes(self, time: FloatArray, seen: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Camera axes, (N,) each, of points (N, 3) in the local frame, counted from the centre at their times."""
        x, y, z = (self.rotations(time) @ seen[:, :, None])[:, :, 0].T
        return x, -y, -z

    def turn_about(self, pose: FloatArray) -> FloatArray:
        """The same turn, degrees (3,), of a pose (6,) whose angles count from another frame."""
        if not self.values[9:12].any():
            return np.zeros(3)
        here, there = (_turning(np.radians(angles)) for angles in (self.values[3:6], pose[3:6]))
        return np.asarray(np.linalg.solve(there, here @ self.values[9:12]), dtype=np.float64)

    @property
    def turning(self) -> FloatArray:
        """Rotation vector (3,) of the turn about camera axes: x right, y down, z forward; degrees."""
        return FLIP @ _turning(np.radians(self.values[3:6])) @ self.values[9:12]

    def directions(self, time: FloatArray, seen: FloatArray) -> FloatArray:
        """Directions (N, 3) in camera axes at times (N,) to the local frame."""
        return (np.swapaxes(self.rotations(time), 1, 2) @ (seen @ FLIP)[:, :, None])[:, :, 0]

    def derivatives(
        self, time: FloatArray, seen: FloatArray, bent: FloatArray, by_camera: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives of the image at times (N,) by the parameters (N, 2, 12), and by the local frame (N, 2, 3).

        Of points `seen` (N, 3) as `axes` takes them, with the derivatives `bent` of that by the local frame, and those
        of the image by camera axes (N, 2, 3); the times are held.

        Parameters
        ----------
        time : array (N,)
            Seconds.
        seen : array (N, 3)
        bent : array (N, 3, 3)
        by_camera : array (N, 2, 3)
        """
        x, y, z = self._about(time)
        by_image = by_camera @ FLIP
        by_local = by_image @ (z @ y @ x) @ bent
        turned = (z @ y @ x @ TURNS[0], z @ TURNS[1] @ y @ x, TURNS[2] @ z @ y @ x)
        # Parameters are in degrees, the derivatives of rotations per radian.
        by_angles = [by_image @ (each @ seen[:, :, None]) * (np.pi / 180.0) for each in turned]
        held = np.concatenate([-by_local, *by_angles], axis=2)
        return np.concatenate([held, held * time[:, None, None]], axis=2), by_local

    def followed(self, held: FloatArray, slope: FloatArray) -> FloatArray:
        """Matrices (N, 2, 2) from changes of the image at held times to those that the times follow.

        Of derivatives (N, 2, 12) at held times and those of time by the image (N, 2).
        """
        rate = held[:, :, :6] @ self.values[6:12]
        share = 1.0 - (slope * rate).sum(axis=1)
        followed: FloatArray = np.eye(2) + rate[:, :, None] * (slope / share[:, None])[:, None, :]
        return followed


def turn_of(angles: FloatArray, turning: FloatArray) -> FloatArray:
    """Changes (3,) of the angles that a turn about camera axes makes, the inverse of `Scan.turning`; degrees.

    Parameters
    ----------
    angles : array (3,)
        omega, phi, kappa in degrees.
    turning : array (3,)
        Rotation vector: x right, y down, z forward; degrees.
    """
    return np.asarray(np.linalg.solve(_turning(np.radians(angles)), FLIP @ turning), dtype=np.float64)


def _turning(angles: FloatArray) -> FloatArray:
    """Rotation vector about the axes of the image, by a small change of each angle (3, 3)."""
    _, y, z = angles
    first, second = r3(z) @ r2(y) @ np.eye(3)[0], r3(z) @ np.eye(3)[1]
    return np.column_stack([first, second, np.eye(3)[2]])
