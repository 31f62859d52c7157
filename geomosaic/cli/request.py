"""Inputs of the library from the flags of a command."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geomosaic.cli.options import json_value

if TYPE_CHECKING:
    from geomosaic.inputs.declarations import Block, PlanarInputs
    from geomosaic.render.extent import Area


def block_inputs(
    images: tuple[Path, ...],
    flags: Mapping[str, Any],
    control: Path | None = None,
    planar: PlanarInputs | None = None,
) -> Block:
    """Block from the flags of a command.

    Parameters
    ----------
    images : tuple of Path
    flags : mapping
        Values by parameter name, as click gives them.
    control : Path, optional
        Table of control points.
    planar : PlanarInputs, optional

    Returns
    -------
    Block

    Raises
    ------
    InputError
        An orientation or a camera is given without a sensor.
    """
    from geomosaic.errors import InputError
    from geomosaic.inputs.declarations import Block
    from geomosaic.sensor.registry import photo_sensor, plane_sensor

    if flags["sensor"] is None and (flags["exterior"] or flags["camera"] or flags["fiducials"]):
        raise InputError(
            "--exterior, --camera or --fiducials is given without a sensor", hint=f"add --sensor {photo_sensor()}"
        )
    return Block(
        images=images,
        sensor=flags["sensor"] or plane_sensor(),
        options={name: json_value(text) for name, text in flags["sensor_options"].items()},
        camera=flags["camera"],
        corrections=flags["corrections"],
        fiducials=flags["fiducials"],
        exterior=flags["exterior"],
        crs=flags["crs"],
        heights=flags["heights"],
        angles=flags["angles"],
        angle_unit=flags["angle_unit"],
        angle_frame=flags["angle_frame"],
        matrix=flags["matrix"],
        trusted=flags["trusted"],
        dem=flags["dem"],
        height=flags["height"],
        dem_heights=flags["dem_heights"],
        control=control,
        bands=flags["bands"],
        planar=planar,
        margin=None if flags.get("margin") is None else (flags["margin"],) * 4,
        usable=flags.get("usable"),
        band_names=flags.get("band_names"),
    )


def planar_inputs(flags: Mapping[str, Any]) -> PlanarInputs | None:
    """Planar placement of photos from the flags of a command.

    Parameters
    ----------
    flags : mapping
        Values by parameter name, as click gives them.

    Returns
    -------
    PlanarInputs or None
        None where nothing asks for it.

    Raises
    ------
    InputError
        A flag of it is given without --kind, or with a sensor that has a rigorous model.
    """
    from geomosaic.errors import InputError
    from geomosaic.inputs.declarations import PlanarInputs, wrong_policy
    from geomosaic.sensor.registry import plane_sensor

    own = [name for name in ("model", "ties", "gcps", "scale", "azimuth", "rectify") if flags[name] is not None]
    own += [name for name in ("robust", "insist") if flags[name]]
    rigorous = flags["sensor"] not in (None, plane_sensor())
    if flags["kind"] is None:
        if own and rigorous:
            what = f"--{own[0]} places photos without a rigorous model, and --sensor {flags['sensor']} names one"
            hint = "leave one of them out"
            if own == ["gcps"]:
                what = f"control points of images of --sensor {flags['sensor']} need a project, which reports on them"
                hint = (
                    f"geomosaic new block.toml IMAGE... --sensor {flags['sensor']} --gcps FILE with the other inputs, "
                    "then geomosaic run block.toml"
                )
            raise InputError(what, where=f"--{own[0]}", hint=hint)
        if own:
            raise InputError(
                f"--{own[0]} is given without a kind of mosaic",
                hint="add --kind uncontrolled, semicontrolled, controlled or grown",
            )
        return None
    if rigorous:
        raise InputError(
            f"--kind {flags['kind']} places photos without a rigorous model, and --sensor {flags['sensor']} names one",
            hint="leave one of them out",
        )
    scale = 1.0 if flags["scale"] is None else flags["scale"]
    azimuth = flags["azimuth"] or 0.0
    if not (math.isfinite(scale) and math.isfinite(azimuth)):
        raise InputError("--scale and --azimuth are finite numbers", hint="give map units per pixel, and degrees")
    wrong = wrong_policy(flags["robust"], flags["insist"])
    return PlanarInputs(flags["kind"], flags["model"], flags["ties"], scale, azimuth, flags["rectify"], wrong)


def area(flags: Mapping[str, Any]) -> Area:
    """Area of the output from the flags of a command.

    Parameters
    ----------
    flags : mapping
        `dst_crs`, `res`, `bounds` and, where the command has it, `like`.

    Returns
    -------
    Area
    """
    from geomosaic.render.extent import Area

    return Area(flags["dst_crs"], flags["res"], flags["bounds"], like=flags.get("like"))
