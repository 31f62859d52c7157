"""Groups of observations of a block, made of what was measured and of what the options say of its accuracy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from geomosaic.block_adjustment.constraints import of_points, of_rigs
from geomosaic.block_adjustment.measurements import Measurements
from geomosaic.block_adjustment.start import StartBlock
from geomosaic.errors import InputError, listed
from geomosaic.estimation.solver import Unknowns
from geomosaic.geo.local_frames import omega_phi_kappa
from geomosaic.image_names import find_by_name
from geomosaic.inputs.tables import read_table
from geomosaic.options.adjustment import AdjustmentOptions
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.object_constraints import Distances
from geomosaic.orientation.block.observations import (
    GroundControl,
    Group,
    ImagePositions,
    SurfaceHeights,
    whitening,
)
from geomosaic.orientation.block.poses import Attitudes, CameraPositions, pose_of
from geomosaic.sensor.plugin import HasPose, SensorModel
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray, IntArray

# Metres over which a DEM is differenced where it names no spacing of its own.
SLOPE_OVER = 5.0
# Change of an offset (m), a drift (m) and a boresight (degrees) that moves an image by about a pixel.
STEPS = (0.1, 0.1, 0.01)
# Camera axes of a photo, y up and z backwards, to x right, y down, z forward.
FLIP = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Observed:
    """Observations of a block.

    Attributes
    ----------
    groups : tuple of Group
        Image positions first.
    further : tuple of Unknowns
        Of strips, mountings, lakes, planes, lines and rigs.
    kept : tuple of int
        Points that several unknowns of one observation share.
    """

    groups: tuple[Group, ...]
    further: tuple[Unknowns, ...]
    kept: tuple[int, ...]


def observed(
    start: StartBlock,
    models: Sequence[SensorModel],
    measured: Measurements,
    frame: BlockFrame,
    points: FloatArray,
    options: AdjustmentOptions,
) -> Observed:
    """Observations of a block.

    Parameters
    ----------
    start : StartBlock
    models : sequence of SensorModel (M,)
        First orientations.
    measured : Measurements
    frame : BlockFrame
    points : array (S, 3)
        First coordinates in the frame.
    options : AdjustmentOptions

    Raises
    ------
    InputError
        An option has nothing to work on, or a table cannot be read.
    """
    roots = whitening(measured.covariance)
    groups: list[Group] = [ImagePositions(measured.image, measured.point, measured.colrow, roots)]
    if len(measured.control):
        groups.append(control_group(measured, frame, points))
    further: list[Unknowns] = []
    positions = _positions(start, frame, options, further)
    attitudes = _attitudes(start, frame, options, further)
    groups += [group for group in (positions, attitudes) if group is not None]
    if options.dem_sigma is not None:
        groups.append(_heights(start.surface, measured, frame, options.dem_sigma))
    groups += of_points(measured, frame, points, options, further)
    if options.rigs is not None:
        poses = [pose_of(model, frame) if isinstance(model, HasPose) else None for model in models]
        groups += of_rigs(start.names, poses, options.rigs, further)
    ends = [np.concatenate([group.first, group.second]) for group in groups if isinstance(group, Distances)]
    kept = tuple(sorted({point for each in ends for point in each.tolist()}))
    return Observed(tuple(groups), tuple(further), kept)


def control_group(measured: Measurements, frame: BlockFrame, points: FloatArray) -> GroundControl:
    """Control points as observations.

    Parameters
    ----------
    measured : Measurements
    frame : BlockFrame
    points : array (S, 3)
        First coordinates in the frame: they stand for those that are not given.
    """
    which = measured.control
    axes = frame.axes_of_ground(np.nan_to_num(points[which]))
    axes = np.broadcast_to(axes, (len(which), 3, 3))
    given, sigmas = measured.given[which], measured.sigma_given[which]
    guess = frame.to_ground(np.nan_to_num(points[which]))
    xyz = frame.from_ground(np.where(np.isfinite(given), given, guess))
    # Metres along the axes of the ground, whatever the scale of its map.
    metric = axes / np.linalg.norm(axes, axis=2, keepdims=True)
    # Between axes that are not given there is no correlation.
    correlated = np.linalg.inv(np.linalg.cholesky(measured.correlation[which]))
    return GroundControl(which, xyz, correlated @ (metric / sigmas[:, :, None]))


def _positions(
    start: StartBlock, frame: BlockFrame, options: AdjustmentOptions, further: list[Unknowns]
) -> CameraPositions | None:
    """Camera positions of images whose table or options say how accurate they are."""
    images, places, roots = [], [], []
    # The position of an image that stays says nothing but of the offset of its strip.
    held = fixed_images(start, options.fixed) if options.drift is None else set()
    for index, (scene, row) in enumerate(zip(start.scenes, start.rows, strict=True)):
        if index in held or not _observed(start, index, options.position_sigma, start.placed):
            continue
        images.append(index)
        places.append(pose_of(scene.model, frame).centre)
        if row is not None and row.covariance is not None:
            turn = frame.axes_of_ground(places[-1][None])[0]
            back = np.linalg.inv(turn)
            roots.append(whitening((back @ _positive(row.covariance[:3, :3]) @ back.T)[None])[0])
        else:
            roots.append(np.eye(3) / (options.position_sigma or np.inf))
    if not images and held:
        return None
    if not images:
        for name in ("lever_arm", "drift"):
            if getattr(options, name) is not None:
                raise _idle(name, "position_sigma", "camera positions")
        if options.position_sigma is not None:
            raise InputError(
                "no image has a camera position to hold it to", where="`position_sigma`", hint="give `exterior`"
            )
        return None
    strip, time = _strips(start, np.array(images), options, further)
    return CameraPositions(
        np.array(images), np.array(places), np.array(roots), np.array(options.lever_arm or (0.0, 0.0, 0.0)), strip, time
    )


def _attitudes(
    start: StartBlock, frame: BlockFrame, options: AdjustmentOptions, further: list[Unknowns]
) -> Attitudes | None:
    images, rotations, roots = [], [], []
    held = set() if options.boresight else fixed_images(start, options.fixed)
    for index, (scene, row) in enumerate(zip(start.scenes, start.rows, strict=True)):
        if index in held or not _observed(start, index, options.attitude_sigma, start.oriented):
            continue
        images.append(index)
        rotations.append(pose_of(scene.model, frame).rotation)
        if row is not None and row.covariance is not None:
            turned = _turns(row.angles) @ _positive(row.covariance[3:, 3:]) @ _turns(row.angles).T
            roots.append(whitening(turned[None])[0])
        else:
            roots.append(np.eye(3) / (options.attitude_sigma or np.inf))
    if not images and held:
        return None
    if not images:
        if options.boresight:
            raise _idle("boresight", "attitude_sigma", "camera angles")
        if options.attitude_sigma is not None:
            raise InputError(
                "no image has camera angles to hold it to", where="`attitude_sigma`", hint="give `exterior`"
            )
        return None
    boresight = np.full(len(images), -1)
    if options.boresight:
        names = tuple(f"boresight: {axis}" for axis in ("right", "down", "forward"))
        boresight[:] = len(further)
        further.append(Unknowns(names, np.zeros(3), np.full(3, STEPS[2]), np.full(3, np.inf)))
    return Attitudes(np.array(images), np.array(rotations), np.array(roots), boresight)


def _observed(start: StartBlock, index: int, sigma: float | None, given: BoolArray) -> bool:
    """Whether what is given of an image's pose is an observation: its table or the options say how accurate it is."""
    row = start.rows[index]
    posed = isinstance(start.scenes[index].model, HasPose) and bool(given[index])
    return posed and (sigma is not None or (row is not None and row.covariance is not None))


