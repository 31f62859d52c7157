"""Accumulated errors of an uncontrolled mosaic's joins, against the simultaneous adjustment."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import GeomosaicWarning, SolveError, counted, listed
from geomosaic.orientation.planar.determinacy import elongation, pieces
from geomosaic.orientation.planar.measurements import PlanarBlock, Tie
from geomosaic.orientation.planar.sequential import LONGEST_OF_CONTROL, Attachment, fit_best, fit_single, known_points
from geomosaic.orientation.planar.simultaneous import adjust
from geomosaic.orientation.planar.solution import PlanarSolution, joins, positions_by
from geomosaic.orientation.planar.transformations import LEAST, Frame, PlanarTransform, half
from geomosaic.types import FloatArray


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
        raise SolveError(
            f"a scale of {scale} map units per pixel is not positive", hint="give the pixel size on the map, above 0"
        )
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
    near = _neighbours(block)
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


def _neighbours(block: PlanarBlock) -> dict[str, list[str]]:
    """Neighbours of each photo: those that share two points or more with it."""
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
            f"to be rectified singly each photo needs {LEAST[kind]} control points ({kind}); {listed(short)}",
            hint="add control points, or adjust all photos together with tie points",
        )
    return {photo.name: fit_single(photo, own[photo.name], kind, LONGEST_OF_CONTROL) for photo in block.photos}


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
    at = {photo.name: adjusted[photo.name].corners_and_middle() for photo in block.photos}
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


def _conformal(source: FloatArray, target: FloatArray) -> FloatArray:
    """Conformal transformation (2,) of complex numbers of least squares, target ≈ p[0]·source + p[1]."""
    a, b = _complex(source), _complex(target)
    turn = np.vdot(a - a.mean(), b - b.mean()) / np.vdot(a - a.mean(), a - a.mean())
    return np.array([turn, b.mean() - turn * a.mean()])


def _apply(transform: FloatArray, xy: FloatArray) -> FloatArray:
    z = transform[0] * _complex(xy) + transform[1]
    return np.column_stack([z.real, z.imag])


def _complex(xy: FloatArray) -> FloatArray:
    return xy[:, 0] + 1j * xy[:, 1]


def _rms(lengths: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(lengths))))
