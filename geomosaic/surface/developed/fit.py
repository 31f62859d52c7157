"""Geometric fit of primitives to points: shapes with place, axis and sizes, distances with derivatives, adjustment.

The derivative of a distance by anything that moves the body is −n · (the movement of the foot), n being the normal
there. A body that turns by a small ω about its origin o moves a foot x by ω × (x − o).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from geomosaic.errors import SolveError, counted
from geomosaic.estimation.equations import Equations
from geomosaic.estimation.solver import Problem, Stopping, solve
from geomosaic.estimation.statistics import sigma0_of
from geomosaic.geo.local_frames import angle_axis
from geomosaic.surface.developed.ellipsoid import Ellipsoid
from geomosaic.types import FloatArray

# Unknowns of each kind, which is also how many points it needs; two fewer with a known axis.
LEAST = {"plane": 3, "sphere": 4, "cylinder": 5, "cone": 6, "ellipsoid": 7}
SIZES = {"plane": (), "sphere": ("radius",), "cylinder": ("radius",), "cone": ("half_angle",), "ellipsoid": ("a", "c")}


@dataclass(frozen=True)
class Shape:
    """Primitive with its place, axis and sizes.

    Attributes
    ----------
    kind : str
        A key of `LEAST`.
    origin : array (3,)
        A point of the plane, a point of the cylinder's axis, the apex, or the centre.
    rotation : array (3, 3)
        Rows x', y', z'; z' is the normal or the axis.
    sizes : array
        As in `SIZES`; metres, the half angle in radians.
    """

    kind: str
    origin: FloatArray
    rotation: FloatArray
    sizes: FloatArray

    def names(self, *, axis_known: bool) -> tuple[str, ...]:
        """Names of the unknowns: shifts along x', y', z' of the origin, turns about x' and y', sizes."""
        shifts = {"plane": ("z'",), "cylinder": ("x'", "y'")}.get(self.kind, ("x'", "y'", "z'"))
        turns = () if axis_known or self.kind == "sphere" else ("about x'", "about y'")
        return (*shifts, *turns, *SIZES[self.kind])

    def distances(self, points: FloatArray, names: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
        """Signed distances (N,) of points (N, 3), outwards positive, and their derivatives (N, P)."""
        own = (points - self.origin) @ self.rotation.T
        away, normal, by_size = self._measured(own)
        columns = {f"{'xyz'[i]}'": -normal[:, i] for i in range(3)}
        # n · (e × x) = e · (x × n)
        moment = np.cross(own, normal)
        columns |= {"about x'": -moment[:, 0], "about y'": -moment[:, 1]}
        columns |= dict(zip(SIZES[self.kind], by_size, strict=True))
        return away, np.column_stack([columns[name] for name in names])

    def _measured(self, own: FloatArray) -> tuple[FloatArray, FloatArray, tuple[FloatArray, ...]]:
        """Distances, outward normals (N, 3) and derivatives by the sizes of points in body axes."""
        out = np.hypot(own[:, 0], own[:, 1])
        east, north = own[:, 0] / np.maximum(out, 1e-300), own[:, 1] / np.maximum(out, 1e-300)
        if self.kind == "plane":
            return own[:, 2], np.tile([0.0, 0.0, 1.0], (len(own), 1)), ()
        if self.kind == "sphere":
            reach = np.linalg.norm(own, axis=1)
            return reach - self.sizes[0], own / reach[:, None], (-np.ones(len(own)),)
        if self.kind == "cylinder":
            return out - self.sizes[0], np.column_stack([east, north, np.zeros_like(out)]), (-np.ones(len(own)),)
        if self.kind == "cone":
            sine, cosine = np.sin(self.sizes[0]), np.cos(self.sizes[0])
            normal = np.column_stack([east * cosine, north * cosine, np.full_like(out, sine)])
            return out * cosine + own[:, 2] * sine, normal, (own[:, 2] * cosine - out * sine,)
        body = Ellipsoid(float(self.sizes[0]), float(self.sizes[1]), "equidistant")
        away, normal = body.coordinates(own)[:, 2], body.normal(own)
        foot = own - away[:, None] * normal
        across = (foot[:, :2] * normal[:, :2]).sum(axis=1) / self.sizes[0]
        return away, normal, (-across, -foot[:, 2] * normal[:, 2] / self.sizes[1])

    def moved(self, names: tuple[str, ...], step: FloatArray) -> Shape:
        """Shape after a step (P,) of the unknowns."""
        change = dict(zip(names, step, strict=True))
        shift = np.array([change.get(f"{axis}'", 0.0) for axis in "xyz"])
        turn = angle_axis(np.array([change.get("about x'", 0.0), change.get("about y'", 0.0), 0.0]))
        sizes = self.sizes + np.array([change[name] for name in SIZES[self.kind]])
        rotation = turn.T @ self.rotation
        return replace(self, origin=self.origin + shift @ self.rotation, rotation=rotation, sizes=sizes)

    @property
    def sound(self) -> bool:
        """Whether the sizes are those of a body."""
        limit = np.pi / 2 if self.kind == "cone" else np.inf
        return bool(((self.sizes > 0.0) & (self.sizes < limit)).all())


def basis(axis: FloatArray) -> FloatArray:
    """Rotation whose last row is a given axis; the other two are free.

    Parameters
    ----------
    axis : array (3,)
        Unit vector.

    Returns
    -------
    array (3, 3)
    """
    # Crossed with an axis of the frame that is far from parallel to it, so that the product has length.
    first = np.cross([0.0, 1.0, 0.0] if abs(axis[0]) > 0.7 else [1.0, 0.0, 0.0], axis)
    first = first / np.linalg.norm(first)
    return np.array([first, np.cross(axis, first), axis])


DIRECTIONS = 300
KEPT = 5
MOST_POINTS = 300


def _initial_shapes(kind: str, points: FloatArray, axis: FloatArray | None) -> list[Shape]:
    """Initial shapes of a fit, best first."""
    if kind == "plane":
        return [Shape(kind, points.mean(axis=0), basis(_least(points)), np.array([]))]
    if kind == "sphere":
        found = _solved(np.column_stack([points, np.ones(len(points))]), (points**2).sum(axis=1))
        centre = found[:3] / 2
        return [Shape(kind, centre, np.eye(3), np.sqrt([max(found[3] + centre @ centre, 0.0)]))]
    sample = points[np.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).astype(int)]
    rotations = _half_sphere() if axis is None else basis(axis)[None]
    kept: list[Shape] = []
    for i in np.argsort(_misfits(kind, sample, rotations), kind="stable"):
        shape = _about(kind, sample, rotations[i])
        if shape is not None:
            kept.append(shape)
        if len(kept) == KEPT:
            break
    return kept


