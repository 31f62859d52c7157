"""Controlled mosaics of photos rectified singly: each by its own control points; Wolf & Dewitt, section 9-9."""

from __future__ import annotations

from geomosaic.adjust.planar.attach import LONGEST_OF_CONTROL, fit_single
from geomosaic.adjust.planar.kinds import LEAST
from geomosaic.adjust.planar.solution import PlanarSolution
from geomosaic.adjust.planar.values import PlanarBlock
from geomosaic.errors import SolveError


def rectify_singly(block: PlanarBlock, kind: str = "projective") -> dict[str, PlanarSolution]:
    """Fit each photo to the control points in it; tie points take no part.

    Returns
    -------
    dict of str to PlanarSolution
        By photo.

    Raises
    ------
    SolveError
        Photos with too few control points, all named, or with points nearly on a line.
    """
    if kind not in LEAST:
        raise SolveError(f"no transformation named '{kind}'", mend=f"choose one of {', '.join(LEAST)}")
    own = {photo.name: [point for point in block.control if point.photo == photo.name] for photo in block.photos}
    short = [f"'{name}' has {len(points)}" for name, points in own.items() if len(points) < LEAST[kind]]
    if short:
        raise SolveError(
            f"to be rectified singly each photo needs {LEAST[kind]} control points ({kind}); {', '.join(short[:6])}"
            + (f" and {len(short) - 6} more" if len(short) > 6 else ""),
            mend="add control points, or adjust all photos together with tie points",
        )
    return {photo.name: fit_single(photo, own[photo.name], kind, LONGEST_OF_CONTROL) for photo in block.photos}
