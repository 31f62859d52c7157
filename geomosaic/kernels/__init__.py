"""Compiled kernels: image coordinates of output pixels, values at them, weighted means, pyramids, occlusion.

Each is a C++ function of the library that `library` loads, behind a typed Python function. No fast maths: results must
not depend on how loops are vectorised, so that every processor gives the same bytes; the tests hold them against the
same operations in NumPy.
"""
