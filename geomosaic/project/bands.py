"""Bands by name, and whether those of several images mean the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from geomosaic.block.scene import Scene
from geomosaic.errors import InputError, did_you_mean
from geomosaic.raster.info import SourceInfo, inspect

_COLOURS = ("red", "green", "blue")


def with_named_bands(scenes: Sequence[Scene], names: Sequence[str]) -> tuple[Scene, ...]:
    """Scenes of which the bands of these names are used, in this order; each file may have them where it will.

    Raises
    ------
    InputError
        An image has no such band, or several.
    """
    return tuple(replace(scene, bands=tuple(_number(scene.path, name) for name in names)) for scene in scenes)


def check_same_bands(scenes: Sequence[Scene]) -> None:
    """Refuse images with different numbers of bands, or with the same named bands in another order.

    Raises
    ------
    InputError
    """
    infos = [inspect(scene.path, scene.bands) for scene in scenes]
    first = infos[0]
    for scene, info in zip(scenes, infos, strict=True):
        if info.bands != first.bands:
            alpha = " besides alpha" if info.alpha or first.alpha else ""
            raise InputError(
                f"the image has {_bands(info)}{alpha}, '{scenes[0].name}' has {_bands(first)}",
                where=scene.path,
                mend="choose the same bands of all images: --bidx 1,2,3, or by name --bands red,green,blue",
            )
        mine, other = _names(info), _names(first)
        if mine != other and sorted(mine) == sorted(other):
            raise InputError(
                f"the bands are {', '.join(mine)}, those of '{scenes[0].name}' are {', '.join(other)}",
                where=scene.path,
                mend=f"--bands {','.join(other)} brings them into one order",
            )
        if (info.scales, info.offsets) != (first.scales, first.offsets):
            raise InputError(
                f"stored numbers mean other values (scale {info.scales[0]:g}, offset {info.offsets[0]:g}) than those "
                f"of '{scenes[0].name}' (scale {first.scales[0]:g}, offset {first.offsets[0]:g})",
                where=scene.path,
                mend="bring them to one scale first, for example with gdal_translate -unscale",
            )


def _number(path: str, name: str) -> int:
    info = inspect(path)
    plain = [i for i in range(1, info.bands + (info.alpha is not None) + 1) if i != info.alpha]
    wanted = name.strip().casefold()
    for known in (_descriptions(info), list(info.colors)):
        found = [number for number, own in zip(plain, known, strict=True) if own.casefold() == wanted]
        if len(found) == 1:
            return found[0]
        if found:
            raise InputError(f"several bands are called '{name}'", where=path, mend="choose by number: --bidx")
    have = [text for text in (*_descriptions(info), *(c for c in info.colors if c in _COLOURS)) if text]
    raise InputError(
        f"no band is called '{name}'",
        where=path,
        mend=did_you_mean(name, have) or (f"it has {', '.join(have)}" if have else "choose by number: --bidx"),
    )


def _descriptions(info: SourceInfo) -> list[str]:
    return [(text or "").strip() for text in info.descriptions]


def _names(info: SourceInfo) -> list[str]:
    """Descriptions where all bands have one; else colours, where they are some."""
    described = [text.casefold() for text in _descriptions(info)]
    if all(described) and len(set(described)) == len(described):
        return described
    return list(info.colors) if set(info.colors) >= set(_COLOURS) else []


def _bands(info: SourceInfo) -> str:
    return "one band" if info.bands == 1 else f"{info.bands} bands"
