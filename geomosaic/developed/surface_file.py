"""Surface files (TOML): plane, cylinder, cone, sphere or ellipsoid by its parameters, or fitted to measured points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, counted, default_hint, did_you_mean
from geomosaic.geo.crs import has_heights
from geomosaic.geo.engineering_crs import local_frame_crs
from geomosaic.geo.local_frames import LocalFrame
from geomosaic.geo.transform import Transform
from geomosaic.inputs.vertical_datums import positions_crs
from geomosaic.sensor.plausibility import DATUMS
from geomosaic.stores.path import to_path
from geomosaic.surface.developed.ellipsoid import PLAN, PROJECTIONS, Ellipsoid, Triaxial
from geomosaic.surface.developed.fit import SIZES, FittedPrimitive
from geomosaic.surface.developed.placement import Developed
from geomosaic.surface.developed.primitives import Axes, Cone, Cylinder, Flat, Primitive
from geomosaic.types import FloatArray, PathLike
from geomosaic.whole_files import finite, read_toml

# What the origin of each kind is called.
ORIGIN = {"plane": "point", "cylinder": "point", "cone": "apex", "sphere": "centre", "ellipsoid": "centre"}
_SIZES = {
    "plane": (), "cylinder": ("radius",), "cone": ("half_angle",), "sphere": ("radius",), "ellipsoid": ("semi_axes",)
}  # fmt: skip
_COMMON = ("kind", "points", "bottom", "top", "crs", "heights")
USUAL = "equidistant"


@dataclass(frozen=True)
class SurfaceFile:
    """Surface of a file, the CRS the file counts in, and notes on both.

    Attributes
    ----------
    path : Path
    surface : Developed
    crs : CRS
        3-D; the local frame where the file names none.
    facing : bool
        Whether the file says which side of a plane is looked at.
    facts : dict
        Kind, sizes and place with their sigmas, as JSON values.
    notes : tuple of str
    files : tuple of Path
        The file and the points it names.
    """

    path: Path
    surface: Developed
    crs: CRS
    facing: bool
    facts: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()


def read_surface(path: PathLike) -> SurfaceFile:
    """Surface of a TOML file.

    Parameters
    ----------
    path : path
        Keys at its top or in the one table [surface]; lengths in metres, angles in degrees.

    Raises
    ------
    InputError
        A key is missing, unknown or out of range.
    SolveError
        The points do not determine the surface.
    """
    with default_hint("correct that line of the surface file"):
        return _read_surface(path)


def _read_surface(path: PathLike) -> SurfaceFile:
    given, where = read_toml(path, "surface file"), str(path)
    table = given.get("surface")
    if isinstance(table, dict) and len(given) == 1:
        given = table
    kind = given.get("kind")
    if not isinstance(kind, str) or kind not in ORIGIN:
        hint = did_you_mean(str(kind), ORIGIN)
        raise InputError(
            "the surface has no kind" if kind is None else f"no surface of kind {kind!r}",
            where=where,
            hint=f"{hint} kinds are: {', '.join(ORIGIN)}".strip(),
        )
    _known(given, kind, where)
    crs = _crs(given, where)
    fitted = _fitted(given, kind, crs, to_path(path), where) if "points" in given else None
    frame, axes, body, facts, notes = fitted or _given(given, kind, crs, where)
    inside = given.get("side", "outside")
    if inside not in ("inside", "outside"):
        raise InputError(
            f"side = {inside!r} is neither 'inside' nor 'outside'",
            where=where,
            hint="write 'inside' where the photos see it from within, as in a tunnel",
        )
    bottom, top = _limit(given, "bottom", -np.inf, where), _limit(given, "top", np.inf, where)
    if not bottom < top:
        raise InputError(
            f"bottom = {bottom:g} is not below top = {top:g}", where=where, hint="swap them, or leave one out"
        )
    surface = Developed(body, axes, inside == "inside", bottom, top, frame)
    files = (to_path(path), *([to_path(path).parent / given["points"]] if "points" in given else []))
    facing = kind != "plane" or "normal" in given
    return SurfaceFile(to_path(path), surface, crs, facing, {"kind": kind, **facts}, notes, files)


def _known(given: Mapping[str, Any], kind: str, where: str) -> None:
    """Check that all keys mean something for a kind."""
    direction = ("normal", "up") if kind == "plane" else ("axis", "zero", "side")
    extra = ("projection",) if kind in ("sphere", "ellipsoid") else ()
    allowed = (*_COMMON, ORIGIN[kind], *_SIZES[kind], *direction, *extra)
    for key in given:
        if key not in allowed:
            hint = did_you_mean(key, allowed)
            hint = f"{hint} keys of a {kind} are: {', '.join(allowed)}".strip()
            raise InputError(f"unknown key '{key}'", where=where, hint=hint)
    doubled = [key for key in (ORIGIN[kind], *_SIZES[kind]) if key in given] if "points" in given else []
    if doubled:
        raise InputError(
            f"both points and {doubled[0]} are given", where=where, hint="give the points, or the parameters"
        )


def _crs(given: Mapping[str, Any], where: str) -> CRS:
    if "crs" not in given:
        if "heights" in given:
            raise InputError("heights are declared without a crs", where=where, hint="name the crs, or leave both out")
        return local_frame_crs()
    crs = positions_crs(str(given["crs"]), str(given["heights"]) if "heights" in given else None, where)
    if not has_heights(crs):
        raise InputError(
            f"the heights of the surface in '{crs.name}' have no vertical datum",
            where=where,
            hint=f"declare it with heights: {DATUMS}",
        )
    return crs


Parts = tuple[LocalFrame | None, Axes, Primitive, dict[str, Any], tuple[str, ...]]


def _given(given: Mapping[str, Any], kind: str, crs: CRS, where: str) -> Parts:
    """Surface from its parameters."""
    origin = _vector(given, ORIGIN[kind], where)
    frame = None
    if crs != local_frame_crs():
        frame, origin = LocalFrame.at(crs, origin), np.zeros(3)
        if not np.isfinite(frame.origin).all():
            raise InputError(
                f"{ORIGIN[kind]} has no place in '{crs.name}'",
                where=where,
                hint="check its order, x before y, and the CRS",
            )
    if kind == "plane":
        axes = Axes.facing(origin, _vector(given, "normal", where), _optional(given, "up", where), where)
    else:
        axis = _optional(given, "axis", where)
        axes = Axes.about(origin, np.array([0.0, 0.0, 1.0]) if axis is None else axis, _zero(given, where), where)
    sizes: list[float] = []
    for name in _SIZES[kind]:
        values = given.get(name)
        if values is None:
            raise InputError(f"'{name}' is missing", where=where, hint=f"give {name}, or points to fit the {kind} to")
        sizes += [
            _positive(v, name, where)
            for v in (values if name == "semi_axes" and isinstance(values, list) else [values])
        ]
    if kind == "ellipsoid":
        _check_semi_axes(sizes, given, where)
    if kind == "cone":
        if not sizes[0] < 90.0:
            raise InputError(
                f"half_angle = {sizes[0]:g} is not below 90 degrees",
                where=where,
                hint="give the angle between axis and side, in degrees",
            )
        sizes = [float(np.radians(sizes[0]))]
    return frame, axes, _primitive_of(kind, np.array(sizes), _projection(given, where)), {}, ()


def _primitive_of(kind: str, sizes: FloatArray, projection: str) -> Primitive:
    """Primitive of a kind, from its radius or semi-axes in metres, or the half angle of a cone in radians."""
    if kind == "plane":
        return Flat()
    if kind == "cylinder":
        return Cylinder(float(sizes[0]))
    if kind == "cone":
        return Cone(float(sizes[0]))
    if len(sizes) == 3:
        return Triaxial((float(sizes[0]), float(sizes[1]), float(sizes[2])))
    return Ellipsoid(float(sizes[0]), float(sizes[-1]), projection)


def _check_semi_axes(sizes: Sequence[float], given: Mapping[str, Any], where: str) -> None:
    """Check of semi-axes: two or three, and with three different ones no development but the plan."""
    if len(sizes) not in (2, 3):
        raise InputError(
            f"semi_axes has {counted(len(sizes), 'value')}, not 2 or 3",
            where=where,
            hint="give [across the axis, along it], metres, or [towards zero, across that, along the axis]",
        )
    if len(sizes) == 3 and given.get("projection", USUAL) != PLAN:
        raise InputError(
            f"an ellipsoid of three semi-axes has no '{given.get('projection', USUAL)}' development: its parallels are "
            "no circles",
            where=where,
            hint=f"say projection = '{PLAN}', or give two semi-axes, where both across the axis are alike",
        )


def _fitted(given: Mapping[str, Any], kind: str, crs: CRS, path: Path, where: str) -> Parts:
    """Surface through points measured on it."""
    from geomosaic.surface.developed.fit import fit_primitive

    points, frame = _points(path.parent / str(given["points"])), None
    if crs != local_frame_crs():
        # Fitted in a level frame of true lengths: a map has a scale distortion and large coordinates.
        frame = LocalFrame.at(crs, points.mean(axis=0))
        points = frame.to_enu(Transform(crs, frame.crs)(points))
    axis = None if kind == "plane" else _optional(given, "axis", where)
    fitted = fit_primitive(kind, points, axis)
    origin, along = fitted.shape.origin, fitted.shape.rotation[2]
    if kind == "plane":
        wanted = _optional(given, "normal", where)
        along = -along if wanted is not None and along @ wanted < 0.0 else along
        axes = Axes.facing(origin, along, _optional(given, "up", where), where)
    else:
        # The axis of a cone has a direction of its own, from its apex; that of any other body is turned to the one
        # given, or upwards.
        if kind != "cone" and (along @ axis if axis is not None else along[2]) < 0.0:
            along = -along
        if kind == "cylinder":  # v counts from the frame's origin: heights, where the axis is plumb
            origin = origin - (origin @ along) * along
        axes = Axes.about(origin, along, _zero(given, where), where)
    body = _primitive_of(kind, fitted.shape.sizes, _projection(given, where))
    return frame, axes, body, _fit_facts(fitted, axes), _fit_lines(fitted, axes)


def _points(path: Path) -> FloatArray:
    """Points (N, 3) of a table with the columns x, y, z."""
    from geomosaic.inputs.tables import read_table

    table = read_table(path, "table of points", "id,x,y,z")
    table.require("x", "y", "z", what="points on a surface")
    return np.array([[row.number(axis) for axis in "xyz"] for row in table])


def _projection(given: Mapping[str, Any], where: str) -> str:
    name = given.get("projection", USUAL)
    if not isinstance(name, str) or name not in PROJECTIONS:
        hint = did_you_mean(str(name), PROJECTIONS)
        hint = f"{hint} projections are: {', '.join(PROJECTIONS)}".strip()
        raise InputError(f"no projection named {name!r}", where=where, hint=hint)
    return str(name)


def _zero(given: Mapping[str, Any], where: str) -> FloatArray | None:
    return _optional(given, "zero", where)


def _number(value: Any, name: str, where: str) -> float:
    try:
        number = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else np.nan
    except OverflowError:  # a whole number of hundreds of digits
        number = np.inf
    if not np.isfinite(number):
        raise InputError(f"{name} = {value!r:.40} is not a finite number", where=where, hint="write a number")
    return number


def _positive(value: Any, name: str, where: str) -> float:
    number = _number(value, name, where)
    if not number > 0.0:
        raise InputError(f"{name} = {number:g} is not above 0", where=where, hint="give it in metres, or degrees")
    return number


def _limit(given: Mapping[str, Any], name: str, default: float, where: str) -> float:
    return _number(given[name], name, where) if name in given else default


def _optional(given: Mapping[str, Any], name: str, where: str) -> FloatArray | None:
    return _vector(given, name, where) if name in given else None


def _vector(given: Mapping[str, Any], name: str, where: str) -> FloatArray:
    value = given.get(name)
    if value is None:
        raise InputError(f"'{name}' is missing", where=where, hint=f"give {name} = [x, y, z]")
    if not isinstance(value, list) or len(value) != 3:
        raise InputError(f"{name} = {value!r} is not [x, y, z]", where=where, hint="give three numbers")
    return np.array([_number(item, name, where) for item in value])


def _fit_facts(fitted: FittedPrimitive, axes: Axes) -> dict[str, Any]:
    """Sizes, place and axis of a fitted surface with their sigmas in metres and degrees; None without redundancy."""
    kind, sigmas = fitted.shape.kind, fitted.sigmas
    degrees = {"half_angle"}
    sizes = {
        name: {
            "value": float(np.degrees(value) if name in degrees else value),
            "sigma": finite(np.degrees(sigmas[name]) if name in degrees else sigmas[name]),
        }
        for name, value in zip(SIZES[kind], fitted.shape.sizes, strict=True)
    }
    turns = [np.degrees(value) for name, value in sigmas.items() if name.startswith("about")]
    return {
        "points": len(fitted.residuals),
        "redundancy": fitted.redundancy,
        "rms": float(np.sqrt((fitted.residuals**2).mean())),
        "sigma0": finite(fitted.sigma0),
        "largest_residual": float(np.abs(fitted.residuals).max()),
        **sizes,
        "origin": {"value": fitted.shape.origin.tolist(), "sigma": [finite(s) for s in fitted.sigma_origin]},
        "axis": {"value": axes.rotation[2].tolist(), "sigma_degrees": [finite(turn) for turn in turns]},
    }


def _fit_lines(fitted: FittedPrimitive, axes: Axes) -> tuple[str, ...]:
    """Text of a fit in two lines: its check, and its sizes, place and axis."""
    facts = _fit_facts(fitted, axes)
    check = f"sigma0 {1000 * facts['sigma0']:.2g} mm" if facts["sigma0"] is not None else "no check: no point too many"
    sizes = []
    for name in SIZES[fitted.shape.kind]:
        unit = "°" if name == "half_angle" else " m"
        sizes.append(f"{name} {facts[name]['value']:.4f}{unit}{_sigma(facts[name]['sigma'])}")
    words = f"{fitted.shape.kind} through {facts['points']} points: {check}, largest distance "
    words += f"{1000 * facts['largest_residual']:.2g} mm"
    place = ", ".join(
        f"{v:.4f}{_sigma(s)}" for v, s in zip(facts["origin"]["value"], facts["origin"]["sigma"], strict=True)
    )
    axis = ", ".join(f"{v:+.6f}" for v in facts["axis"]["value"])
    turns = facts["axis"]["sigma_degrees"]
    tilt = "" if not turns or None in turns else f", to {max(turns):.2g}°"
    name = "normal" if fitted.shape.kind == "plane" else "axis"
    return words, "; ".join([*sizes, f"origin {place}", f"{name} {axis}{tilt}"])


def _sigma(value: float | None) -> str:
    return "" if value is None else f" ± {value:.2g}"
