"""Report of images found in a reference as an HTML page: control, residuals and rejected places drawn over each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.errors import GeomosaicError
from geomosaic.numbers import round_below
from geomosaic.raster.pictures import jpeg_bytes, preview
from geomosaic.report.figures import data_uri
from geomosaic.report.page import rendered
from geomosaic.types import FloatArray

# Pixels of the longer side of a picture of an image, and its side in units of the figure; quality of its JPEG.
LARGEST, SHOWN, QUALITY = 900, 900.0, 72
# Units of a residual as long as most are, and images that are drawn: the others stand in the table.
LONG, MOST = 40.0, 40


@dataclass(frozen=True, eq=False)
class FoundImage:
    """Image with the places that were found in a reference.

    Attributes
    ----------
    name, path : str
    size : (int, int)
    colrow, residuals : array (N, 2)
        Control points that agree, and measured minus computed, pixels.
    left_out : array (K, 4)
        The same of places that do not agree.
    rms : float
        Of the residuals of one axis, pixels.
    moved : float
        Metres that the image lay off; NaN of one that nothing oriented.
    """

    name: str
    path: str
    size: tuple[int, int]
    colrow: FloatArray
    residuals: FloatArray
    left_out: FloatArray
    rms: float
    moved: float

    @property
    def largest(self) -> float:
        """Longest residual of a control point, pixels."""
        return float(np.linalg.norm(self.residuals, axis=1).max(initial=0.0))


def render_reference(
    found: Sequence[FoundImage], failures: Mapping[str, str], name: str, summary: Sequence[str], notes: Sequence[str]
) -> str:
    """HTML page of the images that were found in a reference.

    Parameters
    ----------
    found : sequence of FoundImage
    failures : mapping of str to str
        Images that were not, each with the reason.
    name : str
        Of the block.
    summary, notes : sequence of str
        The result in words, and what the user was warned of.

    Returns
    -------
    str
        Text from files is escaped, nothing is loaded from elsewhere, and no script runs.
    """
    # The worst first: they are what a reader looks for.
    order = sorted(found, key=lambda each: -each.rms)
    return rendered(
        "reference_matches", name=name, summary=summary, notes=notes, failures=failures, images=order,
        figures=[_figure(each) for each in order[:MOST]],
    )  # fmt: skip


def _figure(found: FoundImage) -> dict[str, Any]:
    """Picture of an image, residuals of its control enlarged over it, and crosses where places do not agree."""
    scale = SHOWN / max(found.size)
    width, height = (side * scale for side in found.size)
    lengths = np.linalg.norm(found.residuals, axis=1)
    usual = float(np.percentile(lengths, 90)) if len(lengths) else 0.0
    factor = round_below(LONG / max(usual, 1e-6) / scale)
    ends = np.hstack([found.colrow * scale, (found.colrow + factor * found.residuals) * scale])
    return {
        "name": found.name,
        "width": width,
        "height": height,
        "picture": _picture(found.path),
        "factor": factor,
        "lines": "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for a, b, c, d in ends.tolist()),
        "points": (found.colrow * scale).tolist(),
        "crosses": (found.left_out[:, :2] * scale).tolist(),
    }


def _picture(path: str) -> str:
    """Small JPEG as a data URI; empty of an image that cannot be read."""
    try:
        return data_uri(jpeg_bytes(*preview(path, LARGEST), QUALITY), "image/jpeg")
    except (GeomosaicError, OSError):
        return ""
