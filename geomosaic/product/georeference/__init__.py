"""Georeferencing one image by its control: read, examined, fitted, judged, drawn and told."""
