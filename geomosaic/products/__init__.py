"""Products from plain inputs: orthos, mosaics and edge-matched mosaics, each by one function of the library."""
