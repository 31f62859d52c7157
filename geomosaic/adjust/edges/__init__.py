"""Edge matching: photos adjusted to control and to each other together, and joined exactly by correction grids."""

from __future__ import annotations

from geomosaic.adjust.edges.match import EdgeMatch, match_edges
from geomosaic.adjust.edges.misfit import Misfit
from geomosaic.adjust.edges.spread import spread
from geomosaic.adjust.edges.stations import CommonPoint, Stations

__all__ = ["CommonPoint", "EdgeMatch", "Misfit", "Stations", "match_edges", "spread"]
