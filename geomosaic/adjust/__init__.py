"""Fits of one image to its control: errors told, points deleted, blunders found, kinds compared.

Everything works on a function that makes a sensor model from chosen control points; no sensor is known here.
"""
