"""geomosaic.sensor."""
