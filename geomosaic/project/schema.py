"""Schema of project files: sections and keys with their types; pydantic checks it here and nowhere further in."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, get_args, get_origin

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, create_model, model_validator

from geomosaic.errors import InputError
from geomosaic.options.adjustment import AdjustmentOptions
from geomosaic.options.check import check_limits
from geomosaic.options.declaration import Declared, Option, declared, is_part
from geomosaic.options.inputs import Area, BlockInputs, QualityLimits
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.tie_points import TiePointOptions
from geomosaic.stores.addresses import accept, is_address


def _plain_path(text: str) -> str:
    """Path of a file on this machine, or address of an object that opens without anything secret in it."""
    if is_address(text):
        if re.search(r"[?]|//[^/]*@", text):
            raise ValueError(
                "a signature or password in an address does not belong into a project file: "
                "set the variables of the store's credentials"
            )
        try:
            return accept(text)
        except InputError as error:
            raise ValueError(f"{error.what}: {error.hint}") from None
    # GDAL would take other names for addresses, archives or XML descriptions, and read what the project does not name.
    if not text.strip():
        raise ValueError("the path is empty")
    if "\0" in text or "://" in text or text.lstrip().startswith(("/vsi", "\\vsi", "<")):
        raise ValueError(f"'{text[:60]}' is not the path of a file")
    return text


FilePath = Annotated[str, AfterValidator(_plain_path)]


def _limited(option: Option) -> AfterValidator:
    """Check of a value against the choices and limits of an option."""

    def check(value: Any) -> Any:
        try:
            check_limits(value, option, "")
        except InputError as error:
            raise ValueError(f"{error.what}: {error.hint}") from None
        return value

    return AfterValidator(check)


class Section(BaseModel):
    """Table of a project file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)


class ProjectFields(Section):
    """[project] without declared options: name of the outputs, images and which of them are set aside, remarks."""

    name: str = Field("mosaic", min_length=1, max_length=100, pattern=r"^[^/\\\x00-\x1f]+$")
    images: list[FilePath] = Field(default_factory=list)  # tables [[images]] may name all
    set_aside: list[str] = Field(default_factory=list)  # names of image files
    notes: list[str] = Field(default_factory=list)


class SensorInputs(BaseModel):
    """Table whose undeclared keys are inputs of the plugin, which checks them."""

    model_config = ConfigDict(extra="allow", frozen=True)

    @property
    def options(self) -> dict[str, Any]:
        """Inputs of the plugin."""
        return dict(self.model_extra or {})


class SensorFields(SensorInputs):
    """[sensor] without declared options."""

    name: str


class ImageFields(SensorInputs):
    """[[images]] without declared options: images with inputs of their own, or with a sensor of their own."""

    path: Annotated[list[FilePath], BeforeValidator(lambda given: [given] if isinstance(given, str) else given)]
    sensor: str | None = None
    camera: FilePath | None = None

    @model_validator(mode="after")
    def _belongs_to_a_sensor(self) -> ImageFields:
        plain = {"path", "sensor", "camera", *self.options}
        alone = sorted(self.model_fields_set - plain) if self.sensor is None else []
        if alone:
            raise ValueError(f"{alone[0]} needs a sensor of these images' own: sensor = ...")
        return self


class ExteriorFields(Section):
    """[exterior]: a layout of a printed list is for printed angles."""

    @model_validator(mode="after")
    def _printed_belongs(self) -> ExteriorFields:
        if (getattr(self, "angles", "") == "printed") != (getattr(self, "printed", None) is not None):
            raise ValueError("angles = 'printed' and the table [exterior.printed] belong together")
        return self


class DemFields(Section):
    """[dem]: a file, a constant height, or tie points."""

    @model_validator(mode="after")
    def _one(self) -> DemFields:
        given = [name for name in ("file", "height") if getattr(self, name, None) is not None]
        given += ["from_tie_points"] if getattr(self, "from_tie_points", False) else []
        # A height beside tie points is the ground on which a reference is searched for control points.
        if len(given) != 1 and given != ["height", "from_tie_points"]:
            raise ValueError("give one of file, height and from_tie_points = true, or the last two together")
        if given == ["from_tie_points"] and getattr(self, "heights", None) is not None:
            raise ValueError("heights from tie points count from the datum of the positions: leave out heights")
        return self


class ControlFields(Section):
    """[control]: table of control and check points."""

    file: FilePath


class OutputFields(Section):
    """[output] without declared options: folder of the outputs, and whether an ortho of each image is written too."""

    folder: FilePath = "output"
    orthos: bool = False


def _tile_address(text: str) -> str:
    """Address of tiles, with {z}, {x} and {y}."""
    # The host enters a header of the studio's answers: nothing but a host may stand there.
    if not re.fullmatch(r"(https://[A-Za-z0-9.-]+|http://(127\.0\.0\.1|localhost))(:\d+)?/[^\s\"'<>;,]*", text):
        raise ValueError("give an address that begins with https:// and a host")
    if lost := [mark for mark in ("{z}", "{x}", "{y}") if mark not in text]:
        raise ValueError(
            f"the address has no {', '.join(lost)}, such as https://tiles.example.org/{{z}}/{{x}}/{{y}}.png"
        )
    return text


class StudioFields(Section):
    """[studio]: what the page shows beside the project; no step depends on it."""

    base_map: Annotated[str, AfterValidator(_tile_address)] | None = None
    base_map_notice: Annotated[str, Field(max_length=200)] = ""
    base_map_zoom: Annotated[int, _limited(Option(least=0, most=24))] = 19


