"""Block of photos from their tags: cameras, positions, what is assumed, and what an adjustment is to find."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from geomosaic.errors import InputError, counted, listed
from geomosaic.geo.crs import horizontal, is_local, parse_crs
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block, file_of
from geomosaic.options.inputs import CORNER_SIGMA_PX
from geomosaic.project.photo_tags import PhotoFacts
from geomosaic.render.extent import utm_zone
from geomosaic.sensor.registry import photo_sensor
from geomosaic.surface.model import undulation
from geomosaic.types import BoolArray, FloatArray

LONLAT = "EPSG:4326"
# Frame of photos of which nothing tells where they are.
NOWHERE = "local"
# Metres, of positions by code phases, in plan and height; degrees, of a gimbal whose compass tells its yaw.
POSITION_SIGMA, ATTITUDE_SIGMA = 3.0, 5.0
# Metres that not even RTK is better by: the antenna is not the projection centre.
LEAST_SIGMA = 0.05
# Focal length over the longer side where no tag tells it, half-way between wide angle and normal, and its a-priori
# standard deviation as a share: self-calibration finds it from there.
ASSUMED_FOCAL, ASSUMED_SHARE = 1.2, 0.3
# Principal point from the middle of a photo, as a share of the longer side: that of lenses without a calibration.
PRINCIPAL_SHARE = 0.01
# Standard deviations of a position within which the corners of a block that nothing else places are as expected: they
# lie beyond the cameras, and the angles count there.
BEYOND = 3.0
# Metres of a fine ground sampling, where no tag tells it.
FINE = 0.02
# Photos are of another place beyond a gap of so many times the usual distance between neighbours, and so many metres.
STRAY, FAR = 20.0, 2000.0
# Metres between neighbours beyond which no photos overlap, from whatever height they were taken.
ABROAD = 100e3
# Metres within which positions tell nothing of one another.
ONE_PLACE = 0.5


@dataclass(frozen=True)
class EmbeddedInputs:
    """Inputs that images carry, and how a draft tells them.

    Attributes
    ----------
    inputs : Block
    tables : dict of Path to str
        Tables to be written beside the project, by path.
    lines : list of str
        For people.
    needed : list of str
        What is missing.
    aside : mapping of Path to str
        Pictures that are not used, each with the reason.
    adjust : tuple of str or None
        Lines of [adjust] where tie points are to orient the photos; None where they are not.
    said : mapping of str to str
        Remarks on keys of the project, such as what was assumed.
    output_crs : str or None
        CRS of the mosaic.
    notes : list of str
        What was assumed or left out, for the report.
    corner_sigma : float or None
        Expected error in pixels of a mosaic that positions of the cameras alone place; None for the default limit.
    reference : Path or None
        Georeferenced raster in which control points are to be found.
    height_sigma : float or None
        Standard deviation of the heights of these, metres, where it is assumed.
    """

    inputs: Block
    tables: dict[Path, str] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    needed: list[str] = field(default_factory=list)
    aside: Mapping[Path, str] = field(default_factory=dict)
    adjust: tuple[str, ...] | None = None
    said: Mapping[str, str] = field(default_factory=dict)
    output_crs: str | None = None
    notes: list[str] = field(default_factory=list)
    corner_sigma: float | None = None
    reference: Path | None = None
    height_sigma: float | None = None


@dataclass(frozen=True)
class _Remarks:
    """Remarks on a block that is drafted."""

    lines: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        """Remark that belongs into the report, too."""
        self.lines.append(f"  {text}")
        self.notes.append(text)


@dataclass(frozen=True)
class TaggedPhoto:
    """Photo with what its tags tell."""

    path: Path
    size: tuple[int, int]
    facts: PhotoFacts


def tied_photos(inputs: Block, photos: Sequence[TaggedPhoto], project: Path) -> EmbeddedInputs:
    """Block of photos that tie points are to orient, from what their tags tell.

    Parameters
    ----------
    inputs : Block
        What was given comes before what is carried.
    photos : sequence of TaggedPhoto
        Two or more, those of `inputs`.
    project : Path
        Tables are named after it and lie beside it.
    """
    remarks, said = _Remarks(), dict[str, str]()
    photos, aside = _of_one_place(photos, remarks)
    inputs = replace(inputs, images=tuple(photo.path for photo in photos), sensor=photo_sensor())
    inputs, tables, focal = _cameras(inputs, photos, project, remarks)
    if any(photo.facts.turned for photo in photos):
        remarks.lines.append("  EXIF asks viewers to turn some photos: they are taken as they are stored")
    positions, adjust = [photo for photo in photos if photo.facts.position], list[str]()
    output_crs = corner_sigma = None
    remarks.lines.append(known_places(photos))
    local = inputs.crs is not None and is_local(parse_crs(inputs.crs, "`crs`"))
    if (control := odm_list_of(inputs)) is not None:
        inputs = _with_list(inputs, control, positions, said, remarks)
    unused = _unused_positions(inputs, local) if positions else None
    if unused is not None:
        remarks.note(f"the positions are not used: {unused}")
    elif positions:
        inputs, table = _placed(inputs, photos, project, said, remarks)
        tables |= table
        sigma, of_poses = _accuracy(photos, inputs.angles)
        adjust += of_poses
        if inputs.control is None:
            corner_sigma = float(f"{max(BEYOND * sigma / (_sampling(photos) or FINE), CORNER_SIGMA_PX):.2g}")
            output_crs = _utm(positions) if inputs.dem is None else None
    elif inputs.control is None and inputs.crs is None:
        inputs = replace(inputs, crs=NOWHERE)
        remarks.note(
            "no position: the mosaic gets a local frame, level as far as the photos tell, without a place on the Earth"
        )
        said["crs"] = "nothing tells where the photos are"
    adjust += focal
    return EmbeddedInputs(
        inputs, tables, remarks.lines, [], aside, tuple(adjust), said, output_crs, remarks.notes, corner_sigma
    )


def odm_list_of(inputs: Block) -> Path | None:
    """OpenDroneMap's list of control points, where that is what was given.

    Parameters
    ----------
    inputs : Block
    """
    # Imported here: a project is loaded before it reads any control.
    from geomosaic.control.read import is_odm_list

    control = file_of(inputs.control)
    return control if control is not None and is_odm_list(control) else None


def _with_list(
    inputs: Block, control: Path, positions: Sequence[TaggedPhoto], said: dict[str, str], remarks: _Remarks
) -> Block:
    """Inputs in the CRS that OpenDroneMap's list of control points states."""
    from geomosaic.control.read import odm_measurements

    stated, points, _ = odm_measurements(control)
    if inputs.crs is None:
        # Short where it is one of the register: the list of today has a PROJ string.
        code = horizontal(parse_crs(stated)).to_epsg(min_confidence=70)
        inputs = replace(inputs, crs=f"EPSG:{code}" if code else stated)
        said["crs"] = f"as {control.name} states it"
    if inputs.heights is None:
        heights = {point.xyz[2] for _, point in points}
        flat = f", and are all {heights.pop():g}" if len(heights) == 1 else ""
        why = f"{control.name} does not say what its heights count from{flat}"
        # Those who measure with a drone's altitudes beside them mean the same by both.
        datum = _datum(positions)[0] if positions and not flat else "ellipsoidal"
        inputs, said["heights"] = replace(inputs, heights=datum), f"ASSUMED: {why}"
        remarks.note(f"vertical datum of the control points assumed: {datum} ({why})")
    return inputs


