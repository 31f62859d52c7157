"""Film camera of a scan: its fiducial marks against the certificate, and the interior orientation from them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations, permutations
from typing import Any

import numpy as np

from geomosaic.errors import InputError, SensorInputError, warn
from geomosaic.sensor.inputs import choice, flag, need, number, numbers, suggestion, table_of
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.types import FloatArray
from geomosaic_frame.additional import additional_of
from geomosaic_frame.certificate import read_certificate
from geomosaic_frame.deformation import Deformation
from geomosaic_frame.film import FilmCamera
from geomosaic_frame.interior_orientation import KINDS, InteriorOrientation, fit_interior

# µm; a conformal fit that leaves more (RMS) is a wrong number or a wrong mark: film shrinks by about 0.1 %.
GROSS = 500.0
# µm; a residual that is reported as a warning.
LARGE = 50.0
# A numbering that fits by this factor better is reported.
CLEARLY = 3.0

Pairs = tuple[FloatArray, FloatArray]


def _read_marks(given: Any, known: Mapping[str, tuple[float, float]], size: tuple[int, int], where: str) -> list[str]:
    """Names of the fiducials measured, in the certificate's order."""
    table = table_of(given, "fiducials", where)
    for name, place in table.items():
        if str(name) not in known:
            raise InputError(
                f"the certificate has no fiducial '{name}'",
                where=where,
                hint=suggestion(name, "it has", known),
            )
        col, row = numbers(place, 2, f"fiducial {name}", where)
        if not (0.0 <= col <= size[0] and 0.0 <= row <= size[1]):
            raise InputError(
                f"fiducial {name} is at col {col:g}, row {row:g}, outside the image of {size[0]} x {size[1]} pixels",
                where=where,
                hint="measure it in this image, as (col, row) in pixels; a copy in another resolution has other pixels",
            )
    return [name for name in known if name in {str(key) for key in table}]


def orient(
    given: Mapping[str, Any],
    known: Mapping[str, tuple[float, float]],
    size: tuple[int, int],
    kind: str | None,
    mirrored: bool,
    where: str,
) -> tuple[InteriorOrientation, list[str]]:
    """Interior orientation of a scan from its fiducials, with notes.

    Parameters
    ----------
    given : mapping
        Mark → [col, row] in pixels of the scan.
    known : mapping
        Mark → (x, y) in mm.
    size : tuple of int
        Width and height of the scan.
    kind : str or None
        'conformal', 'affine' or 'projective'; None takes affine, and conformal with fewer than four marks.
    mirrored : bool
        Whether the scan shows the film from its back.
    where : str
        Named in errors.

    Returns
    -------
    orientation : InteriorOrientation
    notes : list of str
        Residuals, marks not measured.

    Raises
    ------
    InputError
        Too few marks, or marks that do not fit; says which numbering would.
    """
    names = _read_marks(given, known, size, where)
    by_name = {str(key): value for key, value in given.items()}
    image = np.array([by_name[name] for name in names], dtype=np.float64).reshape(-1, 2)
    film = np.array([known[name] for name in names]).reshape(-1, 2)
    kind = kind or ("affine" if len(names) >= 4 else "conformal")
    need = KINDS[kind]
    if len(names) < need or _in_line(film, kind) or _in_line(image, kind):
        raise InputError(
            f"the fiducials {', '.join(names) or '(none)'} do not determine a {kind} interior orientation",
            where=where,
            hint=f"measure {need} or more that are not in line"
            + (", or use interior = 'conformal'" if kind != "conformal" and len(names) >= 2 else ""),
        )
    conformal = fit_interior(image, film, "conformal", mirrored)
    if conformal.rms > GROSS:
        raise _misfit(names, image, film, mirrored, conformal.rms, where)
    result = fit_interior(image, film, kind, mirrored)
    notes = [_summary(result, names)]
    missing = [name for name in known if name not in names]
    if missing:
        notes.append(f"fiducials not measured: {', '.join(missing)}")
    _refuse_rotated_numbers(result, names, image, film, mirrored, where)
    worst = int(np.argmax(np.hypot(*result.residuals.T)))
    size_of_worst = float(np.hypot(*result.residuals[worst]))
    if size_of_worst > LARGE:
        warn(
            f"{where}: a fiducial fits badly: {names[worst]} by {size_of_worst:.0f} µm. Measure the marks again, and "
            "check the certificate."
        )
    if result.redundancy == 0:
        notes.append(f"{len(names)} fiducials leave a {kind} orientation no check: a wrong one cannot be found")
    return result, notes


