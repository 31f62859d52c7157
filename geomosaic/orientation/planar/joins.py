"""Joins of photos: gaps at common points, along the seam and across it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geomosaic.orientation.planar.measurements import PlanarBlock
from geomosaic.orientation.planar.transformations import PlanarTransform
from geomosaic.types import FloatArray


@dataclass(frozen=True)
class Join:
    """Join of two photos.

    Attributes
    ----------
    first, second : str
    points : int
        Points measured in both.
    along, across : float
        Mean shift of the second photo's content against the first's, in pixels of the second: along the seam, which
        runs halfway between the middles of the two photos, and across it.
    rms, largest : float
        Of the lengths of the gaps, pixels of the second photo.
    """

    first: str
    second: str
    points: int
    along: float
    across: float
    rms: float
    largest: float


def joins(block: PlanarBlock, transforms: Mapping[str, PlanarTransform]) -> list[Join]:
    """Joins of all pairs of placed photos that show common points, in the order of the block.

    Parameters
    ----------
    block : PlanarBlock
    transforms : mapping of str to PlanarTransform
        By photo.
    """
    places = positions(block, transforms)
    names = [photo.name for photo in block.photos if photo.name in transforms]
    found = [join(a, b, transforms, places) for i, a in enumerate(names) for b in names[i + 1 :]]
    return [one for one in found if one is not None]


def positions(block: PlanarBlock, transforms: Mapping[str, PlanarTransform]) -> dict[str, dict[str, FloatArray]]:
    """Map position (2,) of each measured point by each placed photo that shows it: photo → point → position.

    Parameters
    ----------
    block : PlanarBlock
    transforms : mapping of str to PlanarTransform
        By photo.
    """
    return {name: positions_by(block, transform) for name, transform in transforms.items()}


def positions_by(block: PlanarBlock, transform: PlanarTransform) -> dict[str, FloatArray]:
    """Map position (2,) of each point that one placed photo shows.

    Parameters
    ----------
    block : PlanarBlock
    transform : PlanarTransform
    """
    own = block.by_photo[transform.photo.name]
    if not own:
        return {}
    ground = transform.to_ground(np.array([[measured.col, measured.row] for measured in own.values()]))
    return dict(zip(own, ground, strict=True))


def join(
    first: str,
    second: str,
    transforms: Mapping[str, PlanarTransform],
    places: Mapping[str, Mapping[str, FloatArray]],
) -> Join | None:
    """Join of one pair of photos; None where they share no point.

    Parameters
    ----------
    first : str
    second : str
    transforms : mapping of str to PlanarTransform
        By photo.
    places : mapping
        Map position (2,) of each point by photo, see `positions`.
    """
    shared = [point for point in places[first] if point in places[second]]
    if not shared:
        return None
    gaps = np.array([places[second][point] - places[first][point] for point in shared])
    transform = transforms[second]
    gaps = gaps / transform.pixel()
    across = transform.centre() - transforms[first].centre()
    across = across / max(float(np.hypot(*across)), 1e-300)
    seam = np.array([-across[1], across[0]])
    length = np.hypot(*gaps.T)
    return Join(
        first,
        second,
        len(shared),
        float((gaps @ seam).mean()),
        float((gaps @ across).mean()),
        float(np.sqrt((length**2).mean())),
        float(length.max()),
    )
