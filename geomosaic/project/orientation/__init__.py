"""Orientations from tables and lists, and whether they can be meant."""
