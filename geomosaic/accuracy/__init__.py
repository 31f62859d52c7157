"""Accuracy: products held against check points, reference images and requirements."""
