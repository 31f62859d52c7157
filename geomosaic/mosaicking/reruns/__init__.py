"""Reruns: what an earlier run of the same mosaic has found, taken where its ingredients are the same."""
