"""Image matching: shifts between two images, and the location of marks."""
