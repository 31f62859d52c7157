"""Fiducial marks of scanned films: measured by matching with a picture of the mark, and written as tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InputError, listed, warn
from geomosaic.geo.grid import Window
from geomosaic.inputs.declarations import image_paths, read_camera
from geomosaic.matching.marks import Mark, MarkTemplate, locate_mark
from geomosaic.options.control import SearchOptions
from geomosaic.options.declaration import compose
from geomosaic.raster.files import check_output
from geomosaic.raster.info import inspect
from geomosaic.raster.source import Source
from geomosaic.types import FloatArray, PathLike
from geomosaic.whole_files import path_of, write_atomic

# Turns at which a film lies on the scanner.
RIGHT_ANGLES = (0.0, 90.0, 180.0, 270.0)
# Marks that leave an affine fit residuals.
FEWEST = 4
# A position of the frame that fits by this factor better is the right one; µm to which marks are measured, where no fit
# is doubted.
CLEARLY, MEASURED = 3.0, 5.0
LOST = Mark(float("nan"), float("nan"), float("nan"), 0.0)
SMALLEST = 9
# Pixels of a template's side: less says nothing, more is no mark.
LARGEST = 1024


def _expected_places(
    fiducials: Mapping[str, tuple[float, float]], size: tuple[int, int], pixel: float, turned: float, mirrored: bool
) -> dict[str, tuple[float, float]]:
    """Places of the marks, (col, row), on a scan of pixels in µm that has the film in its middle, turned by degrees."""
    t = np.radians(turned)
    places = {}
    for name, (x, y) in fiducials.items():
        right = -x if mirrored else x
        across, up = right * np.cos(t) - y * np.sin(t), right * np.sin(t) + y * np.cos(t)
        places[name] = (size[0] / 2 + 1000.0 * across / pixel, size[1] / 2 - 1000.0 * up / pixel)
    return places


def _read_template(path: PathLike, at: tuple[float, float] | None = None, side: int | None = None) -> MarkTemplate:
    """Template of a mark: a whole picture, or a square of `side` pixels about a place (col, row) of a scan.

    The mark must look the same upside down, as dots, crosses and rings do: its centre is found by that.
    """
    with Source(path) as source:
        image = Window(0, 0, source.info.width, source.info.height)
        if at is None or side is None:
            return _template(_grey(source, _checked(image, path)), path)
        for _ in range(3):  # about the centre found, until it is in the middle
            window = Window(round(at[0] - side / 2), round(at[1] - side / 2), side, side)
            if window.intersection(image) != window:
                raise InputError(
                    f"a square of {side} pixels about col {at[0]:g}, row {at[1]:g} is not inside the image",
                    where=str(path),
                    hint="give the place of a mark as (col, row), and a size that leaves it inside",
                )
            template = _template(_grey(source, _checked(window, path)), path)
            at = window.col + template.centre[0], window.row + template.centre[1]
    return template


def _checked(window: Window, path: PathLike) -> Window:
    """Check, before it is read, that a picture is neither too small nor too large for a mark."""
    if min(window.width, window.height) < SMALLEST or max(window.width, window.height) > LARGEST:
        raise InputError(
            f"a picture of {window.width} x {window.height} pixels is no template of a mark",
            where=str(path),
            hint=f"cut out one mark with some ground around it, {SMALLEST} to {LARGEST} pixels; in a scan say where "
            "one is with `at`, and how large with `side`",
        )
    return window


def _template(grey: FloatArray, path: PathLike) -> MarkTemplate:
    template = MarkTemplate.symmetric(grey)
    if not np.isfinite(template.centre).all():
        raise InputError(
            "the template has no mark that looks the same upside down, as dots, crosses and rings do",
            where=str(path),
            hint="cut out one clean mark, whole and about in the middle",
        )
    return template


def _measure_marks(
    path: PathLike,
    template: MarkTemplate,
    places: Mapping[str, tuple[float, float]],
    reach: float,
    least: float,
) -> dict[str, Mark]:
    """Fiducial marks measured near their expected places, in pixels of the scan; NaN where none is within `reach`."""
    found = {}
    rows, cols = template.values.shape
    with Source(path) as source:
        image = Window(0, 0, source.info.width, source.info.height)
        for name, (col, row) in places.items():
            left, top = int(col - reach - cols / 2), int(row - reach - rows / 2)
            width, height = int(2 * reach) + cols, int(2 * reach) + rows
            window = Window(left, top, width, height).intersection(image)
            # The film may be scanned so that a mark lies off the picture: the others are still measured.
            if window.empty:
                found[name] = LOST
                continue
            mark = locate_mark(_grey(source, window), template, least)
            found[name] = Mark(mark.col + window.col, mark.row + window.row, mark.sigma, mark.correlation)
    return found


def _grey(source: Source, window: Window) -> FloatArray:
    """Mean of the bands (rows, cols)."""
    grey: FloatArray = source.read(window)[0].astype(np.float64).mean(axis=2)
    return grey


def _calibrated_marks(camera: Path) -> dict[str, tuple[float, float]]:
    """Calibrated coordinates of the fiducial marks of a certificate: name to (x, y), mm; x right, y up."""
    table = read_camera(camera).get("fiducials")
    if not isinstance(table, dict) or not table:
        raise InputError(
            "the camera has no fiducials",
            where=str(camera),
            hint="give the calibration certificate with the table [fiducials]: mark = [x, y] in mm",
        )
    marks = {}
    for name, place in table.items():
        try:
            x, y = (float(value) for value in place)
        except (TypeError, ValueError):
            raise InputError(
                f"fiducial {name} is {place!r}, not [x, y] in mm",
                where=str(camera),
                hint=f"write {name} = [x, y], as in the calibration certificate",
            ) from None
        marks[str(name)] = (x, y)
    return marks


def find_fiducials(
    scans: Sequence[PathLike],
    camera: PathLike,
    template: PathLike,
    pixel_size: float,
    *,
    at: tuple[float, float] | None = None,
    output: PathLike | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Mapping[str, Mapping[str, Mark]]:
    """Fiducial marks of scanned films, found by a picture of one of them.

    Parameters
    ----------
    scans : sequence of path
    camera : path
        Calibration certificate (TOML) with the marks in mm.
    template : path
        Picture of one mark; or a scan that shows one `at` a place.
    pixel_size : float
        Of the scans, µm.
    at : tuple of float, optional
        Column and row of a mark in `template`, pixels.
    output : path, optional
        Table to write: image, id, col, row, sigma, correlation.
    overwrite : bool
        Replace an existing table.
    **options
        Of `SearchOptions`: `side` of the square cut out there, `reach`, `turned`, `mirrored`, `least`.

    Returns
    -------
    mapping of str to mapping of str to Mark
        By scan and name of the mark; col and row in pixels.

    Raises
    ------
    InputError, OutputExistsError
    """
    images = image_paths(scans, "scans")
    file, search = None, compose(SearchOptions, {"pixel_size": pixel_size, **options})
    if output is not None:
        file = path_of(output, "output")
        read = (*images, path_of(camera, "camera"), path_of(template, "template"))
        check_output(file, overwrite=overwrite, inputs=read)
    known = _calibrated_marks(path_of(camera, "camera"))
    turns = RIGHT_ANGLES if search.turned is None else (search.turned,)
    side = max(round(1000.0 * search.side / search.pixel_size), 1) if at else None
    pattern = _read_template(path_of(template, "template"), at, side)
    found, doubtful = {}, []
    for scan in images:
        size = inspect(scan).size
        places = [_expected_places(known, size, search.pixel_size, turn, search.mirrored) for turn in turns]
        ways = _numberings(scan, pattern, places, 1000.0 * search.reach / search.pixel_size, search.least)
        counts = [sum(mark.found for mark in marks.values()) for marks in ways]
        fits = [_misfit(marks, known) for marks in ways]
        best = min(range(len(ways)), key=lambda i: (-counts[i], fits[i]))
        # A frame that is nearly symmetric fits in several positions: the first is taken, and the others are told.
        limit = max(CLEARLY * fits[best], MEASURED)
        alike = [i for i, fit in enumerate(fits) if counts[i] == counts[best] and fit <= limit]
        chosen = alike[0]
        found[scan.name] = ways[chosen]
        if chosen:
            warn(
                f"{scan.name}: the marks are numbered for a film turned by {turns[chosen]:g}°: so {counts[chosen]} are "
                f"found and fit to {fits[chosen]:.0f} µm, unturned {counts[0]}"
                + (f" to {fits[0]:.0f} µm" if np.isfinite(fits[0]) else "")
            )
        # Marks of an even frame never tell, and film is laid unturned as a rule: said each time, it would tell nothing.
        if counts[best] and any(chosen or not _even(known, turns[i]) for i in alike[1:]):
            doubtful.append(scan.name)
    if doubtful:
        warn(
            f"{listed(doubtful)}: the marks fit the certificate as well with the film turned by other right angles; if "
            "the data strip shows that it lies so, say `turned`"
        )
    if file is not None:
        _write_marks(file, found)
    return found


def _numberings(
    scan: Path,
    template: MarkTemplate,
    places: Sequence[Mapping[str, tuple[float, float]]],
    reach: float,
    least: float,
) -> list[dict[str, Mark]]:
    """Marks by name for each set of expected places; those of the first that others expect, too, are measured once."""
    first = _measure_marks(scan, template, places[0], reach, least)
    whole, seen = all(mark.found for mark in first.values()), [mark for mark in first.values() if mark.found]
    ways = [first]
    for expected in places[1:]:
        marks, rest = {}, {}
        for name, (col, row) in expected.items():
            near = min(seen, key=lambda mark: max(abs(mark.col - col), abs(mark.row - row)), default=None)
            if near is not None and max(abs(near.col - col), abs(near.row - row)) <= reach:
                marks[name] = near
            else:
                rest[name] = (col, row)
        if rest and not whole:
            marks |= _measure_marks(scan, template, rest, reach, least)
        ways.append({name: marks.get(name, LOST) for name in expected})
    return ways


def _even(known: Mapping[str, tuple[float, float]], turn: float) -> bool:
    """Whether marks turned by so many degrees lie where others lay, to what is measured: they cannot tell the turn."""
    first, after = (_expected_places(known, (0, 0), 1000.0, each, mirrored=False) for each in (0.0, turn))
    nearest = {name: min(first.values(), key=lambda place: math.dist(place, here)) for name, here in after.items()}
    return _misfit({name: Mark(*place, 0.0, 1.0) for name, place in nearest.items()}, known) <= MEASURED


def _misfit(marks: Mapping[str, Mark], known: Mapping[str, tuple[float, float]]) -> float:
    """RMS residual in µm of an affine fit of the certificate to marks; infinite where too few leave one."""
    names = [name for name, mark in marks.items() if mark.found]
    if len(names) < FEWEST:
        return float("inf")
    design = np.array([[marks[name].col, marks[name].row, 1.0] for name in names])
    film = np.array([known[name] for name in names])
    residuals = film - design @ np.linalg.lstsq(design, film, rcond=None)[0]
    return float(1000.0 * np.sqrt((residuals**2).sum() / (2 * len(names) - 6)))


def _write_marks(path: Path, found: dict[str, dict[str, Mark]]) -> None:
    """Table of measured fiducials for `Block.fiducials`, as CSV, without the marks that were not found."""
    lines = ["image,id,col,row,sigma,correlation"]
    for image, marks in found.items():
        lines += [
            # Thousandths of a pixel: a tenth of what marks are located to.
            f"{image},{name},{mark.col:.3f},{mark.row:.3f},{mark.sigma:.3f},{mark.correlation:.3f}"
            for name, mark in marks.items()
            if mark.found
        ]
    write_atomic(path, "\n".join(lines) + "\n")
