"""Pose of a scanner and look directions of its detectors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray

# Line lengths beyond each end of the line within which directions are extrapolated.
REACH = 5.0
_ROUNDS = 12


@dataclass(frozen=True, eq=False)
class LookDirections:
    """Look directions of a line, u = (across, along, −1) in the scanner's axes.

    Attributes
    ----------
    cols : array (K,)
        Image columns of the nodes, increasing; 0.5 is the first pixel's centre.
    across, along : array (K,)
        Slopes of the look direction at the nodes, without unit, or their angles in radians; `across` is monotonic.
    angular : bool
        Whether it is angles that grow linearly between nodes. SPOT 1 to 4 tell those of the first and the last
        detector only; were it their tangents, the line would be wrong by 55 pixels at 27° of incidence.
    """

    cols: FloatArray
    across: FloatArray
    along: FloatArray
    angular: bool = False

    def __post_init__(self) -> None:
        for name in ("cols", "across", "along"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def of(cls, cols: FloatArray, across: FloatArray, along: FloatArray, where: str, angular: bool = False) -> Self:
        """Look directions of nodes, checked to be smooth and finite.

        Parameters
        ----------
        cols : array (K,)
            Columns of the nodes.
        across, along : array (K,)
            Slopes, or radians where `angular`.
        where : str
            Named in errors.
        angular : bool

        Raises
        ------
        InputError
            Fewer than two nodes, or neighbours that look in the same direction or the other way round.
        """
        order = np.argsort(cols)
        c, a, b = (np.asarray(v, dtype=np.float64)[order] for v in (cols, across, along))
        # Only a monotonic line can be inverted, from a direction to the column that looks there.
        steps = np.diff(a)
        monotonic = len(a) >= 2 and bool((np.diff(c) > 0).all() and ((steps > 0).all() or (steps < 0).all()))
        if not monotonic or not np.isfinite([c, a, b]).all():
            raise InputError(
                "the look angles of the line do not go one way from detector to detector",
                where=where,
                hint="two or more detectors are needed, each looking further across than the one before",
            )
        return cls(c, a, b, angular)

    @cached_property
    def _table(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Nodes with one more beyond each end, on the mean slope of the last hundredth of the line."""
        count = len(self.cols)
        back = min(count - 1, max(1, count // 100))
        columns = []
        reach = REACH * (self.cols[-1] - self.cols[0])
        for values in (self.cols, self.across, self.along):
            first = values[0] - (values[back] - values[0]) * reach / (self.cols[back] - self.cols[0])
            last = values[-1] + (values[-1] - values[-1 - back]) * reach / (self.cols[-1] - self.cols[-1 - back])
            columns.append(np.concatenate([[first], values, [last]]))
        return columns[0], columns[1], columns[2]

    @cached_property
    def _by_across(self) -> tuple[FloatArray, FloatArray]:
        cols, across, _ = self._table
        # `np.interp` needs nodes that increase.
        return (across, cols) if across[0] < across[-1] else (across[::-1], cols[::-1])

    @cached_property
    def _span(self) -> tuple[float, float]:
        """Middle and half length of the line, in columns."""
        return 0.5 * float(self.cols[0] + self.cols[-1]), 0.5 * float(self.cols[-1] - self.cols[0])

    def _curve(self, cols: FloatArray) -> FloatArray:
        """Second Legendre polynomial over the line: 1 at both ends, −0.5 in the middle."""
        middle, half = self._span
        along = (cols - middle) / half
        return 1.5 * along * along - 0.5

    def slopes(self, cols: FloatArray, stretch: float = 0.0, bend: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Slopes (N,) across and along of columns (N,); NaN more than five line lengths beyond an end.

        `stretch` and `bend` add that multiple of the second Legendre polynomial over the line to the slopes.

        Parameters
        ----------
        cols : array (N,)
        stretch, bend : float
            Corrections of the slopes.
        """
        nodes, across, along = self._table
        a = np.interp(cols, nodes, across, np.nan, np.nan)
        b = np.interp(cols, nodes, along)
        if self.angular:
            a, b = np.tan(a), np.tan(b)
        if stretch or bend:
            curve = self._curve(cols)
            a, b = a + stretch * curve, b + bend * curve
        return a, b

    def column_slopes(
        self, cols: FloatArray, stretch: float = 0.0, bend: float = 0.0
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Derivatives (N,) of `slopes` by the column, across and along, and the polynomial of stretch and bend.

        Parameters
        ----------
        cols : array (N,)
        stretch, bend : float
            Corrections of the slopes.
        """
        nodes, across, along = self._table
        a, b = interpolation_slopes(cols, nodes, np.column_stack([across, along])).T
        if self.angular:
            tangents = (np.tan(np.interp(cols, nodes, values)) for values in (across, along))
            a, b = (slope * (1.0 + tangent**2) for slope, tangent in zip((a, b), tangents, strict=True))
        middle, half = self._span
        turn = 3.0 * (cols - middle) / half**2
        return a + stretch * turn, b + bend * turn, self._curve(cols)

    def columns(self, across: FloatArray, stretch: float = 0.0) -> FloatArray:
        """Columns (N,) that look along slopes across (N,); NaN more than five line lengths beyond an end."""
        known, nodes = self._by_across
        cols: FloatArray = np.interp(self._as_known(across), known, nodes, np.nan, np.nan)
        if stretch:
            # The stretch is some pixels in thousands, so each round gains three digits or more.
            for _ in range(_ROUNDS):
                cols = np.interp(self._as_known(across - stretch * self._curve(cols)), known, nodes, np.nan, np.nan)
        return cols

    def _as_known(self, slopes: FloatArray) -> FloatArray:
        """Slopes in the form the nodes are stored in: angles where `angular`."""
        return np.arctan(slopes) if self.angular else slopes

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        nodes = {"cols": self.cols.tolist(), "across": self.across.tolist(), "along": self.along.tolist()}
        return {**nodes, "angular": self.angular}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(np.array(state["cols"]), np.array(state["across"]), np.array(state["along"]), state["angular"])


_SAME = 0.1  # pixels


def choose_band(
    looks: Mapping[str, LookDirections], band: str | None, where: str
) -> tuple[LookDirections, tuple[str, ...]]:
    """Look directions of the band asked for, or of all bands where they are the same.

    Parameters
    ----------
    looks : mapping of str to LookDirections
        By band, one at least.
    band : str, optional
    where : str
        Named in errors.

    Returns
    -------
    look : LookDirections
    notes : tuple of str
        What is to be noted of the choice.

    Raises
    ------
    InputError
        There is no such band, or the bands look apart by more than a tenth of a pixel and none is named.
    """
    if band is not None:
        if band not in looks:
            raise InputError(
                f"there are no look angles of band {band}", where=where, hint=f"known bands are: {', '.join(looks)}"
            )
        return looks[band], (f"look angles of band {band}",)
    first = next(iter(looks.values()))
    apart = max(_apart(first, look) for look in looks.values())
    if apart > _SAME:
        raise InputError(
            f"the bands look apart by up to {apart:.2f} pixels, and nothing says which one is meant",
            where=where,
            hint=f"give band = {' or '.join(looks)}, and rectify each band by itself",
        )
    return first, ()


def _apart(one: LookDirections, other: LookDirections) -> float:
    """Largest distance in pixels between the directions of two bands."""
    cols = np.linspace(one.cols[0], one.cols[-1], 101)
    pixel = abs(one.across[-1] - one.across[0]) / (one.cols[-1] - one.cols[0])
    pairs = zip(one.slopes(cols), other.slopes(cols), strict=True)
    return float(max(np.nanmax(np.abs(a - b)) for a, b in pairs) / pixel)


class Pose(NamedTuple):
    """Position and axes of a scanner at N times.

    Attributes
    ----------
    position : array (N, 3)
        Geocentric metres.
    axes : array (N, 3, 3)
        Rows are the scanner's own axes x, y, z in geocentric components. z points away from the ground.
    """

    position: FloatArray
    axes: FloatArray


def components(axes: FloatArray, vectors: FloatArray) -> FloatArray:
    """Components of vectors along axes.

    Parameters
    ----------
    axes : array (N, 3, 3)
        Rows are unit vectors, geocentric.
    vectors : array (N, 3)
        Geocentric.

    Returns
    -------
    array (N, 3)
    """
    # Written out instead of a matrix product: BLAS may round a point differently from one array length to the next.
    return np.stack([_dot(axes[:, i], vectors) for i in range(3)], axis=1)


def combined(axes: FloatArray, parts: FloatArray) -> FloatArray:
    """Vectors of given components along axes, the inverse of `components`.

    Parameters
    ----------
    axes : array (N, 3, 3)
        Rows are unit vectors, geocentric.
    parts : array (N, 3)
        Components.

    Returns
    -------
    array (N, 3)
        Geocentric.
    """
    return parts[:, :1] * axes[:, 0] + parts[:, 1:2] * axes[:, 1] + parts[:, 2:] * axes[:, 2]


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def turned(axes: FloatArray, pitch: FloatArray, roll: FloatArray, yaw: FloatArray) -> FloatArray:
    """Axes turned by the SPOT attitude angles.

    A look direction u in the turned axes is Mp·Mr·My·u in the axes given, with (SPOT Geometry Handbook, CNES, 2002)

             1    0     0            cr   0  −sr            cy −sy   0
        Mp = 0   cp    sp       Mr =  0   1    0       My = sy  cy   0
             0  −sp    cp            sr   0   cr             0   0   1

    so the rows of the turned axes are those of (Mp·Mr·My)ᵀ times the axes.

    Parameters
    ----------
    axes : array (N, 3, 3)
        Rows are the axes x, y, z.
    pitch, roll, yaw : array (N,)
        Radians.

    Returns
    -------
    array (N, 3, 3)
    """
    x, y, z = axes[:, 0], axes[:, 1], axes[:, 2]
    c, s = np.cos(pitch)[:, None], np.sin(pitch)[:, None]
    y, z = c * y - s * z, s * y + c * z
    c, s = np.cos(roll)[:, None], np.sin(roll)[:, None]
    x, z = c * x + s * z, c * z - s * x
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x, y = c * x + s * y, c * y - s * x
    return np.stack([x, y, z], axis=1)


def unit(vectors: FloatArray) -> FloatArray:
    """Unit vectors.

    Parameters
    ----------
    vectors : array (N, 3)

    Returns
    -------
    array (N, 3)
    """
    return vectors / np.sqrt(_dot(vectors, vectors))[:, None]


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products a × b, by components.

    Parameters
    ----------
    a, b : array (N, 3)

    Returns
    -------
    array (N, 3)
    """
    return np.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        axis=1,
    )


def interpolation_slopes(at: FloatArray, nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Slopes of a piecewise linear interpolation, as `np.interp` has it: 0 beyond the nodes.

    Parameters
    ----------
    at : array (N,)
    nodes : array (K,)
        Increasing.
    values : array (K, D)

    Returns
    -------
    array (N, D)
    """
    if len(nodes) < 2:
        return np.zeros((len(at), values.shape[1]))
    first = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    slopes = np.diff(values, axis=0) / np.diff(nodes)[:, None]
    inside = (at >= nodes[0]) & (at <= nodes[-1])
    return np.where(inside[:, None], slopes[first], 0.0)


def turning_axes(pitch: FloatArray, roll: FloatArray, yaw: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Axes about which the angles of `turned` turn what is seen in the turned axes.

    Parameters
    ----------
    pitch, roll, yaw : array (N,)
        Radians.

    Returns
    -------
    pitch, roll, yaw : array (N, 3)
        With the components d of a vector in the turned axes, ∂d / ∂angle = axis × d.
    """
    zero, one = np.zeros_like(pitch), np.ones_like(pitch)
    unturned = np.broadcast_to(np.eye(3), (len(pitch), 3, 3))
    return (
        turned(unturned, pitch, roll, yaw)[:, :, 0],
        np.column_stack([np.sin(yaw), np.cos(yaw), zero]),
        np.column_stack([zero, zero, -one]),
    )


def unit_rates(vectors: FloatArray, rates: FloatArray) -> FloatArray:
    """Rates of change of unit vectors `unit(vectors)`.

    Parameters
    ----------
    vectors : array (N, D)
        Of any length.
    rates : array (N, D)
        Their rates of change.

    Returns
    -------
    array (N, D)
    """
    length = np.sqrt((vectors * vectors).sum(axis=1))[:, None]
    along = vectors / length
    change: FloatArray = (rates - along * (along * rates).sum(axis=1)[:, None]) / length
    return change


def matrix_rates(q: FloatArray, rates: FloatArray) -> FloatArray:
    """Rates of change of `matrices_of_quaternions`.

    Parameters
    ----------
    q : array (N, 4)
        Scalar first, of any length but 0.
    rates : array (N, 4)
        Their rates of change.

    Returns
    -------
    array (N, 3, 3)
    """
    w, x, y, z = (q / np.sqrt((q * q).sum(axis=1))[:, None]).T
    dw, dx, dy, dz = unit_rates(q, rates).T
    xx, yy, zz = 2 * x * dx, 2 * y * dy, 2 * z * dz
    xy, xz, yz = dx * y + x * dy, dx * z + x * dz, dy * z + y * dz
    wx, wy, wz = dw * x + w * dx, dw * y + w * dy, dw * z + w * dz
    rows = [
        [-2 * (yy + zz), 2 * (xy - wz), 2 * (xz + wy)],
        [2 * (xy + wz), -2 * (xx + zz), 2 * (yz - wx)],
        [2 * (xz - wy), 2 * (yz + wx), -2 * (xx + yy)],
    ]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def matrices_of_quaternions(q: FloatArray) -> FloatArray:
    """Rotation matrices of quaternions.

    Parameters
    ----------
    q : array (N, 4)
        Scalar first, of any length but 0.

    Returns
    -------
    array (N, 3, 3)
    """
    w, x, y, z = (q / np.sqrt((q * q).sum(axis=1))[:, None]).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def quaternions_of(matrices: FloatArray) -> FloatArray:
    """Quaternions of rotation matrices; neighbours have the same sign.

    Parameters
    ----------
    matrices : array (N, 3, 3)

    Returns
    -------
    array (N, 4)
        Scalar first, of length one.
    """
    # Of the four forms the one with the largest divisor is taken (Shepperd, 1978).
    m = np.asarray(matrices, dtype=np.float64)
    trace = np.trace(m, axis1=1, axis2=2)
    squares = 0.25 * np.column_stack([1 + trace, *(1 + 2 * m[:, i, i] - trace for i in range(3))])
    w2, x2, y2, z2 = squares.T
    wx, wy, wz = (0.25 * v for v in (m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]))
    xy, xz, yz = (0.25 * v for v in (m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]))
    forms = np.stack(
        [np.stack(row, axis=1) for row in ((w2, wx, wy, wz), (wx, x2, xy, xz), (wy, xy, y2, yz), (wz, xz, yz, z2))],
        axis=1,
    )
    best = np.argmax(squares, axis=1)
    q: FloatArray = forms[np.arange(len(m)), best]
    q = q / np.linalg.norm(q, axis=1)[:, None]
    return same_side(q)


def satellite_pose(position: FloatArray, quaternions: FloatArray) -> Pose:
    """Pose of a satellite whose axes point forward, right and to the ground.

    Parameters
    ----------
    position : array (N, 3)
        Geocentric metres.
    quaternions : array (N, 4)
        From the satellite's to geocentric axes, scalar first, of any length.

    Returns
    -------
    Pose
        Axes right, forward, up.
    """
    turns = matrices_of_quaternions(quaternions)
    return Pose(position, np.stack([turns[:, :, 1], turns[:, :, 0], -turns[:, :, 2]], axis=1))


def satellite_rates(velocity: FloatArray, quaternions: FloatArray, rates: FloatArray) -> Pose:
    """Rates of change of `satellite_pose`.

    Parameters
    ----------
    velocity : array (N, 3)
        Rate of change of the position.
    quaternions, rates : array (N, 4)
        As there, and their rates of change.
    """
    turns = matrix_rates(quaternions, rates)
    return Pose(velocity, np.stack([turns[:, :, 1], turns[:, :, 0], -turns[:, :, 2]], axis=1))


def same_side(quaternions: FloatArray) -> FloatArray:
    """Quaternions with signs such that no neighbours are opposite: q and −q are the same rotation.

    Parameters
    ----------
    quaternions : array (K, 4)

    Returns
    -------
    array (K, 4)
    """
    # Interpolated between opposite signs, components would pass through zero, where there is no rotation.
    away = (quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0.0
    signs = np.concatenate([[1.0], np.cumprod(np.where(away, -1.0, 1.0))])
    turned: FloatArray = quaternions * signs[:, None]
    return turned
