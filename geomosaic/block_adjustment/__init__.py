"""Block adjustment of declared images: measurements, solution, files."""
