"""Oriented block of declared inputs: images with their models, surface and control points."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint, OrientedBlock, OrientedImage
from geomosaic.errors import GeomosaicError, HeightDatumError, InputError, SensorInputError, SolveError
from geomosaic.geo.crs import has_heights
from geomosaic.geo.transform import Transform
from geomosaic.image_names import file_of_image
from geomosaic.inputs.declarations import Block, read_camera
from geomosaic.inputs.exterior_orientation import RECONSTRUCTIONS, ExteriorRow
from geomosaic.inputs.ground import DEM_MEMORY, OF_POSITIONS, build_surface, height_below, undeclared_positions
from geomosaic.inputs.images import Photo, chosen_bands, photos_of, with_declared
from geomosaic.inputs.tables import read_fiducials
from geomosaic.raster.info import inspect
from geomosaic.sensor.inputs import known_inputs
from geomosaic.sensor.plausibility import DATUMS, SkyError
from geomosaic.sensor.plugin import ControlUse, HasRays, SensorRequest
from geomosaic.sensor.registry import build as build_model
from geomosaic.sensor.registry import capabilities, plugin
from geomosaic.surface.model import Surface

if TYPE_CHECKING:
    from geomosaic.sensor.plugin import SensorModel


def build_block(inputs: Block, *, ground: bool = True, dem_memory: int = DEM_MEMORY) -> OrientedBlock:
    """Oriented block of declared inputs, with surface and control points.

    Parameters
    ----------
    inputs : Block
    ground : bool
        False leaves out the surface and all checks that need one.
    dem_memory : int
        Bytes that its DEM may hold between reads.

    Raises
    ------
    InputError
        An input is missing or wrong; names the file, line or option.
    """
    refuse_unknown_inputs(inputs)
    _refuse_missing(inputs)
    if inputs.planar is not None:
        from geomosaic.inputs.planar_block import build_planar

        return build_planar(inputs, inputs.planar)[0]
    photos, crs = photos_of(inputs)
    if crs is not None and not has_heights(crs) and any(photo.exterior for photo in photos):
        raise undeclared_positions(inputs, crs, photos)
    moved = partial(_moved_by_a_metre, inputs, photos, crs)
    surface = build_surface(inputs, crs, photos, moved, dem_memory) if ground else None
    control = _control(inputs, photos, crs)

    def build(read: Block, some: Sequence[Photo], frame: CRS | None) -> tuple[OrientedImage, ...]:
        return _scenes(read, some, frame, control, surface)

    try:
        scenes = build(inputs, photos, crs)
    except SkyError as error:
        from geomosaic.inputs.orientation_plausibility import hints_for_upward_views

        hints = hints_for_upward_views(inputs, photos, crs, build) if crs is not None else []
        down = " or ".join(hints[:2])
        error.hint = f"all photos would look down if you {down}; else {error.hint}" if hints else error.hint
        raise
    except SolveError as error:
        _explain(inputs, control, crs, error)
        raise
    if ground and (len(scenes) > 1 or control):  # a single photo gives no other evidence than its horizon
        from geomosaic.inputs.orientation_plausibility import check_orientation
        from geomosaic.inputs.recorded_places import check_recorded_places

        check_recorded_places(inputs, photos, crs)
        check_orientation(inputs, photos, crs, (scenes, surface, control), build)
    if surface is not None and crs is not None and inputs.height is not None:
        from geomosaic.inputs.orientation_plausibility import check_ground_height

        check_ground_height(inputs, photos, crs, surface)
    return OrientedBlock(with_declared(inputs, scenes), surface, control, crs)


def refuse_unknown_inputs(inputs: Block) -> None:
    """Check that a block's own inputs are inputs of its sensor, before what they were meant to be is missed.

    Parameters
    ----------
    inputs : Block

    Raises
    ------
    InputError
        Names the input, the nearest one that the sensor has, and all of them.
    """
    for name, given in (("", inputs.options), *inputs.image_options.items()):
        if given:
            known_inputs(given, plugin(inputs.sensor).inputs, inputs.sensor, name or inputs.images[0].name)


def _refuse_missing(inputs: Block) -> None:
    """Check that the files of camera and DEM exist, while it is known which option named them."""
    for name, given in (("camera", inputs.camera), ("dem", inputs.dem)):
        # GDAL reads from archives and addresses, too, which are no files.
        local = isinstance(given, Path) and not str(given).startswith("/vsi") and ":" not in str(given)
        if isinstance(given, Path) and local and not given.exists():
            number = name == "dem" and given.name.replace(".", "", 1).isdigit()
            hint = "one height for all the ground is given as `height`" if number else "check the path"
            raise InputError(f"the file of `{name}` does not exist", where=str(given), hint=hint)


def join_blocks(parts: Sequence[Block], blocks: Sequence[OrientedBlock]) -> OrientedBlock:
    """Block of several, each of its own sensor, over the one ground that they name.

    Parameters
    ----------
    parts : sequence of Block
    blocks : sequence of OrientedBlock
        Built of them.

    Returns
    -------
    OrientedBlock
        With control points where there is one part; those of several may lie in several CRS.

    Raises
    ------
    InputError
        The parts name different grounds, or two images have one name.
    """
    # One of them tells the ground for all: sensors that use no heights need none.
    pairs = tuple(zip(parts, blocks, strict=True))
    grounds = {
        # A height without a datum of its own counts from that of the positions.
        (
            part.dem,
            part.height,
            part.dem_from_tie_points,
            part.dem_heights or (part.heights if part.height is not None else None),
        )
        for part, block in pairs
        if block.surface is not None
    }
    if len(grounds) > 1:
        raise InputError("the images stand on different grounds", where="`dem`", hint="give one `dem` for all of them")
    scenes = tuple(replace(scene, group=k) for k, block in enumerate(blocks) for scene in block.scenes)
    first = blocks[0] if len(blocks) == 1 else None
    surface = next((block.surface for block in blocks if block.surface is not None), None)
    return OrientedBlock(scenes, surface, first.control if first else (), first.crs if first else None)


def refuse_unused_ground(parts: Sequence[Block], *, uses_surface: bool) -> None:
    """Check that images which are georeferenced already are given no input that would do nothing.

    Parameters
    ----------
    parts : sequence of Block
        Of one product. Where one is placed otherwise, its ground is that of all, and nothing is refused.
    uses_surface : bool
        Whether the product needs a surface whatever its images are, as seams beside raised objects do.

    Raises
    ------
    InputError
        Names the input.
    """
    if not all(map(_lies_as_its_files_say, parts)):
        return
    for part in parts:
        own = all(inspect(image, part.bands).crs is not None for image in part.images)
        idle = ["heights", *(["crs"] if own else []), *([] if uses_surface else ["dem", "height", "dem_heights"])]
        for name in idle:
            if getattr(part, name) is not None:
                what = f"`{name}` would do nothing: the images are georeferenced and lie as their files say"
                raise InputError(what, hint=f"leave out `{name}`, or name the `sensor` that took the images")


def _lies_as_its_files_say(part: Block) -> bool:
    power = capabilities(part.sensor)
    placed = {name for given in (part.options, *part.image_options.values()) for name in given} & {*power.placements}
    otherwise = (part.planar, part.control, part.exterior)
    return power.planar and not placed and all(each is None for each in otherwise)


def unadjusted(inputs: Block) -> Sequence[OrientedImage] | None:
    """Images of a block before the adjustment of their sensor on the control points.

    Parameters
    ----------
    inputs : Block

    Returns
    -------
    sequence of OrientedImage or None
        None where the sensor does not adjust itself on control, or where the images cannot be built without it.
    """
    if capabilities(inputs.sensor).control is not ControlUse.ADJUSTMENT:
        return None
    # The run with control gives the same warnings.
    options = {**inputs.options, "refine": "none"}
    own = {name: {**some, "refine": "none"} for name, some in inputs.image_options.items()}
    plain = replace(inputs, control=None, options=options, image_options=own)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return build_block(plain, ground=False).scenes
    except GeomosaicError:
        return None


def _explain(inputs: Block, control: Sequence[ControlPoint], crs: CRS | None, error: SolveError) -> None:
    """Addition of the likeliest cause to the error of a sensor that its control points did not determine."""
    points = [point for point in control if point.role == "control"]
    scenes = unadjusted(inputs) if points else None
    if crs is None or scenes is None:
        return
    from geomosaic.inputs.control_diagnostics import likeliest_cause
    from geomosaic.inputs.orientation_plausibility import median_distance

    cause, hint = likeliest_cause(scenes, points, crs, median_distance(scenes, points, crs))
    if cause:
        error.what, error.hint = f"{error.what}: the points do not lie in the image; {cause}", hint


def _moved_by_a_metre(inputs: Block, photos: Sequence[Photo], crs: CRS | None) -> float | None:
    """Pixels that a metre of height moves the first image, if its model needs no control; else None."""
    from geomosaic.sensor.plausibility import pixels_per_metre

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            moved = pixels_per_metre(_scenes(inputs, photos[:1], crs, (), None)[0].model)
    except InputError:
        return None
    return moved if np.isfinite(moved) else None


def _scenes(
    inputs: Block,
    photos: Sequence[Photo],
    crs: CRS | None,
    control: Sequence[ControlPoint],
    surface: Surface | None,
) -> tuple[OrientedImage, ...]:
    """Oriented images of the photos."""
    camera = read_camera(inputs.camera) if inputs.camera else None
    marks = read_fiducials(inputs.fiducials, [photo.name for photo in photos]) if inputs.fiducials else {}
    return tuple(
        OrientedImage(
            photo.name,
            str(photo.path),
            inputs.sensor,
            _corrected(inputs, photo, _model(inputs, photo, crs, camera, marks.get(photo.name), control, surface)),
            inputs.src_nodata,
            chosen_bands(inputs, photo.path),
        )
        for photo in photos
    )


def _corrected(inputs: Block, photo: Photo, model: SensorModel) -> SensorModel:
    """Model with the correction grid behind it, where one is given."""
    if inputs.corrections is None:
        return model
    from geomosaic.inputs.correction_grids import read_corrections
    from geomosaic.sensor.corrected import Corrected

    grid = read_corrections(file_of_image(inputs.corrections, photo.name))
    return Corrected.of(model, grid, inputs.sensor)


def _model(
    inputs: Block,
    photo: Photo,
    crs: CRS | None,
    camera: Mapping[str, Any] | None,
    marks: Mapping[str, Any] | None,
    control: Sequence[ControlPoint],
    surface: Surface | None,
) -> SensorModel:
    options = dict(inputs.options)
    if camera is not None:
        options["camera"] = dict(camera)
    options |= inputs.image_options.get(photo.name, {})
    if marks is not None:
        options["fiducials"] = dict(marks)
    row = photo.exterior
    # The sensor reads camera and orientation from the other program's file itself.
    if inputs.angles in RECONSTRUCTIONS and isinstance(inputs.exterior, Path):
        options["orientation"] = {"system": inputs.angles, "reconstruction": str(inputs.exterior.resolve())}
    power = capabilities(inputs.sensor)
    if row is not None:
        _refuse_gaps(inputs, row, photo.name, [name for name in power.exterior if name not in options])
        options.update(_of_table(inputs, row))
    if power.planar:
        crs = _complete_planar(options, photo, crs, control, power.placements)
    elif "points" not in options and _uses_control(power.control, options, row):
        points = _points(photo, control)
        options.update({"points": points} if points else {})
    try:
        request = SensorRequest(photo.name, photo.info.size, options, crs, str(inputs.base), str(photo.path))
        return _on_ground(inputs.sensor, request, surface, row.position if row and row.placed else None)
    except InputError as error:
        placed = options.keys() & {*power.exterior, "points"}
        if isinstance(error, SensorInputError) and error.name in power.exterior and not placed:
            error.what = "the position of the camera is not given"
            error.hint = "give `exterior`, a table of positions and angles"
        # An error about an image's row of the table names its line; one about an input of all images has none.
        if error.where == photo.name and inputs.exterior is not None:
            if row is not None and not _concerns_all_images(error, inputs):
                error.where = f"{photo.name} ({inputs.exterior}, line {row.line})"
            elif isinstance(error, HeightDatumError):
                error.hint = f"declare it with {OF_POSITIONS}: {DATUMS}"
        raise


def _refuse_gaps(inputs: Block, row: ExteriorRow, name: str, wanted: Sequence[str]) -> None:
    """Check that a row of the orientation table has what nothing else gives."""
    known = {"position": row.placed, "orientation": row.turned}
    what = {"position": "position", "orientation": "angles"}
    missing = [what[each] for each in wanted if not known.get(each, True)]
    if missing:
        raise InputError(
            f"the table has no {' and no '.join(missing)} of this image",
            where=f"{name} ({inputs.exterior}, line {row.line})",
            hint="fill them in; or let tie points orient the photos: [match] or [adjust] in a project, `adjust`",
        )


def _of_table(inputs: Block, row: ExteriorRow) -> dict[str, Any]:
    """Row of the orientation table as inputs of the sensor; what it does not know is left out."""
    declared = {"frame": inputs.angle_frame, "matrix": inputs.matrix}
    extra = {name: word for name, word in declared.items() if word is not None}
    system = inputs.angles
    if system == "printed":  # printed lists are converted to matrices on reading
        system, extra["matrix"] = "matrix", "ground_to_image"
    columns: dict[str, Any] = {"position": list(row.position)} if row.placed else {}
    if row.turned:
        columns["orientation"] = {"system": system, **row.angles, **extra}
        columns["angle_unit"] = inputs.angle_unit or "deg"
    taken = capabilities(inputs.sensor).exterior
    if row.velocity is not None and row.turned and "velocity" in taken:
        columns["orientation"]["velocity"] = list(row.velocity)
        if row.rates is not None:
            columns["orientation"]["rates"] = list(row.rates)
    # A sensor that takes none of them gets all and refuses them by name: no table is silently unused.
    return {name: value for name, value in columns.items() if name in taken} or columns


def _on_ground(
    sensor: str, request: SensorRequest, surface: Surface | None, camera: Sequence[float] | None
) -> SensorModel:
    """Model of an image, with the height of the ground below the camera where the sensor takes it."""
    crs, options = request.crs, request.options
    wanted = capabilities(sensor).ground_height and "ground_height" not in options
    if surface is None or crs is None or not wanted:
        return build_model(sensor, request)
    model = None
    if camera is None:
        # Without a table only a model gives the camera's place: one is built without the height to find it.
        model = build_model(sensor, request)
        if not isinstance(model, HasRays):
            return model
        middle = np.array([[request.size[0] / 2, request.size[1] / 2]])
        camera = Transform(model.crs, crs)(model.rays(middle)[0])[0].tolist()
    height = height_below(surface, crs, camera)
    if height is None:
        return model or build_model(sensor, request)
    with warnings.catch_warnings():
        if model is not None:
            warnings.simplefilter("ignore")  # the first model has given them already
        return build_model(sensor, replace(request, options={**options, "ground_height": height}))


def _concerns_all_images(error: InputError, inputs: Block) -> bool:
    """Whether an error is about an input that is the same for all images, not about the image's row of the table."""
    shared = {*inputs.options, *(entry.name for entry in plugin(inputs.sensor).inputs)} - {"position", "orientation"}
    return isinstance(error, SensorInputError) and error.name in shared


