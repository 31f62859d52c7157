"""An image that lies about where its model says, found in a georeferenced reference, coarse to fine.

Image and reference are drawn on one grid of the reference, so that scale, turn and relief hardly differ. On a coarse
grid features, or the correlation of both, find by how much the model is wrong; resected with that, it draws the image
nearly where it belongs, and corners of the reference are found in it: by correlation, then by least squares, on finer
and finer grids. What the resection leaves tells how well reference and heights agree with the image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geomosaic.block import OrientedImage
from geomosaic.errors import InputError, SolveError
from geomosaic.estimation.blunders.data_snooping import chance_errors
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.units import linear_unit
from geomosaic.matching.registration import (
    PATCH,
    Picture,
    agreeing_with_homography,
    align_features,
    corners,
    correlated_shift,
    match_corners,
)
from geomosaic.matching.two_view import LEAST_MATCHES
from geomosaic.reference_matching.drawing import Drawer
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve.control_resection import resect_control
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray, IntArray

# Longer side of the grids on which features, and a shift alone, are looked for.
FEATURE_SIDE, SHIFT_SIDE = 1500, 256
FEATURES = 5000
# Share of the image's diagonal that an angle of some degrees may move it, beside its position.
TILT = 0.1
# Cells along the longer side of the image, points that are looked for in each, and pixels of a cell that are drawn.
CELLS, PER_CELL, DRAWN = 12, 6, 256
# Correlation of the least squares match, and its largest standard deviation, grid pixels: other seasons leave less than
# two photos of one flight have.
LEAST_CORRELATION, LARGEST_SIGMA = 0.6, 0.3
# Pixels of the image that matching cannot know of (what stands above the surface, changes within the patch).
FLOOR = 0.1
# Share of the places found that must agree: of those found by chance hardly any do.
LEAST_SHARE = 0.15
# Pixels of the coarser grid within which the finer one looks.
REACH = 2.5
# Median pixels of the image that its model may have been wrong where its patches were drawn for the last time.
NEAR = 1.0


@dataclass(frozen=True, eq=False)
class ReferenceMatch:
    """Places of an image that were found in a reference, N of them.

    Attributes
    ----------
    scene : OrientedImage
        With the model resected on them.
    colrow : array (N, 2)
        Pixels of the image, corner-based.
    xy : array (N, 2)
        On the map of the reference.
    xyz : array (N, 3)
        On the ground, in the CRS of the surface; z is 0 without one.
    covariance : array (N, 2, 2)
        Of `colrow`, from the matching alone, square pixels.
    residuals : array (N, 2)
        `colrow` less where the model puts them, pixels.
    sampling : float
        Metres on the ground of a pixel of the image.
    moved : float
        Median distance of the places from where the model had put them, metres.
    left_out : array (K, 4)
        `colrow` and `residuals` of the places that were measured and do not agree.
    """

    scene: OrientedImage
    colrow: FloatArray
    xy: FloatArray
    xyz: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    sampling: float
    moved: float
    left_out: FloatArray

    def __len__(self) -> int:
        return len(self.colrow)

    @property
    def tried(self) -> int:
        """Places that were measured, with those that do not agree."""
        return len(self) + len(self.left_out)

    @property
    def rms(self) -> float:
        """Root mean square of the residuals of one axis, pixels."""
        return float(np.sqrt((self.residuals**2).mean())) if len(self) else float("nan")

    @property
    def sigma(self) -> float:
        """Standard deviation of the reference in one axis, metres: what the residuals have beyond the matching."""
        # The errors that all of its points share, of a datum or a shift of the map, are not in it.
        own = float(np.trace(self.covariance, axis1=1, axis2=2).mean()) / 2.0
        # A model of few parameters follows the errors a little.
        freedom = max(2 * len(self) - 8, 1) / (2.0 * len(self))
        return self.sampling * float(np.sqrt(max(self.rms**2 / freedom - own, FLOOR**2)))

    def select(self, kept: BoolArray) -> ReferenceMatch:
        """Those of them (N,) that agree."""
        names = ("colrow", "xy", "xyz", "covariance", "residuals")
        out = np.hstack([self.colrow, self.residuals])[~kept]
        kept_only = {name: getattr(self, name)[kept] for name in names}
        return replace(self, left_out=np.vstack([self.left_out, out]), **kept_only)


@dataclass(frozen=True, eq=False)
class Reference:
    """Open reference with its own grid.

    Attributes
    ----------
    drawer : Drawer
    grid : Grid
    """

    drawer: Drawer
    grid: Grid

    @classmethod
    def open(cls, scene: OrientedImage, grid: Grid) -> Reference:
        """Reference as `georeferenced` gives it, opened; its drawer is a context."""
        return cls(Drawer.open(scene, None, grid.crs), grid)

    @property
    def name(self) -> str:
        """Its file."""
        return self.drawer.scene.path

    @property
    def metres(self) -> float:
        """Metres in a unit of its map."""
        return linear_unit(self.grid.crs)

    def factor(self, drawer: Drawer) -> int:
        """Pixels of the reference along those of the finest grid: about as large as the image's own."""
        return max(1, round(drawer.outline.sampling / max(self.grid.resolution)))

    def around(self, drawer: Drawer, factor: int, margin: float) -> tuple[Grid, Window]:
        """Its grid in pixels of a factor, and the window that may show the image, `margin` in metres.

        Parameters
        ----------
        drawer : Drawer
            Of the image.
        factor : int
            Pixels of the reference along those of the grid.
        margin : float
            Metres around the image's outline.
        """
        left, bottom, right, top = drawer.outline.bounds
        wide = margin / self.metres
        grid = self.grid if factor == 1 else self.grid.coarser(factor)
        return grid, grid.window_of((left - wide, bottom - wide, right + wide, top + wide))


