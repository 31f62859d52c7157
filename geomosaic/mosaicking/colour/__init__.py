"""Colour of a mosaic: samples of overlaps to corrections of each image."""
