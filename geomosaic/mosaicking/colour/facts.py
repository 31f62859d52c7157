"""Facts of the colour balance: values for JSON, a line in words, a picture of the correction fields."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from geomosaic.radiometry import bases
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.radiometry.local_gains import CorrectionField

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
            {"terms": list(trial.terms), "held_back_difference": trial.left, "kept": trial.kept}
            for trial in balance.trials
        ],
        "notes": list(balance.notes),
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
