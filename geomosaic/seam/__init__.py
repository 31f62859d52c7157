"""Which image shows which place, and the weights across the seams."""
