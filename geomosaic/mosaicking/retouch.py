"""What a person changes after having looked: photos left out, the colour of one photo touched up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from geomosaic.errors import InputError, did_you_mean
from geomosaic.mosaicking.colour.corrections import Correction, then
from geomosaic.options.mosaic import Retouch
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.radiometry.histogram_matching import Curve
from geomosaic.types import FloatArray


def numbers_of(wanted: Sequence[str], names: Sequence[str], what: str) -> set[int]:
    """Numbers of images that an edit names.

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
    """Corrections of all images, some of them touched up. The balance itself is not solved anew: others stay."""
    numbers_of(list(edits), list(names), "to be touched up")
    return [
        then(own, edits[name].gain, edits[name].offset) if name in edits else own
        for name, own in zip(names, colours, strict=True)
    ]


def steady(solved: Balance) -> Balance:
    """A balance of ten significant digits.

    Solvers of linear algebra may differ in the last digits from run to run, as their threads divide the work; with
    fewer digits equal runs have equal gains, and units of an earlier run can be taken.
    """
    curves = solved.curves
    if curves is not None and all(isinstance(curve, Curve) for curve in curves):
        curves = tuple(_rounded(curve) for curve in curves if isinstance(curve, Curve))
    return replace(solved, gain=_digits(solved.gain), offset=_digits(solved.offset), curves=curves)


def _rounded(curve: Curve) -> Curve:
    return replace(curve, knots=[(_digits(x), _digits(y)) for x, y in curve.knots])


def _digits(values: FloatArray, digits: int = 10) -> FloatArray:
    rounded: FloatArray = np.array([float(f"{v:.{digits}g}") for v in values.ravel().tolist()]).reshape(values.shape)
    return rounded
