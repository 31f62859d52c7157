"""The colour of a mosaic: samples of the overlaps, what is warranted by them, corrections, and the last stretch."""
