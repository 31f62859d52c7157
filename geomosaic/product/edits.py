"""What a person changes after having looked: photos left out, the colour of one photo touched up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError, did_you_mean
from geomosaic.product.corrections import Correction, then


@dataclass(frozen=True)
class Retouch:
    """Change of one image's corrected values: value · gain + offset, the same for all bands."""

    gain: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.gain) and self.gain > 0 and np.isfinite(self.offset)):
            raise InputError(
                f"a photo is to be touched up by gain {self.gain} and offset {self.offset}",
                mend="give a positive gain, and an offset in grey values",
            )


def numbers_of(wanted: Sequence[str], names: Sequence[str], what: str) -> set[int]:
    """Numbers of images that an edit names.

    Raises
    ------
    InputError
        A name that no image has.
    """
    for name in wanted:
        if name not in names:
            hint = did_you_mean(name, names) or "name an image"
            raise InputError(f"'{name}' is {what}, which is no image of this mosaic", mend=hint)
    return {names.index(name) for name in wanted}


def retouched(colours: Sequence[Correction], names: Sequence[str], edits: Mapping[str, Retouch]) -> list[Correction]:
    """Corrections of all images, some of them touched up. The balance itself is not solved anew: others stay."""
    numbers_of(list(edits), list(names), "to be touched up")
    return [
        then(own, edits[name].gain, edits[name].offset) if name in edits else own
        for name, own in zip(names, colours, strict=True)
    ]
