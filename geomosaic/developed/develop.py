"""Orthos and mosaics on a developed surface: footprints in (u, v), check of the cameras' side, grid and result."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.block import Footprint, OrientedBlock, OrientedImage
from geomosaic.developed.surface_file import SurfaceFile, read_surface
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal, is_local
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block, block_of
from geomosaic.inputs.exterior_orientation import RECONSTRUCTIONS
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.products.mosaics import check_outputs, reference_of
from geomosaic.raster.files import check_output
from geomosaic.render.extent import output_grid
from geomosaic.sensor.developed import OBLIQUE, OBLIQUE_LIMITS, DevelopedModel
from geomosaic.sensor.registry import capabilities
from geomosaic.surface.developed.placement import Developed
from geomosaic.surface.developed.primitives import Axes
from geomosaic.surface.model import Plane
from geomosaic.types import BoolArray, FloatArray, PathLike
from geomosaic.whole_files import path_of

if TYPE_CHECKING:
    from geomosaic.mosaicking.records import MosaicResult
    from geomosaic.render.ortho import OrthoResult


# Cells along the longer side at which an outline is measured.
CELLS = 256


@dataclass(frozen=True)
class DevelopedFootprint(Footprint):
    """Footprint on a developed surface, of several parts where the surface is cut.

    Attributes
    ----------
    parts : shapely Polygon or MultiPolygon
        All that the image shows, to a cell; `ring` is its bounding rectangle.
    """

    parts: Any = None

    @property
    def polygon(self) -> Any:
        """Outline of all parts."""
        return self.parts


def developed_footprint(scene: OrientedImage, model: DevelopedModel) -> DevelopedFootprint:
    """Footprint of an image on a developed surface.

    Parameters
    ----------
    scene : OrientedImage
    model : DevelopedModel
        Of the scene on the surface.

    Returns
    -------
    DevelopedFootprint
        In (u, v), metres on the surface; `sampling` is the size of an image pixel there.

    Raises
    ------
    InputError
        The camera stands on the wrong side of the surface, or the image shows nothing of it.
    """
    # Lines of sight through a net of pixels give the area to look at; a net of cells over it is then projected into the
    # image, twice, the second time on the bounds that the first has found.
    _check_side(scene, model)
    places, _ = model.seen()
    if not len(places):
        raise InputError(
            f"the image shows nothing of the {model.surface.body.kind}",
            where=scene.name,
            hint="check the surface's place and side, the frame of the positions, bottom and top, and `oblique`",
        )
    bounds = _padded(model, places)
    # Twice: the cells of the first pass are as coarse as its bounds are too wide.
    for _ in range(2):
        left, low, right, high = bounds
        cell = max(right - left, high - low) / CELLS
        u = np.linspace(left, right, max(2, round((right - left) / cell)) + 1)
        v = np.linspace(low, high, max(2, round((high - low) / cell)) + 1)
        image = _image(model, u, v)
        shown = _in_image(image, model.size)
        near = shown[:-1, :-1] | shown[1:, :-1] | shown[:-1, 1:] | shown[1:, 1:]
        whole = shown[:-1, :-1] & shown[1:, :-1] & shown[:-1, 1:] & shown[1:, 1:]
        if not whole.any():
            near = whole = near if near.any() else np.ones_like(near)
        rows, cols = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
        bounds = float(u[cols[0]]), float(v[rows[0]]), float(u[cols[-1] + 1]), float(v[rows[-1] + 1])
    left, low, right, high = bounds
    ring = np.array([[left, low], [right, low], [right, high], [left, high]])
    parts = _polygon(whole, u, v)
    centre, sampling = _best(parts, u, v, image)
    # Image seen on the border of the net goes on beyond it: the surface ends there, or its bounds cut the image.
    border = [image[0], image[-1], image[:, 0], image[:, -1]]
    complete = not any(_in_image(edge, model.size).any() for edge in border)
    return DevelopedFootprint(scene.name, ring, centre, sampling, complete, parts)


def _check_side(scene: OrientedImage, model: DevelopedModel) -> None:
    """Check that the camera stands on the side of the surface that is drawn; one without projection centre passes."""
    origin = model.origin()
    if origin is None:
        return
    surface, kind = model.surface, model.surface.body.kind
    above = surface.coordinates(origin[None])[0, 2]
    if not above < 0.0:  # NaN: off the development, so not inside either
        return
    if kind == "plane":
        raise InputError(
            f"the camera stands {-above:.3f} m behind the plane",
            where=scene.name,
            hint="turn the normal round: it points to the side that is looked at",
        )
    there, other = ("outside", "outside") if surface.inside else ("inside", "inside")
    raise InputError(
        f"the camera stands {there} the {kind}, {-above:.3f} m from its surface",
        where=scene.name,
        hint=f"check radius, place and the frame of the positions; side = '{other}' is for looking at it from there",
    )


def _padded(model: DevelopedModel, places: FloatArray) -> tuple[float, float, float, float]:
    """Bounds of places (N, 2), wider by what the net of pixels may have missed, within the domain."""
    low, high = places.min(axis=0), places.max(axis=0)
    # The small terms give an area to places that all lie on one line.
    pad = 0.05 * np.maximum(high - low, 1e-3 * max(1e-9, float((high - low).max()))) + 1e-9
    domain = np.array(model.surface.domain)
    low, high = np.maximum(low - pad, domain[:2]), np.minimum(high + pad, domain[2:])
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _image(model: DevelopedModel, u: FloatArray, v: FloatArray) -> FloatArray:
    """Image (rows, cols, 2) of the net of u and v; rows are those of v."""
    across, up = np.meshgrid(u, v)
    uvh = np.column_stack([across.ravel(), up.ravel(), np.zeros(across.size)])
    return model.ground_to_image(uvh).reshape(len(v), len(u), 2)


def _in_image(image: FloatArray, size: tuple[int, int]) -> BoolArray:
    with np.errstate(invalid="ignore"):
        return np.asarray(((image >= 0.0) & (image <= np.array(size))).all(axis=-1))


def _polygon(cells: BoolArray, u: FloatArray, v: FloatArray) -> Any:
    """Union of cells (rows, cols) as valid polygons, run by run."""
    import shapely

    runs = []
    for row, line in enumerate(cells):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8)))
        runs += [shapely.box(u[a], v[row], u[b], v[row + 1]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return shapely.union_all(runs).simplify(0.0)


def _best(parts: Any, u: FloatArray, v: FloatArray, image: FloatArray) -> tuple[tuple[float, float], float]:
    """Place seen best, the centre of the largest part weighted by pixels per area; and the pixel size there."""
    import shapely

    with np.errstate(invalid="ignore"):
        by_u, by_v = np.gradient(image, u, axis=1), np.gradient(image, v, axis=0)
        # Determinant of the Jacobian: image pixels per square metre of surface.
        pixels = np.abs(by_u[..., 0] * by_v[..., 1] - by_u[..., 1] * by_v[..., 0])
    largest = max(getattr(parts, "geoms", [parts]), key=lambda part: part.area)
    across, up = np.meshgrid(u, v)
    weight = np.where(shapely.contains_xy(largest, across, up) & np.isfinite(pixels), pixels, 0.0)
    if not weight.any():
        point = largest.representative_point()
        finite = pixels[np.isfinite(pixels) & (pixels > 0.0)]
        best = float(np.median(finite)) if len(finite) else 1.0
        return (point.x, point.y), float(1.0 / np.sqrt(best))
    total = weight.sum()
    centre = float((weight * across).sum() / total), float((weight * up).sum() / total)
    return centre, float(1.0 / np.sqrt(np.median(pixels[weight > 0.0])))


@dataclass(frozen=True)
class DevelopedResult:
    """Developed image, as an ortho of one image or a mosaic of several.

    Attributes
    ----------
    facts : dict
        The surface, see `SurfaceFile.facts`.
    notes : tuple of str
        On the surface and on the images' orientation.
    ortho : OrthoResult or None
        Where there is one image.
    mosaic : MosaicResult or None
        Where there are several.
    """

    facts: dict[str, Any]
    notes: tuple[str, ...]
    ortho: OrthoResult | None = None
    mosaic: MosaicResult | None = None


def develop(
    images: Block,
    output: PathLike,
    surface: PathLike,
    *,
    oblique: float = OBLIQUE,
    resolution: float | None = None,
    bounds: Bounds | None = None,
    **options: Any,
) -> DevelopedResult:
    """Photos of a facade, a tower or a dome on its developed surface, in metres.

    Parameters
    ----------
    images : Scene or Block
        Without a CRS their positions and control count in the frame of the surface file.
    output : path
        GeoTIFF to write.
    surface : path
        Surface file (TOML): plane, cylinder, cone, sphere or ellipsoid.
    oblique : float
        Largest angle between line of sight and normal that is drawn, degrees.
    resolution, bounds
        See `ortho`, in metres of the development.
    **options
        Of `MosaicOptions`, flat; of one image those of `RenderOptions` count.

    Raises
    ------
    InputError
        A camera stands on the wrong side, an image shows nothing of the surface, or an input does not fit it.
    GeomosaicError
        OutputError, SensorError or SolveError; nothing is left under the output's name.
    """
    OBLIQUE_LIMITS.check(oblique, "`oblique`")
    inputs, place, wanted = block_of(images, "images"), Area(None, resolution, bounds), MosaicOptions.of(**options)
    wanted.uncertainty.refuse("developed images")
    file, found = path_of(output, "output"), read_surface(path_of(surface, "surface"))
    read = (*inputs.files, *found.files)
    if len(inputs.images) > 1:
        check_outputs(file, wanted, read)
    else:
        check_output(file, overwrite=wanted.render.overwrite, inputs=read, geotiff=True)
    block = build_block(_in_frame(inputs, found), ground=False)
    thing, turned = _towards(found, block)
    scenes = tuple(
        replace(scene, model=DevelopedModel(scene.model, thing, scene.sensor, oblique)) for scene in block.scenes
    )
    grid, outlines = _plan(scenes, place)
    notes = (*found.notes, *turned, *(note for scene in block.scenes for note in _image_notes(scene, len(scenes) > 1)))
    facts = {**found.facts, **thing.to_dict()}
    # In the coordinates of the development, (u, v, height above the surface), the surface is a plane: rendering needs
    # no other.
    flat = Plane(thing.crs, 0.0)
    if len(scenes) == 1:
        from geomosaic.render.ortho import ortho

        one = ortho(scenes[0], flat, grid, outlines[0], file, wanted.render)
        return DevelopedResult(facts, notes, ortho=one)
    from geomosaic.mosaicking.mosaic import mosaic

    developed = OrientedBlock(scenes, flat)
    several = mosaic(developed, grid, list(outlines), file, wanted, reference=reference_of(wanted, inputs.bands))
    return DevelopedResult(facts, notes, mosaic=several)


def _in_frame(inputs: Block, found: SurfaceFile) -> Block:
    """Inputs with their positions in the surface's CRS, where they name none."""
    if inputs.dem is not None or inputs.height is not None:
        raise InputError("a DEM or a height has no part in a developed surface", hint="leave out `dem` and `height`")
    # Photos of facades and domes look level or up, which sensors refuse as a mistake unless told.
    if "upwards" not in inputs.options and capabilities(inputs.sensor).upwards:
        inputs = replace(inputs, options={**inputs.options, "upwards": True})
    if inputs.crs is not None or (inputs.angles in RECONSTRUCTIONS and is_local(found.crs)):
        return inputs
    return replace(inputs, crs=found.crs.to_wkt())


