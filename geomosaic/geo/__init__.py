"""Coordinate reference systems, vertical datums, local frames, rotations and the raster grid."""
