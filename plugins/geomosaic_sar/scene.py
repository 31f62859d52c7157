"""Metadata of a radar scene as every reader gives it, its UTC times counted from an epoch, and its state vectors."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray
from geomosaic_sar.calibration import SarCalibration
from geomosaic_sar.geometry import GroundRange, ImageGeometry, SlantRange
from geomosaic_sar.orbit import Orbit, StateVectors, require_orbit

_STAMP = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(\.\d+)?(?:Z|UTC)?")


@dataclass(frozen=True, eq=False)
class RadarScene:
    """Radar scene as its metadata tell it.

    Attributes
    ----------
    title : str
        Mission, mode, product and date.
    size : tuple of int
        Width and height in pixels.
    geometry : ImageGeometry
    notes : tuple of str
    height : float
        Rough ellipsoidal height of the ground, metres.
    polarisation : str
        '' where the metadata name none, or several.
    calibrations : mapping of str to SarCalibration
        Those that stand in the metadata themselves, by polarisation; of any one quantity.
    """

    title: str
    size: tuple[int, int]
    geometry: ImageGeometry
    notes: tuple[str, ...] = ()
    height: float = 0.0
    polarisation: str = ""
    calibrations: Mapping[str, SarCalibration] = field(default_factory=dict)


@dataclass(frozen=True)
class Epoch:
    """UTC second from which the times of a scene count."""

    start: datetime

    @classmethod
    def of(cls, text: str, where: str) -> Epoch:
        """Epoch at the whole second before a time.

        Parameters
        ----------
        text : str
            UTC, as in 2024-05-01T12:00:00.123456.
        where : str
            Named in errors.
        """
        return cls(_parts(text, where)[0])

    def seconds(self, text: str, where: str) -> float:
        """Seconds from the epoch to a UTC time; `where` is named in errors."""
        whole, fraction = _parts(text, where)
        return (whole - self.start) / timedelta(seconds=1) + fraction


def _parts(text: str, where: str) -> tuple[datetime, float]:
    """Whole second and fraction of a UTC time."""
    found = _STAMP.fullmatch(text.strip())
    try:
        if found is None:
            raise ValueError
        # Fractions have any number of digits; those of datetime end at microseconds, 7 mm of the orbit.
        return datetime.fromisoformat(found[1]).replace(tzinfo=UTC), float(found[2] or 0.0)
    except ValueError:
        raise InputError(
            f"'{text[:40]}' is no UTC time", where=where, hint="write it as 2024-05-01T12:00:00.123456"
        ) from None


def checked_geometry(
    states: StateVectors,
    size: tuple[int, int],
    timing: tuple[float, float],
    side: int,
    axis: SlantRange | GroundRange,
    where: str,
) -> ImageGeometry:
    """Geometry of an image whose orbit covers it.

    Parameters
    ----------
    states : StateVectors
    size : tuple of int
        Width and height in pixels.
    timing : tuple of float
        Zero-Doppler time of the first row, and seconds from one row to the next.
    side : int
        1 looking to the right of the flight, -1 to the left.
    axis : RangeAxis
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The rows have no positive interval, or `require_orbit` refuses the orbit.
    """
    first, interval = timing
    if not 0.0 < interval < 1.0:
        raise InputError(
            f"rows are {interval:g} s apart",
            where=where,
            hint="give the azimuth time interval in seconds, above 0 and below 1",
        )
    orbit = Orbit.through(states)
    require_orbit(orbit, first, first + (size[1] - 1) * interval, where)
    return ImageGeometry(orbit, side, first, interval, axis)


def orbit_note(orbit: Orbit) -> str:
    """Number of the state vectors of an orbit, and how well they agree, for the notes of a model.

    Parameters
    ----------
    orbit : Orbit
    """
    kind = "Lagrange" if orbit.states.velocities is None else "Hermite"
    return (
        f"orbit of {len(orbit.states.times)} state vectors, {kind} interpolation; each left out in turn lies within "
        f"{orbit.mismatch():.2g} m of it"
    )


def growing(times: Sequence[float], what: str, where: str) -> FloatArray:
    """Times that grow.

    Parameters
    ----------
    times : sequence of float
    what : str
        Their name in the file.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        There are none, or they do not grow.
    """
    out = np.array(times, dtype=np.float64)
    if not len(out) or not (np.diff(out) > 0.0).all():
        raise InputError(f"the times of {what} do not grow", where=where, hint="get the metadata again")
    return out
