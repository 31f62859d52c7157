"""Orientation: images placed by control and tie points, one by one, in planar blocks, and matched at their edges."""
