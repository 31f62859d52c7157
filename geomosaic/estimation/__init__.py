"""Least squares: normal equations, networks of measurements, outliers; knows no image and no file."""
