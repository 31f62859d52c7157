"""Developed images of things that are no terrain: facades, towers, domes."""