def _in_line(points: FloatArray, kind: str) -> bool:
    """Whether points are too few or too close to a line (1 : 1000) for a kind of orientation."""
    if len(points) < 2:
        return True
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[0] == 0.0 or (kind != "conformal" and spread[1] < 1e-3 * spread[0]))


def _summary(result: InteriorOrientation, names: list[str]) -> str:
    across, down = result.pixel
    worst = int(np.argmax(np.hypot(*result.residuals.T)))
    return (
        f"interior orientation: {result.kind}, {len(names)} fiducials, residuals {result.rms:.1f} µm RMS, "
        f"{np.hypot(*result.residuals[worst]):.1f} µm at {names[worst]}; pixels of {across:.3f} x {down:.3f} µm, "
        f"turned by {result.turn:.2f}°{', mirrored' if result.mirrored else ''}"
    )


def _misfit(
    names: list[str], image: FloatArray, film: FloatArray, mirrored: bool, rms: float, where: str
) -> InputError:
    """Hint at another numbering of the marks that would fit."""
    what = f"the fiducials do not fit the certificate: {rms / 1000.0:.1f} mm RMS"
    back = fit_interior(image, film, "conformal", not mirrored)
    if back.rms <= GROSS and len(names) > 2:
        return InputError(
            f"{what}; numbered the other way round they do, to {back.rms:.0f} µm",
            where=where,
            hint="the marks are numbered in the other direction, or the scan shows the film from its back: "
            f"renumber them, or set mirrored = {str(not mirrored).lower()}",
        )
    tried = (
        (fit_interior(image, film[list(order)], "conformal", mirrored).rms, order) for order in _orders(len(names))
    )
    # A frame that is nearly symmetric fits in several positions: the one with the fewest numbers changed is reported.
    fitting = [(sum(i != j for i, j in enumerate(order)), rms, order) for rms, order in tried if rms <= GROSS]
    if fitting:
        _, left, order = min(fitting)
        wrong = [f"{names[i]} is in truth {names[j]}" for i, j in enumerate(order) if i != j]
        return InputError(
            f"{what}; with other numbers they do, to {left:.0f} µm: {', '.join(wrong)}",
            where=where,
            hint="renumber these marks",
        )
    # With three marks any two fit a conformal transformation, so none can be named.
    alone = [(fit_interior(*_without(image, film, i), "conformal", mirrored).rms, i) for i in range(len(names))]
    if len(names) > 3 and min(alone)[0] <= GROSS:
        left, i = min(alone)
        off = float(np.hypot(*_off(image, film, i, mirrored)))
        return InputError(
            f"{what}; without {names[i]} they do, to {left:.0f} µm, and it is off by {off:.1f} mm",
            where=where,
            hint=f"measure {names[i]} again, or leave it out",
        )
    return InputError(
        f"{what}, and with no other numbering",
        where=where,
        hint="check that they are (col, row) in pixels of this scan, and that the certificate is this camera's, in mm",
    )


def _without(image: FloatArray, film: FloatArray, i: int) -> Pairs:
    return np.delete(image, i, axis=0), np.delete(film, i, axis=0)


