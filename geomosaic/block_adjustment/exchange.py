"""Adjusted blocks as reconstructions, in which form other programs take them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block import OrientedImage
from geomosaic.block_adjustment.measurements import Measurements
from geomosaic.block_adjustment.start import StartBlock
from geomosaic.errors import InputError, counted, listed, warn
from geomosaic.geo.crs import geographic, is_local
from geomosaic.geo.transform import Transform
from geomosaic.interchange.formats import WRITERS, write_reconstruction
from geomosaic.interchange.reconstruction import ImagePoints, ImagePose, ObjectPoints, Reconstruction
from geomosaic.orientation.block.poses import pose_of
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.sensor.plugin import HasCameraTable, HasPose


def reconstruction_of(
    scenes: Sequence[OrientedImage], solution: BlockSolution, measured: Measurements, start: StartBlock
) -> Reconstruction:
    """Photos, points and accepted measurements of an adjusted block, east, north, up at its middle.

    Parameters
    ----------
    scenes : sequence of OrientedImage
        Adjusted; those of sensors without one projection centre are left out with a warning.
    solution : BlockSolution
    measured : Measurements
    start : StartBlock
        The same images before the adjustment.
    """
    problem = solution.adjustment.problem
    local = problem.frame.local
    cameras: dict[str, Any] = {}
    numbers: dict[str, str] = {}
    images: list[ImagePose] = []
    before: list[ImagePose] = []
    index = np.full(len(scenes), -1)
    for at, scene in enumerate(scenes):
        if not isinstance(scene.model, HasPose) or not isinstance(scene.model, HasCameraTable):
            continue
        table = dict(scene.model.camera_table)
        name = numbers.setdefault(repr(table), str(len(numbers) + 1))
        cameras[name] = table
        pose = pose_of(scene.model, problem.frame)
        index[at] = len(images)
        images.append(ImagePose(scene.name, name, pose.rotation, pose.centre))
        if start.oriented[at]:
            given = pose_of(start.models[at], problem.frame)
            before.append(ImagePose(scene.name, None, given.rotation, given.centre))
    left_out = [scene.name for scene, at in zip(scenes, index, strict=True) if at < 0]
    if left_out:
        text = f"{counted(len(left_out), 'image')} without one projection centre left out: {listed(left_out)}"
        warn(text)
    xyz = problem.frame.from_ground(solution.ground)
    good = (index[measured.image] >= 0) & (solution.adjustment.state.weights[0] > 0.0)
    seen = ImagePoints(index[measured.image[good]], measured.point[good], measured.colrow[good], measured.sigma[good])
    reference, crs = None, None
    if not is_local(local.crs):
        datum = geographic(local.crs)
        longitude, latitude, height = Transform(local.crs, datum)(local.origin[None])[0].tolist()
        reference, crs = (longitude, latitude, height), datum.to_wkt()
    points = ObjectPoints(tuple(solution.ids), xyz)
    return Reconstruction(cameras, tuple(images), points, seen, crs, reference, before=tuple(before))


def write_exports(
    found: Reconstruction, ground: CRS, formats: Sequence[str], folder: Path, name: str
) -> dict[str, Path]:
    """Folders of files of other programs; what a format has no place for is left out with a warning.

    Parameters
    ----------
    found : Reconstruction
    ground : CRS
        Of the block: the map of programs that count in one.
    formats : sequence of str
        Of `WRITERS`.
    folder : Path
        Gets a folder for each.
    name : str
        Of the block.
    """
    written: dict[str, Path] = {}
    if not found.images:  # which `reconstruction_of` told
        return written
    folder.mkdir(parents=True, exist_ok=True)
    for format in formats:
        writer, home = WRITERS[format], folder / format
        path = home / f"{name}{writer.ending}" if writer.ending else home
        try:
            block = found.in_map(ground) if writer.in_map and found.on_earth is not None else found
            write_reconstruction(block, path, format, overwrite=True)
            written[format] = home
        except InputError as error:
            # The adjustment stands, whatever another program's format has no place for.
            warn(f"not exported as {format}: {error}")
    return written
