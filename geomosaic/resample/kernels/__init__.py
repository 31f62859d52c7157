"""Numba kernels: image coordinates of output pixels, values at them, weighted means.

Each has a plain NumPy twin in `resample.reference` that computes the same operations in the same order, so both give
the same bytes; the twin serves small jobs and the tests. No fastmath: results must not depend on how loops are
vectorised. What is compiled is kept beside the module it stands in and renewed when that file changes, so no kernel
calls one of another module.
"""
