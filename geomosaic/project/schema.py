"""Schema of project files: sections and keys with their types; pydantic checks it here and nowhere further in."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, get_args, get_origin

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, create_model, model_validator

from geomosaic.options.declaration import Declared, Option, declared, is_part
from geomosaic.options.mosaic import MosaicOptions, Width


def _plain_path(text: str) -> str:
    """Path of a file on this machine.

    GDAL would take other names for addresses, archives or XML descriptions, and read what the project does not name.
    """
    if not text.strip():
        raise ValueError("the path is empty")
    if "\0" in text or "://" in text or text.lstrip().startswith(("/vsi", "\\vsi", "<")):
        raise ValueError(f"'{text[:60]}' is not the path of a file")
    return text


def _width(text: str) -> str:
    """Text of a width with a unit."""
    from geomosaic.errors import InputError

    try:
        Width.parse(text)
    except InputError as error:
        raise ValueError(f"{error.what}: {error.hint}") from None
    return text


FilePath = Annotated[str, AfterValidator(_plain_path)]
WidthText = Annotated[str, AfterValidator(_width)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Band = Annotated[int, Field(ge=1)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


Pixels = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Section(BaseModel):
    """Table of a project file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)


class ProjectSection(Section):
    """[project]: the images, and what counts for all of them.

    Attributes
    ----------
    name : str
        Of the outputs.
    images : list of str
        Paths or patterns.
    nodata : float, optional
        Value of missing pixels, in place of what the files say.
    bands : tuple of int, optional
        Counted from 1; all unless given.
    margin : float or tuple of float, optional
        Pixels left out at all sides, or at left, top, right, bottom.
    usable : str, optional
        Table of polygons in image coordinates, beyond which images are not used.
    """

    name: str = Field("mosaic", min_length=1, max_length=100, pattern=r"^[^/\\\x00-\x1f]+$")
    images: list[FilePath] = Field(min_length=1)
    nodata: float | None = None
    bands: Annotated[tuple[Band, ...], Field(min_length=1)] | None = None
    margin: Pixels | tuple[Pixels, Pixels, Pixels, Pixels] | None = None
    usable: FilePath | None = None


