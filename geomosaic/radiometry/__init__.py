"""Gain and offset of each image, solved over the overlaps."""