@dataclass(frozen=True, eq=False)
class _Points:
    """Places of an image, and where they lie: on the map, on the ground."""

    colrow: FloatArray
    covariance: FloatArray
    xy: FloatArray
    xyz: FloatArray


def match_oriented(
    scene: OrientedImage,
    surface: Surface | None,
    reference: Reference,
    search: float,
    tolerance: float | None = None,
) -> ReferenceMatch:
    """Places of an image of approximate orientation in a reference.

    Parameters
    ----------
    scene : OrientedImage
    surface : Surface or None
        None where the model uses no heights.
    reference : Reference
    search : float
        Metres that the image may lie wrong; angles of some degrees are allowed for besides.
    tolerance : float, optional
        Pixels that places may lie off the resected model: the image is warped in itself. Without it the scatter says
        which places are wrong.

    Raises
    ------
    InputError
        The reference shows nothing of where the image lies.
    SolveError
        The image was not found in it.
    """
    crs = reference.grid.crs
    with Drawer.open(scene, surface, crs) as drawer:
        left, bottom, right, top = drawer.outline.bounds
        margin = search + TILT * reference.metres * float(np.hypot(right - left, top - bottom))
        start, factor = _rough(drawer, reference, margin)
        loose = margin / (reference.metres * drawer.outline.sampling)
        model = _resected(drawer, start, np.full(len(start.colrow), float(factor)), loose)
        return refine(drawer.with_model(model, crs), reference, factor, loose, drawer, tolerance)


