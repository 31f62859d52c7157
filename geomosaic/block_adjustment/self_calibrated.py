"""Self-calibration that goes as far as a block bears: held parameters of its cameras that it determines are set free.

Which they are, the score test of an adjustment says (`orientation.block.self_calibration`). The adjustment with them is
taken where the image positions fit better, with those that turn out significant and can be told apart.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import listed
from geomosaic.orientation.block.self_calibration import offers
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.types import FloatArray, IntArray

# Share of the image positions that may be lost to a better fit.
LOST = 0.02
# Share by which their RMS must fall: for less, parameters fit what no lens does, such as errors of matching.
LEAST_GAIN = 0.02
# Pixels of a sensor are square: what asks for these is a rolling shutter, or film, and not set free unasked.
SQUARE = ("aspect", "shear")
# Correlation up to which a parameter is tried: the score test is linear, at a lens that is wrong. Whether it stands
# alone, the adjustment with it says.
TRIED_CORRELATION = 0.98


@dataclass(frozen=True)
class SetFree:
    """Parameters of cameras that were set free since the block determines them.

    Attributes
    ----------
    names : tuple of str
    rms : tuple of float
        Of the image positions that take part before and after, pixels.
    used : tuple of int
        Image positions that take part before and after.
    """

    names: tuple[str, ...]
    rms: tuple[float, float]
    used: tuple[int, int]

    @property
    def text(self) -> str:
        """In words."""
        before, after = self.rms
        return (
            f"self-calibration: {listed(self.names, 12)} set free, too, as this block determines "
            f"{'it' if len(self.names) == 1 else 'them'}: image positions fit to {after:.3g} px RMS in place of "
            f"{before:.3g}, and {self.used[1]} take part in place of {self.used[0]}"
        )


def determined_parameters(solution: BlockSolution, camera: IntArray, known: Collection[str]) -> tuple[str, ...]:
    """Held parameters of interior orientations that the residuals ask for and the block determines.

    Parameters
    ----------
    solution : BlockSolution
    camera : int array (M,)
        Camera of each image.
    known : collection of str
        Parameters that are free already, or have been tried.
    """
    names = dict.fromkeys(name for offer in offers(solution, camera, SQUARE, TRIED_CORRELATION) for name in offer.names)
    return tuple(name for name in names if name not in known)


def without_evidence(solution: BlockSolution, names: tuple[str, ...]) -> set[str]:
    """Free parameters, among some, that no camera can tell apart from others or finds significant.

    A camera of a single odd picture bears hardly any of them, which says nothing of the others.

    Parameters
    ----------
    solution : BlockSolution
    names : tuple of str
    """
    weak = {name for one, other, _ in solution.correlated() for name in (one, other)}
    weak |= {name for name, _, _ in solution.insignificant()}
    determined = set[str]()
    for camera in solution.adjustment.problem.unknowns.interiors:
        determined |= {_of_any(name) for name, free in zip(camera.names, camera.free, strict=True) if free} - {
            _of_any(name) for name in weak & {*camera.names}
        }
    return {*names} - determined


def _of_any(name: str) -> str:
    """Name of a camera's parameter without the camera's."""
    return name.rsplit(": ", 1)[-1]


def better_with(before: BlockSolution, after: BlockSolution, names: tuple[str, ...]) -> SetFree | None:
    """What parameters gain that were set free; None where the image positions fit hardly better.

    Parameters
    ----------
    before, after : BlockSolution
    names : tuple of str
    """
    one, other = (each.adjustment.state.weights[0] > 0.0 for each in (before, after))
    used = int(one.sum()), int(other.sum())
    both = one & other
    fits = _rms(after.residuals[both]) < (1.0 - LEAST_GAIN) * _rms(before.residuals[both])
    if used[1] < (1.0 - LOST) * used[0] or not fits:
        return None
    return SetFree(names, (_rms(before.residuals[one]), _rms(after.residuals[other])), used)


def _rms(residuals: FloatArray) -> float:
    return float(np.sqrt((residuals**2).sum(axis=1).mean())) if len(residuals) else float("inf")
