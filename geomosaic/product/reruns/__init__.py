"""What a run takes over from an earlier one of the same product."""
