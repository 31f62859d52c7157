"""Rasters and vectors in files, the only user of GDAL: read by windows, written whole."""
