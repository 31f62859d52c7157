"""Options of mosaics: colour, seams, blending, rules, samples and records."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from geomosaic.errors import InputError, did_you_mean
from geomosaic.options.check import CheckedOptions, check_idle, is_given
from geomosaic.options.declaration import compose, flat_values, named_only, option
from geomosaic.options.inputs import Area, EdgeOptions
from geomosaic.options.render import RenderOptions, SampleOptions, UncertaintyOptions

if TYPE_CHECKING:
    from geomosaic.types import Progress

# What the balance can solve; gain and offset are always.
TERMS = ("gain", "vignetting", "trend", "hotspot", "haze", "gamma", "dodging")
RULES = ("first", "last", "min", "max", "mean", "median", "sum", "count")
# Rules under which every pixel has one source image.
SINGLE_SOURCE_RULES = RULES[:2]
# These look at every image, in whatever order.
_UNORDERED = tuple(f"rule={rule}" for rule in RULES[2:])
ORDERS = ("list", "name", "sensor", "resolution", "date", "oldest", "day", "season", "cloud")


def _parse_terms(text: Any) -> tuple[str, ...]:
    """Terms of the colour balance."""
    words = text.split(",") if isinstance(text, str) else text
    terms = tuple(str(word).strip().lower() for word in words if str(word).strip())
    wrong = sorted(set(terms) - set(TERMS)) if terms != ("auto",) else []
    if wrong or not terms:
        hint = did_you_mean(wrong[0], TERMS) if wrong else ""
        raise InputError(
            f"colour has no term '{', '.join(wrong)}'", hint=f"{hint} auto, or some of {', '.join(TERMS)}".strip()
        )
    return terms


def _parse_order(text: Any) -> tuple[str, ...]:
    """Criteria of precedence, the most important first."""
    words = text.split(",") if isinstance(text, str) else text
    names = tuple(str(word).strip().lower() for word in words)
    wrong = next((name for name in names if name not in ORDERS), None)
    if wrong is not None or not names:
        hint = did_you_mean(wrong or "", ORDERS)
        raise InputError(f"no order is named '{wrong or ''}'", hint=f"{hint} one of {', '.join(ORDERS)}".strip())
    return names


def _parse_reference_day(text: Any) -> str:
    """Day that dates of acquisition are compared with, such as '2024-07-15' or '07-15'."""
    written = str(text).strip()
    try:
        # A leap year, so that 02-29 is a day.
        date.fromisoformat(written if len(written) > len("07-15") else f"2000-{written}")
    except ValueError:
        raise InputError(f"'{text}' is no day", hint="write 2024-07-15, or 07-15 for a season of any year") from None
    return written


@dataclass(frozen=True)
class Retouch(CheckedOptions):
    """Change of one image's colour after the balance: value · gain + offset, the same for all bands."""

    gain: float = option(1.0, "Factor of all values.", above=0.0)
    offset: float = option(0.0, "Added to all values, grey values.")


