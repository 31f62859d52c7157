"""TIFF files that grow tile by tile, with overviews; tiles of an earlier file are taken over as they are."""
