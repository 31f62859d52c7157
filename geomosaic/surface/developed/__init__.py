"""Surfaces of things that are no terrain: plane, cylinder, cone, ellipsoid, and their developments in metres."""