@named_only
@dataclass(frozen=True, kw_only=True)
class ColourOptions(CheckedOptions, group="colour", stage="colour", section="mosaic"):
    """Options of colour: the balance over overlaps, histogram matching, and touch-ups.

    Attributes
    ----------
    balance : bool, optional
        Solve a gain and an offset per image and band over the overlaps; unless given, done where there are seams.
    colour : tuple of str
        What the balance solves: ('auto',) for what is warranted, or some of `TERMS`.
    mask : Path, optional
        Vector file of areas that say nothing of colours: clouds, water.
    histogram : str, optional
        Match histograms instead: 'overlap' in sequence over what images share, 'whole' over all that each shows,
        'sequence' each image to the one before it.
    region : Path, optional
        Vector file of areas that histograms are matched over.
    master : str, optional
        Name of the image that the others are matched to; unless given, the one that shares most.
    reference : Path, optional
        Georeferenced raster that all images are matched to, instead of a master.
    reference_bands : tuple of int, optional
        Bands of the reference that go with those of the images, from 1.
    retouch : mapping of str to Retouch
        Changes of single images' colours after the balance.
    """

    balance: bool | None = option(
        None, "Balance colours over the overlaps.", shown="balance, but not with --rule, nor what is calibrated",
        idle_with=("histogram", "rule=count"),
    )  # fmt: skip
    colour: tuple[str, ...] = option(
        ("auto",),
        f"What the balance solves: gain (and offset), and {', '.join(TERMS[1:])}, with commas "
        "between; or auto for what is warranted.", metavar="TERMS", shown="auto", parse=_parse_terms,
        needs=("balance",), idle_with=("histogram",),
    )  # fmt: skip
    mask: Path | None = option(
        None, "Areas that say nothing of colours, as polygons: clouds, water.", needs=("balance", "histogram")
    )
    histogram: str | None = option(
        None,
        "Match histograms instead: over what images share, nearest first; over all that each shows; or each image to "
        "the one before it.", choices=("overlap", "whole", "sequence"),
    )  # fmt: skip
    region: Path | None = option(None, "Areas that histograms are matched over, as polygons.", needs=("histogram",))
    master: str | None = option(
        None, "Image that the others are matched to.", metavar="NAME", shown="shares most",
        needs=("balance", "histogram"),
    )  # fmt: skip
    reference: Path | None = option(
        None, "Georeferenced raster that all are matched to, instead of a master.", needs=("balance", "histogram")
    )
    reference_bands: tuple[int, ...] | None = option(
        None, "Bands of the reference that go with those of the images.", least=1, metavar="NUMBERS",
        flag="--reference-bidx", needs=("reference",),
    )  # fmt: skip
    retouch: Mapping[str, Retouch] = option(
        default_factory=dict, help="Changes of single images' colours after the balance: gain and offset by image.",
        flag=None, stage="edits", idle_with=("rule",),
    )  # fmt: skip


@dataclass(frozen=True)
class SeamWeights(CheckedOptions):
    """Weights of the seam cost terms, relative to one cell of seam at no other cost (`length`).

    Attributes
    ----------
    length : float
        Cost of every cell: keeps seams short where nothing else matters.
    colour : float
        Difference of the two images' values, in units of their contrast.
    gradient : float
        Difference of their gradients: edges that do not meet.
    texture : float
        Difference of their local standard deviations: sharp against blurred, trees against lawn.
    angle : float
        View angle of the image that shows the cell, in units of 45 degrees; per cell of area.
    edge : float
        Proximity of the edge of the image that shows the cell; per cell of area.
    heights : float
        Raised objects: roofs, trees, walls.
    avoid : float
        Cells inside areas to avoid.
    follow : float
        Part of the cost that remains along lines to follow, 0 to 1.
    reach : float
        Width of the zone in which a seam may run, as a part of the distance of two image centres, 0 to 1.
    """

    length: float = option(0.03, "Cost of every cell: keeps seams short.", above=0.0)
    colour: float = option(1.0, "Difference of both images' values.", least=0.0)
    gradient: float = option(0.5, "Difference of their gradients: edges that do not meet.", least=0.0)
    texture: float = option(0.25, "Difference of their local standard deviations.", least=0.0)
    angle: float = option(0.004, "View angle of the image that shows the cell.", least=0.0)
    edge: float = option(0.02, "Proximity of the edge of that image.", least=0.0)
    heights: float = option(3.0, "Raised objects: roofs, trees, walls.", least=0.0)
    avoid: float = option(100.0, "Cells inside areas to avoid.", least=0.0)
    follow: float = option(0.15, "Part of the cost that remains along lines to follow.", least=0.0, most=1.0)
    reach: float = option(
        0.6, "Width of the zone of a seam, as a part of the distance of two centres.", least=0.0, most=1.0
    )


