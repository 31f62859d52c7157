"""Block adjustment as a least squares problem: images, cameras, points and what was observed of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, cast

import numpy as np

from geomosaic.errors import SolveError, listed
from geomosaic.estimation.elimination import Pattern
from geomosaic.estimation.network import Network, Observations
from geomosaic.estimation.solver import Problem, Stopping
from geomosaic.orientation.block.common_rotation import turned_together
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.free_datum import free_datum
from geomosaic.orientation.block.object_constraints import Distances
from geomosaic.orientation.block.observations import GroundControl, Group, ImagePositions
from geomosaic.orientation.block.unknowns import BlockState, BlockUnknowns
from geomosaic.sensor.plugin import HasInterior, SensorModel
from geomosaic.types import BoolArray, FloatArray, IntArray

# Weight of the worst measurement in robust rounds: none leaves them, so that it may come back.
LEAST_WEIGHT = 1e-9
# Rounds in which points follow their images, and the damping of their depths, over all that is known of a place: of a
# drone's photos rays that enclose half a degree lose a tenth.
FOLLOWING, FLAT = 2, 1e-6

# Of every solution that counts.
RULES = Stopping(rounds=100, step=1e-6, near=1e-3, gain=1e-9)


@dataclass(frozen=True, eq=False)
class Priors(Group):
    """A-priori values of parameters that have an a-priori standard deviation."""

    unknowns: BlockUnknowns
    name = "a-priori values"
    of_points = False

    @cached_property
    def _rows(self) -> Any:
        every = self.unknowns.all
        return np.flatnonzero(every.free & np.isfinite(every.sigmas))

    @property
    def points(self) -> Any:  # type: ignore[override]
        """Point of each (N,); -1 for none."""
        return np.full(len(self._rows), -1)

    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened misclosures (N, K); see `Group`."""
        every = self.unknowns.all
        left = (every.start - state.values(self.unknowns))[self._rows] / every.sigmas[self._rows]
        return np.asarray(left)[:, None]

    @property
    def row_images(self) -> tuple[IntArray, IntArray]:
        """Each value that is of an image, and its image."""
        of = np.searchsorted(self.unknowns.offsets, self._rows, side="right") - 1
        mine = of < len(self.unknowns.images)
        return np.flatnonzero(mine), of[mine]

    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state; see `Group`."""
        root = 1.0 / self.unknowns.all.sigmas[self._rows]
        return Observations(
            self.points,
            unknowns.columns[self._rows][:, None],
            root[:, None, None],
            np.zeros((len(root), 1, 3)),
            self.misclosure(state, frame),
        )


@dataclass(frozen=True, eq=False)
class BlockProblem(Problem[BlockState]):
    """Block of images of any sensors, adjusted in one solution.

    Attributes
    ----------
    frame : BlockFrame
    unknowns : BlockUnknowns
    groups : tuple of Group
        Image positions first.
    robust : float
        Median lengths of residuals at which an image position has a quarter of its weight; inf for least squares.
    free : str, optional
        What no observation determines, and inner constraints hold: 'similarity' (place, attitude and scale of the
        block) or 'congruence' (all but the scale).
    """

    frame: BlockFrame
    unknowns: BlockUnknowns
    groups: tuple[Group, ...]
    robust: float = float("inf")
    free: Literal["similarity", "congruence"] | None = None
    _patterns: dict[str, Pattern] = field(default_factory=dict)

    @classmethod
    def of(cls, frame: BlockFrame, unknowns: BlockUnknowns, groups: Sequence[Group]) -> BlockProblem:
        """Problem with the a-priori values of its unknowns among the observations.

        Parameters
        ----------
        frame : BlockFrame
        unknowns : BlockUnknowns
        groups : sequence of Group
        """
        priors = Priors(unknowns)
        return cls(frame, unknowns, (*groups, *([priors] if len(priors) else [])))

    @property
    def views(self) -> ImagePositions:
        """Image positions of points."""
        return cast(ImagePositions, self.groups[0])

    def start(self, models: Sequence[SensorModel], points: FloatArray, further: Sequence[FloatArray]) -> BlockState:
        """State of first values in which all observations that can be computed take part.

        Parameters
        ----------
        models : sequence of SensorModel
        points : array (N, 3)
            In the frame, metres.
        further : sequence of array (K,)
        """
        weights = tuple(np.ones(len(group)) for group in self.groups)
        known = np.asarray(np.isfinite(points).all(axis=1))
        state = BlockState(tuple(models), np.where(known[:, None], points, 0.0), tuple(further), weights, known)
        return self.checked(state)

    def checked(self, state: BlockState) -> BlockState:
        """State without observations that cannot be computed, and without points that these leave undetermined."""
        moving, weights = state.moving.copy(), [w.copy() for w in state.weights]
        for group, weight in zip(self.groups, weights, strict=True):
            weight[~group.placed(moving)] = 0.0
            seen = weight > 0.0
            if seen.any():
                weight[~np.isfinite(group.misclosure(state, self.frame)).all(axis=1)] = 0.0
        while True:
            fixed = self._intersected(weights, len(moving))
            lost = moving & ~fixed
            if not lost.any():
                break
            moving &= fixed
            for group, weight in zip(self.groups, weights, strict=True):
                weight[~group.placed(moving)] = 0.0
        return replace(state, weights=tuple(weights), moving=moving)

    def _intersected(self, weights: Sequence[FloatArray], points: int) -> BoolArray:
        """Points with two image positions in different images, or with as much from other observations."""
        # Counted in coordinates: a point needs three. Parallel rays are found later, by the normal matrix.
        count = np.zeros(points, dtype=np.int64)
        for group, weight in zip(self.groups, weights, strict=True):
            if group.of_points:
                size = 2 if group is self.views else group.observed.sum(axis=1)
                np.add.at(count, group.points, np.where(weight > 0.0, size, 0))
        return count >= 3

    def with_determined_images(self, state: BlockState, weak: BoolArray) -> tuple[BlockProblem, BlockState, BoolArray]:
        """Problem and state without images that fewer observations touch than they have unknowns.

        Parameters
        ----------
        state : BlockState
        weak : bool array (M,)
            Images that are left out anyway.

        Returns
        -------
        problem : BlockProblem
            Parameters of such images are held.
        state : BlockState
            Their observations have no weight.
        held : bool array (M,)

        Raises
        ------
        SolveError
            No image is left.
        """
        problem, held, lost = self, np.zeros(len(state.models), dtype=np.bool_), weak
        while True:
            if not lost.any():
                state, less = problem._without_idle(problem.checked(state))
                lost = problem._undetermined(state) & ~held
                if less:
                    continue
                if not lost.any():
                    break
            held, lost = held | lost, np.zeros(len(held), dtype=np.bool_)
            problem = replace(self, unknowns=self.unknowns.holding(held))
            weights = []
            for group, weight in zip(self.groups, state.weights, strict=True):
                weights.append(np.where(group.touches(held), 0.0, weight))
            state = replace(state, weights=tuple(weights))
        if held.all():
            raise SolveError(
                f"the measurements do not determine {listed(self.unknowns.images, 6)}: no image is left to adjust",
                hint="give more tie points or control points, or the accuracy of positions and angles",
            )
        if not state.moving[self.unknowns.kept].all():
            problem = replace(problem, unknowns=problem.unknowns.keeping(state.moving))
        if not (seen := self._observed_further(state)).all():
            problem = replace(problem, unknowns=problem.unknowns.holding_further(~seen))
        return problem, state, held

    def _observed_further(self, state: BlockState) -> BoolArray:
        """Groups of further unknowns (F,) of which as many observed components take part as they have free ones."""
        count = np.zeros(len(self.unknowns.further), dtype=np.int64)
        for group, weight in zip(self.groups, state.weights, strict=True):
            row, further = group.row_further
            np.add.at(count, further, np.where(weight > 0.0, group.observed.sum(axis=1), 0)[row])
        needed = [int((each.free & ~np.isfinite(each.sigmas)).sum()) for each in self.unknowns.further]
        return np.asarray(count >= np.maximum(needed, 1))

    def _without_idle(self, state: BlockState) -> tuple[BlockState, bool]:
        """State without observations of further unknowns that too few determine; whether there were any."""
        # Held at its first values, a plane that lost most of its points would bend the block with the rest.
        idle, weights, less = ~self._observed_further(state), [], False
        for group, weight in zip(self.groups, state.weights, strict=True):
            row, further = group.row_further
            out = np.zeros(len(weight), dtype=np.bool_)
            out[row[idle[further]]] = True
            less |= bool((weight[out] > 0.0).any())
            weights.append(np.where(out, 0.0, weight))
        return replace(state, weights=tuple(weights)), less

    def _undetermined(self, state: BlockState) -> BoolArray:
        """Images (M,) with fewer observed components than free parameters."""
        count = np.zeros(len(state.models), dtype=np.int64)
        for group, weight in zip(self.groups, state.weights, strict=True):
            row, image = group.row_images
            np.add.at(count, image, np.where(weight[row] > 0.0, group.components, 0))
        needed = np.array([int(each.free.sum()) for each in self.unknowns.image_parameters])
        return np.asarray(count < needed)

    # What the solver asks.

    def misclosures(self, state: BlockState) -> list[FloatArray]:
        """Whitened misclosures (N, K) of each group, not weighted."""
        return [group.misclosure(state, self.frame) for group in self.groups]

    def linearise(self, state: BlockState) -> Network:
        """Linearised network of what takes part."""
        groups, views, datum = [], None, None
        for index, (group, weight) in enumerate(zip(self.groups, state.weights, strict=True)):
            if not (weight > 0.0).any():
                continue
            found = group.linearised(state, self.unknowns, self.frame)
            if index == 0 and self.free is not None:
                views = found
            groups.append(weighted(found, weight))
        if views is not None:
            scale = self.free == "similarity"
            datum = free_datum(views, groups[1:], self.views, state, self.unknowns, scale)
        moving = np.repeat(state.moving[:, None], 3, axis=1)
        moving[self.unknowns.kept] = False
        network = Network(tuple(groups), self.unknowns.blocks, moving, datum, self._patterns.get("last"))
        # From step to step and round to round mostly the same measurements take part.
        self._patterns["last"] = network.normals.pattern
        return network

    def squares(self, state: BlockState) -> float:
        """Weighted sum of squares."""
        total = 0.0
        for left, weight in zip(self.misclosures(state), state.weights, strict=True):
            part = weight > 0.0
            total += float(weight[part] @ (left[part] ** 2).sum(axis=1))
        return total

    def moved(self, state: BlockState, step: FloatArray) -> BlockState:
        """State after a step."""
        unknowns = self.unknowns
        before = state.values(unknowns)
        parts = unknowns.split(unknowns.all.moved(before, step[: unknowns.count]))
        count = len(unknowns.images)
        shared = parts[count : count + len(unknowns.interiors)]
        models = []
        for image, model in enumerate(state.models):
            camera = int(unknowns.camera[image])
            if camera >= 0:
                own = cast(HasInterior, model)
                model = cast(SensorModel, own.with_interior(own.interior.with_values(shared[camera])))
            models.append(model)
        changes = [own - first for own, first in zip(parts, unknowns.split(before)[:count], strict=False)]
        free = [own.free for own in unknowns.image_parameters]
        models, common = turned_together(models, changes, free, self.frame)
        first = count + len(unknowns.interiors)
        points = state.points.copy()
        moving = state.moving.copy()
        moving[unknowns.kept] = False
        points[moving] += step[unknowns.count :].reshape(-1, 3)
        further = tuple(parts[first : first + len(unknowns.further)])
        kept = parts[first + len(unknowns.further) :]
        if kept:
            points[unknowns.kept] = np.array(kept)
        if common is not None:
            moving[unknowns.kept] = True
            points[moving] += (state.points[moving] - common.middle) @ common.second_order.T
        return replace(state, models=tuple(models), points=points, further=further)

    def after_inner_iterations(self, state: BlockState) -> BlockState:
        """State with all points where their observations put them, with all parameters as they are."""
        moving = state.moving.copy()
        moving[self.unknowns.kept] = False
        for _ in range(FOLLOWING):
            normal, right = np.zeros((len(moving), 3, 3)), np.zeros((len(moving), 3))
            for group, weight in zip(self.groups, state.weights, strict=True):
                if group.of_points and (weight > 0.0).any():
                    found = weighted(group.linearised(state, self.unknowns, self.frame), weight)
                    turned = np.swapaxes(found.by_point, 1, 2)
                    np.add.at(normal, found.point, turned @ found.by_point)
                    np.add.at(right, found.point, (turned @ found.misclosure[:, :, None])[:, :, 0])
            size = np.trace(normal, axis1=1, axis2=2)
            seen = moving & (size > 0.0) & np.isfinite(size) & np.isfinite(right).all(axis=1)
            # Of nearly parallel rays the depth is left where it is.
            stiff = normal[seen] + FLAT * size[seen, None, None] * np.eye(3)
            points = state.points.copy()
            points[seen] += np.linalg.solve(stiff, right[seen][:, :, None])[:, :, 0]
            state = replace(state, points=points)
        return state

    def movement(self, state: BlockState, trial: BlockState, equations: Any, step: FloatArray) -> float:
        """Largest change of a parameter, in its steps of about a pixel."""
        if self.unknowns.count:
            # Points follow their images: what these moved, in pixels, says it all.
            return self.unknowns.all.movement(step[: self.unknowns.count])
        # All images are held: what moves are the points, as their images see it.
        before, after = (self.views.misclosure(each, self.frame)[state.weights[0] > 0.0] for each in (state, trial))
        return float(np.nan_to_num(np.abs(after - before), nan=0.0).max(initial=0.0))

    def refreshed(self, state: BlockState) -> BlockState:
        """State with weights that follow from its residuals, in robust rounds."""
        if not np.isfinite(self.robust):
            return state
        weights, of_views = [], np.inf
        for group, weight in zip(self.groups, state.weights, strict=True):
            # Wrong control, or a point far off its plane, would win against all its rays if these alone gave way.
            of_surface = group.of_points and len(group.row_further[0]) > 0
            if group is self.views or isinstance(group, GroundControl | Distances) or of_surface:
                # A line most of whose points are wrong must not be judged by itself, once the rays are in place.
                weight, scale = self._falling(group, state, weight, of_views if of_surface else np.inf)
                of_views = scale if group is self.views else of_views
            weights.append(weight)
        return replace(state, weights=tuple(weights))

    def _falling(self, group: Group, state: BlockState, weight: FloatArray, most: float) -> tuple[FloatArray, float]:
        """Weights (N,) of a group that fall with the lengths of its residuals, and the scale, `most` at most."""
        part = weight > 0.0
        length = np.nan_to_num(np.sqrt((group.misclosure(state, self.frame) ** 2).sum(axis=1)), nan=np.inf)
        # Never below what was declared: the scale falls while the block comes into place. Two would be judged by
        # themselves, so that a wrong one would keep its weight.
        scale = min(max(1.0, float(np.median(length[part]))), most) if part.sum() > 2 else 1.0
        falling = 1.0 / (1.0 + (length / (self.robust * scale)) ** 2) ** 2
        return np.where(part, np.maximum(falling, LEAST_WEIGHT), 0.0), scale


def weighted(found: Observations, weight: FloatArray) -> Observations:
    """Observations times the roots of their weights, those of no weight left out.

    Parameters
    ----------
    found : Observations
    weight : array (N,)
    """
    part = weight > 0.0
    root = np.sqrt(weight[part])
    if part.all() and (root == 1.0).all():
        return found
    return Observations(
        found.point[part],
        found.columns[part],
        found.by_parameters[part] * root[:, None, None],
        found.by_point[part] * root[:, None, None],
        found.misclosure[part] * root[:, None],
    )
