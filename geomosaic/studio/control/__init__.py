"""Control measured in the studio: points of an image, their solution, and where the next one helps most."""