@named_only
@dataclass(frozen=True, kw_only=True)
class SeamOptions(CheckedOptions, group="seams", stage="seams", section="mosaic"):
    """Options of seamlines.

    Attributes
    ----------
    seams : str
        'nearest' halfway between the places that images see best; 'halve' where the edges of two are equally far;
        'graph-cut' where seams cost least; 'order' where the first of `order` that shows the ground ends.
    follow, avoid : tuple of Path
        Vector files of roads and rivers that seams of 'graph-cut' follow, and of areas that they keep out of.
    seam_weights : SeamWeights
        Weights of the costs of 'graph-cut'.
    cutlines : Path, optional
        Vector file of areas drawn by hand, each with its image; they win.
    exclude : tuple of str
        Names of images that show nothing; they still take part in the balance, so that the others keep their colours.
    water : Path, optional
        Vector file of water, each piece of which the least glinting image shows.
    water_fill : str
        'calmest' for that image, or 'tone' for a continuous tone that fits the shores.
    """

    seams: str = option(
        "nearest",
        "Seams halfway between what images see best, halving overlaps, of least cost by graph cut, or by "
        "--order.", choices=("nearest", "halve", "graph-cut", "order"), idle_with=("rule",),
    )  # fmt: skip
    follow: tuple[Path, ...] = option(
        (), "Roads and rivers that --seams graph-cut runs along.", needs=("seams=graph-cut",)
    )
    avoid: tuple[Path, ...] = option(
        (), "Areas, such as buildings, that --seams graph-cut keeps out of.", needs=("seams=graph-cut",)
    )
    seam_weights: SeamWeights = option(
        default_factory=SeamWeights, help="Weight of a cost of --seams graph-cut, such as heights=5.",
        metavar="NAME=VALUE", flag="--seam-weight", needs=("seams=graph-cut",),
    )  # fmt: skip
    cutlines: Path | None = option(
        None, "Areas with an image each, drawn by hand, that win over --seams.", stage="edits",
        idle_with=("rule", "blend=edge"),
    )  # fmt: skip
    exclude: tuple[str, ...] = option(
        (), "Image that is to show nothing.", metavar="NAME", stage="edits", idle_with=("rule",)
    )
    water: Path | None = option(
        None, "Areas of water: each is shown by the image with the least glint.", idle_with=("rule",)
    )
    water_fill: str = option(
        "calmest", "Show water by that image, or fill it with a continuous tone that fits its shores.",
        choices=("calmest", "tone"), needs=("water",),
    )  # fmt: skip


@dataclass(frozen=True)
class Width:
    """A width on the ground.

    Attributes
    ----------
    value : float
    unit : str
        'px' output pixels, 'm' metres, or 'map' units of the output CRS.
    """

    value: float
    unit: str = "map"

    @classmethod
    def parse(cls, text: str | float) -> Width:
        """Width of '20px', '5m', or a number of map units.

        Raises
        ------
        InputError
        """
        found = re.fullmatch(r"\s*(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+)\s*(px|m)?\s*", str(text))
        if not found:
            raise InputError(f"'{text}' is not a width", hint="write pixels as 20px, metres as 5m, or map units as 5")
        return cls(float(found[1]), found[2] or "map")


