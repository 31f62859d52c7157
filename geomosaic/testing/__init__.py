"""geomosaic.testing."""
