"""Inputs: from plain declarations, files and tables to scenes, surfaces and control points."""
