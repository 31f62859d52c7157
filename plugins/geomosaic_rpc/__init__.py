"""Satellite scenes with rational polynomial coefficients: read, refined, fitted to other models, written."""

from __future__ import annotations

from geomosaic_rpc.build import RpcPlugin
from geomosaic_rpc.coefficients import Rpc
from geomosaic_rpc.find import read_rpc
from geomosaic_rpc.fit import RpcFit, fit_rpc
from geomosaic_rpc.model import RpcModel
from geomosaic_rpc.refine import Refinement, refine
from geomosaic_rpc.tie_correction import Relation, Sights, relate
from geomosaic_rpc.write import write_tags, write_text

plugin = RpcPlugin()

__all__ = [
    "Refinement",
    "Relation",
    "Rpc",
    "RpcFit",
    "RpcModel",
    "RpcPlugin",
    "Sights",
    "fit_rpc",
    "plugin",
    "read_rpc",
    "refine",
    "relate",
    "write_tags",
    "write_text",
]
