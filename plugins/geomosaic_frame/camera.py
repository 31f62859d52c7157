"""Interface of camera models: interior orientation and lens, whether in pixels or in millimetres of a film."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from geomosaic.errors import InputError, warn
from geomosaic.sensor.inputs import known_keys, need, numbers, pair, positive, table_of
from geomosaic.sensor.plugin import Parameters
from geomosaic.types import FloatArray
from geomosaic_frame.additional import NAMES, AdditionalParameters, additional_of, with_requested
from geomosaic_frame.distortion import Lens, NoDistortion
from geomosaic_frame.lenses import adjustable, coefficient_groups, lens_from_dict, lens_from_table, plain
from geomosaic_frame.rolling_shutter import RollingShutter

if TYPE_CHECKING:
    from geomosaic_frame.deformation import Deformation

KEYS = (
    "name",
    "size",
    "focal_length",
    "sensor_size",
    "pixel_size",
    "principal_point",
    "focal_length_px",
    "principal_point_px",
    "distortion",
    "additional",
    "rolling_shutter",
)
# Fields of view, degrees across the corners: of the longest telescopes in orbit, and beyond any but fisheye lenses.
NARROWEST, WIDEST = 0.05, 170.0


@dataclass(frozen=True)
class Camera:
    """Digital camera: interior orientation in pixels, with its lens.

    col = cx + fx·u and row = cy + fy·v, where (u, v) is what the lens makes of a direction in camera axes: x right, y
    DOWN, z forward. Additional parameters move (fx·u, fy·v) in the image plane.

    Attributes
    ----------
    size : tuple of int
        Width and height in pixels.
    focal : tuple of float
        fx, fy in pixels.
    principal_point : tuple of float
        (col, row) in pixels; (0, 0) is the outer corner of the upper-left pixel.
    lens : Lens
        Distortion.
    additional : AdditionalParameters, optional
        In pixels.
    shutter : RollingShutter, optional
        None where all of a photo is exposed at once.
    """

    size: tuple[int, int]
    focal: tuple[float, float]
    principal_point: tuple[float, float]
    lens: Lens = field(default_factory=NoDistortion)
    additional: AdditionalParameters | None = None
    shutter: RollingShutter | None = None
    deformation = None  # there is no film

    def __post_init__(self) -> None:
        object.__setattr__(self, "lens", self.lens.for_corners(*self._plane(self.corners)))

    @property
    def corners(self) -> FloatArray:
        """Outer corners of the image and the middles of its sides (8, 2)."""
        w, h = self.size
        grid = [(c, r) for c in (0.0, w / 2, w) for r in (0.0, h / 2, h) if (c, r) != (w / 2, h / 2)]
        return np.array(grid, dtype=np.float64)

    def _plane(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (N, 2) to (u, v)."""
        p = np.asarray(colrow, dtype=np.float64)
        x, y = p[:, 0] - self.principal_point[0], p[:, 1] - self.principal_point[1]
        if self.additional is not None:
            x, y = self.additional.undone(x, y)
        return x / self.focal[0], y / self.focal[1]

    def project(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Camera axes (N,) each to pixels (N, 2); NaN where the lens cannot see.

        Parameters
        ----------
        x, y, z : array (N,)
            Camera axes: right, down, ahead, in any unit.
        """
        u, v = self.lens.project(x, y, z)
        out = np.empty((len(u), 2))
        np.multiply(u, self.focal[0], out=out[:, 0])
        np.multiply(v, self.focal[1], out=out[:, 1])
        if self.additional is not None:
            out = np.column_stack(self.additional.shifted(*out.T))
        out += self.principal_point
        return out

    def derivatives(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by camera axes, (N, 2, 3).

        Parameters
        ----------
        x, y, z : array (N,)
            Camera axes: right, down, ahead, in any unit.
        """
        out: FloatArray = self.lens.derivatives(x, y, z) * np.array(self.focal)[:, None]
        if self.additional is not None:
            u, v = self.lens.project(x, y, z)
            out = self.additional.slopes(u * self.focal[0], v * self.focal[1]) @ out
        return out

    def directions(self, colrow: FloatArray) -> FloatArray:
        """Pixels (N, 2) to unit directions in camera axes (N, 3)."""
        direction = np.column_stack(self.lens.unproject(*self._plane(colrow)))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        return direction

    @cached_property
    def interior(self) -> Parameters:
        """Interior orientation: focal_length (along rows) in px, aspect (columns over rows), principal point, lens."""
        fx, fy = self.focal
        lens, more = adjustable(self.lens).coefficients, self.additional
        names = ("focal_length", "aspect", "principal_col", "principal_row", *lens, *(more.names if more else ()))
        units = ("px", "", "px", "px", *("",) * len(lens), *("px",) * (len(names) - 4 - len(lens)))
        values = [fy, fx / fy, *self.principal_point, *lens.values(), *(more.values if more else ())]
        corners = self.by_interior(*self.directions(self.corners).T)
        groups = {"principal_point": names[2:4], **coefficient_groups(self.lens), **NAMES}
        return Parameters.held(names, units, values, corners, groups)

    def deformed(self, values: FloatArray) -> Camera:
        """The camera itself: nothing of it belongs to one photo."""
        return self

    def having(self, names: Iterable[str]) -> Camera:
        """Camera with the additional parameters that names of an interior orientation ask for."""
        return with_requested(self, names, self._half)

    @property
    def _half(self) -> tuple[float, float]:
        return self.size[0] / 2.0, self.size[1] / 2.0

    def with_interior(self, values: FloatArray) -> Camera:
        """Camera with other values of the interior orientation (Q,)."""
        return _with_interior(self, tuple(values.tolist()))

    def by_interior(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by the interior orientation, (N, 2, Q).

        Parameters
        ----------
        x, y, z : array (N,)
            Camera axes: right, down, ahead, in any unit.
        """
        lens, (fx, fy) = adjustable(self.lens), self.focal
        u, v = lens.project(x, y, z)
        own = np.zeros((len(u), 2, 4))
        own[:, 0, 0], own[:, 1, 0] = u * (fx / fy), v
        own[:, 0, 1] = u * fy
        own[:, :, 2:] = np.eye(2) + 0.0 * u[:, None, None]  # NaN where the lens cannot see
        by_lens = lens.by_coefficients(x, y, z) * np.array([[fx], [fy]])
        if self.additional is None:
            return np.concatenate([own, by_lens], axis=2)
        slopes = self.additional.slopes(u * fx, v * fy)
        by_additional = self.additional.by_values(u * fx, v * fy)
        return np.concatenate([slopes @ own[:, :, :2], own[:, :, 2:], slopes @ by_lens, by_additional], axis=2)

    def warn_of_fold(self, where: str) -> None:
        """Warning where the image reaches beyond the radius up to which its distortion polynomial can be used."""
        u, v = self._plane(self.corners)
        beyond = ~self.lens.in_calibrated_range(u, v)
        if beyond.any():
            scale = math.sqrt(self.focal[0] * self.focal[1])
            warn(
                f"{where}: the distortion polynomial folds back {self.lens.edge * scale:.0f} px from the principal "
                f"point, but the image reaches {np.hypot(u, v).max() * scale:.0f} px; beyond, distortion goes on "
                f"linearly, and the image's edge is unreliable. Check the coefficients and their convention."
            )

    def scaled(self, size: tuple[int, int], where: str) -> Camera:
        """Camera of a copy of the image in another resolution.

        Raises
        ------
        InputError
            The copy has another aspect ratio.
        """
        if size == self.size:
            return self
        (w, h), (new_w, new_h) = self.size, size
        # A copy's sides are rounded to whole pixels: allow each of them its rounding.
        if abs(new_w * h - new_h * w) > max(w, h):
            hint = "rotated by its EXIF orientation" if new_w == h or (new_w < new_h) != (w < h) else "cropped"
            raise InputError(
                f"the image has {new_w} x {new_h} pixels, the camera {w} x {h}: not the same shape",
                where=where,
                hint=f"give the image as the camera took it (is it {hint}?), or the camera that fits it",
            )
        sx, sy = new_w / w, new_h / h
        return replace(
            self,
            size=size,
            focal=(self.focal[0] * sx, self.focal[1] * sy),
            principal_point=(self.principal_point[0] * sx, self.principal_point[1] * sy),
            additional=self.additional.scaled(math.sqrt(sx * sy)) if self.additional else None,
            shutter=self.shutter.scaled(size) if self.shutter else None,
        )

    @classmethod
    def from_table(cls, table: Mapping[str, Any], image_size: tuple[int, int], where: str) -> Camera:
        """Camera from a `camera.toml` table.

        Parameters
        ----------
        table : mapping
            - `size`: width, height of the calibrated image in px; that of the image where not given;
            - `focal_length` in mm, with `sensor_size` (width, height in mm) or `pixel_size` (µm, one or two), and
              `principal_point`: mm from the image's centre, x right, y UP, default (0, 0);
            - or `focal_length_px` (one or fx, fy) and `principal_point_px`: (col, row) from the outer corner of the
              upper-left pixel, default the image's centre;
            - `distortion`: see `lens_from_table`; `additional`: see `AdditionalParameters`;
            - `rolling_shutter`: see `RollingShutter`; `name`: free text.
        image_size : tuple of int
            Width, height of the image at hand in px.
        where : str
            Named in errors.
        """
        known_keys(table, KEYS, where)
        size = image_size
        if "size" in table:
            w, h = numbers(table["size"], 2, "size", where)
            if w < 1 or h < 1 or w != int(w) or h != int(h):
                raise InputError(
                    f"size = {[w, h]} is not a width and a height in whole pixels",
                    where=where,
                    hint="give size = [width, height] of the photos",
                )
            size = int(w), int(h)
        pixel = _pixel_size(table, size, where)
        focal_mm = positive(table["focal_length"], "focal_length", where) if "focal_length" in table else None
        lens_table = table_of(table.get("distortion", {"model": "none"}), "distortion", where)
        lens = lens_from_table(lens_table, focal_mm, f"{where}, distortion")
        focal = _focal(table, focal_mm, pixel, where)
        _check_field(focal, size, lens, where)
        camera = cls(size, focal, _principal_point(table, size, pixel, where), lens)
        return replace(
            camera, additional=additional_of(table, camera._half, where), shutter=_shutter(table, size, where)
        )

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "size": list(self.size),
            "focal_length_px": list(self.focal),
            "principal_point_px": list(self.principal_point),
            "distortion": self.lens.to_dict(),
            **({"additional": self.additional.to_dict()} if self.additional else {}),
            **({"rolling_shutter": self.shutter.to_dict()} if self.shutter else {}),
        }

    @classmethod
    def from_dict(cls, state: Mapping[str, Any]) -> Camera:
        """Camera of a state, as `to_dict` gives it."""
        w, h = state["size"]
        fx, fy = state["focal_length_px"]
        cx, cy = state["principal_point_px"]
        camera = cls((int(w), int(h)), (fx, fy), (cx, cy), lens_from_dict(state["distortion"]))
        shutter = _shutter(state, camera.size, "camera")
        return replace(camera, additional=additional_of(state, camera._half, "camera"), shutter=shutter)


# Photos of one camera have one camera in every step of an adjustment, and what is derived from it only once.
@lru_cache(maxsize=16)
def _with_interior(camera: Camera, values: tuple[float, ...]) -> Camera:
    focal, aspect, col, row, *rest = values
    lens, more = adjustable(camera.lens), camera.additional
    count = len(lens.coefficients)
    lens = plain(lens.with_coefficients(dict(zip(lens.coefficients, rest[:count], strict=True))))
    more = more.with_values(rest[count:]) if more else None
    return replace(camera, focal=(aspect * focal, focal), principal_point=(col, row), lens=lens, additional=more)


def _shutter(table: Mapping[str, Any], size: tuple[int, int], where: str) -> RollingShutter | None:
    """Rolling shutter of a camera's table or state; None without."""
    if "rolling_shutter" not in table:
        return None
    own = table_of(table["rolling_shutter"], "rolling_shutter", where)
    return RollingShutter.from_table(own, size, f"{where}, rolling_shutter")


def _one_of(table: Mapping[str, Any], first: str, second: str, where: str) -> None:
    if first in table and second in table:
        raise InputError(f"both '{first}' and '{second}' are given", where=where, hint="give one of them")


def _pixel_size(table: Mapping[str, Any], size: tuple[int, int], where: str) -> tuple[float, float] | None:
    """Pixel width and height in mm, where known."""
    _one_of(table, "sensor_size", "pixel_size", where)
    if "sensor_size" in table:
        w, h = pair(numbers(table["sensor_size"], 2, "sensor_size", where), "sensor_size", where)
        pixel = w / size[0], h / size[1]
        # Width and height in the wrong order give pixels far from square; sizes rounded to 0.1 mm hardly do.
        if not 0.98 < pixel[0] / pixel[1] < 1.02:
            raise InputError(
                f"sensor_size = {w} x {h} mm on {size[0]} x {size[1]} px makes pixels of {pixel[0] * 1000:.3f} x "
                f"{pixel[1] * 1000:.3f} µm, not square",
                where=where,
                hint="check the order (width, height) of size and sensor_size, or give pixel_size = [x, y] in µm",
            )
        return pixel
    if "pixel_size" in table:
        x, y = pair(table["pixel_size"], "pixel_size", where)
        return x / 1000.0, y / 1000.0
    return None


def _focal(
    table: Mapping[str, Any], focal_mm: float | None, pixel: tuple[float, float] | None, where: str
) -> tuple[float, float]:
    """Focal lengths fx, fy in pixels."""
    _one_of(table, "focal_length", "focal_length_px", where)
    if "focal_length_px" in table:
        return pair(table["focal_length_px"], "focal_length_px", where)
    if focal_mm is None:
        need(table, "focal_length", where, "the camera constant in mm (or focal_length_px in pixels)")
        raise AssertionError  # unreachable: need() has raised
    if pixel is None:
        raise InputError(
            "focal_length is in mm, but the size of a pixel is not known",
            where=where,
            hint="give sensor_size (width, height in mm) or pixel_size (µm), or focal_length_px",
        )
    return focal_mm / pixel[0], focal_mm / pixel[1]


def _check_field(focal: tuple[float, float], size: tuple[int, int], lens: Lens, where: str) -> None:
    """Check of the field of view: one that no camera has shows lengths in another unit than their key says."""
    angle = 2.0 * math.degrees(math.atan(math.hypot(size[0] / focal[0], size[1] / focal[1]) / 2.0))
    if NARROWEST <= angle <= WIDEST or (angle > WIDEST and lens.to_dict()["model"] == "fisheye"):
        return
    raise InputError(
        f"the focal length gives a field of view of {angle:.3g}° across the corners",
        where=where,
        hint="check the units: focal_length and sensor_size are in mm, pixel_size in µm, focal_length_px in pixels",
    )


def _principal_point(
    table: Mapping[str, Any], size: tuple[int, int], pixel: tuple[float, float] | None, where: str
) -> tuple[float, float]:
    """Principal point (col, row) in pixels; the image's centre where none is given."""
    _one_of(table, "principal_point", "principal_point_px", where)
    if "principal_point_px" in table:
        col, row = numbers(table["principal_point_px"], 2, "principal_point_px", where)
        return col, row
    x, y = numbers(table.get("principal_point", (0.0, 0.0)), 2, "principal_point", where)
    if pixel is None:
        if x or y:
            raise InputError(
                "principal_point is in mm, but the size of a pixel is not known",
                where=where,
                hint="give sensor_size or pixel_size, or principal_point_px",
            )
        return size[0] / 2, size[1] / 2
    if abs(x) > size[0] * pixel[0] / 2 or abs(y) > size[1] * pixel[1] / 2:
        raise InputError(
            f"principal_point = [{x}, {y}] mm lies outside the image",
            where=where,
            hint="it is the offset from the image's centre in mm; for pixels use principal_point_px",
        )
    return size[0] / 2 + x / pixel[0], size[1] / 2 - y / pixel[1]


class CameraModel(Protocol):
    """Camera model: camera axes (x right, y down, z forward) to pixels and back."""

    @property
    def shutter(self) -> RollingShutter | None:
        """Rolling shutter; None where all of a photo is exposed at once."""

    @property
    def deformation(self) -> Deformation | None:
        """Where the transformation from a film to its scan is adjusted with the photo."""

    def deformed(self, values: FloatArray) -> CameraModel:
        """Camera with other amounts (U,) of its film's deformation."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    @property
    def focal(self) -> tuple[float, float]:
        """Camera constant in pixels, along columns and rows."""

    def project(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Camera axes (N,) each to pixels (N, 2); NaN where the lens cannot see.

        Parameters
        ----------
        x, y, z : array (N,)
            Along the camera axes, in any unit.
        """

    def derivatives(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by camera axes, (N, 2, 3); parameters as for `project`."""

    def directions(self, colrow: FloatArray) -> FloatArray:
        """Pixels (N, 2) to unit directions in camera axes (N, 3)."""

    @property
    def interior(self) -> Parameters:
        """Interior orientation, all of it held."""

    def having(self, names: Iterable[str]) -> CameraModel:
        """Camera with the additional parameters that names of an interior orientation ask for."""

    def with_interior(self, values: FloatArray) -> CameraModel:
        """Camera with other values of the interior orientation (Q,)."""

    def by_interior(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by the interior orientation, (N, 2, Q); parameters as for `project`."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""


def camera_model_from_dict(state: Mapping[str, Any]) -> CameraModel:
    """Camera model of a saved state.

    Parameters
    ----------
    state : mapping
        As `to_dict` of the camera gives it.

    Returns
    -------
    CameraModel
        `FilmCamera` or `Camera`.
    """
    if "film" in state:
        from geomosaic_frame.film import FilmCamera

        return FilmCamera.from_dict(state)
    return Camera.from_dict(state)
