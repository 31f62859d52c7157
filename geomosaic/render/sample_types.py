"""Sample types of mosaics: images of different depth without clipping, palette images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError
from geomosaic.raster.info import DTYPES, SourceInfo

RULES = ("keep", "range")


@dataclass(frozen=True)
class Depth:
    """Sample type of the output.

    Attributes
    ----------
    dtype : str, optional
        NumPy name; that of the images, which must all have the same, unless given.
    convert : str
        'keep' the numbers, which the type must be able to hold; 'range' brings the whole range of an unsigned type to
        that of the other: 255 of 8 bits becomes 65535 of 16 bits.
    """

    dtype: str | None = None
    convert: str = "keep"

    def __post_init__(self) -> None:
        if self.dtype is not None and self.dtype not in DTYPES:
            raise InputError(f"no sample type is named '{self.dtype}'", hint=f"one of {', '.join(DTYPES)}")
        if self.convert not in RULES:
            raise InputError(f"no conversion is named '{self.convert}'", hint=f"use {' or '.join(RULES)}")

    def scales(self, infos: Sequence[SourceInfo]) -> tuple[str, list[float]]:
        """Sample type of the output, and what the values of each image are multiplied by.

        Raises
        ------
        InputError
            Values would be lost.
        """
        first = infos[0]
        if self.dtype is None:
            for info in infos:
                if info.dtype != first.dtype:
                    raise InputError(
                        f"the image holds {info.dtype} samples, '{first.path}' holds {first.dtype}",
                        where=info.path,
                        hint=f"name one type for all: --dtype {_wider(infos)} keeps the numbers as they are; with "
                        "--convert range the whole range of each type is brought to that of the output",
                    )
            return first.dtype, [1.0] * len(infos)
        return self.dtype, [self._scale(info, self.dtype) for info in infos]

    def _scale(self, info: SourceInfo, dtype: str) -> float:
        if self.convert == "keep" or info.dtype == dtype:
            if not np.can_cast(info.dtype, dtype, "safe"):
                raise InputError(
                    f"the image holds {info.dtype} samples, and {dtype} cannot hold them all",
                    where=info.path,
                    hint=f"a wider --dtype, such as {np.result_type(info.dtype, dtype).name}, or --convert range",
                )
            return 1.0
        if np.dtype(info.dtype).kind != "u" or np.dtype(dtype).kind != "u":
            raise InputError(
                f"the range of {info.dtype} cannot be brought to that of {dtype}: only those of unsigned whole numbers",
                where=info.path,
                hint="use --convert keep, with a type that holds the values",
            )
        return float(np.iinfo(dtype).max / np.iinfo(info.dtype).max)


def _wider(infos: Sequence[SourceInfo]) -> str:
    name = np.result_type(*(info.dtype for info in infos)).name
    return name if name in DTYPES else "float64"


def refuse_palette(info: SourceInfo, resampling: str) -> None:
    """Stop before numbers of a palette are averaged.

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
            "with --resampling nearest",
        )
