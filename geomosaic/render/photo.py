"""Image with all that is needed to render it into an output grid, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.block import Footprint, OrientedImage
from geomosaic.errors import InputError
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.options.render import CELL, SAMPLE_TYPES, SampleOptions
from geomosaic.radiometry.corrections import CorrectionField, ToneCurve
from geomosaic.raster.info import SourceInfo
from geomosaic.raster.source import Source
from geomosaic.render.aligned import Offset, copied, is_identity, offset_on, table_of
from geomosaic.render.calibrated import calibrated_values
from geomosaic.resample.warp import MOST_SAMPLES, Colour, Sampling, Target, value_range, warp
from geomosaic.sensor.lattice import Lattice, build
from geomosaic.sensor.map_to_image import BlockGround, MapToImage
from geomosaic.surface.model import Surface
from geomosaic.types import AnyArray

if TYPE_CHECKING:
    from geomosaic.render.occlusion import OcclusionMask


@dataclass(frozen=True, eq=False)
class Photo:
    """Scene with its open image, its mapping from map to image, and its footprint.

    Attributes
    ----------
    scene : OrientedImage
    source : Source
        Its pixels; closed by who opened the photo.
    mapper : MapToImage
        Map of the output to image.
    footprint : Footprint
        In the map of the output.
    scale : float
        Factor that brings its values to those of the other images.
    grid : Grid, optional
        The output.
    offset : (columns, rows), optional
        Image pixel minus output pixel, where the pixels of the image are pixels of `grid`, see `aligned.offset_on`.
    tables : dict
        Lookup tables of corrections, made once each.
    """

    scene: OrientedImage
    source: Source
    mapper: MapToImage
    footprint: Footprint
    scale: float = 1.0
    grid: Grid | None = None
    offset: Offset | None = None
    tables: dict[tuple[int, str], tuple[object, AnyArray | None]] = field(default_factory=dict, compare=False)

    def table(self, colour: Colour | ToneCurve, out: np.dtype[Any]) -> AnyArray | None:
        """Lookup table of a correction, where the image's values are few enough; computed once."""
        key = id(colour), str(out)
        if key not in self.tables:  # the correction is kept too: no other can come to have its id
            self.tables[key] = colour, table_of(colour, self.scale, self.source.dtype, out)
        return self.tables[key][1]

    def step_of(self, coarse: Grid) -> int | None:
        """Output pixels along a cell of a coarser grid, where they are pixels of the photo too; None where not."""
        if self.offset is None or self.grid is None:
            return None
        step = round(coarse.resolution[0] / self.grid.resolution[0])
        return step if step > 1 and self.grid.coarser(step) == coarse else None

    @classmethod
    def open(
        cls,
        scene: OrientedImage,
        surface: Surface | None,
        grid: Grid,
        footprint: Footprint,
        memory: int,
        scale: float = 1.0,
    ) -> Photo:
        """Open the image and check that it is the one the model was made for.

        Parameters
        ----------
        scene : OrientedImage
        surface : Surface or None
            None where heights play no part.
        grid : Grid
            Of the output.
        footprint : Footprint
        memory : int
            Bytes that may be held of it.
        scale : float
        """
        source = Source(
            scene.path, nodata=scene.nodata, bands=scene.bands, memory_limit=memory, usable=scene.usable,
            clouds=scene.clouds, calibrated=calibrated_values(scene, surface),
        )  # fmt: skip
        info = source.info
        if (info.width, info.height) != tuple(scene.model.size):
            raise InputError(
                f"the image has {info.width} x {info.height} pixels, its model {scene.model.size[0]} x "
                f"{scene.model.size[1]}",
                where=scene.path,
                hint="give the camera and orientation that belong to this image",
            )
        crs = None if surface is None else surface.crs
        mapper = MapToImage.between(grid.crs, crs, scene.model)
        return cls(scene, source, mapper, footprint, scale, grid, offset_on(grid, mapper, footprint))

    def touches(self, bounds: Bounds) -> bool:
        """Whether the footprint's bounds meet these."""
        a, b = self.footprint.bounds, bounds
        return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]


