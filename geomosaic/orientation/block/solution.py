"""Result of a block adjustment in the terms of its user: images, cameras, points, control and check points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from geomosaic.errors import counted
from geomosaic.estimation.solver import Unknowns
from geomosaic.estimation.statistics import variance_factor
from geomosaic.orientation.block.adjustment import BlockAdjustment
from geomosaic.orientation.block.object_constraints import Distances
from geomosaic.orientation.block.observations import GroundControl
from geomosaic.orientation.block.reliability import Reliability, reliability
from geomosaic.sensor.plugin import HasInterior, Parameters, SensorModel
from geomosaic.types import BoolArray, FloatArray, IntArray

# Correlation of two parameters from which on they cannot be told apart.
HIGH_CORRELATION = 0.95
# Probability of the test of sigma0, both sides together.
SIGMA0_ALPHA = 0.01
# Standard deviations below which a parameter of the interior orientation is not significant.
SIGNIFICANT = 2.0
# Images of a camera over whose heights a mean is taken.
MEAN_OF = 60


@dataclass(frozen=True, eq=False)
class KnownPoints:
    """Points with given coordinates, after the adjustment.

    Attributes
    ----------
    ids : tuple of str (N,)
    point : int array (N,)
    errors : array (N, 3)
        Given minus adjusted along the axes of the ground's CRS; NaN of points that have no place.
    sigmas : array (N, 3)
        Standard deviations of the adjusted coordinates.
    sigmas_given : array (N, 3)
        Of the given ones; 0 where nobody told.
    rejected : bool array (N,)
    rays : int array (N,)
        Image positions that take part.
    detectable : array (N,)
        Minimal detectable error of the given coordinates, metres; see `Reliability`.
    shift : array (N,)
        Metres by which an unseen error of any of its measurements moves the point at most.
    """

    ids: tuple[str, ...]
    point: IntArray
    errors: FloatArray
    sigmas: FloatArray
    sigmas_given: FloatArray
    rejected: BoolArray
    rays: IntArray
    detectable: FloatArray
    shift: FloatArray

    def rms(self) -> FloatArray:
        """RMS errors (3,) of the points that were not rejected; NaN without any."""
        part = ~self.rejected & np.isfinite(self.errors).all(axis=1)
        return np.sqrt((self.errors[part] ** 2).mean(axis=0)) if part.any() else np.full(3, np.nan)


@dataclass(frozen=True, eq=False)
class BlockSolution:
    """Adjusted block with the names of its parts.

    Attributes
    ----------
    adjustment : BlockAdjustment
    ids : tuple of str (S,)
        Of the points.
    given : array (S, 3)
        Given coordinates in the CRS of the ground; NaN where none are.
    check : bool array (S,)
        Points whose given coordinates took no part, and check the result.
    sigma_given : array (S, 3), optional
        Standard deviations of given coordinates.
    """

    adjustment: BlockAdjustment
    ids: tuple[str, ...]
    given: FloatArray
    check: BoolArray
    sigma_given: FloatArray | None = None

    @property
    def images(self) -> tuple[str, ...]:
        """Names of the images."""
        return self.adjustment.problem.unknowns.images

    @property
    def models(self) -> tuple[SensorModel, ...]:
        """Adjusted models, in the order of `images`."""
        return self.adjustment.state.models

    @property
    def variance_factor(self) -> float:
        """Factor from cofactors to covariances: sigma0² and the a-priori 1 pooled."""
        return variance_factor(self.adjustment.sigma0, self.adjustment.redundancy)

    @property
    def sigma0_bounds(self) -> tuple[float, float]:
        """Range in which sigma0 lies with a probability of 99 %, where the standard deviations given are right."""
        freedom = self.adjustment.redundancy
        if freedom < 1:
            return 0.0, float("inf")
        low, high = chi2.ppf([SIGMA0_ALPHA / 2.0, 1.0 - SIGMA0_ALPHA / 2.0], freedom) / freedom
        return float(np.sqrt(low)), float(np.sqrt(high))

    @property
    def reservation(self) -> str:
        """What a block of this size goes without, in words; empty where nothing is missing."""
        if not self.adjustment.network.approximate:
            return ""
        return (
            f"the equations of {counted(len(self.images), 'image')} are too many for a factor, and were solved by "
            "conjugate gradients: covariances of images and points and the weakest direction are not computed, "
            "redundancy numbers leave out how the parts of the block hang together"
        )

    def covariance(self, index: int) -> FloatArray | None:
        """Covariance of an image's parameters and, behind them, of its camera's interior orientation.

        Parameters
        ----------
        index : int
            Of the image.

        Returns
        -------
        array (P + Q, P + Q)
            Zero for what is held.
        None
            The block is too large, see `reservation`, or too little was measured in the image, which stays.
        """
        if self.adjustment.network.approximate or self.adjustment.undetermined[index]:
            return None
        return self._covariance(self.adjustment.problem.unknowns.of_image(index))

    def camera_covariance(self, index: int) -> FloatArray:
        """Covariance (Q, Q) of a camera's interior orientation; zero for what is held."""
        return self._covariance(self.adjustment.problem.unknowns.of_camera(index))

    def further_covariance(self, index: int) -> FloatArray:
        """Covariance (P, P) of a group of further unknowns; zero for what is held."""
        return self._covariance(self.adjustment.problem.unknowns.of_further(index))

    def _covariance(self, columns: IntArray) -> FloatArray:
        out = np.zeros((len(columns), len(columns)))
        free = columns >= 0
        own = self.adjustment.network.cofactors_between(columns[free], columns[free])
        out[np.ix_(free, free)] = own * self.variance_factor
        return out

    @cached_property
    def axes(self) -> FloatArray:
        """Derivatives (S, 3, 3) of ground coordinates by the block's, at the points."""
        return self.adjustment.problem.frame.axes_of_ground(self.adjustment.state.points)

    @property
    def length_unit(self) -> str:
        """Unit of lengths: 'm', or 'units' where nothing says how large the block is."""
        problem = self.adjustment.problem
        scaled = problem.free != "similarity" or any(isinstance(group, Distances) for group in problem.groups)
        return "m" if scaled else "units"

    @cached_property
    def ground(self) -> FloatArray:
        """Points (S, 3) in the CRS of the ground; NaN of those that have no place."""
        places = self.adjustment.problem.frame.to_ground(self.adjustment.state.points)
        return np.where(self.adjustment.state.moving[:, None], places, np.nan)

    @cached_property
    def point_covariance(self) -> FloatArray:
        """Covariance (S, 3, 3) of the points along the axes of the ground's CRS; NaN of those that have no place."""
        state, problem = self.adjustment.state, self.adjustment.problem
        cofactors = self.adjustment.network.point_cofactors().copy()
        for point, columns in problem.unknowns.kept_columns.items():
            cofactors[point] = self.adjustment.network.cofactors_between(columns, columns)
        turned = self.axes @ cofactors @ np.swapaxes(self.axes, 1, 2) * self.variance_factor
        return np.where(state.moving[:, None, None], turned, np.nan)

    @cached_property
    def own_point_covariance(self) -> FloatArray:
        """Covariance (S, 3, 3) of the points were the images without error, along the axes of the ground's CRS."""
        cofactors = np.where(
            self.adjustment.state.moving[:, None, None], self.adjustment.network.factored.inverses, 0.0
        )
        return self.axes @ cofactors @ np.swapaxes(self.axes, 1, 2) * self.variance_factor

    @cached_property
    def point_sigmas(self) -> FloatArray:
        """Standard deviations (S, 3) of the points along the axes of the ground's CRS."""
        return np.sqrt(np.diagonal(self.point_covariance, axis1=1, axis2=2))

    @cached_property
    def rays(self) -> IntArray:
        """Number (S,) of image positions of each point that take part."""
        views = self.adjustment.problem.views
        used = self.adjustment.state.weights[0] > 0.0
        return np.bincount(views.points[used], minlength=len(self.ids))

    @cached_property
    def residuals(self) -> FloatArray:
        """Measured minus computed image positions (N, 2), pixels, of what was left out, too."""
        adjustment = self.adjustment
        return adjustment.problem.views.residuals(adjustment.state, adjustment.problem.frame)

    def image_rms(self) -> FloatArray:
        """RMS lengths (M,) of the residuals of each image, pixels, of what takes part."""
        views, used = self.adjustment.problem.views, self.adjustment.state.weights[0] > 0.0
        count = np.bincount(views.image[used], minlength=len(self.images))
        total = np.bincount(views.image[used], (self.residuals[used] ** 2).sum(axis=1), len(self.images))
        return np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan)

    @cached_property
    def reliability(self) -> tuple[Reliability, ...]:
        """Minimal detectable errors of each group of observations, and how far they would move the points."""
        return reliability(self.adjustment)

    @cached_property
    def point_reliability(self) -> tuple[FloatArray, FloatArray]:
        """Largest minimal detectable error (S,) of the rays of each point, pixels, and the largest shift (S,), metres.

        Inf where nothing checks a measurement of the point, NaN without any.
        """
        detectable, shift = np.full(len(self.ids), np.nan), np.full(len(self.ids), np.nan)
        np.fmax.at(detectable, self.adjustment.problem.views.points, self.reliability[0].detectable)
        for group, own in zip(self.adjustment.problem.groups, self.reliability, strict=True):
            if group.of_points:
                np.fmax.at(shift, group.points, own.shift)
        return detectable, shift

    def _known(self, point: IntArray, rejected: BoolArray, detectable: FloatArray) -> KnownPoints:
        return KnownPoints(
            tuple(self.ids[each] for each in point.tolist()),
            point,
            self.given[point] - self.ground[point],
            self.point_sigmas[point],
            np.zeros((len(point), 3)) if self.sigma_given is None else self.sigma_given[point],
            rejected,
            self.rays[point],
            detectable,
            self.point_reliability[1][point],
        )

    @cached_property
    def control(self) -> KnownPoints:
        """Control points."""
        points: list[IntArray] = [np.zeros(0, dtype=np.int64)]
        rejected: list[BoolArray] = [np.zeros(0, dtype=np.bool_)]
        detectable: list[FloatArray] = [np.zeros(0)]
        for index, group in enumerate(self.adjustment.problem.groups):
            if isinstance(group, GroundControl):
                points.append(group.points)
                rejected.append(self.adjustment.rejected[index])
                detectable.append(self.reliability[index].detectable)
        return self._known(np.concatenate(points), np.concatenate(rejected), np.concatenate(detectable))

    @cached_property
    def checks(self) -> KnownPoints:
        """Check points."""
        point = np.flatnonzero(self.check)
        return self._known(point, np.zeros(len(point), dtype=np.bool_), np.full(len(point), np.nan))

    def correlated(self) -> list[tuple[str, str, float]]:
        """Parameters of one image, or of a camera, whose correlation is above 0.95 in size, the largest first.

        Only those of an interior orientation with each other, and with the images that show them: within an exterior
        orientation high correlations are the rule, and harmless.
        """
        unknowns, found = self.adjustment.problem.unknowns, dict[tuple[str, str], float]()
        names = [name for name, free in zip(unknowns.all.names, unknowns.all.free, strict=True) if free]
        network = self.adjustment.network
        every, sigmas = np.arange(network.parameters), np.sqrt(network.parameter_variances())
        for camera in range(len(unknowns.interiors)):
            own = unknowns.of_camera(camera)
            own = own[own >= 0]
            found_of = network.cofactors_between(every, own)
            # Of a block that is too large for the variances of all, those of the camera are known.
            sigmas[own] = np.sqrt(np.diagonal(found_of[own]))
            rest = found_of.T / (sigmas[own, None] * np.where(sigmas > 0.0, sigmas, np.inf))
            for row, column in zip(*np.nonzero(np.abs(rest) > HIGH_CORRELATION), strict=True):
                one, other = sorted((int(own[row]), int(column)))
                if one != other:
                    found[names[one], names[other]] = float(rest[row, column])
        return sorted(((a, b, value) for (a, b), value in found.items()), key=lambda each: -abs(each[2]))

    def focal_heights(self) -> list[tuple[str, float]]:
        """Correlation of each camera's focal length with the mean height of its images, by the camera's name.

        Near 1 the block may rise and sink with the focal length, and its heights stretch, without any residual.
        """
        unknowns, found = self.adjustment.problem.unknowns, list[tuple[str, float]]()
        if self.adjustment.network.approximate:
            return found
        for camera, shared in enumerate(unknowns.interiors):
            columns = unknowns.of_camera(camera).tolist()
            focal = [k for name, k in zip(shared.names, columns, strict=True) if name.endswith(": focal_length")]
            up = []
            for image in np.flatnonzero(unknowns.camera == camera).tolist():
                names = unknowns.image_parameters[image].names
                columns = unknowns.of_image(image)[: len(names)].tolist()
                up += [k for name, k in zip(names, columns, strict=True) if name.endswith(": up") and k >= 0]
            if not up or focal[:1] in ([], [-1]):
                continue
            # A mean of many is that of some: each column of cofactors is a solution of its own.
            chosen = np.array([*up[:: -(-len(up) // MEAN_OF)], focal[0]])
            cofactors = self.adjustment.network.cofactors_between(chosen, chosen)
            mean = np.full(len(chosen) - 1, 1.0 / (len(chosen) - 1))
            variance = float(cofactors[-1, -1] * (mean @ cofactors[:-1, :-1] @ mean))
            if variance > 0.0:
                found.append((group_name(shared), float(mean @ cofactors[:-1, -1] / np.sqrt(variance))))
        return found

    def insignificant(self) -> list[tuple[str, float, float]]:
        """Interior orientation parameters that did not move by twice their standard deviation: name, change, sigma."""
        unknowns, found = self.adjustment.problem.unknowns, []
        for camera, shared in enumerate(unknowns.interiors):
            sigmas = np.sqrt(np.diagonal(self.camera_covariance(camera)))
            change = self.interior(camera).values - shared.start
            for name, free, moved, sigma in zip(shared.names, shared.free, change, sigmas, strict=True):
                if free and abs(moved) < SIGNIFICANT * sigma:
                    found.append((name, float(moved), float(sigma)))
        return found

    def interior(self, camera: int) -> Parameters:
        """Adjusted interior orientation of a camera."""
        unknowns = self.adjustment.problem.unknowns
        model = self.models[int(np.argmax(unknowns.camera == camera))]
        if not isinstance(model, HasInterior):
            raise TypeError(f"{type(model).__name__} has no interior orientation")
        return model.interior

    def weakest(self) -> tuple[float, list[tuple[str, float]]]:
        """Direction in which the block is determined worst.

        Returns
        -------
        condition : float
            Of the normalised design.
        movements : list of (str, float)
            Images, strips and cameras that move along it by one standard deviation, and by how much at most in pixels,
            the largest first. NaN and none where the block is too large, see `reservation`.
        """
        if self.adjustment.network.approximate:
            return float("nan"), []
        condition, change = self.adjustment.network.weakest()
        unknowns = self.adjustment.problem.unknowns
        moved = change[: unknowns.count] * np.sqrt(self.variance_factor)
        found = []
        # Points that are kept among the parameters come last, and have no pixels of their own.
        for index, group in enumerate(unknowns.groups[: len(unknowns.groups) - len(unknowns.kept)]):
            columns = unknowns.of_group(index)
            if (columns >= 0).any():
                found.append((group_name(group), float(group.movement(moved[columns[columns >= 0]]))))
        return condition, sorted(found, key=lambda each: -each[1])


def group_name(group: Unknowns) -> str:
    """Name of a group of unknowns: what its parameters' names begin with.

    Parameters
    ----------
    group : Unknowns
    """
    return group.names[0].rsplit(": ", 1)[0] if group.names else ""
