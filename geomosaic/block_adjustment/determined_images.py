"""Images of a block that something holds; those that nothing ties or holds are set aside, and named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from geomosaic.block_adjustment.groups import fixed_images
from geomosaic.block_adjustment.measurements import Measurements
from geomosaic.block_adjustment.start import StartBlock
from geomosaic.errors import GeomosaicError, InputError, counted, listed
from geomosaic.options.adjustment import AdjustmentOptions
from geomosaic.orientation.block.connectivity import UndeterminedError
from geomosaic.types import IntArray

UNSEEN = "no tie point in common with another image"
WEAK = "what it has in common with the others does not orient it"
APART = "{} images tied to each other alone"


@dataclass(frozen=True, eq=False)
class DeterminedImages:
    """Images that are adjusted.

    Attributes
    ----------
    start : StartBlock
    measured : Measurements
    options : AdjustmentOptions
    aside : mapping of str to str
        Images that are set aside, each with the reason.
    """

    start: StartBlock
    measured: Measurements
    options: AdjustmentOptions
    aside: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, start: StartBlock, measured: Measurements, options: AdjustmentOptions) -> DeterminedImages:
        """Images that show a point, or are held by what is known of their position and angles.

        Parameters
        ----------
        start : StartBlock
        measured : Measurements
        options : AdjustmentOptions

        Raises
        ------
        InputError
            They are fewer than half of the images.
        """
        whole = cls(start, measured, options)
        said = options.position_sigma is not None and options.attitude_sigma is not None
        known = [said or (row is not None and row.covariance is not None) for row in start.rows]
        seen, fixed = set(measured.image.tolist()), fixed_images(start, options.fixed)
        unseen = [
            np.array([index])
            for index in range(len(start.names))
            if index not in seen and not (start.oriented[index] and (known[index] or index in fixed))
        ]
        names = [start.names[int(index)] for (index,) in unseen]
        return whole.without(
            unseen,
            InputError(
                f"{counted(len(unseen), 'image')} without a point that another image shows: {listed(names, 6)}",
                where="`ties`",
                hint="measure tie points in these images, or leave them out of the block; or give the accuracy of "
                "their positions and angles (`position_sigma`, `attitude_sigma`)",
            ),
        )

    def without(self, parts: Sequence[IntArray], error: GeomosaicError) -> DeterminedImages:
        """Images without some parts; the error is raised where these are no small matter.

        Parameters
        ----------
        parts : sequence of int array (N,)
            Images of each.
        error : GeomosaicError
        """
        if not parts:
            if isinstance(error, UndeterminedError):
                raise error
            return self
        names, out = self.start.names, np.zeros(len(self.start.names), dtype=bool)
        out[np.concatenate(parts)] = True
        rest, all_of, largest = int((~out).sum()), len(names) + len(self.aside), max(map(len, parts))
        # Of rigs and of what the user has fixed the rest needs all images.
        fixed = fixed_images(self.start, self.options.fixed)
        bound = self.options.rigs is not None or bool(fixed & {*np.flatnonzero(out).tolist()})
        if bound or 2 * rest < all_of or rest <= largest:
            raise error
        alone = WEAK if isinstance(error, UndeterminedError) else UNSEEN
        causes = {
            names[k]: APART.format(len(part)) if len(part) > 1 else alone for part in parts for k in part.tolist()
        }
        start, measured = self.start.select(~out), self.measured.of_images(~out)
        return replace(self, start=start, measured=measured, aside={**self.aside, **causes})

    @property
    def text(self) -> str:
        """What is set aside and what to do; empty where nothing is."""
        if not self.aside:
            return ""
        return f"{set_aside_text(self.aside)}; {HINT}"


HINT = (
    "do they belong to this place? Leave them out for good, or add photos or tie points that join them to the others; "
    "images whose position and angles are given with their accuracy take part in any case"
)


def set_aside_text(aside: Mapping[str, str]) -> str:
    """Images that are set aside, by reason.

    Parameters
    ----------
    aside : mapping of str to str
        Reasons by the names of the images.
    """
    by_reason: dict[str, list[str]] = {}
    for name, why in aside.items():
        by_reason.setdefault(why, []).append(name)
    causes = [f"{listed(names, 6)} ({why})" for why, names in by_reason.items()]
    return f"{counted(len(aside), 'image')} set aside, the rest is adjusted: {listed(causes, 6, '; ')}"