class SensorSection(BaseModel):
    """[sensor]: the sensor and its calibration; every other key is an input of the plugin, which checks it.

    Attributes
    ----------
    name : str
    camera : str, optional
        Camera file (TOML).
    corrections : str, optional
        File of a correction grid; '{image}' in it takes the name of each image.
    fiducials : str, optional
        Table of measured fiducial marks.
    """

    model_config = ConfigDict(extra="allow", frozen=True)

    name: str
    camera: FilePath | None = None
    corrections: FilePath | None = None
    fiducials: FilePath | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Inputs of the plugin."""
        return dict(self.model_extra or {})


class PrintedSection(Section):
    """[exterior.printed]: layout of a printed list of orientations, see `geomosaic.inputs.printed_orientation`.

    Attributes
    ----------
    columns : list of str
        In the order of the list.
    axes : str
    sequence : list of str
        Rotations in their order.
    lines : int
        Lines of one image.
    skip : int
        Lines at the top that are left out.
    """

    columns: list[str] = Field(min_length=4)
    axes: str
    sequence: list[Literal["omega", "phi", "kappa"]] = Field(default_factory=list)
    lines: Annotated[int, Field(ge=1, le=20)] = 1
    skip: Annotated[int, Field(ge=0)] = 0


class ExteriorSection(Section):
    """[exterior]: exterior orientation of the images, and the frame of positions and control.

    Attributes
    ----------
    file : str, optional
        Table or reconstruction.
    crs : str, optional
        Of the positions and the control points.
    heights : str, optional
        Their vertical datum.
    angles : str
        Angle system.
    angle_unit : str, optional
    angle_frame : str, optional
        Whether angles count in the map's grid or in a local level frame.
    matrix : str, optional
        Direction of rotation matrices.
    trusted : bool
        Do not look whether the orientation is plausible.
    printed : PrintedSection, optional
        With angles = 'printed'.
    """

    file: FilePath | None = None
    crs: str | None = None
    heights: str | None = None
    angles: str = "opk"
    angle_unit: Literal["deg", "gon", "rad"] | None = None
    angle_frame: Literal["grid", "local"] | None = None
    matrix: Literal["ground_to_image", "image_to_ground"] | None = None
    trusted: bool = False
    printed: PrintedSection | None = None

    @model_validator(mode="after")
    def _printed_belongs(self) -> ExteriorSection:
        if (self.angles == "printed") != (self.printed is not None):
            raise ValueError("angles = 'printed' and the table [exterior.printed] belong together")
        return self


class DemSection(Section):
    """[dem]: a file or a constant height.

    Attributes
    ----------
    file : str, optional
    height : float, optional
        Metres.
    heights : str, optional
        Vertical datum; overrides what the file says.
    """

    file: FilePath | None = None
    height: Finite | None = None
    heights: str | None = None

    @model_validator(mode="after")
    def _one(self) -> DemSection:
        if (self.file is None) == (self.height is None):
            raise ValueError("give either file or height")
        return self


class ControlSection(Section):
    """[control]: table of control and check points.

    Attributes
    ----------
    file : str
    """

    file: FilePath


class PlanarSection(Section):
    """[planar]: photos of flat ground placed together by plane transformations.

    Attributes
    ----------
    kind : str
        'uncontrolled', 'semicontrolled', 'controlled' or 'grown'.
    model : str, optional
        'conformal', 'affine' or 'projective'; as is usual for the kind unless given.
    ties : str, optional
        Table of tie points.
    scale : float
        Map units per pixel of the photo that an uncontrolled mosaic starts with.
    azimuth : float
        Direction of its top, degrees clockwise from the map's north.
    rectify : str, optional
        'singly' or 'together', for controlled mosaics.
    robust, insist : bool
        Leave out points that contradict the others, or go on with them.
    """

    kind: Literal["uncontrolled", "semicontrolled", "controlled", "grown"]
    model: Literal["conformal", "affine", "projective"] | None = None
    ties: FilePath | None = None
    scale: Positive = 1.0
    azimuth: Finite = 0.0
    rectify: Literal["singly", "together"] | None = None
    robust: bool = False
    insist: bool = False


class OutputFields(Section):
    """[output] without the options of rendering: place of the outputs on disk and on the map.

    Attributes
    ----------
    folder : str
    crs : str, optional
    resolution : float, optional
        Map units.
    bounds : tuple of float, optional
        Left, bottom, right, top in map units.
    orthos : bool
        Write an ortho of each image too.
    """

    folder: FilePath = "output"
    crs: str | None = None
    resolution: Positive | None = None
    bounds: tuple[Finite, Finite, Finite, Finite] | None = None
    orthos: bool = False


def section_of(title: str, options: Iterable[Declared], base: type[Section] = Section) -> type[Any]:
    """Section of the project file whose keys are declared options.

    Parameters
    ----------
    title : str
        As written, such as '[output]'.
    options : iterable of Declared
    base : type
        Section with further keys.

    Returns
    -------
    type
        Pydantic model derived from `base`.
    """
    keys: dict[str, Any] = {}
    for one in options:
        kind, default = _kind(one), _default(one)
        if default is None:
            kind = kind | None
        if is_part(one.kind):
            keys[one.key] = (kind, Field(default_factory=kind))
        else:
            keys[one.key] = (kind, Field(default_factory=type(default)) if default in ({}, []) else default)
    made: type[Any] = create_model(title, __base__=base, **keys)
    return made


def _kind(one: Declared) -> Any:
    """Type of an option in a project file."""
    option, kind = one.option, one.kind
    if kind is Width:
        return Pixels | WidthText
    if option.parse is not None or kind is str:
        return Literal[option.choices] if option.choices else str
    if is_part(kind):
        return section_of(one.key, declared(kind))
    if get_origin(kind) is tuple:
        return list[_scalar(get_args(kind)[0], option)]  # type: ignore[misc]
    if get_origin(kind) is Mapping:
        value = get_args(kind)[1]
        return dict[str, section_of(one.key, declared(value)) if is_part(value) else str | int]  # type: ignore[misc]
    return _scalar(kind, option)


def _scalar(kind: Any, option: Option) -> Any:
    """Type of one value, with its limits."""
    if kind is Path:
        return FilePath
    if kind not in (int, float):
        return kind
    limits = {"gt": option.above, "ge": option.least, "le": option.most}
    finite: dict[str, Any] = {name: limit for name, limit in limits.items() if math.isfinite(limit)}
    return Annotated[kind, Field(allow_inf_nan=False, **finite) if kind is float else Field(**finite)]


def _default(one: Declared) -> Any:
    """Default of an option as a project file has it."""
    if get_origin(one.kind) is Mapping:
        return {}
    if isinstance(one.default, tuple):
        return ",".join(one.default) if one.option.parse is not None else []
    return one.default


def _options(section: str) -> list[Declared]:
    return [one for one in declared(MosaicOptions) if one.option.section == section]


if TYPE_CHECKING:
    OutputSection: TypeAlias = OutputFields
    MosaicSection: TypeAlias = Section
else:
    OutputSection = section_of("[output]", _options("output"), OutputFields)
    MosaicSection = section_of("[mosaic]", _options("mosaic"))


class QualitySection(Section):
    """[quality]: limits of accuracy, and a reference image to compare with.

    Attributes
    ----------
    max_control_rms_px, max_check_rms_px : float, optional
        RMS length of residuals, image pixels.
    max_lattice_error_px : float, optional
        Interpolation of the geometry, image pixels.
    max_seam_mismatch_px : float, optional
        Pixels of the mosaic.
    max_registration_px : float, optional
        RMS of shifts against the reference, pixels of the reference.
    reference : str, optional
        Georeferenced raster.
    """

    max_control_rms_px: Positive | None = None
    max_check_rms_px: Positive | None = None
    max_lattice_error_px: Positive | None = None
    max_seam_mismatch_px: Positive | None = None
    max_registration_px: Positive | None = None
    reference: FilePath | None = None

    @model_validator(mode="after")
    def _judged(self) -> QualitySection:
        if self.max_registration_px is not None and self.reference is None:
            raise ValueError("max_registration_px needs a reference to compare with")
        return self


class ProjectFile(Section):
    """Whole project file.

    Attributes
    ----------
    format : int
        1.
    project, sensor, exterior, output, mosaic, quality
        Sections that are always there, with defaults but for the first two.
    dem, control, planar
        Sections that may be missing.
    """

    format: Literal[1]
    project: ProjectSection
    sensor: SensorSection
    exterior: ExteriorSection = Field(default_factory=ExteriorSection)
    dem: DemSection | None = None
    control: ControlSection | None = None
    planar: PlanarSection | None = None
    output: OutputSection = Field(default_factory=OutputSection)
    mosaic: MosaicSection = Field(default_factory=MosaicSection)
    quality: QualitySection = Field(default_factory=QualitySection)
