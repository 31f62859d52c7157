"""What a fitted surface is and how sure that is, in words and as plain values."""

from __future__ import annotations

from typing import Any

import numpy as np

from geomosaic.adjust.bodies.fit import FittedBody
from geomosaic.adjust.bodies.shape import SIZES
from geomosaic.surface.developed.body import Axes


def fit_facts(fitted: FittedBody, axes: Axes) -> dict[str, Any]:
    """Sizes, place and axis with their sigmas; metres and degrees, None where there is no check."""
    kind, sigmas = fitted.shape.kind, fitted.sigmas
    degrees = {"half_angle"}
    sizes = {
        name: {
            "value": float(np.degrees(value) if name in degrees else value),
            "sigma": _known(np.degrees(sigmas[name]) if name in degrees else sigmas[name]),
        }
        for name, value in zip(SIZES[kind], fitted.shape.sizes, strict=True)
    }
    turns = [np.degrees(value) for name, value in sigmas.items() if name.startswith("about")]
    return {
        "points": len(fitted.residuals),
        "redundancy": fitted.redundancy,
        "rms": float(np.sqrt((fitted.residuals**2).mean())),
        "sigma0": _known(fitted.sigma0),
        "largest_residual": float(np.abs(fitted.residuals).max()),
        **sizes,
        "origin": {"value": fitted.shape.origin.tolist(), "sigma": [_known(s) for s in fitted.sigma_origin]},
        "axis": {"value": axes.rotation[2].tolist(), "sigma_degrees": [_known(turn) for turn in turns]},
    }


def fit_words(fitted: FittedBody, axes: Axes) -> tuple[str, ...]:
    """The same in two lines."""
    facts = fit_facts(fitted, axes)
    check = f"sigma0 {1000 * facts['sigma0']:.2g} mm" if facts["sigma0"] is not None else "no check: no point too many"
    sizes = []
    for name in SIZES[fitted.shape.kind]:
        unit = "°" if name == "half_angle" else " m"
        sizes.append(f"{name} {facts[name]['value']:.4f}{unit}{_sigma(facts[name]['sigma'])}")
    words = f"{fitted.shape.kind} through {facts['points']} points: {check}, largest distance "
    words += f"{1000 * facts['largest_residual']:.2g} mm"
    place = ", ".join(
        f"{v:.4f}{_sigma(s)}" for v, s in zip(facts["origin"]["value"], facts["origin"]["sigma"], strict=True)
    )
    axis = ", ".join(f"{v:+.6f}" for v in facts["axis"]["value"])
    turns = facts["axis"]["sigma_degrees"]
    tilt = "" if not turns or None in turns else f", to {max(turns):.2g}°"
    name = "normal" if fitted.shape.kind == "plane" else "axis"
    return words, "; ".join([*sizes, f"origin {place}", f"{name} {axis}{tilt}"])


def _sigma(value: float | None) -> str:
    return "" if value is None else f" ± {value:.2g}"


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