def refine(
    drawer: Drawer,
    reference: Reference,
    factor: int,
    loose: float,
    given: Drawer,
    tolerance: float | None = None,
) -> ReferenceMatch:
    """Places of an image whose model is right to some pixels of a coarse grid.

    Parameters
    ----------
    drawer : Drawer
        Of the image.
    reference : Reference
    factor : int
        Pixels of the reference in one of the coarse grid.
    loose : float
        Pixels that the model's parameters may move the image.
    given : Drawer
        Of the image as it was declared.
    tolerance : float, optional
        See `match_oriented`.

    Raises
    ------
    SolveError
        Too few places agree.
    """
    crs, last = reference.grid.crs, reference.factor(drawer)
    again = 2
    while True:
        finer = max(last, factor // 4)
        # Of features places are good to two pixels or so of their grid; on the finest again, to less than a few.
        reach = max(4, int(np.ceil(REACH * factor / finer)))
        # Pixels of the image in one of the grid.
        wide = max(reference.grid.resolution) * finer / drawer.outline.sampling
        reach += int(np.ceil((tolerance or 0.0) / wide))
        factor = finer
        found = _measured(drawer, reference, factor, reach)
        predicted = drawer.mapper.image(found.xyz[:, :2], found.xyz[:, 2])
        seen = np.flatnonzero(np.isfinite(predicted).all(axis=1))
        # A homography takes what the model may still be wrong by, and leaves relief: some pixels.
        agreed = agreeing_with_homography(
            predicted[seen], found.colrow[seen], max(3.0, 1.5 * factor / last, tolerance or 0.0)
        )
        kept = seen[agreed[1]] if agreed is not None else seen[:0]
        if len(kept) < max(LEAST_MATCHES, LEAST_SHARE * len(found.colrow)):
            raise not_found(reference, f"{len(kept)} of {len(found.colrow)} places agree")
        sigma = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2) / 2.0)
        drawer = drawer.with_model(_resected(drawer, _selected(found, kept), sigma[kept], loose), crs)
        # Patches were drawn by the model before: once more where that put them visibly elsewhere.
        wrong = float(np.median(np.abs(predicted[kept] - found.colrow[kept])))
        if factor == last and (wrong < NEAR or not again):
            break
        again -= factor == last
    residuals = found.colrow - drawer.mapper.image(found.xyz[:, :2], found.xyz[:, 2])
    if tolerance is None:
        scatter = np.sqrt(sigma**2 + np.median((residuals[kept] ** 2).mean(axis=1)))
        good = chance_errors(((residuals / scatter[:, None]) ** 2).sum(axis=1), np.full(len(residuals), 2))
    else:
        good = np.linalg.norm(residuals, axis=1) < 2.0 * tolerance
    sampling = drawer.outline.sampling * reference.metres
    away = found.colrow - given.mapper.image(found.xyz[:, :2], found.xyz[:, 2])
    moved = float(np.nanmedian(np.linalg.norm(away[good], axis=1))) * sampling
    match = ReferenceMatch(
        drawer.scene, found.colrow, found.xy, found.xyz, found.covariance, residuals, sampling, moved, np.zeros((0, 4))
    )
    return match.select(good)


@dataclass(frozen=True, eq=False)
class PlaceMatch:
    """Place of the ground that was found in an image by its picture in a reference.

    Attributes
    ----------
    colrow : array (2,)
        Pixels of the image, corner-based.
    covariance : array (2, 2)
        Of it, square pixels.
    correlation : float
    """

    colrow: FloatArray
    covariance: FloatArray
    correlation: float


