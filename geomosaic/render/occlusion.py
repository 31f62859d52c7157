"""Occlusion: an image shows no place that the surface hides from it; walls of true orthos stand upright."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from affine import Affine

from geomosaic.errors import InputError
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.units import linear_unit
from geomosaic.render.radar_terrain import RadarTerrain
from geomosaic.resample.layover_shadow import LAYOVER, SHADOW
from geomosaic.resample.occlusion import STEP, WALL, Field, Relief, Way, hidden, upright
from geomosaic.sensor.map_to_image import BlockGround, Ground, MapToImage
from geomosaic.sensor.plugin import HasSensorPositions
from geomosaic.surface.model import HeightPatch, Surface
from geomosaic.types import AnyArray, ByteArray, FloatArray

# Output pixels between nodes from which on it matters; finer nodes leave less than a pixel of every wall.
COARSE = 0.75


@dataclass(frozen=True, eq=False)
class UprightGround(Ground):
    """Ground of a true ortho: heights of a block at its pixels, walls upright, not at the surface's nodes.

    Where the output has another map than the surface, or is turned against it, they are those of the nodes as ever.
    """

    def block(self, window: Window) -> BlockGround:
        """Heights of one block."""
        found = super().block(window)
        if found.patch is None or found.unknown or self.to_surface is None or not self.to_surface.identical:
            return found
        node = 1.0 / math.sqrt(abs(found.patch.transform.determinant))
        if self.surface is None or node < COARSE * math.sqrt(math.prod(self.grid.resolution)):
            return found
        # A pixel around the block, for what lies between its outer pixels' centres and its edge.
        wider = self.grid.crop(Window(window.col - 1, window.row - 1, window.width + 2, window.height + 2))
        t = found.patch.transform @ wider.transform @ Affine.translation(0.5, 0.5)
        if t.b != 0.0 or t.d != 0.0:
            return found
        way: Way = (t.a, t.c - 0.5, t.e, t.f - 0.5)
        heights = np.empty(wider.shape, dtype=np.float32)
        upright(found.patch.heights, way, WALL * node * linear_unit(self.surface.crs), heights)
        return BlockGround(window, HeightPatch(heights, ~wider.transform), found.heights)


# Chebyshev nodes: s is a quadratic in height between them.
LEVELS = np.cos((2 * np.arange(3) + 1) * np.pi / 6)
_TO_QUADRATIC = np.linalg.inv(np.vander(LEVELS, 3, increasing=True))
# Output pixels of a difference, upwards too: short, so that lines of sight are not bent; long against rounding.
AHEAD = 0.5

# Parts of an output pixel over which heights may be means: a mean of roof and ground is the height of neither.
DETAIL = 4.0


def ground_of(grid: Grid, surface: Surface | None) -> UprightGround:
    """Ground of a true ortho.

    Parameters
    ----------
    grid : Grid
        The output.
    surface : Surface or None

    Returns
    -------
    UprightGround
    """
    return UprightGround.under(grid, surface, DETAIL)


# None where nothing can be hidden.
Sight = tuple[Field, Relief] | None
# Bytes of heights that a block keeps for its images, each of which needs its own part of the surface: over nodes much
# closer than pixels, twelve photos held 300 MB. What was dropped is read again where its image is asked once more.
HELD = 48 << 20


def hidden_label(images: int) -> int:
    """Label of pixels that some image covers and that are hidden from every one; it follows those of the images.

    Parameters
    ----------
    images : int
        Number of images.

    Returns
    -------
    int
    """
    return images + 1


@dataclass(frozen=True)
class Visibility:
    """Visibility of the ground from the images, block by block.

    Attributes
    ----------
    grid : Grid
        The output.
    below : Ground
        The surface under it.
    """

    grid: Grid
    below: Ground

    def block(self, ground: BlockGround) -> OcclusionMask:
        """Begin a block."""
        return OcclusionMask(self, ground, np.zeros((ground.window.height, ground.window.width), dtype=np.uint8))

    def sight(self, mapper: MapToImage, ground: BlockGround) -> Sight:
        """Lines of sight of an image over a block, with the heights they may run into."""
        surface = self.below.surface
        if surface is None or ground.unknown or not mapper.uses_heights or surface.range[0] == surface.range[1]:
            return None
        low, high = ground.heights
        xy, slopes = self._slopes(mapper, ground, (low + high) / 2, (high - low) / 2)
        if not np.isfinite(slopes).any():
            return None
        # As far as the lines of sight get below the highest place of all.
        climb = surface.range[1] - low
        steps = np.einsum("k,rcak->rca", np.ones(3), np.abs(slopes)) * climb
        signs = np.sign(slopes[..., 0])
        reach = np.concatenate([xy, xy + signs * steps]).reshape(-1, 2)
        (left, bottom), (right, top) = np.nanmin(reach, axis=0).tolist(), np.nanmax(reach, axis=0).tolist()
        patch = surface.patch((left, bottom, right, top), self.below.spacing)
        if min(patch.heights.shape) < 2:
            return None
        t = patch.transform
        nodes = np.empty((*xy.shape[:2], 8))
        nodes[..., 0] = t.a * xy[..., 0] + t.b * xy[..., 1] + t.c - 0.5
        nodes[..., 1] = t.d * xy[..., 0] + t.e * xy[..., 1] + t.f - 0.5
        nodes[..., 2:5] = t.a * slopes[:, :, 0] + t.b * slopes[:, :, 1]
        nodes[..., 5:8] = t.d * slopes[:, :, 0] + t.e * slopes[:, :, 1]
        longest = np.nanmax(np.hypot(np.abs(nodes[..., 2:5]).sum(axis=-1), np.abs(nodes[..., 5:8]).sum(axis=-1)))
        width = linear_unit(surface.crs) / math.sqrt(abs(t.determinant))
        relief = Relief.of(patch.heights, float(longest), width)
        if not relief.may_hide(float(longest)):
            return None
        half = (high - low) / 2
        return Field(nodes, (low + high) / 2, 1.0 / half if half > 0.0 else 0.0, width), relief

    def _slopes(
        self, mapper: MapToImage, ground: BlockGround, middle: float, half: float
    ) -> tuple[FloatArray, FloatArray]:
        """Surface map of nodes (rows, cols, 2), and quadratics (rows, cols, 2, 3) of the upward lines of sight."""
        # A line of sight is where the image stays the same: with d the change of image by map x, y and height,
        # s = −d_xy⁻¹ · d_z.
        window = ground.window
        c = window.col + STEP * np.arange(-(-window.width // STEP) + 1)
        r = window.row + STEP * np.arange(-(-window.height // STEP) + 1)
        xy = mapper.surface_xy(self.grid.xy(np.stack(np.meshgrid(c, r), axis=-1).reshape(-1, 2).astype(np.float64)))
        across = AHEAD * self.below.spacing
        metres = AHEAD * self.grid.resolution[0] * linear_unit(self.grid.crs)
        levels = middle + half * LEVELS
        places = [xy, xy + np.array([across, 0.0]), xy + np.array([0.0, across]), xy]
        heights = [np.repeat(level + (metres if i == 3 else 0.0), len(xy)) for level in levels for i in range(4)]
        image = mapper.image(np.concatenate(places * 3), np.concatenate(heights)).reshape(3, 4, len(xy), 2)
        by_x, by_y, by_z = ((image[:, i] - image[:, 0]) / d for i, d in ((1, across), (2, across), (3, metres)))
        determinant = by_x[..., 0] * by_y[..., 1] - by_x[..., 1] * by_y[..., 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            x = -(by_y[..., 1] * by_z[..., 0] - by_y[..., 0] * by_z[..., 1]) / determinant
            y = -(by_x[..., 0] * by_z[..., 1] - by_x[..., 1] * by_z[..., 0]) / determinant
        at_levels = np.stack([x, y])  # (2, levels, N)
        quadratics = np.zeros((*at_levels.shape[::2], 3))
        for power in range(3):
            for level in range(3):
                quadratics[..., power] += _TO_QUADRATIC[power, level] * at_levels[:, level]
        if half == 0.0:
            quadratics[..., 1:] = 0.0
        shape = len(r), len(c)
        return xy.reshape(*shape, 2), _continued(quadratics.transpose(1, 0, 2).reshape(*shape, 2, 3))


def visibility(grid: Grid, below: Ground) -> Visibility:
    """Visibility of the ground of an output from its images.

    Parameters
    ----------
    grid : Grid
        The output.
    below : Ground
        The surface under it.

    Returns
    -------
    Visibility

    Raises
    ------
    InputError
        There is no surface that could hide anything.
    """
    if below.surface is None or below.surface.range[0] == below.surface.range[1]:
        raise InputError(
            "a true ortho needs a surface model with the heights of what hides the ground",
            hint="give `dem`, or leave out `true_ortho`",
        )
    return Visibility(grid, below)


def _continued(slopes: FloatArray) -> FloatArray:
    """Give nodes that the image does not see, beyond its horizon, the slopes of the nearest that it does."""
    # A cell at the edge of what is seen has such nodes, and what is hidden there must be found all the same.
    unknown = ~np.isfinite(slopes).all(axis=(2, 3))
    if not unknown.any() or unknown.all():
        return slopes
    from scipy.ndimage import distance_transform_edt

    row, col = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return np.asarray(slopes[row, col])


@dataclass(frozen=True)
class OcclusionMask:
    """One block's shades.

    Attributes
    ----------
    visibility : Visibility
    ground : BlockGround
    mask : uint8 array (rows, cols)
        1 where some image was found to cover a place and not to see it.
    """

    visibility: Visibility
    ground: BlockGround
    mask: ByteArray
    _known: dict[int, tuple[MapToImage, Sight]] = field(default_factory=dict)
    _asked: dict[int, ByteArray] = field(default_factory=dict)
    _radar_masks: dict[int, tuple[MapToImage, ByteArray]] = field(default_factory=dict)

    def hide(self, mapper: MapToImage, out: AnyArray, valid: ByteArray) -> None:
        """Take from an image's pixels those that it cannot see, and note them.

        Parameters
        ----------
        mapper : MapToImage
        out : array (rows, cols, bands)
        valid : uint8 array (rows, cols)
        """
        # Right after `worthwhile` only of the places asked about there: what they hide is known, and no others count.
        found = self._asked.pop(id(mapper), None)
        if found is None:
            found = self.hidden(mapper, valid)
        else:
            np.bitwise_and(found, valid, out=found)
        if found is not None and found.any():
            here = found.view(np.bool_)
            np.copyto(out, 0, where=here[..., None])
            np.copyto(valid, 0, where=here)
            np.bitwise_or(self.mask, found, out=self.mask)

    def worthwhile(self, mapper: MapToImage, missing: AnyArray) -> AnyArray:
        """Of places still missing (bool, rows, cols), those where an image may show something or tell what it hides."""
        self._asked.clear()
        found = self.hidden(mapper, missing.view(np.uint8))
        if found is None:
            return missing
        known = found & self.mask
        worth: AnyArray = np.less(known, missing.view(np.uint8), out=known.view(np.bool_))
        if worth.any():
            self._asked[id(mapper)] = found
        return worth

    def _drop(self) -> None:
        """Drop the heights of the images that were first looked at, as far as they are more than may be kept."""
        sizes = {key: sight[1].heights.nbytes for key, (_, sight) in self._known.items() if sight is not None}
        for key, size in list(sizes.items()):
            if sum(sizes.values()) > HELD - size:  # as much again is about to be read
                del self._known[key], sizes[key]

    def hidden(self, mapper: MapToImage, wanted: ByteArray) -> ByteArray | None:
        """1 where the surface is in the way of what is wanted (uint8, rows, cols); None where it nowhere is."""
        if isinstance(mapper.model, HasSensorPositions):
            return self._radar(mapper, wanted)
        if id(mapper) not in self._known:
            self._drop()
            self._known[id(mapper)] = mapper, self.visibility.sight(mapper, self.ground)
        _, sight = self._known[id(mapper)]
        if sight is None:
            return None
        lines, relief = sight
        out = np.zeros_like(wanted)
        hidden(lines, relief, wanted, out)
        return out

    def _radar(self, mapper: MapToImage, wanted: ByteArray) -> ByteArray | None:
        """1 where a radar scene has layover or shadow in what is wanted; None where it nowhere has."""
        surface = self.visibility.below.surface
        if surface is None or self.ground.unknown or not wanted.any():
            return None
        if id(mapper) not in self._radar_masks:
            classes = RadarTerrain(self.visibility.grid, surface, mapper.model).classes(self.ground.window)
            self._radar_masks[id(mapper)] = mapper, (classes & (LAYOVER | SHADOW) > 0).astype(np.uint8)
        found: ByteArray = self._radar_masks[id(mapper)][1] & (wanted != 0)
        return found if found.any() else None
