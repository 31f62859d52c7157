"""What may stand in a project file; pydantic checks it at this edge and nowhere further in."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, get_args, get_origin

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, create_model, model_validator

from geomosaic.options.declaration import Declared, Option, declared, is_part
from geomosaic.options.mosaic import MosaicOptions, Width


def _plain_path(text: str) -> str:
    """Refuse names that GDAL would open as something other than a file on this machine."""
    if not text.strip():
        raise ValueError("the path is empty")
    if "\0" in text or "://" in text or text.lstrip().startswith(("/vsi", "\\vsi", "<")):
        raise ValueError(f"'{text[:60]}' is not the path of a file")
    return text


def _width(text: str) -> str:
    """Refuse what is no width with a unit."""
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
    """A table of the project file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)


class ProjectSection(Section):
    """[project]."""

    name: str = Field("mosaic", min_length=1, max_length=100, pattern=r"^[^/\\\x00-\x1f]+$")
    images: list[FilePath] = Field(min_length=1)
    nodata: float | None = None
    bands: Annotated[tuple[Band, ...], Field(min_length=1)] | None = None
    margin: Pixels | tuple[Pixels, Pixels, Pixels, Pixels] | None = None
    usable: FilePath | None = None


class SensorSection(BaseModel):
    """[sensor]: name, camera, corrections and fiducials; every other key is an input of the plugin, which checks it."""

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
    """[exterior.printed]: how a printed list is to be read."""

    columns: list[str] = Field(min_length=4)
    axes: str
    sequence: list[Literal["omega", "phi", "kappa"]] = Field(default_factory=list)
    lines: Annotated[int, Field(ge=1, le=20)] = 1
    skip: Annotated[int, Field(ge=0)] = 0


class ExteriorSection(Section):
    """[exterior]."""

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
    """[dem]: a file or a constant height."""

    file: FilePath | None = None
    height: Finite | None = None
    heights: str | None = None

    @model_validator(mode="after")
    def _one(self) -> DemSection:
        if (self.file is None) == (self.height is None):
            raise ValueError("give either file or height")
        return self


class ControlSection(Section):
    """[control]."""

    file: FilePath


class PlanarSection(Section):
    """[planar]: photos of flat ground placed together by plane transformations."""

    kind: Literal["uncontrolled", "semicontrolled", "controlled", "grown"]
    model: Literal["conformal", "affine", "projective"] | None = None
    ties: FilePath | None = None
    scale: Positive = 1.0
    azimuth: Finite = 0.0
    rectify: Literal["singly", "together"] | None = None
    robust: bool = False
    insist: bool = False


class OutputFields(Section):
    """[output] without the options of rendering."""

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
    """[quality]: thresholds, and a reference image to compare with."""

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
    """The whole file."""

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
