"""Images of folders, sorted: files that are no pictures, copies, thumbnails, bursts and blurred photos, and why."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from geomosaic.digests import sha256
from geomosaic.errors import GeomosaicError, InputError, counted, listed
from geomosaic.raster.info import inspect, rasters_among
from geomosaic.raster.pictures import preview
from geomosaic.types import Float32Array, FloatArray

# Endings of images that belong to scenes with metadata (.dim).
SCENES = (".tif", ".tiff", ".jp2", ".ntf", ".img", ".jpg")
MOVIES = (".mov", ".mp4", ".m4v", ".avi", ".mts", ".lrv")
RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf", ".pef")
# A picture whose longer side is a smaller share of the median one is a thumbnail.
THUMBNAIL = 0.25
# Longer side, in pixels, of the copies that tell how sharp photos are; and the size of those that are held against each
# other, small enough to compare all with all, and large enough that a step of a few percent of the picture shows.
PREVIEW, SMALL = 1024, (96, 128)
# Correlation of details at one and the same place, above which two pictures were taken from one place. Photos with an
# overlap of 95 % show the same ground five small pixels apart, and do not correlate.
SAME = 0.9
# Photos that are held against others at once: memory must not grow with the square of the photos.
BLOCK = 512
# Sharpness, of the block's median, below which a photo is called blurred; and by itself, below which it is of no use:
# 1/256 is that of a picture without any fine detail. A blur of 2, 4 and 8 pixels (Gaussian, in drone photos of 12 Mpx)
# leaves 0.2, 0.04 and 0.02 of it, and 0.012 by itself; sharp photos of one block are within 0.5.
BLURRED, USELESS = 0.35, 0.015
# Share of the block's median of fine detail below which a photo shows next to nothing.
EMPTY = 0.02
# Share of the block's median of coarse detail that ground has, however blurred.
FEW = 0.03
# Variance of the Laplacian of grey values that are rounded: less is no detail.
ROUNDING = 20.0 / 12.0
# Photos without which a median says nothing of a block.
ENOUGH = 4


@dataclass(frozen=True)
class SortedImages:
    """Images that are used, those that are not, and what is to be said of them.

    Attributes
    ----------
    images : tuple of Path
    aside : mapping of Path to str
        Pictures that are not used, each with the reason; a user may take them back.
    lines : tuple of str
        For people.
    loose : frozenset of Path
        Images that were found in a folder, and not named one by one.
    """

    images: tuple[Path, ...]
    aside: Mapping[Path, str] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    loose: frozenset[Path] = frozenset()

    def without(self, aside: Mapping[Path, str], lines: Iterable[str] = ()) -> SortedImages:
        """Sorted images with some more of them set aside."""
        kept = tuple(path for path in self.images if path not in aside)
        said = tuple(f"  set aside {path.name}: {why}" for path, why in aside.items())
        return SortedImages(kept, {**self.aside, **aside}, (*self.lines, *said, *lines), self.loose)


def images_of(paths: Sequence[Path], others: Collection[Path] = ()) -> SortedImages:
    """Image files of the paths that were named.

    A folder stands for the images in it, where it has none for those in the folders in it; that of a scene for the
    scene's images alone, a DIMAP file (.dim) for its image.

    Parameters
    ----------
    paths : sequence of Path
    others : collection of Path
        Files with another role, which no folder gives as images.

    Returns
    -------
    SortedImages
        Each once, in the order given; those of folders that cannot be read, copies and thumbnails are set aside.

    Raises
    ------
    InputError
        A folder or a metadata file has no image.
    """
    found: dict[Path, None] = {}
    loose: list[Path] = []
    lines: list[str] = []
    known = {path.resolve() for path in others}
    for path in paths:
        if path.is_dir():
            images, said = _in_folder(path, known)
            loose += images
            lines += said
        elif path.suffix.lower() == ".dim":
            near = [path.with_suffix(suffix) for suffix in SCENES]
            images = [file for file in near if file.is_file()] or _images_in_scene(path.parent)
        else:
            images = [path]
        if not images:
            remark = f" ({'; '.join(line.strip() for line in lines)})" if lines and path.is_dir() else ""
            raise InputError(
                "there is metadata, but no image" if path.is_file() else f"the folder has no image{remark}",
                where=str(path),
                hint="name the image that belongs to it; its metadata is found beside it"
                if path.is_file()
                else "name a folder with photos (JPEG, TIFF, PNG ...)",
            )
        found.update(dict.fromkeys(images))
    every = SortedImages(tuple(found), {}, tuple(lines), frozenset(loose))
    return _readable(every) if loose else every


def _images_in_scene(folder: Path) -> list[Path]:
    """Images of a scene's folder by the names its producer gives them, IMAGERY*."""
    return [file for file in sorted(folder.glob("IMAGERY*")) if file.suffix.lower() in SCENES]


