"""geomosaic.resample."""
