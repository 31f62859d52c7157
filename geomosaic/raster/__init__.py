"""geomosaic.raster."""
