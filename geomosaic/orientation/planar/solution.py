"""Solution of a planar block: transformations, residuals, standard deviations, and gaps where photos are joined."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from geomosaic.estimation.network import Network
from geomosaic.estimation.statistics import position_sigmas, variance_factor
from geomosaic.orientation.planar.measurements import PlanarBlock
from geomosaic.orientation.planar.observation_equations import GROUND, PlanarProblem, Views
from geomosaic.orientation.planar.transformations import (
    Frame,
    PlanarTransform,
    by_parameters,
    by_photo,
    photo_coordinates,
)
from geomosaic.types import FloatArray


@dataclass(frozen=True)
class Join:
    """Join of two photos.

    Attributes
    ----------
    first, second : str
    points : int
        Points measured in both.
    along, across : float
        Mean shift of the second photo's content against the first's, in pixels of the second: along the seam, which
        runs halfway between the middles of the two photos, and across it.
    rms, largest : float
        Of the lengths of the gaps, pixels of the second photo.
    """

    first: str
    second: str
    points: int
    along: float
    across: float
    rms: float
    largest: float


def joins(block: PlanarBlock, transforms: Mapping[str, PlanarTransform]) -> list[Join]:
    """Joins of all pairs of placed photos that show common points, in the order of the block.

    Parameters
    ----------
    block : PlanarBlock
    transforms : mapping of str to PlanarTransform
        By photo.
    """
    places = _positions(block, transforms)
    names = [photo.name for photo in block.photos if photo.name in transforms]
    found = [join(a, b, transforms, places) for i, a in enumerate(names) for b in names[i + 1 :]]
    return [one for one in found if one is not None]


def _positions(block: PlanarBlock, transforms: Mapping[str, PlanarTransform]) -> dict[str, dict[str, FloatArray]]:
    """Map position (2,) of each measured point by each placed photo that shows it: photo → point → position."""
    return {name: positions_by(block, transform) for name, transform in transforms.items()}


def positions_by(block: PlanarBlock, transform: PlanarTransform) -> dict[str, FloatArray]:
    """Map position (2,) of each point that one placed photo shows.

    Parameters
    ----------
    block : PlanarBlock
    transform : PlanarTransform
    """
    own = block.by_photo[transform.photo.name]
    if not own:
        return {}
    ground = transform.to_ground(np.array([[measured.col, measured.row] for measured in own.values()]))
    return dict(zip(own, ground, strict=True))


def join(
    first: str,
    second: str,
    transforms: Mapping[str, PlanarTransform],
    places: Mapping[str, Mapping[str, FloatArray]],
) -> Join | None:
    """Join of one pair of photos; None where they share no point.

    Parameters
    ----------
    first : str
    second : str
    transforms : mapping of str to PlanarTransform
        By photo.
    places : mapping
        Map position (2,) of each point by photo, see `_positions`.
    """
    shared = [point for point in places[first] if point in places[second]]
    if not shared:
        return None
    gaps = np.array([places[second][point] - places[first][point] for point in shared])
    transform = transforms[second]
    gaps = gaps / transform.pixel()
    across = transform.centre() - transforms[first].centre()
    across = across / max(float(np.hypot(*across)), 1e-300)
    seam = np.array([-across[1], across[0]])
    length = np.hypot(*gaps.T)
    return Join(
        first,
        second,
        len(shared),
        float((gaps @ seam).mean()),
        float((gaps @ across).mean()),
        float(np.sqrt((length**2).mean())),
        float(length.max()),
    )


@dataclass(frozen=True, eq=False)
class PlanarSolution:
    """Solution of a planar block.

    Attributes
    ----------
    block : PlanarBlock
    kind : str
    frame : Frame
        Normalised ground coordinates of `values` and `cofactors`.
    values : array (K, P)
        Parameters of each photo, normalised photo → normalised ground, see `transformations`.
    cofactors : mapping of (int, int) to array (P, P)
        Of the parameters of two photos that show a common point, by their numbers; zeros where a photo is held fixed.
        Times `sigma0`², or as they are where the standard deviations of the measurements are trusted, they are
        covariances.
    views : Views
        The measurements.
    points : array (M, 2)
        Adjusted map position of each of `views.ids`.
    residuals : array (N, 2)
        Measured minus computed (col, row) of each view in pixels; NaN for ground coordinates.
    standardised : array (N, 2)
        The same over their own standard deviations, a-priori; NaN where no redundancy controls a measurement.
    sigma0 : float
        Standard deviation of unit weight: 1 where the measurements are as good as their sigmas say; NaN without
        redundancy.
    redundancy : int
        Independent equations less unknowns.
    equations : int
        Observation equations (9-3) and (9-4) that were written.
    condition : float
        Condition number of the design with columns of unit length.
    rounds : int
        Solutions of the normal equations it took.
    """

    block: PlanarBlock
    kind: str
    frame: Frame
    values: FloatArray
    cofactors: Mapping[tuple[int, int], FloatArray]
    views: Views
    points: FloatArray
    residuals: FloatArray
    standardised: FloatArray
    sigma0: float
    redundancy: int
    equations: int
    condition: float
    rounds: int

    @cached_property
    def transforms(self) -> dict[str, PlanarTransform]:
        """Transformation of each photo, by name."""
        return {
            photo.name: PlanarTransform(photo, self.kind, self.frame, values)
            for photo, values in zip(self.block.photos, self.values, strict=True)
        }

    def sigmas(self, photo: str) -> FloatArray:
        """A-priori standard deviations (P,) of a photo's `values`."""
        number = self.block.index[photo]
        return np.sqrt(np.diag(self.cofactors[number, number]))

    def covariance(self, photo: str) -> FloatArray:
        """Covariance (P, P) of a photo's `values`, by the standard deviation of unit weight where it is known."""
        number = self.block.index[photo]
        return variance_factor(self.sigma0, self.redundancy) * self.cofactors[number, number]

    def position_sigmas(self, photo: str, colrow: FloatArray) -> FloatArray:
        """A-priori standard deviations (N,) in map units of where image places (N, 2) lie: √((σX² + σY²)/2)."""
        number = self.block.index[photo]
        xy = photo_coordinates(self.block.photos[number].size, colrow)
        by = by_parameters(self.kind, self.values[number], xy) / np.sqrt(2.0)
        return position_sigmas(by, self.cofactors[number, number]) * self.frame.scale

    def expected_errors(self, photo: str) -> tuple[FloatArray, FloatArray]:
        """Map positions (5, 2) of a photo's corners and middle, and expected lengths (5,) of their errors, pixels."""
        transform = self.transforms[photo]
        colrow = transform.corners_and_middle()
        scale = np.sqrt(2.0 * variance_factor(self.sigma0, self.redundancy))
        return transform.to_ground(colrow), scale * self.position_sigmas(photo, colrow) / transform.pixel()

    @property
    def observations(self) -> int:
        """Number of observed coordinates: image coordinates, and those of control that is not held fixed."""
        return 2 * int((~self.views.is_ground | (self.views.sigma > 0.0)).sum())

    @property
    def rms(self) -> float:
        """Root mean square length of the residuals, pixels."""
        lengths = (self.residuals[~self.views.is_ground] ** 2).sum(axis=1)
        return float(np.sqrt(lengths.mean())) if len(lengths) else float("nan")


