"""Surfaces: plane, ellipsoid, DEM; intersection of rays with them."""
