"""Block of a project as its steps have left it: models, ground, image positions with residuals, facts."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block import Footprint, OrientedBlock, footprint
from geomosaic.block_adjustment.image_residuals import ImageResiduals, image_residuals, joined_positions
from geomosaic.errors import GeomosaicError, InputError
from geomosaic.geo.crs import geographic, horizontal, parse_map
from geomosaic.inputs.build import build_block, join_blocks
from geomosaic.inputs.tie_points import TiePoints, read_ties
from geomosaic.jobs.manifest import Layout, read_json
from geomosaic.jobs.run_control import FileStates, file_states
from geomosaic.jobs.steps.orient import restore_block
from geomosaic.project.load import Project
from geomosaic.render.extent import utm_zone

# What reading a file that a step wrote may end in where something else has written to it.
DAMAGED = (OSError, ValueError, KeyError, TypeError, AttributeError)
DAMAGE, MEND = "what step orient has written is damaged", "run it again"
# Bytes of a DEM that are kept while footprints are made.
_DEM = 32 << 20


@dataclass(frozen=True, eq=False)
class BlockReading:
    """Block as its files have it.

    Attributes
    ----------
    block : OrientedBlock or None
        None where the images have no orientation, as `reason` says.
    state : str
        'adjusted' (as one), 'oriented' (image by image), 'declared' (no step has run), or 'none'.
    reason : str
    crs : CRS
        Map CRS of the block; of no use where `block` is None.
    residuals : ImageResiduals or None
        None where no tie point and no control point is measured.
    facts : mapping
        Of the adjustment, as in `adjustment.json`; empty without one.
    """

    block: OrientedBlock | None
    state: str
    reason: str
    crs: CRS | None
    residuals: ImageResiduals | None
    facts: Mapping[str, Any]

    def footprints(self, crs: CRS) -> dict[str, Footprint]:
        """Footprints by the name of the image; those that see no ground are left out."""
        found = {}
        for scene in () if self.block is None else self.block.scenes:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    found[scene.name] = footprint(scene, self.block.surface if self.block else None, crs)
            except GeomosaicError:
                continue
        return found


def files_of(project: Project) -> FileStates:
    """State of the files that a reading is made of.

    Parameters
    ----------
    project : Project
    """
    layout = Layout(project)
    files = [project.path, *layout.models, *layout.ties, *layout.adjustment, layout.facts("orient"), *layout.surface]
    files += [*project.measurements, *(file for part in project.blocks for file in part.tables)]
    return file_states(files)


def read_block(project: Project) -> BlockReading:
    """Block of a project as its files have it.

    Parameters
    ----------
    project : Project
    """
    layout = Layout(project)
    oriented = all(path.is_file() for path in layout.models)
    points, facts_file = (None, None) if not layout.adjustment else layout.adjustment[:2]
    facts: Mapping[str, Any] = {}
    try:
        facts = facts_of(facts_file) if oriented else {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            block = restore_block(project, _DEM) if oriented else _declared(project)
    except (GeomosaicError, *DAMAGED) as error:
        reason = f"{DAMAGE}; {MEND}"
        if isinstance(error, GeomosaicError):
            reason = f"{error.what}{f'; {error.hint}' if error.hint else ''}"
        return BlockReading(None, "none", reason, None, _ties_alone(project), facts)
    state = "declared" if not oriented else "adjusted" if facts else "oriented"
    adjusted = points if facts and points is not None and points.is_file() else None
    return BlockReading(block, state, "", _map_crs(project, block), _residuals(project, block, adjusted, facts), facts)


def _ties_alone(project: Project) -> ImageResiduals | None:
    """Image positions without residuals; None where they cannot be read either, which the steps tell."""
    with contextlib.suppress(GeomosaicError):
        return _residuals(project, None, None, {})
    return None


def _declared(project: Project) -> OrientedBlock:
    """Block before any step."""
    if project.inputs.planar is not None:
        raise InputError("plane transformations place these photos", hint="run the step orient")
    return join_blocks(project.blocks, [build_block(part) for part in project.blocks])


def _map_crs(project: Project, block: OrientedBlock) -> CRS:
    """CRS of the output, else that of the positions; the UTM zone in place of degrees."""
    if project.area.dst_crs:
        return parse_map(project.area.dst_crs, "`crs`")
    crs = block.crs if block.crs is not None else block.scenes[0].model.crs
    crs = horizontal(geographic(crs) if crs.is_geocentric else crs)
    for scene in block.scenes if crs.is_geographic else ():
        with contextlib.suppress(GeomosaicError):
            return utm_zone(*footprint(scene, block.surface, crs).centre)
    return crs


def facts_of(path: Path | None) -> Mapping[str, Any]:
    """Values of a file that step "orient" has written; empty where there is none.

    Parameters
    ----------
    path : Path or None

    Raises
    ------
    InputError
        The file is damaged.
    """
    if path is None or not path.is_file():
        return {}
    try:
        found = read_json(path)
    except DAMAGED:
        found = None
    if not isinstance(found, dict):
        raise InputError(DAMAGE, where=path.name, hint=MEND)
    return found


def _residuals(
    project: Project, block: OrientedBlock | None, points: Path | None, facts: Mapping[str, Any]
) -> ImageResiduals | None:
    """Image positions of tie points and of control; None where nothing is measured."""
    parts = []
    ties = None if project.adjustment is None else project.adjustment.ties
    if ties is not None and Path(ties).exists():
        parts.append(read_ties(ties))
    orient = Layout(project).facts("orient")
    if points is not None and orient.is_file():
        parts.append(_control(facts_of(orient)))
    measured = joined_positions(parts)
    if not len(measured):
        return None
    models = (
        {image.name: None for image in project.images} if block is None else {s.name: s.model for s in block.scenes}
    )
    out = {(one["image"], one["point"]) for one in facts.get("blunders", ()) if one.get("image")}
    return image_residuals(measured, models, points, out)


def _control(facts: Mapping[str, Any]) -> TiePoints:
    """Image positions of control and check points as step "orient" read them."""
    pairs = [(one["id"], one["image"]) for one in facts.get("control", ())]
    places = facts.get("measured", {})
    known = [(point, image, places[f"{point} {image}"]) for point, image in pairs if f"{point} {image}" in places]
    colrow = np.array([place for _, _, place in known], dtype=np.float64).reshape(-1, 2)
    return TiePoints([point for point, _, _ in known], [image for _, image, _ in known], colrow)