def match_place(drawer: Drawer, reference: Reference, xy: tuple[float, float], reach: int = 8) -> PlaceMatch | None:
    """Place of the image that shows what the reference shows at a point of its map, by least squares matching.

    The image is drawn through its model on the grid of the reference first, so that scale, turn and relief hardly
    differ.

    Parameters
    ----------
    drawer : Drawer
        Of the image, whose model is right to `reach`.
    reference : Reference
    xy : tuple of float
        On its map.
    reach : int
        Pixels of the finest grid that the image may lie off.

    Returns
    -------
    PlaceMatch or None
        None where either shows nothing there, the correlation is below 0.6, or the match is not determined.
    """
    grid = reference.grid.coarser(factor) if (factor := reference.factor(drawer)) > 1 else reference.grid
    at = grid.colrow(np.array([xy]))[0]
    col, row = (int(np.floor(value)) for value in at)
    border = PATCH + reach + 4
    window = Window(col - border, row - border, 2 * border + 1, 2 * border + 1).intersection(grid.window)
    if window.empty or not (
        window.col <= col < window.col + window.width and window.row <= row < window.row + window.height
    ):
        return None
    here = grid.crop(window)
    truth, seen = reference.drawer.draw(here), drawer.draw(here)
    pixel = np.array([[col - window.col, row - window.row]])
    found = match_corners(truth, seen, pixel, reach)
    largest = np.linalg.eigvalsh(np.nan_to_num(found.covariance, nan=1.0))[0, 1]
    if not found.found[0] or found.correlation[0] < LEAST_CORRELATION or largest > LARGEST_SIGMA**2:
        return None
    measured = _measured_points(drawer, here, pixel + 0.5, found.colrow, found.covariance)
    if not len(measured.colrow):
        return None
    # A template is centred on a pixel; the rest of a pixel to the point itself goes through the model.
    exact = drawer.ground(here, here.colrow(np.array([xy])))
    wanted, centre = (drawer.mapper.image(place[:, :2], place[:, 2])[0] for place in (exact, measured.xyz))
    return PlaceMatch(measured.colrow[0] + wanted - centre, measured.covariance[0], float(found.correlation[0]))


def not_found(reference: Reference, why: str, hint: str = "") -> SolveError:
    """Error of an image that a reference does not show.

    Parameters
    ----------
    reference : Reference
    why : str
    hint : str
        What to look for, instead of what helps with an orientation.
    """
    own = (
        "does it show the same land, in a resolution not much coarser than the image's? Where the image may lie "
        "farther off, raise `search`; where its angles, heights or CRS are wrong, correct them"
    )
    return SolveError(f"the image is not found in the reference: {why}", where=reference.name, hint=hint or own)


