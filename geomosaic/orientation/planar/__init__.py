"""Planar blocks: photos of flat ground without a rigorous model; uncontrolled to controlled mosaics."""
