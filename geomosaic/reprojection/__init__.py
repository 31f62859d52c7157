"""Reprojection of vector layers."""