# A residual whose variance is a smaller part of its measurement's tells nothing of it.
UNCONTROLLED = 1e-6


def cofactor_blocks(problem: PlanarProblem, network: Network) -> dict[tuple[int, int], FloatArray]:
    """Cofactors (P, P) of the parameters of every two photos that show a common point; 0 for those that are held.

    Parameters
    ----------
    problem : PlanarProblem
    network : Network
        Of the adjustment.
    """
    photo = problem.views.photo
    pairs = photo[problem.views.pairs]
    near = {(i, i) for i in range(len(problem.block.photos))}
    for a, b in pairs[(pairs != GROUND).all(axis=1)].tolist():
        near |= {(a, b), (b, a)}
    zero = np.zeros((problem.count, problem.count))
    block = problem.first // problem.count
    free = {(a, b): (int(block[a]), int(block[b])) for a, b in sorted(near) if not problem.held[[a, b]].any()}
    found = network.cofactors_of(free.values())
    return {pair: found[free[pair]] if pair in free else zero for pair in sorted(near)}


def image_residuals(problem: PlanarProblem, values: FloatArray, points: FloatArray) -> FloatArray:
    """Measured minus computed (col, row) (N, 2) in pixels at the adjusted points (M, 2), normalised ground.

    Parameters
    ----------
    problem : PlanarProblem
    values : array (K, P)
        Parameters of each photo, normalised photo to normalised ground.
    points : array (M, 2)
        Adjusted points on the normalised ground.
    """
    views = problem.views
    computed = np.full((len(views.photo), 2), np.nan)
    place = problem.frame.map(points[views.point])
    for i, photo in enumerate(problem.block.photos):
        own = np.flatnonzero(views.photo == i)
        computed[own] = PlanarTransform(photo, problem.kind, problem.frame, values[i]).to_image(place[own])
    left: FloatArray = views.colrow - computed
    return left


