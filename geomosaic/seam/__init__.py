"""geomosaic.seam."""
