"""Positions of samples in their images and relative to the nadir; correction fields laid out over the output."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geomosaic.geo.grid import Grid
from geomosaic.radiometry import bases
from geomosaic.radiometry.colour_model import ColourModel
from geomosaic.radiometry.corrections import CorrectionField
from geomosaic.radiometry.normal_equations import ColourSetting
from geomosaic.radiometry.overlaps import Overlap, SamplePositions
from geomosaic.render.photos import Photos
from geomosaic.resample.warp import value_range
from geomosaic.types import AnyArray, FloatArray, IntArray

# Intervals of the net of gains across a footprint: between nodes, vignetting by half is interpolated to 1e-4.
NODES = 48
# Relative difference of the sizes of images of one camera: orthos of one camera are not of equal size.
SIZE_TOLERANCE = 0.05


def _cameras(photos: Photos) -> IntArray:
    """Number of the camera (images,) of each photo: photos of one sensor and of about one size share a camera."""
    known: list[tuple[str, float, float]] = []
    numbers = []
    for scene in photos.block.scenes:
        width, height = scene.model.size
        for number, (sensor, w, h) in enumerate(known):
            if sensor == scene.sensor and abs(width / w - 1) < SIZE_TOLERANCE and abs(height / h - 1) < SIZE_TOLERANCE:
                numbers.append(number)
                break
        else:
            numbers.append(len(known))
            known.append((scene.sensor, width, height))
    return np.array(numbers, dtype=np.int64)


def _view_radius(photos: Photos) -> float:
    """Half the diagonal of a footprint in map units, the median of all."""
    radii = [np.hypot(*(outline.ring - np.array(outline.centre)).T).max() for outline in photos.outlines]
    return float(np.median(radii))


def sample_positions(photos: Photos, grid: Grid) -> SamplePositions:
    """Function that gives the positions of cells of a coarse grid in an image and relative to its nadir.

    Parameters
    ----------
    photos : Photos
    grid : Grid
        Coarse grid of the cells.

    Returns
    -------
    SamplePositions
        Image and cells (N, 2) as (col, row) → positions in the image and on the ground, each (N, 2), in the units of
        `radiometry.bases`. For a reference, which is numbered after the photos, all positions are 0.
    """
    radius = _view_radius(photos)

    def find(index: int, cells: AnyArray) -> tuple[FloatArray, FloatArray]:
        if index >= len(photos):
            return np.zeros((len(cells), 2)), np.zeros((len(cells), 2))
        return _positions(photos, index, grid.xy(np.asarray(cells, dtype=np.float64) + 0.5), radius)

    return find


def _positions(photos: Photos, index: int, xy: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """Positions in the image (N, 2), corners at distance 1, and about the nadir (N, 2), in units of `radius`."""
    surface, size = photos.block.surface, np.array(photos.block.scenes[index].model.size, dtype=np.float64)
    with photos.using(index) as photo:
        mapper = photo.mapper
    own = mapper.surface_xy(xy)
    z = np.zeros(len(xy)) if surface is None or not mapper.uses_heights else surface.height(own)
    # Held at the edges: nodes of a net reach beyond the image, where powers of the radius would run away.
    colrow = np.clip(mapper.image(own, z), 0.0, size)
    image = (colrow - size / 2) / (np.hypot(*size) / 2)
    view = (xy - np.array(photos.outlines[index].centre)) / radius
    return image, np.clip(view, -1.2, 1.2)


def correction_field(photos: Photos, index: int, fields: ColourModel) -> CorrectionField:
    """Correction field of one photo, laid out over its footprint in the output.

    Parameters
    ----------
    photos : Photos
    index : int
        Number of the photo.
    fields : ColourModel

    Returns
    -------
    CorrectionField
        Nodes beyond the image have the gain of its edge, those that the model cannot see the mean gain of the others.
    """
    window = photos.grid.window_of(photos.outlines[index].bounds)
    longer = max(window.width, window.height, 1)
    spacing = longer / NODES
    cols = window.col + spacing * np.arange(max(2, int(np.ceil(window.width / spacing)) + 1))
    rows = window.row + spacing * np.arange(max(2, int(np.ceil(window.height / spacing)) + 1))
    c, r = np.meshgrid(cols, rows)
    xy = photos.grid.xy(np.column_stack([c.ravel(), r.ravel()]))
    image, view = _positions(photos, index, xy, _view_radius(photos))
    log = np.full((len(xy), fields.gain.shape[1]), np.nan)
    seen = np.isfinite(image).all(axis=1)
    if seen.any():
        log[seen] = fields.log_field(index, image[seen], view[seen])
        # Without a height, or where the model cannot see: pixels beside such a node are interpolated with it.
        log[~seen] = log[seen].mean(axis=0)
    else:
        log[:] = 0.0
    # Rounded: sums in another order differ in the last bits, and equal runs must give equal pixels.
    net = np.round(np.exp(log + fields.gain[index]), 9).reshape(len(rows), len(cols), -1)
    shade = CorrectionField.of(
        net, (float(cols[0]), float(rows[0])), (spacing, spacing), fields.dark[index], fields.gamma[index],
        fields.setting.reach, fields.setting.pivot,
    )  # fmt: skip
    if fields.haze is None:
        return shade
    return replace(shade, path=bases.excess_air_path(view).reshape(len(rows), len(cols)), haze=fields.haze[index])


def colour_setting(photos: Photos, pairs: list[Overlap], level: FloatArray) -> ColourSetting:
    """Setting of a colour model without terms.

    Parameters
    ----------
    photos : Photos
    pairs : list of Overlap
    level : array (images, bands)
        Median level of each photo, and NaN for a reference after them.

    Returns
    -------
    ColourSetting
    """
    kinds = _cameras(photos)
    # A reference was taken by no camera of the block: terms of light and lens do not apply to it.
    camera = np.concatenate([kinds, np.full(len(level) - len(kinds), -1)])
    return ColourSetting(
        len(camera), int(kinds.max()) + 1, camera, frozenset(), _value_range(photos, pairs), level,
        middle=_median_sample(pairs),
    )  # fmt: skip


def _value_range(photos: Photos, pairs: list[Overlap]) -> float:
    """Range of values: of the sample type, or of the samples where that has none."""
    _, high, whole = value_range(photos.info.dtype)
    return high if whole else max(float(np.abs(pair.a).max()) for pair in pairs) or 1.0


def _median_sample(pairs: list[Overlap]) -> float:
    """Median of the samples, of the first views of all overlaps; at least 0."""
    return max(float(np.median(np.concatenate([pair.a.ravel() for pair in pairs if len(pair.a)]))), 0.0)