@named_only
@dataclass(frozen=True)
class BlendOptions(CheckedOptions, group="blending", stage="blending", section="mosaic"):
    """Options of blending across seams.

    Attributes
    ----------
    blend : str
        'feather' across the seam, 'cutline' the same by exact distances, 'edge' from the edge of each image inwards
        where images lie on each other, 'overlap' over all that images share, 'multiband' each band of frequency as
        wide as its wavelength, or 'none'.
    feather : Width, optional
        Width of the transition, 32 output pixels unless given. For 'overlap' the distance from an image's edge beyond
        which it counts fully, without end unless given. For 'multiband' the width of the coarsest band, rounded to a
        power of two. A text such as '5m' or a number of map units will do.
    ramp : str
        'linear', or 'smooth' with no kink at its ends.
    limit : bool, optional
        Do not blend what the images show differently. Done unless said otherwise.
    """

    blend: str = option(
        "feather",
        "Blend across the seam (exactly by cutline), from the edge of the upper image inwards, over all that images "
        "share, each band of frequency by itself, or not at all.",
        choices=("feather", "cutline", "edge", "overlap", "multiband", "none"), idle_with=("rule",),
    )  # fmt: skip
    feather: Width | None = option(
        None, "Width of the blending: 20px, 5m, or a number of map units.", metavar="WIDTH", shown="32px",
        parse=Width.parse, idle_with=("rule", "blend=none"),
    )  # fmt: skip
    ramp: str = option(
        "linear", "Shape of the transition.", choices=("linear", "smooth"),
        idle_with=("rule", "blend=none", "blend=multiband", "feather=0"),
    )  # fmt: skip
    limit: bool | None = option(
        None, "Do not blend what images show differently, such as cars.", shown="limit",
        idle_with=("rule", "blend=none", "feather=0"),
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.blend in ("overlap", "edge", "cutline") and self.feather is not None and self.feather.value == 0.0:
            what = "a width of 0 leaves nothing to blend over"
            raise InputError(what, where="`feather`", hint="give a width, or `blend=none` for hard seams")

    @property
    def limits(self) -> bool:
        """Whether what images show differently is not blended."""
        return self.blend != "none" and self.limit is not False

    @property
    def plain(self) -> bool:
        """Whether weights across the seam are all that is wanted."""
        return self.blend in ("none", "feather")


@dataclass(frozen=True, kw_only=True)
class RuleOptions(CheckedOptions, group="seams", stage="seams", section="mosaic"):
    """Options of a mosaic by rule instead of seams, and of which image comes first.

    Attributes
    ----------
    rule : str, optional
        One of `RULES`; seams unless given.
    order : tuple of str
        Whose pixels come first, by criteria of which each decides between equals of those before it: 'list' as given,
        'name', 'sensor' by blocks of the declaration, 'resolution' the finest, 'date' the newest, 'oldest', 'day' the
        nearest to `day`, 'season' the nearest to that day of any year, 'cloud' the least clouded. Images that are equal
        in all of them come as given with `rule` and seams 'order'; other seams divide them.
    day : str, optional
        Day that 'day' and 'season' count from.
    base : str, optional
        Name of the image that is laid lowest, under all others.
    panchromatic : str
        What images of one band show beside images of several, in all bands alike: 'fill' what no image of several
        bands shows, 'mix' what they would with several bands, 'refuse' stops.
    """

    rule: str | None = option(
        None, "Lay images together by rule, as rio merge does, instead of seams; nothing is balanced unless asked for.",
        choices=RULES, flag="--rule --method", stage="blending",
    )  # fmt: skip
    order: tuple[str, ...] = option(
        ("list",),
        f"Whose pixels come first: {', '.join(ORDERS)}; several with commas between, each among equals of those "
        "before it. Seams divide what is equal in all.", metavar="NAMES", shown="list", parse=_parse_order,
        idle_with=_UNORDERED,
    )  # fmt: skip
    day: str | None = option(
        None, "Day that --order day and season count from, such as 2024-07-15, or 07-15.", metavar="DATE",
        parse=_parse_reference_day, idle_with=_UNORDERED,
    )  # fmt: skip
    base: str | None = option(
        None, "Image that is laid lowest, under all others.", metavar="NAME", idle_with=_UNORDERED
    )
    panchromatic: str = option(
        "fill",
        "What images of one band show beside images of several: what these leave, what they would with several "
        "bands; or stop.", choices=("fill", "mix", "refuse"), stage="all",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        dated = [name for name in ("day", "season") if name in self.order]
        if self.day is None and dated:
            raise InputError(f"`order={dated[0]}` has no day to count from", hint="give `day`, such as 2024-07-15")
        if self.day is not None and not dated:
            raise InputError("`day` would do nothing without `order=day` or `order=season`", hint="leave out `day`")
        if "day" in self.order and self.day is not None and len(self.day) <= len("07-15"):
            raise InputError(f"`order=day` needs a year beside {self.day}", hint="give `day` as 2024-07-15")


@dataclass(frozen=True)
class TileSize:
    """Side of the square tiles of a mosaic in many files.

    Attributes
    ----------
    value : float
        Above 0.
    unit : str
        'px' output pixels, or 'm' metres.
    """

    value: float
    unit: str

    @classmethod
    def parse(cls, text: str) -> TileSize:
        """Size of '16384px', '5000m' or '10km'.

        Raises
        ------
        InputError
        """
        found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*(px|m|km)\s*", str(text))
        if not found or float(found[1]) <= 0.0:
            raise InputError(f"'{text}' is not a size of tiles", hint="write pixels as 16384px, or lengths as 10km")
        value = float(found[1])
        return cls(value * 1000.0, "m") if found[2] == "km" else cls(value, found[2])


@dataclass(frozen=True, kw_only=True)
class RecordOptions(CheckedOptions, stage="records", section="mosaic"):
    """Options of what is written beside a mosaic."""

    labels: bool = option(True, "Write the raster of source images.")
    vectors: bool = option(
        True, "Write footprints, seams and gains (GeoPackage), and the STAC item with the checksum.", flag="--records",
        section=None,
    )  # fmt: skip
    stac: bool = option(True, flag=None, needs=("vectors",), section=None)
    views: bool = option(
        False, "Write the raster of view angles and resolutions.", flag="--views/--no-views", needs=("labels",),
        idle_with=("rule",),
    )  # fmt: skip
    displacement: float | None = option(
        None, "Write the raster of relief displacements against level ground of this height, metres.", metavar="HEIGHT",
        needs=("labels",), idle_with=("rule",),
    )  # fmt: skip
    seam_quality: bool | None = option(
        None, "Judge seams piece by piece.", shown="in projects only", group="seams", idle_with=("rule",)
    )
    tiling: TileSize | None = option(
        None, "Write a grid of files of about this size, with a VRT, a tile index and a STAC collection.",
        metavar="16384px|10km", parse=TileSize.parse,
    )  # fmt: skip


@named_only
@dataclass(frozen=True, kw_only=True)
class MosaicOptions:
    """Options of a mosaic, composed of those of its stages.

    Attributes
    ----------
    render : RenderOptions
    colours : ColourOptions
    seamlines : SeamOptions
    blending : BlendOptions
    merge : RuleOptions
    samples : SampleOptions
    records : RecordOptions
    uncertainty : UncertaintyOptions

    Raises
    ------
    InputError
        A value is wrong, or an option would do nothing beside the others.
    """

    render: RenderOptions = field(default_factory=RenderOptions)
    colours: ColourOptions = field(default_factory=ColourOptions)
    seamlines: SeamOptions = field(default_factory=SeamOptions)
    blending: BlendOptions = field(default_factory=BlendOptions)
    merge: RuleOptions = field(default_factory=RuleOptions)
    samples: SampleOptions = field(default_factory=SampleOptions)
    records: RecordOptions = field(default_factory=RecordOptions)
    uncertainty: UncertaintyOptions = field(default_factory=UncertaintyOptions)

    def __post_init__(self) -> None:
        width = self.blending.feather
        hard = self.blending.blend == "feather" and width is not None and width.value == 0.0
        check_idle(self, {"balance": self.balanced} | ({"feather": "0"} if hard else {}))
        if self.blending.blend == "edge" and self.seamlines.seams != "order":
            what = "`blend=edge` feathers the edges of images that lie on each other, and `seams=order` is not given"
            raise InputError(what, hint="give `seams=order`, or `blend=cutline` for a ramp across other seams")
        weights, usual = self.seamlines.seam_weights, SeamWeights()
        for name in ("follow", "avoid"):
            if getattr(weights, name) != getattr(usual, name) and not getattr(self.seamlines, name):
                what = f"`seam_weights` would do nothing with '{name}': `{name}` is not given"
                raise InputError(what, hint=f"give `{name}`, or leave out its weight")

    def __repr__(self) -> str:
        given = (f"{one.name}={value!r}" for one, value in flat_values(self) if is_given(one, value))
        return f"{type(self).__name__}({', '.join(given)})"

    @classmethod
    def of(cls, **values: Any) -> MosaicOptions:
        """Options from flat values by name, such as `blend="multiband", feather="5m"`; parts may be given whole.

        Parameters
        ----------
        **values : object

        Raises
        ------
        InputError
        """
        return compose(cls, values)

    def with_progress(self, progress: Progress | None) -> Self:
        """The same options with a progress callback.

        Parameters
        ----------
        progress : callable or None
        """
        return replace(self, render=self.render.with_progress(progress))

    @property
    def balanced(self) -> bool:
        """Whether colours are balanced: as asked; unless asked, where there are seams."""
        declared_balance = self.colours.balance
        return self.merge.rule is None if declared_balance is None else declared_balance

    @property
    def uses_surface(self) -> bool:
        """Whether the mosaic needs a surface whatever its images are, as seams beside raised objects do."""
        drawn = self.records.views or self.records.displacement is not None or self.render.true_ortho
        return self.seamlines.seams == "graph-cut" or drawn or self.uncertainty.accuracy

    @property
    def writes_labels(self) -> bool:
        """Whether there is a raster of source images: rules that mix several have no one source per pixel."""
        return self.records.labels and self.merge.rule in (None, *SINGLE_SOURCE_RULES)

    @property
    def writes_item(self) -> bool:
        """Whether a STAC item is asked for."""
        return self.records.vectors and self.records.stac


@dataclass(frozen=True, repr=False)
class EdgeMosaicOptions(MosaicOptions):
    """Options of `match_edges`: those of a mosaic, with the fit and the extent."""

    fit: EdgeOptions = field(default_factory=EdgeOptions)
    area: Area = field(default_factory=Area)
