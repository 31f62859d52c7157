"""Styles of vector layers: TOML, QML of QGIS, SLD."""
