"""Orientations, object points and image measurements in the files of other programs, both ways."""
