"""Uncontrolled planar mosaics joined by tie points, and controlled photos rectified singly (Wolf & Dewitt, 9-9).

Wolf & Dewitt, section 9-7. Errors of the joins add up on the way; starting in the middle keeps the ways short.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.errors import SolveError, counted
from geomosaic.orientation.planar.determinacy import elongation, pieces
from geomosaic.orientation.planar.joins import positions_by
from geomosaic.orientation.planar.measurements import PlanarBlock
from geomosaic.orientation.planar.sequential import LONGEST_OF_CONTROL, Attachment, fit_best, fit_single, known_points
from geomosaic.orientation.planar.solution import PlanarSolution
from geomosaic.orientation.planar.transformations import LEAST, Frame, PlanarTransform, half


@dataclass(frozen=True, eq=False)
class Chain:
    """Uncontrolled mosaic: photos joined one after the other.

    Attributes
    ----------
    start : str
        The photo in the middle, which gives scale and azimuth.
    transforms : dict of str to PlanarTransform
        In the order they were joined.
    attachments : tuple of Attachment
    steps : dict of str to int
        Joins between each photo and the start.
    """

    start: str
    transforms: dict[str, PlanarTransform]
    attachments: tuple[Attachment, ...]
    steps: dict[str, int]


def chain(
    block: PlanarBlock, kind: str = "conformal", *, scale: float = 1.0, azimuth: float = 0.0, start: str | None = None
) -> Chain:
    """Uncontrolled mosaic of a block, joined by tie points from its middle outwards.

    Parameters
    ----------
    block : PlanarBlock
        Its control points take part as tie points only.
    kind : str
        'conformal', 'affine' or 'projective'; where the ties of a photo lie nearly in a line, it is joined by a
        conformal transformation all the same, and its attachment says so.
    scale : float
        Map units per pixel in the start photo.
    azimuth : float
        Direction of the top of the start photo in degrees, clockwise from the map's north.
    start : str, optional
        Photo to begin with; unless given, the one from which the farthest photo is the fewest joins away.

    Returns
    -------
    Chain
        The middle of the start photo is at (0, 0).

    Raises
    ------
    SolveError
        The photos do not hang together by at least two common points each.
    """
    if not scale > 0.0:
        raise SolveError(f"a scale of {scale} map units per pixel is not positive")
    if kind not in LEAST:
        raise SolveError(f"no transformation named '{kind}'", hint=f"choose one of {', '.join(LEAST)}")
    apart = pieces(block)
    if len(apart) > 1:
        raise SolveError(
            f"the photos are in {len(apart)} pieces that share no point; one is {', '.join(sorted(apart[1])[:4])}",
            hint="measure tie points between them, or make a mosaic of each",
        )
    first = middle(block) if start is None else block.photo(start).name
    photo = block.photo(first)
    turn = np.radians(azimuth)
    step = scale * half(photo.size)
    values = np.array([step * np.cos(turn), -step * np.sin(turn), 0.0, 0.0])
    made = {first: PlanarTransform(photo, "conformal", Frame(), values)}
    records = [Attachment(first, (), "conformal", 0, 0, float("nan"), "", float("nan"))]
    steps = {first: 0}
    waiting = [other.name for other in block.photos if other.name != first]
    places = {first: positions_by(block, made[first])}
    known = {name: known_points(block, name, places, made) for name in waiting}
    while waiting:
        # Outwards ring by ring; in a ring, what hangs best comes first.
        ready = [name for name in waiting if len(known[name][0]) >= 2]
        if not ready:
            most = max(waiting, key=lambda name: len(known[name][0]))
            raise SolveError(
                f"photo '{most}' shares {counted(len(known[most][0]), 'point')} with the photos that are joined; "
                "it takes 2",
                hint="measure more tie points between them, or leave it out",
            )
        ring = {name: 1 + min(steps[before] for before in known[name][1]) for name in ready}
        name = min(ready, key=lambda one: (ring[one], -len(known[one][0]), waiting.index(one)))
        points, to = known[name]
        solution, refused = fit_best(block.photo(name), points, kind)
        made[name], steps[name] = solution.transforms[name], ring[name]
        ratio = elongation(block.photo(name).size, np.array([[point.col, point.row] for point in points]))
        records.append(Attachment(name, to, solution.kind, len(points), 0, ratio, refused, solution.rms))
        waiting.remove(name)
        places[name] = positions_by(block, made[name])
        near = {other for point in places[name] for other in block.sharing[point]}
        known.update({other: known_points(block, other, places, made) for other in waiting if other in near})
    return Chain(first, made, tuple(records), steps)


def middle(block: PlanarBlock) -> str:
    """Central photo of a planar block, from which an uncontrolled mosaic is joined outwards.

    Parameters
    ----------
    block : PlanarBlock

    Returns
    -------
    str
        Name of the photo. Of a block in several pieces, it lies in the largest.
    """
    # Errors accumulate with each join, so the start is the photo from which the farthest photo is the fewest joins
    # away; of several, the one with the smallest sum of joins to all others.
    near = neighbours(block)
    best: tuple[int, int, int, int] | None = None
    found = block.photos[0].name
    for number, photo in enumerate(block.photos):
        away = {photo.name: 0}
        ring = [photo.name]
        while ring:
            ring = list(dict.fromkeys(b for a in ring for b in near[a] if b not in away))
            away.update(dict.fromkeys(ring, max(away.values()) + 1))
        # Fewest photos out of reach, then joins to the farthest, then joins to all; the block's order breaks ties.
        mark = (len(near) - len(away), max(away.values()), sum(away.values()), number)
        if best is None or mark < best:
            best, found = mark, photo.name
    return found


def neighbours(block: PlanarBlock) -> dict[str, list[str]]:
    """Neighbours of each photo: those that share two points or more with it.

    Parameters
    ----------
    block : PlanarBlock

    Returns
    -------
    dict of str to list of str
        Names in the order of the block's photos.
    """
    # Two points are what a conformal transformation, the least of the models, needs.
    points: dict[str, list[str]] = {}
    for measured in block.measurements:
        points.setdefault(measured.id, []).append(measured.photo)
    shared: dict[tuple[str, str], int] = {}
    for seen in points.values():
        for a in seen:
            for b in seen:
                shared[a, b] = shared.get((a, b), 0) + 1
    names = [photo.name for photo in block.photos]
    return {a: [b for b in names if a != b and shared.get((a, b), 0) >= 2] for a in names}


def rectify_singly(block: PlanarBlock, kind: str = "projective") -> dict[str, PlanarSolution]:
    """Single rectification: each photo fitted to the control points in it; tie points take no part.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.

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
        raise SolveError(f"no transformation named '{kind}'", hint=f"choose one of {', '.join(LEAST)}")
    own = {photo.name: [point for point in block.control if point.photo == photo.name] for photo in block.photos}
    short = [f"'{name}' has {len(points)}" for name, points in own.items() if len(points) < LEAST[kind]]
    if short:
        raise SolveError(
            f"to be rectified singly each photo needs {LEAST[kind]} control points ({kind}); {', '.join(short[:6])}"
            + (f" and {len(short) - 6} more" if len(short) > 6 else ""),
            hint="add control points, or adjust all photos together with tie points",
        )
    return {photo.name: fit_single(photo, own[photo.name], kind, LONGEST_OF_CONTROL) for photo in block.photos}
