"""Initial values of edge matching, and how far photos are from meeting at common points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.orientation.edges.adjustment import EdgeProblem
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve import fit, image_to_height
from geomosaic.types import BoolArray, FloatArray


def own_fits(problem: EdgeProblem, models: list[SensorModel]) -> tuple[list[SensorModel], BoolArray]:
    """Models fitted to each photo's own control points alone: the photos without edge matching.

    Parameters
    ----------
    problem : EdgeProblem
    models : list of SensorModel
        Of the photos.

    Returns
    -------
    models : list of SensorModel
        As given where a photo's own control does not determine it.
    fitted : bool array (photos,)
        A photo with nothing free counts as fitted.
    """
    s = problem.stations
    known = np.isfinite(s.sigma)[s.station]
    return _fitted(problem, models, s.xyz, known, np.zeros(len(models), dtype=bool))


def extended_to_neighbours(problem: EdgeProblem, models: list[SensorModel], fitted: BoolArray) -> list[SensorModel]:
    """Models of photos without enough control, fitted to common points as their neighbours place them, round by round.

    A photo that is not reached keeps the values it came with: they are its start.

    Parameters
    ----------
    problem : EdgeProblem
    models : list of SensorModel
        Of the photos.
    fitted : bool array (photos,)
        Photos that are fitted already.
    """
    while not fitted.all() and fitted.any():
        ground = common_ground(problem, models, fitted)
        known = np.isfinite(ground[:, 0])[problem.stations.station]
        models, now = _fitted(problem, models, ground, known, fitted)
        # No photo was reached in this round: none will be in the next.
        if (now == fitted).all():
            break
        fitted = now
    return models


def common_ground(problem: EdgeProblem, models: list[SensorModel], from_photos: BoolArray) -> FloatArray:
    """Stations (S, 3) in the map CRS: as given, or the mean of what chosen photos see; NaN where none does.

    Parameters
    ----------
    problem : EdgeProblem
    models : list of SensorModel
        Of the photos.
    from_photos : bool array (photos,)
        Photos whose view of common points counts.
    """
    s = problem.stations
    places = _ground_of(problem, models)
    places[~from_photos[s.photo]] = np.nan
    ground = s.xyz.copy()
    for station in np.flatnonzero(np.isinf(s.sigma)):
        seen = places[s.station == station, :2]
        seen = seen[np.isfinite(seen).all(axis=1)]
        if len(seen):
            ground[station, :2] = seen.mean(axis=0)
    return ground


def _ground_of(problem: EdgeProblem, models: list[SensorModel]) -> FloatArray:
    """Places (N, 3) on the map of each measurement by its own photo, at the height of its station."""
    s = problem.stations
    places = np.full((len(s.photo), 3), np.nan)
    for index, model in enumerate(models):
        mine = s.photo == index
        if mine.any():
            places[mine] = image_to_height(model, s.colrow[mine], s.xyz[s.station[mine], 2], problem.crs)
    return places


def _fitted(
    problem: EdgeProblem, models: list[SensorModel], ground: FloatArray, known: BoolArray, done: BoolArray
) -> tuple[list[SensorModel], BoolArray]:
    """Models fitted where they are not yet and known measurements (N,) suffice, and which are fitted."""
    s, out, fitted = problem.stations, list(models), done.copy()
    for index in np.flatnonzero(~done):
        parameters, mine = models[index].parameters, known & (s.photo == index)
        if not (parameters.sigmas > 0.0).any():
            fitted[index] = True
            continue
        try:
            points = problem.to_model[index](ground[s.station[mine]])
            out[index] = fit(models[index], points, s.colrow[mine], s.sigma_px[mine]).model
            fitted[index] = True
        except SolveError:
            continue  # too few points of its own: its neighbours may help
    return out, fitted


@dataclass(frozen=True)
class Misfit:
    """Misfit at shared points: where one photo puts what another shows, for each pair of photos.

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
        return np.hypot(self.pixels[:, 0], self.pixels[:, 1])

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


def misfit(problem: EdgeProblem, models: list[SensorModel], placed: BoolArray | None = None) -> Misfit:
    """Misfit of photos at their shared points.

    Parameters
    ----------
    problem : EdgeProblem
    models : list of SensorModel
    placed : bool array (photos,), optional
        Photos that have a place; pairs with others are NaN.
    """
    s = problem.stations
    places = _ground_of(problem, models)
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
