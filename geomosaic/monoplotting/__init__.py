"""Monoplotting both ways: pixels to places on the ground with their error, and map vectors into a photo."""
