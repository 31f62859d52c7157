"""Heights of the ground: plane, ellipsoid, DEM; and where rays meet it."""
