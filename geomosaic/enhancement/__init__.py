"""Enhancement for print: contrast, sharpening, pan-sharpening, hillshade."""
