"""GDAL as the maker of the pieces of a TIFF: one tile, compressed, and the tags that describe a raster."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from io import BytesIO
from typing import Any

import numpy as np
import rasterio.crs
from affine import Affine
from rasterio.errors import RasterioError
from rasterio.io import MemoryFile

from geomosaic.errors import InputError
from geomosaic.geo.grid import Grid
from geomosaic.raster.cog import tiff
from geomosaic.raster.cog.tiff import Directory, Field
from geomosaic.raster.environment import environment, opening
from geomosaic.types import AnyArray, ByteArray

# Side of a tile, pixels.
BLOCK = 512
# Of the samples of a band: value = sample · scale + offset, and the unit of the value.
Scaling = tuple[float, float, str | None]
UNSCALED: Scaling = (1.0, 0.0, None)
# Tag of a file that says how its overviews were resampled, where not by plain means; the word is GDAL's.
OVERVIEWS = "OVERVIEW_RESAMPLING"


@dataclass(frozen=True)
class Samples:
    """Samples of a raster.

    Attributes
    ----------
    bands : int, number of bands
    dtype : str, NumPy name of the sample type
    nodata : float, optional, invalid pixels get this value; without it an internal mask says which pixels are valid
    mask : bool, write the internal mask (left out where every pixel is valid)
    """

    bands: int
    dtype: str
    nodata: float | None = None
    mask: bool = True


@dataclass(frozen=True)
class RasterMetadata:
    """Metadata of a raster file.

    Attributes
    ----------
    descriptions : sequence of str or None, name of each band
    scalings : sequence of Scaling, scale, offset and unit of each band
    tags : mapping of str to str, of the file
    categorical : bool, values are labels and not measures: overviews take no mean of them
    overviews : str, mean of several pixels otherwise: 'average', or 'rms', the root of the mean square, of amplitudes
    """

    descriptions: Sequence[str | None] = ()
    scalings: Sequence[Scaling] = ()
    tags: Mapping[str, str] = field(default_factory=dict)
    categorical: bool = False
    overviews: str = "average"


_ANYWHERE = Affine(1.0, 0.0, 1.0, 0.0, -1.0, 1.0)
# Place of a file of one tile, of which only the pixels count: rasterio warns of a file without one.
_PLACED = {33550: Field(12, 3, struct.pack("<3d", 1, 1, 0)), 33922: Field(12, 6, struct.pack("<6d", 0, 0, 0, 1, 1, 0))}

PIXEL_TAGS = {
    tiff.BITS, tiff.COMPRESSION, tiff.PHOTOMETRIC, tiff.SAMPLES, tiff.PLANAR, tiff.TILE_WIDTH, tiff.TILE_LENGTH,
    tiff.PREDICTOR, tiff.EXTRA_SAMPLES, tiff.SAMPLE_FORMAT,
}  # fmt: skip


def tile_profile(bands: int, dtype: str, options: Mapping[str, str]) -> dict[str, Any]:
    """Rasterio profile of a GeoTIFF of one tile.

    Parameters
    ----------
    bands : int
    dtype : str
    options : mapping of str to str, creation options of GDAL's GTiff driver

    Returns
    -------
    dict, arguments of `rasterio.open`
    """
    return {
        "driver": "GTiff",
        "width": BLOCK,
        "height": BLOCK,
        "count": bands,
        "dtype": dtype,
        "tiled": True,
        "blockxsize": BLOCK,
        "blockysize": BLOCK,
        "interleave": "pixel",
        **{key.lower(): value for key, value in options.items()},
    }


def encode_tile(values: AnyArray, profile: Mapping[str, Any], *, categorical: bool = False) -> bytes:
    """Compressed bytes of one tile, as they stand in a TIFF.

    Parameters
    ----------
    values : array (BLOCK, BLOCK, bands)
    profile : mapping, see `tile_profile`
    categorical : bool, whether the values are labels
    """
    # No state: tiles are encoded in any thread.
    first = values[0, 0]
    # Labels are so nearly everywhere; one row tells nearly all other tiles.
    if (values[BLOCK // 2] == first).all() and (values == first).all():
        return _encode_constant(first.tobytes(), tuple(sorted(profile.items())))
    # Labels come in long runs of the same number: there making a file in memory takes GDAL longer than all the rest.
    # This is what libtiff does for predictor 2: differences along the row, then deflate.
    if categorical and values.dtype.kind in "ui" and (profile["compress"], profile["predictor"]) == ("DEFLATE", "2"):
        steps = values.copy()
        steps[:, 1:] -= values[:, :-1]
        return zlib.compress(steps.tobytes(), int(profile["zlevel"]))
    if values.shape[2] > 1 and _is_of_bytes(values.dtype, profile):
        return _encode_bytes(values, profile)
    return _one_tile_file(values, profile)


def _is_of_bytes(dtype: np.dtype[Any], profile: Mapping[str, Any]) -> bool:
    """Whether a tile is compressed as bytes, whatever its bands and type."""
    known = profile["compress"] in ("DEFLATE", "ZSTD", "LZW", "LZMA") and "discard_lsb" not in profile
    predictor = profile.get("predictor", "1")
    return known and (predictor == "1" or (predictor == "2" and dtype.kind in "iu"))


def _encode_bytes(values: AnyArray, profile: Mapping[str, Any]) -> bytes:
    """Compressed bytes of an interleaved tile, the same as GDAL makes of its bands."""
    # GDAL takes the bands apart and puts them together again: a fifth of the time with deflate at level 1, a third with
    # Zstandard. One band of bytes it passes on as it is.
    if profile.get("predictor") == "2":  # differences from pixel to pixel, as libtiff has them
        steps = values.copy()
        steps[:, 1:] -= values[:, :-1]
        values = steps
    samples = values.reshape(BLOCK, -1).view(np.uint8)
    options = {key: value for key, value in profile.items() if key not in ("photometric", "alpha")}
    one = {"count": 1, "dtype": "uint8", "width": samples.shape[1], "blockxsize": samples.shape[1], "predictor": "1"}
    return _one_tile_file(samples[..., None], {**options, **one})


@lru_cache(maxsize=256)
def _encode_constant(pixel: bytes, profile: tuple[tuple[str, Any], ...]) -> bytes:
    options = dict(profile)
    values = np.empty((BLOCK, BLOCK, options["count"]), dtype=options["dtype"])
    values[:] = np.frombuffer(pixel, dtype=options["dtype"])
    return _one_tile_file(values, options)


def _one_tile_file(values: AnyArray, profile: Mapping[str, Any]) -> bytes:
    with environment(), MemoryFile() as memory:
        with memory.open(**profile, transform=_ANYWHERE) as dataset:
            dataset.write(np.moveaxis(values, -1, 0))
        data = bytes(memory.getbuffer())
    directory = tiff.read_directories(BytesIO(data))[0]
    offset, count = directory[tiff.TILE_OFFSETS].integers[0], directory[tiff.TILE_COUNTS].integers[0]
    return data[offset : offset + count]


def decode_tile(directory: Directory, data: bytes) -> AnyArray:
    """Values of a tile as it stands in a TIFF.

    Parameters
    ----------
    directory : Directory, of the level that the tile belongs to
    data : bytes, compressed

    Returns
    -------
    array (BLOCK, BLOCK, bands)

    Raises
    ------
    ValueError
        GDAL cannot read it.
    """
    one = {tag: field for tag, field in directory.items() if tag in PIXEL_TAGS}
    one |= {tiff.WIDTH: Field.of(4, BLOCK), tiff.LENGTH: Field.of(4, BLOCK)}
    one |= _PLACED
    one |= {tiff.TILE_OFFSETS: Field.of(4, 8), tiff.TILE_COUNTS: Field.of(4, len(data))}
    # A directory begins at an even offset, behind the header of 8 bytes and the tile.
    at = 8 + len(data) + len(data) % 2
    whole = tiff.header(at, big=False) + data + bytes(len(data) % 2) + tiff.lay_out([one], at, big=False)
    try:
        with environment(), MemoryFile(whole) as memory, memory.open() as dataset:
            values = np.empty((BLOCK, BLOCK, dataset.count), dtype=dataset.dtypes[0])
            dataset.read(out=np.moveaxis(values, -1, 0))
    except RasterioError as error:
        raise ValueError(f"a tile cannot be read ({error})") from error
    return values


def describe_raster(
    grid: Grid, profile: Mapping[str, Any], metadata: RasterMetadata, *, nodata: float | None, where: str
) -> Directory:
    """Tags that GDAL writes for a raster, without the tiles' places.

    Parameters
    ----------
    grid : Grid
    profile : mapping, see `tile_profile`
    metadata : RasterMetadata
    nodata : float or None
    where : str, named in errors

    Raises
    ------
    InputError
        GDAL refuses the creation options.
    """
    try:
        with environment(), opening(), MemoryFile() as memory:
            crs = rasterio.crs.CRS.from_wkt(grid.crs.to_wkt())
            with memory.open(**profile, crs=crs, transform=grid.transform, nodata=nodata) as dataset:
                for band, text in enumerate(metadata.descriptions, start=1):
                    if text:
                        dataset.set_band_description(band, text)
                if any(scaling != UNSCALED for scaling in metadata.scalings):
                    dataset.scales, dataset.offsets = zip(*(scaling[:2] for scaling in metadata.scalings), strict=True)
                    dataset.units = [unit or "" for _, _, unit in metadata.scalings]
                if metadata.tags:
                    dataset.update_tags(**metadata.tags)
                if profile.get("compress", "NONE").upper() != "NONE":  # only a tile shows what the codec cannot do
                    dataset.write(np.ones((profile["count"], BLOCK, BLOCK), dtype=profile["dtype"]))
            directory = tiff.read_directories(BytesIO(bytes(memory.getbuffer())))[0]
    except (RasterioError, ValueError, OSError) as error:
        raise InputError(
            f"GDAL refuses these creation options ({error.__cause__ or error})",
            where=where,
            hint="see the creation options of GDAL's GTiff driver",
        ) from error
    for tag in (tiff.TILE_OFFSETS, tiff.TILE_COUNTS):
        del directory[tag]
    return {**directory, tiff.WIDTH: Field.of(4, grid.width), tiff.LENGTH: Field.of(4, grid.height)}


# Tags of an internal mask: one bit per pixel, deflate, as GDAL makes them.
MASK_TAGS: Directory = {
    tiff.NEW_SUBFILE_TYPE: Field.of(4, 4),
    tiff.BITS: Field.of(3, 1),
    tiff.COMPRESSION: Field.of(3, 8),
    tiff.PHOTOMETRIC: Field.of(3, 4),
    tiff.SAMPLES: Field.of(3, 1),
    tiff.PLANAR: Field.of(3, 1),
    tiff.TILE_WIDTH: Field.of(3, BLOCK),
    tiff.TILE_LENGTH: Field.of(3, BLOCK),
}


def encode_mask(valid: ByteArray | None) -> bytes:
    """Compressed bytes of a mask tile, one bit per pixel.

    Parameters
    ----------
    valid : uint8 array (BLOCK, BLOCK) or None, 1 and 0; None is all ones
    """
    return _ones() if valid is None else zlib.compress(np.packbits(valid, axis=1).tobytes(), 6)


@lru_cache
def _ones() -> bytes:
    return zlib.compress(b"\xff" * (BLOCK * BLOCK // 8), 6)
