"""Orientation of an image as the adjustment of its block left it: what further control points start from."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.estimation.statistics import variance_factor
from geomosaic.jobs.manifest import Layout, read_json
from geomosaic.project.load import Project
from geomosaic.sensor.corrected import model_from_dict
from geomosaic.sensor.plugin import SensorModel
from geomosaic.types import FloatArray


@dataclass(frozen=True, eq=False)
class BlockPrior:
    """Adjusted model of an image of a block.

    Attributes
    ----------
    model : SensorModel
    covariance : array (P, P)
        Of its parameters, from the adjustment of the whole block.
    measured : collection of str
        Control and check points that were measured in the image then.
    sigma_px : float
        Standard deviation that the adjustment takes for an image coordinate, pixels.
    unit : float
        Standard deviation of unit weight that scales the covariance, and so those of new points; 1 where those of the
        measurements are trusted.
    """

    model: SensorModel
    covariance: FloatArray
    measured: Collection[str]
    sigma_px: float
    unit: float = 1.0


def block_prior(project: Project, image: Path) -> BlockPrior | None:
    """Adjusted model of an image; None where no adjustment of a block, planar ones among them, has told its covariance.

    Parameters
    ----------
    project : Project
    image : Path
    """
    layout = Layout(project)
    planar = project.inputs.planar is not None
    if (project.adjustment is None and not planar) or image not in project.images:
        return None
    path, facts = layout.models[project.images.index(image)], layout.facts("orient")
    if not path.is_file() or not facts.is_file():
        return None
    try:
        state, found = read_json(path), read_json(facts)
        if state["covariance"] is None:
            return None
        model = model_from_dict(dict(state))
        count = len(model.parameters)
        covariance = np.array(state["covariance"], dtype=np.float64)[:count, :count]
        measured = {one["id"] for one in found["control"] if one["image"] == image.name}
        unit = _unit(found["planar"], image.name) if planar else 1.0
    except (ValueError, KeyError, TypeError):  # of an image that was set aside, or damaged
        return None
    # A planar block takes a pixel where its table tells nothing else.
    sigma_px = 1.0 if project.adjustment is None else project.adjustment.sigma_px
    return BlockPrior(model, covariance, measured, sigma_px, unit) if covariance.any() else None


def _unit(planar: Mapping[str, Any], image: str) -> float:
    """Standard deviation of unit weight of a photo of a planar block, rectified with the others or singly."""
    own: Mapping[str, Any] = next((one for one in planar["photos"] if one["photo"] == image), {})
    sigma0, redundancy = ({**planar, **own}[name] for name in ("sigma0", "redundancy"))
    return math.sqrt(variance_factor(math.nan if sigma0 is None else sigma0, redundancy))
