"""geomosaic.block."""
