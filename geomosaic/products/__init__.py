"""Products from plain inputs: orthos, mosaics, planar and edge-matched mosaics."""
