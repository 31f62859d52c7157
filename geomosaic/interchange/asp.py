"""Matches and adjustments of the Ames Stereo Pipeline: LEFT__RIGHT.match and IMAGE.adjust.

A match file is two counts and the interest points of both images, little-endian: column and row (float32), both as
whole numbers, orientation, scale, interest (float32), polarity (a byte), octave, level, the count of the descriptor
and the descriptor (float32) (Vision Workbench, MatcherIO.cc). The centre of the upper-left pixel is (0, 0) there.

An adjustment is a translation T in metres and a unit quaternion Q = (w, x, y, z), both geocentric: the camera that was
at C, with R from camera to world, is at C + T with Q·R (Vision Workbench, AdjustedCameraModel).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from geomosaic.errors import InputError, default_hint, listed
from geomosaic.interchange.colmap import check_quaternion, quaternion_matrix
from geomosaic.interchange.colmap_binary import Cursor
from geomosaic.interchange.files import all_numbers, number_text, of_image
from geomosaic.interchange.reconstruction import ImagePoints, ImagePose, ObjectPoints, Reconstruction
from geomosaic.sensor.inputs import LARGEST
from geomosaic.types import FloatArray, IntArray

# What comes before the count of the descriptor, and that count.
_POINT = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("ix", "<i4"),
        ("iy", "<i4"),
        ("orientation", "<f4"),
        ("scale", "<f4"),
        ("interest", "<f4"),
        ("polarity", "u1"),
        ("octave", "<u4"),
        ("level", "<u4"),
        ("descriptor", "<u8"),
    ]
)


def read_match(data: bytes, path: str) -> tuple[FloatArray, FloatArray]:
    """Columns and rows (N, 2) of the same points in two images.

    Parameters
    ----------
    data : bytes
        Whole file.
    path : str
        Named in errors.

    Raises
    ------
    InputError
        The file is damaged.
    """
    cursor = Cursor(data, path)
    left, right = cursor.take("QQ")
    if left != right or left * 2 * _POINT.itemsize > len(data):
        raise cursor.error(f"{left} points match {right}: this is no file of matches, or not the whole of it")
    found = np.empty((2 * left, 2))
    for index in range(2 * left):
        row = cursor.rows(_POINT, 1)[0]
        found[index] = row["x"], row["y"]
        length = 4 * int(row["descriptor"])
        cursor.require(length)
        cursor.at += length
    if not (np.abs(found) <= LARGEST).all():
        raise cursor.error("a point is not at finite numbers")
    return found[:left] + 0.5, found[left:] + 0.5


def match_bytes(left: FloatArray, right: FloatArray) -> bytes:
    """Match file of columns and rows (N, 2) in two images, without descriptors; float32, as the format has them.

    Parameters
    ----------
    left, right : array (N, 2)
        Columns and rows, pixels.
    """
    both = np.concatenate([left, right]) - 0.5
    rows = np.zeros(len(both), _POINT)
    rows["x"], rows["y"] = both.T
    rows["ix"], rows["iy"] = both.T
    rows["scale"] = 1.0
    return np.array([len(left), len(right)], dtype="<u8").tobytes() + rows.tobytes()


def read_matches(files: Mapping[str, bytes]) -> Reconstruction:
    """Tie points of match files: a point that chains of matches lead to is one.

    Parameters
    ----------
    files : mapping
        Bytes by name, [PREFIX-]LEFT__RIGHT.match, whose images are called LEFT and RIGHT.

    Raises
    ------
    InputError
        A file is damaged, or its name is not that of two images.
    """
    names: dict[str, int] = {}
    features: dict[tuple[int, float, float], int] = {}
    pairs: list[tuple[int, int]] = []
    start = _prefix(list(files))
    for name, data in files.items():
        left, mark, right = name.removeprefix(start).removesuffix(".match").removesuffix("-clean").partition("__")
        if not (left and mark and right):
            raise InputError(
                "the name is not LEFT__RIGHT.match, of two images", where=name, hint="keep the names that ASP gives"
            )
        both = [
            [
                features.setdefault((names.setdefault(image, len(names)), x, y), len(features))
                for x, y in colrow.tolist()
            ]
            for image, colrow in zip((left, right), read_match(data, name), strict=True)
        ]
        pairs += zip(*both, strict=True)
    rows = list(features)
    point = _components(pairs, len(rows))
    images = tuple(ImagePose(name) for name in names)
    seen = ImagePoints(
        np.array([row[0] for row in rows], dtype=np.int64), point, np.array([row[1:] for row in rows]).reshape(-1, 2)
    )
    points = ObjectPoints.unknown([str(index) for index in range(int(point.max(initial=-1)) + 1)])
    return Reconstruction({}, images, points, seen, notes=("match files have no cameras and no coordinates",))


def _prefix(names: list[str]) -> str:
    """PREFIX- of bundle_adjust, where all names have the same one and it says run."""
    starts = {name.partition("-")[0] if name.startswith("run-") else "" for name in names}
    return "run-" if starts == {"run"} else ""


def _components(pairs: list[tuple[int, int]], count: int) -> IntArray:
    """Number of the connected group of each of `count` features, in the order of their first ones."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not count:
        return np.zeros(0, dtype=np.int64)
    ends = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    graph = coo_array((np.ones(len(ends)), ends.T), shape=(count, count))
    _, group = connected_components(graph, directed=False)
    return np.asarray(group, dtype=np.int64)


