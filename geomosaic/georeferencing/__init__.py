"""Georeferencing of one image by control points, with its report."""
