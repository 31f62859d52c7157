"""Film camera: its lens in millimetres, the scan of its film, and its calibration certificate.

With x, y the measured image coordinates from the principal point of autocollimation, y up, and (dx, dy) the same from
the principal point of symmetry at (sx, sy), r = |(dx, dy)|, the ideal image is at (manuals of calibration
laboratories; Manual of Photogrammetry, ch. 4)

    x + dx·g(r)/r + p1·(r² + 2·dx²) + 2·p2·dx·dy
    y + dy·g(r)/r + 2·p1·dx·dy + p2·(r² + 2·dy²)

and the ray goes to (x, y, −c) of the ideal image.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import is_local
from geomosaic.sensor.inputs import choice, known_keys, need, number, numbers, positive, table_of
from geomosaic.sensor.ray_corrections import (
    HIGHEST,
    curvature_shift,
    earth_radius,
    heights_in_metres,
    refraction_shift,
)
from geomosaic.types import BoolArray, FloatArray
from geomosaic_frame.distortion import Columns, Perspective
from geomosaic_frame.interior_orientation import apply
from geomosaic_frame.radial_tables import Radial, RadialPolynomial, RadialTable, radial_from_dict

ROUNDS = 30


@dataclass(frozen=True)
class FilmLens(Perspective):
    """Lens of a film camera, whose corrections apply to the measured image: ideal = formula(measured).

    Attributes
    ----------
    constant : float
        Camera constant in mm.
    radial : Radial
        g(r), mm.
    symmetry : tuple of float
        Principal point of symmetry from that of autocollimation, mm, x right, y up.
    tangential : tuple of float
        p1, p2 in mm⁻¹.
    """

    constant: float
    radial: Radial
    symmetry: tuple[float, float] = (0.0, 0.0)
    tangential: tuple[float, float] = (0.0, 0.0)

    def _ideal(self, u: FloatArray, v: FloatArray) -> tuple[Columns, tuple[FloatArray, ...]]:
        """Ideal (x, y) and the four derivatives by the measured (u, v), in focal lengths, y down."""
        c = self.constant
        dx, dy = u * c - self.symmetry[0], -v * c - self.symmetry[1]
        r = np.hypot(dx, dy)
        g, slope = self.radial.correction(r)
        safe = np.where(r > 0.0, r, 1.0)
        ratio = np.where(r > 0.0, g / safe, slope)
        # d(g/r)/dr / r, which vanishes in the centre.
        # g/r tends to g'(0) at the centre, where the quotient would be 0/0.
        bend = np.where(r > 0.0, (slope - ratio) / safe**2, 0.0)
        p1, p2 = self.tangential
        # Beyond the end of g, terms of degree two go on linearly along the ray: times end·(2r − end)/r².
        end = self.radial.end
        fade, fading = np.ones_like(r), np.zeros_like(r)
        if (p1 or p2) and np.isfinite(end):
            far = r > end
            fade[far] = end * (2.0 * r[far] - end) / r[far] ** 2
            fading[far] = 2.0 * end * (end - r[far]) / r[far] ** 4  # d fade/dr / r
        tx = p1 * (r**2 + 2.0 * dx**2) + 2.0 * p2 * dx * dy
        ty = 2.0 * p1 * dx * dy + p2 * (r**2 + 2.0 * dy**2)
        x, y = u * c + dx * ratio + fade * tx, -v * c + dy * ratio + fade * ty
        xx = 1.0 + ratio + dx * dx * bend + fade * (6.0 * p1 * dx + 2.0 * p2 * dy) + fading * tx * dx
        xy = dx * dy * bend + fade * (2.0 * p1 * dy + 2.0 * p2 * dx) + fading * tx * dy
        yx = dx * dy * bend + fade * (2.0 * p1 * dy + 2.0 * p2 * dx) + fading * ty * dx
        yy = 1.0 + ratio + dy * dy * bend + fade * (2.0 * p1 * dx + 6.0 * p2 * dy) + fading * ty * dy
        return (x / c, -y / c), (xx, -xy, -yx, yy)

    def _undistort(self, u: FloatArray, v: FloatArray) -> Columns:
        return self._ideal(u, v)[0]

    def _distort(self, x: FloatArray, y: FloatArray) -> Columns:
        """Measured from ideal image by Newton's method, to rounding; NaN where it does not converge."""
        u, v = x.copy(), y.copy()
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(ROUNDS):
                (a, b), (xx, xy, yx, yy) = self._ideal(u, v)
                a, b = x - a, y - b
                det = xx * yy - xy * yx
                du, dv = (yy * a - xy * b) / det, (xx * b - yx * a) / det
                u, v = u + du, v + dv
                step = np.maximum(np.abs(du), np.abs(dv)) / (1.0 + np.maximum(np.abs(u), np.abs(v)))
                if not (step > 2e-15).any():
                    break
            a, b = self._ideal(u, v)[0]
            lost = ~(np.maximum(np.abs(a - x), np.abs(b - y)) <= 1e-12 * (1.0 + np.maximum(np.abs(x), np.abs(y))))
        return np.where(lost, np.nan, u), np.where(lost, np.nan, v)

    def _slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Derivatives of the measured by the ideal image: the inverse of those of the corrections."""
        xx, xy, yx, yy = self._ideal(*self._distort(x, y))[1]
        det = xx * yy - xy * yx
        return yy / det, -xy / det, -yx / det, xx / det

    def trusted(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether the corrections are used there as given, not their continuation (N,)."""
        c = self.constant
        return np.hypot(u * c - self.symmetry[0], -v * c - self.symmetry[1]) <= self.radial.end

    def for_corners(self, u: FloatArray, v: FloatArray) -> Self:
        """The lens itself: its limit does not depend on the image."""
        return self

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "model": "film",
            "constant": self.constant,
            "radial": self.radial.to_dict(),
            "symmetry": list(self.symmetry),
            "tangential": list(self.tangential),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        (sx, sy), (p1, p2) = state["symmetry"], state["tangential"]
        return cls(float(state["constant"]), radial_from_dict(state["radial"]), (sx, sy), (p1, p2))


