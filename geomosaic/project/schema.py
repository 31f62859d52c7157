"""What may stand in a project file; pydantic checks it at this edge and nowhere further in."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator


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
    from geomosaic.options.mosaic import Width

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
    def _told(self) -> ExteriorSection:
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


class OutputSection(Section):
    """[output]."""

    folder: FilePath = "output"
    crs: str | None = None
    resolution: Positive | None = None
    bounds: tuple[Finite, Finite, Finite, Finite] | None = None
    resampling: Literal["nearest", "bilinear", "cubic", "lanczos", "average"] = "bilinear"
    tolerance: Pixels = 0.02
    driver: Literal["COG", "GTiff"] = "COG"
    creation: dict[str, str | int] = Field(default_factory=dict)
    nodata: float | None = None
    orthos: bool = False


Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Part = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class SeamWeightsSection(Section):
    """[mosaic.seam_weights]: what is not given has its default, see `seam.cost.SeamWeights`."""

    length: Positive | None = None
    colour: Weight | None = None
    gradient: Weight | None = None
    texture: Weight | None = None
    angle: Weight | None = None
    edge: Weight | None = None
    heights: Weight | None = None
    avoid: Weight | None = None
    follow: Part | None = None
    reach: Part | None = None


class RetouchSection(Section):
    """[mosaic.retouch."photo_07.jpg"]: a change of one photo's colour after the balance."""

    gain: Positive = 1.0
    offset: Finite = 0.0


class MosaicSection(Section):
    """[mosaic]."""

    feather: Annotated[float, Field(ge=0, allow_inf_nan=False)] | WidthText | None = None
    blend: Literal["feather", "overlap", "multiband", "none"] = "feather"
    ramp: Literal["linear", "smooth"] = "linear"
    limit: bool | None = None
    order: Literal["list", "name", "resolution", "date"] = "list"
    base: str | None = None
    rule: Literal["first", "last", "min", "max", "mean", "median", "sum", "count"] | None = None
    water: FilePath | None = None
    water_fill: Literal["calmest", "tone"] = "calmest"
    balance: bool | None = None
    colour: str = "auto"
    mask: FilePath | None = None
    histogram: Literal["overlap", "whole", "sequence"] | None = None
    region: FilePath | None = None
    master: str | None = None
    reference: FilePath | None = None
    reference_bands: list[int] | None = None
    stretch: str | None = None
    labels: bool = True
    seams: Literal["nearest", "halve", "alike", "order"] = "nearest"
    seam_weights: SeamWeightsSection = Field(default_factory=lambda: SeamWeightsSection())
    follow: list[FilePath] = Field(default_factory=list)
    avoid: list[FilePath] = Field(default_factory=list)
    cutlines: FilePath | None = None
    seam_quality: bool | None = None
    views: bool = False
    displacement: Finite | None = None
    exclude: list[str] = Field(default_factory=list)
    retouch: dict[str, RetouchSection] = Field(default_factory=dict)
    true_ortho: bool = False


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
