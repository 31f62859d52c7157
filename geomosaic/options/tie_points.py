"""Options of tie point matching."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geomosaic.options.check import check_idle, check_values
from geomosaic.options.declaration import option

# Projects and the library have these options, and no command a flag for them.
_MATCH: dict[str, Any] = {"flag": None, "section": "match", "group": "input"}


@dataclass(frozen=True)
class TiePointOptions:
    """Options of `match`.

    Attributes
    ----------
    match_size : int
        Longer side, in pixels, to which images are reduced to find their features; places are measured at full size.
    features : int
        Features of an image that are compared.
    neighbours : int
        Nearest images that each is compared with, by camera positions, or by likeness where there are none.
    per_cell : int
        Points that each of 16 x 16 cells of an image asks for.
    cache : Path, optional
        Folder that keeps features and matches, so that a rerun with one more photo matches that photo only.
    """

    match_size: int = option(
        2000, "Longer side of images, pixels, in which features are found; they are measured at full size.", least=200,
        **_MATCH,
    )  # fmt: skip
    features: int = option(5000, "Features of an image that are compared.", least=100, **_MATCH)
    neighbours: int = option(
        24, "Nearest images that each is compared with, by positions or, without any, by likeness.", least=1, **_MATCH
    )
    per_cell: int = option(3, "Tie points that each of 16 x 16 cells of an image asks for.", least=1, **_MATCH)
    cache: Path | None = option(
        None, "Folder that keeps features and matches for the next run.", flag=None, group="input"
    )

    def __post_init__(self) -> None:
        check_values(self)
        check_idle(self)
