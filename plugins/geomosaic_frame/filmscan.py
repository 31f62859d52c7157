"""The film camera of one scan: its certificate, and the fiducial marks measured in the scan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from geomosaic.sensor.options import choice, flag, need, table_of
from geomosaic.sensor.plugin import SensorRequest
from geomosaic_frame.calibration import read_certificate
from geomosaic_frame.film import FilmCamera
from geomosaic_frame.interior import KINDS
from geomosaic_frame.marks import orient


def film_of(table: Mapping[str, Any], request: SensorRequest, where: str) -> tuple[FilmCamera, list[str]]:
    """Certificate and measured marks to a camera of this scan, and what was done to it."""
    certificate = read_certificate(table, where)
    options = request.options
    text = "the fiducials measured in this scan, mark = [col, row] in pixels, for the interior orientation"
    given = table_of(need(options, "fiducials", request.image, text), "fiducials", request.image)
    kind = options.get("interior")
    if kind is not None:
        kind = choice(kind, KINDS, "interior", request.image)
    mirrored = flag(options, "mirrored", request.image)
    interior, notes = orient(given, certificate.fiducials, request.size, kind, mirrored, request.image)
    camera = FilmCamera(request.size, certificate.lens, certificate.autocollimation, interior.matrix)
    end, reach = certificate.lens.radial.end, camera.reach()
    if reach > end:
        notes.append(f"the distortion is given up to {end:.0f} mm, the scan reaches {reach:.0f} mm: continued linearly")
    return camera, notes
