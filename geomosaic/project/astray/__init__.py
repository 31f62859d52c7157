"""Control that lies far from where the images put it: what is likeliest wrong with it."""
