"""Errors to be expected of a product, by the covariance of its solution, and what they and residuals say in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np

from geomosaic.types import FloatArray

# Share of the errors that residuals show, √(redundancy / observations), up to which they are no measure of accuracy.
LITTLE = 0.5


@dataclass(frozen=True)
class ExpectedErrors:
    """Expected errors of a product by the covariance of its solution: lengths of one standard deviation, image pixels.

    Attributes
    ----------
    corners : tuple of float
        At the north-west, north-east, south-east and south-west corner.
    middle : float
    largest : float
        Of these, of the other outermost corners of images (their convex hull), and of the middles of all images, which
        show their own.
    image : str
        Image of the largest one.
    fits : tuple of (int, int)
        Redundancy and number of observations of each independent solution.
    left_out : bool
        The errors of measurement are the leave-one-out errors of a model that passes through its points.
    """

    corners: tuple[float, ...]
    middle: float
    largest: float
    image: str
    fits: tuple[tuple[int, int], ...]
    left_out: bool = False

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        places: FloatArray,
        sigmas: FloatArray,
        fits: Sequence[tuple[int, int]],
        *,
        left_out: bool = False,
    ) -> ExpectedErrors:
        """Expected errors where images reach out farthest towards each corner, and in the middle.

        Parameters
        ----------
        names : sequence of str
            K images.
        places : array (K, 5, 2)
            Map positions of the corners of each image and of its middle, x east and y north.
        sigmas : array (K, 5)
            Expected errors there, pixels.
        fits, left_out
            See the attributes.
        """
        at = places.reshape(-1, 2)
        low, high = np.nanmin(at, axis=0), np.nanmax(at, axis=0)
        # A corner of the map's rectangle may show no image: the outermost place in its direction stands for it.
        share = (places - 0.5 * (low + high)) / np.maximum(high - low, 1e-300)
        outermost = [int(np.nanargmax((share @ way).ravel())) for way in ((-1, 1), (1, 1), (1, -1), (-1, -1))]
        central = int(np.nanargmin(np.hypot(*share[:, 4].T)))
        shown = np.unique([*outermost, *range(4, len(at), 5), *convex_hull(at)])
        known = np.nan_to_num(sigmas.ravel(), nan=np.inf)
        worst = int(shown[np.argmax(known[shown])])
        corners = tuple(sigmas.ravel()[outermost].tolist())
        return cls(corners, float(sigmas[central, 4]), float(known[worst]), names[worst // 5], tuple(fits), left_out)

    @property
    def facts(self) -> dict[str, Any]:
        """JSON values, None where nothing determines a place."""
        known = [value if np.isfinite(value) else None for value in (*self.corners, self.middle, self.largest)]
        exact = sum(fit[0] <= 0 for fit in self.fits)
        basis = "residuals" if not exact else "a-priori" if exact == len(self.fits) else "residuals, a-priori"
        return {
            "corner_sigmas_px": known[:4],
            "middle_sigma_px": known[4],
            "largest_sigma_px": known[5],
            "largest_in": self.image,
            "redundancy": sum(fit[0] for fit in self.fits),
            "observations": sum(fit[1] for fit in self.fits),
            "solutions": len(self.fits),
            "without_redundancy": exact,
            "basis": "leave-one-out" if self.left_out else basis,
        }


def convex_hull(points: FloatArray) -> list[int]:
    """Points at the corners of their convex hull, by number and in order (Andrew's monotone chain).

    Parameters
    ----------
    points : array (N, 2)
        Those that are not finite are left out.

    Returns
    -------
    list of int
        Counter-clockwise from the one farthest to the left; the two ends of points on a line.
    """
    # SciPy has a hull, and takes a quarter of a second to load.
    known = np.flatnonzero(np.isfinite(points).all(axis=1))
    if not len(known):
        return []
    centred = points[known] - points[known].mean(axis=0)
    order = np.lexsort(centred.T[::-1]).tolist()
    x, y = centred.T.tolist()
    least = 1e-12 * float(np.abs(centred).max()) ** 2  # of an area that is more than rounding
    ring: list[int] = []
    for half in (order, order[::-1]):
        chain: list[int] = []
        for c in half:
            while len(chain) > 1:
                a, b = chain[-2:]
                if (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a]) > least:
                    break
                chain.pop()
            chain.append(c)
        ring += chain[:-1]
    return list(map(int, known[ring or order]))


def shown_by_residuals(accuracy: Mapping[str, Any]) -> float:
    """Share of the errors of measurement that residuals show, √(redundancy / observations), 0 to 1.

    Parameters
    ----------
    accuracy : mapping
        `ExpectedErrors.facts`.
    """
    return sqrt(max(accuracy["redundancy"], 0) / max(accuracy["observations"], 1))


FITS_EXACTLY = "fits exactly: 0 redundant observations say nothing about accuracy"


def share_text(accuracy: Mapping[str, Any]) -> str:
    """Clause on how little of the errors residuals show; empty where it is enough.

    Parameters
    ----------
    accuracy : mapping
        `ExpectedErrors.facts`.
    """
    share = shown_by_residuals(accuracy)
    if share > LITTLE:
        return ""
    part = f"{accuracy['redundancy']} of {accuracy['observations']} observations are redundant"
    return f", which show about {share:.0%} of the errors ({part})"


def residual_text(rms: float | None, accuracy: Mapping[str, Any]) -> str:
    """Residuals in words, called what they are where little or nothing is redundant.

    Parameters
    ----------
    rms : float or None
        RMS length of the residuals, pixels.
    accuracy : mapping
        `ExpectedErrors.facts`.
    """
    exact, count = accuracy["without_redundancy"], accuracy["solutions"]
    if exact and exact == count:
        return FITS_EXACTLY
    said = ("residuals not known" if rms is None else f"residuals {rms:.2f} px RMS") + share_text(accuracy)
    if exact:
        said += f"; {exact} of {count} images fit exactly: 0 redundant observations say nothing about their accuracy"
    return said


# What expected errors rest on in place of residuals, by `basis` of `ExpectedErrors.facts`.
_BASIS = {
    "residuals": "",
    "a-priori": "; nothing is redundant: measured coordinates without sigma are taken to be off by 1 px",
    "residuals, a-priori": "; where nothing is redundant, coordinates without sigma are taken to be off by 1 px",
    "leave-one-out": "; measured coordinates are taken to be off as leave-one-out errors are",
}


def expected_text(accuracy: Mapping[str, Any], product: str = "mosaic") -> str:
    """Expected errors in words.

    Parameters
    ----------
    accuracy : mapping
        `ExpectedErrors.facts`.
    product : str
        What has the corners.
    """

    def number(value: float | None) -> str:
        return "?" if value is None else f"{value:.2g}" if value < 10.0 else f"{value:.0f}"

    corners = ", ".join(map(number, accuracy["corner_sigmas_px"]))
    line = (
        f"expected errors (one standard deviation) from the covariance: {corners} px at the corners of the {product} "
        f"(NW, NE, SE, SW), {number(accuracy['middle_sigma_px'])} px in its middle"
    )
    largest, named = accuracy["largest_sigma_px"], [*accuracy["corner_sigmas_px"], accuracy["middle_sigma_px"]]
    more = "" if largest in named else f"; up to {number(largest)} px in {accuracy['largest_in']}"
    return line + more + _BASIS[accuracy["basis"]]
