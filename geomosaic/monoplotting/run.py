"""Monoplotting of one image from plain declarations: pixels to the map, and map vectors into the photo."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from geomosaic.block import OrientedBlock, OrientedImage, footprint
from geomosaic.errors import InputError, SolveError, counted, warn
from geomosaic.geo.crs import crs_code, height_name, horizontal, parse_crs
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block, block_of, on_ground
from geomosaic.inputs.orientation_covariance import orientation, table_covariances
from geomosaic.inputs.orientation_plausibility import FAR, median_distance
from geomosaic.inputs.summary import control_discrepancies
from geomosaic.monoplotting.line_drawing import View, draw
from geomosaic.monoplotting.places import (
    Places,
    axes_of,
    check_name,
    ground_crs,
    is_digitized,
    outside_image,
    read_digitized,
    read_pixels,
    require_inside,
    write_csv,
    write_frame,
)
from geomosaic.monoplotting.places import locate as locate_points
from geomosaic.options.control import DrawOptions, LocateOptions
from geomosaic.options.declaration import compose
from geomosaic.raster.vector import VectorProduct, read_layer, read_product
from geomosaic.sensor.error_propagation import InputUncertainty
from geomosaic.sensor.plugin import SensorModel
from geomosaic.stores.path import given_path
from geomosaic.surface.dem import Dem, height_sigmas
from geomosaic.surface.model import Surface
from geomosaic.types import FloatArray, PathLike
from geomosaic.whole_files import finite, path_of

if TYPE_CHECKING:
    from geopandas import GeoDataFrame


ERROR = ("semi_major_m", "semi_minor_m", "azimuth_deg", "sigma_z_m")
POINT = ("id", "col", "row", "x", "y", "z", *ERROR)


@dataclass(frozen=True)
class MonoplotInputs:
    """Files of monoplotting, with the block of the image.

    Attributes
    ----------
    block : Block
        The image, its sensor and the surface.
    source : Path, optional
        Table or vectors of pixels.
    output : Path, optional
    overwrite : bool
    """

    block: Block
    source: Path | None = None
    output: Path | None = None
    overwrite: bool = False


@dataclass(frozen=True)
class Located:
    """Places on the ground of pixels of one image.

    Attributes
    ----------
    places : Places
        Of all points, or of all vertices.
    names : tuple of str
        Of the points; empty for vectors.
    features : int
        Features written; 0 for points.
    lost : int
        Points, or features, of which something sees no known ground.
    uncertainty : InputUncertainty
    outside : tuple of int
        Those of the lost, counted from 0, that lie outside of the image.
    path : Path, optional
        File that was written.
    """

    places: Places
    names: tuple[str, ...]
    features: int
    lost: int
    uncertainty: InputUncertainty
    outside: tuple[int, ...] = ()
    path: Path | None = None

    def __repr__(self) -> str:
        what = counted(len(self.names), "point") if self.names else counted(self.features, "feature")
        file = f", '{self.path}'" if self.path else ""
        return f"Located({what}, {self.lost} without ground, {crs_code(self.places.crs)}{file})"

    def read(self) -> GeoDataFrame:
        """Places as features.

        Returns
        -------
        GeoDataFrame
            Points with id, col, row (pixels) and error ellipses (metres, degrees), without those that see no ground;
            of digitized vectors what was written.
        """
        import geopandas
        import shapely

        if not self.names and self.path is not None:
            return read_product(self.path)
        seen = self.places.seen
        rows = [row for row, good in zip(self.rows(), seen, strict=True) if good]
        columns = {name: [row[k] for row in rows] for k, name in enumerate(POINT) if name not in ("x", "y", "z")}
        frame = geopandas.GeoDataFrame(columns, geometry=shapely.points(self.places.xyz[seen]), crs=self.places.crs)
        for name in ERROR:  # a column of nothing but None would have no type
            frame[name] = frame[name].astype("float64")
        frame["heights"] = height_name(self.places.crs)
        return frame

    def rows(self) -> list[list[Any]]:
        """Values of `POINT` for each point; None where something is not known."""
        found = self.places
        error = _error_columns(found)
        return [
            [name, *map(finite, [*found.colrow[i].tolist(), *found.xyz[i].tolist(), *error[i].tolist()])]
            for i, name in enumerate(self.names)
        ]


def locate(
    scene: Block,
    pixels: FloatArray | PathLike,
    *,
    dem: PathLike | Dem | float | None = None,
    dem_heights: str | None = None,
    output: PathLike | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Located:
    """Places on the ground of pixels of one image, with their error ellipses.

    Parameters
    ----------
    scene : Scene
    pixels : array (N, 2) or path
        Columns and rows, or a table (id, col, row), or vectors digitized on the raw image.
    dem, dem_heights
        See `ortho`.
    output : path, optional
        GeoPackage, GeoJSON, FlatGeobuf or CSV to write; vectors need it.
    overwrite : bool
        Replace an existing file.
    **options
        Of `LocateOptions`: `dst_crs`, `sigma_px`, `sigma_dem`, `sigmas`, `rows`, ...

    Raises
    ------
    InputError, SolveError, OutputError
    """
    source = given_path(pixels) if isinstance(pixels, str | Path) else None
    points = np.empty((0, 2)) if source is not None else _points(pixels)
    file, request = None if output is None else path_of(output, "output"), compose(LocateOptions, options)
    inputs = MonoplotInputs(on_ground(block_of(scene, "scene"), dem, dem_heights), source, file, overwrite)
    if inputs.output is not None:
        read = (*inputs.block.files, *filter(None, [source]))
        check_name(inputs.output, overwrite=inputs.overwrite, inputs=read)
    block, photo = _scene_of(inputs.block)
    size = photo.model.size
    dst_crs = parse_crs(request.dst_crs, "`dst_crs`") if request.dst_crs else None
    crs = ground_crs(photo.model, block.surface, dst_crs, request.dst_heights)
    photo, covariance, note = oriented(inputs.block, request.sigmas, block, photo)
    height = None if request.sigma_dem is None else height_sigmas(request.sigma_dem)
    uncertainty = InputUncertainty(request.sigma_px, height, covariance, (note,))
    axes = axes_of(request.rows, request.first_pixel, size, inputs.source)
    if inputs.source is not None and is_digitized(inputs.source):
        frame = read_digitized(inputs.source, request.layer, axes, size)
        return _located_vectors(inputs, request, (block, photo), crs, uncertainty, frame)
    if inputs.source is not None:
        table = read_pixels(inputs.source, axes, size)
        names, colrow = table.names, table.colrow
    else:
        colrow = axes.colrow(points)
        require_inside(colrow, size, "`pixels`")
        names = tuple(str(number) for number in range(1, len(colrow) + 1))
    places = _located(photo.model, block.surface, colrow, crs, uncertainty)
    outside = tuple(np.flatnonzero(outside_image(colrow, size)).tolist())
    found = Located(places, names, 0, int((~places.seen).sum()), uncertainty, outside, inputs.output)
    if inputs.output is not None:
        _write_points(inputs.output, found, overwrite=inputs.overwrite)
    return found


def _points(given: object) -> FloatArray:
    """Image points (N, 2); one point may be given as a pair."""
    try:
        points = np.atleast_2d(np.asarray(given, dtype=np.float64))
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError("these are no image points", where="`pixels`", hint="give an array (N, 2) of column and row")
    return points


def _error_columns(places: Places) -> FloatArray:
    """Values of `ERROR` (N, 4)."""
    error = places.ellipses
    return np.column_stack([error.semi_axes, error.azimuth, error.sigma_z])


def _scene_of(inputs: Block) -> tuple[OrientedBlock, OrientedImage]:
    """Block of one image, and the image."""
    block = build_block(inputs)
    return block, block.scenes[0]


def oriented(
    inputs: Block, sigmas: Mapping[str, float], block: OrientedBlock, scene: OrientedImage
) -> tuple[OrientedImage, FloatArray | None, str]:
    """Adjust the image to its control points, where it has any; the covariance of its orientation, and a note.

    Parameters
    ----------
    inputs : Block
    sigmas : mapping
    block : OrientedBlock
    scene : OrientedImage
    """
    control = [point for point in block.control if point.image == scene.name and point.role == "control"]
    try:
        own = table_covariances(inputs, block).get(scene.name)
        model, covariance, note = orientation(scene.model, sigmas, control, block.crs, own)
    except SolveError as error:
        error.where = error.where or f"{inputs.control}, {scene.name}"
        for points in control_discrepancies(inputs, block):
            if points.cause:
                error.what, error.hint = f"{error.what}; {points.cause}", points.hint
        raise
    if block.crs is not None and median_distance([replace(scene, model=model)], control, block.crs) > FAR:
        # Of the image as it was: adjusted to wrong points it tells nothing.
        for points in control_discrepancies(inputs, block):
            warn(points.text)
    return replace(scene, model=model), covariance, note


def _write_points(path: Path, found: Located, *, overwrite: bool) -> None:
    if path.suffix.lower() == ".csv":
        write_csv(path, POINT, found.rows(), overwrite=overwrite)
    else:
        write_frame(path, found.read(), "places", overwrite=overwrite)


def _located_vectors(
    inputs: MonoplotInputs,
    options: LocateOptions,
    oriented: tuple[OrientedBlock, OrientedImage],
    crs: CRS,
    uncertainty: InputUncertainty,
    frame: GeoDataFrame,
) -> Located:
    """Bring digitized vectors to the ground; the error of a feature is that of its worst vertex."""
    import shapely

    block, scene = oriented
    if inputs.output is None:
        raise InputError("vectors need a file to be written to", where=str(inputs.source), hint="give `output`")
    shapes = np.asarray(frame.geometry.values)
    if options.step is not None:
        shapes = shapely.segmentize(shapes, options.step)
    colrow, owner = shapely.get_coordinates(shapes, return_index=True)
    places = _located(scene.model, block.surface, colrow, crs, uncertainty)
    whole = np.ones(len(shapes), dtype=bool)
    whole[owner[~places.seen]] = False
    if inputs.output.suffix.lower() == ".csv":
        error = _error_columns(places)
        rows = (
            [int(f) + 1, *map(finite, [*colrow[i], *places.xyz[i], *error[i]])] for i, f in enumerate(owner.tolist())
        )
        write_csv(inputs.output, ("feature", *POINT[1:]), rows, overwrite=inputs.overwrite)
    else:
        flat = shapely.force_3d(shapes[whole], 0.0)
        count = np.bincount(owner, minlength=len(shapes))[whole]
        assert count.sum() == whole[owner].sum()
        deep = shapely.set_coordinates(flat.copy(), places.xyz[whole[owner]])
        worst = _worst(_error_columns(places), owner, len(shapes))[whole]
        out = frame[whole].set_geometry(deep).set_crs(crs, allow_override=True)
        for k, name in enumerate(ERROR):
            out[name] = worst[:, k]
        out["heights"] = height_name(crs)
        write_frame(inputs.output, out, options.layer or "places", overwrite=inputs.overwrite)
    outside = tuple(np.unique(owner[outside_image(colrow, scene.model.size)]).tolist())
    return Located(places, (), int(whole.sum()), int((~whole).sum()), uncertainty, outside, inputs.output)


def _located(
    model: SensorModel, surface: Surface | None, colrow: FloatArray, crs: CRS, uncertainty: InputUncertainty
) -> Places:
    """Places of image points; none for those outside of the image."""
    seen = np.where(outside_image(colrow, model.size)[:, None], np.nan, colrow)
    return replace(locate_points(model, surface, seen, crs, uncertainty), colrow=colrow)


def _worst(error: FloatArray, owner: FloatArray, count: int) -> FloatArray:
    """Errors (count, 4) of the vertex of each feature whose larger semi-axis is largest."""
    out = np.full((count, error.shape[1]), np.nan)
    order = np.argsort(error[:, 0], kind="stable")  # NaN comes last, and must not win
    for index in order[np.isfinite(error[order, 0])]:
        out[owner[index]] = error[index]
    return out


# Margin around the photo's footprint within which vectors are read, as a share of its larger side.
# The footprint is computed at few points, and lines that leave it may come back.
_MARGIN = 0.25


@dataclass(frozen=True)
class DrawnVectors(VectorProduct):
    """Map vectors drawn into a photo: the file, and counts of features read, drawn, pieces and hidden pieces."""

    path: Path
    features: int
    drawn: int
    pieces: int
    hidden: int


def draw_vectors(
    scene: Block,
    vectors: PathLike,
    output: PathLike,
    *,
    dem: PathLike | Dem | float | None = None,
    dem_heights: str | None = None,
    overwrite: bool = False,
    **options: Any,
) -> DrawnVectors:
    """Map vectors drawn into the pixels of one image.

    Parameters
    ----------
    scene : Scene
    vectors : path
        In any CRS; draped over the ground.
    output : path
        GeoPackage, GeoJSON, FlatGeobuf or CSV to write, in pixels.
    dem, dem_heights
        See `ortho`.
    overwrite : bool
        Replace an existing file.
    **options
        Of `DrawOptions`: `src_crs`, `layer`, `rows`, `mark_hidden`, ...

    Raises
    ------
    InputError, SolveError, OutputError
    """
    given, request = on_ground(block_of(scene, "scene"), dem, dem_heights), compose(DrawOptions, options)
    source, file = path_of(vectors, "vectors"), path_of(output, "output")
    check_name(file, overwrite=overwrite, inputs=(source, *given.files))
    frame = read_layer(source, request.layer)
    crs = parse_crs(request.src_crs, "`src_crs`") if request.src_crs else frame.crs
    if crs is None:
        raise InputError("the layer has no CRS", where=str(source), hint="name it with `src_crs`")
    flat = horizontal(CRS.from_user_input(crs))
    block, photo = _scene_of(given)
    axes = axes_of(request.rows, request.first_pixel, photo.model.size, file)
    photo, _, _ = oriented(given, request.sigmas, block, photo)
    view = View.of(photo.model, block.surface, flat)
    left, bottom, right, top = footprint(photo, block.surface, flat).bounds
    margin = _MARGIN * max(right - left, top - bottom)
    bounds = left - margin, bottom - margin, right + margin, top + margin
    made = draw(view, list(frame.geometry.values), bounds, hidden=request.mark_hidden)
    if len(frame) and not made.geometries:
        theirs, ours = (", ".join(f"{value:.8g}" for value in box) for box in (frame.total_bounds, bounds))
        warn(
            f"nothing of {source.name} is seen in the photo: it lies at {theirs}, the photo shows no more than "
            f"{ours} (left, bottom, right, top in {flat.name}); is that its CRS? else say `src_crs`"
        )
    if file.suffix.lower() == ".csv":
        _write_drawn_table(file, overwrite, made.geometries, made.feature, made.hidden, axes.xy)
    else:
        import shapely

        out = frame.iloc[made.feature].set_geometry(
            [shapely.transform(geometry, axes.xy) for geometry in made.geometries]
        )
        out = out.set_crs(None, allow_override=True)
        if request.mark_hidden:
            out["hidden"] = np.array(made.hidden, dtype=bool)
        write_frame(file, out, request.layer or "drawn", overwrite=overwrite)
    return DrawnVectors(file, len(frame), len(set(made.feature)), len(made.geometries), sum(made.hidden))


def _write_drawn_table(
    path: Path,
    overwrite: bool,
    geometries: list[Any],
    feature: list[int],
    hidden: list[bool],
    count: Callable[[FloatArray], FloatArray],
) -> None:
    import shapely

    rows = (
        [number + 1, piece, *place, int(covered)]
        for piece, (geometry, number, covered) in enumerate(zip(geometries, feature, hidden, strict=True), 1)
        for place in count(shapely.get_coordinates(geometry)).tolist()
    )
    write_csv(path, ("feature", "piece", "col", "row", "hidden"), rows, overwrite=overwrite)
