"""Contracts of a sensor: one pure map from ground to image, and the plugin that builds it from inputs.

The core imports no plugin: it asks the registry for one by its name or by what it can do, and works with its models.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from pyproj import CRS

from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Parameters:
    """Named parameters.

    Attributes
    ----------
    names, units : tuple of str
        One per parameter, for example 'omega' and 'deg'.
    values : array (P,)
        Current values in their units.
    sigmas : array (P,)
        A-priori standard deviations: 0 holds a parameter fixed, inf leaves it free.
    steps : array (P,)
        A change that moves the image by about one pixel; scales differences and normal equations.
    groups : mapping of str to tuple of str
        Names for several parameters together; of an interior orientation also for some that it has not, but can be
        given (`including`): they are 0 then.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    sigmas: FloatArray
    steps: FloatArray
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("values", "sigmas", "steps"):
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.shape != (len(self.names),):
                raise ValueError(f"{name} has shape {array.shape} for {len(self.names)} names")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if len(self.units) != len(self.names):
            raise ValueError("names and units differ in number")

    @classmethod
    def held(
        cls,
        names: tuple[str, ...],
        units: tuple[str, ...],
        values: Sequence[float],
        slopes: FloatArray,
        groups: Mapping[str, tuple[str, ...]] | None = None,
    ) -> Parameters:
        """Held parameters; `slopes` (M, 2, P) of the image at some places make steps of at most a pixel there.

        Parameters
        ----------
        names, units : tuple of str
        values : sequence of float (P,)
        slopes : array (M, 2, P)
            Derivatives of the image by the parameters at some places.
        groups : mapping of str to tuple of str, optional
        """
        moved = np.linalg.norm(slopes, axis=1)
        most = np.max(moved, axis=0, where=np.isfinite(moved), initial=0.0)
        steps = 1.0 / np.where(most > 0.0, most, 1.0)
        return cls(names, units, np.array(values), np.zeros(len(names)), steps, groups or {})

    def __len__(self) -> int:
        return len(self.names)

    def including(self, names: Sequence[str]) -> Parameters:
        """Parameters and behind them those of names that are not among them: 0, and held."""
        more = tuple(name for name in names if name not in self.names)
        zero = np.zeros(len(more))
        return replace(
            self,
            names=(*self.names, *more),
            units=(*self.units, *("",) * len(more)),
            values=np.concatenate([self.values, zero]),
            sigmas=np.concatenate([self.sigmas, zero]),
            steps=np.concatenate([self.steps, zero + 1.0]),
        )

    def with_values(self, values: FloatArray) -> Parameters:
        """Same parameters with new values (P,)."""
        return replace(self, values=np.asarray(values, dtype=np.float64))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values, which have no infinity: a free parameter's sigma is null."""
        sigmas = [None if np.isinf(sigma) else float(sigma) for sigma in self.sigmas]
        return {"values": self.values.tolist(), "sigmas": sigmas, "steps": self.steps.tolist()}

    @classmethod
    def from_dict(cls, names: tuple[str, ...], units: tuple[str, ...], state: Mapping[str, Any]) -> Parameters:
        """Parameters of a state that holds what `to_dict` gives.

        Parameters
        ----------
        names, units : tuple of str
            Of the P parameters.
        state : mapping
            Lists of P numbers; a sigma that is null is infinite.
        """
        sigmas = np.array([np.inf if sigma is None else sigma for sigma in state["sigmas"]])
        return cls(names, units, np.array(state["values"]), sigmas, np.array(state["steps"]))


@dataclass(frozen=True)
class ControlBlunder:
    """Control point of an image that contradicts the others, and took no part in its model.

    Attributes
    ----------
    id : str
    size : tuple of float
        Measured minus what the other points say, (col, row) in pixels; NaN where the model does not see the point.
    cause : str
        What may have happened; '' where nothing speaks for one cause.
    """

    id: str
    size: tuple[float, float]
    cause: str = ""

    @property
    def length(self) -> float:
        """Length of the error, pixels."""
        return math.hypot(*self.size)

    def __str__(self) -> str:
        if not math.isfinite(self.length):
            return f"point '{self.id}' is not seen by the image"
        cause = f": {self.cause}" if self.cause else ""
        return f"point '{self.id}' is off by {self.length:.3g} px{cause}"


