"""Control of one image: places known in the image and on the ground, the files they come from, diagnostics."""
