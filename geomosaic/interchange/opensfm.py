"""Reconstructions of OpenSfM and OpenDroneMap: reconstruction.json, tracks.csv, ground_control_points.json.

A pose takes the world to the camera, X_c = R·X_w + t with R of a rotation vector, and camera axes x right, y down, z
forward. The world is east, north, up at `reference_lla`; OpenDroneMap writes a file that looks the same in the axes of
its map. Measurements are normalised: from the image's middle, in units of its longer side, y down.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InputError, counted
from geomosaic.geo.local_frames import angle_axis
from geomosaic.interchange.reconstruction import (
    ImagePoints,
    ImagePose,
    ObjectPoints,
    Reconstruction,
    SurveyedPoints,
    pixel_camera,
)
from geomosaic.sensor.inputs import finite_numbers, need, number, numbers, table_of
from geomosaic.types import FloatArray, IntArray
from geomosaic.whole_files import check_rows

# Text that tracks.csv begins with, and values of a row of each version.
_HEADER = "OPENSFM_TRACKS_VERSION_v"
_VALUES = {0: 8, 1: 9, 2: 11}

COEFFICIENTS = {
    "perspective": ("brown", ("k1", "k2")),
    "simple_radial": ("brown", ("k1",)),
    "radial": ("brown", ("k1", "k2")),
    "brown": ("brown", ("k1", "k2", "k3", "p1", "p2")),
    "fisheye": ("fisheye", ("k1", "k2")),
    "fisheye_opencv": ("fisheye", ("k1", "k2", "k3", "k4")),
}


def camera_table(camera: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Camera table, as in `camera.toml`, of an OpenSfM camera.

    Focal length and principal point are given there in units of the longer side; the principal point counts from the
    image's centre, y down.

    Parameters
    ----------
    camera : mapping
        Entry of `cameras` in a reconstruction.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The camera is of another type, or lacks a value.
    """
    kind = str(need(camera, "projection_type", where, "the camera's kind"))
    if kind not in COEFFICIENTS:
        raise InputError(
            f"OpenSfM cameras of the type '{kind}' are not supported",
            where=where,
            hint=f"supported are: {', '.join(COEFFICIENTS)}",
        )
    model, names = COEFFICIENTS[kind]
    w, h = numbers([need(camera, key, where, "pixels") for key in ("width", "height")], 2, "width, height", where)
    longest = max(w, h)
    focal = camera.get("focal")
    fx, fy = camera.get("focal_x", focal), camera.get("focal_y", focal)
    if fx is None:
        raise InputError("the camera has no focal length", where=where, hint="give focal, or focal_x and focal_y")
    fy = fx if fy is None else fy
    cx, cy = (number(camera.get(key, 0.0), key, where) for key in ("c_x", "c_y"))
    return {
        "size": [w, h],
        "focal_length_px": [number(fx, "focal", where) * longest, number(fy, "focal_y", where) * longest],
        "principal_point_px": [w / 2 + cx * longest, h / 2 + cy * longest],
        "distortion": {"model": model, **{name: camera[name] for name in names if name in camera}},
    }


@lru_cache(maxsize=4)
def _parse(data: bytes, path: str, where: str) -> tuple[Mapping[str, Any], ...]:
    """Parts of a reconstruction; kept, since all images of a block ask for them."""
    try:
        parts = json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"the reconstruction {path} cannot be read: {error}",
            where=where,
            hint="give the file reconstruction.json of OpenSfM or ODM",
        ) from error
    return tuple(
        table_of(part, "the reconstruction", where) for part in (parts if isinstance(parts, list) else [parts])
    )