@dataclass(frozen=True)
class Rectifier:
    """Rectification of photos onto a grid, block by block.

    Attributes
    ----------
    grid : Grid
        The output.
    resampling : str
    tolerance : float
        Admissible error of the lattice, image pixels.
    most_samples : int, optional
        Image pixels per output pixel beyond which an image is reduced on reading.
    """

    grid: Grid
    resampling: str
    tolerance: float
    most_samples: int | None = None

    def fill(
        self,
        photo: Photo,
        ground: BlockGround,
        colour: Colour | ToneCurve | CorrectionField,
        target: Target,
        *,
        lattices: list[Lattice] | None = None,
        shades: OcclusionMask | None = None,
    ) -> list[Lattice]:
        """Fill one block from one photo; the lattices used, none where the photo does not see it.

        Parameters
        ----------
        photo : Photo
        ground : BlockGround
            Heights under the block.
        colour : Colour, ToneCurve or CorrectionField
            Correction of its values.
        target : Target
            The pixels, and what is wanted of them.
        lattices : list of Lattice, optional
            Those that were used for the same block and photo before.
        shades : OcclusionMask, optional
            Take what the surface hides.
        """
        if ground.unknown:
            return []
        out, out_valid, need = target.values, target.valid, target.need
        if photo.offset is not None and self.grid is photo.grid and not isinstance(colour, CorrectionField):
            identity = isinstance(colour, Colour) and is_identity(colour) and photo.scale == 1.0
            table = None if identity else photo.table(colour, out.dtype)
            if identity or table is not None:
                return copied(photo.source, photo.offset, ground.window, out, out_valid, need, table)
        if not isinstance(colour, Colour):
            plain, seen = np.zeros(out.shape, dtype=_unrounded(out)), np.zeros_like(out_valid)
            same = Colour.identity(out.shape[2])
            bare = replace(target, values=plain, valid=seen)
            used = self.fill(photo, ground, same, bare, lattices=lattices, shades=shades)
            if isinstance(colour, CorrectionField):
                from geomosaic.kernels.blend import shade

                window = ground.window
                place = (*colour.at(window.col + 0.5, window.row + 0.5), 1 / colour.spacing[0], 1 / colour.spacing[1])
                shade(
                    plain, seen, colour.net, colour.path, colour.haze, place, colour.dark, colour.curve, colour.reach,
                    colour.offset, *value_range(str(out.dtype)), out, out_valid,
                )  # fmt: skip
                return used
            here = seen > 0
            out[here], out_valid[here] = _rounded(colour(plain[here]), str(out.dtype)), 1
            return used
        if photo.scale != 1.0:
            colour = Colour(colour.gain * photo.scale, colour.offset)
        if lattices is None:
            lattices = build(photo.mapper, self.grid, ground, self.tolerance)
        patch = ground.patch if photo.mapper.uses_heights else None
        size, block = photo.scene.model.size, ground.window
        sampling = Sampling(self.resampling, self.most_samples or MOST_SAMPLES)
        for lattice in lattices:
            part = lattice.window
            col, row = part.col - block.col, part.row - block.row
            inside = slice(row, row + part.height), slice(col, col + part.width)
            wanted = None
            if need is not None:
                wanted = np.ascontiguousarray(
                    need[row // CELL : -(-(row + part.height) // CELL), col // CELL : -(-(col + part.width) // CELL)]
                )
                if not wanted.any():
                    continue
            piece = target.part(*inside, wanted)
            warp(photo.source, size, lattice, patch, sampling, colour, piece)
        if shades is not None:
            shades.hide(photo.mapper, out, out_valid)
        return lattices


def _unrounded(out: AnyArray) -> type[np.floating[Any]]:
    """Type of values that a curve has yet to bend: one rounding is enough."""
    return np.float32 if out.dtype.itemsize < 4 or out.dtype == np.float32 else np.float64


def _rounded(values: AnyArray, dtype: str) -> AnyArray:
    low, high, whole = value_range(dtype)
    return np.clip(np.floor(values + 0.5), low, high) if whole else values


def sample_scales(options: SampleOptions, infos: Sequence[SourceInfo]) -> tuple[str, list[float]]:
    """Sample type of the output, and the factor that the values of each image are multiplied by.

    Parameters
    ----------
    options : SampleOptions
    infos : sequence of SourceInfo
        Of the images.

    Returns
    -------
    dtype : str
    scales : list of float
        One an image.

    Raises
    ------
    InputError
        Values would be lost.
    """
    first = infos[0]
    if options.dtype is None:
        for info in infos:
            if info.dtype != first.dtype:
                raise InputError(
                    f"the image holds {info.dtype} samples, '{first.path}' holds {first.dtype}",
                    where=info.path,
                    hint=f"name one type for all: `dtype={_wider(infos)}` keeps the numbers as they are; with "
                    "`convert=range` the whole range of each type is brought to that of the output",
                )
        return first.dtype, [1.0] * len(infos)
    return options.dtype, [_scale(info, options.dtype, options.convert) for info in infos]


def _scale(info: SourceInfo, dtype: str, convert: str) -> float:
    if convert == "keep" or info.dtype == dtype:
        if not np.can_cast(info.dtype, dtype, "safe"):
            raise InputError(
                f"the image holds {info.dtype} samples, and {dtype} cannot hold them all",
                where=info.path,
                hint=f"a wider `dtype`, such as {np.result_type(info.dtype, dtype).name}, or `convert=range`",
            )
        return 1.0
    if np.dtype(info.dtype).kind != "u" or np.dtype(dtype).kind != "u":
        raise InputError(
            f"the range of {info.dtype} cannot be brought to that of {dtype}: only those of unsigned whole numbers",
            where=info.path,
            hint="use `convert=keep`, with a type that holds the values",
        )
    return float(np.iinfo(dtype).max / np.iinfo(info.dtype).max)


def _wider(infos: Sequence[SourceInfo]) -> str:
    name = np.result_type(*(info.dtype for info in infos)).name
    return name if name in SAMPLE_TYPES else "float64"


def refuse_palette(info: SourceInfo, resampling: str) -> None:
    """Check that numbers of a palette are not averaged.

    Parameters
    ----------
    info : SourceInfo
    resampling : str

    Raises
    ------
    InputError
        The colours of the image stand in a palette, and the resampling takes more than the nearest pixel.
    """
    if resampling != "nearest" and "palette" in info.colors:
        raise InputError(
            "the pixels of the image are numbers of a palette, between which there are no values",
            where=info.path,
            hint="expand them to colours first (gdal_translate -expand rgb); where they are classes, keep the numbers "
            "with `resampling=nearest`",
        )
