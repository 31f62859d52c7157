"""Plausibility tests of exterior orientations, made before any long work.

Three kinds of evidence, each used only where it is conclusive:
- the horizon: photos of the ground do not look at the sky (`geomosaic.sensor.plausibility.SkyError`);
- control points: their measured image positions against those that the orientation gives;
- correlation: neighbouring photos, reduced, against each other over the ground.
A hypothesis is proposed where the evidence is against the declared orientation and clearly for the hypothesis. Poor
orientations pass: no other reading makes them good.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint, OrientedImage
from geomosaic.errors import GeomosaicError, InputError, warn
from geomosaic.execution.units import map_in_order
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.images import Photo
from geomosaic.inputs.orientation_hypotheses import Hypothesis, hypotheses
from geomosaic.inputs.vertical_datums import positions_crs
from geomosaic.raster.image_metadata import maker_number, read_photo_tags
from geomosaic.raster.pictures import preview
from geomosaic.sensor.solve.inverse import image_to_ground
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray

# Oriented images of some photos, with the CRS of their positions.
Build = Callable[[Block, Sequence[Photo], CRS], Sequence[OrientedImage]]

# Median distance of control points in pixels up to which an orientation is plausible.
FAR = 5.0
# Factor by which a hypothesis must reduce that distance.
BETTER = 4.0
# Correlations: neighbours that show the same ground, that are beyond doubt, and the least gain of another reading.
# Measured (docs/orientations.md): orientations read rightly 0.78 to 0.87, most of those read wrongly 0.05 to 0.39; a
# small error, as true north for grid north, leaves 0.75, and passes.
_SAME_GROUND, _CERTAIN, _GAIN = 0.35, 0.45, 0.3
_PAIRS = 3
# Correlation of a single pair that makes others needless.
_CERTAIN_ALONE = 0.65
# Share of the image diagonal within which a hypothesis must bring the points: farther off, it explains nothing.
PLAUSIBLE = 0.1
# Reduced images: longer side in pixels; then, in their pixels, the spacing of compared places, the largest shift
# that is searched, and the half width of the window of local means. A pair needs so many places that both show.
_SIDE, _EVERY, _REACH, _AROUND, _FEWEST = 240, 5, 2, 4, 120
_MEASUREMENTS = 4
# Share of the height above take-off by which the ground may differ without a doubt: it may lie higher or lower than the
# place of take-off, but seldom by as much as half of a flying height.
_UNLIKELY_RELIEF = 0.5
_ASKED = 12  # photos whose tags are read
_TRUST = "if the orientation is right as it is, say so: `trusted`"


def check_orientation(
    inputs: Block,
    photos: Sequence[Photo],
    crs: CRS | None,
    block: tuple[Sequence[OrientedImage], Surface | None, Sequence[ControlPoint]],
    build: Build,
) -> None:
    """Check of orientations: an error where they are implausible and another reading of the same table is not.

    Parameters
    ----------
    inputs : Block
    photos : sequence of Photo
        All of the block.
    crs : CRS or None
        CRS of the positions.
    block : tuple
        Oriented images in the order of the photos, surface, control points.
    build : callable
        Oriented images of another reading.

    Raises
    ------
    InputError
        Names the evidence against the orientation, and a hint.
    """
    scenes, surface, control = block
    if inputs.trusted or crs is None or not all(photo.exterior for photo in photos):
        return
    if len(control) >= _MEASUREMENTS:
        _by_control(inputs, photos, crs, scenes, control, build)
    elif surface is not None and len(scenes) > 1:
        _by_correlation(inputs, photos, crs, scenes, surface, build)


def check_ground_height(inputs: Block, photos: Sequence[Photo], crs: CRS, surface: Surface) -> None:
    """Warning about one height of the ground that does not fit the photos' own heights above the place of take-off.

    Parameters
    ----------
    inputs : Block
        A DEM knows the ground better than what photos say: only one height is doubted.
    photos : sequence of Photo
        All of the block; some, spread over it, are looked at.
    crs : CRS
        3-D CRS of the positions.
    surface : Surface
        Plane of that height.
    """
    if inputs.height is None or inputs.trusted:
        return
    oriented = [photo for photo in photos if photo.exterior is not None]
    both = []
    for photo in oriented[:: -(-len(oriented) // _ASKED) or 1]:
        start = maker_number(read_photo_tags(photo.path).xmp, "RelativeAltitude")
        if start and photo.exterior is not None:
            height = Transform(crs, surface.crs)(np.array([photo.exterior.position]))[0, 2]
            both.append((height - inputs.height, start))
    if not both:
        return
    above, start = np.median(both, axis=0)
    if not abs(above - start) <= _UNLIKELY_RELIEF * abs(start):
        warn(
            f"doubtful: ground at {inputs.height:g} m is {above:.1f} m below the photos, which say {start:.1f} m above "
            f"take-off; a `height` of {inputs.height + above - start:.1f} would agree"
        )


def hints_for_upward_views(inputs: Block, photos: Sequence[Photo], crs: CRS, build: Build) -> list[str]:
    """Hints for photos that look at the sky: readings of the orientation with which they would look at the ground.

    Parameters
    ----------
    inputs : Block
    photos : sequence of Photo
        All of the block; about six, spread over it, are tried.
    crs : CRS
        CRS of the positions.
    build : callable
        Oriented images of another reading.

    Returns
    -------
    list of str
        Likeliest first.
    """
    oriented = [photo for photo in photos if photo.exterior]
    # A few photos tell a wrong unit or sense as well as all of them do.
    some = oriented[:: max(1, len(oriented) // 6)]
    return [
        hypothesis.hint
        for hypothesis in (hypotheses(inputs, some, crs) if some else ())
        # A vertical datum does not turn a camera.
        if hypothesis.inputs.heights == inputs.heights and _built(hypothesis, crs, build) is not None
    ]


def _by_control(
    inputs: Block,
    photos: Sequence[Photo],
    crs: CRS,
    scenes: Sequence[OrientedImage],
    control: Sequence[ControlPoint],
    build: Build,
) -> None:
    given = median_distance(scenes, control, crs)
    if given < FAR:
        return
    measured = {point.image for point in control}
    some = [photo for photo in photos if photo.name in measured]
    some = some[:: max(1, len(some) // 8)]
    tried = [
        (median_distance(made, control, _crs(hypothesis.inputs, crs)), hypothesis)
        for hypothesis in hypotheses(inputs, some, crs)
        if (made := _built(hypothesis, crs, build)) is not None
    ]
    if not tried:
        return
    least = min(off for off, _ in tried)
    # Of readings that do about as well, the first: hypotheses come in the order of likelihood.
    off, best = next((off, hypothesis) for off, hypothesis in tried if off <= 1.2 * least + 0.5)
    if off > PLAUSIBLE * min(float(np.hypot(*scene.model.size)) for scene in scenes):
        return
    if BETTER * off < median_distance(
        [scene for scene in scenes if scene.name in {p.name for p in some}], control, crs
    ):
        raise _implausible(inputs, f"control points lie {given:.0f} px from where it puts them", best, f"{off:.1f} px")


def _by_correlation(
    inputs: Block,
    photos: Sequence[Photo],
    crs: CRS,
    scenes: Sequence[OrientedImage],
    surface: Surface,
    build: Build,
) -> None:
    places = np.array([photo.exterior.position[:2] for photo in photos if photo.exterior])
    pairs = _nearest_pairs(places, _PAIRS)
    try:
        # As a rule one pair, in the middle of the block, is beyond doubt, and no other photo needs to be decoded.
        first = pairs[len(pairs) // 2] if pairs else ()
        small = dict(map_in_order(lambda i: _reduced_image(scenes[i].path), first, 2))
        if _median_correlation([scenes[i] for i in first], list(small.values()), surface) >= _CERTAIN_ALONE:
            return
        numbers = [i for pair in pairs for i in pair]
        small |= {i: _reduced_image(scenes[i].path) for i in dict.fromkeys(numbers) if i not in small}
    except GeomosaicError:
        return  # the orthos themselves will fail with a better message
    copies = [small[i] for i in numbers]
    given = _median_correlation([scenes[i] for i in numbers], copies, surface)
    if given >= _CERTAIN:
        return
    tried = [
        (_median_correlation(made, copies, surface), hypothesis)
        for hypothesis in hypotheses(inputs, [photos[i] for i in numbers], crs)
        if (made := _built(hypothesis, crs, build)) is not None
    ]
    if not tried:
        return
    most = max(correlation for correlation, _ in tried)
    # The first of those that do about as well, as above.
    best_correlation, best = next(pair for pair in tried if pair[0] >= most - 0.03)
    if best_correlation >= _SAME_GROUND and best_correlation - given >= _GAIN:
        what = f"neighbouring photos do not show the same ground (correlation {given:.2f})"
        raise _implausible(inputs, what, best, f"they do ({best_correlation:.2f})")


def median_distance(scenes: Sequence[OrientedImage], control: Sequence[ControlPoint], crs: CRS) -> float:
    """Median distance of measured control points from their computed image positions.

    Parameters
    ----------
    scenes : sequence of OrientedImage
    control : sequence of ControlPoint
        Those measured in other images do not count.
    crs : CRS
        CRS of the control points.

    Returns
    -------
    float
        Pixels; infinite for a point that its image does not see, 0 without points.
    """
    models = {scene.name: scene.model for scene in scenes}
    off = []
    for point in control:
        model = models.get(point.image)
        if model is None:
            continue
        at = Transform(crs, model.crs)(np.array([point.xyz]))
        computed = model.ground_to_image(at)[0]
        length = float(np.hypot(*(computed - np.array(point.colrow))))
        off.append(length if np.isfinite(length) else np.inf)
    return float(np.median(off)) if off else 0.0


def _built(hypothesis: Hypothesis, crs: CRS, build: Build) -> Sequence[OrientedImage] | None:
    """Oriented images of a reading; None where it is impossible."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return build(replace(hypothesis.inputs, trusted=True), hypothesis.photos, _crs(hypothesis.inputs, crs))
    except GeomosaicError:
        return None


