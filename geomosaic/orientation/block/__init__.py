"""Block adjustment of any mix of sensors."""
