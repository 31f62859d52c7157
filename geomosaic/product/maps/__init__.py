"""From a raster to a finished map: enhancement, contours, sheets and series of them."""
