"""Photos without a rigorous model, from their tables to a block."""