def _unused_positions(inputs: Block, local: bool) -> str | None:
    """Why positions of tags do not go into a block; None where they do."""
    if local:
        return "a local frame was asked for, which has no place on the Earth"
    if inputs.control is None:
        return None
    if inputs.crs is None or inputs.heights is None:
        return "nothing says in which CRS and above which vertical datum the control points are: `crs` and `heights`"
    if (control := odm_list_of(inputs)) is not None:
        from geomosaic.control.read import odm_measurements

        if len({point.xyz[2] for _, point in odm_measurements(control)[1]}) == 1:
            return f"{control.name} has one height for all its points, which is no height above the sea"
    return None


def known_places(photos: Sequence[TaggedPhoto]) -> str:
    """Summary of the positions and attitudes in the tags of photos.

    Parameters
    ----------
    photos : sequence of TaggedPhoto
    """
    place = sum(photo.facts.position is not None for photo in photos)
    attitude = sum(photo.facts.gimbal is not None for photo in photos)
    above = [photo.facts.above_start for photo in photos if photo.facts.above_start is not None]
    text = f"EXIF and XMP: {place} of {len(photos)} photos have a position, {attitude} a gimbal attitude"
    if not above:
        return text
    sampling = _sampling(photos)
    about = f", ground sampling some {100.0 * sampling:.2g} cm" if sampling else ""
    return f"{text}\n  {min(above):g} to {max(above):g} m above the place of take-off{about}"


