"""Tables of fiducial marks from scans and a calibration certificate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from geomosaic.errors import InputError
from geomosaic.fiducials.measurement import expected_places, find_fiducials, read_template
from geomosaic.inputs.camera import read_camera
from geomosaic.match.marks import Mark
from geomosaic.raster.info import inspect
from geomosaic.whole_files import write_atomic


@dataclass(frozen=True)
class Search:
    """Limits of the search for marks.

    Attributes
    ----------
    pixel : float
        Size of a pixel of the scans, micrometres.
    reach : float
        Millimetres by which the film may lie off the middle of the scan.
    turned : float
        Degrees by which the film is turned in the scan, counter-clockwise.
    mirrored : bool
        Whether the scan shows the film from its back.
    least : float
        Correlation that a mark must have.
    """

    pixel: float
    reach: float = 5.0
    turned: float = 0.0
    mirrored: bool = False
    least: float = 0.6


def calibrated_marks(camera: Path) -> dict[str, tuple[float, float]]:
    """Calibrated coordinates of the fiducial marks.

    Parameters
    ----------
    camera : Path
        Calibration certificate with the table [fiducials].

    Returns
    -------
    dict of str to tuple of float
        Name to (x, y) in the image frame of the camera, mm; x right, y up.

    Raises
    ------
    InputError
        The file has no table of fiducials, or something else than two numbers in it.
    """
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
            raise InputError(f"fiducial {name} is {place!r}, not [x, y] in mm", where=str(camera)) from None
        marks[str(name)] = (x, y)
    return marks


def find_marks(
    scans: Sequence[Path],
    camera: Path,
    template: Path,
    search: Search,
    at: tuple[float, float] | None = None,
    side: float = 2.0,
) -> dict[str, dict[str, Mark]]:
    """Fiducial marks of a certificate, measured in scans.

    Parameters
    ----------
    scans : sequence of Path
    camera : Path
        Certificate.
    template : Path
        Picture of one mark; or a scan that shows one at the place `at`.
    search : Search
    at : tuple of float, optional
        (col, row) of a mark in `template`, pixels.
    side : float
        Side of the square about it, mm.

    Returns
    -------
    dict
        Scan → mark → Mark.

    Raises
    ------
    InputError
        The certificate has no marks, or the template none that looks the same upside down.
    """
    known = calibrated_marks(camera)
    pattern = read_template(template, at, max(round(1000.0 * side / search.pixel), 1) if at else None)
    found = {}
    for scan in scans:
        info = inspect(scan)
        places = expected_places(known, info.size, search.pixel, search.turned, search.mirrored)
        found[scan.name] = find_fiducials(scan, pattern, places, 1000.0 * search.reach / search.pixel, search.least)
    return found


def write_marks(path: Path, found: dict[str, dict[str, Mark]]) -> None:
    """Table of measured fiducials for `Block.fiducials`, as CSV.

    Parameters
    ----------
    path : Path
    found : dict
        Scan → mark → Mark, as `find_marks` gives it; marks that were not found are left out.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    lines = ["image,id,col,row,sigma,correlation"]
    for image, marks in found.items():
        lines += [
            # Thousandths of a pixel: a tenth of what marks are located to.
            f"{image},{name},{mark.col:.3f},{mark.row:.3f},{mark.sigma:.3f},{mark.correlation:.3f}"
            for name, mark in marks.items()
            if mark.found
        ]
    write_atomic(path, "\n".join(lines) + "\n")
