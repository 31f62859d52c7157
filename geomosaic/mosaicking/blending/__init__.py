"""Blending: values of several images to one, across seams, over overlaps, or by rule."""
