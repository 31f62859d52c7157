"""Control points of a block from a georeferenced reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block import OrientedImage
from geomosaic.block_adjustment.start import StartBlock
from geomosaic.control.points import ControlPoints, mean_sigmas
from geomosaic.errors import GeomosaicError, InputError, SolveError, counted
from geomosaic.execution.units import map_units, workers_for
from geomosaic.geo.crs import crs_code, has_heights, horizontal
from geomosaic.geo.grid import Grid
from geomosaic.geo.transform import Transform
from geomosaic.inputs.control_table import write_control
from geomosaic.matching.two_view import LEAST_MATCHES
from geomosaic.options.tie_points import TiePointOptions
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.initial_values import Known, UnorientedBlock, initial_values
from geomosaic.reference_matching.drawing import Drawer, georeferenced
from geomosaic.reference_matching.match import Reference, ReferenceMatch, match_oriented, not_found, refine
from geomosaic.reference_matching.search import LOOSE, SearchedReference, match_anywhere
from geomosaic.report.reference_matches import FoundImage, render_reference
from geomosaic.sensor.plugin import HasPose
from geomosaic.stores.path import to_path
from geomosaic.tie_points.distant_positions import distances_beyond, too_distant
from geomosaic.types import FloatArray, PathLike, Progress

# Pixels by which a photo of an assumed focal length may miss places over a relief.
LOOSE_SIGMA = 4.0


@dataclass(frozen=True, eq=False)
class ReferenceControl:
    """Control points that were found in a reference.

    Attributes
    ----------
    reference : str
        Its file.
    control : mapping of str to ControlPoints
        By image, in the CRS of the block, with covariances in the image and standard deviations on the ground; what
        `adjust` and `Block` take. A place that several images show has one name.
    matches : mapping of str to ReferenceMatch
        By image: residuals, and the model resected on the points.
    failures : mapping of str to str
        Images that were not found, and why.
    sigma_xy, sigma_z : float
        Standard deviations of the points on the ground, metres: declared, or, of the plan, what the residuals tell.
    """

    reference: str
    control: Mapping[str, ControlPoints]
    matches: Mapping[str, ReferenceMatch]
    failures: Mapping[str, str]
    sigma_xy: float
    sigma_z: float

    @cached_property
    def facts(self) -> dict[str, Any]:
        """Result as JSON values."""
        return {
            "reference": self.reference,
            "points": len({name for points in self.control.values() for name in points.names}),
            "positions": sum(map(len, self.control.values())),
            "sigma_xy": self.sigma_xy,
            "sigma_z": self.sigma_z,
            "images": [
                {
                    "name": name,
                    "points": len(found),
                    "tried": found.tried,
                    "rms_px": found.rms,
                    "moved_m": None if np.isnan(found.moved) else found.moved,
                }
                for name, found in self.matches.items()
            ],
            "failures": dict(self.failures),
        }

    @property
    def summary(self) -> str:
        """Result in words."""
        count = len(self.control) + len(self.failures)
        crs = next(iter(self.control.values())).crs
        lines = [
            f"{len(self.control)} of {counted(count, 'image')} found in {self.reference}: "
            f"{counted(self.facts['points'], 'control point')}, {counted(self.facts['positions'], 'image position')}",
            f"standard deviation of a point: {self.sigma_xy:.3g} m in plan, {self.sigma_z:.3g} m in height; errors "
            "that the whole reference has are not in it",
            f"coordinates are in '{crs.name}' ({crs_code(crs)})",
        ]
        lines += [
            f"{name}: {counted(len(found), 'point')}, RMS {found.rms:.2f} px after its resection; "
            + ("found without an orientation" if np.isnan(found.moved) else f"it lay {found.moved:.3g} m off")
            for name, found in self.matches.items()
        ]
        lines += [f"{name}: {why}" for name, why in self.failures.items()]
        return "\n".join(lines)

    def page(self, name: str, notes: Sequence[str] = ()) -> str:
        """Report as an HTML page: control, residuals and places left out, drawn over each image.

        Parameters
        ----------
        name : str
            Of the block, as its title.
        notes : sequence of str
            What the user was warned of.
        """
        found = [
            FoundImage(
                image, each.scene.path, each.scene.model.size, each.colrow, each.residuals, each.left_out, each.rms,
                each.moved,
            )
            for image, each in self.matches.items()
        ]  # fmt: skip
        return render_reference(found, self.failures, name, self.summary.splitlines(), notes)

    def write(self, path: PathLike, crs: CRS | None = None) -> Path:
        """Table of control points, as the `control` of a block takes it.

        Parameters
        ----------
        path : path-like
        crs : CRS, optional
            3-D, of the coordinates; that of the block's results, in metres, unless given.

        Returns
        -------
        Path
        """
        return write_control(path, self.control, crs)


def reference_control(start: StartBlock, options: TiePointOptions, progress: Progress) -> ReferenceControl:
    """Control points of the images of a block from `options.reference`; see `geomosaic.match`.

    Parameters
    ----------
    start : StartBlock
    options : TiePointOptions
    progress : callable

    Raises
    ------
    InputError
        The reference cannot be read, or the images have no orientation to start from.
    SolveError
        No image was found in it.
    """
    if options.reference is None:
        raise InputError("no reference is given", where="`reference`", hint="give a georeferenced raster")
    if start.surface is None and any(has_heights(model.crs) for model in start.models):
        raise InputError(
            "control points need the heights of the ground", where="`dem`", hint="give a DEM, or one height"
        )
    scene, grid = georeferenced(options.reference, "the reference")
    matches: dict[str, ReferenceMatch] = {}
    failures: dict[str, GeomosaicError] = {}
    distant = distances_beyond(start, grid, options.search)
    if np.isfinite(distant).all():
        raise too_distant(distant, scene.path)
    found_in, names = _FoundInReference(start, scene, grid, options.search, distant), start.names
    with workers_for(options), found_in.searched.reference.drawer:
        # One image after the other where threads do: each is on all processors.
        results = map_units(found_in, range(len(names)), replace(options, threads=1))
        for number, found in results:
            if isinstance(found, ReferenceMatch):
                matches[names[number]] = found
            else:
                failures[names[number]] = found
            progress(number + 1, len(names), "reference")
    if not matches:
        name, first = next(iter(failures.items()))
        if len(failures) == 1:
            raise first
        raise (InputError if isinstance(first, InputError) else SolveError)(
            f"none of {len(failures)} images is found; {name}: {first.what}", where=first.where, hint=first.hint
        ) from first
    plan = options.reference_sigma
    if plan is None:
        plan = float(np.sqrt(np.mean([found.sigma**2 for found in matches.values()])))
    height = options.height_sigma if options.height_sigma is not None else plan
    control = _control(start, matches, grid.resolution, np.array([plan, plan, height]))
    why = {name: error.what for name, error in failures.items()}
    return ReferenceControl(str(options.reference), control, matches, why, plan, height)


class _FoundInReference:
    """Places of images of a block in a reference, by their numbers, or why there are none; for any process.

    Parameters
    ----------
    start : StartBlock
    scene : OrientedImage
        The reference.
    grid : Grid
        Its own.
    search : float
        See `TiePointOptions`.
    distant : array (M,)
        Metres that images lie beyond the reference and the search; NaN for those that do not.
    """

    def __init__(self, start: StartBlock, scene: OrientedImage, grid: Grid, search: float, distant: FloatArray) -> None:
        self._made_of = start, scene, grid, search, distant
        self.searched = SearchedReference(Reference.open(scene, grid))

    def __reduce__(self) -> tuple[Any, ...]:
        start, *rest = self._made_of
        return _FoundInReference, (start.for_matching(), *rest)

    def __call__(self, number: int) -> ReferenceMatch | GeomosaicError:
        start, scene, _, search, distant = self._made_of
        image = start.scenes[number]
        try:
            if np.isfinite(distant[number]):
                return too_distant(distant[[number]], scene.path)
            if start.oriented[number]:
                return match_oriented(image, start.surface, self.searched.reference, search)
            return _match_unoriented(image, start, self.searched)
        except (InputError, SolveError) as error:
            return error


def _match_unoriented(image: OrientedImage, start: StartBlock, searched: SearchedReference) -> ReferenceMatch:
    """Places of a photo that nothing orients in a reference, wherever in it the photo lies.

    A homography of its features finds places; on these the photo is resected with what is known of its camera, and its
    places are measured anew through the sensor model, over the ground.
    """
    reference, surface = searched.reference, start.surface
    if not isinstance(image.model, HasPose) or surface is None:
        raise InputError(
            "nothing says where the image lies",
            where=image.name,
            hint="give its approximate position and angles with `exterior`",
        )
    found = match_anywhere(to_path(image.path), image.bands, searched)
    xy = Transform(reference.grid.crs, horizontal(surface.crs))(found.xy)
    xyz = Transform(surface.crs, start.ground)(np.column_stack([xy, surface.height(xy)]))
    seen = np.flatnonzero(np.isfinite(xyz).all(axis=1))
    if len(seen) < LEAST_MATCHES:
        raise not_found(reference, "the DEM has no heights where it lies in it", "give a DEM of the same land")
    frame = BlockFrame.at(start.ground, np.median(xyz[seen], axis=0)[None])
    known = Known.nothing(1, len(seen))
    points = replace(known, points=frame.from_ground(xyz[seen]), sigma_points=np.full(len(seen), found.sampling))
    block = UnorientedBlock(
        (image.name,), (image.model,), np.zeros(1, dtype=bool), np.zeros(len(seen), dtype=np.int64),
        np.arange(len(seen)), found.colrow[seen], frame.local, points,
    )  # fmt: skip
    model = initial_values(block, LOOSE_SIGMA).models[0]
    with Drawer.open(replace(image, model=model), surface, reference.grid.crs) as drawer:
        match = refine(drawer, reference, reference.factor(drawer), LOOSE, drawer)
    return replace(match, moved=float("nan"))


def _control(
    start: StartBlock, matches: Mapping[str, ReferenceMatch], pixel: tuple[float, float], sigmas: FloatArray
) -> dict[str, ControlPoints]:
    """Points by image, those at one pixel of the reference under one name."""
    numbers: dict[tuple[int, int], int] = {}
    found = {}
    for name, match in matches.items():
        # To a hundredth of a pixel: corners of one grid, cut at different places, differ by rounding.
        cells = np.rint(match.xy / np.array(pixel) * 100.0).astype(np.int64).tolist()
        names = [f"ref{numbers.setdefault((x, y), len(numbers) + 1)}" for x, y in cells]
        _, first = np.unique(names, return_index=True)
        kept = match.select(np.isin(np.arange(len(names)), first))
        source = start.surface.crs if start.surface is not None else match.scene.model.crs
        ground = Transform(source, start.ground)(kept.xyz)
        points = ControlPoints.from_arrays(
            kept.colrow, ground, start.ground, names=[names[k] for k in np.sort(first).tolist()],
            sigma=mean_sigmas(kept.covariance),
        )  # fmt: skip
        known = np.tile(sigmas, (len(points), 1))
        found[name] = replace(points, sigma_ground=known, covariance=kept.covariance)
    return found
