"""Least squares: equations, problems and their solver, statistics, and blunders; knows no image and no file."""
