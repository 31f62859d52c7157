"""Page of a sheet for tests of layers, which need its map only."""

from geomosaic.geo.crs import CRS
from geomosaic.sheets.page import Page


def page_of(crs: CRS, bounds: tuple[float, float, float, float], straight: float) -> Page:
    """Page of a map on which chords of `straight` units of the map are two millimetres long."""
    paper = (0.0, 0.0, 100.0, 100.0)
    return Page(100.0, 100.0, paper, paper, paper, None, None, "none", crs, bounds, 500.0 * straight)
