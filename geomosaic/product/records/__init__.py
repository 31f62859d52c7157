"""What goes with a mosaic: vectors and a STAC item, facts of its sources, rasters of where each pixel comes from."""
