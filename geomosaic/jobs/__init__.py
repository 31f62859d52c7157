"""geomosaic.jobs."""
