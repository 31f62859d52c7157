"""SPOT 5 scenes as OSSIM keyword lists (.geom): orbit, attitudes and look angles under 'support_data'."""

from __future__ import annotations

import re

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.metadata import finite_number
from geomosaic.types import FloatArray
from geomosaic_pushbroom.look_angles import LookDirections
from geomosaic_pushbroom.orbit import Orbit, require_cover, samples_in_order
from geomosaic_pushbroom.paths import AnglePath
from geomosaic_pushbroom.reported import GYROSCOPES, STARS, SceneMetadata

KIND = "ossimSpot5Model"
_PREFIX = "support_data."


def read_ossim(data: bytes, where: str) -> SceneMetadata:
    """Metadata of a SPOT 5 scene in an OSSIM keyword list.

    Attitudes are pitch, roll, yaw; lines and detectors count from 1 at the pixel's centre.

    Parameters
    ----------
    data : bytes
        Whole file.
    where : str
        Named in errors.

    Returns
    -------
    SceneMetadata

    Raises
    ------
    InputError
        The list is of another type, not whole, of a part of a scene, or adjusted by OSSIM.
    """
    words = _words(data.decode("utf-8", "replace"), where)
    if words.get("type") != KIND:
        raise InputError(
            f"this keyword list is of type '{words.get('type', 'none')[:40]}', not {KIND}",
            where=where,
            hint="RPC models in keyword lists are for the sensor 'rpc'",
        )
    _need_whole(words, where)
    reference = _list(words, "reference_line_time", 1, where)[0]
    line = _list(words, "reference_line_time_line", 1, where)[0]
    period = _list(words, "line_sampling_period", 1, where)[0]
    times = _list(words, "ephemeris_sample_times", 0, where) - reference
    positions, velocities = (
        _list(words, f"{name}_ecf_samples", 3 * len(times), where).reshape(-1, 3) for name in ("position", "velocity")
    )
    at = _list(words, "attitude_sample_times", 0, where) - reference
    attitude = _list(words, "attitude_samples", 3 * len(at), where).reshape(-1, 3)
    at, attitude = samples_in_order(at, attitude, f"{_PREFIX}attitude_samples", where)
    count = int(_list(words, "detector_count", 1, where)[0])
    psi_x, psi_y = (_list(words, f"pixel_lookat_angle_{axis}", count, where) for axis in "xy")
    cols: FloatArray = np.arange(0.5, count, dtype=np.float64)
    look = LookDirections.of(cols, -psi_y, psi_x, where, angular=True)
    orbit = Orbit.through(times, positions, velocities, where)
    width, height = (int(v) for v in _list(words, "image_size", 2, where))
    if width != count:
        raise InputError(f"{count} detectors for {width} columns", where=where, hint="get the whole file")
    require_cover(at, height, float(line) - 0.5, float(period), where)
    stars = words.get(f"{_PREFIX}star_tracker_used_flag", "0").strip() == "1"
    title = f"SPOT 5 HRG, {words.get(f'{_PREFIX}image_date', 'no date')[:10]}"
    path, quality = AnglePath(orbit, at, attitude), STARS if stars else GYROSCOPES
    return SceneMetadata(title, path, look, float(period), float(line) - 0.5, (width, height), quality)


def _need_whole(words: dict[str, str], where: str) -> None:
    """Check that the list holds no adjustment made by OSSIM and no part of a scene, which have no effect here."""
    for name, value in words.items():
        changed = re.fullmatch(r"adjustment_\d+\.adj_param_\d+\.(parameter|center)", name)
        if (changed or name == f"{_PREFIX}sub_image_offset") and not all(_is_zero(word) for word in value.split()):
            raise InputError(
                f"{name} is '{value[:40]}', not 0: "
                + ("an adjustment made by OSSIM is not applied" if changed else "this is a part of the scene"),
                where=where,
                hint="set it to 0, and "
                + ("refine here with control points" if changed else "say where the part lies: offset = [col, row]"),
            )


def _is_zero(word: str) -> bool:
    try:
        return float(word) == 0.0
    except ValueError:
        return False


def _words(content: str, where: str) -> dict[str, str]:
    words = {}
    for row in content.splitlines():
        name, colon, value = row.partition(":")
        if colon:
            words[name.strip()] = value.strip().strip('"').strip()
    if not words:
        raise InputError("this is no keyword list", where=where, hint="give METADATA.DIM or a .geom file of SPOT 5")
    return words


def _list(words: dict[str, str], name: str, count: int, where: str) -> FloatArray:
    """Finite numbers of a key, `count` of them (0: any number)."""
    given = words.get(f"{_PREFIX}{name}")
    if given is None:
        raise InputError(f"the keyword list has no {_PREFIX}{name}", where=where, hint="get the whole file")
    values = np.array([finite_number(word) for word in given.split()])
    if not len(values) or not np.isfinite(values).all() or (count and len(values) != count):
        wanted = f"{count} finite numbers" if count else "finite numbers"
        raise InputError(f"{_PREFIX}{name} does not hold {wanted}", where=where, hint="get the file again")
    return values