@runtime_checkable
class SensorModel(Protocol):
    """Sensor model: a frozen map ground → image.

    Image coordinates are (col, row), (0.5, 0.5) being the centre of the upper-left pixel. A point that the model cannot
    see in principle (behind the camera) is NaN, never an exception; one bad point never spoils the others. Points that
    merely fall outside the image keep smooth, finite coordinates outside it: the lattice interpolates across the edge.
    """

    @property
    def crs(self) -> CRS:
        """Frame of xyz: geocentric or another 3-D CRS; a 2-D projected CRS where heights play no part."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image in pixels."""

    @property
    def parameters(self) -> Parameters:
        """Parameters that an adjustment may change."""

    @property
    def seed(self) -> tuple[float, float, float]:
        """A ground point near the middle of what the image shows, in `crs`; inverses start there."""

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) in `crs` to image (N, 2) in pixels."""

    def with_values(self, values: FloatArray) -> Self:
        """New model with other parameter values (P,)."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values; `from_dict` of the same class gives the model back."""

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it."""


@dataclass(frozen=True, eq=False)
class WrappedModel:
    """Base of sensor models around another one, whose size and parameters they have.

    Attributes
    ----------
    model : SensorModel
    """

    model: SensorModel

    @property
    def size(self) -> tuple[int, int]:
        """That of the wrapped model."""
        return self.model.size

    @property
    def parameters(self) -> Parameters:
        """Those of the wrapped model."""
        return self.model.parameters

    def with_values(self, values: FloatArray) -> Self:
        """Model around the wrapped one with other parameter values (P,)."""
        return replace(self, model=self.model.with_values(values))


@runtime_checkable
class HasRays(Protocol):
    """Optional power: lines of sight in closed form."""

    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to origins (N, 3) and unit directions (N, 3) to the ground, in the model's Cartesian `crs`."""


@runtime_checkable
class HasJacobian(Protocol):
    """Optional power: derivatives in closed form."""

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by parameters (N, 2, P) and by ground coordinates (N, 2, 3)."""


@runtime_checkable
class HasGroundJacobian(Protocol):
    """Optional power: derivatives by ground without those by parameters, for models of very many parameters."""

    def ground_jacobian(self, xyz: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by ground coordinates (N, 2, 3)."""


@runtime_checkable
class HasSensorPositions(Protocol):
    """Optional power: where a side-looking radar was when it imaged a ground point.

    Columns of such an image are ranges: ground points of one row and one distance from the sensor share a pixel.
    """

    def sensor_positions(self, xyz: FloatArray) -> FloatArray:
        """Positions (N, 3) of the sensor at the times ground points (N, 3) are imaged, all in the model's `crs`.

        The `crs` is geocentric (metres), so that xyz − positions are lines of sight; NaN where a point is not imaged.
        """


class Calibration(Protocol):
    """Radiometric calibration of an image: a physical quantity as a linear function of what its pixels hold."""

    @property
    def quantity(self) -> str:
        """Name of the quantity, for the bands of an output."""

    @property
    def unit(self) -> str:
        """Its unit."""

    @property
    def flattened(self) -> bool:
        """Whether it is radar brightness (beta nought), to be normalised by the area that is lit.

        What is lit is computed from the surface, for a model that tells its `HasSensorPositions`; the result is
        terrain-flattened gamma nought.
        """

    def at(self, cols: FloatArray, rows: FloatArray) -> tuple[AnyArray, AnyArray]:
        """Factor and offset (M, N) at the pixels of growing columns (N,) and rows (M,); 0.5 is the middle of the first.

        The quantity is factor · value + offset, or factor · value² + offset of amplitudes.

        Parameters
        ----------
        cols : array (N,)
        rows : array (M,)
        """


@runtime_checkable
class HasRadiometry(Protocol):
    """Optional power: what the values of an image's pixels are, as far as it matters for means of them."""

    @property
    def amplitudes(self) -> bool:
        """Whether values are amplitudes: their squares, the powers, are averaged and calibrated."""

    @property
    def calibration(self) -> Calibration | None:
        """Calibration of the pixels; None where they stay as they are."""


@runtime_checkable
class HasExterior(Protocol):
    """Optional power: the exterior orientation of a photo, as tables have it."""

    def exterior(self, crs: CRS) -> FloatArray:
        """Projection centre (x, y, z) in a 3-D CRS, and omega, phi, kappa from its grid north in degrees: (6,)."""


@runtime_checkable
class HasMotion(Protocol):
    """Optional power: the motion of a photo while its rows are exposed, as tables have it."""

    def motion(self, crs: CRS) -> FloatArray | None:
        """Velocity along the axes of a 3-D CRS, its units per second, and turn about the camera's axes (6,).

        The latter right, down and forward, degrees per second, right-handed, at the time of the exterior orientation;
        None of a photo that is exposed at once.
        """


