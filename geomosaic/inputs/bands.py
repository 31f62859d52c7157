"""Bands of images of one or several sensors: chosen by number, name or wavelength, and checked to be the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from geomosaic.block import OrientedImage
from geomosaic.errors import InputError, counted
from geomosaic.inputs.declarations import Block
from geomosaic.raster.band_names import band_number, is_panchromatic, names_of_bands, plain_bands, wavelength_of
from geomosaic.raster.info import SourceInfo, inspect


def bands_by_name(inputs: Block, path: Path, names: Sequence[str]) -> tuple[int, ...]:
    """Bands of an image by name or wavelength, whatever their order in its file.

    Parameters
    ----------
    inputs : Block
        What it declares of the bands of its files comes before what they say.
    path : Path
        The image.
    names : sequence of str

    Returns
    -------
    tuple of int
        Counted from 1, in the order of the names; the only band of a panchromatic image.

    Raises
    ------
    InputError
        The image has no band of a name, or several.
    """
    info = _as_declared(inputs, inspect(path))
    if is_panchromatic(info) and len(names) > 1:
        return (plain_bands(info)[0],)
    return tuple(band_number(info, str(path), name) for name in names)


def _as_declared(inputs: Block, info: SourceInfo) -> SourceInfo:
    """Metadata of an image with the names or wavelengths of bands that its block declares."""
    names = inputs.declared_bands
    if names is None:
        return info
    if len(names) != info.bands:
        what = f"`declared_bands` names {counted(len(names), 'band')}, the file has {counted(info.bands, 'band')}"
        raise InputError(what, where=info.path, hint="name each band of the file once, in its order")
    given = [wavelength_of(name) for name in names]
    described = tuple(None if value is not None else name for name, value in zip(names, given, strict=True))
    return replace(info, descriptions=described, wavelengths=tuple(given), colors=("undefined",) * info.bands)


def check_same_bands(scenes: Sequence[OrientedImage], infos: Sequence[SourceInfo]) -> None:
    """Check that images have the same bands: number, order of names, scale and offset of values.

    Parameters
    ----------
    scenes : sequence of OrientedImage
    infos : sequence of SourceInfo
        Of their bands.

    Raises
    ------
    InputError
        Names an image that differs from the first one.
    """
    first = infos[0]
    for scene, info in zip(scenes, infos, strict=True):
        if info.bands != first.bands:
            alpha = " besides alpha" if info.alpha or first.alpha else ""
            raise InputError(
                f"the image has {counted(info.bands, 'band')}{alpha}, '{scenes[0].name}' has "
                f"{counted(first.bands, 'band')}",
                where=scene.path,
                hint="choose the same bands of all images: `bands=1,2,3`, or by name `band_names=red,green,blue`",
            )
        mine, other = names_of_bands(info), names_of_bands(first)
        if mine != other and sorted(mine) == sorted(other):
            raise InputError(
                f"the bands are {', '.join(mine)}, those of '{scenes[0].name}' are {', '.join(other)}",
                where=scene.path,
                hint=f"`band_names={','.join(other)}` brings them into one order",
            )
        if (info.scales, info.offsets) != (first.scales, first.offsets):
            raise InputError(
                f"stored numbers stand for other values (scale {info.scales[0]:g}, offset {info.offsets[0]:g}) than "
                f"those of '{scenes[0].name}' (scale {first.scales[0]:g}, offset {first.offsets[0]:g})",
                where=scene.path,
                hint="bring them to one scale first, for example with gdal_translate -unscale",
            )
