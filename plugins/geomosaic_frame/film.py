"""Film camera: its lens in millimetres, and the scan of its film.

With x, y the measured image coordinates from the principal point of autocollimation, y up, and (dx, dy) the same from
the principal point of symmetry at (sx, sy), r = |(dx, dy)|, the ideal image is at (manuals of calibration
laboratories; Manual of Photogrammetry, ch. 4)

    x + dx·g(r)/r + p1·(r² + 2·dx²) + 2·p2·dx·dy
    y + dy·g(r)/r + 2·p1·dx·dy + p2·(r² + 2·dy²)

and the ray goes to (x, y, −c) of the ideal image.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import is_local
from geomosaic.sensor.plugin import Parameters
from geomosaic.sensor.ray_corrections import (
    HIGHEST,
    curvature_shift,
    earth_radius,
    heights_in_metres,
    refraction_shift,
)
from geomosaic.types import BoolArray, FloatArray
from geomosaic_frame.additional import NAMES, AdditionalParameters, additional_of, with_requested
from geomosaic_frame.deformation import Deformation
from geomosaic_frame.distortion import Columns, Perspective, Slopes, inverse_slopes, newton_inverse
from geomosaic_frame.interior_orientation import apply
from geomosaic_frame.radial_tables import Radial, RadialPolynomial, radial_from_dict

# Terms of a radial polynomial, k0 to k4.
DEGREE = 5


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

    def _ideal(self, u: FloatArray, v: FloatArray) -> tuple[Columns, Slopes]:
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
        return newton_inverse(self._ideal, (x, y), (x, y))

    def _slopes(self, x: FloatArray, y: FloatArray) -> Slopes:
        return inverse_slopes(self._ideal(*self._distort(x, y))[1])

    @property
    def coefficients(self) -> dict[str, float]:
        """Of a radial polynomial k0 to k4 and p1, p2, in mm, as corrections; none of a radial table."""
        if not isinstance(self.radial, RadialPolynomial):
            return {}
        k = (*self.radial.k, *(0.0,) * (DEGREE - len(self.radial.k)))
        return {**{f"k{i}": value for i, value in enumerate(k)}, "p1": self.tangential[0], "p2": self.tangential[1]}

    def with_coefficients(self, values: Mapping[str, float]) -> Self:
        """Lens with other values of the coefficients."""
        if not values:
            return self
        *k, p1, p2 = values.values()
        while k and k[-1] == 0.0:
            k.pop()
        return replace(self, radial=RadialPolynomial(tuple(k)), tangential=(p1, p2))

    def _coefficient_slopes(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Derivatives of the measured (u, v) by the coefficients, (N, 2, K)."""
        names = self.coefficients
        if not names:
            return super()._coefficient_slopes(x, y)
        u, v = self._distort(x, y)
        dx, dy = u * self.constant - self.symmetry[0], -v * self.constant - self.symmetry[1]
        r, end = np.hypot(dx, dy), self.radial.end
        # The end of the corrections is held: no image point beyond it should count.
        near, far = np.minimum(r, end), r > end
        fade = np.ones_like(r)
        fade[far] = end * (2.0 * r[far] - end) / r[far] ** 2
        ratio = near / np.where(r > 0.0, r, 1.0)
        added = np.empty((len(r), 2, len(names)))
        for i in range(len(names) - 2):
            g = near ** (2 * i) * (ratio + (2 * i + 1) * (1.0 - ratio))  # of g over r
            added[:, 0, i], added[:, 1, i] = dx * g, dy * g
        added[:, 0, -2], added[:, 1, -2] = fade * (r**2 + 2.0 * dx**2), fade * 2.0 * dx * dy
        added[:, 0, -1], added[:, 1, -1] = fade * 2.0 * dx * dy, fade * (r**2 + 2.0 * dy**2)
        # formula(measured) = ideal stays as it is: what a coefficient adds, the measured image takes back.
        added *= np.array([[-1.0], [1.0]]) / self.constant
        slopes: FloatArray = np.einsum("ijn,njk->nik", np.reshape(self._slopes(x, y), (2, 2, -1)), added)
        return slopes

    def in_calibrated_range(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether the corrections are used there as given, not their continuation (N,)."""
        c = self.constant
        return np.hypot(u * c - self.symmetry[0], -v * c - self.symmetry[1]) <= self.radial.end

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

    Camera axes → lens → additional parameters → millimetres in the axes of the fiducials → pixels.

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
    additional : AdditionalParameters, optional
        In mm.
    deformation : Deformation, optional
        Where the transformation to the film is adjusted with the photo.
    """

    size: tuple[int, int]
    lens: FilmLens
    autocollimation: tuple[float, float]
    to_film: FloatArray
    additional: AdditionalParameters | None = None
    deformation: Deformation | None = None
    _to_scan: FloatArray = field(init=False, repr=False, compare=False)
    _from_scan: FloatArray = field(init=False, repr=False, compare=False)
    shutter = None  # no camera for film has one that rolls

    def __post_init__(self) -> None:
        # (u, v) of the lens, in focal lengths and y down, to mm to pixels.
        c, (x, y) = self.lens.constant, self.autocollimation
        matrix = np.linalg.inv(self.to_film) @ np.array([[c, 0.0, x], [0.0, -c, y], [0.0, 0.0, 1.0]])
        if self.deformation is not None:
            matrix = self.deformation.matrix @ matrix
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
        return apply(self._to_scan, self._film(x, y, z)[0])

    def _film(self, x: FloatArray, y: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Camera axes (N,) each to (u, v) in the film (N, 2), and their derivatives by the (u, v) of the lens."""
        u, v = self.lens.project(x, y, z)
        if self.additional is None:
            return np.column_stack([u, v]), None
        c = self.lens.constant
        return np.column_stack(self.additional.shifted(u * c, v * c)) / c, self.additional.slopes(u * c, v * c)

    def derivatives(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by camera axes, (N, 2, 3)."""
        return self._by_uv(x, y, z)[1] @ self.lens.derivatives(x, y, z)

    def _by_uv(self, x: FloatArray, y: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by (u, v) in the film, (N, 2, 2), and by those of the lens."""
        uv, slopes = self._film(x, y, z)
        colrow, w = apply(self._to_scan, uv), uv @ self._to_scan[2, :2] + self._to_scan[2, 2]
        by_film: FloatArray = (self._to_scan[None, :2, :2] - colrow[:, :, None] * self._to_scan[2, :2]) / w[
            :, None, None
        ]
        return by_film, by_film if slopes is None else by_film @ slopes

    @property
    def _corners(self) -> FloatArray:
        """Outer corners of the scan (4, 2)."""
        w, h = self.size
        return np.array([[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]])

    @cached_property
    def interior(self) -> Parameters:
        """Interior orientation: camera constant and principal point of autocollimation in mm, and the lens.

        The principal point of symmetry moves with that of autocollimation.
        """
        lens, more = self.lens.coefficients, self.additional
        names = ("focal_length", "principal_x", "principal_y", *lens, *(more.names if more else ()))
        units = ("mm", "mm", "mm", *(_unit(name) for name in lens), *("mm",) * (len(names) - 3 - len(lens)))
        values = [self.lens.constant, *self.autocollimation, *lens.values(), *(more.values if more else ())]
        corners = self.by_interior(*self.directions(self._corners).T)
        distortion = {"distortion": tuple(lens)} if lens else {}
        return Parameters.held(names, units, values, corners, {"principal_point": names[1:3], **distortion, **NAMES})

    def having(self, names: Iterable[str]) -> FilmCamera:
        """Camera with the additional parameters that names of an interior orientation ask for."""
        return with_requested(self, names, self.half)

    @property
    def half(self) -> tuple[float, float]:
        """Half the size of the scan along the axes of the fiducials, mm."""
        width, height = np.ptp(apply(self.to_film, self._corners), axis=0) / 2.0
        return float(width), float(height)

    def with_interior(self, values: FloatArray) -> FilmCamera:
        """Camera with other values of the interior orientation (Q,)."""
        constant, x, y, *rest = (float(value) for value in values)
        names, more = tuple(self.lens.coefficients), self.additional
        lens = self.lens.with_coefficients(dict(zip(names, rest[: len(names)], strict=True)))
        more = more.with_values(rest[len(names) :]) if more else None
        return replace(self, lens=replace(lens, constant=constant), autocollimation=(x, y), additional=more)

    def by_interior(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by the interior orientation, (N, 2, Q)."""
        (by_film, by_lens), c = self._by_uv(x, y, z), self.lens.constant
        # The lens in mm does not change with c: the image moves with the ideal point, and the unit of (u, v) is c.
        by_constant = self.lens.derivatives(x, y, z)[:, :, :2] @ (np.column_stack([x, y]) / c)[:, :, None]
        by_point = np.broadcast_to(np.diag([1.0, -1.0]) / c, by_film.shape)
        parts = [by_lens @ by_constant, by_film @ by_point, by_lens @ self.lens.by_coefficients(x, y, z)]
        if self.additional is not None:
            u, v = self.lens.project(x, y, z)
            parts.append(by_film @ self.additional.by_values(u * c, v * c) / c)
        return np.concatenate(parts, axis=2)

    def deformed(self, values: FloatArray) -> FilmCamera:
        """Camera with other amounts (U,) of its film's deformation."""
        assert self.deformation is not None
        return replace(self, deformation=self.deformation.with_values(values))

    def directions(self, colrow: FloatArray) -> FloatArray:
        """Pixels (N, 2) to unit directions in camera axes (N, 3)."""
        u, v = apply(self._from_scan, colrow).T
        if self.additional is not None:
            c = self.lens.constant
            u, v = (each / c for each in self.additional.undone(u * c, v * c))
        direction = np.column_stack(self.lens.unproject(u.copy(), v.copy()))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        return direction

    def reach(self) -> float:
        """Largest distance of the scan's corners from the principal point of symmetry, in mm."""
        corners = apply(self.to_film, self._corners)
        middle = np.add(self.autocollimation, self.lens.symmetry)
        return float(np.hypot(*(corners - middle).T).max())

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "film": self.to_film.tolist(),
            "size": list(self.size),
            "autocollimation": list(self.autocollimation),
            "lens": self.lens.to_dict(),
            **({"additional": self.additional.to_dict()} if self.additional else {}),
            **({"deformation": self.deformation.to_dict()} if self.deformation else {}),
        }

    @classmethod
    def from_dict(cls, state: Mapping[str, Any]) -> FilmCamera:
        """Camera of a state, as `to_dict` gives it."""
        (w, h), (x, y) = state["size"], state["autocollimation"]
        camera = cls((int(w), int(h)), FilmLens.from_dict(state["lens"]), (x, y), np.array(state["film"]))
        known = state.get("deformation")
        return replace(
            camera,
            additional=additional_of(state, camera.half, "camera"),
            deformation=Deformation.from_dict(known) if known else None,
        )


def _unit(name: str) -> str:
    """Unit of a coefficient: r, added in mm, times a power of mm."""
    power = -1 if name.startswith("p") else -2 * int(name[1:])
    return f"mm^{power}" if power else ""


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
