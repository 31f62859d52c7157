"""Rendering: output blocks pulled from raw images through a lattice of the sensor model; orthos."""
