"""Plausibility of exterior orientations: found before any long work, with the key or column to change.

Three witnesses are asked, each of them only where it can say something:
- the horizon: photos of the ground do not look at the sky (`geomosaic.sensor.plausibility.SkyError`);
- control points: the measured places against those that the orientation gives;
- the pictures: neighbouring photos, reduced, against each other over the ground.
A reading other than the declared one is proposed where the witness refuses what was declared and clearly accepts the
other. Poor orientations are not refused: no other reading makes them good. Nor is anything said where it is not needed.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from pyproj import CRS

from geomosaic.block.block import ControlPoint, OrientedImage
from geomosaic.errors import GeomosaicError, InputError
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.frames import positions_crs
from geomosaic.inputs.orientation_check.hypotheses import Reading, neighbours, readings, reduced_image, together
from geomosaic.inputs.photos import Photo
from geomosaic.render.workers import in_order
from geomosaic.surface.model import Surface

Build = Callable[[Block, Sequence[Photo], CRS], Sequence[OrientedImage]]
"""Scenes of some photos, with the CRS of their positions."""

FAR = 5.0
"""Pixels by which control points may lie off, in the median, without any doubt."""
BETTER = 4.0
"""How many times nearer another reading must bring them."""
ALIKE, UNLIKE, GAIN = 0.35, 0.45, 0.3
"""Correlations: neighbours that show the same ground, that are beyond doubt, and the least gain of another reading."""
PAIRS = 3
SURE = 0.65
"""Correlation of a single pair that makes others needless."""
PLAUSIBLE = 0.1
"""Part of the diagonal that points may lie off by a reading that is proposed: farther off, it explains nothing."""
MEASUREMENTS = 4
TRUST = "if the orientation is right as it is, say so: `trusted`"


def check_orientation(
    inputs: Block,
    photos: Sequence[Photo],
    crs: CRS | None,
    block: tuple[Sequence[OrientedImage], Surface | None, Sequence[ControlPoint]],
    build: Build,
) -> None:
    """Check of orientations: an error where one cannot be meant, and another reading of the same table can.

    Parameters
    ----------
    inputs : Block
    photos : sequence of Photo
        All of the block.
    crs : CRS or None
        Of the positions.
    block : tuple
        Scenes (in the order of the photos), surface and control points.
    build : callable
        Makes scenes of another reading.

    Raises
    ------
    InputError
        Names what speaks against the orientation, and a hint.
    """
    scenes, surface, control = block
    if inputs.trusted or crs is None or not all(photo.exterior for photo in photos):
        return
    if len(control) >= MEASUREMENTS:
        _by_control(inputs, photos, crs, scenes, control, build)
    elif surface is not None and len(scenes) > 1:
        _by_pictures(inputs, photos, crs, scenes, surface, build)


def looking_down(inputs: Block, photos: Sequence[Photo], crs: CRS, build: Build) -> list[str]:
    """Hints for photos that look at the sky: readings of the orientation with which they would look at the ground.

    Parameters
    ----------
    inputs : Block
    photos : sequence of Photo
        About six of them, spread over the table, are tried.
    crs : CRS
        Of the positions.
    build : callable
        Makes scenes of another reading.

    Returns
    -------
    list of str
        The likeliest first.
    """
    oriented = [photo for photo in photos if photo.exterior]
    # A few photos tell a wrong unit or sense as well as all of them do.
    some = oriented[:: max(1, len(oriented) // 6)]
    found = []
    for reading in readings(inputs, some, crs) if some else ():
        if reading.inputs.heights == inputs.heights and _built(reading, crs, build) is not None:
            found.append(reading.hint)
    return found


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
    tried = []
    for reading in readings(inputs, some, crs):
        made = _built(reading, crs, build)
        if made is not None:
            tried.append((median_distance(made, control, _crs(reading.inputs, crs)), reading))
    if not tried:
        return
    least = min(off for off, _ in tried)
    # Of readings that do about as well, the first: they come in the order of likelihood.
    off, best = next((off, reading) for off, reading in tried if off <= 1.2 * least + 0.5)
    if off > PLAUSIBLE * min(float(np.hypot(*scene.model.size)) for scene in scenes):
        return
    if BETTER * off < median_distance(
        [scene for scene in scenes if scene.name in {p.name for p in some}], control, crs
    ):
        raise _doubt(inputs, f"control points lie {given:.0f} px from where it puts them", best, f"{off:.1f} px")


def _by_pictures(
    inputs: Block,
    photos: Sequence[Photo],
    crs: CRS,
    scenes: Sequence[OrientedImage],
    surface: Surface,
    build: Build,
) -> None:
    places = np.array([photo.exterior.position[:2] for photo in photos if photo.exterior])
    pairs = neighbours(places, PAIRS)
    try:
        # As a rule one pair, in the middle of the block, is beyond doubt, and no other needs to be read.
        first = pairs[len(pairs) // 2] if pairs else ()
        small = dict(in_order(lambda i: reduced_image(scenes[i].path), first, 2))
        if together([scenes[i] for i in first], list(small.values()), surface) >= SURE:
            return
        numbers = [i for pair in pairs for i in pair]
        small |= {i: reduced_image(scenes[i].path) for i in dict.fromkeys(numbers) if i not in small}
    except GeomosaicError:
        return  # the work itself will say it better
    copies = [small[i] for i in numbers]
    given = together([scenes[i] for i in numbers], copies, surface)
    if given >= UNLIKE:
        return
    tried = []
    for reading in readings(inputs, [photos[i] for i in numbers], crs):
        made = _built(reading, crs, build)
        if made is not None:
            tried.append((together(made, copies, surface), reading))
    if not tried:
        return
    most = max(alike for alike, _ in tried)
    # The likeliest of those that do about as well, as above.
    alike, best = next((alike, reading) for alike, reading in tried if alike >= most - 0.03)
    if alike >= ALIKE and alike - given >= GAIN:
        what = f"neighbouring photos do not show the same ground (correlation {given:.2f})"
        raise _doubt(inputs, what, best, f"they do ({alike:.2f})")


def median_distance(scenes: Sequence[OrientedImage], control: Sequence[ControlPoint], crs: CRS) -> float:
    """Median distance of measured control points from their computed image positions.

    Parameters
    ----------
    scenes : sequence of OrientedImage
    control : sequence of ControlPoint
    crs : CRS
        Of the control points.

    Returns
    -------
    float
        Pixels. A point that its image does not see is infinitely far; 0 where no point lies in these images.
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


def _built(reading: Reading, crs: CRS, build: Build) -> Sequence[OrientedImage] | None:
    """Scenes of a reading; None where it cannot be."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return build(replace(reading.inputs, trusted=True), reading.photos, _crs(reading.inputs, crs))
    except GeomosaicError:
        return None


def _crs(inputs: Block, crs: CRS) -> CRS:
    return positions_crs(inputs.crs, inputs.heights) if inputs.crs is not None else crs


def _doubt(inputs: Block, refused: str, best: Reading, accepted: str) -> InputError:
    return InputError(
        f"the orientation cannot be meant: {refused}; with {best.what}, {accepted}",
        where=str(inputs.exterior),
        hint=f"{best.hint}; {TRUST}",
    )
