"""Surfaces of things that are no terrain, from files."""
