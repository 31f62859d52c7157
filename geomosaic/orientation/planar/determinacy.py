"""Determinacy of a planar block: whether its measurements determine its photos."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from geomosaic.errors import SolveError, counted, listed, warn
from geomosaic.orientation.planar.measurements import PlanarBlock
from geomosaic.orientation.planar.transformations import LEAST, PlanarTransform, photo_coordinates
from geomosaic.types import FloatArray

if TYPE_CHECKING:
    from geomosaic.orientation.planar.solution import PlanarSolution


# Largest |a3·x + b3·y| inside a photo that a near-vertical one can have: a tilt of 30° at a half angle of 40°.
STEEPEST = 0.5
# Condition number below which it is not the geometry that an adjustment fails of.
WELL = 1e3
# Standard deviation of unit weight from which a warning names relief, blunders or too small sigmas.
BAD_FIT = 3.0


def check_determined(block: PlanarBlock, kind: str, fixed: Mapping[str, PlanarTransform], where: str | None) -> None:
    """Check by counting: photos with too few points and pieces with too little control are refused.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.
    fixed : mapping of str to PlanarTransform
        Photos that are held, by name.
    where : str, optional
        Named in errors.

    Raises
    ------
    SolveError
    """
    if kind not in LEAST:
        raise SolveError(f"no transformation named '{kind}'", where=where, hint=f"choose one of {', '.join(LEAST)}")
    # Counting comes first: it names the photo and the number that lacks, which a singular matrix cannot.
    photos: dict[str, set[str]] = {photo.name: set() for photo in block.photos}
    points: dict[str, set[str]] = {}
    for measured in block.measurements:
        points.setdefault(measured.id, set()).add(measured.photo)
    known = {point.id for point in block.control}
    for name, seen in points.items():
        for photo in seen:
            if len(seen) > 1 or name in known:
                photos[photo].add(name)
    for photo, own in photos.items():
        if len(own) < LEAST[kind] and photo not in fixed:
            raise SolveError(
                f"photo '{photo}' shares {counted(len(own), 'point')} with other photos or the ground; "
                f"{_article(kind)} transformation needs {LEAST[kind]}",
                where=where,
                hint="measure more tie or control points in it, choose a simpler model, or leave the photo out",
            )
    for piece in pieces(block):
        # A held photo takes the part of control.
        if piece & set(fixed):
            continue
        own = {point.id for point in block.control if point.photo in piece}
        if len(own) < LEAST[kind]:
            rest = f": {listed(sorted(piece), 4)}" if len(piece) < len(block.photos) else ""
            raise SolveError(
                f"{counted(len(own), 'control point')} for {counted(len(piece), 'connected photo')}{rest}; "
                f"{_article(kind)} transformation needs {LEAST[kind]}",
                where=where,
                hint="add control points, tie these photos to the others, or make an uncontrolled mosaic",
            )


def pieces(block: PlanarBlock) -> list[set[str]]:
    """Connected pieces of a planar block: photos that hang together by common points.

    Parameters
    ----------
    block : PlanarBlock

    Returns
    -------
    list of set of str
        Names of photos of each piece, in the order of the block's photos; one piece where all hang together.
    """
    points: dict[str, list[str]] = {}
    for measured in block.measurements:
        points.setdefault(measured.id, []).append(measured.photo)
    root = {photo.name: photo.name for photo in block.photos}

    def top(name: str) -> str:
        while root[name] != name:
            # Union-find with path halving.
            root[name] = root[root[name]]
            name = root[name]
        return name

    for seen in points.values():
        for other in seen[1:]:
            root[top(other)] = top(seen[0])
    found: dict[str, set[str]] = {}
    for one in block.photos:
        found.setdefault(top(one.name), set()).add(one.name)
    return list(found.values())


def elongation(size: tuple[int, int], colrow: FloatArray) -> float:
    """Condition number of the places (N, 2) of points in a photo: their longest extent over the one across it.

    Ratio of the singular values of the centred coordinates: 1 for points spread evenly, infinite on a line.

    Parameters
    ----------
    size : tuple of int
        Width and height of the photo, pixels.
    colrow : array (N, 2)
        Pixels, corner-based.
    """
    xy = photo_coordinates(size, colrow)
    singular = np.linalg.svd(xy - xy.mean(axis=0), compute_uv=False)
    return float(singular[0] / singular[1]) if len(singular) > 1 and singular[1] > 1e-15 * singular[0] else np.inf


def ill_conditioned(block: PlanarBlock, kind: str, condition: float, photo: str, where: str | None) -> SolveError:
    """Error of an adjustment whose equations do not determine its unknowns.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.
    condition : float
        Condition number of the design.
    photo : str
        Name of the photo that is determined worst.
    where : str, optional
        Named in errors.
    """
    number = "infinite" if not np.isfinite(condition) else f"{condition:.1e}"
    several = len(block.photos) > 1
    hints = {
        "conformal": "look for points of one name that are not the same place, for photos that hang on one place, and "
        "whether col and row are meant alike in all tables (rows count downwards from the top)",
        "affine": "the tie or control points lie nearly on a line somewhere: spread them, or choose conformal",
        "projective": "relief at the tie points does this: rectify each photo singly (controlled, 4 or more control "
        "points in each), or choose affine",
    }
    hint = hints[kind]
    if kind == "projective" and not several:
        hint = "spread the points over the photo, no three of four on one line; where the relief is strong take affine"
    what = (
        "is ill-conditioned"
        if kind == "projective" or not condition < WELL
        else "does not converge: the points contradict each other"
    )
    return SolveError(
        f"the {kind} adjustment {what}: condition number {number}, worst in photo '{photo}'",
        where=where,
        hint=hint,
    )


def check_plausible(solution: PlanarSolution, start: PlanarSolution | None, where: str | None) -> None:
    """Check of a projective solution for the effect of relief, and of residuals against their sigmas.

    Parameters
    ----------
    solution : PlanarSolution
    start : PlanarSolution, optional
        Affine solution that a projective one started from.
    where : str, optional
        Named in errors.

    Raises
    ------
    SolveError
    """
    # Points above and below a plane make residuals, and the perspective terms follow them. In a block they are held by
    # little, so errors grow from the points to the corners of the photos. Where they come to more than those of the
    # affine adjustment that it started from, or to perspective terms that no near-vertical photo has, it is refused.
    if solution.kind == "projective":
        for photo, values in zip(solution.block.photos, solution.values, strict=True):
            worst = float(np.abs(values[6:]) @ (np.array(photo.size) / max(photo.size)))
            if worst > STEEPEST:
                error = ill_conditioned(solution.block, "projective", solution.condition, photo.name, where)
                error.what += f", whose scale would change by {worst:.0%} from its middle to a corner"
                raise error
    if not solution.sigma0 > BAD_FIT:
        return
    if start is not None and len(solution.block.photos) > 1:
        (mine, worst_photo), (simpler, _) = _expected_error(solution), _expected_error(start)
        if not mine < simpler:
            error = ill_conditioned(solution.block, "projective", solution.condition, worst_photo, where)
            error.what += (
                f"; with residuals of {solution.rms:.1f} px RMS, {solution.sigma0:.1f} times what the sigmas say, it "
                f"puts the corners of the photos wrong by {mine:.3g} map units RMS, the affine one by {simpler:.3g}"
            )
            raise error
    mirrored = ", a mirrored image (affine takes it)" if solution.kind == "conformal" else ""
    place = f"{where}: " if where else ""
    warn(
        f"{place}residuals are {solution.sigma0:.1f} times as large as the standard deviations say "
        f"({solution.rms:.2f} px RMS): relief or tilt, a wrong measurement{mirrored}, or too small sigmas"
    )


def _expected_error(solution: PlanarSolution) -> tuple[float, str]:
    """Expected position error of an adjusted planar block at the corners of its photos."""
    each = {
        name: solution.position_sigmas(name, transform.corners()) for name, transform in solution.transforms.items()
    }
    worst = max(each, key=lambda name: float(each[name].max()))
    return solution.sigma0 * float(np.sqrt(np.mean(np.square(list(each.values()))))), worst


def _article(kind: str) -> str:
    return f"an {kind}" if kind == "affine" else f"a {kind}"