def match_files(found: Reconstruction) -> dict[str, bytes]:
    """Match files of all pairs of images that see common points.

    Parameters
    ----------
    found : Reconstruction

    Returns
    -------
    dict
        Bytes by name, LEFT__RIGHT.match without the images' extensions, the first of the images left.
    """
    seen = found.observations
    by_point: dict[int, list[int]] = {}
    for at, point in enumerate(seen.point.tolist()):
        by_point.setdefault(point, []).append(at)
    pairs: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for rows in by_point.values():
        rows = sorted(rows, key=lambda at: int(seen.image[at]))
        for place, at in enumerate(rows):
            for other in rows[place + 1 :]:
                pairs.setdefault((int(seen.image[at]), int(seen.image[other])), []).append((at, other))
    files = {}
    for (left, right), rows_of in sorted(pairs.items()):
        index = np.array(rows_of)
        names = [found.images[at].name.rpartition("/")[2].rpartition(".") for at in (left, right)]
        stems = [head or tail for head, _, tail in names]
        files[f"{stems[0]}__{stems[1]}.match"] = match_bytes(seen.colrow[index[:, 0]], seen.colrow[index[:, 1]])
    return files


def read_adjustment(text: str, path: str) -> tuple[FloatArray, FloatArray]:
    """Translation (3,) in metres and rotation (3, 3) of an .adjust file.

    Parameters
    ----------
    text : str
        Whole file.
    path : str
        Named in errors.

    Raises
    ------
    InputError
        It is none, or one in pieces along the image.
    """
    if "piecewise" in text[:200].lower():
        raise InputError(
            "the adjustment is one in pieces along the image", where=path, hint="adjust without solving for jitter"
        )
    with default_hint("make it again with bundle_adjust, or correct what was edited in it"):
        values = all_numbers(text, path)
        if len(values) not in (7, 10) or (len(values) == 10 and (values[7:] != [0.0, 0.0, 1.0]).any()):
            raise InputError(
                f"{len(values)} numbers are not a translation and a quaternion",
                where=path,
                hint="offsets and scales of pixels are not read",
            )
        check_quaternion(values[3:7], path)
    return values[:3], quaternion_matrix(values[3:7])


def adjustment_text(translation: FloatArray, rotation: FloatArray) -> str:
    """Text of an .adjust file: translation (3,) in metres, rotation (3, 3) of the camera's axes in the world.

    Parameters
    ----------
    translation : array (3,)
        Metres.
    rotation : array (3, 3)
    """
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat(canonical=True).tolist()
    return f"{number_text(translation)}\n{w!r} {x!r} {y!r} {z!r}\n"


def adjusted(pose: ImagePose, translation: FloatArray, rotation: FloatArray) -> ImagePose:
    """Geocentric pose after an adjustment of `read_adjustment`.

    Parameters
    ----------
    pose : ImagePose
        Oriented.
    translation : array (3,)
    rotation : array (3, 3)
    """
    old, centre = pose.pose
    return replace(pose, rotation=old @ rotation.T, centre=centre + translation)


def adjustment(before: ImagePose, after: ImagePose) -> tuple[FloatArray, FloatArray]:
    """Translation (3,) and rotation (3, 3) that lead from one geocentric pose to another.

    Parameters
    ----------
    before, after : pose
        Projection centre (3,) and rotation (3, 3), geocentric.
    """
    (old, start), (new, end) = before.pose, after.pose
    return end - start, new.T @ old


def with_adjustments(found: Reconstruction, texts: Mapping[str, str]) -> Reconstruction:
    """Geocentric images after their adjustments; those without one stay where they are, and are named in the notes.

    Parameters
    ----------
    found : Reconstruction
        Cameras as they were.
    texts : mapping of str to str
        Whole files by path, [PREFIX-]IMAGE.adjust.

    Raises
    ------
    InputError
        A file is damaged, belongs to no image, or to the same as another one.
    """
    after, owner = list(found.images), dict[int, str]()
    for path, text in texts.items():
        own = [at for at, image in enumerate(found.images) if of_image(Path(path).stem, image.name)]
        if len(own) != 1 or own[0] in owner:
            what = f"{owner[own[0]]} is of the same image" if len(own) == 1 else f"it belongs to {len(own)} cameras"
            raise InputError(what, where=path, hint="name each IMAGE.adjust or PREFIX-IMAGE.adjust, as its camera")
        owner[own[0]] = path
        after[own[0]] = adjusted(after[own[0]], *read_adjustment(text, path))
    rest = [image.name for at, image in enumerate(found.images) if at not in owner]
    notes = (*found.notes, f"no .adjust, left as they were: {listed(rest)}") if rest else found.notes
    return replace(found, images=tuple(after), before=found.images, notes=notes)


def adjustment_files(found: Reconstruction) -> dict[str, bytes]:
    """Adjustments of all images whose pose before is known.

    Parameters
    ----------
    found : Reconstruction

    Returns
    -------
    dict
        Bytes by name, IMAGE.adjust without the image's extension.

    Raises
    ------
    InputError
        Nothing says where on the Earth the images are, or where they were before.
    """
    frame, before = found.on_earth, {image.name: image for image in found.before if image.oriented}
    if frame is None:
        hint = "name its `crs`, 'EPSG:4978' for a geocentric one, or its `reference`"
        raise InputError("an .adjust is geocentric, this reconstruction is not", where="reconstruction", hint=hint)
    files = {}
    for image in found.images:
        if image.oriented and image.name in before:
            shift, turn = adjustment(before[image.name], image)
            text = adjustment_text(frame.axes.T @ shift, frame.axes.T @ turn @ frame.axes)
            files[f"{Path(image.name).stem}.adjust"] = text.encode()
    if not files:
        raise InputError(
            "an .adjust holds differences from the orientation before the adjustment, which is not known",
            where="reconstruction",
            hint="start from oriented images, those of `angles` = tsai for example",
        )
    return files