def _towards(found: SurfaceFile, block: OrientedBlock) -> tuple[Developed, list[str]]:
    """Surface turned to the cameras: a fitted plane without a declared side faces the first one."""
    if found.facing:
        return found.surface, []
    scene = block.scenes[0]
    origin = DevelopedModel(scene.model, found.surface, scene.sensor).origin()
    if origin is None:
        raise InputError(
            "nothing says which side of the plane is looked at", where=str(found.path), hint="give normal, roughly"
        )
    axes = found.surface.axes
    if found.surface.coordinates(origin[None])[0, 2] < 0.0:
        axes = Axes.facing(axes.origin, -axes.rotation[2], axes.rotation[1], str(found.path))
    normal = ", ".join(f"{value:+.4f}" for value in axes.rotation[2])
    return replace(found.surface, axes=axes), [f"the plane is looked at from the side of {scene.name}: normal {normal}"]


def _plan(scenes: tuple[OrientedImage, ...], area: Area) -> tuple[Grid, list[DevelopedFootprint]]:
    """Outlines of the images and the grid of the output, which ends where the development does."""
    outlines, models = [], []
    for scene in scenes:
        model = scene.model
        if isinstance(model, DevelopedModel):
            models.append(model)
            outlines.append(developed_footprint(scene, model))
    crs = horizontal(models[0].crs)
    wide = max(float(np.ptp(outline.ring, axis=0).max()) for outline in outlines)
    if area.resolution is not None and area.resolution > wide:
        raise InputError(
            f"one pixel of {area.resolution:g} m would be larger than all images together, {wide:.3g} m",
            hint="the resolution counts in metres on the surface",
        )
    grid = output_grid(crs, list(outlines), area.resolution, area.bounds, snap=area.snap)
    return grid, outlines


def _image_notes(scene: OrientedImage, several: bool) -> list[str]:
    """Notes of an image, with its name where there are several."""
    notes = [str(note) for note in getattr(scene.model, "notes", ())]
    return [f"{scene.name}: {note}" for note in notes] if several else notes