def _terms(kind: str, points: FloatArray, rotations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Design (D, N, K) and right-hand side (D, N) of the primitives about directions."""
    x, y, z = np.moveaxis(np.einsum("dij,nj->dni", rotations, points), -1, 0)
    columns = [x, y, np.ones_like(x)] if kind == "cylinder" else [x, y, np.ones_like(x), z, z * z]
    return np.stack(columns, axis=-1), -(x * x + y * y)


def _misfits(kind: str, points: FloatArray, rotations: FloatArray) -> FloatArray:
    """Sums of squares (D,) that the best primitives about directions leave, in the sense of algebra."""
    design, right = _terms(kind, points, rotations)
    base = np.linalg.qr(design)[0]
    left = right - np.einsum("dnk,dk->dn", base, np.einsum("dnk,dn->dk", base, right))
    return np.asarray((left**2).sum(axis=1))


def _about(kind: str, points: FloatArray, rotation: FloatArray) -> Shape | None:
    """The body about a direction that fits points best, in the sense of algebra."""
    design, right = _terms(kind, points, rotation[None])
    z = points @ rotation[2]
    found = _solved(design[0], right[0])
    b, c, e, d, a = (*found, 0.0, 0.0) if kind == "cylinder" else found
    x0, y0 = -b / 2, -c / 2
    square = x0 * x0 + y0 * y0 - e
    if kind == "cylinder":
        if square <= 0.0:
            return None
        return Shape(kind, np.array([x0, y0, 0.0]) @ rotation, rotation, np.sqrt([square]))
    if (kind == "cone") != (a < 0.0) or a == 0.0:
        return None
    z0 = -d / (2 * a)
    centre = np.array([x0, y0, z0]) @ rotation
    if kind == "cone":
        if (z > z0).sum() > len(z) / 2:  # the body lies below its apex
            rotation = np.array([rotation[0], -rotation[1], -rotation[2]])
        return Shape(kind, centre, rotation, np.arctan(np.sqrt([-a])))
    square += d * d / (4 * a)
    if square <= 0.0:
        return None
    return Shape(kind, centre, rotation, np.sqrt([square, square / a]))


def _solved(design: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(design, right, rcond=None)[0], dtype=np.float64)


def _least(points: FloatArray) -> FloatArray:
    """Direction in which points spread least."""
    return np.asarray(np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1], dtype=np.float64)


@lru_cache(maxsize=1)
def _half_sphere() -> FloatArray:
    """Rotations (D, 3, 3) with z' all over the upper half sphere, evenly (Fibonacci's lattice), the vertical first."""
    i = np.arange(DIRECTIONS)
    z = 1.0 - i / DIRECTIONS
    turn = np.pi * (3.0 - np.sqrt(5.0)) * i
    out = np.sqrt(1.0 - z * z)
    return np.stack([basis(axis) for axis in np.column_stack([out * np.cos(turn), out * np.sin(turn), z])])


# A longer step than half the points' spread, or half a radian, would leave the body that the start is near to.
RULES = Stopping(rounds=60, step=1e-14, near=1e-11, longest=0.5)
# Condition number beyond which the points do not determine the body.
WORST_CONDITION = 1e6
# Sizes below this share of the points' spread (or this angle) are no body: points in line are on a pipe of none.
SMALLEST = 1e-8


@dataclass(frozen=True)
class FittedPrimitive:
    """Primitive fitted to points, and how well they determine it.

    Attributes
    ----------
    shape : Shape
        Where the points are given. The origin of a plane is in the middle of the points, that of a cylinder on the axis
        beside it.
    names : tuple of str
        The unknowns, see `Shape.names`.
    covariance : array (P, P)
        Of the unknowns: metres, turns and half angle in radians. NaN without redundancy.
    residuals : array (N,)
        Distances of the points from the surface, outwards positive, metres.
    sigma0 : float
        Standard deviation of a distance; NaN without redundancy.
    """

    shape: Shape
    names: tuple[str, ...]
    covariance: FloatArray
    residuals: FloatArray
    sigma0: float

    @property
    def redundancy(self) -> int:
        """Redundancy: points more than unknowns."""
        return len(self.residuals) - len(self.names)

    @property
    def sigmas(self) -> dict[str, float]:
        """Standard deviations by name; metres and radians."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def sigma_origin(self) -> FloatArray:
        """Standard deviations (3,) of the origin in the frame of the points, metres."""
        rows = np.zeros((3, len(self.names)))
        for i, axis in enumerate(("x'", "y'", "z'")):
            if axis in self.names:
                rows[:, self.names.index(axis)] = self.shape.rotation[i]
        sigmas: FloatArray = np.sqrt(np.einsum("ij,jk,ik->i", rows, self.covariance, rows))
        return sigmas


