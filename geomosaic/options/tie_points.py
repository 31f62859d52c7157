"""Options of tie point matching."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from geomosaic.options.check import SelfContainedOptions
from geomosaic.options.declaration import option
from geomosaic.options.render import RunningOptions


@dataclass(frozen=True)
class TiePointOptions(SelfContainedOptions, RunningOptions, group="input", section="match"):
    """Options of `match`.

    Attributes
    ----------
    match_size : int
        Longer side, in pixels, to which images are reduced to find their features; places are measured at full size.
    features : int
        Features of an image that are compared.
    neighbours : int
        Nearest images that each is compared with, by camera positions, or by similarity where there are none.
    per_cell : int
        Points that each of 16 x 16 cells of an image asks for.
    leave_out : Path, optional
        Vector file of areas on the ground that get no tie points, as water and clouds; images need an orientation.
    cache : Path, optional
        Folder that keeps features and matches, so that a rerun with one more photo matches that photo only.
    reference : Path, optional
        Ortho, mosaic or map, in which control points are found.
    search : float
        Metres that images may lie wrong before.
    reference_sigma, height_sigma : float, optional
        Standard deviations of the reference in one axis, and of the heights, metres.
    threads, memory_limit, workers
        See `RunningOptions`.
    """

    match_size: int = option(
        2000, "Longer side of images, pixels, in which features are found; they are measured at full size.", least=200
    )
    features: int = option(5000, "Features of an image that are compared.", least=100)
    neighbours: int = option(
        24, "Nearest images that each is compared with, by positions or, without any, by similarity.", least=1
    )
    per_cell: int = option(3, "Tie points that each of 16 x 16 cells of an image asks for.", least=1)
    leave_out: Path | None = option(None, "Areas on the ground that get no tie points, as polygons: water, clouds.")
    cache: Path | None = option(None, "Folder that keeps features and matches for the next run.", section=None)
    reference: Path | None = option(
        None, "Georeferenced raster of the land, such as an ortho, in which control points are found."
    )
    search: float = option(
        300.0, "Metres that images may lie wrong before they are found in the reference.", above=0.0,
        needs=("reference",),
    )  # fmt: skip
    reference_sigma: float | None = option(
        None, "Standard deviation of the reference in one axis, metres.", above=0.0,
        shown="what the residuals of each image tell", needs=("reference",),
    )  # fmt: skip
    height_sigma: float | None = option(
        None, "Standard deviation of the heights of its points, metres.", above=0.0, shown="that of the reference",
        needs=("reference",),
    )  # fmt: skip
