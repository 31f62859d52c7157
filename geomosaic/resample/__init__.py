"""Resampling of images through a lattice, and what is made of several: weighted means, pyramids, occlusion."""
