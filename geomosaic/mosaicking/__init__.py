"""Mosaics: many images to one, each pixel resampled once; colour, seams, blending, water, records and reruns."""