def _complete_planar(
    options: dict[str, Any],
    photo: Photo,
    crs: CRS | None,
    control: Sequence[ControlPoint],
    placements: Sequence[str],
) -> CRS | None:
    """CRS of a planar model, whose `options` are completed from control points, else from the image's georeference."""
    if not options.keys().isdisjoint(placements):
        return crs or photo.info.crs
    points = _points(photo, control)
    if points:
        options["points"] = points
        return crs
    own = photo.info.transform
    if own is None:
        raise InputError(
            "the image is not georeferenced, and no other input gives its place",
            where=str(photo.path),
            hint="give `sensor` with its inputs (see `geomosaic sensors`), or control points",
        )
    if crs is None and photo.info.crs is None:
        raise InputError("the image has a geotransform but no CRS", where=str(photo.path), hint="give `crs`")
    options["transform"] = [own.a, own.b, own.c, own.d, own.e, own.f]
    return photo.info.crs or crs


def _uses_control(use: ControlUse, options: Mapping[str, Any], row: ExteriorRow | None) -> bool:
    """Whether the sensor is to be given the control points of an image that has these options."""
    if use is ControlUse.ADJUSTMENT:
        return bool(options.get("refine") != "none")
    return use is ControlUse.RESECTION and row is None and "orientation" not in options