@dataclass(frozen=True)
class FilmCamera:
    """Film camera with the scan of its film.

    Camera axes → lens → millimetres in the axes of the fiducials → pixels.

    Attributes
    ----------
    size : tuple of int
        Width and height of the scan in pixels.
    lens : FilmLens
        With the camera constant.
    autocollimation : tuple of float
        Principal point of autocollimation in the axes of the fiducials, mm, x right, y up.
    to_film : array (3, 3)
        Homogeneous pixels → mm of the fiducial axes.
    """

    size: tuple[int, int]
    lens: FilmLens
    autocollimation: tuple[float, float]
    to_film: FloatArray
    _to_scan: FloatArray = field(init=False, repr=False, compare=False)
    _from_scan: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        # (u, v) of the lens, in focal lengths and y down, to mm to pixels.
        c, (x, y) = self.lens.constant, self.autocollimation
        matrix = np.linalg.inv(self.to_film) @ np.array([[c, 0.0, x], [0.0, -c, y], [0.0, 0.0, 1.0]])
        object.__setattr__(self, "_to_scan", matrix / matrix[2, 2])
        object.__setattr__(self, "_from_scan", np.linalg.inv(matrix))

    @property
    def focal(self) -> tuple[float, float]:
        """Camera constant in pixels, along columns and rows, at the principal point."""
        (a, b, c), (d, e, f), (g, h, _) = self._to_scan
        # The homography is not square pixels exactly: lengths of the pixel's sides seen in focal lengths.
        slopes = np.array([[a - c * g, b - c * h], [d - f * g, e - f * h]])
        across, down = 1.0 / np.linalg.norm(np.linalg.inv(slopes), axis=0)
        return float(across), float(down)

    def project(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Camera axes (N,) each to pixels (N, 2); NaN where the lens cannot see."""
        return apply(self._to_scan, np.column_stack(self.lens.project(x, y, z)))

    def derivatives(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by camera axes, (N, 2, 3)."""
        uv = np.column_stack(self.lens.project(x, y, z))
        colrow, w = apply(self._to_scan, uv), uv @ self._to_scan[2, :2] + self._to_scan[2, 2]
        by_uv = (self._to_scan[None, :2, :2] - colrow[:, :, None] * self._to_scan[2, :2]) / w[:, None, None]
        out: FloatArray = by_uv @ self.lens.derivatives(x, y, z)
        return out

    def directions(self, colrow: FloatArray) -> FloatArray:
        """Pixels (N, 2) to unit directions in camera axes (N, 3)."""
        u, v = apply(self._from_scan, colrow).T
        direction = np.column_stack(self.lens.unproject(u.copy(), v.copy()))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        return direction

    def reach(self) -> float:
        """Largest distance of the scan's corners from the principal point of symmetry, in mm."""
        w, h = self.size
        corners = apply(self.to_film, np.array([[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]]))
        middle = np.add(self.autocollimation, self.lens.symmetry)
        return float(np.hypot(*(corners - middle).T).max())

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "film": self.to_film.tolist(),
            "size": list(self.size),
            "autocollimation": list(self.autocollimation),
            "lens": self.lens.to_dict(),
        }

    @classmethod
    def from_dict(cls, state: Mapping[str, Any]) -> FilmCamera:
        """Camera of a state, as `to_dict` gives it."""
        (w, h), (x, y) = state["size"], state["autocollimation"]
        return cls((int(w), int(h)), FilmLens.from_dict(state["lens"]), (x, y), np.array(state["film"]))


