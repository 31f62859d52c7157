"""An image of unknown place, scale and turn, such as a scan, found by its features anywhere in a reference."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from geomosaic.block import OrientedImage
from geomosaic.geo.grid import Window
from geomosaic.matching.displacement import consistent
from geomosaic.matching.features import Features
from geomosaic.matching.registration import Alignment, Picture, align_features
from geomosaic.raster.info import SourceInfo
from geomosaic.raster.source import Source
from geomosaic.reference_matching.drawing import Drawer
from geomosaic.reference_matching.match import FEATURE_SIDE, FEATURES, Reference, ReferenceMatch, not_found, refine
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.sensor.registry import build, plane_sensor

# Tiles of the reference along its longer side on the finest grid, and pixels by which they overlap.
MOST_TILES, OVERLAP = 6, 64
# Share of the image's longer side that relief, and the warp of paper and film, may move a place off one homography.
WARPED = 0.004
# Pixels of a coarse grid by which a homography of a relief may be off.
LOOSE = 60.0


@dataclass(frozen=True, eq=False)
class SearchedReference:
    """Reference in which images are looked for: its features at each scale are found once for all of them.

    Attributes
    ----------
    reference : Reference
        Open.
    """

    reference: Reference
    _found: list[tuple[int, Features]] = field(default_factory=list)
    _rest: list[Iterator[tuple[int, Features]]] = field(default_factory=list)

    def levels(self) -> Iterator[tuple[int, Features]]:
        """Features from coarse to fine, each with the factor of its grid; a finer one may show more."""
        if not self._rest:
            self._rest.append(_levels(self.reference))
        yield from self._found
        for level in self._rest[0]:
            self._found.append(level)
            yield level


def match_anywhere(path: Path, bands: tuple[int, ...] | None, searched: SearchedReference) -> ReferenceMatch:
    """Places of an image in a reference, wherever in it the image lies.

    Parameters
    ----------
    path : Path
    bands : tuple of int, optional
        Counted from 1.
    searched : SearchedReference

    Raises
    ------
    SolveError
        The image was not found.
    """
    reference = searched.reference
    with Source(path, bands=bands) as source:
        info = source.info
        shrink = max(1, -(-max(info.size) // FEATURE_SIDE))
        values, valid = source.read(Window(0, 0, info.width, info.height), shrink)
    shown = np.ones(values.shape[:2], dtype=bool) if valid is None else valid > 0
    features = Picture(values.mean(axis=2, dtype=np.float32), shown).features(FEATURES).scaled(shrink)
    for factor, seen in searched.levels():
        # Pixels of the image: three of the coarser of both pictures.
        found = align_features(seen, features, 3.0 * shrink)
        if found is not None:
            model = _model(path, info, reference, found, factor)
            scene = OrientedImage(path.stem, str(path), plane_sensor(), model, bands=bands)
            with Drawer.open(scene, None, reference.grid.crs) as drawer:
                match = refine(drawer, reference, factor, LOOSE, drawer, max(8.0, WARPED * max(info.size)))
                return match.select(consistent(match.colrow - match.residuals, match.colrow))
    hint = "give a reference of the same land that looks more like it, or measure control points: `control`"
    raise not_found(reference, "its features are found nowhere in it", hint)


def _levels(reference: Reference) -> Iterator[tuple[int, Features]]:
    """Features of the reference from coarse to fine, each with the factor of its grid; a finer one may show more."""
    side = max(reference.grid.width, reference.grid.height)
    factor = max(1, -(-side // FEATURE_SIDE))
    while True:
        grid = reference.grid if factor == 1 else reference.grid.coarser(factor)
        parts = []
        for tile in grid.window.split(FEATURE_SIDE, FEATURE_SIDE):
            wide = Window(
                tile.col - OVERLAP, tile.row - OVERLAP, tile.width + 2 * OVERLAP, tile.height + 2 * OVERLAP
            ).intersection(grid.window)
            found = reference.drawer.draw(grid.crop(wide)).features(FEATURES)
            places = found.colrow + np.array([wide.col, wide.row])
            parts.append(Features(places, found.scale, found.angle, found.descriptors))
        names = ("colrow", "scale", "angle", "descriptors")
        yield factor, Features(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
        if factor == 1 or side / (factor // 2) > MOST_TILES * FEATURE_SIDE:
            return
        factor //= 2


def _model(path: Path, info: SourceInfo, reference: Reference, found: Alignment, factor: int) -> SensorModel:
    """Projective model of the image through the matches."""
    grid = reference.grid if factor == 1 else reference.grid.coarser(factor)
    rows = np.column_stack([grid.xy(found.first), found.second]).tolist()
    points = [
        {"id": str(number), "x": x, "y": y, "col": col, "row": row} for number, (x, y, col, row) in enumerate(rows)
    ]
    request = SensorRequest(path.name, info.size, {"kind": "projective", "points": points}, grid.crs, path=str(path))
    return build(plane_sensor(), request)
