"""Block adjustment of declared images of any sensors in one solution."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.block import ControlPoint
from geomosaic.block_adjustment.angle_units import unit_errors
from geomosaic.block_adjustment.determined_images import DeterminedImages
from geomosaic.block_adjustment.groups import fixed_images, observed
from geomosaic.block_adjustment.measurements import Measurements, control_of, measurements
from geomosaic.block_adjustment.result import AdjustedBlock
from geomosaic.block_adjustment.self_calibrated import SetFree, better_with, determined_parameters, without_evidence
from geomosaic.block_adjustment.start import (
    StartBlock,
    check_cameras,
    heightless_points,
    places_of,
    refuse_positions,
    single_images,
    start_block,
    unknown_images,
    with_interior,
)
from geomosaic.errors import GeomosaicWarning, InputError, SolveError, counted, listed, warn
from geomosaic.estimation.solver import Unknowns
from geomosaic.geo.crs import is_local
from geomosaic.inputs.control_diagnostics import likeliest_cause
from geomosaic.inputs.declarations import Block, block_of
from geomosaic.inputs.orientation_plausibility import median_distance
from geomosaic.inputs.tie_points import TiePoints, read_ties
from geomosaic.options.adjustment import AdjustmentOptions
from geomosaic.options.declaration import compose
from geomosaic.orientation.block.adjustment import ALPHA, BlockAdjustment, adjust_block
from geomosaic.orientation.block.connectivity import UndeterminedError
from geomosaic.orientation.block.determinacy import require_determined
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.initial_values import InitialValues, Known, UnorientedBlock, initial_values
from geomosaic.orientation.block.level_frame import UNITS, level_frame
from geomosaic.orientation.block.object_constraints import Distances
from geomosaic.orientation.block.observations import slices_of
from geomosaic.orientation.block.poses import pose_of
from geomosaic.orientation.block.prior_conflict import PriorConflict, adjust_near_known
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.orientation.block.unknowns import BlockUnknowns
from geomosaic.orientation.block.weak_rotation import weak_roll
from geomosaic.sensor.plugin import HasCovariance, HasPose, SensorModel
from geomosaic.sensor.solve import image_to_height
from geomosaic.types import BoolArray, FloatArray, Progress, no_progress

# Adjustment, how a block got its frame in words, remarks on its parts, and parameters that strayed.
_Adjusted = tuple[BlockAdjustment, str, list[str], Sequence[PriorConflict]]

# Shares of an image's longer side from which on a median distance of control points from where given orientations put
# them is a slip where another reading explains it, and in any case: less may be the error of a first value.
EXPLAINED, SLIP = 0.1, 0.5
# Share of the measurements of one kind, and their number, above which those that were left out have a common cause: of
# matched tie points up to a tenth are wrong.
MANY, FEW = 0.15, 4
# Standard deviation in pixels of image positions for the start of a block whose cameras are yet to be calibrated: what
# the lens does is no blunder.
UNCALIBRATED = 1.0
# And where too few agree with each other then: a drone's wide lens is off by fifty pixels in the corners of a photo.
# Four times the bound orients as many photos, but with points that few rays hold.
WIDER = 16.0
# Misfit of given orientations, as a share of an image's longer side, above which tie points know better: least squares
# does not come back from receivers and gimbals that are metres and tens of degrees off near the ground.
ROUGH = 0.05
# Standard deviation in pixels of the orientation of scenes whose files state none: 10 m at half a metre.
USUAL = 20.0


# Shares of the time of an adjustment, per cent, of two blocks of 8 and 12 photos. Nobody knows before how many robust
# rounds and searches for blunders it takes.
SHARES = {"images": 2, "measurements": 6, "first values": 16, "solution": 76}


def adjust(images: Block | Sequence[Block], progress: Progress | None = None, **options: Any) -> AdjustedBlock:
    """Block adjustment: orientations of all images, and places of all points, from one least squares solution.

    Parameters
    ----------
    images : Block, or sequence of Block
        Images with what is known of them: camera, first orientations if there are any, control and check points.
        Images of other sensors, or of another camera, are blocks of their own.
    progress : callable, optional
        Called with (done, total, stage).
    **options
        Of `AdjustmentOptions`: `ties`, `position_sigma`, `interior`, ...

    Returns
    -------
    AdjustedBlock
        Adjusted `models`, `points`, `summary` in words, `facts`; `write` makes the files.

    Raises
    ------
    InputError
        An input is missing or wrong; names file and line, or the option.
    SolveError
        The measurements do not determine the block: names the parts, and what is free.

    Examples
    --------
    >>> block = gm.Block(photos, "frame", camera="camera.toml", exterior="gnss.csv", crs="EPSG:32633",
    ...                  heights="egm96", control="points.csv")  # doctest: +SKIP
    >>> print(gm.adjust(block, ties="ties.csv", position_sigma=0.1).summary)  # doctest: +SKIP
    """
    parts = [block_of(each, "images") for each in ([images] if isinstance(images, Block) else images)]
    if not parts:
        raise InputError("no image is given", where="`images`", hint="give a block")
    return adjust_parts(parts, compose(AdjustmentOptions, options), progress or no_progress)


def adjust_parts(parts: Sequence[Block], options: AdjustmentOptions, progress: Progress = no_progress) -> AdjustedBlock:
    """Block adjustment of several blocks together; see `adjust`.

    Parameters
    ----------
    parts : sequence of Block
    options : AdjustmentOptions
    progress : callable

    Raises
    ------
    InputError, SolveError
        See `adjust`.
    """
    stages = _stages(progress)
    start = start_block(parts)
    refuse_positions(start, any(part.control is not None for part in parts))
    if options.interior or options.self_calibration:
        check_cameras(start, parts)
        for note in unknown_images(start, options.interior):
            warn(note)
    stages("images")
    control = control_of(parts, start.names, start.ground)
    sizes = {scene.name: scene.model.size for scene in start.scenes}
    ties = read_ties(options.ties, sizes) if isinstance(options.ties, Path) else options.ties
    if ties is not None and not isinstance(ties, TiePoints):
        what = f"{type(ties).__name__} is neither a path nor tie points"
        raise InputError(what, where="`ties`", hint="give the path of a table, or TiePoints(...)")
    if ties is None and not control:
        raise InputError("nothing was measured in the images", where="`ties`", hint="give `ties`, or control points")
    measured, notes = measurements(sizes, ties, control, options)
    notes += heightless_points(start, measured) if options.dem_sigma is None else []
    for note in notes:
        warn(note)
    images = DeterminedImages.of(start, measured, options)
    stages("measurements")
    while True:
        try:
            found, nowhere, remarks, conflicts = _adjusted(images, control, stages, progress)
            break
        except UndeterminedError as error:
            images = images.without(error.parts, error)
    free: SetFree | None = None
    if options.self_calibration:
        images, (found, nowhere, remarks, conflicts), free = _self_calibrated(
            images, (found, nowhere, remarks, conflicts), lambda wider: _adjusted(wider, control, stages, progress)
        )
    start, measured = images.start, images.measured
    aside, of_conflicts = [images.text] if images.aside else [], [each.text for each in conflicts]
    aside += _held_cameras(images)
    for note in (*aside, *remarks, *_losses(start.names, found), *unit_errors(start, found), *of_conflicts):
        warn(note)
    stages("solution")
    solution = _solution(images, found)
    own = [point for point in control if point.image not in images.aside]
    solved = AdjustedBlock.of(start, measured, own, solution, options.exports)
    held = tuple(each.text for each in conflicts if each.rms is not None)
    solved = replace(
        solved, nowhere=nowhere, set_aside=images.aside, held=held, set_free=() if free is None else (free.text,),
        running=options,
    )  # fmt: skip
    offset = solved.height_offset
    if offset is not None and offset.significant and options.dem_sigma is None:  # observed, it is told already
        warn(offset.text)
    return solved


def _held_cameras(images: DeterminedImages) -> list[str]:
    """Note on cameras of single images, of which next to nothing is found."""
    single = single_images(images.start, images.measured.controlled)
    names = [name for name, alone in zip(images.start.names, single.tolist(), strict=True) if alone]
    if not names or not images.options.interior:
        return []
    return [
        f"{counted(len(names), 'camera')} with a single image and no control point in it, which does not determine "
        f"a lens: its distortion and principal point are held as given: {listed(names, 6)}"
    ]


def _solution(images: DeterminedImages, found: BlockAdjustment) -> BlockSolution:
    measured = images.measured
    return BlockSolution(found, measured.ids, measured.given, measured.check, measured.sigma_given)


def _self_calibrated(
    images: DeterminedImages, first: _Adjusted, adjusted: Callable[[DeterminedImages], _Adjusted]
) -> tuple[DeterminedImages, _Adjusted, SetFree | None]:
    """Adjustment with all held parameters of cameras that it determines, the options that say so, and the gain."""
    found, begun, given, gain, tried = first, _solution(images, first[0]), images.options, None, set[str]()
    while names := determined_parameters(_solution(images, found[0]), images.start.camera, tried):
        tried |= {*names}
        taken: tuple[str, ...] = () if gain is None else gain.names
        wanted, weak, trial, wider = (*taken, *names), {""}, found, images
        while weak and wanted:
            interior = {**given.interior, **dict.fromkeys(wanted, float("inf"))}
            wider = replace(images, options=replace(given, interior=interior))
            try:
                with warnings.catch_warnings():  # of first values, said once
                    warnings.simplefilter("ignore", GeomosaicWarning)
                    trial = adjusted(wider)
            except SolveError:  # the score test is linear
                return images, found, gain
            weak = without_evidence(_solution(wider, trial[0]), wanted)
            wanted = tuple(name for name in wanted if name not in weak)
        better = better_with(_solution(images, found[0]), _solution(wider, trial[0]), wanted) if wanted else None
        if better is None or {*wanted} == {*taken}:
            break
        images, found, gain = wider, trial, better_with(begun, _solution(wider, trial[0]), wanted)
    return images, found, gain


def _adjusted(
    images: DeterminedImages, control: Sequence[ControlPoint], stages: Callable[[str], None], progress: Progress
) -> _Adjusted:
    """Adjustment of images, how a block got its frame in words, remarks on its parts, and parameters that strayed."""
    start, measured, options = images.start, images.measured, images.options
    frame = _frame(start, measured)
    _refuse_unit_errors(start, control)
    problem, first, nowhere = _problem(start, measured, frame, options)
    stages("first values")
    remarks = require_determined(problem, first)
    alpha = ALPHA if options.robust else None
    by = partial(adjust_block, robust=options.robust, alpha=alpha, surveyed=measured.check, progress=progress)
    found, conflicts = adjust_near_known(problem, first, by)
    lost = np.flatnonzero(found.undetermined & ~start.oriented)
    if len(lost) and 2 * len(lost) < len(start.names):
        # Of what wrong tie points alone have oriented nothing is right.
        raise UndeterminedError("images without a good measurement", hint="leave them out", parts=list(lost[:, None]))
    return found, nowhere, remarks, conflicts


def _losses(names: Sequence[str], found: BlockAdjustment) -> list[str]:
    """Notes on images without good measurements, on kinds of which many were left out, and on a roll that is free."""
    notes = []
    lost = [name for name, out in zip(names, found.undetermined.tolist(), strict=True) if out]
    if lost:
        some = counted(len(lost), "image")
        notes.append(f"{some} that too few good measurements touch, left as given: {listed(lost, 6)}")
    for group, out, weight in zip(found.problem.groups, found.rejected, found.state.weights, strict=True):
        wrong, all_of = int(out.sum()), int((out | (weight > 0.0)).sum())
        if max(MANY * all_of, FEW) < wrong < all_of:
            notes.append(
                f"{wrong} of {all_of} {group.name} were left out, more than are wrong by chance: look for one cause, "
                "such as the angle system, units, the order of axes, or fixed images that are wrong"
            )
    weak = weak_roll(found.problem, found.state)
    if weak is not None:
        notes.append(f"{weak.text(names)}; {weak.hint}")
    return notes


def _stages(progress: Progress) -> Callable[[str], None]:
    """Progress by stages, each with its share of the time."""
    done = set()

    def finished(stage: str) -> None:
        done.add(stage)  # some once more where images were set aside meanwhile
        progress(sum(SHARES[each] for each in done), sum(SHARES.values()), "adjustment")

    return finished


def _frame(start: StartBlock, measured: Measurements) -> BlockFrame:
    """Frame at the middle of what is known."""
    given = measured.given[np.isfinite(measured.given).all(axis=1)]
    places = np.vstack([places_of(start), given])
    places = places[np.isfinite(places).all(axis=1)]
    if not len(places) and is_local(start.ground):
        places = np.zeros((1, 3))
    if not len(places):
        raise SolveError(
            "nothing says where the block lies",
            hint="give control points (`control`), or camera positions (`exterior`); or a local frame as `crs`, in "
            "which the block gets a form, but no place and no scale",
        )
    return BlockFrame.at(start.ground, np.median(places, axis=0)[None])


def _is_free(start: StartBlock, measured: Measurements) -> bool:
    """Whether nothing says where a block in a local frame lies, how it is turned and how large it is."""
    return is_local(start.ground) and not start.placed.any() and not np.isfinite(measured.given).any()


def _refuse_unit_errors(start: StartBlock, control: Sequence[ControlPoint]) -> None:
    """Check of control points against orientations that are given: another CRS, exchanged axes, other units."""
    seen = {scene.name for scene, oriented in zip(start.scenes, start.oriented, strict=True) if oriented}
    whole = [point for point in control if point.image in seen and np.isfinite(point.xyz).all()]
    if not whole:
        return
    scenes = [scene for scene in start.scenes if scene.name in seen]
    far = median_distance(scenes, whole, start.ground)
    longest = max(max(scene.model.size) for scene in scenes)
    if far <= EXPLAINED * longest:
        return
    cause, hint = likeliest_cause(scenes, whole, start.ground, far)
    if not cause and far <= SLIP * longest:
        return
    reading = f"; {cause}" if cause else ""
    raise InputError(
        f"{counted(len(whole), 'measurement')} of control points lie, in the median, {far:.3g} px from where the "
        f"orientations put them{reading}",
        where="`control`",
        hint=hint
        or "check the CRS and the vertical datum of the control points and of the positions, the units, and the "
        "camera: its focal length and pixel size",
    )


def _problem(
    start: StartBlock, measured: Measurements, frame: BlockFrame, options: AdjustmentOptions
) -> tuple[BlockProblem, Any, str]:
    """Adjustment problem, its first values, and how a block without a place was given its frame, in words."""
    models, camera = with_interior(start, options.interior, single_images(start, measured.controlled))
    free = _is_free(start, measured)
    known = _known(start, measured, frame, options)
    unoriented = UnorientedBlock(
        start.names, models, start.oriented, measured.image, measured.point, measured.colrow, frame.local, known
    )
    sigma = max(float(np.median(measured.sigma)), UNCALIBRATED if options.interior else 0.0)
    begun = _begun(unoriented, sigma, not free, WIDER * sigma if options.interior else None)
    if options.position_sigma is not None and _misfit(begun, measured, frame)[0]:
        begun = _from_ties(unoriented, begun, measured, sigma, frame, fixed_images(start, options.fixed))
    for note in begun.notes:
        warn(note)
    points, words = _placed(begun, measured, frame), ""
    seen = observed(start, begun.models, measured, frame, points, options)
    if free and np.isfinite(begun.points).all(axis=1).any():
        begun, words = _levelled(begun, [each for each in seen.groups if isinstance(each, Distances)], frame)
        points = _placed(begun, measured, frame)
        seen = observed(start, begun.models, measured, frame, points, options)
    missing = [measured.ids[point] for point in seen.kept if not np.isfinite(points[point]).all()]
    if missing:
        what = f"point '{missing[0]}' of the measured distances has no place: its rays do not meet"
        raise InputError(what, where="`distances`", hint="measure it in more images, or leave the distance out")
    unknowns = BlockUnknowns.of(
        start.names, begun.models, camera, seen.further, np.array(seen.kept, dtype=np.int64), points
    )
    held = fixed_images(start, options.fixed)
    own = tuple(
        replace(each, sigmas=np.zeros_like(each.sigmas))
        if index in held
        else (each if len(measured.control) else _near_their_start(begun.models[index], each))
        for index, each in enumerate(unknowns.image_parameters)
    )
    unknowns = replace(unknowns, image_parameters=own)
    problem = replace(BlockProblem.of(frame, unknowns, seen.groups), free="similarity" if free else None)
    return problem, problem.start(begun.models, points, [each.start for each in seen.further]), words


def _near_their_start(model: SensorModel, own: Unknowns) -> Unknowns:
    """Free parameters of an oriented image without a pose, with a-priori standard deviations."""
    free = np.isinf(own.sigmas)
    if isinstance(model, HasPose) or not free.any():
        return own
    # Tie points alone do not see where all scenes together lie (Grodecki and Dial, 2003): what the producer states of
    # their accuracy holds them near their start, else what is usual of satellites.
    stated = model.covariance if isinstance(model, HasCovariance) else None
    sigmas = USUAL * own.steps if stated is None else np.sqrt(np.diag(stated))
    return replace(own, sigmas=np.where(free & (sigmas > 0.0), sigmas, own.sigmas))


def _begun(block: UnorientedBlock, sigma: float, datum: bool, wider: float | None) -> InitialValues:
    """First values; with a wider bound for what lenses do, where they cannot be found without."""
    try:
        return initial_values(block, sigma, datum)
    except UndeterminedError as error:
        if wider is None:
            raise
        try:
            return initial_values(block, wider, datum)
        except UndeterminedError as other:  # what the first trial says is nearer to the cause
            raise (other if other.count < error.count else error) from None


def _from_ties(
    block: UnorientedBlock,
    given: InitialValues,
    measured: Measurements,
    sigma: float,
    frame: BlockFrame,
    held: Collection[int],
) -> InitialValues:
    """Start from tie points and camera positions alone, where it fits the images better than given angles do."""
    # Of images without a point nothing but their angles tells; those that are held stay where they are.
    seen = set(measured.image.tolist()) - set(held)
    loose = [index in seen and isinstance(model, HasPose) for index, model in enumerate(block.models)]
    try:
        found = initial_values(replace(block, oriented=block.oriented & ~np.array(loose)), sigma)
    except SolveError:  # a strip without turns, parts without a datum: nothing but the angles says how they lie
        return given
    return min(given, found, key=lambda each: _misfit(each, measured, frame))


def _levelled(begun: InitialValues, bars: Sequence[Distances], frame: BlockFrame) -> tuple[InitialValues, str]:
    """Start of a block that lies nowhere, level and as large as is known, and that in words."""
    local, models, scale = frame.local, list(begun.models), None
    for group in bars:
        # From afar measured distances would pass for blunders.
        with np.errstate(divide="ignore"):
            ratios = group.length / np.linalg.norm(begun.points[group.second] - begun.points[group.first], axis=1)
        scale = float(np.median(ratios[np.isfinite(ratios)])) if np.isfinite(ratios).any() else None
    poses = [pose_of(model, frame) for model in models]
    move, of_cameras = level_frame(begun.points, np.array([pose.centre for pose in poses]), scale)
    points = move.places(begun.points)
    ahead = local.to_geocentric(np.nanmedian(points, axis=0))
    for index, (model, pose) in enumerate(zip(begun.models, poses, strict=True)):
        assert isinstance(model, HasPose)  # of other sensors a block has a place
        centre, rotation = move.places(pose.centre[None])[0], pose.rotation @ move.rotation.T
        models[index] = model.posed(local.to_geocentric(centre), rotation @ local.axes, ahead, local.crs)
    level = "camera positions" if of_cameras else "tie points"
    size = "it is as large as its distances say"
    if scale is None:
        size = f"its unit is 1/{UNITS:.0f} of the height of the cameras above the ground, and no metre"
    words = f"the block has no place on the Earth: it is level by the plane of the {level}, and {size}"
    return replace(begun, models=tuple(models), points=points), words


def _misfit(begun: InitialValues, measured: Measurements, frame: BlockFrame) -> tuple[int, float]:
    """Images that first values do not fit, and the lower quartile of the distances of image positions, pixels."""
    # Half of the positions may be wrong, or of points that wrong ones displace: the quartile is of good ones still.
    off, rough = np.full(len(measured.image), np.inf), 0
    for image, rows in slices_of(measured.image):
        model = begun.models[image]
        seen = model.ground_to_image(frame.places(model.crs, begun.points[measured.point[rows]]))
        off[rows] = np.nan_to_num(np.linalg.norm(seen - measured.colrow[rows], axis=1), nan=np.inf)
        rough += float(np.quantile(off[rows], 0.25, method="lower")) > ROUGH * max(model.size)
    return rough, float(np.quantile(off, 0.25, method="lower"))


def _placed(begun: InitialValues, measured: Measurements, frame: BlockFrame) -> FloatArray:
    """First coordinates of points (S, 3), of those whose rays do not meet yet in the height of the others."""
    points = begun.points.copy()
    missing: BoolArray = ~np.asarray(np.isfinite(points).all(axis=1))
    if not missing.any() or missing.all() or is_local(frame.ground):
        return points
    # Disturbed orientations let the rays of a good point pass far from each other: it must not be lost for that.
    ground = frame.to_ground(points[~missing])
    height = float(np.median(ground[:, 2]))
    total, count = np.zeros_like(points), np.zeros(len(points))
    rows = np.flatnonzero(missing[measured.point])
    for image, part in slices_of(measured.image[rows]):
        mine = rows[part]
        places = image_to_height(begun.models[image], measured.colrow[mine], np.full(len(mine), height), frame.ground)
        seen = np.isfinite(places).all(axis=1)
        np.add.at(total, measured.point[mine[seen]], places[seen])
        np.add.at(count, measured.point[mine[seen]], 1.0)
    some = missing & (count > 0.0)
    points[some] = frame.from_ground(total[some] / count[some][:, None])
    return points


def _known(start: StartBlock, measured: Measurements, frame: BlockFrame, options: AdjustmentOptions) -> Known:
    """Places that are known before any image is oriented."""
    known = Known.nothing(len(start.scenes), len(measured.ids))
    points, sigmas = known.points.copy(), known.sigma_points.copy()
    whole = measured.control[np.isfinite(measured.given[measured.control]).all(axis=1)]
    whole = whole[np.isfinite(measured.sigma_given[whole]).all(axis=1)]
    points[whole] = frame.from_ground(measured.given[whole])
    sigmas[whole] = measured.sigma_given[whole].max(axis=1)
    centres: FloatArray = known.centres.copy()
    if options.position_sigma is not None:
        for index, scene in enumerate(start.scenes):
            if start.placed[index] and isinstance(scene.model, HasPose):
                centres[index] = pose_of(scene.model, frame).centre
    sigma_centres = np.full(len(centres), options.position_sigma or 1.0)
    return replace(known, points=points, sigma_points=sigmas, centres=centres, sigma_centres=sigma_centres)
