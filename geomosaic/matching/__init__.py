"""Image matching: features, pairs of images, least squares matching, tracks. Functions of arrays."""
