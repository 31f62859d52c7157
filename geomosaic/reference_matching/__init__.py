"""Images found in a georeferenced reference: control points without a point measured by hand."""
