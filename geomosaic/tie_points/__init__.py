"""Tie points of images, measured in the images themselves."""
