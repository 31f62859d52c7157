"""Resampling of images through a lattice, by compiled kernels and in NumPy, to the same bytes."""
