"""Images with their models, the surface they show, footprints and control points."""
