"""Control discrepancies of a block: control and check points that do not lie where its images put them."""

from __future__ import annotations

from dataclasses import dataclass

from geomosaic.block.block import OrientedBlock
from geomosaic.inputs.build import unadjusted
from geomosaic.inputs.control_diagnostics import likeliest_cause
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.orientation_plausibility import FAR, median_distance
from geomosaic.sensor.plugin import ControlUse
from geomosaic.sensor.registry import capabilities


@dataclass(frozen=True)
class ControlDiscrepancy:
    """Discrepancy between the points of one role and the images.

    Attributes
    ----------
    role : str
        'control' or 'check'.
    median : float
        Median distance, pixels; inf where an image cannot see them at all.
    cause : str
        Likeliest slip; empty where none explains it.
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
    """Discrepancies of control and check points whose median distance exceeds `FAR` pixels.

    Parameters
    ----------
    inputs : Block
    block : OrientedBlock
        Block built of them, adjusted on the control as far as its sensor does that.

    Returns
    -------
    list of ControlDiscrepancy
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
    """Hint where no usual slip explains a discrepancy."""
    use = capabilities(inputs.sensor).control
    resected = use is ControlUse.RESECTION and inputs.exterior is None and "orientation" not in inputs.options
    only = ""
    if role == "control" and use is ControlUse.ADJUSTMENT and inputs.options.get("refine") == "none":
        only = "they serve for assessment only, as refine is 'none': "
    elif role == "control" and use is not ControlUse.ADJUSTMENT and not resected:
        placed = use is ControlUse.RESECTION
        more = ", but photos without an [exterior] file are placed by three of them" if placed else ""
        only = f"they serve for assessment only, as sensor '{inputs.sensor}' is not adjusted on them{more}: "
    return (
        f"{only}check their CRS, the order of x and y, the vertical datum of z, and how col and row are counted; an "
        f"orientation that is poor itself has to be adjusted; what you accept is max_{role}_rms_px under [quality]"
    )