def _sampling(photos: Sequence[TaggedPhoto]) -> float:
    """Ground sampling in metres by the heights above the place of take-off; 0 where no tag tells them."""
    facts = [photo.facts for photo in photos]
    found = [fact.above_start / fact.focal for fact in facts if fact.above_start and fact.focal]
    return abs(float(np.median(found))) if found else 0.0


def _of_one_place(photos: Sequence[TaggedPhoto], remarks: _Remarks) -> tuple[list[TaggedPhoto], dict[Path, str]]:
    """Photos without positions that cannot be, and without photos of another place, which are set aside."""
    found = list(photos)
    zero = [photo.path.name for photo in photos if photo.facts.no_place]
    if zero:
        remarks.note(f"position 0, 0 not used (the receiver had none yet): {listed(zero, 6)}")
    located = {index: photo.facts.position[:2] for index, photo in enumerate(found) if photo.facts.position}
    if len(located) < 2:
        return found, {}
    places = np.array([*located.values()])
    xy = _metres(places)[1]
    if (usual := _usual_distance(xy)) > ABROAD:
        remarks.note(
            f"positions not used: neighbours lie {usual / 1000.0:.4g} km apart, so that some or all of them are wrong; "
            "correct the tags, or leave out the photos of another place"
        )
        return [_unplaced(photo) for photo in found], {}
    if len(located) < 3:
        return found, {}
    here = _largest_cluster(xy)
    off = np.linalg.norm(xy - np.median(xy[here], axis=0), axis=1)
    far = [index for index, near in zip(located, here, strict=True) if not near]
    aside: dict[Path, str] = {}
    for index, (lon, lat), distance in zip(far, places[~here], off[~here] / 1000.0, strict=True):
        where = f"at {lat:.4f}, {lon:.4f}, {distance:.4g} km from the others"
        # One photo of the block may have a wrong position; several are photos of another place.
        if len(far) < 3:
            remarks.note(f"position of {found[index].path.name} not used: {where}")
            found[index] = _unplaced(found[index])
        else:
            aside[found[index].path] = f"{where}: make a project of its own for them"
    if float(off.max()) < ONE_PLACE:
        remarks.note("positions not used: all photos have the same, which is that of no flight")
        found = [_unplaced(photo) for photo in found]
    return [photo for photo in found if photo.path not in aside], aside


