"""Seams: which image shows which place."""
