"""Precedence of images: which comes first where several show the ground, by sensor, date, resolution or cloud."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import date, datetime

from geomosaic.block import Footprint, OrientedBlock, OrientedImage
from geomosaic.errors import InputError, did_you_mean, listed, warn
from geomosaic.options.mosaic import MosaicOptions, RuleOptions
from geomosaic.raster.band_names import is_panchromatic, plain_bands
from geomosaic.raster.image_metadata import acquisition_digits, recorded_cloud_cover
from geomosaic.raster.info import SourceInfo

# Days in a year, for the distance of two days of the year.
YEAR = 365.2425


def image_ranks(scenes: Sequence[OrientedImage], outlines: Sequence[Footprint], rule: RuleOptions) -> list[int]:
    """Rank of each image, 0 for those that come first; images of one rank are equals.

    Parameters
    ----------
    scenes : sequence of OrientedImage
    outlines : sequence of Footprint
        Of the scenes, with their ground sampling distance.
    rule : RuleOptions
        Its criteria, day, base and treatment of panchromatic images.

    Returns
    -------
    list of int

    Raises
    ------
    InputError
        An image does not say when it was taken, or how much of it is cloud; or there is no image of the base's name.
    """
    keys = list(zip(_lowest(scenes, rule), _keys(scenes, outlines, rule), strict=True))
    rank = {key: place for place, key in enumerate(sorted(set(keys)))}
    return [rank[key] for key in keys]


def image_order(scenes: Sequence[OrientedImage], outlines: Sequence[Footprint], rule: RuleOptions) -> list[int]:
    """Numbers of the images, the uppermost first; equals as given, or with `rule.rule` 'last' all the other way round.

    Parameters
    ----------
    scenes, outlines, rule
        As of `image_ranks`.

    Returns
    -------
    list of int

    Raises
    ------
    InputError
        As `image_ranks`.
    """
    keys, lowest = _keys(scenes, outlines, rule), _lowest(scenes, rule)
    order = sorted(range(len(scenes)), key=keys.__getitem__)
    if rule.rule == "last":
        order.reverse()
    # What lies lowest does so whichever of the others comes first; sorts are stable.
    return sorted(order, key=lowest.__getitem__)


def filling_ranks(
    scenes: Sequence[OrientedImage], outlines: Sequence[Footprint], options: MosaicOptions
) -> Sequence[int]:
    """Ranks by which images fill the gaps that others leave; with seams 'order' no two are equals.

    Parameters
    ----------
    scenes : sequence of OrientedImage
    outlines : sequence of Footprint
    options : MosaicOptions

    Returns
    -------
    sequence of int
        Empty where all are equals.
    """
    ranks = image_ranks(scenes, outlines, options.merge)
    if options.seamlines.seams == "order":
        ranks = [0] * len(scenes)
        for place, i in enumerate(image_order(scenes, outlines, options.merge)):
            ranks[i] = place
    return ranks if any(ranks) else ()


def _keys(
    scenes: Sequence[OrientedImage], outlines: Sequence[Footprint], rule: RuleOptions
) -> list[tuple[float | str, ...]]:
    if "sensor" in rule.order and len({scene.group for scene in scenes}) == 1:
        hint = "give each sensor a block of its own, in a project a table [[images]], or another `order`"
        raise InputError("`order=sensor` would do nothing: all images are of one block", hint=hint)
    criteria = [_criterion(name, scenes, outlines, rule.day) for name in rule.order]
    return [tuple(key(i) for key in criteria) for i in range(len(scenes))]


def _lowest(scenes: Sequence[OrientedImage], rule: RuleOptions) -> list[int]:
    """2 for the base image, 1 for images that only fill, 0 for all others."""
    base = None if rule.base is None else image_index(rule.base, scenes)
    filling = filling_images(scenes, rule)
    return [2 if i == base else int(i in filling) for i in range(len(scenes))]


def _criterion(
    name: str, scenes: Sequence[OrientedImage], outlines: Sequence[Footprint], day: str | None
) -> Callable[[int], float | str]:
    """Key of an image by its number, the smaller the earlier it comes."""
    if name == "list":
        # With seams, the default order makes no difference between images.
        return lambda i: 0.0
    if name == "name":
        return lambda i: scenes[i].name
    if name == "sensor":
        return lambda i: scenes[i].group
    if name == "resolution":
        # Six digits: the same pixel size, computed at different places, must be equal.
        return lambda i: float(f"{outlines[i].sampling:.6g}")
    if name == "cloud":
        return lambda i: cloud_cover(scenes[i])
    if name == "season":
        return lambda i: _days_between_seasons(_acquisition(scenes[i]).date(), _day(day or ""))
    if name == "day":
        return lambda i: abs((_acquisition(scenes[i]).date() - _day(day or "")).days)
    sign = -1.0 if name == "date" else 1.0
    return lambda i: sign * (_acquisition(scenes[i]) - datetime.min).total_seconds()


def _day(text: str) -> date:
    return date.fromisoformat(text if len(text) > len("07-15") else f"2000-{text}")


def _days_between_seasons(one: date, other: date) -> float:
    """Days between two days of the year, whatever their years: at most half a year."""
    apart = abs(one.timetuple().tm_yday - other.timetuple().tm_yday)
    return min(apart, YEAR - apart)


def _acquisition(scene: OrientedImage) -> datetime:
    """Time of acquisition, as declared, else as the file says; without its time zone."""
    digits = scene.acquired.replace("-", "").ljust(14, "0") if scene.acquired else acquisition_digits(scene.path)
    if digits is not None:
        try:
            return datetime.strptime(digits, "%Y%m%d%H%M%S")
        except ValueError:  # zeros, or other digits that are no time
            pass
    raise InputError(
        "the image does not say when it was taken",
        where=scene.path,
        hint="give `acquired` for it, such as 1985-07-12, write the tag TIFFTAG_DATETIME, or choose another `order`",
    )


def cloud_cover(scene: OrientedImage) -> float:
    """Percentage of an image that is cloud: as declared, else by its cloud mask, else as the file says.

    Parameters
    ----------
    scene : OrientedImage

    Raises
    ------
    InputError
        Nothing says it.
    """
    if scene.cloud_cover is not None:
        return scene.cloud_cover
    found = recorded_cloud_cover(scene.path) if scene.clouds is None else scene.clouds.share()
    if found is None:
        raise InputError(
            "the image does not say how much of it is cloud",
            where=scene.path,
            hint="give `cloud_cover` or `clouds` for it, or choose another `order`",
        )
    return found


def image_index(name: str, scenes: Sequence[OrientedImage], where: str = "`base`", hint: str = "") -> int:
    """Number of the image of a name, with or without its suffix.

    Parameters
    ----------
    name : str
    scenes : sequence of OrientedImage
    where : str
        Option that names the image, for the error.
    hint : str
        Added to the error's hint.

    Returns
    -------
    int

    Raises
    ------
    InputError
        No image, or several, of that name.
    """
    names = [scene.name for scene in scenes]
    found = [i for i, own in enumerate(names) if own == name] or [
        i for i, own in enumerate(names) if own.rpartition(".")[0] == name
    ]
    if len(found) != 1:
        meant = did_you_mean(name, names)
        raise InputError(
            f"{'several images are' if found else 'no image is'} called '{name}'",
            where=where,
            hint=f"{meant or f'name one of the images, such as {names[0]}'}{hint}",
        )
    return found[0]


def filling_images(scenes: Sequence[OrientedImage], rule: RuleOptions) -> set[int]:
    """Numbers of the panchromatic images that show only what no image of several bands does.

    Parameters
    ----------
    scenes : sequence of OrientedImage
        With bands of equal number, see `with_panchromatic`.
    rule : RuleOptions
    """
    if rule.panchromatic != "fill":
        return set()
    return {i for i, scene in enumerate(scenes) if is_grey(scene)}


def is_grey(scene: OrientedImage) -> bool:
    """Whether an image shows its one band in all of several.

    Parameters
    ----------
    scene : OrientedImage
    """
    return scene.bands is not None and len(scene.bands) > 1 and len(set(scene.bands)) == 1


def with_panchromatic(block: OrientedBlock, infos: Sequence[SourceInfo], options: MosaicOptions) -> OrientedBlock:
    """Block whose images of one band beside those of several show it in all bands alike.

    Parameters
    ----------
    block : OrientedBlock
    infos : sequence of SourceInfo
        Of the bands of its images.
    options : MosaicOptions

    Returns
    -------
    OrientedBlock
        The same one where all images have as many bands, or where bands differ otherwise.

    Raises
    ------
    InputError
        They are refused, or the rule would mix them with images that they shall only supplement.

    Warns
    -----
    GeomosaicWarning
        Names them, and what they show.
    """
    most, rule = max(info.bands for info in infos), options.merge
    single = [scene.name for scene, info in zip(block.scenes, infos, strict=True) if info.bands == 1]
    others = any(info.bands not in (1, most) or (info.bands == 1 and not is_panchromatic(info)) for info in infos)
    if most == 1 or not single or others:
        return block
    if rule.panchromatic == "refuse":
        what = f"the image has one band, others have {most}"
        raise InputError(what, where=single[0], hint="leave it out, or choose `panchromatic`")
    mixing = rule.rule not in (None, "first", "last", "count")
    if rule.panchromatic == "fill" and mixing:
        raise InputError(
            f"`rule={rule.rule}` mixes all images, and '{single[0]}' has one band where others have {most}",
            hint="leave it out, or give `panchromatic=mix`",
        )
    where = "where no image of several bands shows the ground" if rule.panchromatic == "fill" else "like the others"
    warn(f"{listed(single, 5)}: one band beside images of {most}, shown in all bands alike, {where}")
    scenes = tuple(
        replace(scene, bands=(scene.bands or (plain_bands(info)[0],)) * most) if info.bands == 1 else scene
        for scene, info in zip(block.scenes, infos, strict=True)
    )
    return replace(block, scenes=scenes)