def _off(image: FloatArray, film: FloatArray, i: int, mirrored: bool) -> FloatArray:
    """Millimetres by which a mark is off where the others put it."""
    rest = fit_interior(*_without(image, film, i), "conformal", mirrored)
    u = rest.matrix @ np.array([*image[i], 1.0])
    gap: FloatArray = u[:2] / u[2] - film[i]
    return gap


def _orders(count: int) -> Iterator[tuple[int, ...]]:
    """Other numberings: all of few marks, of many those with two exchanged."""
    if count <= 5:
        yield from permutations(range(count))
        return
    for i, j in combinations(range(count), 2):
        order = list(range(count))
        order[i], order[j] = j, i
        yield tuple(order)


def _refuse_rotated_numbers(
    result: InteriorOrientation, names: list[str], image: FloatArray, film: FloatArray, mirrored: bool, where: str
) -> None:
    """Error where marks fit much better with their numbers moved on by one or more: a frame turned by right angles."""
    # A symmetric frame fits in each of its positions; only the calibrated deviations from symmetry tell them apart.
    if result.redundancy == 0:
        return
    # Marks in the order of their directions: a turn of the frame moves every number on by the same count.
    around = np.argsort(np.arctan2(*(film - film.mean(axis=0)).T[::-1])).tolist()
    for step in range(1, len(names)):
        moved = np.empty(len(names), dtype=int)
        moved[around] = around[step:] + around[:step]
        other = fit_interior(image, film[moved], result.kind, mirrored)
        # Marks are measured to some micrometres: a numbering that fits so well is not doubted.
        if max(CLEARLY * other.rms, 5.0) < result.rms:
            first = around[0]
            raise InputError(
                f"the fiducials fit to {result.rms:.0f} µm, but to {other.rms:.0f} µm if the numbers are moved by "
                f"{step} of {len(names)}, so that {names[first]} is {names[moved[first]]}: probably the scan is "
                "turned, and the marks were numbered as if it were not",
                where=where,
                hint="renumber them, as `geomosaic fiducials` does; or measure the worst mark again, or leave it out",
            )


def film_camera(table: Mapping[str, Any], request: SensorRequest, where: str) -> tuple[FilmCamera, list[str]]:
    """Film camera of a scan, from a calibration certificate and the fiducials measured in it.

    Parameters
    ----------
    table : mapping
        Calibration certificate, as in `camera.toml`.
    request : SensorRequest
        Size of the scan in pixels; the options `fiducials`, `fiducial_sigma`, `interior`, `mirrored`.
    where : str
        Named in errors about the certificate.

    Returns
    -------
    camera : FilmCamera
    notes : list of str
        Interior orientation and what was assumed.

    Raises
    ------
    InputError
        The certificate is not complete, or the fiducials do not fit it.
    """
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
    camera = replace(
        camera,
        additional=additional_of(table, camera.half, where),
        deformation=_deformation(given, interior.kind, options.get("fiducial_sigma"), request.image),
    )
    end, reach = certificate.lens.radial.end, camera.reach()
    if reach > end:
        notes.append(f"the distortion is given up to {end:.0f} mm, the scan reaches {reach:.0f} mm: continued linearly")
    return camera, notes


def _deformation(marks: Mapping[Any, Any], kind: str, sigma: Any, where: str) -> Deformation | None:
    """What the marks leave open of a transformation, where their sigma is told."""
    if sigma is None:
        return None
    value = number(sigma, "fiducial_sigma", where)
    if not value > 0.0:
        raise SensorInputError(
            f"fiducial_sigma is {value:g}", name="fiducial_sigma", where=where, hint="give a standard deviation above 0"
        )
    if kind == "projective":
        raise SensorInputError(
            "a projective transformation is not adjusted with the photo",
            name="fiducial_sigma",
            where=where,
            hint="use interior = 'affine', or leave fiducial_sigma out",
        )
    colrow = np.array([list(place) for place in marks.values()], dtype=np.float64)
    return Deformation.of_marks(colrow, kind, value)
