"""Styles of other programs: the common part of QML (QGIS) and SLD (OGC)."""
