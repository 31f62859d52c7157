"""Options of a block adjustment: tie points, what else was observed and how well, and which parameters are unknown."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError
from geomosaic.options.check import SelfContainedOptions, finite_numbers
from geomosaic.options.declaration import option
from geomosaic.options.render import RunningOptions


def _parse_free(value: Any) -> Mapping[str, float]:
    """Parameters that an adjustment may change, each with its a-priori standard deviation."""
    if isinstance(value, Mapping):
        pairs = [(name, sigma) for name, sigma in value.items()]
    else:
        words = value.split(",") if isinstance(value, str) else value
        # Names of images may have a '=', too.
        parts = [str(word).rpartition("=") if "=" in str(word) else (str(word), "", "") for word in words]
        pairs = [(name.strip(), text if equals else math.inf) for name, equals, text in parts]
    found = {}
    for name, given in pairs:
        try:
            sigma = float(given)
        except (TypeError, ValueError):
            sigma = math.nan
        if not name or not sigma > 0.0:
            hint = "write names, such as focal_length, or names with standard deviations, such as focal_length=2"
            raise InputError(f"'{name}={given}' is no parameter with a standard deviation above 0", hint=hint)
        found[name] = sigma
    return found


def _parse_vector(value: Any) -> tuple[float, ...]:
    """Vector of three numbers."""
    parts = finite_numbers(value)
    if len(parts) != 3:
        raise InputError(f"'{value}' is no vector", hint="give three numbers, such as 0.1 0.0 -0.3")
    return parts


# Projects and the library have these options, and no command a flag for them.
@dataclass(frozen=True)
class AdjustmentOptions(SelfContainedOptions, RunningOptions, group="input", section="adjust", flag=None):
    """Options of `adjust`.

    Attributes
    ----------
    ties : Path or TiePoints, optional
        Tie points.
    sigma_px : float
        Standard deviation of image positions whose table says none, pixels.
    sigma_xy, sigma_z : float
        Standard deviations of control points whose table says none, metres.
    position_sigma, attitude_sigma : float, optional
        Standard deviations of camera positions (metres) and attitudes (degrees) whose table says none; without one
        they are first values alone.
    lever_arm : tuple of float, optional
        Antenna less projection centre, in camera axes (x right, y down, z forward), metres.
    drift : str, optional
        Error that all positions of a strip share: 'offset', or 'linear' with time.
    strips : Path, optional
        Strip of each image.
    boresight : bool
        Whether all attitudes share an unknown rotation.
    dem_sigma : float, optional
        Standard deviation of the DEM's heights, metres; with it tie points lie on the DEM.
    distances : Path, optional
        Measured distances between points.
    lakes, planes, lines : Path, optional
        Points at one unknown height, on one plane, on one straight line.
    rigs : Path, optional
        Images whose relative position and attitude is the same in all exposures.
    interior : mapping of str to float
        Parameters of the interior orientation that are unknown, with their a-priori standard deviations.
    self_calibration : bool
        Whether held parameters of cameras become unknown, too, where the block determines them.
    fixed : tuple of str
        Images that stay where they are.
    robust : bool
        Whether blunders are left out.
    exports : tuple of str
        Programs whose files are written, too.
    threads, memory_limit, workers
        See `RunningOptions`; they make the ground of the tie points.
    """

    ties: Path | Any | None = option(
        None,
        "Tie points: id, image, col, row, and sigma_px where it is known (or sigma_col, sigma_row, correlation); "
        "or files of another program.",
    )  # fmt: skip
    sigma_px: float = option(0.5, "Standard deviation of image positions, where their table says none.", above=0.0)
    sigma_xy: float = option(
        0.02, "Standard deviation in plan of control points, metres, where their table says none.", above=0.0
    )
    sigma_z: float = option(
        0.03, "Standard deviation in height of control points, metres, where their table says none.", above=0.0
    )
    position_sigma: float | None = option(
        None, "Standard deviation of camera positions, metres, where their table says none.", above=0.0,
        shown="first values only",
    )  # fmt: skip
    attitude_sigma: float | None = option(
        None, "Standard deviation of camera angles, degrees, where their table says none.", above=0.0,
        shown="first values only",
    )  # fmt: skip
    lever_arm: tuple[float, float, float] | None = option(
        None, "From the projection centre to the antenna: right, down and forward in the camera, metres.",
        parse=_parse_vector, shown="none",
    )  # fmt: skip
    drift: str | None = option(
        None, "Error that the camera positions of a strip share.", choices=("offset", "linear"), shown="none"
    )
    strips: Path | None = option(
        None, "Strip of each image: image, strip, and time where it is known.", shown="all images are one strip",
        needs=("drift",),
    )  # fmt: skip
    boresight: bool = option(False, "Estimate a rotation that all camera angles share.")
    dem_sigma: float | None = option(
        None, "Standard deviation of the DEM, metres, where tie points are to lie on it.", above=0.0,
        shown="the DEM takes no part",
    )  # fmt: skip
    distances: Path | None = option(None, "Measured distances between points: from, to, length, sigma.")
    lakes: Path | None = option(
        None, "Points at one height, as the shore of a lake: id, lake, and sigma (metres) where it is known."
    )
    planes: Path | None = option(None, "Points on one plane, as a facade: id, plane, and sigma (metres).")
    lines: Path | None = option(None, "Points on one straight line, as an eaves: id, line, and sigma (metres).")
    rigs: Path | None = option(
        None, "Images of stereo rigs: from, to, and where they are known rig, dx, dy, dz, omega, phi, kappa."
    )
    interior: Mapping[str, float] = option(
        default_factory=dict,
        help="Parameters of the interior orientation to estimate, such as focal_length, or "
        "several together: principal_point, distortion, brown, ebner, gruen; with NAME=SIGMA held to their values.",
        parse=_parse_free, shown="none",
    )  # fmt: skip
    self_calibration: bool = option(
        False, "Estimate further parameters of the interior orientation that the block determines."
    )
    fixed: tuple[str, ...] = option((), "Images that stay where they are; '*' for all.")
    robust: bool = option(True, "Leave out blunders, and name them.")
    exports: tuple[str, ...] = option(
        (), "Programs whose files are written, too, into `exports`.", shown="none",
        choices=("colmap", "colmap-text", "opensfm", "bundler", "bal", "metashape", "pix4d", "ori", "match", "adjust"),
    )  # fmt: skip