def _largest_cluster(xy: FloatArray) -> BoolArray:
    """Places (N,) in the largest cluster of them, of several as large in that of the first."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    # Cells as large as the gap, joined to their neighbours: the work grows with the places, not with their pairs.
    cells, number = np.unique(np.floor(xy / max(STRAY * _usual_distance(xy), FAR)), axis=0, return_inverse=True)
    pairs = cKDTree(cells).query_pairs(1.5, output_type="ndarray")
    joined = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(cells), len(cells)))
    cluster = connected_components(joined, directed=False)[1][number.ravel()]
    found: BoolArray = cluster == cluster[np.bincount(cluster)[cluster].argmax()]
    return found


def _usual_distance(xy: FloatArray) -> float:
    """Median distance of places (N, 2) from their nearest neighbours."""
    from scipy.spatial import cKDTree

    return float(np.median(cKDTree(xy).query(xy, 2)[0][:, 1]))


def _metres(places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Median of longitudes and latitudes (N, 2), and the places (N, 2) from there in metres."""
    # About one of them, so that a block may lie on the antimeridian.
    east = (places[:, 0] - places[0, 0] + 180.0) % 360.0 - 180.0
    middle = np.array([np.median(east), np.median(places[:, 1])])
    shift = np.column_stack([east, places[:, 1]]) - middle
    degree = 111_320.0
    xy: FloatArray = degree * shift * np.array([np.cos(np.radians(middle[1])), 1.0])
    return middle + np.array([places[0, 0], 0.0]), xy


def _unplaced(photo: TaggedPhoto) -> TaggedPhoto:
    return replace(photo, facts=replace(photo.facts, position=None))


def _placed(
    inputs: Block, photos: Sequence[TaggedPhoto], project: Path, said: dict[str, str], remarks: _Remarks
) -> tuple[Block, dict[Path, str]]:
    """Inputs with a table of positions and attitudes, and the table."""
    places = [photo.facts.position for photo in photos if photo.facts.position]
    flat = not any(math.isfinite(place[2]) for place in places)
    if flat:
        remarks.note("no altitude: all photos are taken to be at one height, and heights count from there")
    level = [photo.path.name for photo in photos if photo.facts.position and math.isnan(photo.facts.position[2])]
    if level and not flat:
        remarks.note(f"no altitude, so that the position is not used: {listed(level, 6)}")
    angles = "dji" if any(photo.facts.gimbal and photo.facts.position for photo in photos) else "none"
    crs = inputs.crs or LONLAT
    whole = all(photo.facts.gimbal and photo.facts.position for photo in photos)
    table = project.with_name(f"{project.stem}-{'exterior' if whole else 'positions'}.csv")
    frame = "longitude, latitude (WGS 84)" if inputs.crs is None else f"x, y in {crs}"
    known = "altitude" if angles == "none" else "altitude and gimbal"
    remarks.lines.append(f"  written to {table.name}: {frame}, {known} as the camera wrote it")
    text = position_table([(photo.path, photo.facts) for photo in photos], crs, angles, 0.0 if flat else math.nan)
    said["angles"] = "tie points give the angles" if angles == "none" else ""
    if inputs.heights is None:
        heights, said["heights"], note = _datum(photos)
        remarks.note(note)
        inputs = replace(inputs, heights=heights)
    return replace(inputs, exterior=table, angles=angles, crs=crs), {table: text}


def _datum(photos: Sequence[TaggedPhoto]) -> tuple[str, str, str]:
    """Vertical datum of the altitudes, with a remark for the project and a line for people: it is an assumption."""
    tags = [photo.facts.heights for photo in photos if photo.facts.position]
    known = {tag for tag in tags if tag}
    lon, lat, _ = next(photo.facts.position for photo in photos if photo.facts.position)
    shift = undulation(parse_crs(LONLAT), lon, lat)
    if known == {"ellipsoidal"} and all(tags):
        heights, why = "ellipsoidal", "positions by RTK count from the ellipsoid"
    else:
        heights, why = "egm96", "above the sea, as most cameras mean it, if not always exactly"
    other = "the geoid EGM96" if heights == "ellipsoidal" else "the ellipsoid"
    cost = f"; if they count from {other}, all heights shift by {abs(shift):.1f} m" if math.isfinite(shift) else ""
    return heights, f"ASSUMED: {why}{cost}", f"vertical datum of the altitudes assumed: {heights} ({why}){cost}"