@runtime_checkable
class HasInterior(Protocol):
    """Optional power: an interior orientation, which the images of one camera share."""

    @property
    def interior(self) -> Parameters:
        """Focal length, principal point, distortion ...; all are held (sigma 0) unless the model was given sigmas."""

    def with_interior(self, interior: Parameters) -> Self:
        """New model with other values and a-priori sigmas of the interior orientation; see `Parameters.groups`."""

    def interior_jacobian(self, xyz: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by the interior orientation (N, 2, Q), pixels per unit."""


@runtime_checkable
class HasPose(Protocol):
    """Optional power: an image with one projection centre and one attitude, which can be given another pose."""

    @property
    def pose(self) -> tuple[FloatArray, FloatArray]:
        """Projection centre (3,) in `crs`, and rotation (3, 3) from its axes to the camera's: x right, z forward."""

    def directions(self, colrow: FloatArray) -> FloatArray:
        """Image (N, 2) to unit directions (N, 3) in camera axes."""

    def posed(self, centre: FloatArray, rotation: FloatArray, ahead: FloatArray, crs: CRS | None = None) -> Self:
        """New model at a pose, as `pose` has it; `ahead` (3,) is a point it sees. All in `crs`, Cartesian, if given.

        Parameters
        ----------
        centre : array (3,)
            Projection centre, metres.
        rotation : array (3, 3)
            See `pose`.
        ahead : array (3,)
            Point that the image sees.
        crs : CRS, optional
            Cartesian CRS of all of them, that of the model unless given.
        """


@runtime_checkable
class HasCameraTable(Protocol):
    """Optional power: a camera that can be described to other programs."""

    @property
    def camera_table(self) -> Mapping[str, Any]:
        """The camera as `camera.toml` describes it, in pixels."""


@runtime_checkable
class HasCovariance(Protocol):
    """Optional power: an accuracy that the image's own data states, such as the errors in a file of RPCs."""

    @property
    def covariance(self) -> FloatArray | None:
        """Covariance (P, P) of the parameters in their units; None where the data states none."""


@runtime_checkable
class HasLeftOut(Protocol):
    """Optional power: control points that took no part in the fit of the model, as they contradict the others."""

    @property
    def left_out(self) -> tuple[ControlBlunder, ...]:
        """Points, the largest error first."""


class RationalFit(Protocol):
    """Rational polynomials fitted to a model, with their error at points that took no part in the fit."""

    @property
    def model(self) -> SensorModel:
        """The rational model."""

    @property
    def rms(self) -> float:
        """RMS distance from the model fitted to, pixels."""

    @property
    def worst(self) -> float:
        """Largest one."""

    @property
    def checks(self) -> int:
        """Number of check points."""

    @property
    def heights(self) -> tuple[float, float]:
        """Lowest and highest ellipsoidal height fitted to, metres."""


class RationalCorrection(Protocol):
    """Correction of rational models by points, some of which may have been left out."""

    @property
    def sigmas(self) -> FloatArray:
        """Standard deviations of the parameters: (P,) of one model, (K, P) of several."""

    @property
    def used(self) -> BoolArray:
        """Mask (N,) of the control or tie points that took part."""

    @property
    def rms_before(self) -> float:
        """RMS length of the residuals of the measurements used, before, pixels."""

    @property
    def rms_after(self) -> float:
        """And after."""


class RationalRefinement(RationalCorrection, Protocol):
    """A rational model corrected with control points."""

    @property
    def model(self) -> SensorModel:
        """Corrected."""

    @property
    def residuals(self) -> FloatArray:
        """Measured minus computed (N, 2), pixels."""


class RationalTieCorrection(RationalCorrection, Protocol):
    """Rational models corrected so that lines of sight of tie points meet."""

    @property
    def models(self) -> Sequence[SensorModel]:
        """Corrected."""


@runtime_checkable
class HasRational(Protocol):
    """A plugin whose models are rational polynomials."""

    kinds: Mapping[str, int]
    """Corrections it knows, and how many control points each needs."""

    def fit_rational(self, model: SensorModel, heights: tuple[float, float]) -> RationalFit:
        """RPC fitted to any model with heights, between two ellipsoidal heights in metres."""

    def rewrite_rational(self, model: Any) -> RationalFit | None:
        """RPC fitted again where no format has a place for its correction, such as drift; None where none is needed."""

    def refine_rational(
        self,
        model: Any,
        xyz: FloatArray,
        colrow: FloatArray,
        kind: str,
        sigmas_px: FloatArray | None,
        ids: Sequence[str],
    ) -> RationalRefinement:
        """RPC corrected by control points: (N, 3) in `model.crs`, (N, 2) pixels; wrong ones are left out.

        Parameters
        ----------
        model : object
        xyz : array (N, 3)
            Ground in `model.crs`.
        colrow : array (N, 2)
            Pixels.
        kind : str
            Correction, such as 'shift' or 'affine'.
        sigmas_px : array (N,) or None
            Standard deviations of the points in pixels.
        ids : sequence of str (N,)
            Names of the points.
        """

    def correct_rational_by_ties(
        self,
        models: Sequence[Any],
        image: IntArray,
        point: IntArray,
        colrow: FloatArray,
        kind: str,
        sigma_px: float,
        fixed: Sequence[int],
    ) -> RationalTieCorrection:
        """RPCs corrected by tie points: image (M,) and point (M,) of each measurement, colrow (M, 2).

        Parameters
        ----------
        models : sequence of object
            RPC models.
        image, point : int array (M,)
            Numbers of the image and of the point of each measurement.
        colrow : array (M, 2)
            Pixels.
        kind : str
            Correction, such as 'shift' or 'affine'.
        sigma_px : float
            Standard deviation of the measurements in pixels.
        fixed : sequence of int
            Numbers of the models that keep their RPC.
        """

    def rational_tags(self, model: Any) -> dict[str, str]:
        """GDAL's RPC domain of a rational model."""

    def rational_text(self, model: Any) -> str:
        """Text of its _RPC.TXT file."""


@dataclass(frozen=True, eq=False)
class SensorInput:
    """Input of a plugin, for `geomosaic sensors NAME` and for error messages.

    Attributes
    ----------
    name : str
        Key under [sensor] of a project, and of `SensorRequest.options`.
    text : str
        What it is, in a few words.
    unit : str
    default : str, optional
        Value where none is given, in words.
    """

    name: str
    text: str
    unit: str = ""
    default: str | None = None


# Inputs that several sensors have.
RAY_CORRECTIONS = (
    SensorInput(
        "refraction",
        "true corrects the refraction of the standard atmosphere, for a ground at ground_height; a number is the "
        "constant K, the angle at 45° from the nadir, in µrad",
        default="false",
    ),
    SensorInput(
        "curvature",
        "true corrects the curvature of the Earth in the planar treatment, for a ground at ground_height",
        default="false",
    ),
)
CONTROL_POINTS = SensorInput(
    "points",
    "control points, each with x, y, z, col, row and optionally id and sigma (pixels, default 1), in the declared "
    "CRS; in a project those of [control]",
)


class ControlUse(Enum):
    """Use that a sensor makes of the control points of an image."""

    CHECK = "check"
    """None: they serve as check points."""
    RESECTION = "resection"
    """They take the place of an orientation, as the input `points`, where no orientation is given."""
    ADJUSTMENT = "adjustment"
    """They correct the model, as the input `points`, unless the input `refine` is 'none'."""


@dataclass(frozen=True, kw_only=True)
class Capabilities:
    """Capabilities of a sensor: what the program may hand to it, and what the user has to be asked for.

    A capability names inputs of the plugin by names that are the same for all sensors (in backticks below). The program
    fills them in from the tables and files of a project; the plugin lists them among its inputs.

    Attributes
    ----------
    planar : bool
        Heights play no part: the CRS of the models is a horizontal one, and no DEM or vertical datum is asked for. The
        image is placed by `points`, its control points, or else by `transform`, the geotransform that it carries.
    placements : tuple of str
        Inputs of which each places the image by itself: where the user gives one, no positions are asked for, and a
        planar sensor has nothing filled in.
    plane_transformations : bool
        The input `kind` chooses among the plane transformations conformal, affine, projective, polynomial (of `order`
        1 to 5) and tps, fitted to `points` or given by `coefficients`. The first such sensor fits the transformations
        of georeferencing and of planar blocks, and takes georeferenced images for which no sensor is named.
    exterior : tuple of str
        Of `position`, `orientation`, `angle_unit` and `velocity`: what it takes of a row of the exterior orientation
        table; a `velocity`, units of the CRS per second, comes among `orientation`, where the table tells it or times,
        and with it `rates`, degrees per second about the camera's axes right, down, forward, where it tells them.
    needs_exterior : bool
        There is no model without an exterior orientation, by such a table or by control points.
    needs_camera : bool
        There is no model without `camera`, the description of the camera. The first sensor that needs both a camera and
        an exterior orientation is proposed for photos with a position in their EXIF.
    control : ControlUse
        Use of control points.
    ground_height : bool
        `ground_height`, the mean height of the ground in the vertical datum of the positions, is filled in from the DEM
        below the camera unless the user gives it.
    upwards : bool
        `upwards` = true allows views level or above the horizon.
    relative : bool
        `relative` = true makes a model without a place, in relative metres, from nominal numbers alone.
    unoriented : bool
        `unoriented` = true makes a model (`HasPose`) that knows its camera alone, to be oriented with a block.
    embedded : bool
        An image, or files beside it, can carry the whole model: the sensor is tried on images for which none is named.
    """

    planar: bool = False
    placements: tuple[str, ...] = ()
    plane_transformations: bool = False
    exterior: tuple[str, ...] = ()
    needs_exterior: bool = False
    needs_camera: bool = False
    control: ControlUse = ControlUse.CHECK
    ground_height: bool = False
    upwards: bool = False
    relative: bool = False
    unoriented: bool = False
    embedded: bool = False

    @property
    def carries_placement(self) -> bool:
        """Whether models are placed by what comes with the image, so that no CRS of positions has to be named."""
        return not self.planar and not self.needs_exterior

    @property
    def standard_inputs(self) -> frozenset[str]:
        """Inputs that the plugin must list for these capabilities."""
        named = {
            "camera": self.needs_camera,
            "points": self.control is not ControlUse.CHECK or self.planar,
            "refine": self.control is ControlUse.ADJUSTMENT,
            "transform": self.planar,
            "kind": self.plane_transformations,
            "order": self.plane_transformations,
            "coefficients": self.plane_transformations,
            "ground_height": self.ground_height,
            "upwards": self.upwards,
            "relative": self.relative,
            "unoriented": self.unoriented,
        }
        return frozenset(name for name, wanted in named.items() if wanted) | {*self.exterior, *self.placements}


@dataclass(frozen=True, eq=False)
class SensorExample:
    """Example of a sensor for `geomosaic sensors NAME`: it runs as it is shown, with any image of that size.

    Attributes
    ----------
    size : tuple of int
        Width and height of the image in pixels.
    project : str
        Sections of a project file without [project]: [sensor] and what it needs.
    files : mapping of str to str
        Files that it names, beside the project: name to text.
    """

    size: tuple[int, int]
    project: str
    files: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class SensorRequest:
    """Request for the model of one image: everything that is known about it.

    Attributes
    ----------
    image : str
        The image's name, for messages.
    size : tuple of int
        Width and height in pixels.
    options : mapping
        The plugin's own inputs: numbers, strings, lists and nested mappings, as TOML has them.
    crs : CRS, optional
        3-D (or 2-D, for models without heights) CRS in which positions in `options` are given.
    base : str
        Folder that relative file names in `options` start from.
    path : str, optional
        The image's own file, for sensors that read what it carries or what lies beside it.
    """

    image: str
    size: tuple[int, int]
    options: Mapping[str, Any] = field(default_factory=dict)
    crs: CRS | None = None
    base: str = "."
    path: str | None = None


class SensorPlugin(Protocol):
    """Sensor plugin, as found through the entry point group 'geomosaic.sensors'.

    Attributes
    ----------
    name : str
        One word, the same as that of the entry point.
    summary : str
        One line.
    inputs : tuple of SensorInput
    capabilities : Capabilities
    model : type
        Class of the models, with `from_dict`.
    """

    name: str
    summary: str
    inputs: tuple[SensorInput, ...]
    capabilities: Capabilities
    model: type[SensorModel]

    def build(self, request: SensorRequest) -> SensorModel:
        """Model of one image.

        Raises
        ------
        SensorInputError
            An input is missing, unknown or out of range; the error knows the image and the input.
        """


@runtime_checkable
class HasExample(Protocol):
    """Optional power of a plugin: an example that runs."""

    example: SensorExample


@runtime_checkable
class HasCameraCheck(Protocol):
    """Optional power of a plugin that takes a `camera`: the keys of its description, checked before any image is."""

    def check_camera(self, camera: Mapping[str, Any], where: str) -> None:
        """Check of the keys of a camera description.

        Parameters
        ----------
        camera : mapping
            As a camera file has it.
        where : str
            Named in errors.

        Raises
        ------
        SensorInputError
            Names an unknown key, and the nearest one that exists.
        """


@runtime_checkable
class HasFiles(Protocol):
    """Optional power of a plugin: the files beside an image that its model comes from, so that changes are noticed."""

    def files(self, path: Path) -> tuple[Path, ...]:
        """Files that belong to an image, or to a file named for it, by their names, as far as they are there."""
