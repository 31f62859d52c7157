"""Lenses from the tables users write and from saved states; a kind is loaded when it is met."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import choice, known_keys, need, number, numbers
from geomosaic_frame.distortion import Lens, NoDistortion
from geomosaic_frame.polynomial import Brown

COEFFICIENTS = {
    "none": (),
    "brown": ("k1", "k2", "k3", "p1", "p2", "k4"),
    "opencv": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
CONVENTIONS = ("opencv", "photogrammetric")


def lens_from_table(table: Mapping[str, Any], focal: float | None, where: str) -> Lens:
    """Lens of a `[distortion]` table.

    Parameters
    ----------
    table : mapping
        `model`: 'none', 'brown', 'opencv' or 'fisheye'; its coefficients, 0 where not given; for 'brown' a
        `convention`: 'opencv' (default: without unit, y down, ideal to distorted) or 'photogrammetric' (mm, y up,
        corrections added to the measured coordinates); `shear`: columns per row by which the axes of the sensor are
        off the right angle, u + shear·v (Metashape's b2 over its focal length along columns); `centre` = [x, y] of
        the distortion, from the principal point in focal lengths, x right, y down (not for 'fisheye').
    focal : float or None
        Focal length in mm where it is known.
    where : str
        Named in errors.
    """
    model = choice(need(table, "model", where, f"one of {', '.join(COEFFICIENTS)}"), COEFFICIENTS, "model", where)
    more = ("convention", "centre") if model == "brown" else ("centre",) if model == "opencv" else ()
    known_keys(table, ("model", *COEFFICIENTS[model], "shear", *more), where)
    values = {key: number(table[key], key, where) for key in COEFFICIENTS[model] if key in table}
    convention = choice(table.get("convention", "opencv"), CONVENTIONS, "convention", where)
    if convention == "photogrammetric":
        if focal is None:
            raise InputError(
                "photogrammetric distortion is in millimetres, but the focal length is not",
                where=where,
                hint="give focal_length in mm with sensor_size or pixel_size, or use convention = 'opencv'",
            )
        k1, k2, k3, p1, p2, k4 = (values.get(key, 0.0) for key in COEFFICIENTS["brown"])
        if k4 or table.get("shear") or table.get("centre"):
            what = "k4, shear and centre belong to the convention 'opencv'"
            raise InputError(what, where=where, hint="leave them out")
        from geomosaic_frame.radial_tables import Corrections

        return Corrections.photogrammetric((k1, k2, k3), (p1, p2), focal)
    centre = numbers(table.get("centre", (0.0, 0.0)), 2, "centre", where)
    return _sheared(_moved(_make(model, values), centre), number(table.get("shear", 0.0), "shear", where))


def lens_from_dict(state: Mapping[str, Any]) -> Lens:
    """Lens of a saved state."""
    if state["model"] == "corrections":
        formula = {key: value for key, value in state["formula"].items() if key != "model"}
        from geomosaic_frame.radial_tables import Corrections

        return Corrections(Brown(**formula))
    values = {key: value for key, value in state.items() if key not in ("model", "shear", "centre")}
    return _sheared(_moved(_make(state["model"], values), state.get("centre", (0.0, 0.0))), state.get("shear", 0.0))


def _make(model: str, values: dict[str, float]) -> Lens:
    if model == "none":
        return NoDistortion()
    if model == "brown":
        return Brown(**values)
    if model == "opencv":
        from geomosaic_frame.polynomial import Rational

        return Rational(**values)
    from geomosaic_frame.fisheye import Fisheye

    return Fisheye(**values)


def _moved(lens: Lens, centre: Sequence[float]) -> Lens:
    if not any(centre):
        return lens
    from geomosaic_frame.lens_modifiers import OffCentre

    return OffCentre(lens, (float(centre[0]), float(centre[1])))


def _sheared(lens: Lens, shear: float) -> Lens:
    if shear == 0.0:
        return lens
    from geomosaic_frame.lens_modifiers import Sheared

    return Sheared(lens, shear)
