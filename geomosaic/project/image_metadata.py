"""What images carry of a block: sensor models, georeferences, tags of photos; for drafts of projects."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

from geomosaic.errors import OutputExistsError, SensorInputError, counted
from geomosaic.inputs.declarations import Block
from geomosaic.project.folders import SortedImages, sort_photos
from geomosaic.project.photo_block import (
    LONLAT,
    EmbeddedInputs,
    TaggedPhoto,
    camera_text,
    known_places,
    odm_list_of,
    position_table,
    tied_photos,
)
from geomosaic.project.photo_tags import photo_facts
from geomosaic.raster.image_metadata import read_photo_tags
from geomosaic.raster.info import SourceInfo, control_point_count, inspect
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.registry import carried_sensors, photo_sensor, plane_sensor, trial
from geomosaic.whole_files import write_atomic


def embedded_inputs(inputs: Block, project: Path, found: SortedImages | None = None) -> EmbeddedInputs:
    """Inputs of a project completed from its images.

    Sensor models that all images carry come first, then georeferences or control points, then EXIF and XMP. Where the
    sensor is one of photos, EXIF and XMP alone are read.

    Parameters
    ----------
    inputs : Block
    project : Path
        The project file; tables are named after it and lie beside it.
    found : SortedImages, optional
        Images of `inputs` as they were found; those of folders are sorted further where they are photos.
    """
    found = found or SortedImages(inputs.images)
    infos = {path: inspect(path, inputs.bands) for path in found.images}
    lying = {path for path, info in infos.items() if info.crs is not None and info.transform is not None}
    # A DEM or an ortho that lies among the photos is none of them.
    among = {path: "it is georeferenced: no photo as it was taken" for path in infos if path in lying & found.loose}
    maps = among if len(among) < len(infos) else {}
    if inputs.sensor != photo_sensor():
        known = _other_than_photos(inputs, infos, lying, maps)
        if known is not None:
            return replace(known, lines=[*found.lines, *known.lines], aside=found.aside)
    found = found.without(maps)
    facts = {path: photo_facts(read_photo_tags(path), infos[path].size) for path in found.images}
    found = sort_photos(found, [path for path, fact in facts.items() if fact.position or fact.focal])
    tags = [TaggedPhoto(path, infos[path].size, facts[path]) for path in found.images]
    inputs = replace(inputs, images=found.images)
    carried = tied_photos(inputs, tags, project) if len(tags) > 1 else _one_photo(inputs, tags[0], project)
    return replace(carried, lines=[*found.lines, *carried.lines], aside={**found.aside, **carried.aside})


def _other_than_photos(
    inputs: Block, infos: Mapping[Path, SourceInfo], lying: Collection[Path], maps: Collection[Path]
) -> EmbeddedInputs | None:
    """Images with a model, a georeference or control points, or that tell nothing; None of what may be photos."""
    own = carried_sensors([(path, info.size) for path, info in infos.items()])
    placed = len(lying) == len(infos)
    if own:
        lines = [f"model: each image carries one for the sensor {own[0]}"]
        if len(own) > 1:
            lines.append(f"  and one for {' and '.join(own[1:])}: say `sensor` to take that")
        if placed:
            lines.append(f"  they are georeferenced too: say `sensor={plane_sensor()}` to take them as they lie")
        return EmbeddedInputs(replace(inputs, sensor=own[0]), lines=lines)
    # OpenDroneMap's list is of photos, whatever else control points may be of.
    if placed or (inputs.control is not None and odm_list_of(inputs) is None):
        return EmbeddedInputs(inputs)
    rest = {path: info for path, info in infos.items() if path not in maps}
    tagged = [(path, control_point_count(path)) for path in rest]
    with_points = [f"{path.name} carries {counted(count, 'control point')}" for path, count in tagged if count]
    if with_points:
        hint = "images placed by their own control points: geomosaic georeference IMAGE ... -o PLACED, and PLACED here"
        return EmbeddedInputs(inputs, lines=with_points, needed=[hint])
    if not all(map(_like_a_photo, rest.values())):
        return EmbeddedInputs(inputs, lines=["no image says where it was taken: no georeference, RPC, DIMAP or GPS"])
    return None


def _like_a_photo(info: SourceInfo) -> bool:
    """Whether a raster may be a photo by its samples: eight or sixteen bits, grey or in colours."""
    return info.dtype in ("uint8", "uint16") and info.bands in (1, 3, 4)


def write_tables(carried: EmbeddedInputs, *, overwrite: bool = False) -> None:
    """Write the tables of a draft beside its project.

    Parameters
    ----------
    carried : EmbeddedInputs
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


def _one_photo(inputs: Block, photo: TaggedPhoto, project: Path) -> EmbeddedInputs:
    """Position, attitude and camera of a photo that nothing can be tied to."""
    facts, tables, lines = photo.facts, dict[Path, str](), list[str]()
    tagged = facts.position is not None or facts.gimbal is not None
    if tagged:
        inputs = replace(inputs, sensor=photo_sensor())
    if facts.camera:
        focal = f", focal length {facts.focal:.1f} px from {facts.focal_from}" if facts.focal else ""
        lines.append(f"camera: {facts.camera}{focal}")
    if tagged:
        lines.append(known_places([photo]))
    else:
        lines.append("no image says where it was taken: no georeference, RPC, DIMAP or GPS")
    lines.append(
        "one photo alone: two or more that overlap are oriented by tie points; add photos, or place it by an ortho of "
        "its land or by control points (`geomosaic georeference`), or give its orientation"
    )
    if inputs.exterior is None and inputs.control is None and facts.position and facts.gimbal:
        table, crs = project.with_name(f"{project.stem}-exterior.csv"), inputs.crs or LONLAT
        tables[table] = position_table([(photo.path, facts)], crs, "dji")
        lines.append(f"  written to {table.name}: position and gimbal as the camera wrote them, to metres and degrees")
        inputs = replace(inputs, exterior=table, angles="dji", crs=crs)
    if facts.focal is not None and inputs.camera is None and tagged:
        camera = project.with_name(f"{project.stem}-camera.toml")
        tables[camera] = camera_text(facts, photo.size, facts.focal, facts.focal_from)
        inputs = replace(inputs, camera=camera)
        lines.append(f"  written to {camera.name}: {facts.focal:.1f} px, from {facts.focal_from}; no distortion")
    return EmbeddedInputs(inputs, tables, lines)
