"""Sample types of mosaics: images of different depth without clipping, palette images."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomosaic.errors import InputError
from geomosaic.options.mosaic import SampleOptions
from geomosaic.options.render import SAMPLE_TYPES
from geomosaic.raster.info import SourceInfo


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
