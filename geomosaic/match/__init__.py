"""Finding the same ground in two images."""
