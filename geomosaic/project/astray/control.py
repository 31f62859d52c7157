"""Whether control lies where the images put it; where not, what is likeliest wrong, and the mend.

Control points of a sensor that does not adjust itself only judge: that they lie far off must not pass in silence.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

from pyproj import CRS

from geomosaic.block.block import Block, ControlPoint
from geomosaic.block.scene import Scene
from geomosaic.errors import GeomosaicError, SolveError
from geomosaic.project.astray.readings import point_readings
from geomosaic.project.inputs import BlockInputs
from geomosaic.project.orientation.doubts import BETTER, FAR, PLAUSIBLE, distance
from geomosaic.sensor.registry import plugin

FEW = 3
"""Points by which no other reading is told from chance."""


@dataclass(frozen=True)
class Astray:
    """Points of one role that lie far from where the images put them.

    Attributes
    ----------
    role : str
        'control' or 'check'.
    median : float
        Of their distances, pixels; inf where an image cannot see them at all.
    cause : str
        What is likeliest wrong; empty where nothing usual explains it.
    mend : str
    """

    role: str
    median: float
    cause: str
    mend: str

    @property
    def text(self) -> str:
        """One sentence, and the mend."""
        off = f"{self.median:.3g} px" if self.median < 1e6 else "out of sight"
        why = f"; {self.cause}" if self.cause else ""
        return f"{self.role} points lie {off} (median) from where the images put them{why}: {self.mend}"


def astray(inputs: BlockInputs, block: Block) -> list[Astray]:
    """Points, control and check apart, of which the median lies farther off than `FAR` pixels.

    Parameters
    ----------
    inputs : BlockInputs
    block : Block
        Made of them; its images adjusted to the control as far as their sensor does that.
    """
    if block.crs is None or inputs.planar is not None or inputs.sensor == "planar":
        return []
    found = []
    for role in ("control", "check"):
        points = [point for point in block.control if point.role == role]
        off = distance(block.scenes, points, block.crs) if points else 0.0
        if off > FAR:
            scenes = _unrefined(inputs) or block.scenes
            cause, mend = _cause(scenes, points, block.crs, distance(scenes, points, block.crs))
            found.append(Astray(role, off, cause, mend or _how_to_adjust(inputs, role)))
    return found


def explain(inputs: BlockInputs, control: Sequence[ControlPoint], crs: CRS | None, error: SolveError) -> None:
    """Put the likeliest cause into the error of a sensor that its control points did not determine."""
    points = [point for point in control if point.role == "control"]
    scenes = _unrefined(inputs)
    if crs is None or scenes is None or not points:
        return
    cause, mend = _cause(scenes, points, crs, distance(scenes, points, crs))
    if cause:
        error.what, error.mend = f"{error.what}: the points do not lie in the image; {cause}", mend


def _cause(scenes: Sequence[Scene], points: Sequence[ControlPoint], crs: CRS, given: float) -> tuple[str, str]:
    """The reading of the points that brings them where the images put them, with its mend; empty words for none."""
    if len(points) < FEW or given <= FAR:
        return "", ""
    sizes = {scene.name: scene.model.size for scene in scenes}
    tried = [(distance(scenes, reading.points, crs), reading) for reading in point_readings(points, crs, sizes)]
    least, best = min(tried, key=lambda pair: pair[0])
    plausible = PLAUSIBLE * min(math.hypot(*size) for size in sizes.values())
    if BETTER * least < given and least < plausible:
        return f"with {best.what} it would be {least:.3g} px", best.mend
    return "", ""


def _unrefined(inputs: BlockInputs) -> Sequence[Scene] | None:
    """The images without what the control made of them; None where their sensor cannot be had so."""
    from geomosaic.project.build import build_block

    if not any(entry.name == "refine" for entry in plugin(inputs.sensor).inputs):
        return None
    plain = replace(inputs, control=None, options={**inputs.options, "refine": "none"})
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return build_block(plain, ground=False).scenes
    except GeomosaicError:
        return None


def _how_to_adjust(inputs: BlockInputs, role: str) -> str:
    """Mend where nothing usual explains it."""
    known = {entry.name for entry in plugin(inputs.sensor).inputs}
    resected = "points" in known and inputs.exterior is None and "orientation" not in inputs.options
    only = ""
    if role == "control" and "refine" in known and inputs.options.get("refine") == "none":
        only = "they only judge, as refine is 'none': "
    elif role == "control" and "refine" not in known and not resected:
        more = ", but photos without an [exterior] file are placed by three of them" if "points" in known else ""
        only = f"they only judge, as sensor '{inputs.sensor}' is not adjusted to them{more}: "
    return (
        f"{only}check their CRS, the order of x and y, the vertical datum of z, and how col and row are counted; an "
        f"orientation that is poor itself has to be adjusted; what you accept is max_{role}_rms_px under [quality]"
    )
