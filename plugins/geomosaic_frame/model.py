"""Frame model of a photo: ground to image with rays and derivatives, and its start at a place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import geographic, is_local
from geomosaic.geo.local_frames import LocalFrame, angles_of, local_frame_crs, omega_phi_kappa, r1, r2, r3
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import height_unit
from geomosaic.sensor.inputs import flag, known_keys, number, table_of
from geomosaic.sensor.plausibility import SkyError, centre_dip
from geomosaic.sensor.plugin import Parameters
from geomosaic.sensor.ray_corrections import Columns, RayCorrection
from geomosaic.types import FloatArray
from geomosaic_frame.camera import CameraModel, camera_model_from_dict
from geomosaic_frame.orientation import FLIP, SYSTEMS
from geomosaic_frame.placement import Place, convergence, local_frame

NAMES = ("east", "north", "up", "omega", "phi", "kappa")

# Derivative of R(t)·v by t is −e×(R·v): the cross-product matrices of the axes, negated.
_TURN = (
    np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
    np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
)


@dataclass(frozen=True, eq=False)
class FrameModel:
    """Frame sensor model: one photo of a frame camera.

    Attributes
    ----------
    camera : CameraModel
        Interior orientation for this image's size: in pixels, or a film with its scan.
    frame : LocalFrame
        East, north, up at the nominal projection centre; or the map's axes (planar treatment).
    parameters : Parameters
        east, north, up: offset of the projection centre from the frame's origin in metres (map units if planar); omega,
        phi, kappa in degrees, ground → image in that frame.
    seed : tuple of float
        Ground point in `crs` near the middle of the image.
    notes : tuple of str
        What was assumed when the model was made.
    ray_correction : RayCorrection
        Refraction and, in the planar treatment, the Earth's curvature; none unless asked for.
    interior_sigmas : tuple of float
        A-priori sigmas of the interior orientation; none where all of it is held.
    """

    camera: CameraModel
    frame: LocalFrame
    parameters: Parameters
    seed: tuple[float, float, float]
    notes: tuple[str, ...] = ()
    ray_correction: RayCorrection = field(default_factory=RayCorrection)
    interior_sigmas: tuple[float, ...] = ()

    @property
    def crs(self) -> CRS:
        """Geocentric, or the map CRS of the planar treatment."""
        return self.frame.crs

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.camera.size

    @cached_property
    def rotation(self) -> FloatArray:
        """Local frame → image, x right, y up (3, 3)."""
        omega, phi, kappa = np.radians(self.parameters.values[3:])
        return omega_phi_kappa(omega, phi, kappa)

    @cached_property
    def centre(self) -> FloatArray:
        """Projection centre in `crs` (3,)."""
        centre: FloatArray = self.frame.to_geocentric(self.parameters.values[None, :3])[0]
        return centre

    @cached_property
    def _to_camera(self) -> FloatArray:
        """`crs` → camera axes (3, 3)."""
        turned: FloatArray = FLIP @ self.rotation @ self.frame.axes
        return turned

    def _camera_axes(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Ground (N, 3) to camera axes, (N,) each."""
        # Written out instead of a matrix product: BLAS may round a point differently from one array length to the next.
        points = np.asarray(xyz, dtype=np.float64)
        x, y, z = (points[:, i] - self.centre[i] for i in range(3))
        if self.ray_correction.none:
            return _product(self._to_camera, x, y, z)
        return _product(FLIP @ self.rotation, *self.ray_correction.seen(*_product(self.frame.axes, x, y, z)))

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) in `crs` to image (N, 2) in pixels; NaN behind the camera."""
        return self.camera.project(*self._camera_axes(xyz))

    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to origins (N, 3) and unit directions (N, 3) towards the ground, in `crs`."""
        seen = self.camera.directions(colrow)
        if self.ray_correction.none:
            directions: FloatArray = seen @ self._to_camera
        else:
            directions = self.ray_correction.true(seen @ (FLIP @ self.rotation)) @ self.frame.axes
            directions /= np.linalg.norm(directions, axis=1)[:, None]
        return np.tile(self.centre, (len(directions), 1)), directions

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by parameters (N, 2, 6), per metre and degree, and by ground (N, 2, 3)."""
        points = np.asarray(xyz, dtype=np.float64)
        by_camera = self.camera.derivatives(*self._camera_axes(points))
        local = (points - self.centre) @ self.frame.axes.T
        bent = np.eye(3) if self.ray_correction.none else self.ray_correction.slopes(*local.T)
        seen = local if self.ray_correction.none else np.column_stack(self.ray_correction.seen(*local.T))
        omega, phi, kappa = np.radians(self.parameters.values[3:])
        turned = (
            self.rotation @ _TURN[0],
            r3(kappa) @ _TURN[1] @ r2(phi) @ r1(omega),
            _TURN[2] @ self.rotation,
        )
        out = np.empty((len(points), 2, 6))
        by_local = by_camera @ (FLIP @ self.rotation) @ bent
        out[:, :, :3] = -by_local
        for i, matrix in enumerate(turned):
            # Parameters are in degrees, the derivatives of rotations per radian: hence π/180 below.
            moved = seen @ (FLIP @ matrix).T
            out[:, :, 3 + i] = np.einsum("nij,nj->ni", by_camera, moved) * (np.pi / 180.0)
        return out, by_local @ self.frame.axes

    def with_values(self, values: FloatArray) -> Self:
        """Photo with other parameter values (6,)."""
        return replace(self, parameters=self.parameters.with_values(values))

    @property
    def interior(self) -> Parameters:
        """Interior orientation of the camera."""
        interior = self.camera.interior
        return replace(interior, sigmas=np.array(self.interior_sigmas)) if self.interior_sigmas else interior

    def with_interior(self, interior: Parameters) -> Self:
        """Photo whose camera has other values, and a-priori sigmas, of its interior orientation."""
        camera = self.camera.having(interior.names)
        if camera is not self.camera:
            # Additional parameters come all together, whatever part of them was named.
            all_of_it = camera.interior
            interior = interior.including(all_of_it.names)
            order = [interior.names.index(name) for name in all_of_it.names]
            interior = replace(all_of_it, values=interior.values[order], sigmas=interior.sigmas[order])
        sigmas = tuple(interior.sigmas.tolist()) if interior.sigmas.any() else ()
        return replace(self, camera=camera.with_interior(interior.values), interior_sigmas=sigmas)

    def interior_jacobian(self, xyz: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by the interior orientation, (N, 2, Q)."""
        return self.camera.by_interior(*self._camera_axes(xyz))

    @property
    def camera_table(self) -> Mapping[str, Any]:
        """The camera as `camera.toml` describes it, in pixels; of film its state, which no other program knows."""
        return self.camera.to_dict()

    @property
    def pose(self) -> tuple[FloatArray, FloatArray]:
        """Projection centre (3,) in `crs`, and rotation (3, 3) from its axes to the camera's."""
        return self.centre, self._to_camera

    def directions(self, colrow: FloatArray) -> FloatArray:
        """Image (N, 2) to unit directions (N, 3) in camera axes: x right, y down, z forward."""
        return self.camera.directions(colrow)

    def posed(self, centre: FloatArray, rotation: FloatArray, ahead: FloatArray, crs: CRS | None = None) -> Self:
        """Photo at another pose (see `pose`) that sees a point `ahead` (3,); all in a Cartesian `crs`, if given."""
        crs = crs or self.crs
        frame = LocalFrame.at(crs, centre) if crs.is_geocentric else LocalFrame(crs, np.array(centre), np.eye(3))
        turned = FLIP @ rotation @ frame.axes.T
        # Near the pole of phi, and where nothing is up, the angles count from the attitude itself.
        if is_local(crs) or abs(turned[2, 0]) > STEEPEST_PHI:
            frame, turned = LocalFrame(frame.crs, frame.origin, turned @ frame.axes), np.eye(3)
        x, y, z = (float(value) for value in ahead)
        values = np.array([0.0, 0.0, 0.0, *np.degrees(angles_of(turned))])
        steps = _steps(self.camera, float(np.linalg.norm(ahead - centre)))
        parameters = Parameters(NAMES, _units(crs), values, self.parameters.sigmas, steps)
        return replace(self, frame=frame, parameters=parameters, seed=(x, y, z))

    def exterior(self, crs: CRS) -> FloatArray:
        """Projection centre in `crs`, and omega, phi, kappa from its grid north, in degrees (6,)."""
        position = Transform(self.crs, crs)(self.centre[None])[0]
        rotation = self.rotation @ self.frame.axes
        if self.crs.is_geocentric:
            # From geocentric axes to those of the place, and from true north to the grid's: `placement.rigorous` back.
            rotation = rotation @ local_frame(crs, position, "exterior").axes.T @ r3(convergence(crs, position))
        return np.array([*position, *np.degrees(angles_of(rotation))])

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "camera": self.camera.to_dict(),
            **self.frame.to_dict(),
            **self.parameters.to_dict(),
            "units": list(self.parameters.units),
            "seed": list(self.seed),
            "notes": list(self.notes),
            "ray_correction": self.ray_correction.to_dict(),
            **({"interior_sigmas": self.interior.to_dict()["sigmas"]} if self.interior_sigmas else {}),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it."""
        frame = LocalFrame.from_dict(state)
        parameters = Parameters.from_dict(NAMES, tuple(state["units"]), state)
        x, y, z = state["seed"]
        ray_correction = RayCorrection.from_dict(state.get("ray_correction", {}))
        sigmas = tuple(np.inf if sigma is None else float(sigma) for sigma in state.get("interior_sigmas", ()))
        camera, notes = camera_model_from_dict(state["camera"]), tuple(state["notes"])
        return cls(camera, frame, parameters, (x, y, z), notes, ray_correction, sigmas)


def _product(matrix: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> Columns:
    """Product of a matrix (3, 3) and columns (N,), rounded alike for a point alone and among others."""
    a, b, c = (t[0] * x + t[1] * y + t[2] * z for t in matrix)
    return a, b, c


GROUPS = {"position": NAMES[:3], "angles": NAMES[3:]}
# Seed of a flat ray: at most this many flying heights away.
FARTHEST = 20.0
# Sine of phi from which the angles of a photo count from its own attitude: omega and kappa are nearly one turn there.
STEEPEST_PHI = 0.9
# Metres to whatever a photo without control points shows in a local frame: where searches start.
AHEAD = 10.0
# Flying height above an unknown ground where height 0 lies above the camera.
GUESSED_HEIGHT = 100.0


def _sigmas(options: Mapping[str, Any], where: str) -> FloatArray:
    """A-priori sigmas of the six parameters; free where none are given."""
    table = table_of(options.get("sigmas", {}), "sigmas", where)
    where = f"{where}, sigmas"
    known_keys(table, (*GROUPS, *NAMES), where)
    values = dict.fromkeys(NAMES, np.inf)
    for group, names in GROUPS.items():
        if group in table:
            values.update(dict.fromkeys(names, number(table[group], group, where)))
    values.update({name: number(table[name], name, where) for name in NAMES if name in table})
    negative = [name for name, value in values.items() if value < 0.0]
    if negative:
        raise InputError(f"the sigma of {negative[0]} is negative", where=where, hint="0 holds it fixed")
    return np.array([values[name] for name in NAMES])


def allows_any_view(crs: CRS, options: Mapping[str, Any], where: str) -> bool:
    """Whether a photo may look above the horizon: the option `upwards` says so, or its frame has no horizon.

    Parameters
    ----------
    crs : CRS
    options : mapping
    where : str
        Named in errors.
    """
    return is_local(crs) or flag(options, "upwards", where)


def frame_model(
    camera: CameraModel,
    place: Place,
    crs: CRS,
    ground: float | None,
    options: Mapping[str, Any],
    notes: tuple[str, ...],
    ray_correction: RayCorrection,
    where: str,
) -> FrameModel:
    """Frame model of a photo at a place, with seed and parameter steps.

    Parameters
    ----------
    camera : CameraModel
    place : Place
        Frame and rotation of the photo.
    crs : CRS
        3-D, of the position.
    ground : float, optional
        Height of the ground in the unit and vertical datum of `crs`.
    options : mapping
        With the a-priori `sigmas`, `upwards` and `points`.
    notes : tuple of str
        What was assumed so far.
    ray_correction : RayCorrection
        Refraction and curvature.
    where : str
        Named in errors.

    Returns
    -------
    FrameModel
        Position in the frame's unit, angles in degrees; steps of about a pixel.

    Raises
    ------
    SkyError
        The photo looks at the sky and may not.
    InputError
        The sigmas are wrong.
    """
    anywhere = allows_any_view(crs, options, where)
    if anywhere:
        # Omega, phi and kappa have no value where a camera looks along x: they count from the attitude given.
        turned = LocalFrame(place.frame.crs, place.frame.origin, place.rotation @ place.frame.axes)
        place = Place(turned, np.eye(3), place.height)
    values = np.array([0.0, 0.0, 0.0, *np.degrees(angles_of(place.rotation))])
    parameters = Parameters(NAMES, _units(place.frame.crs), values, _sigmas(options, where), np.ones(6))
    x, y, z = place.frame.origin
    start = FrameModel(camera, place.frame, parameters, (float(x), float(y), float(z)), notes, ray_correction)
    dip = 90.0 if anywhere else centre_dip(start)
    if dip is None or not dip > 0.0:
        raise SkyError(
            "the photo looks at the sky: its centre ray does not go below the horizon"
            + (f" but {-dip:.1f}° above it" if dip is not None else ""),
            where=where,
            hint=f"check the angle system ({', '.join(SYSTEMS)}), angle_unit, the direction of a matrix, and whether "
            "a roll or omega near 180° turns the camera over; a photo of a facade that is right as it is needs "
            "upwards = true",
        )
    seed, distance = (
        _some_way_ahead(start, crs, options) if anywhere else _ground_ahead(start, crs, place.height, ground)
    )
    return replace(start, parameters=replace(parameters, steps=_steps(camera, distance)), seed=seed)


def unoriented_model(camera: CameraModel, options: Mapping[str, Any], notes: tuple[str, ...], where: str) -> FrameModel:
    """Frame model of a photo that knows its camera alone: at the origin of a frame without a place, looking down.

    Parameters
    ----------
    camera : CameraModel
    options : mapping
        With the a-priori `sigmas`.
    notes : tuple of str
        On the camera.
    where : str
        Named in errors.
    """
    crs, origin = local_frame_crs(), np.zeros(3)
    parameters = Parameters(NAMES, _units(crs), np.zeros(6), _sigmas(options, where), np.ones(6))
    start = FrameModel(camera, LocalFrame(crs, origin, np.eye(3)), parameters, (0.0, 0.0, 0.0), notes)
    return start.posed(origin, FLIP, np.array([0.0, 0.0, -AHEAD]))


def _units(crs: CRS) -> tuple[str, ...]:
    """Units of the parameters of a photo in a Cartesian CRS."""
    return ("m" if crs.is_geocentric else str(crs.axis_info[0].unit_name),) * 3 + ("deg",) * 3


def _steps(camera: CameraModel, distance: float) -> FloatArray:
    """Steps (6,) of about a pixel, of a photo at a distance from what it shows."""
    focal = float(np.sqrt(camera.focal[0] * camera.focal[1]))
    return np.array([distance / focal] * 3 + [float(np.degrees(1.0 / focal))] * 3)


def _some_way_ahead(
    model: FrameModel, crs: CRS, options: Mapping[str, Any]
) -> tuple[tuple[float, float, float], float]:
    """Point on the centre ray at the distance of the control points, else `AHEAD`, and that distance."""
    # A facade is no ground to look for; searches only start there.
    w, h = model.size
    origin, direction = (a[0] for a in model.rays(np.array([[w / 2, h / 2]])))
    points = options.get("points")
    distance = AHEAD
    if points:
        known = np.array([[point[key] for key in ("x", "y", "z")] for point in points], dtype=np.float64)
        known = known if model.crs == crs else Transform(crs, model.crs)(known)
        distance = max(float(np.median(np.linalg.norm(known - origin, axis=1))), 1e-6)
    x, y, z = origin + distance * direction
    return (float(x), float(y), float(z)), distance


def _ground_ahead(
    model: FrameModel, crs: CRS, height: float, ground: float | None
) -> tuple[tuple[float, float, float], float]:
    """Ground point on the centre ray in the model's CRS, and its distance in the model's unit."""
    # The ray is followed down to the height of the ground, and on by what is missing, until it is there; a ray that
    # hardly goes down stops after twenty flying heights.
    w, h = model.size
    origin, direction = (a[0] for a in model.rays(np.array([[w / 2, h / 2]])))
    dip = np.sin(np.radians(centre_dip(model) or 90.0))
    level = geographic(crs) if crs.is_geocentric else crs
    to_level = Transform(model.crs, level)
    if crs.is_geocentric:
        height = float(to_level(origin[None])[0, 2])
    # Distances along the ray are in the model's unit, heights in that of their CRS, which may be feet.
    unit = 1.0 if not model.crs.is_geocentric else height_unit(level)
    if ground is None:
        ground = 0.0 if height * unit > 1.0 else height - GUESSED_HEIGHT / unit
    above = (height - ground) * unit
    # A ray that hardly goes down would meet the ground behind the horizon, where no search should start.
    distance = min(above / dip, FARTHEST * above)
    for _ in range(8):
        here = to_level((origin + distance * direction)[None])[0, 2]
        if not np.isfinite(here):
            break
        distance = float(np.clip(distance + (here - ground) * unit / dip, 0.1 * above, FARTHEST * above))
    x, y, z = origin + distance * direction
    return (float(x), float(y), float(z)), distance
