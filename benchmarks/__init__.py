"""How fast, how large, how exact: geomosaic beside its peers and the floor, on the same data in one run."""