KEYS = (
    "name",
    "date",
    "focal_length",
    "principal_point_autocollimation",
    "principal_point_symmetry",
    "fiducials",
    "distortion",
)
MODELS: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "radial": ("radius", "angle", "distortion", "correction", "radius_is"),
    "polynomial": ("k0", "k1", "k2", "k3", "k4", "p1", "p2", "sign"),
}
SIGNS = ("distortion", "correction")
RADII = ("measured", "ideal")
# µm; a lens of a mapping camera that distorts by more is a table in another unit.
LARGEST = 2000.0


@dataclass(frozen=True)
class Certificate:
    """Calibration certificate of a film camera in the axes of the fiducials: mm, x right, y up.

    Attributes
    ----------
    lens : FilmLens
    autocollimation : tuple of float
        Principal point of autocollimation: where the axis that collinearity refers to meets the film.
    fiducials : mapping
        Mark → (x, y).
    """

    lens: FilmLens
    autocollimation: tuple[float, float]
    fiducials: Mapping[str, tuple[float, float]]


def read_certificate(table: Mapping[str, Any], where: str) -> Certificate:
    """Calibration certificate of a table.

    Parameters
    ----------
    table : mapping
        - `focal_length`: camera constant in mm;
        - `principal_point_autocollimation`: [x, y] in mm in the axes of the fiducials;
        - `principal_point_symmetry`: [x, y] in mm, the centre of the distortion; default that of autocollimation;
        - `fiducials`: table of mark = [x, y] in mm, x right, y up;
        - `distortion`: see `_radial`; default none; `name`, `date`: free text.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        A key is missing, unknown, or no number of a likely size.
    """
    known_keys(table, KEYS, where)
    text = "the camera constant in mm"
    constant = positive(need(table, "focal_length", where, text), "focal_length", where)
    text = "[x, y] in mm in the axes of the fiducials, [0, 0] where the certificate has no other"
    key = "principal_point_autocollimation"
    point = need(table, key, where, text)
    ax, ay = numbers(point, 2, key, where)
    key = "principal_point_symmetry"
    sx, sy = numbers(table.get(key, (ax, ay)), 2, key, where)
    marks = table_of(need(table, "fiducials", where, "a table of mark = [x, y] in mm"), "fiducials", where)
    fiducials: dict[str, tuple[float, float]] = {}
    for name, place in marks.items():
        x, y = numbers(place, 2, f"fiducials.{name}", where)
        fiducials[str(name)] = (x, y)
    if len(fiducials) < 2:
        raise InputError(f"{len(fiducials)} fiducials are no interior orientation", where=where, hint="give all marks")
    reach = float(np.hypot(*np.array(list(fiducials.values())).T).max())
    for words, x, y in (("autocollimation", ax, ay), ("symmetry", sx, sy)):
        if np.hypot(x, y) > 0.2 * reach:
            raise InputError(
                f"principal_point_{words} = [{x:g}, {y:g}] is far from the middle of the fiducials, which reach "
                f"{reach:.1f}",
                where=where,
                hint="give both in mm, in the axes of the fiducials",
            )
    given = table_of(table.get("distortion", {"model": "none"}), "distortion", where)
    radial, tangential = _lens(given, constant, f"{where}, distortion")
    return Certificate(FilmLens(constant, radial, (sx - ax, sy - ay), tangential), (ax, ay), fiducials)


def _lens(table: Mapping[str, Any], constant: float, where: str) -> tuple[Radial, tuple[float, float]]:
    """Corrections of a `[distortion]` table; a distortion is what the lens does, a correction what undoes it."""
    model = choice(need(table, "model", where, f"one of {', '.join(MODELS)}"), MODELS, "model", where)
    known_keys(table, ("model", *MODELS[model]), where)
    if model == "none":
        return RadialPolynomial(()), (0.0, 0.0)
    if model == "radial":
        return _table(table, constant, where), (0.0, 0.0)
    text = (
        "distortion (the image lies farther out by the polynomial) or correction (to be added to the measured radius)"
    )
    sign = -1.0 if choice(need(table, "sign", where, text), SIGNS, "sign", where) == "distortion" else 1.0
    k = [sign * number(table.get(f"k{i}", 0.0), f"k{i}", where) for i in range(5)]
    p1, p2 = (sign * number(table.get(name, 0.0), name, where) for name in ("p1", "p2"))
    while k and k[-1] == 0.0:
        k.pop()
    worst = 1000.0 * abs(float(RadialPolynomial(tuple(k)).correction(np.array([0.6 * constant]))[0][0]))
    if worst > LARGEST:
        raise InputError(
            f"the polynomial distorts by {worst:.0f} µm at a radius of {0.6 * constant:.0f} mm",
            where=where,
            hint="give the coefficients in mm (k1 in mm^-2, k2 in mm^-4, ...), as certificates print them",
        )
    return RadialPolynomial(tuple(k)), (p1, p2)