def _crs(inputs: Block, crs: CRS) -> CRS:
    return positions_crs(inputs.crs, inputs.heights) if inputs.crs is not None else crs


def _implausible(inputs: Block, refused: str, best: Hypothesis, accepted: str) -> InputError:
    return InputError(
        f"the orientation is implausible: {refused}; with {best.what}, {accepted}",
        where=str(inputs.exterior),
        hint=f"{best.hint}; {_TRUST}",
    )


@dataclass(frozen=True)
class _ReducedImage:
    """Reduced image: grey minus its local mean, over its local deviation, and where it is valid; both (rows, cols)."""

    detail: FloatArray
    valid: BoolArray


def _reduced_image(path: str) -> _ReducedImage:
    """Reduced copy of an image, at most `_SIDE` pixels along the longer side."""
    rgb, valid = preview(path, _SIDE)
    grey = rgb.mean(axis=2, dtype=np.float64)
    mean = _box_mean(grey)
    # Local mean and deviation are taken off: exposures differ within a block, and light falls off towards the edges.
    spread = np.sqrt(np.maximum(_box_mean(grey * grey) - mean * mean, 1.0))
    return _ReducedImage((grey - mean) / spread, valid != 0)


def _box_mean(values: FloatArray) -> FloatArray:
    """Mean of 9 x 9 pixels about each pixel, by a summed-area table; edges repeat."""
    sums = np.pad(values, ((_AROUND + 1, _AROUND), (_AROUND + 1, _AROUND)), mode="edge")
    sums[0], sums[:, 0] = 0.0, 0.0
    sums = sums.cumsum(axis=0).cumsum(axis=1)
    n = 2 * _AROUND + 1
    mean: FloatArray = (sums[n:, n:] - sums[:-n, n:] - sums[n:, :-n] + sums[:-n, :-n]) / n**2
    return mean


