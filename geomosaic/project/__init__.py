"""geomosaic.project."""
