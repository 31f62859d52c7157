"""What is made of a block: orthos, mosaics, checks and the report."""
