"""Control diagnostics of a block: whether control lies where the images put it, and what is likeliest wrong.

Control points of a sensor that does not adjust itself only judge: that they lie far off must not pass in silence.
"""

from __future__ import annotations

from dataclasses import dataclass

from geomosaic.block.block import OrientedBlock
from geomosaic.inputs.build import unadjusted
from geomosaic.inputs.control_hypotheses import likeliest_cause
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.orientation_check.plausibility import FAR, median_distance
from geomosaic.sensor.plugin import ControlUse
from geomosaic.sensor.registry import capabilities


@dataclass(frozen=True)
class ControlDiscrepancy:
    """Points of one role that lie far from where the images put them.

    Attributes
    ----------
    role : str
        'control' or 'check'.
    median : float
        Of their distances, pixels; inf where an image cannot see them at all.
    cause : str
        What is likeliest wrong; empty where nothing usual explains it.
    hint : str
    """

    role: str
    median: float
    cause: str
    hint: str

    @property
    def text(self) -> str:
        """One sentence, and a hint."""
        off = f"{self.median:.3g} px" if self.median < 1e6 else "out of sight"
        why = f"; {self.cause}" if self.cause else ""
        return f"{self.role} points lie {off} (median) from where the images put them{why}: {self.hint}"


def control_discrepancies(inputs: Block, block: OrientedBlock) -> list[ControlDiscrepancy]:
    """Points, control and check apart, of which the median lies farther off than `FAR` pixels.

    Parameters
    ----------
    inputs : Block
    block : OrientedBlock
        Made of them; its images adjusted to the control as far as their sensor does that.
    """
    if block.crs is None or inputs.planar is not None or capabilities(inputs.sensor).planar:
        return []
    found = []
    for role in ("control", "check"):
        points = [point for point in block.control if point.role == role]
        off = median_distance(block.scenes, points, block.crs) if points else 0.0
        if off > FAR:
            scenes = unadjusted(inputs) or block.scenes
            cause, hint = likeliest_cause(scenes, points, block.crs, median_distance(scenes, points, block.crs))
            found.append(ControlDiscrepancy(role, off, cause, hint or _how_to_adjust(inputs, role)))
    return found


def _how_to_adjust(inputs: Block, role: str) -> str:
    """Hint where nothing usual explains it."""
    use = capabilities(inputs.sensor).control
    resected = use is ControlUse.RESECTION and inputs.exterior is None and "orientation" not in inputs.options
    only = ""
    if role == "control" and use is ControlUse.ADJUSTMENT and inputs.options.get("refine") == "none":
        only = "they only judge, as refine is 'none': "
    elif role == "control" and use is not ControlUse.ADJUSTMENT and not resected:
        placed = use is ControlUse.RESECTION
        more = ", but photos without an [exterior] file are placed by three of them" if placed else ""
        only = f"they only judge, as sensor '{inputs.sensor}' is not adjusted to them{more}: "
    return (
        f"{only}check their CRS, the order of x and y, the vertical datum of z, and how col and row are counted; an "
        f"orientation that is poor itself has to be adjusted; what you accept is max_{role}_rms_px under [quality]"
    )
