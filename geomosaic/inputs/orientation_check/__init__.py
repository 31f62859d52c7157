"""Checks of orientations before any long work."""