def is_adjusted(inputs: Block) -> bool:
    """Whether the control points of a block take part in the orientation of its images.

    Parameters
    ----------
    inputs : Block
    """
    power, placed = capabilities(inputs.sensor), {"points", "orientation"} & set(inputs.options)
    if inputs.control is None or (power.control is ControlUse.RESECTION and (placed or inputs.exterior is not None)):
        return False
    return _uses_control(power.control, inputs.options, None)


def gives_exterior(inputs: Block) -> bool:
    """Whether control points give the images of a block an exterior orientation, which a table can hold.

    Parameters
    ----------
    inputs : Block
    """
    power = capabilities(inputs.sensor)
    placed = "orientation" in power.exterior and power.control is ControlUse.RESECTION
    return inputs.planar is None and placed and is_adjusted(inputs)


def _points(photo: Photo, control: Sequence[ControlPoint]) -> list[dict[str, Any]]:
    """Control points of an image as an input of its sensor; check points stay out."""
    return [
        {
            "id": point.id, "x": point.xyz[0], "y": point.xyz[1], "z": point.xyz[2],
            "col": point.colrow[0], "row": point.colrow[1], "sigma": point.sigma_px,
        }
        for point in control
        if point.image == photo.name and point.role == "control"
    ]  # fmt: skip


def _control(inputs: Block, photos: Sequence[Photo], crs: CRS | None) -> tuple[ControlPoint, ...]:
    if inputs.control is None:
        return ()
    from geomosaic.inputs.control_points import control_values, read_control

    if crs is None:
        raise InputError("the control points have no CRS", where=str(inputs.control), hint="name it with `crs`")
    if isinstance(inputs.control, Mapping):
        points, where = control_values(inputs.control, crs), "`control`"
    else:
        names, plane = [photo.name for photo in photos], capabilities(inputs.sensor).planar
        points, where = read_control(inputs.control, names, plane=plane), str(inputs.control)
    if points and not inputs.trusted:
        from geomosaic.inputs.control_diagnostics import refuse_misplaced

        refuse_misplaced(points, crs, where)
    return points
