"""How far photos are from meeting at the points they share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.adjust.edges.problem import Problem
from geomosaic.adjust.edges.start import ground_of
from geomosaic.sensor.model import SensorModel
from geomosaic.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Misfit:
    """Where one photo puts what another shows: for each shared point and each pair of photos that show it.

    Attributes
    ----------
    ids : tuple of str (M,)
        Points.
    pairs : tuple of (str, str) (M,)
        First and second photo.
    ground : array (M, 2)
        Second minus first, units of the map.
    pixels : array (M, 2)
        In the first photo: where it would show what the second has measured, minus where it is measured.
    """

    ids: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    ground: FloatArray
    pixels: FloatArray

    @property
    def lengths(self) -> FloatArray:
        """Lengths (M,) in pixels of the first photo; NaN where a photo has no place of its own."""
        length: FloatArray = np.hypot(self.pixels[:, 0], self.pixels[:, 1])
        return length

    @property
    def rms(self) -> float:
        """Root mean square length in pixels, of the pairs that have one; NaN where none has."""
        known = self.lengths[np.isfinite(self.lengths)]
        return float(np.sqrt((known**2).mean())) if len(known) else float("nan")

    @property
    def largest(self) -> float:
        """Largest length in pixels; NaN where no pair has one."""
        known = self.lengths[np.isfinite(self.lengths)]
        return float(known.max()) if len(known) else float("nan")


def misfit(problem: Problem, models: list[SensorModel], placed: BoolArray | None = None) -> Misfit:
    """Measure the misfit of photos at their shared points.

    Parameters
    ----------
    problem : Problem
    models : list of SensorModel
    placed : bool array (photos,), optional
        Photos that have a place; pairs with others are NaN.
    """
    s = problem.stations
    places = ground_of(problem, models)
    if placed is not None:
        places[~placed[s.photo]] = np.nan
    ids, pairs, rows = [], [], []
    for station in np.flatnonzero(s.shared):
        seen = np.flatnonzero(s.station == station)
        for k, first in enumerate(seen):
            for second in seen[k + 1 :]:
                ids.append(s.ids[station])
                pairs.append((problem.photos[s.photo[first]], problem.photos[s.photo[second]]))
                rows.append((first, second))
    table = np.array(rows, dtype=np.int64).reshape(-1, 2)
    pixels = np.full((len(table), 2), np.nan)
    for index, model in enumerate(models):
        mine = s.photo[table[:, 0]] == index
        if mine.any():
            there = model.ground_to_image(problem.to_model[index](places[table[mine, 1]]))
            known = np.isfinite(places[table[mine, 0], 0])
            pixels[mine] = np.where(known[:, None], there - s.colrow[table[mine, 0]], np.nan)
    return Misfit(tuple(ids), tuple(pairs), (places[table[:, 1]] - places[table[:, 0]])[:, :2], pixels)
