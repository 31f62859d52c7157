"""Accumulated errors of an uncontrolled mosaic's joins, against the simultaneous adjustment."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import GeomosaicWarning, SolveError
from geomosaic.orientation.planar.joins import joins
from geomosaic.orientation.planar.measurements import PlanarBlock, Tie
from geomosaic.orientation.planar.simultaneous import adjust
from geomosaic.orientation.planar.solution import PlanarSolution
from geomosaic.orientation.planar.transformations import PlanarTransform
from geomosaic.orientation.planar.uncontrolled import Chain
from geomosaic.types import FloatArray


@dataclass(frozen=True)
class Accumulated:
    """Accumulated error of an uncontrolled mosaic.

    Attributes
    ----------
    against : str
        'control', or 'ties' where the simultaneous adjustment holds the start photo instead of control points.
    model : str
        Kind of the simultaneous adjustment.
    by_photo : dict of str to float
        RMS difference of a photo's corners and middle, in its own pixels, after a conformal transformation that lays
        the start photo of the one onto that of the other.
    by_step : dict of int to float
        RMS of those of the photos so many joins away from the start.
    best : float
        RMS over all photos after the conformal transformation that fits all of them best.
    gaps, gaps_adjusted : float
        RMS gap at points that photos share, pixels: uncontrolled, and adjusted.
    """

    against: str
    model: str
    by_photo: dict[str, float]
    by_step: dict[int, float]
    best: float
    gaps: float
    gaps_adjusted: float

    @property
    def largest(self) -> float:
        """Largest of `by_photo`."""
        return max(self.by_photo.values())


def reference(block: PlanarBlock, made: Chain, kind: str) -> tuple[PlanarSolution, str]:
    """Simultaneous adjustment to compare with: on control where it suffices, else about the start photo.

    A kind that the whole block does not hold gives way to the conformal one.

    Parameters
    ----------
    block : PlanarBlock
    made : Chain
    kind : str
        'conformal', 'affine' or 'projective'.

    Returns
    -------
    solution : PlanarSolution
    against : str
        'control' or 'ties'.
    """
    free = PlanarBlock(block.photos, as_ties(block))
    held = {made.start: made.transforms[made.start]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomosaicWarning)  # what it compares is reported as numbers
        for model in dict.fromkeys((kind, "conformal")):
            for against, measured, fixed in (("control", block, None), ("ties", free, held)):
                with suppress(SolveError):
                    return adjust(measured, model, fixed), against
    raise SolveError("the photos cannot be adjusted together", hint="look for tie points of one name at two places")


def compare(
    block: PlanarBlock, made: Chain, adjusted: Mapping[str, PlanarTransform], against: str, model: str
) -> Accumulated:
    """Comparison of a chain with the simultaneous solution of the same photos.

    Parameters
    ----------
    block : PlanarBlock
    made : Chain
    adjusted : mapping of str to PlanarTransform
        Simultaneous solution, by photo.
    against : str
        'control' or 'ties': what holds the simultaneous solution.
    model : str
        'conformal', 'affine' or 'projective'.
    """
    at = {photo.name: _places(photo.size) for photo in block.photos}
    ours = {name: made.transforms[name].to_ground(at[name]) for name in at}
    theirs = {name: adjusted[name].to_ground(at[name]) for name in at}
    start = _conformal(ours[made.start], theirs[made.start])
    every = _conformal(np.vstack(list(ours.values())), np.vstack(list(theirs.values())))

    def difference(name: str, onto: FloatArray) -> FloatArray:
        placed = _apply(onto, ours[name])
        gap: FloatArray = adjusted[name].to_image(placed) - at[name]
        return np.asarray(np.hypot(*gap.T))

    by_photo = {name: _rms(difference(name, start)) for name in made.transforms}
    steps = sorted(set(made.steps.values()))
    by_step = {n: _rms(np.array([by_photo[name] for name in by_photo if made.steps[name] == n])) for n in steps}
    best = _rms(np.concatenate([difference(name, every) for name in at]))
    return Accumulated(against, model, by_photo, by_step, best, _gaps(block, made.transforms), _gaps(block, adjusted))


def as_ties(block: PlanarBlock) -> tuple[Tie, ...]:
    """Measurements of a planar block as tie points: control enters as points without ground coordinates.

    Parameters
    ----------
    block : PlanarBlock

    Returns
    -------
    tuple of Tie
        The block's ties, then one tie for each measurement of a control point.
    """
    return (*block.ties, *(Tie(p.id, p.photo, p.col, p.row, p.sigma) for p in block.control))


def _gaps(block: PlanarBlock, transforms: Mapping[str, PlanarTransform]) -> float:
    found = joins(block, transforms)
    squares = sum(one.points * one.rms**2 for one in found)
    return float(np.sqrt(squares / max(1, sum(one.points for one in found))))


def _places(size: tuple[int, int]) -> FloatArray:
    width, height = size
    return np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height], [width / 2.0, height / 2.0]])


def _conformal(source: FloatArray, target: FloatArray) -> FloatArray:
    """Conformal transformation (2,) of complex numbers of least squares, target ≈ p[0]·source + p[1]."""
    a, b = _complex(source), _complex(target)
    turn = np.vdot(a - a.mean(), b - b.mean()) / np.vdot(a - a.mean(), a - a.mean())
    return np.array([turn, b.mean() - turn * a.mean()])


def _apply(transform: FloatArray, xy: FloatArray) -> FloatArray:
    z = transform[0] * _complex(xy) + transform[1]
    return np.column_stack([z.real, z.imag])


def _complex(xy: FloatArray) -> FloatArray:
    z: FloatArray = xy[:, 0] + 1j * xy[:, 1]
    return z


def _rms(lengths: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(lengths))))
