"""Satellite scenes with rational polynomial coefficients: read, refined, fitted to other models, written."""

from __future__ import annotations

from geomosaic_rpc.build import RpcPlugin
from geomosaic_rpc.coefficients import Rpc
from geomosaic_rpc.model import RpcModel
from geomosaic_rpc.read import read_rpc
from geomosaic_rpc.refine import Refinement, refine

plugin = RpcPlugin()

__all__ = ["Refinement", "Rpc", "RpcModel", "RpcPlugin", "plugin", "read_rpc", "refine"]
