"""Series of sheets: schemes that divide the ground, their neatlines, and whole series made."""
