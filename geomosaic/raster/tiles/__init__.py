"""Tiled GeoTIFF and COG files, put together tile by tile; `RasterSink` writes through them."""
