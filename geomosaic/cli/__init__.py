"""geomosaic.cli."""