def _idle(name: str, wanted: str, what: str) -> InputError:
    return InputError(
        f"`{name}` would do nothing: no {what} are observed", hint=f"give `{wanted}`, or leave `{name}` out"
    )


def _positive(covariance: FloatArray) -> FloatArray:
    """Covariance without sigmas of 0, which would hold a value beyond all doubt: they count as a hundredth."""
    zero = np.diag(np.where(np.diag(covariance) > 0.0, 0.0, 1e-4))
    positive: FloatArray = covariance + zero
    return positive


def _turns(angles: Mapping[str, Any]) -> FloatArray:
    """Derivatives (3, 3) of a rotation about camera axes by omega, phi and kappa, alike in unit."""
    values = np.radians([float(angles[name]) for name in ("omega", "phi", "kappa")])
    rotation = omega_phi_kappa(*values)
    columns = []
    for step in np.eye(3) * 1e-6:
        change = (omega_phi_kappa(*(values + step)) - omega_phi_kappa(*(values - step))) @ rotation.T / 2e-6
        columns.append([change[2, 1], change[0, 2], change[1, 0]])
    return FLIP @ np.array(columns).T


def _strips(
    start: StartBlock, images: IntArray, options: AdjustmentOptions, further: list[Unknowns]
) -> tuple[IntArray, FloatArray]:
    """Group of further unknowns of each image's strip, and its time from the middle of the strip, from -1 to 1."""
    if options.drift is None:
        return np.full(len(images), -1), np.zeros(len(images))
    names = [start.names[index] for index in images.tolist()]
    of: list[tuple[str, float]] = [("1", float(index)) for index in range(len(names))]
    if options.strips is not None:
        table = read_table(options.strips, "table of strips", "image,strip")
        table.require("image", "strip", what="strips")
        rows = {row.text("image"): (row.text("strip"), row.number("time", float(row.line))) for row in table}
        found = [find_by_name(rows, name) for name in names]
        missing = [name for name, each in zip(names, found, strict=True) if each is None]
        if missing:
            what = f"image {missing[0]} has no strip"
            raise InputError(what, where=str(options.strips), hint="give every image a line: image,strip")
        of = [each for each in found if each is not None]
    strip, time = np.zeros(len(images), dtype=np.int64), np.zeros(len(images))
    for name in dict.fromkeys(each for each, _ in of):
        mine = np.array([index for index, (each, _) in enumerate(of) if each == name])
        times = np.array([of[index][1] for index in mine])
        middle, half = (times.max() + times.min()) / 2.0, max((times.max() - times.min()) / 2.0, 1e-9)
        strip[mine], time[mine] = len(further), (times - middle) / half
        # Positions at one time have no drift.
        drifts = options.drift == "linear" and bool(np.ptp(times) > 0.0)
        sigmas = np.repeat([np.inf, np.inf if drifts else 0.0], 3)
        labels = tuple(f"strip {name}: {kind} {axis}" for kind in ("offset", "drift") for axis in "xyz")
        further.append(Unknowns(labels, np.zeros(6), np.repeat(STEPS[:2], 3), sigmas))
    return strip, time


