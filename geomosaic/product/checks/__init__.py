"""Products held against what is known better, and against what was planned."""
