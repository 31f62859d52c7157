"""The block in the studio: footprints, flight lines, tie points with their residuals, images set aside."""