def _section_of(title: str, options: Iterable[Declared], base: type[BaseModel] = Section) -> type[Any]:
    """Section of the project file whose keys are declared options."""
    keys: dict[str, Any] = {}
    for one in options:
        if one.key in base.model_fields:  # as the file must have it
            continue
        kind, default = _kind(one), _default(one)
        if default is MISSING:
            keys[one.key] = (kind, ...)
        elif default is None:
            keys[one.key] = (kind | None, None)
        elif is_part(one.kind):
            keys[one.key] = (kind, Field(default_factory=kind))
        else:
            keys[one.key] = (kind, Field(default_factory=type(default)) if default in ({}, []) else default)
    made: type[Any] = create_model(title, __base__=base, **keys)
    return made


def _kind(one: Declared) -> Any:
    """Type of an option in a project file."""
    option, kind = one.option, one.kind
    if option.parse is not None:
        return _as_written(option.parse)
    if option.files:
        return FilePath if "" in option.files else str
    if is_part(kind):
        return _section_of(one.key, declared(kind))
    if get_origin(kind) is tuple:
        many: Any = list[_scalar(get_args(kind)[0], option)]  # type: ignore[misc]
        # Where all is the default, an empty list would say the contrary of what it looks like.
        return Annotated[many, Field(min_length=1)] if one.default is None else many
    if get_origin(kind) is Mapping:
        value = get_args(kind)[1]
        return dict[str, _section_of(one.key, declared(value)) if is_part(value) else str | int]  # type: ignore[misc]
    return _scalar(kind, option)


def _as_written(parse: Callable[[Any], Any]) -> Any:
    """Type of a value that the option reads itself: as the file has it, checked."""

    def check(value: Any) -> Any:
        try:
            parse(value)
        except InputError as error:
            raise ValueError(f"{error.what}: {error.hint}") from None
        except (TypeError, AttributeError):  # another kind of value than the option's
            raise ValueError(f"{value!r} is no value of this key") from None
        return value

    return Annotated[Any, AfterValidator(check)]


def _scalar(kind: Any, option: Option) -> Any:
    """Type of one value, with its limits and choices."""
    return FilePath if kind is Path else Annotated[kind, _limited(option)]


def _default(one: Declared) -> Any:
    """Default of an option as a project file has it."""
    if get_origin(one.kind) is Mapping:
        return {}
    if isinstance(one.default, tuple):
        return ",".join(one.default) if one.option.parse is not None else []
    return one.default


# Options of projects, each in its section.
KINDS = (BlockInputs, TiePointOptions, AdjustmentOptions, Area, MosaicOptions, QualityLimits)
DECLARED = tuple(one for kind in KINDS for one in declared(kind))


if TYPE_CHECKING:
    ProjectSection: TypeAlias = ProjectFields
    SensorSection: TypeAlias = SensorFields
    ImageSection: TypeAlias = ImageFields
    OutputSection: TypeAlias = OutputFields
    ExteriorSection: TypeAlias = Section
    DemSection: TypeAlias = Section
    ControlSection: TypeAlias = ControlFields
    PlanarSection: TypeAlias = Section
    MatchSection: TypeAlias = Section
    AdjustSection: TypeAlias = Section
    MosaicSection: TypeAlias = Section
    QualitySection: TypeAlias = Section
else:
    _BASES = {
        "project": ProjectFields, "sensor": SensorFields, "exterior": ExteriorFields, "dem": DemFields,
        "control": ControlFields, "planar": Section, "match": Section, "adjust": Section, "output": OutputFields,
        "mosaic": Section, "quality": Section,
    }  # fmt: skip
    _SECTIONS = {
        name: _section_of(f"[{name}]", [one for one in DECLARED if one.option.section == name], base)
        for name, base in _BASES.items()
    }
    ProjectSection, SensorSection = _SECTIONS["project"], _SECTIONS["sensor"]
    ExteriorSection, DemSection = _SECTIONS["exterior"], _SECTIONS["dem"]
    ControlSection, PlanarSection = _SECTIONS["control"], _SECTIONS["planar"]
    MatchSection, AdjustSection = _SECTIONS["match"], _SECTIONS["adjust"]
    _OF_IMAGES = [one for one in DECLARED if one.option.section in ("sensor", "project") and one.name != "sensor"]
    ImageSection = create_model(
        "[[images]]",
        __base__=_section_of("[[images]]", _OF_IMAGES, ImageFields),
        exterior=(ExteriorSection | None, None),
        control=(ControlSection | None, None),
    )
    OutputSection, MosaicSection, QualitySection = _SECTIONS["output"], _SECTIONS["mosaic"], _SECTIONS["quality"]


class ProjectFile(Section):
    """Whole project file.

    Attributes
    ----------
    format : int
        1.
    project, sensor, exterior, output, mosaic, quality, studio
        Sections that are always there, with defaults but for the first two.
    images : list
        Tables of images with inputs or a sensor of their own.
    dem, control, planar, match, adjust
        Sections that may be missing.
    """

    format: Literal[1]
    project: ProjectSection
    sensor: SensorSection
    images: list[ImageSection] = Field(default_factory=list)
    exterior: ExteriorSection = Field(default_factory=ExteriorSection)
    dem: DemSection | None = None
    control: ControlSection | None = None
    planar: PlanarSection | None = None
    match: MatchSection | None = None
    adjust: AdjustSection | None = None
    output: OutputSection = Field(default_factory=OutputSection)
    mosaic: MosaicSection = Field(default_factory=MosaicSection)
    quality: QualitySection = Field(default_factory=QualitySection)
    studio: StudioFields = StudioFields()
