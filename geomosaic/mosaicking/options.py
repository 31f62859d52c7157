"""How mosaics are made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geomosaic.block.block import OrientedImage
from geomosaic.errors import InputError, did_you_mean
from geomosaic.mosaicking.blending.options import Blending
from geomosaic.mosaicking.retouch import Retouch
from geomosaic.mosaicking.seams.cost_terms import SeamWeights
from geomosaic.render.options import RenderOptions
from geomosaic.render.sample_types import Depth

if TYPE_CHECKING:
    from geomosaic.mosaicking.reruns.reuse import Memory


HISTOGRAMS = ("overlap", "whole", "sequence")
COLOUR = ("gain", "vignetting", "trend", "hotspot", "haze", "gamma", "dodging")
WATER = ("calmest", "tone")
SEAMS = ("nearest", "halve", "alike", "order")


def terms_of(text: str) -> tuple[str, ...]:
    """Terms of the balance from words with commas between, in lower case."""
    return tuple(word.strip().lower() for word in text.split(",") if word.strip())


@dataclass(frozen=True)
class MosaicOptions:
    """What a mosaic adds.

    Attributes
    ----------
    render : RenderOptions
    feather : float, optional
        Width of the transition across a seam in output map units; 32 output pixels unless given, 0 for hard seams.
    balance : bool
        Solve a gain and an offset per image and band over the overlaps.
    labels : bool
        Write the raster that names the source image of each pixel.
    vectors : bool
        Write footprints and seamlines.
    stac : bool
        Write a STAC item.
    histogram : str, optional
        Match histograms instead: 'overlap' in sequence over what images share, 'whole' over all that they show.
    master : str, optional
        Name of the image that the others are matched to; unless given, the one that shares most.
    reference : OrientedImage, optional
        Georeferenced raster that all images are matched to, instead of a master.
    seams : str
        'nearest' halfway between the places that images see best; 'halve' where the edges of two are equally far;
        'alike' where seams cost least; 'order' where the first of `order` that shows the ground ends.
    seam_weights : SeamWeights
        What counts how much for 'alike'.
    follow, avoid : tuple of Path
        Vector files of roads and rivers that seams of 'alike' follow, and of areas that they keep out of.
    cutlines : Path, optional
        Vector file of shares that a person has drawn: they win.
    seam_quality : bool
        Judge the seams piece by piece.
    views : bool
        Write view angle and ground sampling distance of each pixel; needs `labels`.
    displacement : float, optional
        Height of level ground, metres: write the relief displacement of each pixel against it; needs `labels`.
    about : mapping of str to mapping
        Further facts of the images by name, for GeoPackage and STAC: checksums, residuals.
    exclude : tuple of str
        Names of images that show nothing; they still take part in the balance, so that the others keep their colours.
    retouch : mapping of str to Retouch
        Changes of single images' colours, after the balance.
    blending : Blending
        How images are blended across their seams.
    depth : Depth
        Sample type of the output, and how those of the images are brought to it.
    water : Path, optional
        Vector file of water, each piece of which the least glinting image shows.
    water_fill : str
        'calmest' for that image, or 'tone' for a continuous tone that fits the shores.
    memory : Memory, optional
        Where what was computed is remembered, so that a later run takes what has not changed.
    colour : tuple of str
        What the balance solves: ('auto',) for what is warranted, or terms of `COLOUR`; gain and offset are always.
    mask : Path, optional
        Vector file of areas that say nothing of colours: clouds, water.
    region : Path, optional
        Vector file of areas that histograms are matched over, instead of all.
    stretch : str, optional
        Stretch of the finished mosaic to eight bits, see `stretch.read`.
    """

    render: RenderOptions = field(default_factory=RenderOptions)
    feather: float | None = None
    balance: bool = True
    labels: bool = True
    vectors: bool = True
    stac: bool = True
    histogram: str | None = None
    master: str | None = None
    reference: OrientedImage | None = None
    seams: str = "nearest"
    seam_weights: SeamWeights = field(default_factory=SeamWeights)
    follow: tuple[Path, ...] = ()
    avoid: tuple[Path, ...] = ()
    cutlines: Path | None = None
    seam_quality: bool = False
    views: bool = False
    about: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    exclude: tuple[str, ...] = ()
    retouch: Mapping[str, Retouch] = field(default_factory=dict)
    memory: Memory | None = None
    colour: tuple[str, ...] = ("auto",)
    mask: Path | None = None
    region: Path | None = None
    stretch: str | None = None
    rule: str | None = None
    order: str = "list"
    base: str | None = None
    blending: Blending = field(default_factory=Blending)
    depth: Depth = field(default_factory=Depth)
    water: Path | None = None
    displacement: float | None = None
    water_fill: str = "calmest"

    def __post_init__(self) -> None:
        if self.feather is not None and not self.feather >= 0:
            raise InputError(f"a feather of {self.feather} is not a width", hint="give map units, 0 or more")
        if self.seams not in SEAMS:
            raise InputError(f"no way to lay seams is named '{self.seams}'", hint=f"use one of {', '.join(SEAMS)}")
        if self.seams != "alike" and (self.follow or self.avoid or self.seam_weights != SeamWeights()):
            raise InputError(
                f"seams that are laid '{self.seams}' heed no roads, areas or weights", hint="lay them 'alike'"
            )
        if (self.views or self.displacement is not None) and not self.labels:
            raise InputError("views are told per source image, and labels are not to be written", hint="write labels")
        if self.histogram not in (None, *HISTOGRAMS):
            raise InputError(
                f"histograms cannot be matched by '{self.histogram}'", hint=f"one of {', '.join(HISTOGRAMS)}"
            )
        if self.histogram is None and not self.balance and (self.master or self.reference):
            raise InputError("a master is given, but colours are not to be changed", hint="leave out --no-balance")
        if self.region is not None and self.histogram is None:
            raise InputError("a region is given, but histograms are not to be matched", hint="add --histogram whole")
        if self.colour != ("auto",) and (not self.colour or set(self.colour) - set(COLOUR)):
            wrong = sorted(set(self.colour) - set(COLOUR))
            hint = did_you_mean(wrong[0], COLOUR) if wrong else ""
            raise InputError(
                f"colour has no term '{', '.join(wrong)}'", hint=f"{hint} auto, or some of {', '.join(COLOUR)}".strip()
            )
        if self.water_fill not in WATER:
            raise InputError(f"water cannot be filled by '{self.water_fill}'", hint=f"one of {', '.join(WATER)}")
        if self.water_fill != "calmest" and self.water is None:
            raise InputError("a tone is wanted for water, but none is given", hint="give the areas with --water")
        if self.rule is not None:
            self._check_rule()

    def _check_rule(self) -> None:
        given = {
            "--seams": self.seams != "nearest",
            "--cutlines": self.cutlines is not None,
            "--water": self.water is not None,
            "--exclude": bool(self.exclude),
            "--blend": not self.blending.plain or self.blending.ramp != "linear",
            "--limit": bool(self.blending.limit),
            "--stretch": self.stretch is not None,
            "--true-ortho": self.render.true_ortho,
            "--views": self.views,
            "--displacement": self.displacement is not None,
            "--seam-quality": self.seam_quality,
        }
        idle = [name for name, asked in given.items() if asked]
        if idle:
            raise InputError(
                f"under rule '{self.rule}' there are no seams and no blending, and {', '.join(idle)} would do nothing",
                hint=f"leave out {', '.join(idle)}, or --rule",
            )
