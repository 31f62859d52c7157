"""Blocks of photos of flat ground, without a rigorous model: uncontrolled, semicontrolled and controlled mosaics."""
