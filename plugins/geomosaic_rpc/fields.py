"""RPC from the numbers of any format, and the pixel origin of every format in one table."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.metadata import finite_number
from geomosaic_rpc.coefficients import COUNT, Rpc

FIRST_PIXEL: Mapping[str, float | None] = {
    "GDAL": 0.0,
    "RPC.TXT": 0.0,
    "RPB": 0.0,
    "DigitalGlobe XML": 0.0,
    "DIMAP PHR_SENSOR": 1.0,
    "DIMAP S6_SENSOR": 1.0,
    "DIMAP S7_SENSOR": 1.0,
    "DIMAP PNEO_SENSOR": 0.0,
    "DIMAP": None,
    "OSSIM": 0.0,
}
"""What each format calls the centre of the upper-left pixel, in columns and rows; None where that is not known."""

SCALARS = (
    "LINE_OFF", "SAMP_OFF", "LAT_OFF", "LONG_OFF", "HEIGHT_OFF",
    "LINE_SCALE", "SAMP_SCALE", "LAT_SCALE", "LONG_SCALE", "HEIGHT_SCALE",
)  # fmt: skip
POLYNOMIALS = ("SAMP_NUM_COEFF", "SAMP_DEN_COEFF", "LINE_NUM_COEFF", "LINE_DEN_COEFF")
"""In the order of `Rpc.coefficients`."""

_MEND = "check that the file is whole; export the RPC again, or write it as an _RPC.TXT file"


@dataclass(frozen=True)
class RpcFields:
    """An RPC as it stands in a file.

    Attributes
    ----------
    format : str
        A key of `FIRST_PIXEL`.
    numbers : mapping
        The ten scalars, and ERR_BIAS and ERR_RAND where given.
    polynomials : mapping
        Twenty coefficients each of `POLYNOMIALS`.
    """

    format: str
    numbers: Mapping[str, float]
    polynomials: Mapping[str, Sequence[float]]

    def rpc(self, where: str, first_pixel: float | None = None) -> Rpc:
        """Coefficients in geomosaic's pixels: counted from the outer corner of the upper-left pixel.

        Parameters
        ----------
        where : str
            Named in errors.
        first_pixel : float, optional
            What the file calls the centre of the first pixel; that of the format unless given.

        Raises
        ------
        InputError
            Something is missing, or no map can be made of it.
        """
        missing = [name for name in SCALARS if name not in self.numbers]
        missing += [name for name in POLYNOMIALS if name not in self.polynomials]
        if missing:
            raise InputError(f"the RPC has no {', '.join(missing)}", where=where, hint=_MEND)
        for name in POLYNOMIALS:
            if len(self.polynomials[name]) != COUNT:
                raise InputError(
                    f"the RPC has {len(self.polynomials[name])} numbers in {name}, not {COUNT}", where=where, hint=_MEND
                )
            if "DEN" in name and self.polynomials[name][0] == 0.0:
                raise InputError(f"the first number of {name} is 0: nothing can be divided by it", where=where)
        of = self.numbers
        flat = [name for name in SCALARS if name.endswith("SCALE") and of[name] == 0.0]
        if flat:
            raise InputError(f"{', '.join(flat)} of the RPC is 0", where=where, hint=_MEND)
        every = [*of.values(), *(c for name in POLYNOMIALS for c in self.polynomials[name])]
        if not np.isfinite(every).all():
            raise InputError("the RPC has a number that is not finite", where=where, hint=_MEND)
        if abs(of["LAT_OFF"]) > 90.0 or abs(of["LONG_OFF"]) > 360.0:
            raise InputError(
                f"LAT_OFF {of['LAT_OFF']}, LONG_OFF {of['LONG_OFF']} is no place on the Earth in degrees", where=where
            )
        first = FIRST_PIXEL[self.format] if first_pixel is None else first_pixel
        if first is None:
            raise InputError(
                "nothing says how this product counts its pixels: its METADATA_PROFILE is not known",
                where=where,
                hint="say what its RPC calls the centre of the first pixel: first_pixel = 0, or 1 as Pleiades",
            )
        errors = (of["ERR_BIAS"], of["ERR_RAND"]) if {"ERR_BIAS", "ERR_RAND"} <= set(of) else None
        return Rpc(
            # The centre of the first pixel is (0.5, 0.5) here, `first` in the file.
            np.array([of["SAMP_OFF"], of["LINE_OFF"]]) + 0.5 - first,
            np.array([of["SAMP_SCALE"], of["LINE_SCALE"]]),
            np.array([of["LONG_OFF"], of["LAT_OFF"], of["HEIGHT_OFF"]]),
            np.array([of["LONG_SCALE"], of["LAT_SCALE"], of["HEIGHT_SCALE"]]),
            np.array([self.polynomials[name] for name in POLYNOMIALS]),
            errors if errors is not None and min(errors) >= 0.0 and max(errors) > 0.0 else None,
        )


def number(text: str, name: str, where: str) -> float:
    """Finite number of a text.

    Parameters
    ----------
    text : str
        Digits, signs, point and exponent only.
    name : str
        Name of the number, for the message.
    where : str
        Named in errors.

    Returns
    -------
    float

    Raises
    ------
    InputError
        The text is no finite number.
    """
    # Python's own numbers may have underscores and blanks, which no RPC file has.
    value = finite_number(text) if re.fullmatch(r"[-+0-9.eE]{1,60}", text) else math.nan
    if math.isnan(value):
        raise InputError(f"{name} is '{text[:40]}', not a finite number of a sensible size", where=where, hint=_MEND)
    return value


def numbered(found: Mapping[str, str], first: int, digits: int, where: str) -> dict[str, list[float]]:
    """Polynomials whose coefficients stand one by one, as NAME_1 ... NAME_20 or NAME_00 ... NAME_19.

    Parameters
    ----------
    found : mapping
        Texts by key.
    first : int
        Number of the first coefficient, 0 or 1.
    digits : int
        Least digits of the number in the key.
    where : str
        Named in errors.

    Returns
    -------
    dict of list
        Twenty numbers each of `POLYNOMIALS`.

    Raises
    ------
    InputError
        A coefficient is missing or no number.
    """
    out = {}
    for name in POLYNOMIALS:
        keys = [f"{name}_{first + i:0{digits}d}" for i in range(COUNT)]
        absent = [key for key in keys if key not in found]
        if absent:
            raise InputError(f"the RPC has no {absent[0]}", where=where, hint=_MEND)
        out[name] = [number(found[key], key, where) for key in keys]
    return out
