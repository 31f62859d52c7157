"""Water in mosaics: areas proposed, shown with the least glint, or filled with a tone."""
