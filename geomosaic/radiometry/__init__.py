"""geomosaic.radiometry."""
