"""Manual edits of a mosaic: excluded images, and gain and offset of single images after the balance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from geomosaic.errors import InputError, did_you_mean
from geomosaic.mosaicking.colour.corrections import Correction, with_gain_offset
from geomosaic.options.mosaic import Retouch
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.radiometry.histogram_matching import ToneCurve
from geomosaic.types import FloatArray


def image_numbers(wanted: Sequence[str], names: Sequence[str], what: str) -> set[int]:
    """Numbers of the images that an edit names.

    Parameters
    ----------
    wanted : sequence of str
        Names in the edit.
    names : sequence of str
        Of all images.
    what : str
        What is done to them, for the error.

    Raises
    ------
    InputError
        A name that no image has.
    """
    for name in wanted:
        if name not in names:
            hint = did_you_mean(name, names) or "name an image"
            raise InputError(f"'{name}' is {what}, which is no image of this mosaic", hint=hint)
    return {names.index(name) for name in wanted}


def retouched(colours: Sequence[Correction], names: Sequence[str], edits: Mapping[str, Retouch]) -> list[Correction]:
    """Corrections of all images with manual edits applied; the balance is not solved again, so the others stay."""
    image_numbers(list(edits), list(names), "to be touched up")
    return [
        with_gain_offset(own, edits[name].gain, edits[name].offset) if name in edits else own
        for name, own in zip(names, colours, strict=True)
    ]


def rounded(solved: Balance) -> Balance:
    """Balance rounded to ten significant digits.

    Solvers of linear algebra may differ in the last digits from run to run, as their threads divide the work; with
    fewer digits equal runs have equal gains, and units of an earlier run can be used.
    """
    curves = solved.curves
    if curves is not None and all(isinstance(curve, ToneCurve) for curve in curves):
        curves = tuple(_rounded_curve(curve) for curve in curves if isinstance(curve, ToneCurve))
    return replace(solved, gain=_digits(solved.gain), offset=_digits(solved.offset), curves=curves)


def _rounded_curve(curve: ToneCurve) -> ToneCurve:
    return replace(curve, knots=[(_digits(x), _digits(y)) for x, y in curve.knots])


def _digits(values: FloatArray, digits: int = 10) -> FloatArray:
    rounded: FloatArray = np.array([float(f"{v:.{digits}g}") for v in values.ravel().tolist()]).reshape(values.shape)
    return rounded
