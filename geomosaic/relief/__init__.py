"""Relief: contours, spot heights and prominence of height grids."""