def _utm(positions: Sequence[TaggedPhoto]) -> str | None:
    """EPSG code of the UTM zone of a block; None near the poles, which have none."""
    lon, lat = _metres(np.array([photo.facts.position[:2] for photo in positions if photo.facts.position]))[0]
    try:
        code = utm_zone(float((lon + 180.0) % 360.0 - 180.0), float(lat)).to_epsg()
    except InputError:
        return None
    return None if code is None else f"EPSG:{code}"


def _accuracy(photos: Sequence[TaggedPhoto], angles: str) -> tuple[float, list[str]]:
    """Standard deviation of positions in metres, and lines of [adjust] about positions and attitudes."""
    sigmas = [photo.facts.sigma for photo in photos if photo.facts.position and photo.facts.sigma]
    known = len(sigmas) == sum(photo.facts.position is not None for photo in photos)
    rtk = known and all(photo.facts.heights == "ellipsoidal" for photo in photos if photo.facts.position)
    if rtk:
        sigma, why = max(float(np.median(sigmas)), LEAST_SIGMA), "of RTK, as its tags tell"
    else:
        sigma = max(float(np.median(sigmas)), POSITION_SIGMA) if known else POSITION_SIGMA
        why = "of a receiver in a camera"
    lines = [f"position_sigma = {sigma:<12.2g}# metres, {why}"]
    if angles != "none":
        lines.append(f"attitude_sigma = {ATTITUDE_SIGMA:<12.2g}# degrees, of a gimbal with a compass")
    return sigma, lines


def _cameras(
    inputs: Block, photos: Sequence[TaggedPhoto], project: Path, remarks: _Remarks
) -> tuple[Block, dict[Path, str], list[str]]:
    """Inputs with a camera for each kind of photos, their files, and the lines of [adjust] on them.

    A camera that was given stands for all photos.
    """
    if inputs.camera is not None:
        names = 'interior = ["focal_length", "principal_point", "k1", "k2"]'
        return inputs, {}, [f"# {names}    # to be found, if the camera is not calibrated"]
    kinds: dict[tuple[object, ...], list[TaggedPhoto]] = {}
    for photo in photos:
        fact = photo.facts
        # In thousandths of the diagonal: focal lengths in tags are rounded.
        share = None if fact.focal is None else round(1000.0 * fact.focal / math.hypot(*photo.size))
        kinds.setdefault((fact.camera, fact.serial, photo.size, share), []).append(photo)
    tables, own, sigmas = {}, dict(inputs.image_options), dict[str, float]()
    for key in [key for key in kinds if key[0] == "" and key[-1] is None]:
        # Edited photos have lost their tags; one camera takes photos of one size.
        alike = [other for other in kinds if other != key and other[2] == key[2]]
        if len(alike) == 1:
            names = listed((photo.path.name for photo in kinds[key]), 3)
            remarks.note(f"no tags: {names}; taken for photos of the {alike[0][0]}, by their size")
            kinds[alike[0]] += kinds.pop(key)
    groups = sorted(kinds.values(), key=len, reverse=True)
    for number, group in enumerate(groups, start=1):
        first, size = group[0].facts, group[0].size
        file = project.with_name(f"{project.stem}-camera{'' if number == 1 else f'-{number}'}.toml")
        assumed = first.focal is None
        focal = ASSUMED_FOCAL * max(size) if first.focal is None else first.focal
        sigma = focal * (ASSUMED_SHARE if assumed else first.focal_sigma)
        sigmas["" if number == 1 else f":{group[0].path.name}"] = float(f"{sigma:.2g}")
        source = f"ASSUMED, {ASSUMED_FOCAL:g} times the longer side: no tag tells it" if assumed else first.focal_from
        tables[file] = camera_text(first, size, focal, source)
        if number == 1:
            inputs = replace(inputs, camera=file)
        else:
            own |= {photo.path.name: {**own.get(photo.path.name, {}), "camera": str(file)} for photo in group}
        names = f" ({listed((photo.path.name for photo in group), 3)})" if number > 1 else ""
        remarks.lines.append(
            f"camera: {first.camera or 'not named in the tags'}, {counted(len(group), 'photo')}{names} of "
            f"{size[0]} x {size[1]}; focal length {focal:.1f} px, {source}; written to {file.name}"
        )
        if assumed:
            remarks.notes.append(f"focal length of {file.name} {source}")
    if len(groups) > 1:
        remarks.lines.append(
            f"  {len(groups)} cameras or lens settings: one block of so many cameras, each found by itself"
        )
    longest = max(max(photo.size) for photo in photos)
    of_cameras = [f"focal_length{of}={sigma:g}" for of, sigma in sigmas.items() if not of or sigma != sigmas[""]]
    unknown = [*of_cameras, f"principal_point={PRINCIPAL_SHARE * longest:.2g}", "k1", "k2"]
    text = f"interior = {json.dumps(unknown)}    # found with the orientations; = standard deviation before"
    more = "self_calibration = true    # further parameters of the lens, where the block determines them"
    return replace(inputs, image_options=own), tables, [text, more]


