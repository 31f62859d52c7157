"""Planning: the calculators of photo scale, scanning, relief, swath, coverage and control, in all directions.

Pure functions of numbers; nothing here reads a file.
"""
