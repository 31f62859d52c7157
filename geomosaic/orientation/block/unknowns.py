"""Unknowns of a block: which parameter of which image, camera, strip or point stands in which column."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from geomosaic.estimation.solver import Unknowns
from geomosaic.sensor.plugin import HasInterior, SensorModel
from geomosaic.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class BlockUnknowns:
    """Parameters of images and cameras, further ones, and coordinates of points that are not eliminated.

    Attributes
    ----------
    images : tuple of str (M,)
    camera : int array (M,)
        Camera of each image whose interior orientation it shares; -1 for none.
    image_parameters, interiors, further : tuple of Unknowns
        Of each image, of each camera, and of each group of further unknowns.
    kept : int array (K,)
        Points whose coordinates stand among the parameters, since one observation joins several of them.
    kept_start : array (K, 3)
        Their first coordinates.
    """

    images: tuple[str, ...]
    camera: IntArray
    image_parameters: tuple[Unknowns, ...]
    interiors: tuple[Unknowns, ...]
    further: tuple[Unknowns, ...]
    kept: IntArray
    kept_start: FloatArray

    @classmethod
    def of(
        cls,
        images: Sequence[str],
        models: Sequence[SensorModel],
        camera: IntArray,
        further: Sequence[Unknowns],
        kept: IntArray,
        points: FloatArray,
    ) -> BlockUnknowns:
        """Unknowns of a block whose models say which of their parameters are free, weighted or held.

        Parameters
        ----------
        images : sequence of str
        models : sequence of SensorModel
        camera : int array (M,)
            Number of the camera or strip of each image.
        further : sequence of Unknowns
        kept : int array (K,)
            Points whose coordinates stand among the parameters.
        points : array (P, 3)
            First coordinates of all points, metres in the block's frame.
        """
        own = []
        for name, model in zip(images, models, strict=True):
            p = model.parameters
            own.append(Unknowns(tuple(f"{name}: {each}" for each in p.names), p.values, p.steps, p.sigmas))
        shared = []
        for index in range(int(camera.max(initial=-1)) + 1):
            model = models[int(np.argmax(camera == index))]
            if not isinstance(model, HasInterior):
                raise TypeError(f"{type(model).__name__} has no interior orientation")
            p = model.interior
            names = tuple(f"camera {index + 1}: {each}" for each in p.names)
            shared.append(Unknowns(names, p.values, p.steps, p.sigmas))
        return cls(tuple(images), camera, tuple(own), tuple(shared), tuple(further), kept, points[kept])

    def holding(self, images: BoolArray) -> BlockUnknowns:
        """Unknowns with the parameters of some images (M,) held, and of cameras that no other image shows."""
        own = [
            replace(each, sigmas=np.zeros_like(each.sigmas)) if held else each
            for each, held in zip(self.image_parameters, images, strict=True)
        ]
        shared = [
            each if (self.camera[~images] == camera).any() else _held_where_free(each)
            for camera, each in enumerate(self.interiors)
        ]
        return replace(self, image_parameters=tuple(own), interiors=tuple(shared))

    def holding_further(self, groups: BoolArray) -> BlockUnknowns:
        """Unknowns with some groups (F,) of further ones held."""
        pairs = zip(self.further, groups.tolist(), strict=True)
        return replace(self, further=tuple(_held_where_free(each) if held else each for each, held in pairs))

    def keeping(self, moving: BoolArray) -> BlockUnknowns:
        """Unknowns without the kept points that have no place, of points (S,) that have one."""
        there = moving[self.kept]
        return replace(self, kept=self.kept[there], kept_start=self.kept_start[there])

    @cached_property
    def groups(self) -> tuple[Unknowns, ...]:
        """All groups, in the order of the columns."""
        points = [
            Unknowns(tuple(f"point {row}: {axis}" for axis in "xyz"), start, np.full(3, 1e-2), np.full(3, np.inf))
            for row, start in zip(self.kept.tolist(), self.kept_start, strict=True)
        ]
        return (*self.image_parameters, *self.interiors, *self.further, *points)

    @cached_property
    def all(self) -> Unknowns:
        """All of them as one group."""
        return Unknowns.joined(self.groups)

    @cached_property
    def offsets(self) -> IntArray:
        """Where each group begins among all parameters (G + 1,)."""
        return np.cumsum([0, *(len(group.names) for group in self.groups)])

    @cached_property
    def columns(self) -> IntArray:
        """Column of each parameter (P,) among those that are estimated; -1 for those that are held."""
        free = self.all.free
        return np.where(free, np.cumsum(free) - 1, -1)

    @cached_property
    def blocks(self) -> IntArray:
        """Where each group begins among the columns (G + 1,)."""
        return np.concatenate([[0], np.cumsum(self.all.free)])[self.offsets]

    @property
    def count(self) -> int:
        """Number of columns."""
        return int(self.all.free.sum())

    def of_image(self, index: int) -> IntArray:
        """Columns of an image's parameters and, behind them, of its camera's."""
        own = self.of_group(index)
        camera = int(self.camera[index])
        return own if camera < 0 else np.concatenate([own, self.of_group(len(self.images) + camera)])

    def of_camera(self, index: int) -> IntArray:
        """Columns of a camera's interior orientation."""
        return self.of_group(len(self.images) + index)

    def of_further(self, index: int) -> IntArray:
        """Columns of a group of further unknowns."""
        return self.of_group(len(self.images) + len(self.interiors) + index)

    @cached_property
    def kept_columns(self) -> dict[int, IntArray]:
        """Columns of the coordinates of each point that is kept."""
        first = len(self.images) + len(self.interiors) + len(self.further)
        return {int(point): self.of_group(first + row) for row, point in enumerate(self.kept)}

    def of_group(self, group: int) -> IntArray:
        """Columns of a group, by its place in `groups`."""
        return self.columns[self.offsets[group] : self.offsets[group + 1]]

    def split(self, values: FloatArray) -> list[FloatArray]:
        """Values (P,) of all parameters, by groups."""
        return np.split(values, self.offsets[1:-1])


def _held_where_free(unknowns: Unknowns) -> Unknowns:
    """Unknowns that no observation sees: an a-priori value determines its own, and all others are held."""
    return replace(unknowns, sigmas=np.where(np.isfinite(unknowns.sigmas), unknowns.sigmas, 0.0))


@dataclass(frozen=True, eq=False)
class BlockState:
    """Present values of a block.

    Attributes
    ----------
    models : tuple of SensorModel (M,)
    points : array (S, 3)
        In the block's frame, metres.
    further : tuple of array
        Values of each group of further unknowns.
    weights : tuple of array
        Of each group of observations (N,): 1, less for what is doubtful, 0 for what is left out.
    moving : bool array (S,)
        Points whose coordinates are unknown; the others take no part.
    """

    models: tuple[SensorModel, ...]
    points: FloatArray
    further: tuple[FloatArray, ...]
    weights: tuple[FloatArray, ...]
    moving: BoolArray
    # Poses of this state and their derivatives, which several groups of observations ask for.
    memo: dict[str, Any] = field(init=False, repr=False, default_factory=dict)

    def values(self, unknowns: BlockUnknowns) -> FloatArray:
        """Values (P,) of all parameters."""
        shared = []
        for index in range(len(unknowns.interiors)):
            model = self.models[int(np.argmax(unknowns.camera == index))]
            shared.append(cast(HasInterior, model).interior.values)
        own = [model.parameters.values for model in self.models]
        return np.concatenate([*own, *shared, *self.further, *self.points[unknowns.kept]])
