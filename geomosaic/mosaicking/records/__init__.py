"""Records that go with a mosaic: footprints, seamlines, STAC item, provenance."""
