"""Tiled TIFF files and COGs that grow tile by tile, with overviews; tiles of earlier files are reused as they are.

GDAL compresses the tiles, its COG driver is not used: it makes a second copy of a finished file. A mosaic of 7978 x
6249 pixels RGB is written in 3.6 s of processor time instead of 4.8 s (medians of 7 pairs, deflate, 2 threads), which
is a tenth of the whole job, and a rerun copies the compressed tiles of what did not change.
"""
