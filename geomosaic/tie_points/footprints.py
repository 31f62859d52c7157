"""What sensor models and a surface say before any picture is compared: which images overlap, and where places lie."""

from __future__ import annotations

import numpy as np

from geomosaic.block import footprint
from geomosaic.block_adjustment.start import StartBlock
from geomosaic.errors import GeomosaicError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.transform import Transform
from geomosaic.matching.overlaps import pairs_of_outlines
from geomosaic.matching.predicted import Predicted
from geomosaic.sensor.plugin import HasPose, HasRays, SensorModel
from geomosaic.sensor.solve import image_to_ground, image_to_height
from geomosaic.surface.model import Plane, Surface
from geomosaic.types import FloatArray, IntArray

# Share of its size by which a footprint may lie elsewhere.
MARGIN = 0.1
# Metres of height over which the direction of an epipolar curve is taken.
HEIGHT_STEP = 20.0
# Cosine of the tilt from which on an image looks elsewhere than down: its position says little of what it shows.
OBLIQUE = 0.85


def pairs_by_footprints(start: StartBlock, neighbours: int) -> IntArray | None:
    """Pairs (P, 2) of images whose footprints overlap; None where positions say more of these images.

    Parameters
    ----------
    start : StartBlock
    neighbours : int
        Images that each is paired with, those of the largest overlap.
    """
    if not start.oriented.all() or not any(map(_looks_elsewhere, start.models)):
        return None
    if start.surface is None and any(isinstance(model, HasPose) for model in start.models):
        return None
    crs = horizontal(start.ground)
    try:
        outlines = [footprint(scene, surface_of(start, scene.model), crs).polygon for scene in start.scenes]
    except GeomosaicError:
        # Some image sees no ground where it is thought to be: its orientation is a guess.
        return None
    grown = [outline.buffer(MARGIN * np.sqrt(outline.area), quad_segs=2) for outline in outlines]
    return pairs_of_outlines(grown, neighbours)


def _looks_elsewhere(model: SensorModel) -> bool:
    """Whether an image shows another place than the one below it."""
    if not isinstance(model, HasPose) or not isinstance(model, HasRays):
        return True
    origin, ray = model.rays(np.array([[model.size[0] / 2.0, model.size[1] / 2.0]]))
    if not model.crs.is_geocentric:
        return bool(-ray[0, 2] < OBLIQUE)
    return bool(-(origin[0] @ ray[0]) / np.linalg.norm(origin[0]) < OBLIQUE)


def surface_of(start: StartBlock, model: SensorModel) -> Surface:
    """Surface of a block, or the height that a model was made about.

    Parameters
    ----------
    start : StartBlock
    model : SensorModel
    """
    if start.surface is not None:
        return start.surface
    return Plane(start.ground, float(Transform(model.crs, start.ground)(np.array([model.seed]))[0, 2]))


def predicted_places(start: StartBlock, i: int, j: int, colrow: FloatArray) -> Predicted | None:
    """Places of one image as they are expected in another; None where epipolar lines of two photos say as much.

    Parameters
    ----------
    start : StartBlock
    i, j : int
        Numbers of the images.
    colrow : array (N, 2)
        Pixels of the first.
    """
    first, second = start.scenes[i].model, start.scenes[j].model
    photos = isinstance(first, HasPose) and isinstance(second, HasPose)
    if photos or not (start.oriented[i] and start.oriented[j]) or not len(colrow):
        return None
    surface = surface_of(start, first)
    ground = image_to_ground(first, colrow, surface)
    # Beside the DEM and in its holes the mean height of the others serves: along the curve all is sought for anyway.
    known = np.isfinite(ground).all(axis=1)
    height = np.median(ground[known, 2]) if known.any() else np.mean(surface.range)
    if not known.all():
        ground[~known] = image_to_height(first, colrow[~known], float(height), surface.crs)
    above = image_to_height(first, colrow, ground[:, 2] + HEIGHT_STEP, surface.crs)
    there = Transform(surface.crs, second.crs)
    low, high = second.ground_to_image(there(ground)), second.ground_to_image(there(above))
    step = high - low
    length = np.linalg.norm(step, axis=1, keepdims=True)
    # Movements of a hundredth of a pixel have no direction.
    along = np.where(length > 0.01, step / np.maximum(length, 1e-12), 0.0)
    return Predicted(low, along)
