"""Planar blocks from tables."""
