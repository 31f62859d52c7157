"""Digitizing in the studio: layers of GeoPackages beside the project, drawn on the map and in photos."""
