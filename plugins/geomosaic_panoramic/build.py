"""The plugin's door: numbers of a flight to a model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from geomosaic.errors import InputError, did_you_mean
from geomosaic.geo.crs import horizontal
from geomosaic.geo.local import LocalFrame, map_place
from geomosaic.geo.transform import Transform
from geomosaic.sensor.datum import need_heights
from geomosaic.sensor.parameters import Parameters
from geomosaic.sensor.plugin import SensorInput, SensorRequest
from geomosaic_panoramic.example import EXAMPLE
from geomosaic_panoramic.geometry import KINDS, Scan
from geomosaic_panoramic.model import NAMES, PanoramicModel

PER_STEP = {"scanner": "line", "panoramic": "sweep"}


class PanoramicPlugin:
    """Sensor 'panoramic'."""

    name = "panoramic"
    summary = "airborne across-track scanners and panoramic cameras, with attitude and motion during the scan"
    inputs = (
        SensorInput("kind", "scanner (a line is one moment) or panoramic (one sweep of a lens over the film)"),
        SensorInput("position", "x, y, z at the middle of the image, in the CRS of the positions"),
        SensorInput("heading", "direction of the nose, clockwise from north", "deg"),
        SensorInput("north", "grid or true: the north that heading and course count from", default="grid"),
        SensorInput("course", "direction of motion, clockwise from north", "deg", "heading"),
        SensorInput("pitch", "nose up", "deg", "0"),
        SensorInput("roll", "right wing down", "deg", "0"),
        SensorInput("rates", "heading, pitch, roll: change per line, or per sweep", "deg", "0, 0, 0"),
        SensorInput("advance", "way over ground per line (scanner), or during the sweep (panoramic)", "m"),
        SensorInput("v_over_h", "angular speed instead of advance: V/H per line or sweep; needs ground_height", "rad"),
        SensorInput("climb", "change of height per line or sweep", "m", "0"),
        SensorInput("field_of_view", "angle of the whole sweep, all columns", "deg"),
        SensorInput("focal_length", "panoramic: focal length", "mm"),
        SensorInput("pixel_size", "panoramic: pixel of the scanned film", "mm"),
        SensorInput("image_motion", "panoramic: image motion compensation, shift of rows at 90° of scan", "px", "0"),
        SensorInput("columns", "right or left: side of the flight that columns run to", default="right"),
        SensorInput("ground_height", "mean height of the ground, in the vertical datum of the positions", "m", "0"),
    )
    model = PanoramicModel
    example = EXAMPLE

    def build(self, request: SensorRequest) -> PanoramicModel:
        """Make the model of one image.

        Raises
        ------
        InputError
            An input is missing, unknown or out of range.
        HeightDatumError
            The position has no vertical datum.
        """
        where, options = request.image, request.options
        known = [entry.name for entry in self.inputs]
        for key in options:
            if key not in known:
                hint = did_you_mean(str(key), known)
                raise InputError(f"sensor 'panoramic' has no input '{key}'", where=where, mend=hint or "see its inputs")
        kind = _word(options, "kind", KINDS, where)
        if request.crs is None:
            raise InputError(
                "sensor 'panoramic' needs the CRS of the position", where=where, mend="give --exterior-crs"
            )
        need_heights(request.crs, "the position", where, lambda crs: self.build(replace(request, crs=crs)))
        position = np.array(_numbers(options, "position", 3, where))
        frame = LocalFrame.at(request.crs, position)
        if not np.isfinite(frame.origin).all():
            raise InputError(f"position {position.tolist()} has no place in '{request.crs.name}'", where=where)
        north = _word(options, "north", ("grid", "true"), where, "grid")
        turn = 0.0
        if north == "grid" and horizontal(request.crs).is_projected:
            turn = map_place(request.crs, position[0], position[1]).convergence
        heading = _number(options, "heading", where) + turn
        course = math.radians(_number(options, "course", where, heading - turn) + turn)
        ground = _number(options, "ground_height", where, 0.0)
        above = position[2] - ground
        if above <= 0.0:
            raise InputError(
                f"the position is {-above:g} m below ground_height", where=where, mend="check both heights"
            )
        advance = _advance(options, kind, above, where)
        field = _number(options, "field_of_view", where)
        limit = 170.0 if kind == "scanner" else 180.0
        if not 0.0 < field < limit:
            raise InputError(f"field_of_view is {field:g}", where=where, mend=f"give degrees between 0 and {limit:g}")
        focal = _focal(options, kind, where)
        motion = _number(options, "image_motion", where, 0.0)
        side = 1 if _word(options, "columns", ("right", "left"), where, "right") == "right" else -1
        values = np.array(
            [
                0.0, 0.0, 0.0,
                advance * math.sin(course), advance * math.cos(course), _number(options, "climb", where, 0.0),
                heading, _number(options, "pitch", where, 0.0), _number(options, "roll", where, 0.0),
                *_numbers(options, "rates", 3, where, (0.0, 0.0, 0.0)),
                field / request.size[0], focal, motion,
            ][: len(NAMES[kind])]
        )  # fmt: skip
        seed = position.copy()
        seed[2] = ground
        x, y, z = Transform(request.crs, frame.crs)(seed[None])[0].tolist()
        scan = Scan(kind, request.size, side)
        parameters = _parameters(kind, request.size, values, above)
        return _seen(PanoramicModel(scan, frame, parameters, (x, y, z)), above)


def _seen(model: PanoramicModel, above: float) -> PanoramicModel:
    """The model with a seed in the middle of the image: where its line of sight comes down by the height."""
    middle = np.array([[model.size[0] / 2, model.size[1] / 2]])
    origins, directions = model.rays(middle)
    down = -(directions @ model.frame.axes.T)[0, 2]
    if down <= 0.05:
        raise InputError("the middle of the image looks at the sky", mend="check roll and pitch, in degrees")
    x, y, z = (origins + directions * above / down)[0].tolist()
    return replace(model, seed=(x, y, z))


def _parameters(kind: str, size: tuple[int, int], values: np.ndarray, above: float) -> Parameters:
    """Steps move the image by about a pixel; the inside and the rates are held unless an adjustment frees them."""
    beta = math.radians(values[12])
    pixel, reach = above * beta, max(1.0, size[1] / 2 if kind == "scanner" else 0.5)
    angle = math.degrees(beta)
    steps = [
        pixel, pixel, pixel, pixel / reach, pixel / reach, pixel / reach, angle, angle, angle, angle / reach,
        angle / reach, angle / reach, values[12] / size[0] * 2,
    ]  # fmt: skip
    if kind == "panoramic":
        steps += [values[13] / size[1] * 2, 1.0]
    free = math.inf
    sigmas = [free] * 3 + [free, free, 0.0] + [free] * 3
    sigmas += [0.0] * (len(values) - len(sigmas))
    unit = PER_STEP[kind]
    units = ("m",) * 3 + (f"m/{unit}",) * 3 + ("deg",) * 3 + (f"deg/{unit}",) * 3 + ("deg", "px", "px")
    return Parameters(NAMES[kind], units[: len(values)], values, np.array(sigmas), np.array(steps))


def _advance(options: Mapping[str, Any], kind: str, above: float, where: str) -> float:
    if "advance" in options and "v_over_h" in options:
        raise InputError("advance and v_over_h are given together", where=where, mend="give one of them")
    if "v_over_h" in options:
        if "ground_height" not in options:
            raise InputError("v_over_h needs the height above ground", where=where, mend="give ground_height")
        advance = _number(options, "v_over_h", where) * above
    else:
        advance = _number(options, "advance", where, None if kind == "scanner" else 0.0)
    if kind == "scanner" and advance <= 0.0:
        raise InputError(f"the scanner advances by {advance:g} m per line", where=where, mend="give a positive advance")
    return advance


def _focal(options: Mapping[str, Any], kind: str, where: str) -> float:
    """Focal length in pixels; a scanner has none."""
    if kind == "scanner":
        given = [name for name in ("focal_length", "pixel_size", "image_motion") if name in options]
        if given:
            raise InputError(f"{given[0]} has no meaning for a scanner", where=where, mend="leave it out")
        return 0.0
    focal, pixel = _number(options, "focal_length", where), _number(options, "pixel_size", where)
    if focal <= 0.0 or pixel <= 0.0:
        raise InputError("focal_length and pixel_size must be greater than 0", where=where, mend="give both in mm")
    return focal / pixel


def _word(options: Mapping[str, Any], name: str, words: Sequence[str], where: str, default: str | None = None) -> str:
    word = options.get(name, default)
    if word not in words:
        said = f"input '{name}' is '{word}'" if name in options else f"input '{name}' is missing"
        raise InputError(said, where=where, mend=f"{did_you_mean(str(word), words)} give {' or '.join(words)}".strip())
    return str(word)


def _number(options: Mapping[str, Any], name: str, where: str, default: float | None = None) -> float:
    if name not in options and default is not None:
        return default
    return _numbers({name: [options[name]]} if name in options else {}, name, 1, where)[0]


def _numbers(
    options: Mapping[str, Any], name: str, count: int, where: str, default: Sequence[float] | None = None
) -> list[float]:
    given = options.get(name, default)
    if given is None:
        raise InputError(f"input '{name}' is missing", where=where, mend="see `geomosaic sensors panoramic`")
    good = isinstance(given, Sequence) and not isinstance(given, str) and len(given) == count
    try:
        numbers = [float(value) for value in given] if good else []
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        noun = "a number" if count == 1 else f"{count} numbers"
        raise InputError(f"input '{name}' is not {noun}: {given!r}", where=where)
    return numbers
