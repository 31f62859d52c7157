"""Edge matching: photos adjusted to control and to each other together, and joined exactly by correction grids."""

from __future__ import annotations

from geomosaic.orientation.edges.adjustment import CommonPoint, Stations
from geomosaic.orientation.edges.distributed_corrections import spread
from geomosaic.orientation.edges.initial_values import Misfit
from geomosaic.orientation.edges.match import EdgeMatch, match_edges

__all__ = ["CommonPoint", "EdgeMatch", "Misfit", "Stations", "match_edges", "spread"]
