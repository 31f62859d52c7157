"""Co-registration of a georeferenced raster to another: displacement found in both, and one resampling."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine

from geomosaic.block import OrientedImage, footprint
from geomosaic.errors import SolveError, warn
from geomosaic.geo.grid import Grid
from geomosaic.geo.units import linear_unit
from geomosaic.inputs.area import plan
from geomosaic.matching.displacement import KINDS, Displacement, displacement
from geomosaic.options.control import CoregisterOptions
from geomosaic.options.declaration import compose
from geomosaic.options.inputs import Area
from geomosaic.raster.files import check_output, companion
from geomosaic.reference_matching.drawing import georeferenced
from geomosaic.reference_matching.match import Reference, match_oriented
from geomosaic.render.ortho import OrthoResult
from geomosaic.render.ortho import ortho as render_ortho
from geomosaic.sensor.corrected import Corrected
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.sensor.registry import build
from geomosaic.types import PathLike
from geomosaic.whole_files import path_of, write_atomic

# Pixels, of the coarser raster, that are searched unless a distance is given.
SEARCH = 30.0
# Pixels that a local field may lie off one homography.
LOCAL_TOLERANCE = 12.0
_WORDS = {
    "none": "no displacement",
    "shift": "a shift",
    "affine": "an affine displacement",
    "local": "a local field",
}


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class CoregisteredRaster(OrthoResult):
    """Raster that lies on its reference, with the attributes of `OrthoResult`.

    Attributes
    ----------
    displacement : Displacement
        Of the raster against the reference before, in its own pixels.
    facts : dict
        The same as JSON values, with the points; also beside the output.
    facts_file : Path
    """

    displacement: Displacement
    facts: Mapping[str, Any]
    facts_file: Path

    @property
    def summary(self) -> str:
        """Displacement in words."""
        found, facts = self.displacement, self.facts
        held = ", ".join(f"{name} {rms:.3f}" for name, rms in found.held_out.items())
        col, row = facts["shift_px"]
        return "\n".join(
            [
                f"{_WORDS[found.kind]} against {facts['reference']}, from {facts['used']} of {facts['points']} places",
                f"median displacement: {col:+.3f} columns, {row:+.3f} rows ({facts['shift_m']:.3g} m)",
                f"residuals of the places: {found.rms:.3f} px RMS in one axis ({facts['rms_m']:.3g} m)",
                f"RMS at places left out of the fit, px: {held}",
            ]
        )


def coregister(image: PathLike, reference: PathLike, output: PathLike, **options: Any) -> CoregisteredRaster:
    """Georeferenced raster moved onto another of the same land, and resampled once.

    Parameters
    ----------
    image : path
    reference : path
        Any resolution, CRS and season.
    output : path
        GeoTIFF to write; NAME-coregistration.json stands beside it. It has the pixels and the CRS of the image, unless
        `like`, `dst_crs`, `resolution` or `bounds` say otherwise.
    **options
        Of `CoregisterOptions`: `model` ('shift', 'affine' or 'local'), `search`, the extent, and `RenderOptions`, flat.

    Returns
    -------
    CoregisteredRaster

    Raises
    ------
    InputError
        A raster is missing, or has no georeference; they show nothing in common.
    SolveError
        The image was not found in the reference, or lies farther off than `search`.
    """
    wanted = compose(CoregisterOptions, options)
    files = path_of(image, "image"), path_of(reference, "reference")
    final, render, requested = path_of(output, "output"), wanted.render, wanted.registration
    beside = companion(final, "-coregistration", ".json")
    for file in (final, beside):
        check_output(file, overwrite=render.overwrite, inputs=files, geotiff=file == final)
    scene, own = georeferenced(files[0], "the image")
    truth, grid = georeferenced(files[1], "the reference")
    coarser = max(max(each.resolution) * linear_unit(each.crs) for each in (own, grid))
    search = SEARCH * coarser if requested.search is None else requested.search
    tolerance = LOCAL_TOLERANCE if requested.model == "local" else None
    with (opened := Reference.open(truth, grid)).drawer:
        match = match_oriented(scene, None, opened, search, tolerance)
    if match.moved > search:
        enough = float(f"{1.5 * match.moved:.2g}")
        raise SolveError(
            f"the image agrees with the reference {match.moved:.4g} m from its own place, beyond the search distance "
            f"of {search:.4g} m",
            where=str(files[0]),
            hint=f"if that is right, give `search` {enough:g}; ground that repeats itself agrees elsewhere too",
        )
    predicted = scene.model.ground_to_image(match.xyz)
    found = displacement(predicted, match.colrow, scene.model.size, requested.model)
    if found.kind == "none":
        warn(
            f"the image lies on its reference already: {len(match)} places show no displacement, and it stays as it is"
        )
    elif KINDS.index(found.kind) < KINDS.index(requested.model):
        warn(
            f"{_WORDS[found.kind]} is used instead of {_WORDS[requested.model]}, which predicts places left out of the "
            "fit no better"
        )
    moved = replace(scene, model=_model(scene, own, found))
    area = wanted.area
    plain = area == Area()
    out, outlines = (own, [footprint(moved, None, own.crs)]) if plain else plan([moved], None, area)
    made = render_ortho(moved, None, out, outlines[0], final, render)
    middle = np.median((match.colrow - predicted)[found.kept], axis=0)
    facts = {
        "image": str(files[0]),
        "reference": str(files[1]),
        "model": found.kind,
        "asked": requested.model,
        "points": len(match),
        "used": int(found.kept.sum()),
        "shift_px": middle.tolist(),
        "shift_m": float(np.hypot(*middle)) * match.sampling,
        "rms_px": found.rms,
        "rms_m": found.rms * match.sampling,
        "held_out_rms_px": dict(found.held_out),
        "matrix": found.matrix.tolist(),
        "field": None if found.field is None else found.field.to_dict(),
        "places": [
            {"col": col, "row": row, "d_col": x, "d_row": y, "used": used}
            for (col, row), (x, y), used in zip(
                match.colrow.tolist(), found.residuals.tolist(), found.kept.tolist(), strict=True
            )
        ],
    }
    write_atomic(beside, json.dumps(facts, indent=1) + "\n")
    return CoregisteredRaster(**vars(made), displacement=found, facts=facts, facts_file=beside)


def _model(scene: OrientedImage, own: Grid, found: Displacement) -> SensorModel:
    """Model of the raster where it belongs."""
    (a, b, c), (d, e, f) = found.matrix.tolist()
    # What the georeference calls p lies at A·p in the file: pixels go to the map through the inverse of A first.
    transform = own.transform @ ~Affine(a, b, c, d, e, f)
    request = SensorRequest(scene.name, scene.model.size, {"transform": list(transform[:6])}, own.crs, path=scene.path)
    model = build(scene.sensor, request)
    return model if found.field is None else Corrected.of(model, found.field, scene.sensor)