def read_shot(data: bytes, path: Path, image: str, system: str, where: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Camera table and orientation row of one image.

    Parameters
    ----------
    data : bytes
        Of the reconstruction.
    path : Path
        The file.
    image : str
        File name, with or without extension.
    system : str
        'opensfm' or 'odm'.
    where : str
        Named in errors.

    Returns
    -------
    camera : dict
        As `camera.toml`.
    orientation : dict
        Row of that system.
    """
    stem = Path(image).stem
    for part in _parse(data, str(path), where):
        shots = table_of(part.get("shots", {}), "shots", where)
        name = next((key for key in shots if key in (image, stem) or Path(key).stem == stem), None)
        if name is None:
            continue
        shot = table_of(shots[name], name, where)
        reference = _reference(part, where)
        if reference is None:
            raise InputError(
                f"{path} has no reference_lla: the reconstruction is not georeferenced",
                where=where,
                hint="run OpenSfM again on photos with GPS positions, or with control points",
            )
        cameras = table_of(need(part, "cameras", where, "a table of cameras"), "cameras", where)
        camera = cameras.get(str(need(shot, "camera", where, "the name of its camera")))
        if camera is None:
            raise InputError(f"{path} has no camera named {shot['camera']!r}", where=where)
        row = {
            "system": system,
            "rotation": need(shot, "rotation", where, "rotation vector"),
            "translation": need(shot, "translation", where, "translation"),
            "reference": list(reference),
        }
        return camera_table(table_of(camera, "camera", where), where), row
    raise InputError(
        f"{path} has no shot named '{image}'", where=where, hint="check the name; it may not be in the block"
    )


def _reference(part: Mapping[str, Any], where: str) -> tuple[float, float, float] | None:
    """Longitude, latitude, altitude of the origin, where a part of a reconstruction has one."""
    if part.get("reference_lla") is None:
        return None
    lla = table_of(part["reference_lla"], "reference_lla", where)
    text = "a number of reference_lla"
    longitude, latitude, altitude = (
        number(need(lla, key, where, text), key, where) for key in ("longitude", "latitude", "altitude")
    )
    return longitude, latitude, altitude


def read(data: bytes, path: str, tracks: str | None = None, surveyed: bytes | None = None) -> Reconstruction:
    """Reconstruction of all parts of the file; of a point in several parts the later ones are named 'ID (part)'.

    Parameters
    ----------
    data : bytes
        Of reconstruction.json.
    path : str
        Named in errors.
    tracks : str, optional
        Text of tracks.csv: the measurements.
    surveyed : bytes, optional
        Of ground_control_points.json.

    Raises
    ------
    InputError
        A file is damaged, or the parts have different origins.
    """
    parts = _parse(data, path, path)
    cameras: dict[str, dict[str, Any]] = {}
    images: list[ImagePose] = []
    part_of: dict[str, int] = {}
    references = {_reference(part, path) for part in parts}
    if len(references) > 1:
        raise InputError(
            "the parts of the reconstruction have different origins", where=path, hint="give each part as its own file"
        )
    for index, part in enumerate(parts):
        for name, camera in table_of(part.get("cameras", {}), "cameras", path).items():
            cameras[name] = camera_table(table_of(camera, name, f"{path}, camera {name}"), f"{path}, camera {name}")
        for name, given in table_of(part.get("shots", {}), "shots", path).items():
            images.append(_pose(name, table_of(given, name, path), cameras, f"{path}, shot {name}"))
            part_of[name] = index
    gathered = _Points([], [], [], [])
    for part in parts:
        gathered.add(table_of(part.get("points", {}), "points", path), path)
    notes = ["OpenDroneMap's reconstruction.json is in the axes of its map: not told by the file"]
    seen = ImagePoints.none()
    if tracks is not None:
        of, values, left_out = _tracks(tracks, path, images)
        numbers_of = {image.name: at for at, image in enumerate(images)}
        which = np.array([numbers_of[image] for image, _ in of], dtype=np.int64)
        point = gathered.of_tracks([(part_of[image], track) for image, track in of])
        colrow, scale = _pixels(values, which, images, cameras)
        seen = ImagePoints(which, point, colrow, scale=scale)
        notes += [f"{counted(left_out, 'measurement')} in images without orientation left out"] if left_out else []
    control = None if surveyed is None else _surveyed(surveyed, path, images, cameras)
    reference = next(iter(references), None)
    return Reconstruction(cameras, tuple(images), gathered.points(), seen, None, reference, control, tuple(notes))


@dataclass(frozen=True)
class _Points:
    """Points of all parts, gathered: names, coordinates, colours, and the index of each track in each part."""

    ids: list[str]
    xyz: list[tuple[float, ...]]
    colour: list[tuple[float, ...]]
    parts: list[dict[str, int]]

    def add(self, given: Mapping[str, Any], path: str) -> None:
        """Points of the next part."""
        taken = {name for own in self.parts for name in own}
        own: dict[str, int] = {}
        for name, value in given.items():
            where = f"{path}, point {name}"
            point = table_of(value, "the point", where)
            own[name] = len(self.ids)
            self.ids.append(f"{name} ({len(self.parts) + 1})" if name in taken else name)
            self.xyz.append(numbers(need(point, "coordinates", where, "x, y, z"), 3, "coordinates", where))
            self.colour.append(numbers(point.get("color", (0.0, 0.0, 0.0)), 3, "color", where))
        self.parts.append(own)

    def of_tracks(self, tracks: Iterable[tuple[int, str]]) -> IntArray:
        """Index (N,) of the point of each part and track; of tracks without coordinates that of a new point."""
        anywhere = {name: at for own in reversed(self.parts) for name, at in own.items()}
        found = []
        for part, track in tracks:
            at = self.parts[part].get(track, anywhere.get(track))
            if at is None:
                at = anywhere[track] = len(self.ids)
                self.ids.append(track)
                self.xyz.append((np.nan,) * 3)
                self.colour.append((0.0,) * 3)
            found.append(at)
        return np.array(found, dtype=np.int64)

    def points(self) -> ObjectPoints:
        """All of them."""
        colour = np.clip(np.array(self.colour).reshape(-1, 3), 0, 255).astype(np.uint8)
        return ObjectPoints(tuple(self.ids), np.array(self.xyz, dtype=np.float64).reshape(-1, 3), colour)


def _pose(name: str, shot: Mapping[str, Any], cameras: Mapping[str, Any], where: str) -> ImagePose:
    camera = str(need(shot, "camera", where, "the name of its camera"))
    if camera not in cameras:
        raise InputError(f"no camera is named {camera!r}", where=where)
    vector = numbers(need(shot, "rotation", where, "rotation vector"), 3, "rotation", where)
    shift = numbers(need(shot, "translation", where, "translation"), 3, "translation", where)
    rotation = angle_axis(np.array(vector))
    return ImagePose(name, camera, rotation, -rotation.T @ np.array(shift))


def _tracks(text: str, path: str, images: Iterable[ImagePose]) -> tuple[list[tuple[str, str]], FloatArray, int]:
    """Image and track of each measurement, and x, y, scale (N, 3); and the count of those in other images."""
    name = f"{Path(path).parent / 'tracks.csv'}"
    check_rows(text.count("\n"), name)
    lines = text.splitlines()
    version = 0
    if lines and lines[0].startswith(_HEADER):
        word = lines[0].removeprefix(_HEADER).strip()
        if not word.isdecimal() or len(word) > 2 or int(word) not in _VALUES:
            raise InputError(f"version '{word[:20]}' of tracks is not known", where=name, hint="versions 0 to 2 are")
        version = int(word)
    of, values, left_out = [], [], 0
    named = {image.name for image in images}
    for at, line in enumerate(lines, 1):
        if not line.strip() or (at == 1 and version):
            continue
        words = line.split("\t")
        if len(words) != _VALUES[version]:
            raise InputError(
                f"{counted(len(words), 'value')} where a measurement has {_VALUES[version]}", where=f"{name}, line {at}"
            )
        if words[0] not in named:
            left_out += 1
            continue
        of.append((words[0], words[1]))
        given = finite_numbers(words[3 : 6 if version else 5], 3 if version else 2, "x, y, scale", f"{name}, line {at}")
        values.append([*given, np.nan][:3])
    return of, np.array(values).reshape(-1, 3), left_out


def _pixels(
    values: FloatArray, image: IntArray, images: list[ImagePose], cameras: Mapping[str, Mapping[str, Any]]
) -> tuple[FloatArray, FloatArray]:
    """Pixels (N, 2) and sizes (N,) of x, y, scale (N, 3) in images (N,)."""
    sizes = np.array([cameras[str(pose.camera)]["size"] for pose in images], dtype=np.float64).reshape(-1, 2)[image]
    longest = sizes.max(axis=1, initial=0.0)
    return values[:, :2] * longest[:, None] + sizes / 2, values[:, 2] * longest


def _surveyed(data: bytes, path: str, images: list[ImagePose], cameras: Mapping[str, Any]) -> SurveyedPoints:
    name = f"{Path(path).parent / 'ground_control_points.json'}"
    try:
        text = json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"this is no JSON: {error}", where=name, hint="write it again, or take it away") from error
    listed = table_of(text, "the file", name).get("points", [])
    if not isinstance(listed, list):
        raise InputError("'points' is no list", where=name, hint="write the points as a list of tables")
    index = {image.name: at for at, image in enumerate(images)}
    ids, xyz, rows = [], [], []
    for at, given in enumerate(listed):
        point = table_of(given, f"point {at + 1}", name)
        where = f"{name}, point {str(point.get('id', at + 1))[:40]}"
        ids.append(str(need(point, "id", where, "the point's name")))
        place = point.get("position")
        keys = ("longitude", "latitude", "altitude")
        position = table_of({} if place is None else place, "position", where)
        xyz.append([number(position[key], key, where) if key in position else np.nan for key in keys])
        observed = point.get("observations", [])
        for seen in observed if isinstance(observed, list) else []:
            row = table_of(seen, "the observation", where)
            shot = str(need(row, "shot_id", where, "the image"))
            projection = numbers(need(row, "projection", where, "x, y"), 2, "projection", where)
            if shot in index:
                rows.append((index[shot], at, *projection))
    values = np.array(rows, dtype=np.float64).reshape(-1, 4)
    image = values[:, 0].astype(np.int64)
    colrow, _ = _pixels(np.column_stack([values[:, 2:], np.full(len(values), np.nan)]), image, images, cameras)
    points = ObjectPoints(tuple(ids), np.array(xyz).reshape(-1, 3))
    return SurveyedPoints(points, ImagePoints(image, values[:, 1].astype(np.int64), colrow), "EPSG:4979")


# Kinds of cameras that are written for each lens, those with fewest values first.
_WRITTEN = {
    "none": ("perspective", "brown"),
    "brown": ("perspective", "brown"),
    "fisheye": ("fisheye", "fisheye_opencv"),
}


def _camera(table: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Entry of `cameras` of a camera table."""
    where = f"camera {name}"
    camera = pixel_camera(table, where)
    width, height = camera.known_size(where)
    most = COEFFICIENTS["fisheye_opencv" if camera.model == "fisheye" else "brown"][1]
    camera.known_only("OpenSfM", where, none=(), brown=most, fisheye=most)
    longest = max(width, height)
    c_x, c_y = (value / longest for value in camera.from_middle)
    given = {key for key, value in camera.lens.items() if value}
    plain = camera.focal[0] == camera.focal[1] and c_x == c_y == 0.0
    small, large = _WRITTEN[camera.model]
    kind = small if plain and given <= set(COEFFICIENTS[small][1]) else large
    entry: dict[str, Any] = {"projection_type": kind, "width": width, "height": height}
    if kind == small:
        entry["focal"] = camera.focal[0] / longest
    else:
        entry |= {"focal_x": camera.focal[0] / longest, "focal_y": camera.focal[1] / longest, "c_x": c_x, "c_y": c_y}
    return entry | {key: camera.lens.get(key, 0.0) for key in COEFFICIENTS[kind][1]}


def texts_of(found: Reconstruction) -> dict[str, str]:
    """Texts of reconstruction.json and tracks.csv, and of ground_control_points.json where there is control.

    Parameters
    ----------
    found : Reconstruction
        Points without coordinates are only in the tracks.

    Raises
    ------
    InputError
        A camera has no size or a lens that OpenSfM has not; control is in another CRS than EPSG:4979.
    """
    from scipy.spatial.transform import Rotation

    longest = np.array([max(pixel_camera(found.camera_of(image), image.name).size or (1, 1)) for image in found.images])
    middle = np.array([pixel_camera(found.camera_of(image), image.name).middle for image in found.images])
    shots = {}
    for image in found.images:
        if image.oriented:
            rotation, centre = image.pose
            shots[image.name] = {
                "rotation": Rotation.from_matrix(rotation).as_rotvec().tolist(),
                "translation": (-rotation @ centre).tolist(),
                "camera": image.camera,
                "orientation": 1,
            }
    points = {}
    colours = found.points.colours
    for name, xyz, colour in zip(found.points.ids, found.points.xyz.tolist(), colours.tolist(), strict=True):
        if np.isfinite(xyz).all():
            points[name] = {"color": colour, "coordinates": xyz}
    part: dict[str, Any] = {
        "cameras": {name: _camera(table, name) for name, table in found.cameras.items()},
        "shots": shots,
        "points": points,
    }
    if found.reference is not None:
        part["reference_lla"] = dict(zip(("longitude", "latitude", "altitude"), found.reference, strict=True))
    seen = found.observations
    scale = (1.0 if seen.scale is None else seen.scale) / longest[seen.image]
    xy = (seen.colrow - middle[seen.image]) / longest[seen.image][:, None]
    lines = [f"{_HEADER}2"]
    columns = (seen.image.tolist(), seen.point.tolist(), xy.tolist(), np.nan_to_num(scale).tolist())
    for feature, (image, point, (x, y), size) in enumerate(zip(*columns, strict=True)):
        red, green, blue = colours[point].tolist()
        lines.append(
            f"{found.images[image].name}\t{found.points.ids[point]}\t{feature}\t{x!r}\t{y!r}\t{size!r}\t"
            f"{red}\t{green}\t{blue}\t-1\t-1"
        )
    texts = {"reconstruction.json": json.dumps([part], indent=1), "tracks.csv": "\n".join([*lines, ""])}
    if found.control is not None:
        texts["ground_control_points.json"] = _control_text(found, longest, middle)
    return texts


def _control_text(found: Reconstruction, longest: FloatArray, middle: FloatArray) -> str:
    control = found.control
    assert control is not None
    if control.crs != "EPSG:4979":
        raise InputError(
            f"OpenSfM's control points are longitude, latitude and ellipsoidal height, these in {control.crs}",
            where="control points",
            hint="bring them to EPSG:4979",
        )
    listed: list[dict[str, Any]] = []
    for name, xyz in zip(control.points.ids, control.points.xyz.tolist(), strict=True):
        place = {
            key: value
            for key, value in zip(("longitude", "latitude", "altitude"), xyz, strict=True)
            if np.isfinite(value)
        }
        listed.append({"id": name, **({"position": place} if place else {}), "observations": []})
    seen = control.observations
    xy = (seen.colrow - middle[seen.image]) / longest[seen.image][:, None]
    for image, point, projection in zip(seen.image.tolist(), seen.point.tolist(), xy.tolist(), strict=True):
        row = {"shot_id": found.images[image].name, "projection": projection}
        listed[point]["observations"].append(row)
    return json.dumps({"points": listed}, indent=1)
