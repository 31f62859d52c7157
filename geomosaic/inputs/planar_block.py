"""Oriented block of photos of flat ground, each placed by a plane transformation."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint, OrientedBlock, OrientedImage
from geomosaic.errors import InputError, SolveError, counted, listed, warn
from geomosaic.geo.crs import horizontal, parse_map
from geomosaic.inputs.control_points import check_control, read_block
from geomosaic.inputs.declarations import Block, file_of
from geomosaic.inputs.images import Photo, chosen_bands, photos_of, with_declared
from geomosaic.inputs.planar_facts import (
    chain_facts,
    gross_error_facts,
    growth_facts,
    joint_facts,
    placement_lines,
    single_facts,
)
from geomosaic.options.inputs import PlanarInputs
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.sensor.registry import build, plane_sensor
from geomosaic.sensor.solve.newton import jacobian
from geomosaic.types import FloatArray

if TYPE_CHECKING:
    from geomosaic.estimation.blunders.findings import BlunderReport
    from geomosaic.orientation.planar.measurements import PlanarBlock
    from geomosaic.orientation.planar.solution import PlanarSolution
    from geomosaic.orientation.planar.transformations import PlanarTransform


# Of each kind of mosaic, the usual transformation and those it can have.
_MODELS = {
    "uncontrolled": ("conformal", ("conformal", "affine", "projective")),
    "semicontrolled": ("conformal", ("conformal", "affine")),
    "controlled": ("projective", ("projective",)),
    "grown": ("affine", ("conformal", "affine", "projective")),
}

# Local CRS of a mosaic without control: its origin is the middle of the start photo; it has metres if the scale has.
_LOCAL = (
    'ENGCRS["uncontrolled mosaic",EDATUM["middle of the start photo"],CS[Cartesian,2],'
    'AXIS["(X)",east,ORDER[1]],AXIS["(Y)",north,ORDER[2]],LENGTHUNIT["metre",1]]'
)


@dataclass(frozen=True)
class Placed:
    """Placed photos of a planar block.

    Attributes
    ----------
    transforms : dict of str to PlanarTransform
        Transformations by photo.
    facts : dict
        Quality of the placement as JSON values; see `geomosaic.inputs.planar_facts`.
    solutions : dict of str to PlanarSolution
        Adjustment that gave each transformation, by photo; empty where photos were joined one by one, of which no
        covariance is known.
    """

    transforms: dict[str, PlanarTransform]
    facts: dict[str, Any]
    solutions: dict[str, PlanarSolution] = field(default_factory=dict)


def build_planar(inputs: Block, wanted: PlanarInputs) -> tuple[OrientedBlock, dict[str, Any]]:
    """Block of photos of flat ground, placed by plane transformations.

    Parameters
    ----------
    inputs : Block
        Images, control and its CRS.
    wanted : PlanarInputs
        Kind, model and tie points.

    Returns
    -------
    block : OrientedBlock
        Block without a surface; its control points have height 0.
    facts : dict
        Placement and its quality as JSON values.

    Raises
    ------
    InputError
        A table or declaration is missing or wrong.
    SolveError
        The points do not determine the photos.
    """
    crs, photos, block, points, placed = _placed(inputs, wanted)
    scenes = tuple(
        _scene(inputs, photo, placed.transforms[photo.name], crs, placed.solutions.get(photo.name)) for photo in photos
    )
    # The map of a mosaic without control is local: control points in a CRS cannot be compared with it.
    known: tuple[ControlPoint, ...] = () if wanted.is_local(controlled=inputs.control is not None) else points
    facts = {"summary": placement_lines(placed.facts), **placed.facts, "unused": _unused(block)}
    return OrientedBlock(scenes, None, known, crs if known else None), facts


def placed_alone(inputs: Block, wanted: PlanarInputs, image: Path) -> Block:
    """One photo of a planar block by itself, where the whole block places it.

    Parameters
    ----------
    inputs : Block
    wanted : PlanarInputs
    image : Path
        One of its images.

    Returns
    -------
    Block
        Of that image; its transformation is an input of its sensor.

    Raises
    ------
    InputError, SolveError
        As `build_planar`.
    """
    crs, _, _, _, placed = _placed(inputs, wanted)
    options = placed.transforms[image.name].options()
    return replace(
        inputs, images=(image,), planar=None, control=None, sensor=plane_sensor(), options=options, crs=crs.to_wkt(),
        heights=None,
    )  # fmt: skip


def _placed(
    inputs: Block, wanted: PlanarInputs
) -> tuple[CRS, list[Photo], PlanarBlock, tuple[ControlPoint, ...], Placed]:
    """Map, photos, measurements and control points of a planar block, and the placement that follows from them."""
    crs = _map(inputs, wanted)
    photos, _ = photos_of(inputs)
    control = file_of(inputs.control)
    if control is None and inputs.control is not None:
        raise InputError(
            "photos that are placed together take their control points from a file",
            where="`control`",
            hint="write a table: id, x, y, image, col, row",
        )
    block, points = read_block(photos, wanted.ties, control)
    if points and control is not None and wanted.kind != "uncontrolled":
        check_control(points, crs, control, wanted.blunder_policy)
    tables = " and ".join(path.name for path in (wanted.ties, control) if path is not None)
    return crs, photos, block, points, place(block, wanted, tables)


def plane_model(wanted: PlanarInputs) -> str:
    """Plane transformation of a planar block: as asked for, or what is usual for its kind.

    Parameters
    ----------
    wanted : PlanarInputs
    """
    return wanted.model or _MODELS[wanted.kind][0]


def place(block: PlanarBlock, wanted: PlanarInputs, tables: str = "tie and control points") -> Placed:
    """Placement of the photos of a planar block, by kind of mosaic.

    Parameters
    ----------
    block : PlanarBlock
    wanted : PlanarInputs
    tables : str
        Source of the points, for messages about wrong ones.

    Raises
    ------
    InputError
        The kind of mosaic does not have the model, or would not use an input that is given.
    SolveError
        The points do not determine the photos.
    """
    from geomosaic.orientation.planar.blunders import adjust_checked, search_any_adjustment, search_each_photo

    allowed, model = _MODELS[wanted.kind][1], plane_model(wanted)
    if model not in allowed:
        raise InputError(
            f"a {wanted.kind} mosaic has no {model} model",
            hint=f"{wanted.kind} takes {' or '.join(allowed)}"
            + (", controlled takes projective" if wanted.kind == "semicontrolled" else ""),
        )
    if wanted.kind == "uncontrolled":
        block, found = search_any_adjustment(block, model, True).enforced(tables, wanted.blunder_policy)
        return _uncontrolled(block, model, wanted, found)
    if wanted.kind == "grown":
        from geomosaic.orientation.planar.sequential import grow
        from geomosaic.orientation.planar.simultaneous import adjust_unchecked

        block, found = search_any_adjustment(block, model, False).enforced(tables, wanted.blunder_policy)
        grown = grow(block, model)
        if grown.failed:
            worst = sorted(grown.failed, key=lambda one: -one.largest)
            named = (
                f"{one.first} and {one.second} {one.along:.1f} px along the seam, {one.across:.1f} px across it, "
                f"largest gap {one.largest:.1f} px"
                for one in worst
            )
            warn(
                f"{len(worst)} of {counted(len(grown.joins), 'join')} do not meet: "
                f"{listed(named, 3, '; ')}: measure more control there"
            )
        together = None
        with suppress(SolveError):
            together = adjust_unchecked(block, model, {}, None)[0]
        return Placed(grown.transforms, growth_facts(grown, model, together) | gross_error_facts(found))
    if wanted.kind == "controlled" and _singly(block, wanted):
        from geomosaic.orientation.planar.uncontrolled import rectify_singly

        block, found = search_each_photo(block, model).enforced(tables, wanted.blunder_policy)
        single = rectify_singly(block, model)
        transforms = {name: solution.transforms[name] for name, solution in single.items()}
        return Placed(transforms, single_facts(block, single, model) | gross_error_facts(found), single)
    held = _start(block, model, wanted)
    solution, found = adjust_checked(block, model, held, policy=wanted.blunder_policy, where=tables)
    facts = joint_facts(solution, wanted.kind) | gross_error_facts(found)
    return Placed(dict(solution.transforms), facts, dict.fromkeys(solution.transforms, solution))


def _start(block: PlanarBlock, model: str, wanted: PlanarInputs) -> dict[str, PlanarTransform]:
    """Start photo and its place where there is no control: it gives scale, azimuth and origin of the mosaic."""
    from geomosaic.orientation.planar.uncontrolled import chain

    if not wanted.is_local(controlled=bool(block.control)):
        if (wanted.scale, wanted.azimuth) != (1.0, 0.0):
            raise InputError(
                "the control points give the mosaic its scale and azimuth",
                where="`scale`" if wanted.scale != 1.0 else "`azimuth`",
                hint="leave it out, or leave out the control",
            )
        return {}
    made = chain(block, model, scale=wanted.scale, azimuth=wanted.azimuth)
    return {made.start: made.transforms[made.start]}


def _uncontrolled(block: PlanarBlock, model: str, wanted: PlanarInputs, found: BlunderReport) -> Placed:
    from geomosaic.orientation.planar.uncontrolled import chain, compare, reference

    made = chain(block, model, scale=wanted.scale, azimuth=wanted.azimuth)
    for one in made.attachments:
        if one.refused:
            warn(f"{one.photo} is joined by a conformal transformation, not the {model} one: {one.refused}")
    adjusted, against = reference(block, made, model)
    error = compare(block, made, adjusted.transforms, against, adjusted.kind)
    return Placed(made.transforms, chain_facts(block, made, model, error) | gross_error_facts(found))


def _singly(block: PlanarBlock, wanted: PlanarInputs) -> bool:
    """Whether each photo is rectified singly: as asked for, else where each has enough control."""
    if wanted.rectify is not None:
        return wanted.rectify == "singly"
    counts = {photo.name: 0 for photo in block.photos}
    for point in block.control:
        counts[point.photo] += 1
    return min(counts.values()) >= 4  # a projective transformation has eight parameters


def _map(inputs: Block, wanted: PlanarInputs) -> CRS:
    """CRS of the mosaic: that of the control, or a local one."""
    if wanted.is_local(controlled=inputs.control is not None):
        return CRS.from_wkt(_LOCAL)
    if inputs.control is None:
        raise InputError(
            f"a {wanted.kind} mosaic needs control points",
            hint="give `control`, or make it uncontrolled",
        )
    if inputs.crs is None:
        raise InputError(
            "the control points have no CRS",
            where=str(inputs.control),
            hint="name it with `crs`",
        )
    crs = horizontal(parse_map(inputs.crs, "CRS of the control points"))
    if crs.is_geographic:
        raise InputError(
            f"the control points are in degrees ({crs.name}); plane transformations need a map with equal scales",
            where=str(inputs.control),
            hint="transform them to a projected CRS, such as the UTM zone",
        )
    return crs


def _scene(
    inputs: Block, photo: Photo, transform: PlanarTransform, crs: CRS, solution: PlanarSolution | None
) -> OrientedImage:
    request = SensorRequest(photo.name, photo.info.size, transform.options(), crs, str(inputs.base))
    sensor = plane_sensor()
    bands = chosen_bands(inputs, photo.path)
    model = build(sensor, request)
    covariance = None if solution is None else model_covariance(model, transform, solution)
    known_by = "" if covariance is None else "orientation: adjustment of the planar block"
    scene = OrientedImage(
        photo.name, str(photo.path), sensor, model, inputs.src_nodata, bands, covariance=covariance, known_by=known_by
    )
    return with_declared(inputs, [scene])[0]


def model_covariance(model: SensorModel, transform: PlanarTransform, solution: PlanarSolution) -> FloatArray:
    """Covariance (P, P) of a model's parameters from that of the transformation it was made of.

    A change of either moves the image of a place: -(∂X/∂c)⁻¹·∂X/∂p by the transformation, photo to ground, and ∂c/∂q by
    the model, ground to photo. As both are one family, these equations hold exactly at places enough.

    Parameters
    ----------
    model : SensorModel
    transform : PlanarTransform
    solution : PlanarSolution
        Adjustment of the transformation.
    """
    from geomosaic.orientation.planar.transformations import by_parameters, photo_coordinates

    size = transform.photo.size
    colrow = np.stack(np.meshgrid(*(np.linspace(0.0, side, 4) for side in size)), axis=2).reshape(-1, 2)
    ground = transform.to_ground(colrow)
    by_own = by_parameters(transform.kind, transform.values, photo_coordinates(size, colrow)) * transform.frame.scale
    moved = -np.linalg.solve(transform.slope(colrow), by_own)
    by_model = jacobian(model, np.column_stack([ground, np.zeros(len(ground))]))[0]
    count = len(transform.values)
    change = np.linalg.lstsq(by_model.reshape(-1, count), moved.reshape(-1, count), rcond=None)[0]
    covariance: FloatArray = change @ solution.covariance(transform.photo.name) @ change.T
    return covariance


def _unused(block: PlanarBlock) -> list[str]:
    """Tie points that are measured in one photo only."""
    seen: dict[str, int] = {}
    for measured in block.measurements:
        seen[measured.id] = seen.get(measured.id, 0) + 1
    known = {point.id for point in block.control}
    return sorted(name for name, count in seen.items() if count == 1 and name not in known)
