"""One photo and its map: plotting from it and drawing into it."""