def _rough(drawer: Drawer, reference: Reference, margin: float) -> tuple[_Points, int]:
    """Places of the image on a coarse grid, and the factor of that grid."""
    last = reference.factor(drawer)
    _, window = reference.around(drawer, 1, margin)
    if window.empty:
        raise InputError(
            "the reference shows nothing of the land where the image lies by its orientation",
            where=reference.name,
            hint="check the CRS and the positions of the image, or raise `search`",
        )
    side = max(window.width, window.height)
    first = max(last, -(-side // FEATURE_SIDE))
    for factor in dict.fromkeys((first, max(last, first // 2))):
        grid, pictures = _pictures(drawer, reference, factor, margin)
        found = align_features(pictures[0].features(FEATURES), pictures[1].features(FEATURES))
        if found is not None:
            return _points(drawer, grid, found.first, found.second), factor
    factor = max(last, -(-side // SHIFT_SIDE))
    grid, pictures = _pictures(drawer, reference, factor, margin)
    reach = int(np.ceil(margin / (max(grid.resolution) * reference.metres)))
    shift = correlated_shift(*pictures, reach)
    if shift is None:
        raise not_found(reference, "neither features nor the correlation of both tell where")
    rows, cols = np.nonzero(pictures[1].valid)
    spread = np.linspace(0, len(rows) - 1, 200).astype(np.int64)
    second = np.column_stack([cols, rows])[spread].astype(np.float64) + 0.5
    return _points(drawer, grid, second - shift.matrix[:2, 2], second), factor


def _pictures(drawer: Drawer, reference: Reference, factor: int, margin: float) -> tuple[Grid, tuple[Picture, Picture]]:
    """Reference and image on one grid."""
    grid, window = reference.around(drawer, factor, margin)
    here = grid.crop(window)
    return here, (reference.drawer.draw(here), drawer.draw(here))


def _points(drawer: Drawer, grid: Grid, first: FloatArray, second: FloatArray) -> _Points:
    """Places of the image from those on a grid of the reference (N, 2) and of the image drawn on it (N, 2)."""
    none = np.zeros((len(first), 2, 2))
    return _finite(_Points(drawer.places(grid, second), none, grid.xy(first), drawer.ground(grid, first)))


def _finite(points: _Points) -> _Points:
    seen = np.isfinite(points.colrow).all(axis=1) & np.isfinite(points.xyz).all(axis=1)
    return _selected(points, np.flatnonzero(seen))


def _selected(points: _Points, kept: IntArray) -> _Points:
    return _Points(points.colrow[kept], points.covariance[kept], points.xy[kept], points.xyz[kept])


def _resected(drawer: Drawer, points: _Points, sigma: FloatArray, loose: float) -> SensorModel:
    """Model of the image on its points, whose standard deviations (N,) are in pixels; wrong ones left out."""
    start, xyz = drawer.scene.model, drawer.mapper.to_model(points.xyz)
    given = start.parameters
    # What the sensor declares as known by its own sigmas stays known; where it holds all, all may move.
    free = given.sigmas > 0.0 if (given.sigmas > 0.0).any() else np.ones(len(given), dtype=bool)
    priors = np.where(free, 10.0 * loose * given.steps, 0.0)
    return resect_control(start, xyz, points.colrow, sigma, priors=priors).solved.model


def _measured(drawer: Drawer, reference: Reference, factor: int, reach: int) -> _Points:
    """Corners of the reference that were found in the image, cell by cell, on the grid of a factor."""
    grid, window = reference.around(drawer, factor, 0.0)
    cell = max(64, -(-max(window.width, window.height) // CELLS))
    parts = []
    for part in window.split(cell, cell):
        across, down = min(part.width, DRAWN), min(part.height, DRAWN)
        border = PATCH + reach + 4
        col, row = part.col + (part.width - across) // 2 - border, part.row + (part.height - down) // 2 - border
        outer = Window(col, row, across + 2 * border, down + 2 * border).intersection(grid.window)
        here = grid.crop(outer)
        seen = drawer.draw(here)
        if not seen.valid.any():
            continue
        truth = reference.drawer.draw(here)
        pixels = corners(Picture(truth.values, truth.valid & seen.valid), 30, cell / 2.5)
        # Each corner belongs to one cell; the border is what matching looks into.
        low = np.array([col + border - outer.col, row + border - outer.row])
        inner = ((pixels >= low) & (pixels < low + np.array([across, down]))).all(axis=1)
        pixels = pixels[inner][:PER_CELL]
        found = match_corners(truth, seen, pixels, reach)
        largest = np.linalg.eigvalsh(np.nan_to_num(found.covariance, nan=1.0))[:, 1]
        good = found.found & (found.correlation > LEAST_CORRELATION) & (largest < LARGEST_SIGMA**2)
        if good.any():
            parts.append(
                _measured_points(
                    drawer, here, pixels[good].astype(np.float64) + 0.5, found.colrow[good], found.covariance[good]
                )
            )
    if not parts:
        return _points(drawer, grid, np.zeros((0, 2)), np.zeros((0, 2)))
    names = ("colrow", "covariance", "xy", "xyz")
    return _Points(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _measured_points(
    drawer: Drawer, grid: Grid, first: FloatArray, second: FloatArray, covariance: FloatArray
) -> _Points:
    """Measured places of the image, their covariances (N, 2, 2) carried from the grid to its pixels."""
    half = np.array([[0.5, 0.0], [0.0, 0.5]])
    by = [drawer.places(grid, second + step) - drawer.places(grid, second - step) for step in half]
    slope = np.stack(by, axis=2)  # of (col, row) by the grid's column and row
    carried = slope @ covariance @ slope.transpose(0, 2, 1) + FLOOR**2 * np.eye(2)
    plain = _Points(drawer.places(grid, second), carried, grid.xy(first), drawer.ground(grid, first))
    return _finite(plain)