def _in_folder(folder: Path, known: Collection[Path]) -> tuple[list[Path], list[str]]:
    """Images of a folder by their endings, and what is to be said of its other files."""
    files = [file for file in sorted(folder.iterdir()) if file.is_file() and file.name[0] != "."]
    files = [file for file in files if file.resolve() not in known]
    # Scenes come with quicklooks and masks as rasters too: images with a producer's name leave out all others. Cameras
    # call their photos IMG_ as well.
    if any(file.suffix.lower() == ".dim" or file.name.upper().startswith("DIM_") for file in files):
        scenes = [file for file in files if file.stem.upper().startswith(("IMAGERY", "IMG_"))]
        scenes = [file for file in scenes if file.suffix.lower() in SCENES]
        if scenes:
            return scenes, []
    plain = [file for file in files if file.suffix.lower() not in (*MOVIES, *RAW)]
    images, unknown = rasters_among(plain)
    lines = []
    movies = [file.name for file in files if file.suffix.lower() in MOVIES]
    if movies:
        lines.append(
            f"  left out {counted(len(movies), 'movie')}: {listed(movies, 3)}; take single pictures out of them"
        )
    stems = {file.stem for file in images}
    raw = [file.name for file in files if file.suffix.lower() in RAW and file.stem not in stems]
    if raw:
        lines.append(f"  left out {counted(len(raw), 'raw photo')}: {listed(raw, 3)}; develop them to TIFF or JPEG")
    if unknown:
        names = listed((file.name for file in unknown), 3)
        what = "1 file that is no image" if len(unknown) == 1 else f"{len(unknown)} files that are no images"
        lines.append(f"  left out {what}: {names}")
    within = [entry for entry in sorted(folder.iterdir()) if entry.is_dir() and entry.name[0] != "."]
    if images and within:
        lines.append(f"  not looked into: {listed((f'{entry.name}/' for entry in within), 3)}")
    if not images:
        # As cameras write them: DCIM/100MEDIA, DCIM/101MEDIA.
        for entry in within:
            inner, said = _in_folder(entry, known)
            images += inner
            lines += said
    return images, lines


def _readable(found: SortedImages) -> SortedImages:
    """Images of folders without those that cannot be read, copies of others, and thumbnails."""
    aside: dict[Path, str] = {}
    sizes: dict[Path, tuple[int, int]] = {}
    for path in found.images:
        try:
            sizes[path] = inspect(path).size
        except GeomosaicError:
            if path not in found.loose:
                raise
            aside[path] = _unreadable(path)
    for path, original in _copies([path for path in found.images if path in sizes]).items():
        if path in found.loose:
            aside[path] = f"the same file as {original.name}"
    rest = [path for path in found.images if path not in aside]
    usual = float(np.median([max(sizes[path]) for path in rest])) if rest else 0.0
    for path in rest:
        if path in found.loose and max(sizes[path]) < THUMBNAIL * usual:
            width, height = sizes[path]
            aside[path] = f"{width} x {height} pixels, a thumbnail beside the others"
    if len(aside) == len(found.images):
        why = listed((f"{path.name}: {text}" for path, text in aside.items()), 3, "; ")
        raise InputError(f"no image of the folder can be read ({why})", hint="copy the photos again from the camera")
    return found.without(aside)


