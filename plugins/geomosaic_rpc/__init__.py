"""Satellite scenes with rational polynomial coefficients: read, refined, fitted to other models, written."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from geomosaic_rpc.entry_point import RpcPlugin

plugin = RpcPlugin()

# Loaded when first used: the program looks at the plugin of every sensor to find one by its capabilities.
_HOMES = {
    "Refinement": "refinement",
    "TieCorrection": "tie_correction",
    "Rpc": "coefficients",
    "RpcFit": "fit",
    "RpcModel": "model",
    "TieMeasurements": "tie_correction",
    "fit_rpc": "fit",
    "read_rpc": "build",
    "refine": "refinement",
    "correct_by_ties": "tie_correction",
    "write_tags": "write",
    "write_text": "write",
}

__all__ = ["plugin", *_HOMES]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(f"geomosaic_rpc.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'geomosaic_rpc' has no attribute '{name}'")