def camera_text(facts: PhotoFacts, size: tuple[int, int], focal: float, source: str) -> str:
    """Camera file of a photo.

    Parameters
    ----------
    facts : PhotoFacts
    size : tuple of int
    focal : float
        Pixels.
    source : str
        Where it comes from.
    """
    return (
        f"# Focal length: {source}. Lens distortion and principal point are not in the photos.\n"
        f"name = {json.dumps(facts.camera, ensure_ascii=False)}\nsize = [{size[0]}, {size[1]}]\n"
        f"focal_length_px = {focal:.3f}\n"
    )


def position_table(photos: Sequence[tuple[Path, PhotoFacts]], crs: str, angles: str, missing: float = math.nan) -> str:
    """Table of positions in a CRS, with gimbal angles where a photo has them; what is not known is left empty.

    Parameters
    ----------
    photos : sequence of Path and PhotoFacts
    crs : str
    angles : str
        'dji', or 'none' for positions alone.
    missing : float
        Altitude where a position has none; NaN leaves the whole position empty.
    """
    places = np.array([facts.position or (math.nan,) * 3 for _, facts in photos])
    places[:, 2] = np.where(np.isnan(places[:, 2]), missing, places[:, 2])
    known = np.isfinite(places[:, 0])
    if not parse_crs(crs).equals(parse_crs(LONLAT)):
        level = np.column_stack([places[known, :2], np.zeros(np.count_nonzero(known))])
        # Horizontally alone: what the altitude counts from is not known.
        places[known, :2] = Transform(parse_crs(LONLAT), horizontal(parse_crs(crs)))(level)[:, :2]
    places[~np.isfinite(places).all(axis=1)] = math.nan
    digits = 9 if parse_crs(crs).is_geographic else 4
    with_gimbal = angles != "none"
    rows = ["image,x,y,z" + (",gimbal_yaw,gimbal_pitch,gimbal_roll" if with_gimbal else "")]
    for (path, facts), place in zip(photos, places, strict=True):
        cells = [f"{v:.{n}f}" if math.isfinite(v) else "" for v, n in zip(place, (digits, digits, 4), strict=True)]
        if with_gimbal:
            cells += [f"{value:g}" for value in facts.gimbal] if facts.gimbal else [""] * 3
        rows.append(",".join([_quoted(path.name), *cells]))
    return "\n".join(rows) + "\n"


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if any(mark in name for mark in ",; \t\"'#") else name
