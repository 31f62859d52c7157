"""Map vectors drawn into the pixel coordinates of one photo, from files to files."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block.footprint import footprint
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import horizontal, parse_crs
from geomosaic.monoplotting.drape import View
from geomosaic.monoplotting.line_drawing import draw
from geomosaic.monoplotting.run import MonoplotInputs, oriented, scene_of
from geomosaic.monoplotting.tables import axes_of, check_name, write_csv, write_frame
from geomosaic.raster.vector import read_layer
from geomosaic.types import FloatArray

_MARGIN = 0.25
"""Margin around the photo's footprint within which vectors are read, as a share of its larger side.

The footprint is computed at few points, and lines that leave it may come back.
"""


@dataclass(frozen=True)
class DrawnVectors:
    """Counts of features read, features drawn in part or whole, pieces, and occluded pieces."""

    features: int
    drawn: int
    pieces: int
    hidden: int


def draw_vectors(inputs: MonoplotInputs) -> DrawnVectors:
    """Map vectors in pixel coordinates of a photo, written to a file.

    Raises
    ------
    InputError
        Something is missing or wrong; names the file or option.
    """
    if inputs.source is None or inputs.output is None:
        raise InputError("drawing needs vectors of the map and a file to write", hint="give both, with `output`")
    check_name(inputs.output, overwrite=inputs.overwrite)
    frame = read_layer(inputs.source, inputs.layer)
    crs = parse_crs(inputs.crs) if inputs.crs else frame.crs
    if crs is None:
        raise InputError("the layer has no CRS", where=str(inputs.source), hint="name it with `src_crs`")
    flat = horizontal(CRS.from_user_input(crs))
    block, scene = scene_of(inputs.block)
    axes = axes_of(inputs.rows, inputs.first, scene.model.size, inputs.output)
    scene, _, _ = oriented(inputs, block, scene)
    view = View.of(scene.model, block.surface, flat)
    left, bottom, right, top = footprint(scene, block.surface, flat).bounds
    margin = _MARGIN * max(right - left, top - bottom)
    bounds = left - margin, bottom - margin, right + margin, top + margin
    made = draw(view, list(frame.geometry.values), bounds, hidden=inputs.hidden)
    if len(frame) and not made.geometries:
        theirs, ours = (", ".join(f"{value:.8g}" for value in box) for box in (frame.total_bounds, bounds))
        warnings.warn(
            f"nothing of {inputs.source.name} is seen in the photo: it lies at {theirs}, the photo shows no more than "
            f"{ours} (left, bottom, right, top in {flat.name}); is that its CRS? else say `src_crs`",
            GeomosaicWarning,
            stacklevel=2,
        )
    if inputs.output.suffix.lower() == ".csv":
        _write_drawn_table(inputs, made.geometries, made.feature, made.hidden, axes.xy)
    else:
        import shapely

        out = frame.iloc[made.feature].set_geometry(
            [shapely.transform(geometry, axes.xy) for geometry in made.geometries]
        )
        out = out.set_crs(None, allow_override=True)
        if inputs.hidden:
            out["hidden"] = np.array(made.hidden, dtype=bool)
        write_frame(inputs.output, out, inputs.layer or "drawn", overwrite=inputs.overwrite)
    return DrawnVectors(len(frame), len(set(made.feature)), len(made.geometries), sum(made.hidden))


def _write_drawn_table(
    inputs: MonoplotInputs,
    geometries: list[Any],
    feature: list[int],
    hidden: list[bool],
    count: Callable[[FloatArray], FloatArray],
) -> None:
    import shapely

    assert inputs.output is not None
    rows = (
        [number + 1, piece, *place, int(covered)]
        for piece, (geometry, number, covered) in enumerate(zip(geometries, feature, hidden, strict=True), 1)
        for place in count(shapely.get_coordinates(geometry)).tolist()
    )
    write_csv(inputs.output, ("feature", "piece", "col", "row", "hidden"), rows, overwrite=inputs.overwrite)
