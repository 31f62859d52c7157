"""Next point of an image: expected accuracy with one more point at each place, and the order of points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from geomosaic.control.edit import ControlText, TableRow
from geomosaic.control.points import ControlPoints
from geomosaic.geo.crs import has_heights
from geomosaic.geo.transform import Transform
from geomosaic.georeferencing.live_control import LiveControl, Subscene, next_control, next_in_block
from geomosaic.sensor.plugin import SensorModel
from geomosaic.studio.control.block_prior import BlockPrior
from geomosaic.studio.control.station import Station
from geomosaic.studio.history import text_of
from geomosaic.types import FloatArray

# Points of the table that the order of candidates lists, and cells of the image.
_LISTED = 12


def advice_facts(
    station: Station,
    rows: Sequence[TableRow],
    live: LiveControl,
    prior: BlockPrior | None,
    part: Subscene | None = None,
) -> dict[str, Any]:
    """JSON values of where one more point helps most; of an image of an adjusted block, beside what that knows.

    Parameters
    ----------
    station : Station
        Image with its table, model and surface.
    rows : sequence of TableRow
        Of the image's table.
    live : LiveControl
        Solution with the points measured so far.
    prior : BlockPrior or None
    part : Subscene, optional
        Part of the image that is fitted; not with a prior, which is of the whole.

    Returns
    -------
    dict
        Places in pixels, standard deviations in metres, or in pixels where there is no solution yet.
    """
    model = live.model if prior is None else prior.model
    determined = live.solution is not None or prior is not None
    names, candidates = _candidates(station, rows, model, part) if model is not None and determined else ([], None)
    if prior is None:
        found = next_control(live, station.size, station.model, station.surface, candidates, area=part, count=_LISTED)
    else:
        since = _since(rows, live.control, prior)
        found = next_in_block(
            since, prior.model, prior.covariance, station.surface, candidates,
            sigma_px=prior.unit * prior.sigma_px, count=_LISTED,
        )  # fmt: skip
    nominal = prior is None and live.solution is None and isinstance(station.model, str)
    places = found.grid.colrow.reshape(-1, 2)
    if candidates is not None and model is not None:
        places = model.ground_to_image(candidates)
    order = [
        {"col": places[index, 0], "row": places[index, 1], "rms": rms, "id": names[index] if names else None}
        for index, rms in zip(found.order.chosen.tolist(), found.predicted[1:].tolist(), strict=True)
    ]
    return {
        "unit": "px" if nominal else "m",
        "of_block": prior is not None,
        "rms": found.rms,
        "sigma": found.sigma.tolist(),
        "rms_with": found.rms_with.tolist(),
        "order": order,
        "extent": [0, 0, *station.size] if part is None else list(part.within(station.size)),
    }


def _since(rows: Sequence[TableRow], control: ControlPoints, prior: BlockPrior) -> ControlPoints:
    """Points that were measured since the adjustment, as accurate as it would take them."""
    known = {row.values.get("id") for row in rows if row.values.get("sigma_px")}
    taken = [own if name in known else prior.sigma_px for name, own in zip(control.names, control.sigma, strict=True)]
    sigma = prior.unit * np.array(taken, dtype=np.float64)
    new = np.array([name not in prior.measured for name in control.names], dtype=np.bool_)
    return replace(control, sigma=sigma).select(new)


def _candidates(
    station: Station, rows: Sequence[TableRow], model: SensorModel, part: Subscene | None
) -> tuple[list[str], FloatArray | None]:
    """Names and ground points (N, 3) of the table that are measured in other images only; None without any."""
    measured = {row.values.get("id") for row in rows}
    others: dict[str, list[float]] = {}
    for row in ControlText.of(text_of(station.table)).rows:
        name = row.values.get("id", "")
        try:
            xyz = [float(row.values.get(axis) or "nan") for axis in ("x", "y", "z")]
        except ValueError:
            continue
        if name and name not in measured:
            others[name] = xyz
    if not others or station.crs is None:
        return [], None
    places = np.array(list(others.values()))
    flat = not has_heights(model.crs)
    moved = Transform(station.crs, model.crs)(places[:, :2] if flat else places)
    ground = np.zeros((len(moved), 3))
    ground[:, : moved.shape[1]] = moved
    colrow = model.ground_to_image(ground)
    seen = (part or Subscene(0.0, 0.0, *station.size)).holds(colrow)
    if not seen.any():
        return [], None
    return [name for name, there in zip(others, seen, strict=True) if there], ground[seen]
