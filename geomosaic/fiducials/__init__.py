"""Fiducial marks of scanned films."""
