"""Orientations and cameras of other programs: poses given as matrices, and one reader for each kind of file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from geomosaic.errors import InputError, default_hint, did_you_mean, warn
from geomosaic.geo.crs import geocentric
from geomosaic.geo.local_frames import require_rotation
from geomosaic.interchange.files import of_image, pinhole_files, read_bytes, read_text
from geomosaic.sensor.inputs import choice, known_keys, need, number, numbers, pair
from geomosaic.types import FloatArray

# What the world of another program may be: axes of the map, of the Earth, or east, north, up at a reference.
WORLDS = ("map", "geocentric", "local")


def read_pose(row: Mapping[str, Any], where: str) -> tuple[FloatArray, FloatArray, str, CRS | None]:
    """Rotation, position and frame of a pose.

    Parameters
    ----------
    row : mapping
        `rotation`, world → camera (x right, y down, z forward), row by row; `position`; `world`.
    where : str
        Named in errors.

    Returns
    -------
    rotation : array (3, 3)
        The nearest rotation to the one that is given, which must be one to 1e-5.
    position : array (3,)
    frame : str
        'map', 'geocentric' or 'topocentric'.
    crs : CRS or None
        Geocentric, where the file names it.
    """
    text = "rotation matrix world → camera, row by row"
    rotation = np.array(numbers(need(row, "rotation", where, text), 9, "rotation", where)).reshape(3, 3)
    rotation = require_rotation(rotation, "rotation", where)
    position = np.array(numbers(need(row, "position", where, "projection centre"), 3, "position", where))
    frame, crs = _world(str(need(row, "world", where, f"what the world is, one of {', '.join(WORLDS)}")), where)
    return rotation, position, frame, crs


def _world(world: str, where: str) -> tuple[str, CRS | None]:
    """Frame of a world: one of `WORLDS`, or the WKT of a CRS in whose geocentric coordinates the file counts."""
    if world in WORLDS:
        return ("topocentric" if world == "local" else world), None
    if not world or world.lstrip().upper().startswith(("LOCAL_CS", "ENGCRS", "ENGINEERINGCRS")):
        raise InputError(
            "the file counts in local coordinates and does not say where these are",
            where=where,
            hint="say it: world = 'map' (they are those of the CRS that is named), 'geocentric', or 'local' with "
            "reference = [longitude, latitude, altitude]",
        )
    try:
        return "geocentric", geocentric(CRS.from_wkt(world))
    except (CRSError, InputError) as error:
        raise InputError(
            f"what the world is cannot be understood: '{world[:60]}'",
            where=where,
            hint=f"say it: world = {', '.join(WORLDS)}",
        ) from error


# Metres; coordinates of a map are rarely smaller, those that count from an offset are.
LOCAL = 1e5

# Camera table as of `camera.toml`, where the file has one, and orientation row.
Tables = tuple[dict[str, Any] | None, dict[str, Any]]


def read_reconstruction(path: Path, image: str, system: str, where: str) -> Tables:
    """Camera and orientation of one image, from a file of another program.

    Parameters
    ----------
    path : Path
        The program's file.
    image : str
        File name, with or without extension.
    system : str
        One of `READERS`.
    where : str
        Named in errors.

    Returns
    -------
    camera : dict or None
        Camera table, as in `camera.toml`, where the file has one.
    row : dict
        Orientation row.

    Raises
    ------
    InputError
        The file cannot be read, is damaged, or does not know the image.
    """
    with default_hint(f"write {path.name} again with the program it comes from, or correct what was edited in it"):
        return READERS[system](path, image, where)


def _opensfm(path: Path, image: str, where: str, system: str = "opensfm") -> Tables:
    from geomosaic.interchange.opensfm import read_shot

    return read_shot(read_bytes(path, where), path, image, system, where)


def _colmap(path: Path, image: str, where: str) -> Tables:
    from geomosaic.interchange.colmap import camera_table, pose_of
    from geomosaic.interchange.formats import colmap_model

    images = path.with_name(f"images{path.suffix}")
    model = colmap_model(path, where)
    record = _entry_of_image({record.name: record for record in model.images}, image, images, where)
    camera = next((camera for camera in model.cameras if camera.id == record.camera), None)
    if camera is None:
        raise InputError(
            f"camera {record.camera} of {image} is not in cameras{path.suffix}", where=str(images), hint=None
        )
    rotation, centre = pose_of(record).pose
    row = {"system": "colmap", "rotation": rotation.ravel().tolist(), "position": centre.tolist()}
    return camera_table(camera), row


def _pix4d(path: Path, image: str, where: str) -> Tables:
    from geomosaic.interchange.pix4d import (
        OFFSET,
        PARAMETERS,
        PMATRIX,
        offset_file,
        read_offset,
        read_pix4d,
        read_pmatrix,
    )

    offset = offset_file(path, OFFSET)
    shift = read_offset(read_text(offset, where), str(offset)) if offset else None
    read = read_pmatrix if path.name.endswith(PMATRIX) else read_pix4d
    if read is read_pmatrix:
        whole = offset_file(path, PARAMETERS)
        instead = f"; for the photos themselves give {whole.name}" if whole else ""
        warn(f"{path.name} holds for the images that Pix4D has freed of distortion{instead}")
    camera, row = _entry_of_image(read(read_text(path, where), shift, str(path)), image, path, where)
    if shift is None and max(map(abs, row["position"][:2])) < LOCAL:
        warn(
            f"{path.name} has no PROJECT{OFFSET} beside it, and its coordinates are small: without the offset they "
            "are no places of the map; Pix4D writes it to the same folder"
        )
    return dict(camera), dict(row)


def _metashape(path: Path, image: str, where: str) -> Tables:
    from geomosaic.interchange.metashape import read_metashape, read_metashape_text

    if path.suffix.lower() == ".xml":
        camera, row = _entry_of_image(read_metashape(read_bytes(path, where), str(path)), image, path, where)
        return dict(camera), dict(row)
    return None, dict(_entry_of_image(read_metashape_text(read_text(path, where), str(path)), image, path, where))


def _ori(path: Path, image: str, where: str) -> Tables:
    """One file for each image, named after it; a file of any name counts for the image that it names."""
    from geomosaic.interchange.photo_files import read_ori

    own = path.with_name(Path(image).stem + ".ori.xml")
    file = own if own.is_file() else path
    name, camera, row = read_ori(read_bytes(file, where), str(file))
    if file != own and Path(name).stem != Path(image).stem:
        raise InputError(
            f"{path} is the orientation of '{name}', and there is no {own.name} beside it",
            where=where,
            hint=f"name the files of orientations as their images: {own.name}",
        )
    return dict(camera), dict(row)


def _tsai(path: Path, image: str, where: str) -> Tables:
    """One file for each image, whose name ends with that of the image: run-IMAGE.tsai of bundle_adjust too.

    Where the path is an adjustment, IMAGE.adjust, those of all images are applied to their cameras.
    """
    from geomosaic.interchange.asp import adjusted, read_adjustment
    from geomosaic.interchange.photo_files import read_tsai
    from geomosaic.interchange.reconstruction import ImagePose

    def own(files: Sequence[Path]) -> Path:
        mine = [path] if path in files and of_image(path.stem, image) else [f for f in files if of_image(f.stem, image)]
        if len(mine) != 1:
            ending = files[0].suffix if files else ".tsai"
            raise InputError(
                f"{len(mine)} files {ending} beside {path} belong to {image} by their names",
                where=where,
                hint=f"name that of each image as the image: {Path(image).stem}{ending}",
            )
        return mine[0]

    path = path.absolute()
    cameras, adjustments = pinhole_files(path)
    file = own(cameras)
    camera, row = read_tsai(read_text(file, where), str(file))
    if not adjustments:
        return camera, row
    file = own(adjustments)
    before = ImagePose(image, None, np.reshape(row["rotation"], (3, 3)), np.array(row["position"]))
    rotation, centre = adjusted(before, *read_adjustment(read_text(file, where), str(file))).pose
    return camera, row | {"rotation": rotation.ravel().tolist(), "position": centre.tolist()}


READERS: Mapping[str, Callable[[Path, str, str], Tables]] = {
    "opensfm": _opensfm,
    "odm": partial(_opensfm, system="odm"),
    "colmap": _colmap,
    "pix4d": _pix4d,
    "metashape": _metashape,
    "ori": _ori,
    "tsai": _tsai,
}


def _entry_of_image(table: Mapping[str, Any], image: str, path: Path, where: str) -> Any:
    """Entry of an image, by its name without folder, with or without extension."""
    bare = Path(image).stem
    name = next(
        (key for key in table if Path(key).name == image),
        next((key for key in table if Path(key).stem == bare or Path(key).name == bare), None),
    )
    if name is None:
        hint = did_you_mean(bare, [Path(key).stem for key in table])
        raise InputError(
            f"{path} has no image named '{image}'", where=where, hint=f"{hint} it may not have been oriented".strip()
        )
    return table[name]


# Lens and coefficients of each `type` of camera.
ORTHORITY: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "pinhole": ("none", ()),
    "brown": ("brown", ("k1", "k2", "p1", "p2", "k3")),
    "opencv": ("opencv", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")),
    "fisheye": ("fisheye", ("k1", "k2", "k3", "k4")),
}


def orthority_table(values: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """Camera table of orthority's interior parameters, or of the `camera` of simple-ortho; any other as it is.

    Focal length and sensor have one unit, of any name; without a sensor the focal length is in units of the longer
    side, as the principal point is, which counts from the image's centre, y down (orthority, file formats).

    Parameters
    ----------
    values : mapping
        One camera, or cameras by name.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        There are several cameras, or one of another type, or a value is missing or no number.
    """
    named = {name: one for name, one in values.items() if isinstance(one, Mapping) and "focal_len" in one}
    cameras = {"camera": values} if "focal_len" in values else named
    if not cameras:
        return values
    if len(cameras) > 1:
        raise InputError(
            f"the file has {len(cameras)} cameras: {', '.join(cameras)}",
            where=where,
            hint="give a file with the one that took these photos",
        )
    (camera,) = cameras.values()
    kind = choice(need(camera, "type", where, f"one of {', '.join(ORTHORITY)}"), ORTHORITY, "type", where)
    model, names = ORTHORITY[kind]
    known_keys(camera, ("name", "type", "im_size", "focal_len", "sensor_size", "cx", "cy", *names), where)
    size = np.array(pair(need(camera, "im_size", where, "width and height in px"), "im_size", where))
    # Of a sensor of unknown size pixels are square, and its longer side is the unit.
    sensor = camera.get("sensor_size")
    pixels = size / np.array(pair(sensor, "sensor_size", where)) if sensor else np.full(2, size.max())
    focal = np.array(pair(camera["focal_len"], "focal_len", where)) * pixels
    centre = [number(camera.get(key, 0.0), key, where) for key in ("cx", "cy")]
    return {
        "size": size.tolist(),
        "focal_length_px": focal.tolist(),
        "principal_point_px": (size / 2 + np.array(centre) * size.max()).tolist(),
        "distortion": {"model": model, **{name: camera[name] for name in names if name in camera}},
    }
