"""Least squares over measured points: single images and whole blocks."""
