"""Planes, cylinders, cones, spheres and ellipsoids through measured points, by least squares of distances."""