def _correlation_of_pair(
    first: OrientedImage, second: OrientedImage, copies: tuple[_ReducedImage, _ReducedImage], surface: Surface
) -> float:
    """Correlation of two images over the same ground, 0 to 1; 0 where fewer than `_FEWEST` places are shown by both."""
    here, there = copies
    rows, cols = here.detail.shape
    c, r = (v.ravel() for v in np.meshgrid(np.arange(_EVERY, cols, _EVERY), np.arange(_EVERY, rows, _EVERY)))
    scale = np.array(first.model.size) / (cols, rows)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            ground = image_to_ground(first.model, (np.column_stack([c, r]) + 0.5) * scale, surface)
            seen = second.model.ground_to_image(Transform(surface.crs, second.model.crs)(ground))
    except GeomosaicError:
        return 0.0
    place = seen / (np.array(second.model.size) / there.detail.shape[::-1]) - 0.5
    limit = np.array(there.detail.shape[::-1]) - 1 - _REACH
    good = np.isfinite(place).all(axis=1) & (place >= _REACH).all(axis=1) & (place <= limit).all(axis=1)
    good &= here.valid[r, c]
    if np.count_nonzero(good) < _FEWEST:
        return 0.0
    values, at = here.detail[r[good], c[good]], np.rint(place[good]).astype(np.int64)
    # The largest correlation over small shifts: orientations may be rough, and that is not what is looked for.
    best = 0.0
    for down in range(-_REACH, _REACH + 1):
        for right in range(-_REACH, _REACH + 1):
            col, row = at[:, 0] + right, at[:, 1] + down
            known = there.valid[row, col]
            if np.count_nonzero(known) >= _FEWEST:
                best = max(best, _correlation(values[known], there.detail[row[known], col[known]]))
    return best


def _nearest_pairs(places: FloatArray, pairs: int) -> list[tuple[int, int]]:
    """At most so many pairs of nearest photos, spread over the block; `places` (N, 2) may have NaN."""
    found: dict[tuple[int, int], None] = {}
    for first in np.unique(np.linspace(0, len(places) - 1, pairs).round().astype(int)):
        distance = np.hypot(*(places - places[first]).T)
        distance[first] = np.inf
        second = int(np.argmin(distance))
        if np.isfinite(distance[second]):
            found[min(int(first), second), max(int(first), second)] = None
    return list(found)


def _median_correlation(scenes: Sequence[OrientedImage], copies: Sequence[_ReducedImage], surface: Surface) -> float:
    """Median correlation of images 0 and 1, 2 and 3, and so on; 0 without pairs."""
    each = [
        _correlation_of_pair(scenes[i], scenes[i + 1], (copies[i], copies[i + 1]), surface)
        for i in range(0, len(scenes) - 1, 2)
    ]
    return float(np.median(each)) if each else 0.0


def _correlation(a: FloatArray, b: FloatArray) -> float:
    a, b = a - a.mean(), b - b.mean()
    both = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / both if both > 0.0 else 0.0