def _table(table: Mapping[str, Any], constant: float, where: str) -> RadialTable:
    """Radial table: `radius` in mm or `angle` in degrees, and `distortion` (outwards) or `correction` in µm.

    `radius_is` names the radius: 'measured', on the film, or 'ideal', that of the undistorted image. An angle is that
    of the ray, whose radius c·tan α is ideal.
    """
    for first, second, text in (
        ("radius", "angle", "radii in mm, or angles from the axis in degrees"),
        ("distortion", "correction", "µm, positive outwards; or correction, µm to be added to the measured radius"),
    ):
        if (first in table) == (second in table):
            raise InputError(
                f"{'both' if first in table else 'neither'} '{first}' {'and' if first in table else 'nor'} '{second}' "
                "are given",
                where=where,
                hint=f"give one: {first}: {text}",
            )
    places, sign = ("radius" if "radius" in table else "angle"), -1.0 if "distortion" in table else 1.0
    values = "distortion" if "distortion" in table else "correction"
    if not isinstance(table[places], list | tuple) or not table[places]:
        raise InputError(
            f"{places} is {table[places]!r}, not a list of numbers",
            where=where,
            hint="give all its numbers in brackets: [0, 20, 40]",
        )
    count = len(table[places])
    at = np.array(numbers(table[places], count, places, where))
    shift = np.array(numbers(table[values], count, values, where))
    if (np.diff(at) <= 0.0).any() or at[0] < 0.0:
        raise InputError(
            f"{places} does not rise from line to line",
            where=where,
            hint="sort the table from the principal point outwards, each place once",
        )
    if places == "angle":
        if at[-1] >= 80.0:
            raise InputError(
                f"an angle of {at[-1]:g}° is no angle in a mapping camera",
                where=where,
                hint="give degrees from the axis, below 80",
            )
        at = constant * np.tan(np.radians(at))
    if at[0] == 0.0:
        if shift[0] != 0.0:
            raise InputError(
                f"the table has {shift[0]:g} µm at the principal point, where a radial distortion is 0",
                where=where,
                hint="give it about the principal point of symmetry",
            )
        at, shift = at[1:], shift[1:]
    if not len(at):
        raise InputError(
            "the table has no radius but 0", where=where, hint="give the radii up to the corner of the photo"
        )
    if np.abs(shift).max() > LARGEST:
        raise InputError(
            f"the table has {np.abs(shift).max():g} µm, which no mapping camera has",
            where=where,
            hint="give micrometres",
        )
    correction = sign * shift / 1000.0
    usual = "ideal" if places == "angle" else "measured"
    if choice(table.get("radius_is", usual), RADII, "radius_is", where) == "ideal":
        at = at - correction  # the measured radius of each line
        if (np.diff(at, prepend=0.0) <= 0.0).any():
            raise InputError(
                "the measured radius does not rise with the ideal one", where=where, hint="give micrometres"
            )
    return RadialTable(tuple(at.tolist()), tuple(correction.tolist()))


# Pixels from which on a correction that was not asked for is reported.
WORTH = 0.5


def omitted_corrections(
    camera: object, crs: CRS, position: FloatArray, ground: float | None, treatment: str
) -> list[str]:
    """Notes on corrections that are not applied and would move the corners by half a pixel or more.

    Parameters
    ----------
    camera : CameraModel
        Of any kind; only film cameras are judged.
    crs : CRS
        Of the position.
    position : array (3,)
        Projection centre, in `crs`.
    ground : float, optional
        Height of the ground in the unit and vertical datum of `crs`; no notes without it.
    treatment : str
        'rigorous' or 'planar'; curvature matters for the latter only.

    Returns
    -------
    list of str
    """
    if ground is None or is_local(crs) or not isinstance(camera, FilmCamera):
        return []
    top, bottom = heights_in_metres(crs, position, ground)
    if not 0.0 <= bottom < top <= HIGHEST:
        return []
    constant, radius = camera.lens.constant, camera.reach()
    pixels = max(camera.focal) / constant / 1000.0
    notes = []
    moved = float(refraction_shift(np.array(radius), constant, top, bottom)) * pixels
    if moved >= WORTH:
        notes.append(f"refraction is not corrected; it moves the corners by {moved:.1f} px (refraction = true)")
    if treatment == "planar":
        moved = float(curvature_shift(np.array(radius), constant, top - bottom, earth_radius(crs, position))) * pixels
        if moved >= WORTH:
            notes.append(f"curvature is not corrected; it moves the corners by {moved:.1f} px (curvature = true)")
    return notes
