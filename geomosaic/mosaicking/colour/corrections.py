"""Colour corrections of photos: positions of samples, correction fields over the output, retouches, facts and notes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from geomosaic.errors import InputError, did_you_mean
from geomosaic.geo.grid import Grid, Window
from geomosaic.options.mosaic import Retouch
from geomosaic.radiometry import corrections as bases
from geomosaic.radiometry.colour_model import ColourModel
from geomosaic.radiometry.corrections import CorrectionField, ToneCurve
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.radiometry.normal_equations import ColourSetting
from geomosaic.radiometry.overlaps import Overlap, SamplePositions
from geomosaic.radiometry.radiometric_change import RadiometricChange
from geomosaic.render.photos import Photos
from geomosaic.resample.warp import Colour, value_range
from geomosaic.types import AnyArray, FloatArray, IntArray

# Intervals of the net of gains across a footprint: between nodes, vignetting by half is interpolated to 1e-4.
NODES = 48
# Relative difference of the sizes of images of one camera: orthos of one camera are not of equal size.
SIZE_TOLERANCE = 0.05


def _cameras(photos: Photos) -> IntArray:
    """Number of the camera (images,) of each photo: photos of one sensor and of about one size share a camera."""
    known: list[tuple[str, float, float]] = []
    numbers = []
    for scene in photos.scenes:
        width, height = scene.model.size
        for number, (sensor, w, h) in enumerate(known):
            if sensor == scene.sensor and abs(width / w - 1) < SIZE_TOLERANCE and abs(height / h - 1) < SIZE_TOLERANCE:
                numbers.append(number)
                break
        else:
            numbers.append(len(known))
            known.append((scene.sensor, width, height))
    return np.array(numbers, dtype=np.int64)


def view_radius(photos: Photos) -> float:
    """Half the diagonal of a footprint in map units, the median of all.

    Parameters
    ----------
    photos : Photos
    """
    radii = [np.hypot(*(outline.ring - np.array(outline.centre)).T).max() for outline in photos.outlines]
    return float(np.median(radii))


def sample_positions(photos: Photos, grid: Grid) -> SamplePositions:
    """Function that gives the positions of cells of a coarse grid in an image and relative to its nadir.

    Parameters
    ----------
    photos : Photos
    grid : Grid
        Coarse grid of the cells.

    Returns
    -------
    SamplePositions
        Image and cells (N, 2) as (col, row) → positions in the image and on the ground, each (N, 2), in the units of
        `radiometry.bases`. For a reference, which is numbered after the photos, all positions are 0.
    """
    radius = view_radius(photos)

    def find(index: int, cells: AnyArray) -> tuple[FloatArray, FloatArray]:
        if index >= len(photos):
            return np.zeros((len(cells), 2)), np.zeros((len(cells), 2))
        return _positions(photos, index, grid.xy(np.asarray(cells, dtype=np.float64) + 0.5), radius)

    return find


def _positions(photos: Photos, index: int, xy: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """Positions in the image (N, 2), corners at distance 1, and about the nadir (N, 2), in units of `radius`."""
    surface, size = photos.surface, np.array(photos.scenes[index].model.size, dtype=np.float64)
    with photos.using(index) as photo:
        mapper = photo.mapper
    own = mapper.surface_xy(xy)
    z = np.zeros(len(xy)) if surface is None or not mapper.uses_heights else surface.height(own)
    # Held at the edges: nodes of a net reach beyond the image, where powers of the radius would run away.
    colrow = np.clip(mapper.image(own, z), 0.0, size)
    image = (colrow - size / 2) / (np.hypot(*size) / 2)
    view = (xy - np.array(photos.outlines[index].centre)) / radius
    return image, np.clip(view, -1.2, 1.2)


def correction_field(photos: Photos, fields: ColourModel, radius: float, index: int) -> CorrectionField:
    """Correction field of one photo, laid out over its footprint in the output.

    Parameters
    ----------
    photos : Photos
    fields : ColourModel
    radius : float
        Unit of positions on the ground, see `view_radius`.
    index : int
        Number of the photo.

    Returns
    -------
    CorrectionField
        Nodes beyond the image have the gain of its edge, those that the model cannot see the mean gain of the others.
    """
    window = photos.grid.window_of(photos.outlines[index].bounds)
    longer = max(window.width, window.height, 1)
    spacing = longer / NODES
    cols = window.col + spacing * np.arange(max(2, int(np.ceil(window.width / spacing)) + 1))
    rows = window.row + spacing * np.arange(max(2, int(np.ceil(window.height / spacing)) + 1))
    c, r = np.meshgrid(cols, rows)
    xy = photos.grid.xy(np.column_stack([c.ravel(), r.ravel()]))
    image, view = _positions(photos, index, xy, radius)
    log = np.full((len(xy), fields.gain.shape[1]), np.nan)
    seen = np.isfinite(image).all(axis=1)
    if seen.any():
        log[seen] = fields.log_field(index, image[seen], view[seen])
        # Without a height, or where the model cannot see: pixels beside such a node are interpolated with it.
        log[~seen] = log[seen].mean(axis=0)
    else:
        log[:] = 0.0
    # Rounded: sums in another order differ in the last bits, and equal runs must give equal pixels.
    net = np.round(np.exp(log + fields.gain[index]), 9).reshape(len(rows), len(cols), -1)
    shade = CorrectionField.of(
        net, (float(cols[0]), float(rows[0])), (spacing, spacing), fields.dark[index], fields.gamma[index],
        fields.setting.reach, fields.setting.pivot,
    )  # fmt: skip
    if fields.haze is None:
        return shade
    return replace(shade, path=bases.excess_air_path(view).reshape(len(rows), len(cols)), haze=fields.haze[index])


def colour_setting(photos: Photos, pairs: list[Overlap], level: FloatArray) -> ColourSetting:
    """Setting of a colour model without terms.

    Parameters
    ----------
    photos : Photos
    pairs : list of Overlap
    level : array (images, bands)
        Median level of each photo, and NaN for a reference after them.

    Returns
    -------
    ColourSetting
    """
    kinds = _cameras(photos)
    # A reference was taken by no camera of the block: terms of light and lens do not apply to it.
    camera = np.concatenate([kinds, np.full(len(level) - len(kinds), -1)])
    return ColourSetting(
        len(camera), int(kinds.max()) + 1, camera, frozenset(), _value_range(photos, pairs), level,
        middle=_median_sample(pairs),
    )  # fmt: skip


def _value_range(photos: Photos, pairs: list[Overlap]) -> float:
    """Range of values: of the sample type, or of the samples where that has none."""
    _, high, whole = value_range(photos.info.dtype)
    return high if whole else max(float(np.abs(pair.a).max()) for pair in pairs) or 1.0


def _median_sample(pairs: list[Overlap]) -> float:
    """Median of the samples, of the first views of all overlaps; at least 0."""
    return max(float(np.median(np.concatenate([pair.a.ravel() for pair in pairs if len(pair.a)]))), 0.0)


Correction = Colour | ToneCurve | CorrectionField


def corrections(solved: Balance) -> Sequence[Correction]:
    """Corrections of all images in a balance.

    Parameters
    ----------
    solved : Balance

    Returns
    -------
    sequence of Correction
        Its curves where it has any, else gain and offset.
    """
    plain = [Colour(gain, offset) for gain, offset in zip(solved.gain, solved.offset, strict=True)]
    return solved.curves or plain


def with_gain_offset(correction: Correction, gain: float, offset: float) -> Correction:
    """Correction followed by gain · value + offset, in all bands.

    Parameters
    ----------
    correction : Correction
    gain, offset : float
        Applied to corrected values; `offset` in grey values.

    Returns
    -------
    Correction
        Of the same class.
    """
    if isinstance(correction, CorrectionField):
        bands = len(correction.dark)
        return correction.then(np.full(bands, gain), np.full(bands, offset))
    if isinstance(correction, ToneCurve):
        return replace(
            correction, knots=[(x, y * gain + offset) for x, y in correction.knots], slope=correction.slope * gain
        )
    return Colour(correction.gain * gain, correction.offset * gain + offset)


def corrected(correction: Correction, values: AnyArray, window: Window, coarse: Grid, output: Grid) -> FloatArray:
    """Corrected values of a window of a grid coarser than the output.

    Parameters
    ----------
    correction : Correction
    values : array (rows, cols, bands)
    window : Window
        Of the coarse grid.
    coarse, output : Grid
        With the same upper left corner; gains by place are laid out over the output.

    Returns
    -------
    array (rows, cols, bands)
    """
    if isinstance(correction, CorrectionField):
        # Centres of coarse cells in output pixels, over which the gains are laid out.
        factor = coarse.resolution[0] / output.resolution[0]
        cols = factor * np.arange(window.col + 0.5, window.stop_col, dtype=np.float64)
        rows = factor * np.arange(window.row + 0.5, window.stop_row, dtype=np.float64)
        return correction(values, cols, rows)
    return np.asarray(
        correction(values) if isinstance(correction, ToneCurve) else values * correction.gain + correction.offset
    )


def image_numbers(wanted: Sequence[str], names: Sequence[str], where: str) -> set[int]:
    """Numbers of the images that an edit names.

    Parameters
    ----------
    wanted : sequence of str
        Names in the edit.
    names : sequence of str
        Of all images.
    where : str
        Option that names them, for the error.

    Returns
    -------
    set of int

    Raises
    ------
    InputError
        A name that no image has.
    """
    for name in wanted:
        if name not in names:
            hint = did_you_mean(name, names) or "name an image"
            raise InputError(f"'{name}' is no image of this mosaic", where=where, hint=hint)
    return {names.index(name) for name in wanted}


def retouched(colours: Sequence[Correction], names: Sequence[str], edits: Mapping[str, Retouch]) -> list[Correction]:
    """Corrections of all images with manual edits applied.

    The balance is not solved again, so the images that no edit names stay as they are.

    Parameters
    ----------
    colours : sequence of Correction
        Of all images.
    names : sequence of str
        Of all images.
    edits : mapping of str to Retouch
        Gain and offset by name of the image.

    Returns
    -------
    list of Correction

    Raises
    ------
    InputError
        A name that no image has.
    """
    image_numbers(list(edits), list(names), "`retouch`")
    return [
        with_gain_offset(own, edits[name].gain, edits[name].offset) if name in edits else own
        for name, own in zip(names, colours, strict=True)
    ]


def rounded(solved: Balance) -> Balance:
    """Balance rounded to ten significant digits.

    Parameters
    ----------
    solved : Balance

    Returns
    -------
    Balance
        With rounded gains, offsets and knots of tone curves; correction fields were rounded when they were laid out.
    """
    # Solvers of linear algebra may differ in the last digits from run to run, as their threads divide the work; with
    # fewer digits equal runs have equal gains, and units of an earlier run can be used.
    curves = solved.curves
    if curves is not None and all(isinstance(curve, ToneCurve) for curve in curves):
        curves = tuple(_rounded_curve(curve) for curve in curves if isinstance(curve, ToneCurve))
    return replace(solved, gain=_digits(solved.gain), offset=_digits(solved.offset), curves=curves)


def _rounded_curve(curve: ToneCurve) -> ToneCurve:
    return replace(curve, knots=[(_digits(x), _digits(y)) for x, y in curve.knots])


def _digits(values: FloatArray, digits: int = 10) -> FloatArray:
    rounded: FloatArray = np.array([float(f"{v:.{digits}g}") for v in values.ravel().tolist()]).reshape(values.shape)
    return rounded


NAMES = {
    "vignetting": "fall of light to the corners",
    "trend": "view-angle trend",
    "hotspot": "hotspot",
    "haze": "haze towards the corners",
    "gamma": "gamma",
    "dodging": "local differences",
}


def colour_facts(balance: Balance, names: Sequence[str] | None) -> dict[str, Any]:
    """Facts of a colour balance for JSON: terms, trials, parameters of each image, fields that images share.

    Parameters
    ----------
    balance : Balance
    names : sequence of str, optional
        Of the images; numbers from 1 unless given.

    Returns
    -------
    dict
    """
    fields = balance.fields
    terms = [] if fields is None else [term for term in bases.TERMS if term in fields.setting.terms]
    facts: dict[str, Any] = {
        "terms": ["gain", "offset", *terms],
        "trials": [
            {"terms": list(trial.terms), "held_back_difference": trial.held_back_rms, "kept": trial.kept}
            for trial in balance.trials
        ],
        "notes": list(balance.notes),
        "radiometric_change": None if balance.change is None else asdict(balance.change),
    }
    if fields is None:
        return facts
    images = len(balance.gain)
    if "vignetting" in terms:
        # As a table besides: coefficients of ρ², ρ⁴ and ρ⁶ say little to a reader.
        rho = np.linspace(0, 1, 11)
        radial = rho[:, None] ** (2 * np.arange(1, bases.RADIAL + 1))
        own = np.split(fields.shared[: bases.RADIAL * fields.setting.cameras], fields.setting.cameras)
        facts["vignetting"] = [
            {"camera": number, "coefficients": k.T.tolist(), "light": np.exp(-radial @ k).T.tolist()}
            for number, k in enumerate(own)
        ]
    if "trend" in terms:
        at = bases.RADIAL * fields.setting.cameras * ("vignetting" in terms)
        facts["trend"] = fields.shared[at : at + bases.TREND].T.tolist()
    facts["dark"] = fields.dark[:images].tolist()
    if fields.haze is not None:
        facts["haze"] = fields.haze[:images].tolist()
    facts["gamma"] = fields.gamma[:images].tolist()
    shades = [shade for shade in balance.curves or () if isinstance(shade, CorrectionField)]
    facts["field"] = [
        {
            "image": str(i + 1) if names is None else names[i],
            "least": (shade.net / shade.net.mean(axis=(0, 1))).min(axis=(0, 1)).tolist(),
            "most": (shade.net / shade.net.mean(axis=(0, 1))).max(axis=(0, 1)).tolist(),
        }
        for i, shade in enumerate(shades)
    ]
    return facts


def term_notes(balance: Balance) -> list[str]:
    """Lines of text on the terms that were solved besides gain and offset.

    Parameters
    ----------
    balance : Balance

    Returns
    -------
    list of str
    """
    lines = list(balance.notes)
    if balance.fields is not None:
        terms = [NAMES[term] for term in bases.TERMS if term in balance.fields.setting.terms]
        lines.append(f"solved besides gain and offset: {', '.join(terms)}")
    elif balance.trials:
        lines.append("gain and offset are enough: nothing more makes images agree where they were not asked")
    if balance.change is not None and balance.change != RadiometricChange():
        lines.append(balance.change.text)
    return lines


def correction_picture(balance: Balance, side: int = 96) -> np.ndarray | None:
    """Picture of the correction fields of the first twelve images, side by side.

    Parameters
    ----------
    balance : Balance
    side : int
        Pixels of one field along each side.

    Returns
    -------
    uint8 array (rows, cols, 3) or None
        128 is the image's mean gain, a tenth more or less is 64 grey values; None without fields.
    """
    shades = [shade for shade in balance.curves or () if isinstance(shade, CorrectionField)][:12]
    if not shades:
        return None
    tiles = []
    for shade in shades:
        field = (shade.net / shade.net.mean(axis=(0, 1))).mean(axis=2)
        rows = np.linspace(0, field.shape[0] - 1, side).round().astype(int)
        cols = np.linspace(0, field.shape[1] - 1, side).round().astype(int)
        tone = np.clip(128 + 640 * (field[np.ix_(rows, cols)] - 1), 0, 255).astype(np.uint8)
        tiles.append(np.pad(tone, 2, constant_values=255))
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % 6 if len(tiles) > 6 else 0)
    per_row = 6 if len(tiles) > 6 else len(tiles)
    joined = np.concatenate([np.concatenate(tiles[k : k + per_row], axis=1) for k in range(0, len(tiles), per_row)])
    return np.repeat(joined[..., None], 3, axis=2)
