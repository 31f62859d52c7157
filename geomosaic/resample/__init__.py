"""Taking an image's values where a lattice says, compiled and in NumPy, to the same bytes."""