def _heights(surface: Surface | None, measured: Measurements, frame: BlockFrame, sigma: float) -> SurfaceHeights:
    """Heights of the DEM as observations of the tie points."""
    if surface is None:
        raise InputError("`dem_sigma` would do nothing: there is no DEM", hint="give `dem`, or leave `dem_sigma` out")
    loose = np.flatnonzero(~np.isfinite(measured.sigma_given).any(axis=1))
    over = _over(surface)

    def above(places: FloatArray) -> tuple[FloatArray, FloatArray]:
        xyz, turn = frame.to_crs(surface.crs, places)
        east, north = np.array([over, 0.0]), np.array([0.0, over])
        xy = xyz[:, :2]
        slope = [(surface.height(xy + side) - surface.height(xy - side)) / (2.0 * over) for side in (east, north)]
        turn = np.broadcast_to(turn, (len(places), 3, 3))
        return xyz[:, 2] - surface.height(xy), turn[:, 2] - slope[0][:, None] * turn[:, 0] - slope[1][:, None] * turn[
            :, 1
        ]

    return SurfaceHeights(loose, np.full(len(loose), sigma), above)


def _over(surface: Surface) -> float:
    """Half of a cell of a DEM, in the units of its map."""
    grid = getattr(surface, "grid", None)
    return abs(grid.transform.a) / 2.0 if grid is not None else SLOPE_OVER


def fixed_images(start: StartBlock, names: Sequence[str]) -> set[int]:
    """Indices of images that stay where they are.

    Parameters
    ----------
    start : StartBlock
    names : sequence of str
        Fixed images, or patterns of them, '*' for all.

    Raises
    ------
    InputError
        There is no such image.
    """
    held: set[int] = set()
    own = {name: index for index, name in enumerate(start.names)}
    for name in names:
        one = find_by_name(own, name)
        found = {index for image, index in own.items() if fnmatchcase(image, name)} if one is None else {one}
        if not found:
            hint = f"the images are {listed(start.names, 4)}"
            raise InputError(f"no image is named '{name}'", where="`fixed`", hint=hint)
        held |= found
    return held
