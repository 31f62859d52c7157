"""geomosaic.surface."""
