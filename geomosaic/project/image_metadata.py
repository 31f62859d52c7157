"""Position, attitude and focal length of photos from EXIF and their makers' XMP, for drafts of projects."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from geomosaic.errors import InputError, OutputExistsError, SensorInputError, counted
from geomosaic.geo.crs import horizontal, parse_crs
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block
from geomosaic.raster.image_metadata import PhotoTags, maker_number, read_photo_tags, tag_number
from geomosaic.raster.info import control_point_count, inspect
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.registry import carried_sensors, photo_sensor, plane_sensor, trial
from geomosaic.whole_files import write_atomic

# Millimetres: what '35 mm equivalent' focal lengths refer to (CIPA DCG-001).
FULL_FRAME_DIAGONAL = math.hypot(36.0, 24.0)
# Millimetres of EXIF's FocalPlaneResolutionUnit.
UNITS = {"2": 25.4, "3": 10.0, "4": 1.0}
# EXIF's GPSAltitudeRef of depths: below the sea in version 2; in 3.0 below the ellipsoid (1) or the sea (3).
BELOW = ("1", "0x01", "3", "0x03")
GIMBAL = ("GimbalYawDegree", "GimbalPitchDegree", "GimbalRollDegree")


@dataclass(frozen=True)
class PhotoFacts:
    """Position, attitude and focal length as a photo's tags give them.

    Attributes
    ----------
    position : tuple of float or None
        Longitude, latitude in degrees (WGS 84), altitude in metres as written; NaN where there is no altitude.
    gimbal : tuple of float or None
        Gimbal yaw, pitch, roll in degrees.
    above_start : float or None
        Height above the place of take-off, metres.
    focal : float or None
        Focal length in pixels of the photo.
    focal_from : str
        The tags that it comes from, in words.
    camera : str
        Maker and model.
    turned : bool
        Whether EXIF asks viewers to turn the picture.
    """

    position: tuple[float, float, float] | None
    gimbal: tuple[float, float, float] | None
    above_start: float | None
    focal: float | None
    focal_from: str
    camera: str
    turned: bool


def photo_facts(tags: PhotoTags, size: tuple[int, int]) -> PhotoFacts:
    """Position, attitude and focal length from the tags of a photo.

    Parameters
    ----------
    tags : PhotoTags
    size : tuple of int
        Width and height of the photo in pixels.

    Returns
    -------
    PhotoFacts
        What is damaged counts as missing.
    """
    exif = tags.exif
    yaw, pitch, roll = (maker_number(tags.xmp, name) for name in GIMBAL)
    focal, source = _focal(exif, tags.xmp, size)
    return PhotoFacts(
        _position(exif, tags.xmp),
        None if yaw is None or pitch is None or roll is None else (yaw, pitch, roll),
        maker_number(tags.xmp, "RelativeAltitude"),
        focal,
        source,
        " ".join(exif.get(name, "") for name in ("Make", "Model")).strip(),
        exif.get("Orientation", "1") not in ("", "0", "1"),
    )


def _position(exif: Mapping[str, str], xmp: str) -> tuple[float, float, float] | None:
    lat, lon = _angle(exif, "GPSLatitude", "NS"), _angle(exif, "GPSLongitude", "EW")
    altitude = _rational(exif.get("GPSAltitude", ""))
    if altitude is not None and exif.get("GPSAltitudeRef", "0").strip().lower() in BELOW:
        altitude = -altitude
    # The maker's own position, where it is whole, has more digits than EXIF's degrees, minutes and seconds. Some of
    # their cameras write 'Longtitude'.
    fine = maker_number(xmp, "GpsLatitude")
    both = (maker_number(xmp, name) for name in ("GpsLongitude", "GpsLongtitude"))
    east = [value for value in both if value is not None]
    if fine is not None and east:
        lat, lon = fine, east[0]
    absolute = maker_number(xmp, "AbsoluteAltitude")
    altitude = absolute if absolute is not None else altitude
    # (0, 0) is what receivers write before they know their position.
    if lat is None or lon is None or abs(lat) > 90.0 or abs(lon) > 180.0 or (lat == 0.0 and lon == 0.0):
        return None
    return lon, lat, math.nan if altitude is None else altitude


def _angle(exif: Mapping[str, str], name: str, signs: str) -> float | None:
    """Degrees, minutes and seconds, as '(46) (50) (33.9993)'."""
    parts = [tag_number(text) for text in re.findall(r"\(([^)]{1,40})\)", exif.get(name, ""))]
    side = exif.get(f"{name}Ref", "").strip().upper()[:1]
    if not 1 <= len(parts) <= 3 or None in parts or not side or side not in signs:
        return None
    value = sum((part or 0.0) / 60.0**power for power, part in enumerate(parts))
    return -value if side == signs[1] else value


def _focal(exif: Mapping[str, str], xmp: str, size: tuple[int, int]) -> tuple[float | None, str]:
    """Focal length in pixels of the photo, and where it comes from; the photo may be a reduced copy."""
    full = tag_number(exif.get("PixelXDimension", "")) or float(size[0])
    shrink = size[0] / full if full >= 1.0 else 1.0
    calibrated = maker_number(xmp, "CalibratedFocalLength")
    if calibrated:
        return calibrated * shrink, "the maker's calibration"
    mm, pitch = _rational(exif.get("FocalLength", "")), _rational(exif.get("FocalPlaneXResolution", ""))
    unit = UNITS.get(exif.get("FocalPlaneResolutionUnit", ""))
    if mm and pitch and unit:
        return mm * pitch / unit * shrink, f"focal length {mm:g} mm and the resolution of the focal plane"
    equivalent = tag_number(exif.get("FocalLengthIn35mmFilm", ""))
    if equivalent:
        return equivalent * math.hypot(*size) / FULL_FRAME_DIAGONAL, f"{equivalent:g} mm in 35 mm film, rounded"
    return None, ""


def _rational(text: str) -> float | None:
    return tag_number(text.strip().strip("()"))


RASTERS = (".tif", ".tiff", ".jp2", ".ntf", ".img", ".jpg")


@dataclass(frozen=True)
class Carried:
    """Inputs completed from the images' metadata.

    Attributes
    ----------
    inputs : Block
    tables : dict of Path to str
        Files to write beside the project, with their text.
    lines : list of str
        What was read, for people.
    needed : list of str
        What no image says and the project needs.
    """

    inputs: Block
    tables: dict[Path, str] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    needed: list[str] = field(default_factory=list)


def images_of(paths: Sequence[Path]) -> tuple[Path, ...]:
    """Image files of the paths that were named.

    A folder of a scene stands for the images in it, a DIMAP file (.dim) for its image.

    Parameters
    ----------
    paths : sequence of Path

    Returns
    -------
    tuple of Path
        Each once, in the order given.

    Raises
    ------
    InputError
        A folder or a metadata file has no image.
    """
    found: dict[Path, None] = {}
    for path in paths:
        if path.is_dir():
            within = [file for file in sorted(path.iterdir()) if file.suffix.lower() in RASTERS]
            # Scenes come with quicklooks and masks as rasters too: images with a producer's name leave out all others.
            scenes = [file for file in within if file.stem.upper().startswith(("IMAGERY", "IMG_"))]
            images = scenes or within
        elif path.suffix.lower() == ".dim":
            near = [path.with_suffix(suffix) for suffix in RASTERS]
            images = [file for file in near if file.is_file()] or images_in_scene(path.parent)
        else:
            images = [path]
        if not images:
            raise InputError(
                "there is metadata, but no image" if path.is_file() else "the folder has no image",
                where=str(path),
                hint="name the image that belongs to it; its metadata is found beside it",
            )
        found.update(dict.fromkeys(images))
    return tuple(found)


def images_in_scene(folder: Path) -> list[Path]:
    """Images of a scene's folder by the names its producer gives them, IMAGERY*.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    list of Path
        By name.
    """
    return [file for file in sorted(folder.glob("IMAGERY*")) if file.suffix.lower() in RASTERS]


def carried_by(inputs: Block, project: Path) -> Carried:
    """Inputs of a project completed from its images.

    Sensor models that all images carry come first, then georeferences or control points, then EXIF and XMP. Where the
    sensor is one of photos, EXIF and XMP alone are read.

    Parameters
    ----------
    inputs : Block
    project : Path
        The project file; tables are named after it and lie beside it.

    Returns
    -------
    Carried

    Raises
    ------
    InputError
        The photos were taken with several cameras, and none is given.
    """
    photos = inputs.sensor == photo_sensor()
    infos = [inspect(path, inputs.bands) for path in inputs.images]
    own = (
        [] if photos else carried_sensors([(path, info.size) for path, info in zip(inputs.images, infos, strict=True)])
    )
    placed = not photos and all(info.crs is not None and info.transform is not None for info in infos)
    if own:
        lines = [f"model: each image carries one for the sensor {own[0]}"]
        if len(own) > 1:
            lines.append(f"  and one for {' and '.join(own[1:])}: say `sensor` to take that")
        if placed:
            lines.append(f"  they are georeferenced too: say `sensor={plane_sensor()}` to take them as they lie")
        return Carried(replace(inputs, sensor=own[0]), lines=lines)
    if placed or (inputs.control is not None and not photos):
        return Carried(inputs)
    facts = [photo_facts(read_photo_tags(path), info.size) for path, info in zip(inputs.images, infos, strict=True)]
    if any(fact.position or fact.gimbal for fact in facts):
        if inputs.camera is None:
            _one_camera(inputs.images, facts, [info.size for info in infos])
        found = _photos(inputs, facts, infos[0].size, project)
        # The list of what the sensor needs has them already.
        return replace(found, lines=[*found.lines, *found.needed], needed=[]) if photos else found
    if photos:
        return Carried(inputs)
    lines = [_camera_line(facts[0])] if facts[0].camera else []
    tagged = [(path, control_point_count(path)) for path in inputs.images]
    with_points = [f"{path.name} carries {counted(count, 'control point')}" for path, count in tagged if count]
    if with_points:
        hint = "images placed by their own control points: geomosaic georeference IMAGE ... -o PLACED, and PLACED here"
        return Carried(inputs, lines=[*lines, *with_points], needed=[hint])
    return Carried(inputs, lines=[*lines, "no image says where it was taken: no georeference, RPC, DIMAP or GPS"])


def write_tables(carried: Carried, *, overwrite: bool = False) -> None:
    """Write the tables of a draft beside its project.

    Parameters
    ----------
    carried : Carried
    overwrite : bool
        Replace existing files.

    Raises
    ------
    OutputExistsError
        One of them exists; none is written then.
    OutputError
        Writing failed.
    """
    for path in carried.tables:
        if path.exists() and not overwrite:
            raise OutputExistsError("the table exists", where=str(path), hint="give another name, or `overwrite`")
    for path, text in carried.tables.items():
        write_atomic(path, text)


def with_proposals(inputs: Block) -> tuple[Block, list[str]]:
    """Block with the inputs of single images that their sensor asks for and their files suggest.

    Parameters
    ----------
    inputs : Block

    Returns
    -------
    inputs : Block
    lines : list of str
        What was proposed, for people.
    """
    own, lines = dict(inputs.image_options), []
    for path in inputs.images:
        options = {**inputs.options, **own.get(path.name, {})}
        found = trial(
            inputs.sensor,
            SensorRequest(path.name, inspect(path).size, options, None, str(inputs.base), str(path)),
        )
        if isinstance(found, SensorInputError) and found.proposed is not None:
            own[path.name] = {**own.get(path.name, {}), found.name: found.proposed}
            lines.append(f"{path.name}: {found.what}: {found.name} = {found.proposed} is proposed; check it")
    return replace(inputs, image_options=own), lines


def _one_camera(images: Sequence[Path], facts: Sequence[PhotoFacts], sizes: Sequence[tuple[int, int]]) -> None:
    """Refuse photos of several cameras or focal lengths: a project has one, and the first must not stand for all.

    Raises
    ------
    InputError
        Names a photo of each.
    """
    kinds: dict[tuple[str, int | None], Path] = {}
    for path, fact, size in zip(images, facts, sizes, strict=True):
        # In thousandths of the diagonal, so that copies of several sizes are alike.
        focal = None if fact.focal is None else round(1000.0 * fact.focal / math.hypot(*size))
        kinds.setdefault((fact.camera, focal), path)
    if len(kinds) > 1:
        (first, one), (second, other), *_ = kinds.items()
        what = [f"{path.name} ({name or 'no name'}, focal length {_share(focal)})" for (name, focal), path in
                ((first, one), (second, other))]  # fmt: skip
        raise InputError(
            f"the photos were taken with {len(kinds)} cameras or focal lengths: {' and '.join(what)}",
            hint="give a `camera`, and name those of the other photos under [[images]] of the project; or make a "
            "project for the photos of each",
        )


def _share(focal: int | None) -> str:
    return "unknown" if focal is None else f"{focal / 1000.0:.3f} of the diagonal"


def _photos(inputs: Block, facts: Sequence[PhotoFacts], size: tuple[int, int], project: Path) -> Carried:
    """Tables of the positions and attitudes of photos, and a camera of their focal length."""
    lines, needed, tables = [], [], {}
    change: dict[str, object] = {"sensor": photo_sensor()}
    if facts[0].camera:
        lines.append(_camera_line(facts[0]))
    with_place = sum(fact.position is not None for fact in facts)
    with_attitude = sum(fact.gimbal is not None for fact in facts)
    lines.append(
        f"EXIF and XMP: {with_place} of {len(facts)} photos have a position, {with_attitude} a gimbal attitude"
    )
    if any(fact.turned for fact in facts):
        lines.append("  EXIF asks viewers to turn some photos: they are taken as they are stored")
    start = [fact.above_start for fact in facts if fact.above_start is not None]
    if start:
        lines.append(f"  {min(start):g} to {max(start):g} m above the place of take-off")
    whole = with_place == len(facts) == with_attitude and all(
        math.isfinite(fact.position[2]) for fact in facts if fact.position
    )
    if inputs.exterior is None and (with_place or with_attitude):
        # Control points, or angles of another system, are to orient the photos: then their own positions do not.
        oriented = whole and inputs.control is None and inputs.angles in (Block.angles, "dji")
        table = project.with_name(f"{project.stem}-{'exterior' if oriented else 'positions'}.csv")
        crs = inputs.crs or "EPSG:4326"
        tables[table] = _position_table(inputs.images, facts, crs)
        frame = "longitude, latitude (WGS 84)" if inputs.crs is None else f"x, y in {crs}"
        lines.append(f"  written to {table.name}: {frame}, altitude as the camera wrote it, gimbal")
        lines.append(
            "  the accuracy is that of the receiver and the gimbal, metres and degrees: adjust, or expect that"
        )
        if oriented:
            change |= {"exterior": table, "angles": "dji", "crs": crs}
    if not whole and inputs.exterior is None:
        missing = [
            name
            for name, there in (("positions", with_place), ("gimbal attitudes", with_attitude))
            if there < len(facts)
        ]
        missing += [] if missing else ["altitudes"]
        known = f"; {table.name} has what is known: complete it, and name it in [exterior] file" if tables else ""
        needed.append(f"{' and '.join(missing)}: not all photos have them{known}")
    if facts[0].focal is not None and inputs.camera is None:
        camera = project.with_name(f"{project.stem}-camera.toml")
        tables[camera] = (
            f"# From {facts[0].focal_from}. Lens distortion and principal point are not in the photos.\n"
            f"name = {json.dumps(facts[0].camera, ensure_ascii=False)}\nsize = [{size[0]}, {size[1]}]\n"
            f"focal_length_px = {facts[0].focal:.3f}\n"
        )
        change["camera"] = camera
        lines.append(f"  written to {camera.name}: {facts[0].focal:.1f} px, from {facts[0].focal_from}; no distortion")
    return Carried(replace(inputs, **change), tables, lines, needed)  # type: ignore[arg-type]


def _position_table(images: Sequence[Path], facts: Sequence[PhotoFacts], crs: str) -> str:
    """Table of positions in a CRS, with gimbal angles where a photo has them; what is not known is left empty."""
    places = np.array([fact.position or (math.nan,) * 3 for fact in facts])
    known = np.isfinite(places[:, 0])
    if not parse_crs(crs).equals(parse_crs("EPSG:4326")):
        level = np.column_stack([places[known, :2], np.zeros(np.count_nonzero(known))])
        # Horizontally alone: what the altitude counts from is not known.
        places[known, :2] = Transform(parse_crs("EPSG:4326"), horizontal(parse_crs(crs)))(level)[:, :2]
    digits = 9 if parse_crs(crs).is_geographic else 4
    with_gimbal = any(fact.gimbal for fact in facts)
    rows = ["image,x,y,z" + (",gimbal_yaw,gimbal_pitch,gimbal_roll" if with_gimbal else "")]
    for path, fact, place in zip(images, facts, places, strict=True):
        cells = [f"{v:.{n}f}" if math.isfinite(v) else "" for v, n in zip(place, (digits, digits, 4), strict=True)]
        cells += [f"{value:g}" for value in fact.gimbal] if fact.gimbal else [""] * (3 * with_gimbal)
        rows.append(",".join([_quoted(path.name), *cells]))
    return "\n".join(rows) + "\n"


def _camera_line(fact: PhotoFacts) -> str:
    focal = f", focal length {fact.focal:.1f} px from {fact.focal_from}" if fact.focal else ""
    return f"camera: {fact.camera}{focal}"


def _quoted(name: str) -> str:
    return json.dumps(name, ensure_ascii=False) if any(mark in name for mark in ",; \t\"'#") else name
