"""What describes sheets and series, to values."""