def standardised(
    problem: PlanarProblem,
    values: FloatArray,
    at: FloatArray,
    sigma: FloatArray,
    cofactors: Mapping[tuple[int, int], FloatArray],
    residuals: FloatArray,
) -> FloatArray:
    """Residuals (N, 2) over their a-priori standard deviations; NaN where these are next to nothing.

    Parameters
    ----------
    problem : PlanarProblem
    values : array (K, P)
        Parameters of each photo, normalised photo to normalised ground.
    at : array (N, 2)
        Adjusted normalised photo coordinates of the views.
    sigma : array (N,)
        Standard deviations of the views on the normalised ground.
    cofactors : mapping of (int, int) to array (P, P)
        See `cofactor_blocks`.
    residuals : array (N, 2)
        Pixels.
    """
    # On the ground a view of weight w at a point of weights W deviates from the adjusted point by e, whose cofactors
    # are I/w − I/W − A·Q·Aᵀ, A the derivatives of e by all parameters.
    views = problem.views
    out = np.full_like(residuals, np.nan)
    slopes, across = np.zeros((len(views.photo), 2, problem.count)), np.zeros((len(views.photo), 2, 2))
    own = problem.of_views(values)
    slopes[problem.in_photo] = by_parameters(problem.kind, own, at[problem.in_photo])
    # Rows count downwards, y of the photo upwards.
    turn = np.array([1.0, -1.0]) / problem.half[views.photo[problem.in_photo], None]
    across[problem.in_photo] = by_photo(problem.kind, own, at[problem.in_photo]) * turn[:, None, :]
    starts = np.searchsorted(views.point, np.arange(len(views.ids) + 1))
    for first, last in pairwise(starts):
        if last - first < 2:
            continue
        seen = np.arange(first, last)
        share, spread = _shares(sigma[seen])
        photos = views.photo[seen]
        inner = [k for k in range(len(seen)) if photos[k] != GROUND]
        for k in inner:
            by = {m: (float(m == k) - share[m]) * slopes[seen[m]] for m in inner if m == k or share[m] > 0.0}
            known = np.zeros((2, 2))
            for a in by:
                for b in by:
                    known += by[a] @ cofactors[int(photos[a]), int(photos[b])] @ by[b].T
            ground = np.eye(2) * (sigma[seen[k]] ** 2 - spread) - known
            to_pixels = np.linalg.inv(across[seen[k]])
            variance = np.diag(to_pixels @ ground @ to_pixels.T)
            enough = variance > UNCONTROLLED * views.sigma[seen[k]] ** 2
            out[seen[k]] = np.where(enough, residuals[seen[k]] / np.sqrt(np.where(enough, variance, 1.0)), np.nan)
    return out


def _shares(sigma: FloatArray) -> tuple[FloatArray, float]:
    """Share (V,) of each view in the adjusted point, and that point's variance; control of σ = 0 takes all."""
    if (sigma == 0.0).any():
        return (sigma == 0.0).astype(np.float64), 0.0
    weight = 1.0 / sigma**2
    return weight / weight.sum(), float(1.0 / weight.sum())
