"""Bands of a raster by name or wavelength.

A name is looked for among the descriptions and colours in the file, then among the wavelengths of its bands, by the
ranges of the common band names of the STAC extension EO 1.0.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from geomosaic.errors import InputError, did_you_mean, listed
from geomosaic.raster.info import SourceInfo

COLOURS = ("red", "green", "blue")
# Micrometres: ranges of central wavelengths by common name.
COMMON_RANGES = {
    "coastal": (0.40, 0.45), "blue": (0.45, 0.50), "green": (0.50, 0.60), "yellow": (0.58, 0.62), "red": (0.60, 0.70),
    "rededge": (0.70, 0.79), "nir": (0.75, 1.00), "nir08": (0.75, 0.90), "nir09": (0.85, 1.05), "cirrus": (1.35, 1.40),
    "swir16": (1.55, 1.75), "swir22": (2.10, 2.30), "lwir": (10.5, 12.5), "lwir11": (10.5, 11.5),
    "lwir12": (11.5, 12.5),
}  # fmt: skip
PANCHROMATIC = ("pan", "panchromatic")
# Part of a wavelength by which the band that stands for it may differ: red of Landsat 8 is at 655 nm, of SPOT 5 at 645.
NEAR = 0.05


def wavelength_of(name: str) -> float | None:
    """Wavelength that is given in place of a band's name, nanometres.

    Parameters
    ----------
    name : str
        Such as '665nm' or '0.665um'.

    Returns
    -------
    float or None
        None where it is a name.
    """
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*(nm|um|µm)\s*", name, re.IGNORECASE)
    return float(found[1]) * (1.0 if found[2].lower() == "nm" else 1e3) if found else None


def plain_bands(info: SourceInfo) -> list[int]:
    """Numbers of the bands of a file but alpha, from 1.

    Parameters
    ----------
    info : SourceInfo
        Of all its bands.
    """
    return [number for number in range(1, info.bands + (info.alpha is not None) + 1) if number != info.alpha]


def is_panchromatic(info: SourceInfo) -> bool:
    """Whether an image has one band that nothing says to be of one colour.

    Parameters
    ----------
    info : SourceInfo
    """
    if info.bands != 1:
        return False
    described = {text.casefold() for text in _descriptions(info)}
    named = {*described, *info.colors} & {*COMMON_RANGES, "palette"}
    narrow = info.wavelengths[0] is not None and not described & {*PANCHROMATIC}
    return not named and not narrow


def band_number(info: SourceInfo, path: str, name: str) -> int:
    """Number of the band of a name or a wavelength, from 1.

    Parameters
    ----------
    info : SourceInfo
        Of all its bands.
    path : str
        The file, for errors.
    name : str
        Description or colour of a band, a common name, or a wavelength such as '842nm'.

    Raises
    ------
    InputError
        There is none, or there are several.
    """
    plain, wanted, wavelength = plain_bands(info), name.strip().casefold(), wavelength_of(name)
    if wavelength is None:
        for known in (_descriptions(info), list(info.colors)):
            found = [number for number, own in zip(plain, known, strict=True) if own.casefold() == wanted]
            if len(found) == 1:
                return found[0]
            if found:
                raise InputError(f"several bands are called '{name}'", where=path, hint="choose by number: `bands`")
    at = [(number, value) for number, value in zip(plain, info.wavelengths, strict=True) if value is not None]
    if wavelength is not None:
        near = [(abs(value - wavelength), number) for number, value in at if abs(value / wavelength - 1.0) <= NEAR]
        return min(near)[1] if near else _by_common_name(info, plain, path, name, wavelength)
    if wanted in COMMON_RANGES:
        low, high = COMMON_RANGES[wanted]
        within = [(number, value) for number, value in at if low <= value / 1e3 <= high]
        if len(within) == 1:
            return within[0][0]
        if within:
            shown = listed([f"{value:g}nm" for _, value in within], 4)
            raise InputError(
                f"several bands could be '{name}': {shown}",
                where=path,
                hint=f"choose by wavelength: {within[0][1]:g}nm",
            )
    raise _absent(info, path, name)


def _by_common_name(info: SourceInfo, plain: Sequence[int], path: str, name: str, wavelength: float) -> int:
    """Number of the band whose common name has a wavelength in its range, of an image that tells no wavelengths."""
    names = [key for key, (low, high) in COMMON_RANGES.items() if low <= wavelength / 1e3 <= high]
    for known in (_descriptions(info), list(info.colors)):
        found = [number for number, own in zip(plain, known, strict=True) if own.casefold() in names]
        if len(found) == 1 and all(value is None for value in info.wavelengths):
            return found[0]
    raise _absent(info, path, name)


def _absent(info: SourceInfo, path: str, name: str) -> InputError:
    """Error of an image without a band of some name or wavelength."""
    have = [text for text in (*_descriptions(info), *(c for c in info.colors if c in COLOURS)) if text]
    have += [f"{value:g}nm" for value in info.wavelengths if value is not None]
    if not have:
        hint = "choose by number: `bands`; or say what the bands are: `declared_bands`"
    else:
        hint = "" if wavelength_of(name) else did_you_mean(name, have)
        hint = hint or f"it has {', '.join(dict.fromkeys(have))}"
    return InputError(f"no band is called '{name}'", where=path, hint=hint)


def _descriptions(info: SourceInfo) -> list[str]:
    return [(text or "").strip() for text in info.descriptions]


def names_of_bands(info: SourceInfo) -> list[str]:
    """Names of bands: descriptions where all bands have one, else colours; empty where there are neither.

    Parameters
    ----------
    info : SourceInfo
    """
    described = [text.casefold() for text in _descriptions(info)]
    if all(described) and len(set(described)) == len(described):
        return described
    return list(info.colors) if set(info.colors) >= set(COLOURS) else []