def _unreadable(path: Path) -> str:
    """Why a file with the ending of an image is none."""
    with path.open("rb") as file:
        first = file.read(16)
    if not first:
        return "the file is empty"
    if first[4:8] in (b"ftyp", b"moov", b"mdat", b"wide") or first[8:11] == b"AVI":
        return "a movie, whatever its name says; take single pictures out of it"
    return "it cannot be read as an image"


def _copies(paths: Sequence[Path]) -> dict[Path, Path]:
    """Files with the content of another, each with the first that has it."""
    length = {path: path.stat().st_size for path in paths}
    several = {size for size, count in Counter(length.values()).items() if count > 1}
    first: dict[str, Path] = {}
    found = {}
    for path in paths:
        if length[path] in several:
            original = first.setdefault(sha256(path), path)
            if original != path:
                found[path] = original
    return found


@dataclass(frozen=True, eq=False)
class _Sharpness:
    """What the pixels of a photo tell: its details in a small copy, and how strong fine and coarse detail is."""

    details: Float32Array
    strength: float
    coarse: float

    @property
    def sharpness(self) -> float:
        """Fine against coarse detail: ground without contrast, such as water, is not blurred for that."""
        return self.strength / self.coarse if self.coarse > 0.0 else 0.0


def sort_photos(found: SortedImages, tagged: Collection[Path] = ()) -> SortedImages:
    """Photos without those that show what another shows from the same place, and without hopelessly blurred ones.

    Parameters
    ----------
    found : SortedImages
        Those that were named one by one stay.
    tagged : collection of Path
        Photos whose tags tell something: of two copies they are the better ones.

    Returns
    -------
    SortedImages
        `lines` name photos that are blurred or show next to nothing, too.
    """
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        looks = dict(zip(found.images, pool.map(_look, found.images), strict=True))
    aside = {path: "its pixels are damaged" for path, look in looks.items() if look is None and path in found.loose}
    seen = {path: look for path, look in looks.items() if look is not None}
    aside |= {path: why for path, why in _again(seen, tagged).items() if path in found.loose}
    rest = {path: look for path, look in seen.items() if path not in aside}
    if len(rest) < ENOUGH:
        return found.without(aside)
    strength = float(np.median([look.strength for look in rest.values()]))
    sharpness = float(np.median([look.sharpness for look in rest.values()]))
    coarse = float(np.median([look.coarse for look in rest.values()]))
    blurred, empty = [], []
    for path, look in rest.items():
        # Blurred ground has its coarse detail still, and water has none.
        detailed = look.coarse > FEW * coarse
        if detailed and look.sharpness < min(USELESS, BLURRED * sharpness) and path in found.loose:
            aside[path] = "blurred beyond use"
        elif detailed and look.sharpness < BLURRED * sharpness:
            blurred.append(path.name)
        elif look.strength < EMPTY * strength:
            empty.append(path.name)
    lines = []
    if blurred:
        lines.append(f"  blurred beside the others, and kept: {listed(blurred, 6)}")
    if empty:
        lines.append(f"  with next to no detail (water, clouds, fog, or blurred), and kept: {listed(empty, 6)}")
    return found.without(aside, lines)


def _look(path: Path) -> _Sharpness | None:
    """What the pixels of a photo tell; None where they are damaged."""
    try:
        rgb, _ = preview(path, PREVIEW)
    except GeomosaicError:
        return None
    grey = rgb.mean(axis=2, dtype=np.float64)
    strength = max(0.0, _roughness(grey) - ROUNDING)
    # Means of sixteen pixels are rounded by a sixteenth of it.
    coarse = max(0.0, _roughness(_halved(_halved(grey))) - ROUNDING / 16.0) if min(grey.shape) >= 16 else 0.0
    small = _resized(grey, SMALL)
    # Between 3 and 9 small pixels: vignetting is coarser, and copies of other sizes differ in what is finer.
    details = (_box(small, 3)[3:-3, 3:-3] - _box(small, 9)).ravel()
    norm = float(np.linalg.norm(details))
    return _Sharpness((details / norm if norm > 0.0 else details).astype(np.float32), strength, coarse)


