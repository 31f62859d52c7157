"""Orientation of an image as the adjustment of its block left it: what further control points start from."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

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
    """

    model: SensorModel
    covariance: FloatArray
    measured: Collection[str]
    sigma_px: float


def block_prior(project: Project, image: Path) -> BlockPrior | None:
    """Adjusted model of an image; None where no block adjustment has told its covariance.

    Parameters
    ----------
    project : Project
    image : Path
    """
    layout = Layout(project)
    if project.adjustment is None or image not in project.images:
        return None
    path, facts = layout.models[project.images.index(image)], layout.facts("orient")
    if not path.is_file() or not facts.is_file():
        return None
    try:
        state, control = read_json(path), read_json(facts)["control"]
        if state["covariance"] is None:
            return None
        model = model_from_dict(dict(state))
        count = len(model.parameters)
        covariance = np.array(state["covariance"], dtype=np.float64)[:count, :count]
        measured = {one["id"] for one in control if one["image"] == image.name}
    except (ValueError, KeyError, TypeError):  # of an image that was set aside, or damaged
        return None
    return BlockPrior(model, covariance, measured, project.adjustment.sigma_px) if covariance.any() else None