def fit_primitive(kind: str, points: FloatArray, axis: FloatArray | None = None) -> FittedPrimitive:
    """Geometric fit of a body to points.

    Parameters
    ----------
    kind : str
        'plane', 'sphere', 'cylinder', 'cone' or 'ellipsoid' (of revolution).
    points : array (N, 3)
        In a Cartesian frame, metres.
    axis : array (3,), optional
        Known direction of the axis, held; of a cone towards its apex or away from it.

    Raises
    ------
    SolveError
        There are too few points, or they do not determine the body.
    """
    known = np.asarray(points, dtype=np.float64)
    held = axis is not None and kind not in ("plane", "sphere")
    need = LEAST[kind] - (2 if held else 0)
    if len(known) < need:
        what = f"{counted(len(known), 'point')} do{'es' * (len(known) == 1)} not determine a {kind}"
        raise SolveError(what, hint=f"measure {need} at least, well spread")
    if not np.isfinite(known).all():
        raise SolveError(f"a point of the {kind} is no number", hint="correct it, or leave it out")
    middle = known.mean(axis=0)
    spread = float(np.sqrt(((known - middle) ** 2).sum(axis=1).mean()))
    if spread == 0.0:
        raise SolveError(f"all points of the {kind} are one", hint="measure points all over it")
    local = (known - middle) / spread  # lengths about one: steps and rounding are alike for all unknowns
    direction = None if axis is None or not held else np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    solved = [_adjusted(start, local, held) for start in _initial_shapes(kind, local, direction)]
    sound = [one for one in solved if one is not None and (one.sizes > SMALLEST).all()]
    if not sound:
        raise SolveError(f"the points show no {kind}", hint=f"measure more of them, all over it; is it a {kind}?")
    # Starts often lead to one body, turned about its axis: the first of equals, so that rounding does not choose.
    squares = [_squares(one, local) for one in sound]
    shape = next(one for one, own in zip(sound, squares, strict=True) if own <= min(squares) * (1.0 + 1e-9) + 1e-24)
    return _with_covariance(shape, local, held, middle, spread)