def _box(grey: FloatArray, side: int) -> FloatArray:
    """Means of `side` x `side` pixels, where all of them are within the picture."""
    inside: FloatArray = sliding_window_view(grey, (side, side)).mean(axis=(2, 3))
    return inside


def _roughness(grey: FloatArray) -> float:
    """Variance of the Laplacian."""
    inner = grey[1:-1, 1:-1]
    return float((grey[:-2, 1:-1] + grey[2:, 1:-1] + grey[1:-1, :-2] + grey[1:-1, 2:] - 4.0 * inner).var())


def _halved(grey: FloatArray) -> FloatArray:
    """Means of 2 x 2 pixels."""
    rows, cols = grey.shape[0] // 2, grey.shape[1] // 2
    halved: FloatArray = grey[: 2 * rows, : 2 * cols].reshape(rows, 2, cols, 2).mean(axis=(1, 3))
    return halved


def _resized(grey: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Means over cells, `shape` of them whatever the shape of the picture."""
    rows, cols = (
        np.linspace(0, count, wanted + 1).astype(int)[:-1] for count, wanted in zip(grey.shape, shape, strict=True)
    )
    rows, cols = np.minimum(rows, grey.shape[0] - 1), np.minimum(cols, grey.shape[1] - 1)
    sums = np.add.reduceat(np.add.reduceat(grey, rows, axis=0), cols, axis=1)
    count = np.outer(np.diff([*rows, grey.shape[0]]), np.diff([*cols, grey.shape[1]]))
    mean: FloatArray = sums / np.maximum(count, 1)
    return mean


def _again(looks: Mapping[Path, _Sharpness], tagged: Collection[Path]) -> dict[Path, str]:
    """Photos that show what a better one shows from the same place, and which."""
    paths = list(looks)
    if len(paths) < 2:
        return {}
    similar = _similar_photos([looks[path].details for path in paths])
    # The best first: of copies of several sizes the largest, those with tags before edited ones, else the sharpest.
    size = [max(inspect(path).size) for path in paths]
    known = [path in tagged for path in paths]
    order = sorted(range(len(paths)), key=lambda i: (-size[i], not known[i], -looks[paths[i]].strength))
    kept: dict[int, int] = {}
    found = {}
    for i in order:
        better = min((j for j in similar[i] if j in kept), key=kept.__getitem__, default=None)
        if better is None:
            kept[i] = len(kept)
            continue
        name = paths[better].name
        if size[i] < size[better]:
            found[paths[i]] = f"a reduced copy of {name}"
        elif known[better] and not known[i]:
            found[paths[i]] = f"a copy of {name} without its tags"
        else:
            found[paths[i]] = f"it shows from the same place what {name} shows sharper"
    return {path: found[path] for path in paths if path in found}


def _similar_photos(details: Sequence[Float32Array]) -> list[list[int]]:
    """Numbers of the other photos that were taken from the same place, of each."""
    similar: list[list[int]] = [[] for _ in details]
    blocks = [slice(first, first + BLOCK) for first in range(0, len(details), BLOCK)]
    for number, rows in enumerate(blocks):
        block = np.stack(details[rows])
        for cols in blocks[number:]:
            one, other = np.nonzero(block @ (block if cols == rows else np.stack(details[cols])).T > SAME)
            for i, j in zip((one + rows.start).tolist(), (other + cols.start).tolist(), strict=True):
                if i < j:
                    similar[i].append(j)
                    similar[j].append(i)
    return similar
