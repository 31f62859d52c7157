"""geomosaic.product."""
