"""Tiled TIFF files and COGs that grow tile by tile, with overviews; tiles of earlier files are reused as they are."""