@dataclass(frozen=True, eq=False)
class _PrimitiveProblem(Problem[Shape]):
    """Orthogonal distances of points from a body; lengths are in the points' spread."""

    points: FloatArray
    axis_known: bool

    def linearise(self, state: Shape) -> Equations:
        away, by = state.distances(self.points, state.names(axis_known=self.axis_known))
        if not (np.isfinite(away).all() and np.isfinite(by).all()):
            raise SolveError(
                f"a distance from the {state.kind} is no number",
                hint="measure points away from the axis and the centre",
            )
        return Equations(by, -away)

    def squares(self, state: Shape) -> float:
        return _squares(state, self.points) if state.sound else float("inf")

    def moved(self, state: Shape, step: FloatArray) -> Shape:
        return state.moved(state.names(axis_known=self.axis_known), step)


def _squares(shape: Shape, points: FloatArray) -> float:
    return float((shape.distances(points, shape.names(axis_known=True))[0] ** 2).sum())


def _adjusted(shape: Shape, points: FloatArray, held: bool) -> Shape | None:
    """Primitive of least squares near a start; None where the way leads to no body."""
    try:
        # Where the iteration does not settle, the best so far is compared with what other starts give.
        return solve(_PrimitiveProblem(points, held), shape, RULES).state
    except SolveError:
        return None


def _with_covariance(shape: Shape, local: FloatArray, held: bool, middle: FloatArray, spread: float) -> FittedPrimitive:
    """Primitive at the place of its points, with its covariance."""
    names = shape.names(axis_known=held)
    if shape.kind == "cylinder":  # its origin beside the middle of the points
        along = shape.rotation[2]
        shape = Shape(shape.kind, shape.origin - (shape.origin @ along) * along, shape.rotation, shape.sizes)
    away, by = shape.distances(local, names)
    equations = Equations(by, -away)
    if equations.condition()[0] > WORST_CONDITION:
        raise SolveError(
            f"the points do not determine the {shape.kind}",
            hint="measure points all round it and at different heights, not along one line",
        )
    lengths = np.array([1.0 if name.startswith("about") or name == "half_angle" else spread for name in names])
    sigma0 = sigma0_of(float(away @ away), equations.redundancy)
    sizes = shape.sizes if shape.kind == "cone" else shape.sizes * spread
    placed = Shape(shape.kind, shape.origin * spread + middle, shape.rotation, sizes)
    covariance = sigma0**2 * equations.parameter_cofactors() * np.outer(lengths, lengths)
    return FittedPrimitive(placed, names, covariance, away * spread, sigma0 * spread)
